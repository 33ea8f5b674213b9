//! The hostile campaign, a few seeds of it. `cargo xtask hostile` runs more.

use crate::support;
use crate::turn;
use trials::hostile::campaign;

#[test]
fn absurd_values_in_valid_files_do_no_harm() {
    let _turn = turn::beside_others();
    let outcome = campaign(support::smartdepthsync(), 1, 24, &|_, _| {}).unwrap();
    let failed: Vec<String> = outcome.failed.iter().map(ToString::to_string).collect();
    assert!(failed.is_empty(), "{}", failed.join("\n"));
    assert!(outcome.by_command().len() >= 5, "most commands were drawn");
}
