//! `board trigger` and `board imu` as a process against a stand-in: exact units on the way
//! to the board, losses on the way back, files in SI units.
#![cfg(unix)]

use std::sync::mpsc::{Receiver, Sender, channel};

use crate::support::{Behaviour, StandIn, code, polite, run_line};
use protocol::{
    AlignPlan, AlignTrigger, Answer, Command, ConfigureImu, DeviceToHost, EdgeTime, HostToDevice,
    ImuFlags, ImuSample, ImuSensor, ImuSetup, ImuState, ImuStatus, Output, Period, Ping, Pong,
    QueryImu, QueryTrigger, Readback, Refusal, Reply, Request, StartTrigger, TickDelta, Ticks,
    TrainState, TriggerStatus,
};
use serde_json::Value;
use test_support::board::{frame, imu_setup};
use test_support::processes::Ran;

fn with_port(board: &StandIn, line: &str) -> Ran {
    run_line(&format!("{line} --port {}", board.path))
}

fn answer(id: u32, result: Result<Reply, Refusal>) -> Vec<u8> {
    frame(&DeviceToHost::Answer(Answer { id, result }))
}

fn status(period: Period, width: u32) -> TriggerStatus {
    TriggerStatus {
        state: TrainState::Running,
        train: 1,
        period,
        width,
        pulses: 10,
        next_edge: EdgeTime {
            ticks: Ticks(100),
            fraction: 1 << 31,
        },
        late: 0,
        readback: Readback {
            seen: 10,
            delay: Some(2),
            ..Readback::default()
        },
    }
}

/// Answers the trigger's commands and tells the test what it was sent.
struct TriggerStandIn {
    commands: Sender<Command>,
    result: fn(&Command) -> Result<Reply, Refusal>,
}

impl Behaviour for TriggerStandIn {
    fn command(&mut self, command: HostToDevice) -> Vec<u8> {
        if matches!(command.command, Command::SayHello(_)) {
            return polite(command);
        }
        self.commands.send(command.command.clone()).unwrap();
        answer(command.id, (self.result)(&command.command))
    }
}

fn trigger(result: fn(&Command) -> Result<Reply, Refusal>) -> (StandIn, Receiver<Command>) {
    let (commands, received) = channel();
    (StandIn::new(TriggerStandIn { commands, result }), received)
}

#[test]
fn a_period_in_microseconds_reaches_the_board() {
    let (board, received) = trigger(|command| match command {
        Command::StartTrigger(StartTrigger { start, .. }) => {
            Ok(StartTrigger::wrap(status(start.period, start.width)))
        }
        _ => Err(Refusal::TriggerStopped),
    });
    let train = "start --period 33330.65254us --width 12.5us --first-edge 4800000000";
    let done = with_port(&board, &format!("board trigger --json {train}"));
    assert_eq!(code(&done), 0, "{done:?}");
    let Command::StartTrigger(StartTrigger { output, start }) = received.recv().unwrap() else {
        panic!("another command");
    };
    assert_eq!(output, Output::Camera);
    let exact = Period::from_picos(33_330_652_540).unwrap();
    assert!(start.period.0.abs_diff(exact.0) <= 2, "{:?}", start.period);
    assert_eq!(start.width, 600);
    assert_eq!(start.first_edge, Some(Ticks(4_800_000_000).into()));
    let report = done.json();
    assert_eq!(report["period_ns"], "33330652.540");
    assert_eq!(report["period_ticks"], 1_599_871);
    assert_eq!(report["next_edge_fraction"], 1_u32 << 31);
    assert_eq!(report["width_us"], 12.5);
    assert_eq!(
        (&report["period"], &report["width"]),
        (&Value::Null, &Value::Null)
    );
    assert_eq!(report["readback_state"], "ok");
    assert_eq!(report["readback"]["delay"], 2);
}

#[test]
fn an_align_keeps_the_period_unless_told() {
    let (board, received) = trigger(|command| match command {
        Command::QueryTrigger(_) => Ok(QueryTrigger::wrap(status(
            Period(0x1234_5678_9ABC_DEF0 >> 8),
            576,
        ))),
        Command::AlignTrigger(_) => Ok(AlignTrigger::wrap(AlignPlan {
            shift: TickDelta(-480),
            frames: 3,
            arrival_pulse: 44,
            arrival: Ticks(48_000_000 * 92),
        })),
        _ => Err(Refusal::TriggerStopped),
    });
    let align = "board trigger align --anchor 4416000000 --slew 10us --json";
    let output = with_port(&board, align);
    assert_eq!(code(&output), 0, "{output:?}");
    assert_eq!(
        received.recv().unwrap(),
        QueryTrigger(Output::Camera).into()
    );
    let Command::AlignTrigger(AlignTrigger { to: align, .. }) = received.recv().unwrap() else {
        panic!("another command");
    };
    assert_eq!(align.anchor, Ticks(4_416_000_000));
    assert_eq!(align.period, Period(0x1234_5678_9ABC_DEF0 >> 8));
    assert_eq!(align.slew, 480);
    let report = output.json();
    assert_eq!(report["shift"], -480);
    assert_eq!(report["arrival_pulse"], 44);
}

