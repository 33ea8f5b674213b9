//! The fault campaign, a few seeds of it. `cargo xtask hil-sim faults` runs them all.

use recording::session_file::SessionOutcome;
use scenarios::campaign::plan::{Event, Fault, Plan};
use scenarios::campaign::{Verdict, campaign, folders, run};
use test_support::contents;

/// Ten seeds in which every fault comes while the board records, all but two of them twice. In
/// 81 the cable is pulled before the first sample of an IMU that is set up again; in 17 it is out
/// when the board is reset. One seed is one run, to the byte.
#[test]
fn ten_seeds_pass_and_replay_exactly() {
    const SEEDS: [u64; 10] = [81, 17, 57, 152, 210, 134, 282, 178, 271, 195];
    let folder = tempfile::tempdir().unwrap();
    let run = |seeds: &[u64]| campaign(seeds, None, folder.path(), &|_, _| {});
    let verdicts: Vec<Verdict> = run(&SEEDS)
        .into_iter()
        .map(|result| result.unwrap_or_else(|finding| panic!("{finding}")))
        .collect();
    // All files, with the log, which names their folder.
    let [place, _] = folders(152, folder.path());
    let files = contents(&place);
    assert!(run(&[152])[0].is_ok());
    let again = contents(&place);
    assert!(files.keys().eq(again.keys()));
    for (name, bytes) in &files {
        assert!(again[name] == *bytes, "{}", name.display());
    }
    for fault in Fault::ALL {
        assert!(
            verdicts.iter().any(|verdict| verdict.plan.has(fault)),
            "{fault:?}"
        );
    }
}

fn planned(seed: u64, length_us: u64, events: &[(Fault, u64, u64)]) -> Verdict {
    let folder = tempfile::tempdir().unwrap();
    let events = events.iter().map(|&(fault, at_us, for_us)| Event {
        fault,
        at_us,
        for_us,
    });
    let plan = Plan {
        seed,
        events: events.collect(),
        length_us,
        corruption_ppm: 0,
        clock_step_s: 0,
    };
    run(&plan, None, folder.path()).unwrap()
}

/// Without a fault nothing is lost, and the session says so.
#[test]
fn without_a_fault_all_is_good() {
    let verdict = planned(77, 10_000_000, &[]);
    assert_eq!(verdict.outcome, SessionOutcome::Good, "{verdict:?}");
    assert_eq!((verdict.pulses_lost, verdict.samples_lost), (0, 0));
    assert!(verdict.pulses > 290 && verdict.delivered > 5_000);
}

/// A host that stalls longer than the host program waits for a sign of life, on
/// a port that does not go away.
#[test]
fn a_stall_of_twenty_seconds_is_survived() {
    let stall = (Fault::HostStalled, 3_000_000, 20_000_000);
    let verdict = planned(78, 32_000_000, &[stall]);
    assert_eq!(verdict.outcome, SessionOutcome::Loss, "{verdict:?}");
    assert!(verdict.reconnects >= 1, "{verdict:?}");
    assert!(verdict.pulses_lost > 400, "{verdict:?}");
}

/// The board is reset while the host takes nothing: what it says of its new run
/// comes before the host knows of one.
#[test]
fn a_reset_while_the_host_stalls_closes_the_recording() {
    let events = [
        (Fault::HostStalled, 5_163_198, 12_006_373),
        (Fault::WatchdogReset, 5_812_658, 0),
    ];
    let verdict = planned(196, 26_170_000, &events);
    assert_eq!(verdict.outcome, SessionOutcome::Loss, "{verdict:?}");
}
