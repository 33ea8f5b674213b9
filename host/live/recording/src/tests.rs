//! Messages are read back exactly as they were written, also from a file that was cut.

use std::fs;
use std::time::Duration;

use proptest::prelude::*;
use protocol::{
    CaptureChannel, Edge, ImuClock, ImuFlags, ImuState, ImuStatus, Period, Status, TrainState,
    TriggerStatus,
};

use super::diagnostics::BoardCounters;
use super::reader::{Entry, Item, Reader};
use super::session_file::{SessionFile, SessionOutcome};
use super::writer::Writer;
use super::*;
use crate::profile::Profile;
use board::finding::Severity;
use board::imu::Sample;
use clock::PhoneNanos;
use clock::{ClockRelation, Wander};
use protocol::{TICK_HZ, Ticks};

fn sample(number: u64) -> Sample {
    Sample {
        at: Ticks(7 + number * 96_000),
        flags: ImuFlags(0),
        gyro: [number as f64 * 0.01, -0.5, 1e-9],
        accel: [0.1, 9.806_65, -3.0],
        temperature: 31.25,
    }
}

fn pulse(number: u64) -> protocol::Pulse {
    protocol::Pulse {
        output: protocol::Output::Camera,
        seq: 5,
        train: 2,
        number,
        at: Ticks(123_456_789 + number),
        aligned: number.is_multiple_of(2),
        readback: number.is_multiple_of(3).then_some(-4),
    }
}

fn status(at: Ticks) -> Status {
    Status {
        at,
        epoch: 9,
        connects: 1,
        cpu_permille: 34,
        stack_used: 1,
        stack_size: 2,
        trigger: TriggerStatus {
            state: TrainState::Running,
            train: 1,
            period: Period::MIN,
            width: 576,
            pulses: 3,
            next_edge: Ticks(1).into(),
            ..TriggerStatus::default()
        },
        trigger_latency: 5,
        die_decidegrees: Some(312),
        supply_mv: Some(2_930),
        imu: ImuStatus {
            state: ImuState::Running,
            clock: ImuClock::External,
            samples: 4,
            ..ImuStatus::default()
        },
        ..Status::default()
    }
}

fn clock() -> ClockRelation {
    ClockRelation {
        reference: 12.5,
        offset: 94_000.25,
        skew: -1.5e-5,
        covariance: [[1e-12, 2e-19], [2e-19, 1e-14]],
        wander: Wander(5e-8),
    }
}

#[test]
fn everything_comes_back_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = Writer::create(folder.path()).unwrap();
    writer.imu(&sample(3), 41).unwrap();
    let unusual = Sample {
        flags: ImuFlags(ImuFlags::FIRST.0 | ImuFlags::SATURATED.0),
        ..sample(4)
    };
    writer.imu(&unusual, 43).unwrap();
    writer.pulse(&pulse(6)).unwrap();
    let capture = protocol::Capture {
        seq: 1,
        channel: CaptureChannel::Strobe,
        edge: Edge::Falling,
        at: Ticks(55),
        after_loss: true,
    };
    writer.capture(&capture).unwrap();
    writer
        .status(&status(Ticks(48_000_000)), "AB", Duration::ZERO)
        .unwrap();
    writer
        .marker(Ticks(77), Some(PhoneNanos(94_000_000_000_001)), "door")
        .unwrap();
    writer
        .clock_model(Ticks(78), None, &clock(), "twist 1")
        .unwrap();
    writer
        .log(Ticks(79), Severity::Check, "imu_gap", "2 samples")
        .unwrap();
    writer.frame(Ticks(80), vec![1, 2, 255]).unwrap();
    writer.output_pulse(&pulse(7), "left").unwrap();
    let pps = protocol::Pps {
        seq: 4,
        at: Ticks(96_000_000),
        utc: 1_795_234_569,
    };
    writer.pps(&pps, "VLP-16").unwrap();
    writer.finish().unwrap();

    let mut reader = Reader::open(folder.path()).unwrap();
    let entries: Vec<_> = reader.by_ref().map(Result::unwrap).collect();
    assert!(!reader.broken_off());
    let mut items = entries.into_iter();
    let mut next = || items.next().unwrap();

    let first = next();
    let Item::Imu(imu) = &first.item else {
        panic!("{first:?}");
    };
    assert_eq!((first.at, first.sequence), (sample(3).at, 41));
    assert_eq!(imu.angular_velocity, sample(3).gyro);
    assert_eq!(imu.linear_acceleration, sample(3).accel);
    assert_eq!(imu.orientation_covariance[0], -1.0);
    assert!(matches!(next().item, Item::Temperature(value) if value.temperature == 31.25));
    let Item::ImuFlags(flags) = next().item else {
        panic!("no flags");
    };
    assert_eq!(
        [flags.late, flags.saturated, flags.first, flags.after_loss],
        [false, true, true, false]
    );
    assert_eq!(next().sequence, 43);
    assert!(matches!(next().item, Item::Temperature(_)));

    let Entry { item, sequence, .. } = next();
    let Item::Pulse(back) = item else {
        panic!("{item:?}");
    };
    assert_eq!(sequence, pulse(6).seq);
    assert_eq!((back.ticks, back.number, back.train), (123_456_795, 6, 2));
    assert_eq!((back.readback, back.readback_ticks), (true, -4));
    let Item::Capture(capture) = next().item else {
        panic!("no capture");
    };
    assert!(capture.after_loss && !capture.rising && capture.ticks == 55);
    let Item::Status(diagnostics) = next().item else {
        panic!("no status");
    };
    assert_eq!(diagnostics.status.len(), 5);
    let status = status(Ticks(48_000_000));
    assert_eq!(
        BoardCounters::from_message(&diagnostics).unwrap(),
        BoardCounters {
            epoch: status.epoch,
            dropped: status.dropped,
        }
    );
    assert!(matches!(next().item, Item::HostTime(_)));
    let Item::Marker(marker) = next().item else {
        panic!("no marker");
    };
    assert_eq!(marker.source, "door");
    assert_eq!(marker.time_ref.nanos(), 94_000_000_000_001);
    let Item::Clock(model) = next().item else {
        panic!("no clock model");
    };
    assert_eq!(model.offset_s, 94_000.25);
    assert_eq!(model.covariance, [1e-12, 2e-19, 2e-19, 1e-14]);
    assert!(matches!(next().item, Item::Log(log) if log.function == "imu_gap" && log.level == 30));
    assert!(matches!(next().item, Item::Link(frame) if frame.data == [1, 2, 255]));
    let Item::Output(output) = next().item else {
        panic!("no pulse of an output");
    };
    assert_eq!(
        (output.ticks, output.header.frame_id.as_str()),
        (pulse(7).at.0, "left")
    );
    let last = next();
    let Item::Gnss(second) = last.item else {
        panic!("no pulse per second");
    };
    assert_eq!((last.at, last.sequence), (pps.at, pps.seq));
    assert_eq!(second.time_ref.nanos(), pps.utc * 1_000_000_000);
    assert_eq!(second.source, "VLP-16");
    assert!(items.next().is_none());
}

