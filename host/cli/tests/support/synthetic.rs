//! A recording as the program writes it, of a board that is not there: messages numbered as
//! the board does, pulses on their grid, a session file.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, dead_code)]

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use board::finding::Severity;
use board::imu::Sample;
use protocol::{
    Dropped, EdgeGrid, ImuClock, ImuFlags, ImuState, ImuStatus, Output, Period, Pulse, Status,
    TICK_HZ, Ticks, TrainState, TriggerStatus,
};
use recording::messages::{ClockExchange, Header};
use recording::profile::Profile;
use recording::session_file::{Marker, SessionFile};
use recording::writer::Writer;

use super::session;

/// Length in seconds.
pub(crate) const SECONDS: u64 = 6;
const PERIOD: Period = Period((1_599_873 << 32) + 0x1234_5678);
const ANCHOR: Ticks = Ticks(48_000_777);

/// Faults to put into a recording.
#[derive(Clone, Copy, Default)]
pub(crate) struct Wrong {
    /// This IMU sample never comes.
    pub(crate) sample_lost: Option<u64>,
    /// The board says that it dropped it.
    pub(crate) board_knows: bool,
    /// This pulse comes this much late.
    pub(crate) pulse_late: Option<(u64, u64)>,
    /// Before this IMU sample two intervals pass, and it has these flags.
    pub(crate) imu_silence: Option<(u64, ImuFlags)>,
    /// There is an auxiliary output, and these of its pulses never come.
    pub(crate) outputs_lost: &'static [u64],
    /// Not wrong: there is a message on every topic that a session writes, and a depth recording.
    pub(crate) every_topic: bool,
}

fn status(seq: u32, at: Ticks, samples: u32, pulses: u64, dropped: u32) -> Status {
    Status {
        seq,
        at,
        epoch: 9,
        dropped: Dropped {
            imu: dropped,
            ..Dropped::default()
        },
        connects: 1,
        cpu_permille: 34,
        stack_used: 1,
        stack_size: 2,
        trigger: TriggerStatus {
            state: TrainState::Running,
            train: 1,
            period: PERIOD,
            width: 576,
            pulses,
            next_edge: Ticks(1).into(),
            ..TriggerStatus::default()
        },
        trigger_latency: 5,
        imu: ImuStatus {
            state: ImuState::Running,
            clock: ImuClock::External,
            samples,
            ..ImuStatus::default()
        },
        ..Status::default()
    }
}

pub(crate) fn session() -> SessionFile {
    let profile = Profile::published().unwrap();
    let mut clock = session::clock(12.5, 94_000.25, -1.5e-5, 1e-6);
    clock.covariance[0][1] = 2e-19;
    clock.covariance[1][0] = 2e-19;
    let frame_period_ns = 33_330_652.0;
    session::session(profile, clock, (ANCHOR, PERIOD), frame_period_ns, SECONDS)
}

/// Writes messages on the topics that have none yet.
fn write_rest(writer: &mut Writer, session: &mut SessionFile) {
    let end = Ticks(ANCHOR.0 + SECONDS * u64::from(TICK_HZ));
    let clock = session.alignment.unwrap().plan.clock;
    writer.clock_model(end, None, &clock, "twist 1").unwrap();
    session.phones[0].clock = Some(clock);
    let label = String::from("door");
    writer.marker(end, None, &label).unwrap();
    session.markers.push(Marker { at: end, label });
    writer
        .log(end, Severity::Good, "recording", "for 6 s")
        .unwrap();
    let exchange = ClockExchange {
        header: Header::default(),
        sent_ns: 1,
        received_ns: 5,
        clock_ns: 3,
        monotonic_ns: 0,
    };
    writer.exchange(end, "board", exchange).unwrap();
    for second in 0..SECONDS {
        let at = Ticks(ANCHOR.0 + second * u64::from(TICK_HZ));
        let seq = second as u32;
        let utc = 1_800_000_000 + second as i64;
        writer
            .pps(&protocol::Pps { seq, at, utc }, "VLP-16")
            .unwrap();
        let pulse = Pulse {
            output: Output::Two,
            seq,
            train: 1,
            number: second,
            at,
            ..Pulse::default()
        };
        writer.output_pulse(&pulse, "left").unwrap();
    }
    writer.frame(end, vec![1, 2, 255]).unwrap();
}

