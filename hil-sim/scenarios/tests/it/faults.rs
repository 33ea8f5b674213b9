//! The fault campaign, a few seeds of it. `cargo xtask hil-sim faults` runs them all.

use crate::support;
use crate::turn;
use rig::random::Seed;
use scenarios::faults::plan::{Event, Fault, Plan};
use scenarios::faults::{campaign, run, run_plan};
use scenarios::programs::Programs;

fn programs() -> Programs {
    Programs {
        smartdepthsync: support::smartdepthsync().to_owned(),
        elf: None,
        speed: 8.0,
    }
}

/// Seeds that together have every fault.
const SEEDS: [u64; 15] = [3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 18];

#[test]
fn the_fifteen_seeds_have_every_fault() {
    let _turn = turn::beside_others();
    for fault in Fault::ALL {
        let among = SEEDS.iter().any(|&seed| Plan::draw(Seed(seed)).has(fault));
        assert!(among, "{fault:?}");
    }
}

#[test]
fn fifteen_seeds_pass() {
    let _turn = turn::beside_others();
    let folder = support::folder_in_memory();
    let failed: Vec<String> = campaign(&SEEDS, &programs(), folder.path(), &|_, _| {})
        .into_iter()
        .filter_map(|result| Some(result.err()?.to_string()))
        .collect();
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

/// One seed is one run, to the byte.
#[test]
fn a_seed_replays_exactly() {
    let _turn = turn::beside_others();
    let folder = tempfile::tempdir().unwrap();
    let digests: Vec<u32> = (0..2)
        .map(|_| run(Seed(2), &programs(), folder.path()).unwrap().digest)
        .collect();
    assert_eq!(digests[0], digests[1]);
}

/// Without a fault nothing is lost, and the session says so.
#[test]
fn without_a_fault_all_is_good() {
    let _turn = turn::beside_others();
    let folder = tempfile::tempdir().unwrap();
    let plan = Plan {
        seed: 77,
        events: Vec::new(),
        length_us: 10_000_000,
        corruption_ppm: 0,
        clock_step_s: 0,
    };
    let verdict = run_plan(&plan, &programs(), folder.path()).unwrap();
    assert_eq!(verdict.exit_code, 0, "{verdict:?}");
    assert_eq!((verdict.pulses_lost, verdict.samples_lost), (0, 0));
    assert!(verdict.pulses > 290 && verdict.delivered > 5_000);
}

/// A host that stalls longer than the host program waits for a sign of life, on
/// a port that does not go away.
#[test]
fn a_stall_of_twenty_seconds_is_survived() {
    let _turn = turn::beside_others();
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
        clock_step_s: 0,
    };
    let verdict = run_plan(&plan, &programs(), folder.path()).unwrap();
    assert_eq!(verdict.exit_code, 4, "{verdict:?}");
    assert!(verdict.reconnects >= 1, "{verdict:?}");
    assert!(verdict.pulses_lost > 400, "{verdict:?}");
}

/// The board is reset while the host takes nothing: what it says of its new run
/// comes before the host knows of one.
#[test]
fn a_reset_while_the_host_stalls_is_survived() {
    let _turn = turn::beside_others();
    let folder = tempfile::tempdir().unwrap();
    let event = |fault, at_us, for_us| Event {
        fault,
        at_us,
        for_us,
    };
    let plan = Plan {
        seed: 196,
        events: vec![
            event(Fault::HostStalled, 5_163_198, 12_006_373),
            event(Fault::WatchdogReset, 5_812_658, 0),
        ],
        length_us: 26_170_000,
        corruption_ppm: 0,
        clock_step_s: 0,
    };
    let verdict = run_plan(&plan, &programs(), folder.path()).unwrap();
    assert_eq!((verdict.exit_code, verdict.runs), (4, 2), "{verdict:?}");
}
