//! Sessions with a board or a phone that lies, a few of them. `cargo xtask lies` runs more.

use crate::support;
use crate::turn;
use trials::faults::Programs;
use trials::lies::campaign;

#[test]
fn whatever_board_and_phone_say_the_session_ends_well() {
    let _turn = turn::beside_others();
    let programs = Programs {
        smartdepthsync: support::smartdepthsync().to_owned(),
        elf: None,
        speed: 8.0,
    };
    let folder = tempfile::tempdir().unwrap();
    let results = campaign(1, 8, &programs, folder.path(), &|_| {});
    let passed: Vec<_> = results
        .into_iter()
        .map(|result| result.unwrap_or_else(|finding| panic!("{finding}")))
        .collect();
    assert!(passed.iter().map(|verdict| verdict.told).sum::<u64>() > 100);
    assert!(passed.iter().any(|verdict| verdict.frames > 1_000));
}
