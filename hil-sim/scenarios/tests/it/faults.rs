//! The fault campaign, a few seeds of it. `cargo xtask hil-sim faults` runs them all.

use std::path::Path;
use std::process::Command;

use board::finding::Severity;
use recording::SESSION_FILE;
use recording::session_file::{SessionFile, SessionOutcome};
use recording::verify::verify;
use report::REPORT_FILE;
use report::session::{is_lossy, summary};
use scenarios::campaign::plan::{Event, Fault, Plan};
use scenarios::campaign::{Verdict, campaign, folders, run};
use serde_json::{Value, json};
use system::ReadMonitor;
use test_support::contents;

use crate::support;

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
    for seed in SEEDS {
        let [place, killed] = folders(seed, folder.path());
        for folder in [place.join("recording"), killed] {
            if folder.join(SESSION_FILE).exists() {
                agree(&folder);
            }
        }
    }
    for fault in Fault::ALL {
        assert!(
            verdicts.iter().any(|verdict| verdict.plan.has(fault)),
            "{fault:?}"
        );
    }
}

/// `verify`, its page, its exit code and the extraction state the one verdict on a recording, and
/// every command that they print runs.
fn agree(folder: &Path) {
    let session = SessionFile::load(folder).unwrap();
    let verification = verify(folder, &ReadMonitor::default()).unwrap();
    let verdict = summary(folder, &session, Some(&verification));
    let code = if is_lossy(&session, Some(&verification)) {
        4
    } else {
        0
    };
    let output_of = |arguments: &[&str]| {
        let output = Command::new(support::smartdepthsync())
            .args(arguments)
            .arg(folder)
            .output()
            .unwrap();
        assert_eq!(
            output.status.code(),
            Some(code),
            "{arguments:?}: {output:?}"
        );
        String::from_utf8(output.stdout).unwrap()
    };
    let json: Value = serde_json::from_str(&output_of(&["--json", "verify"])).unwrap();
    let word = verdict.severity.word();
    assert_eq!(
        (&json["severity"], &json["verdict"]["severity"]),
        (&json!(word), &json!(word))
    );
    assert_eq!(json["verdict"]["text"], verdict.text);
    let text = output_of(&["verify"]);
    assert_eq!(text.lines().next(), Some(verdict.text.as_str()));
    let page = |path: &Path| std::fs::read_to_string(path.join(REPORT_FILE)).unwrap();
    assert!(page(folder).contains(&format!("<b>{word}</b>")), "{word}");
    let mut printed = vec![text];
    if session.has_recorded() {
        // The phone's files are still on it: that is a loss of the data set, whatever else.
        let own = summary(folder, &session, None)
            .severity
            .max(Severity::Check);
        let data = folder.with_file_name("data");
        let output = Command::new(support::smartdepthsync())
            .args(["extract", "--overwrite", "--out"])
            .args([&data, folder])
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(4), "{output:?}");
        assert!(page(&data).contains(&format!("<b>{}</b>", own.word())));
        printed.push(String::from_utf8(output.stdout).unwrap());
    }
    for line in printed.iter().flat_map(|text| text.lines()) {
        let quoted = line.split('`').skip(1).step_by(2);
        let next = line.strip_prefix("  smartdepthsync").map(|_| line.trim());
        for command in quoted
            .chain(next)
            .filter(|it| it.starts_with("smartdepthsync "))
        {
            // Its options are read, and nothing is done.
            let tool = support::smartdepthsync().display();
            let typed = command.replacen("smartdepthsync", "\"$0\"", 1);
            let ran = Command::new("sh")
                .args(["-c", &format!("{typed} --help"), &tool.to_string()])
                .output()
                .unwrap();
            assert!(ran.status.success(), "{command}: {ran:?}");
        }
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
