//! Sessions that go well, judged by the ground truth and by public readers.

use std::path::Path;

use board::finding::{FindingKind, Severity};
use protocol::{ImuClock, ImuModel};
use recording::MCAP_FILE;
use recording::reader::{Item, Reader};
use recording::session_file::{CHECK_READBACK, SessionFile, SessionOutcome};
use rig::clocks::link_delay::LinkRanges;
use rig::imu::{SampleRecord, SensorModel};
use scenarios::judge::Truth;
use serde_json::Value;
use session::event::SessionEvent;
use session::options::{Track, seconds};

use crate::bench::{TWO, Twisted};
use crate::support::run_python;
use crate::whole_chain::near_truth;

#[test]
fn a_session_ends_aligned_and_everything_is_in_its_folder() {
    let mut rig = Twisted::new(1);
    // The default: every row on the wire is looked at.
    rig.bench.profile.imu.rate_hz = 500;
    let mut options = rig.options("good", 20);
    options.markers = vec![seconds(3), seconds(5)];
    options.fetch_video = true;
    let ended = rig.bench.run(&options).good().unwrap();
    rig.all_is_stopped("good");

    let folder = ended.folder;
    let session = SessionFile::load(&folder).unwrap();
    assert_eq!(session.outcome, Some(SessionOutcome::Good));
    assert_eq!(session.counts.lost(), 0);
    assert!(session.problems.is_empty());
    // Both sides were checked before, and all of them were in order.
    let checked: Vec<&FindingKind> = session.preflight.iter().map(|c| &c.kind).collect();
    for name in ["board", "phone", "IMU", "IMU clock", "IMU noise", "link"] {
        let is_checked = checked.iter().any(|&kind| *kind == name);
        assert!(is_checked, "{name} is missing in {checked:?}");
    }
    assert_eq!(checked.last(), Some(&&CHECK_READBACK.into()));
    let is_bad = |check: &board::finding::Finding| check.severity == Severity::Bad;
    assert!(!session.preflight.iter().any(is_bad));
    assert_eq!(session.markers.len(), 2);
    let span = session.recorded.unwrap();
    let length = (span.to - span.from).as_secs_f64();
    assert!((20.0..20.2).contains(&length), "{length}");
    let late = session.markers[0].at.0 - span.from.0;
    assert_eq!(late, seconds(3));
    for file in &session.files {
        assert!(folder.join(file).metadata().unwrap().len() > 0, "{file}");
    }
    assert!(session.files.iter().any(|f| f.ends_with(".mp4")));

    let truth = rig.bench.stop().unwrap();
    let samples = truth.imu.clone();
    let verdict = Truth::from_run(truth).unwrap().judge(&folder).unwrap();
    let alignment = session.alignment.unwrap();
    near_truth(&verdict.offset_start, 20.0, 40.0);
    // One stamp of the phone has 1 µs of jitter; the rest is the offset's.
    let phase_sigma = alignment.phase_sigma_us.hypot(1.0);
    assert!(verdict.phase.start_us.abs() < 5.0 * phase_sigma);
    assert!(verdict.phase.start_us.abs() < 60.0, "{:?}", verdict.phase);
    assert!(verdict.phase.drift_us_per_min.abs() < 5.0 * alignment.drift_sigma_us_per_min);
    assert!(
        verdict.phase.drift_us_per_min.abs() < 300.0,
        "{:?}",
        verdict.phase
    );
    assert!(verdict.phase.residual_us < 1.0, "{:?}", verdict.phase);
    assert_eq!(verdict.lost, 0);

    as_sent(&folder, &session, &samples);
}

/// A twist that passes the gates and leaves the clocks little better known than they allow is
/// tried again, and at last taken as it is.
#[test]
fn a_weak_twist_is_tried_again_where_nobody_is_asked() {
    let mut rig = Twisted::new(2);
    let twists = |rig: &mut Twisted, name: &str| -> Vec<f64> {
        rig.record(name, 3);
        let session = rig.readable(name, SessionOutcome::Good);
        let twists = session.phones[0].twists.iter();
        twists.map(|twist| twist.offset_sigma_us.unwrap()).collect()
    };
    let usual = twists(&mut rig, "usual");
    let [sigma_us] = usual.as_slice() else {
        panic!("{usual:?}");
    };
    // What was good enough is weak then: it passes by half.
    rig.bench.profile.align.max_offset_sigma_us = 2.0 * sigma_us;
    let weak = twists(&mut rig, "weak");
    assert_eq!(weak.len(), 3, "{weak:?}");
}

/// Compares the file with the sensor's registers, bit for bit, in
/// this program's reader and in public ones.
fn as_sent(folder: &Path, session: &SessionFile, samples: &[SampleRecord]) {
    let scale = session.imu.as_ref().unwrap().scale;
    let mut rows = Vec::new();
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
            _ => {}
        }
    }
    assert!(!reader.broken_off());
    assert!(rows.len() > 13_000, "{}", rows.len());
    assert!(pulses > 600, "{pulses}");

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
        .expect("the first row is not a sample of the sensor");
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
    assert_eq!(found["counts"]["/board/trigger"], pulses);
    assert_eq!(found["counts"]["/link/frames"], Value::Null);
    assert_eq!(found["markers"].as_array().unwrap().len(), 2);
}

