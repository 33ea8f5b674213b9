//! The fault campaign, a few seeds of it. `cargo xtask faults` runs them all.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use hil_sim::faults::plan::{Event, Fault, Plan};
use hil_sim::faults::{run, run_plan};
use hil_sim::random::Seed;
use rayon::prelude::*;

/// Every fault leads in one of thirteen seeds in a row.
#[test]
fn fifteen_seeds_pass() {
    let folder = tempfile::tempdir().unwrap();
    let failed: Vec<String> = (1..=15_u64)
        .into_par_iter()
        .filter_map(|seed| run(Seed(seed), None, folder.path()).err())
        .map(|finding| finding.to_string())
        .collect();
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

/// One seed is one run, to the byte.
#[test]
fn a_seed_replays_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let digests: Vec<u32> = (0..2)
        .map(|_| run(Seed(2), None, folder.path()).unwrap().digest)
        .collect();
    assert_eq!(digests[0], digests[1]);
}

/// Without a fault nothing is lost, and the session says so.
#[test]
fn without_a_fault_all_is_good() {
    let folder = tempfile::tempdir().unwrap();
    let plan = Plan {
        seed: 77,
        events: Vec::new(),
        length_us: 10_000_000,
        corruption_ppm: 0,
    };
    let verdict = run_plan(&plan, None, folder.path()).unwrap();
    assert_eq!(verdict.exit_code, 0, "{verdict:?}");
    assert_eq!((verdict.pulses_lost, verdict.samples_lost), (0, 0));
    assert!(verdict.pulses > 290 && verdict.delivered > 5_000);
}

/// A host that stalls longer than the host program waits for a sign of life, on
/// a port that does not go away.
#[test]
fn a_stall_of_twenty_seconds_is_survived() {
    let folder = tempfile::tempdir().unwrap();
    let stall = Event {
        fault: Fault::HostStalled,
        at_us: 3_000_000,
        for_us: 20_000_000,
    };
    let plan = Plan {
        seed: 78,
        events: vec![stall],
        length_us: 32_000_000,
        corruption_ppm: 0,
    };
    let verdict = run_plan(&plan, None, folder.path()).unwrap();
    assert_eq!(verdict.exit_code, 4, "{verdict:?}");
    assert!(verdict.reconnects >= 1, "{verdict:?}");
    assert!(verdict.pulses_lost > 400, "{verdict:?}");
}