/// Writes a recording into `parent/walk`.
pub(crate) fn make(parent: &Path, wrong: Wrong) -> PathBuf {
    let folder = parent.join("walk");
    fs::create_dir(&folder).unwrap();
    let mut writer = Writer::create(&folder).unwrap();
    // All events in the order of their times.
    let mut events: Vec<(u64, u8, u64)> = Vec::new();
    for number in 0..SECONDS * 500 {
        let late = wrong.imu_silence.is_some_and(|(from, _)| number >= from);
        let steps = number + u64::from(late);
        events.push((ANCHOR.0 + 5_000 + steps * 96_000, 0, number));
    }
    let grid = EdgeGrid::new(ANCHOR, PERIOD);
    for number in 0..SECONDS * 30 {
        let mut at = grid.edge(number as i64).ticks.0;
        if let Some((late, by)) = wrong.pulse_late
            && late == number
        {
            at += by;
        }
        events.push((at, 1, number));
    }
    for number in 0..=SECONDS {
        events.push((ANCHOR.0 + 9_999 + number * u64::from(TICK_HZ), 2, number));
    }
    events.push((ANCHOR.0 + 77_777_777, 3, 0));
    if !wrong.outputs_lost.is_empty() {
        events.extend((0..SECONDS).map(|n| (ANCHOR.0 + 333 + n * u64::from(TICK_HZ), 4, n)));
    }
    events.sort_unstable();
    let (mut samples, mut pulses) = (0_u32, 0_u64);
    for (at, kind, number) in events {
        let at = Ticks(at);
        match kind {
            0 => {
                samples += 1;
                if wrong.sample_lost == Some(number) {
                    continue;
                }
                let sample = Sample {
                    at,
                    flags: match wrong.imu_silence {
                        Some((first, flags)) if first == number => flags,
                        _ => ImuFlags(0),
                    },
                    gyro: [(number % 600) as f64 * 1e-3, 0.1, 0.2],
                    accel: [0.0, 0.0, 9.8],
                    temperature: 31.0,
                };
                writer.imu(&sample, number as u32).unwrap();
            }
            1 => {
                pulses += 1;
                let pulse = Pulse {
                    output: Output::Camera,
                    seq: number as u32,
                    train: 1,
                    number,
                    at,
                    aligned: true,
                    readback: Some(4),
                };
                writer.pulse(&pulse).unwrap();
            }
            2 => {
                let lost = wrong
                    .sample_lost
                    .is_some_and(|lost| wrong.board_knows && u64::from(samples) > lost);
                let status = status(number as u32, at, samples, pulses, lost.into());
                writer.status(&status, "AB", Duration::ZERO).unwrap();
            }
            4 if wrong.outputs_lost.contains(&number) => {}
            4 => {
                let pulse = Pulse {
                    output: Output::Two,
                    seq: number as u32,
                    train: 1,
                    number,
                    at,
                    ..Pulse::default()
                };
                writer.output_pulse(&pulse, "left").unwrap();
            }
            _ => {
                let capture = protocol::Capture {
                    at,
                    ..protocol::Capture::default()
                };
                writer.capture(&capture).unwrap();
            }
        }
    }
    let mut session = session();
    if wrong.every_topic {
        write_rest(&mut writer, &mut session);
        fs::write(folder.join("depth.mkv"), "no pictures").unwrap();
    }
    let topics = writer.finish().unwrap();
    fs::write(folder.join("twist_1_phone_gyro.csv"), "0,0,0,1\n").unwrap();
    session.files.push(String::from("twist_1_phone_gyro.csv"));
    session::close(&mut session, topics, &folder);
    folder
}
