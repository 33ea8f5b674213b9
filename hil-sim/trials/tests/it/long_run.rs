//! A short piece of the long run, over a wrap of the counter.

use crate::turn;
use rig::random::Seed;
use trials::long_run::{Options, run};

/// `cargo xtask longrun` is this for hours.
#[test]
fn two_minutes_are_exact_on_all_pins_with_flat_memory() {
    // It looks at the memory of all of this program.
    let _turn = turn::alone();
    let options = Options {
        elf: None,
        seed: Seed(3),
        seconds: 120,
        full_link_percent: 10,
        strobe: true,
        slice_s: 2,
    };
    let report = run(&options, |_| {}).unwrap();
    assert_eq!(report.full_link_s, 12);
    assert_eq!(report.lost, 0);
    assert!(report.pulses >= 3_600, "{report:?}");
    assert_eq!(report.pulses_reported, report.pulses);
    assert!(report.samples >= 60_000, "{report:?}");
    assert!(report.captures >= 18 * 3_590, "{report:?}");
    assert!(report.wraps >= 1, "{report:?}");
    assert!(report.link_bytes > 12 * 400_000, "{report:?}");
    assert!(report.stack_used < report.stack_size / 2, "{report:?}");
    let at = &report.growth[0];
    assert!(at.to_bytes > at.from_bytes, "{at:?}");
}
