//! The report of a recording, opened in a browser.

use std::process::Command;

use board::{StreamCount, StreamCounts};
use protocol::Ticks;
use recording::finding::Finding;
use recording::session_file::{Marker, SessionFile, SessionOutcome, Span, Twist};

use crate::support::synthetic::{SECONDS, Wrong, make};
use test_support::browser;

#[test]
fn a_recordings_report_is_readable_on_phone_desk_and_paper() {
    let parent = tempfile::tempdir().unwrap();
    let folder = make(parent.path(), Wrong::default());
    let mut session = SessionFile::load(&folder).unwrap();
    let clock = session.alignment.unwrap().clock;
    session.phones[0].clock = Some(clock);
    session.phones[0].twists.push(Twist {
        phone_gyro: Some(String::from("twist_1_phone_gyro.csv")),
        span: Span {
            from: Ticks(48_000_000),
            to: Ticks(48_000_000 * 8),
        },
        accepted: true,
        clock: Some(clock),
        offset_sigma_us: Some(2.4),
        skew_sigma_ppm: Some(0.98),
        board_temperature_c: Some(27.5),
        report: serde_json::Value::Null,
    });
    session.counts = StreamCounts {
        pulses: StreamCount {
            received: SECONDS * 30,
            ..StreamCount::default()
        },
        imu: StreamCount {
            received: SECONDS * 500,
            lost: 2,
            disordered: 0,
        },
        ..StreamCounts::default()
    };
    session.outcome = Some(SessionOutcome::Loss);
    let lost = Finding::check("imu_gap", "2 IMU samples lost <b>here</b>");
    session.problems.push(lost.at(Ticks(48_000_000 * 5)));
    session.markers.push(Marker {
        at: Ticks(48_000_000 * 4),
        label: String::from("a door that has a very long name, as people write them"),
    });
    session.save(&folder).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_smartdepthsync"))
        .args(["--json", "verify"])
        .arg(&folder)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    let written: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let report = folder.join("report.html");
    assert_eq!(written["report"], report.to_str().unwrap());
    browser::check(
        &report,
        "record",
        &[
            "<b>check</b>",
            "2 IMU samples lost &lt;b&gt;here&lt;/b&gt;",
            "rad/s",
            "a door that has a very long name",
            "frame_sync.bias_us",
        ],
    );
}