#[test]
fn a_file_that_is_cut_anywhere_gives_all_whole_chunks() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = Writer::create(folder.path()).unwrap();
    // 40 s at 500 Hz: 80 chunks of half a second.
    for number in 0..20_000 {
        writer.imu(&sample(number), number as u32).unwrap();
    }
    // Killed: no finish. What was not flushed is gone with the process.
    let path = folder.path().join(MCAP_FILE);
    let whole = fs::read(&path).unwrap();
    std::mem::forget(writer);
    let mut most = 0;
    for cut in (0..60).map(|part| whole.len() * (part + 1) / 60) {
        fs::write(&path, &whole[..cut]).unwrap();
        let mut reader = Reader::open(&path).unwrap();
        let mut last = None;
        for (count, entry) in reader.by_ref().enumerate() {
            let entry = entry.unwrap();
            assert_eq!(entry.at, sample(count as u64 / 2).at);
            last = Some(entry.at);
        }
        let last = last.map_or(0, |at| at.0);
        assert!(last >= most);
        most = last;
    }
    // At most half a second of board time (plus one sample) is missing.
    assert!(
        sample(19_999).at.0 - most <= u64::from(TICK_HZ) / 2 + 96_000,
        "{most}"
    );
}

#[test]
fn what_waits_is_written_after_half_a_second_of_the_callers_clock() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = Writer::create(folder.path()).unwrap();
    let entries = || Reader::open(folder.path()).unwrap().count();
    let begin = Duration::from_secs(77);
    writer.tick(begin).unwrap();
    writer.imu(&sample(0), 0).unwrap();
    writer.tick(begin + Duration::from_secs(9)).unwrap();
    writer.tick(begin + Duration::from_millis(9_499)).unwrap();
    assert_eq!(entries(), 0);
    writer.tick(begin + Duration::from_millis(9_500)).unwrap();
    assert_eq!(entries(), 2);
}

#[test]
fn nothing_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let writer = Writer::create(folder.path()).unwrap();
    writer.finish().unwrap();
    let Err(error) = Writer::create(folder.path()) else {
        panic!("written twice");
    };
    assert!(!error.is_disk_full());
}

#[test]
fn the_session_file_comes_back_and_another_form_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = SessionFile::new(String::from("walk"), Profile::published().unwrap());
    session.phones[0].clock = Some(clock());
    session.save(folder.path()).unwrap();
    session.outcome = Some(SessionOutcome::Loss);
    session.save(folder.path()).unwrap();
    assert_eq!(SessionFile::load(folder.path()).unwrap(), session);
    let names: Vec<_> = fs::read_dir(folder.path()).unwrap().collect();
    assert_eq!(names.len(), 1, "{names:?}");

    let path = folder.path().join(SESSION_FILE);
    let text = fs::read_to_string(&path).unwrap();
    let form = format!("\"format\": {}", crate::session_file::FORMAT);
    fs::write(&path, text.replace(&form, "\"format\": 77")).unwrap();
    let error = SessionFile::load(folder.path()).unwrap_err().to_string();
    assert!(error.contains("found 77"), "{error}");

    // Its phones are those of its profile.
    session.phones.clear();
    session.save(folder.path()).unwrap();
    let error = SessionFile::load(folder.path()).unwrap_err().to_string();
    assert!(error.contains("its phones are []"), "{error}");
}

proptest! {
    #[test]
    fn nanoseconds_give_the_ticks_back(ticks in 0_u64..1 << 58) {
        prop_assert_eq!(ticks_of_nanos(Ticks(ticks).as_nanos()), Ticks(ticks));
    }
}