/// Streams IMU samples at 500 Hz, a hundred at a time, with one missing; says that it sets
/// the sensor up until so many were sent.
#[derive(Default)]
struct ImuStandIn {
    next: u32,
    missing: Option<u32>,
    starting: u32,
}

impl ImuStandIn {
    /// Board time of the next sample.
    fn now(&self) -> Ticks {
        Ticks(48_000_000 * 91 + u64::from(self.next) * 96_000)
    }

    fn setup(&self) -> ImuSetup {
        let setup = imu_setup();
        ImuSetup {
            gyro_delay_us: 1_900,
            accel_delay_us: 2_000,
            status: ImuStatus {
                samples: self.next,
                state: if self.next < self.starting {
                    ImuState::Starting
                } else {
                    ImuState::Running
                },
                ..setup.status
            },
            sensor: ImuSensor::MPU_9150,
            ..setup
        }
    }
}

impl Behaviour for ImuStandIn {
    fn command(&mut self, command: HostToDevice) -> Vec<u8> {
        match command.command {
            Command::QueryImu(_) => answer(command.id, Ok(QueryImu::wrap(self.setup()))),
            Command::ConfigureImu(_) => answer(command.id, Ok(ConfigureImu::wrap(self.setup()))),
            Command::Ping(ping) => {
                let pong = Pong {
                    host_time: ping.host_time,
                    received: self.now(),
                    sent: self.now(),
                };
                answer(command.id, Ok(Ping::wrap(pong)))
            }
            _ => polite(command),
        }
    }

    fn tick(&mut self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for _ in 0..20 {
            let (seq, at) = (self.next, self.now());
            self.next += 1;
            if self.missing == Some(seq) {
                continue;
            }
            bytes.extend(frame(&DeviceToHost::Imu(ImuSample {
                seq,
                at,
                flags: ImuFlags(0),
                accel: [0, 0, 8_192],
                temperature: -3_400,
                gyro: [655, if seq.is_multiple_of(2) { 1 } else { -1 }, 0],
            })));
        }
        bytes
    }
}

#[test]
fn imu_reports_si_units_and_tells_a_loss() {
    let board = StandIn::new(ImuStandIn::default());
    let output = with_port(&board, "board imu --duration 1s --json");
    assert_eq!(code(&output), 0, "{output:?}");
    let report = output.json();
    assert_eq!(report["samples"], 500);
    assert_eq!(report["missed"], 0);
    assert_eq!(report["rate_hz"], 500.0);
    assert_eq!(report["interval_jitter_ticks"], 0.0);
    assert_eq!(report["temperature_c"], 25.0);
    let gyro_x = report["gyro_mean_rad_s"][0].as_f64().unwrap();
    assert!((gyro_x - 10_f64.to_radians()).abs() < 1e-9);
    let accel_z = report["accel_mean_m_s2"][2].as_f64().unwrap();
    assert!((accel_z - 9.806_65).abs() < 1e-9);

    let output = with_port(&board, "board imu --duration 1s");
    assert_eq!(code(&output), 0, "{output:?}");

    let board = StandIn::new(ImuStandIn {
        missing: Some(4_000),
        ..ImuStandIn::default()
    });
    let output = with_port(&board, "board imu --duration 9s --json");
    assert_eq!(code(&output), 4, "{output:?}");
    let report = output.json();
    assert_eq!(report["missed"], 1);
    assert_eq!(report["interval_max_ticks"], 96_000);
}

/// As after power-on, or after another setting.
#[test]
fn doctor_looks_again_at_a_sensor_that_is_set_up() {
    for (starting, severity) in [(600, "good"), (u32::MAX, "bad")] {
        let board = StandIn::new(ImuStandIn {
            starting,
            ..ImuStandIn::default()
        });
        let output = with_port(&board, "doctor --no-phone --no-trigger --json");
        let report = output.json();
        let mut checks = report["checks"].as_array().unwrap().iter();
        let imu = checks.find(|check| check["kind"] == "IMU").unwrap();
        assert_eq!(imu["severity"], severity, "{imu}");
    }
}
