//! `smartdepthsync record` as a process on the whole simulated rig: a session
//! that goes well, judged by the truth and by public readers.

use std::path::Path;

use crate::turn;
use crate::whole_rig::{OVERSHOOT_S, SPEED, Session, WholeRig, run_python};
use recording::MCAP_FILE;
use recording::finding::Severity;
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};
use rig::imu::SampleRecord;
use scenarios::demo::judge::Truth;
use serde_json::Value;

#[test]
fn a_session_ends_aligned_and_everything_is_in_its_folder() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(1, SPEED);
    let arguments = [
        "--duration",
        "20s",
        "--marker",
        "3s",
        "--marker",
        "5s",
        "--fetch-video",
    ];
    let said = Session::start(&mut rig.record_with("good", &rig.full_rate_profile(), &arguments))
        .ends_with(0);
    println!("{said}");

    let folder = rig.recording("good");
    let session = SessionFile::load(&folder).unwrap();
    assert_eq!(session.outcome, Some(SessionOutcome::Good));
    assert_eq!(session.counts.lost(), 0);
    assert!(session.problems.is_empty());
    // Both sides were looked at before, and all of them were in order.
    let looked: Vec<&str> = session.preflight.iter().map(|c| c.kind.as_str()).collect();
    for name in [
        "disk",
        "ffmpeg",
        "board",
        "phone",
        "IMU",
        "IMU clock",
        "IMU noise",
        "link",
    ] {
        assert!(looked.contains(&name), "{name} is missing in {looked:?}");
    }
    assert_eq!(looked.last(), Some(&"trigger read-back"));
    assert!(
        session
            .preflight
            .iter()
            .all(|c| c.severity != Severity::Bad)
    );
    assert_eq!(session.markers.len(), 2);
    let span = session.recorded.unwrap();
    let seconds = (span.to - span.from).as_secs_f64();
    assert!((20.0..20.0 + OVERSHOOT_S).contains(&seconds), "{seconds}");
    assert_eq!(session.markers[0].at.0 - span.from.0, 3 * 48_000_000);
    for file in &session.files {
        assert!(folder.join(file).metadata().unwrap().len() > 0, "{file}");
    }
    assert!(session.files.iter().any(|f| f.ends_with(".mp4")));
    assert!(!rig.phone().is_recording());

    // The figures by the truth.
    let truth = rig.rig.stop().unwrap();
    let samples = truth.imu.clone();
    let verdict = Truth::of(truth).unwrap().judge(&folder).unwrap();
    let alignment = session.alignment.unwrap();
    println!(
        "{:?} {:?} {:?}",
        verdict.offset_start, verdict.phase, alignment
    );
    let start = verdict.offset_start;
    assert!(start.error_us.abs() < 5.0 * start.sigma_us, "{start:?}");
    assert!(start.sigma_us < 20.0, "{start:?}");
    // One stamp of the phone has 1 µs of jitter; the rest is the offset's.
    let phase_sigma = alignment.phase_sigma_us.hypot(1.0);
    assert!(verdict.phase.start_us.abs() < 5.0 * phase_sigma);
    assert!(verdict.phase.drift_us_per_min.abs() < 5.0 * alignment.drift_sigma_us_per_min);
    assert!(verdict.phase.residual_us < 1.0, "{:?}", verdict.phase);
    assert_eq!(verdict.lost, 0);

    as_sent(&folder, &session, &samples);
}

/// What is in the file is what was in the sensor's registers, bit for bit, in
/// this program's reader and in public ones.
fn as_sent(folder: &Path, session: &SessionFile, samples: &[SampleRecord]) {
    let scale = session.imu.as_ref().unwrap().scale;
    let mut rows = Vec::new();
    let mut link = 0;
    let mut pulses = 0;
    let arrival = session.alignment.unwrap().arrival_pulse.unwrap();
    let mut reader = Reader::open(folder).unwrap();
    for entry in reader.by_ref() {
        let entry = entry.unwrap();
        match entry.item {
            Item::Imu(sample) => {
                let rate = sample.angular_velocity;
                let force = sample.linear_acceleration;
                rows.push((entry.at.as_nanos(), [rate, force].concat()));
            }
            Item::Pulse(pulse) => {
                pulses += 1;
                // On a grid of its own before, and on none on its way.
                assert_eq!(pulse.aligned, pulse.number >= arrival, "{pulse:?}");
            }
            Item::Link(_) => link += 1,
            _ => {}
        }
    }
    assert!(!reader.broken_off());
    assert!(rows.len() > 13_000, "{}", rows.len());
    assert!(pulses > 600, "{pulses}");
    assert!(link > 0);

    // Every row is the next of the sensor's samples: none missing, none changed.
    let expected = |record: &SampleRecord| {
        let values = &record.values;
        [
            values.gyro.map(|v| f64::from(v) * scale.gyro_rad_s),
            values.accel.map(|v| f64::from(v) * scale.accel_m_s2),
        ]
        .concat()
    };
    let first = samples
        .iter()
        .position(|record| expected(record) == rows[0].1)
        .expect("the first row is no sample of the sensor");
    for ((_, row), record) in rows.iter().zip(&samples[first..]) {
        assert_eq!(row, &expected(record));
    }

    let found: Value =
        serde_json::from_str(&run_python("read_recording.py", &[&folder.join(MCAP_FILE)])).unwrap();
    let read = found["imu"].as_array().unwrap();
    assert_eq!(read.len(), rows.len());
    for (row, (at, values)) in read.iter().zip(&rows) {
        assert_eq!(row[0], *at);
        let found: Vec<f64> = row.as_array().unwrap()[1..]
            .iter()
            .map(|value| value.as_f64().unwrap())
            .collect();
        assert_eq!(&found, values);
    }
    assert_eq!(found["counts"]["/board/trigger_pulse"], pulses);
    assert_eq!(found["counts"]["/link/frames"], link);
    assert_eq!(found["markers"].as_array().unwrap().len(), 2);
}