#[test]
fn two_phones_are_related_by_one_twist() {
    let mut rig = Twisted::with_phones(31, &TWO, |_, _| {});
    let mut options = rig.options("two", 10);
    options.second_twist = true;
    options.fetch_video = true;
    let run = rig.bench.run(&options);
    let related = run
        .events
        .iter()
        .filter_map(|seen| match &seen.stamped.event {
            SessionEvent::TwistAccepted(twist) => Some((twist.number, twist.phone.name.clone())),
            _ => None,
        });
    let expected = [(1, "left"), (1, "right"), (2, "left"), (2, "right")];
    assert!(related.eq(expected.map(|(number, name)| (number, name.to_owned()))));

    let folder = run.good().unwrap().folder;
    let session = SessionFile::load(&folder).unwrap();
    assert_eq!(session.profile.phone.name, "left");
    let right = &session.phones[1];
    assert_eq!((right.name.as_str(), right.twists.len()), ("right", 2));
    // Each phone's files are in its own folder, and are all there.
    for file in &session.files {
        assert!(folder.join(file).is_file(), "{file}");
    }
    for name in ["left", "right"] {
        let own = |ending: &str| {
            let begins = format!("phones/{name}/");
            let ours = |file: &&String| file.starts_with(&begins) && file.ends_with(ending);
            session.files.iter().filter(ours).count()
        };
        assert_eq!((own("_phone_gyro.csv"), own(".mp4")), (2, 1), "{name}");
    }
    let mut sources = Vec::new();
    for entry in Reader::open(&folder).unwrap() {
        if let Item::PhoneClock(clock) = entry.unwrap().item {
            sources.push((clock.header.frame_id, clock.source));
        }
    }
    let source = |text: &str| (String::from("right"), String::from(text));
    assert_eq!(
        sources,
        [source("twist 1"), source("twists at begin and end")]
    );
}

#[test]
fn a_session_is_aligned_with_an_imu_on_its_own_clock() {
    let mut rig = Twisted::with(34, |config, _| {
        *config = config.clone().with_imu(SensorModel::Mpu9250);
    });
    let options = rig.options("session", 5);
    let folder = rig.bench.run(&options).good().unwrap().folder;
    let session = SessionFile::load(&folder).unwrap();
    assert_eq!(session.counts.lost(), 0);
    let setup = session.imu.unwrap().setup;
    assert_eq!(setup.sensor.model, ImuModel::Mpu9250);
    assert_eq!(setup.status.clock, ImuClock::Internal);

    let truth = Truth::from_run(rig.bench.stop().unwrap()).unwrap();
    let verdict = truth.judge(&folder).unwrap();
    near_truth(&verdict.offset_start, 30.0, 50.0);
}

#[test]
fn the_period_follows_the_phones_clock_and_every_pulse_stays_on_its_grid() {
    let mut rig = Twisted::new(17);
    rig.bench.phone_link = Some(LinkRanges::PHONE_USB);
    let mut options = rig.options("tracked", 16);
    options.track = Track::Always;
    let run = rig.bench.run(&options);
    let is_locked = |event: &SessionEvent| match event {
        SessionEvent::Tracked {
            tracked: Some(tracked),
        } => tracked.holds,
        _ => false,
    };
    assert!(run.time_of(is_locked).is_some());

    let folder = run.good().unwrap().folder;
    let session = SessionFile::load(&folder).unwrap();
    let tracking = session.tracking.unwrap();
    let alignment = session.alignment.unwrap();
    let (mut exchanges, mut periods) = ([0, 0], vec![alignment.plan.period.0 as f64]);
    for entry in Reader::open(&folder).unwrap() {
        match entry.unwrap().item {
            Item::Exchange(exchange) => {
                assert!(exchange.received_ns > exchange.sent_ns);
                exchanges[usize::from(exchange.header.frame_id != "board")] += 1;
            }
            Item::Period(step) => {
                assert!(step.grid.period.in_bounds());
                periods.push(step.grid.period.0 as f64);
            }
            _ => {}
        }
    }
    // 50 and 25 a second, of the seconds from the connection on.
    assert!(exchanges[0] > 100 && exchanges[1] > 200, "{exchanges:?}");
    assert_eq!(periods.len(), 1 + tracking.steps as usize);
    assert!(tracking.steps >= 3, "{tracking:?}");
    for step in periods.windows(2) {
        let ppm = (step[1] / step[0] - 1.0) * 1e6;
        // 0.2 ppm a second, of steps two seconds apart; a slow computer's are rarer.
        assert!(ppm.abs() <= 2.0, "{ppm}");
    }
    // Every pulse is on the grid that held then.
    let report = recording::verify::verify(&folder, &system::ReadMonitor::default()).unwrap();
    let grid = report.grid.unwrap();
    assert!(grid.checked > 300 && grid.off == 0, "{grid:?}");
}
