//! A part of the campaign of faults in the phone alone.

use scenarios::phone_faults::campaign;

use crate::turn;

#[test]
fn the_client_leaves_no_video_running() {
    let _turn = turn::beside_others();
    let seeds: Vec<u64> = (1..=32).collect();
    let runs = campaign(&seeds, &|run| println!("{}: {}", run.seed, run.story)).unwrap();
    let left: Vec<_> = runs.iter().filter(|run| run.left_running).collect();
    assert!(left.is_empty(), "{left:?}");
    // Most get as far as that it matters.
    let began = runs.iter().filter(|run| run.began).count();
    assert!(began > runs.len() / 2, "{began}");
}
