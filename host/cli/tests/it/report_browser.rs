//! The report of a recording, opened in a browser.

use std::process::Command;

use board::finding::Finding;
use board::{StreamCount, StreamCounts};
use protocol::Ticks;
use recording::session_file::{Marker, SessionFile, SessionOutcome, Span, Twist, Video};

use crate::support::synthetic::{SECONDS, Wrong, make};
use clock::{BoardToPhone, PhoneNanos};
use test_support::TestFolder;
use test_support::browser;

#[test]
fn a_recordings_report_is_readable_on_phone_desk_and_paper() {
    let parent = TestFolder::new();
    let folder = make(parent.path(), Wrong::default());
    let mut session = SessionFile::load(&folder).unwrap();
    let clock = session.alignment.unwrap().plan.clock;
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
        report: None,
    });
    // The phone turned as the board did.
    let row = |number: u64| {
        let at = clock.ticks_to_phone(Ticks(48_000_777 + 5_000 + number * 96_000));
        // By the delay of its filter later.
        let at = at.0 + (session.profile.phone.gyro_delay_us * 1e3) as i64;
        format!("{},0.1,0.2,{at}\n", (number % 600) as f64 * 1e-3)
    };
    let rows: String = (0..SECONDS * 500).map(row).collect();
    std::fs::write(folder.join("twist_1_phone_gyro.csv"), rows).unwrap();
    session.phones[0].video = Some(Video {
        phase: PhoneNanos(0),
        frame_duration_ns: 33e6,
        exposure_ns: None,
        boot_minus_frames_ns: 0,
    });
    let frame = |number: i64| clock.ticks_to_phone(Ticks(48_000_777)).0 + number * 33_330_652;
    let frames: String = (0..150)
        .map(|number| format!("{}\n", frame(number)))
        .collect();
    std::fs::write(folder.join("VID_1_timestamps.csv"), frames).unwrap();
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
    // The gyroscope is of the session; the marker is not in the recording, nor are the phone's sensors.
    let monitor = system::ReadMonitor::default();
    session.close_files(&folder, &monitor).unwrap();
    session.save(&folder).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_smartdepthsync"))
        .args(["--json", "verify"])
        .arg(&folder)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    let written: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let findings = written["findings"].as_array().unwrap().iter();
    let wrong = findings.filter(|finding| finding["severity"] != "good");
    let wrong: Vec<&str> = wrong
        .map(|finding| finding["kind"].as_str().unwrap())
        .collect();
    assert_eq!(wrong, ["markers_differ"], "{written}");
    let report = folder.join("report.html");
    assert_eq!(written["report"], report.to_str().unwrap());
    browser::check(
        &report,
        "record",
        &[
            "<b>bad</b>",
            "2 IMU samples lost &lt;b&gt;here&lt;/b&gt;",
            "Twist 1: magnitude of the angular rates of board and phone",
            "What is left between the two: 0.000 rad/s rms",
            "Measured is each pulse",
            "No message of any stream is missing",
            "a door that has a very long name",
            "bias_us",
        ],
    );
}
