//! A message of every kind, and of every form that it has.

use heapless::{String, Vec};
use protocol::*;

fn trigger_status() -> TriggerStatus {
    TriggerStatus {
        state: TrainState::Slewing,
        train: 3,
        period: Period::from_picos(33_330_652_540).unwrap(),
        width: 576,
        pulses: 123_456,
        next_edge: Ticks(0x0123_4567_89AB),
        next_fraction: 0xFEDC_BA98,
        late: 0,
        readback: Readback {
            seen: 99,
            missing: 1,
            stray: 2,
            delay: Some(-3),
        },
    }
}

pub(super) fn imu_status(last_fault: Option<ImuFault>) -> ImuStatus {
    ImuStatus {
        state: ImuState::Running,
        clock: ImuClock::External,
        samples: 300_000,
        late: 1,
        overcaptures: 2,
        recoveries: 3,
        last_fault,
    }
}

fn imu_config() -> ImuConfig {
    ImuConfig {
        divider: 1,
        low_pass: LowPass::Hz188,
        gyro_range: GyroRange::Dps500,
        accel_range: AccelRange::G4,
    }
}

fn imu_setup(config: ImuConfig, status: ImuStatus) -> ImuSetup {
    ImuSetup {
        config,
        interval: 96_000,
        gyro_lsb_per_dps_times_10: config.gyro_range.lsb_per_dps_times_10(),
        accel_lsb_per_g: config.accel_range.lsb_per_g(),
        gyro_delay_us: config.low_pass.gyro_delay_us(),
        accel_delay_us: config.low_pass.accel_delay_us(),
        status,
        sensor: ImuSensor {
            model: ImuModel::Icm42688P,
            gyro_bandwidth_hz_times_10: 2_467,
            gyro_noise_udps: 2_800,
            accel_noise_ug: 70,
            temperature_lsb_per_c_times_100: 13_248,
            temperature_at_zero_centidegrees: -2_500,
        },
    }
}

pub(super) fn hello(reset_cause: ResetCause, last_panic: Option<&str>) -> Hello {
    Hello {
        protocol_version: PROTOCOL_VERSION,
        firmware_version: (1, 2, 3),
        git_revision: String::try_from("0123456789ab").unwrap(),
        git_dirty: true,
        board_id: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12],
        tick_hz: TICK_HZ,
        now: Ticks(48_000_001),
        epoch: 0xDEAD_BEEF,
        reset_cause,
        last_panic: last_panic.map(|text| String::try_from(text).unwrap()),
        board: BoardModel::Discovery,
        panics: last_panic.map_or(0, |_| 300),
        kept_panic: last_panic.map(|text| String::try_from(text).unwrap()),
    }
}

fn board_settings(crystal_ppb: Option<i32>) -> BoardSettings {
    BoardSettings {
        output_start_delay: 2,
        input_delay: 11,
        crystal_ppb,
    }
}

fn gnss_settings() -> GnssSettings {
    GnssSettings {
        utc_at_zero: 1_795_234_567,
        baud: Baud::B9600,
        line_inverted: true,
        sentences: Sentences::Rmc,
        delay_ms: 50,
        pulse_width: TICK_HZ / 50,
        pulse_inverted: false,
    }
}

fn gnss_status() -> GnssStatus {
    GnssStatus {
        state: TrainState::Running,
        pulses: 3_600,
        sentences: 3_599,
        missed: 1,
        late: 0,
    }
}

fn handlers() -> Handlers {
    let handler = |n: u32| HandlerTime {
        calls: 100 * n,
        cycles: 130_000 * n,
        worst: 3_000 * n,
    };
    Handlers {
        trigger: handler(1),
        outputs: handler(2),
        handover: handler(3),
        usb: handler(4),
    }
}

pub(super) fn status() -> Status {
    Status {
        seq: 60,
        at: Ticks(2_880_000_000),
        epoch: 7,
        dropped: Dropped {
            answers: 1,
            pulses: 2,
            captures: 3,
            imu: 4,
            status: 5,
            outputs: 15,
        },
        link: LinkCounters {
            frames: 6,
            lost_frames: 7,
            lost_bytes: 11,
        },
        connects: 12,
        cpu_permille: 55,
        stack_used: 4_096,
        stack_size: 110_000,
        trigger: trigger_status(),
        trigger_latency: 120,
        handlers: handlers(),
        masked: Masked {
            all: 480,
            below_trigger: 9_600,
        },
        die_decidegrees: Some(-123),
        supply_mv: Some(2_930),
        usb: UsbCounters {
            resets: 2,
            suspends: 1,
            stuck: 3,
        },
        resets: [1, 0, 2, 3, 0, 0],
        strobe_overcaptures: 13,
        strobe_floods: 14,
        imu: imu_status(None),
        outputs: [
            TrainState::Stopped,
            TrainState::Waiting,
            TrainState::Running,
        ]
        .map(|state| OutputStatus {
            state,
            train: 2,
            pulses: 108_000,
            late: 1,
        }),
        output_latency: 400,
        gnss: gnss_status(),
    }
}

/// Every command, and every value of every enum in them.
pub(super) fn commands() -> std::vec::Vec<(std::string::String, HostToDevice)> {
    let period = Period::from_picos(33_333_333_330).unwrap();
    let start = TriggerStart {
        period,
        width: 576,
        first_edge: Some(Ticks(96_000_000)),
        first_fraction: 0x8000_0001,
    };
    let soon = TriggerStart {
        period: Period::MIN,
        width: MIN_PULSE_WIDTH,
        first_edge: None,
        first_fraction: 0,
    };
    let to = TriggerAlign {
        anchor: Ticks(1_234_567_890_123),
        anchor_fraction: 7,
        period,
        slew: 1_600,
    };
    let output = Output::Camera;
    let ping = Ping {
        host_time: 0x8877_6655_4433_2211,
    };
    let camera_at = StartTrigger { output, start };
    let camera_soon = StartTrigger {
        output,
        start: soon,
    };
    let (two, period) = (Output::Two, Period::MAX);
    let mut commands: std::vec::Vec<(std::string::String, Command)> = vec![
        ("hello".to_owned(), SayHello.into()),
        ("ping".to_owned(), ping.into()),
        ("trigger-start-at".to_owned(), camera_at.into()),
        ("trigger-start-soon".to_owned(), camera_soon.into()),
        (
            "trigger-start-2".to_owned(),
            StartTrigger { output: two, start }.into(),
        ),
        (
            "trigger-align".to_owned(),
            AlignTrigger { output, to }.into(),
        ),
        (
            "trigger-align-2".to_owned(),
            AlignTrigger { output: two, to }.into(),
        ),
        (
            "trigger-period".to_owned(),
            SetPeriod { output, period }.into(),
        ),
        ("trigger-stop".to_owned(), StopTrigger(Output::Three).into()),
        ("imu-query".to_owned(), QueryImu.into()),
        ("filler".to_owned(), SendFiller(true).into()),
    ];
    for output in Output::ALL {
        let name = format!("trigger-query-{}", output.number());
        commands.push((name, QueryTrigger(output).into()));
    }
    let mut configure = |name: std::string::String, config| {
        commands.push((format!("imu-configure-{name}"), ConfigureImu(config).into()));
    };
    for low_pass in [
        LowPass::Hz188,
        LowPass::Hz98,
        LowPass::Hz42,
        LowPass::Hz20,
        LowPass::Hz10,
        LowPass::Hz5,
    ] {
        let config = ImuConfig {
            low_pass,
            ..imu_config()
        };
        configure(format!("{low_pass:?}"), config);
    }
    for gyro_range in [
        GyroRange::Dps250,
        GyroRange::Dps500,
        GyroRange::Dps1000,
        GyroRange::Dps2000,
    ] {
        let config = ImuConfig {
            gyro_range,
            ..imu_config()
        };
        configure(format!("{gyro_range:?}"), config);
    }
    for accel_range in [
        AccelRange::G2,
        AccelRange::G4,
        AccelRange::G8,
        AccelRange::G16,
    ] {
        let config = ImuConfig {
            accel_range,
            ..imu_config()
        };
        configure(format!("{accel_range:?}"), config);
    }
    for failure in [
        Failure::Panic,
        Failure::Hang,
        Failure::HardFault,
        Failure::Stall,
        Failure::SlowHandler,
        Failure::StackOverflow,
        Failure::LeaveBus,
    ] {
        let key = SELF_TEST_KEY;
        let name = format!("self-test-{failure:?}");
        commands.push((name, SelfTest { key, failure }.into()));
    }
    for baud in Baud::ALL {
        let settings = GnssSettings {
            baud,
            ..gnss_settings()
        };
        let name = format!("gnss-start-{}", baud.hz());
        commands.push((name, StartGnss(settings).into()));
    }
    let zda = GnssSettings {
        sentences: Sentences::RmcZda,
        line_inverted: false,
        pulse_inverted: true,
        ..gnss_settings()
    };
    commands.push(("gnss-start-zda".to_owned(), StartGnss(zda).into()));
    commands.push(("gnss-stop".to_owned(), StopGnss.into()));
    commands.push(("gnss-query".to_owned(), QueryGnss.into()));
    let settings = SetBoard(board_settings(Some(-12_345)));
    commands.push(("board-set".to_owned(), settings.into()));
    commands.push(("board-query".to_owned(), QueryBoard.into()));
    commands.push(("restart-into-rom".to_owned(), RestartIntoRom.into()));
    // A new command does not compile here until it has its golden bytes above.
    let known = |command: &Command| match command {
        Command::SayHello(_)
        | Command::Ping(_)
        | Command::StartTrigger(_)
        | Command::AlignTrigger(_)
        | Command::SetPeriod(_)
        | Command::StopTrigger(_)
        | Command::QueryTrigger(_)
        | Command::ConfigureImu(_)
        | Command::QueryImu(_)
        | Command::SendFiller(_)
        | Command::SelfTest(_)
        | Command::StartGnss(_)
        | Command::StopGnss(_)
        | Command::QueryGnss(_)
        | Command::QueryBoard(_)
        | Command::SetBoard(_)
        | Command::RestartIntoRom(_) => true,
    };
    commands
        .into_iter()
        .inspect(|(_, command)| assert!(known(command)))
        .map(|(name, command)| (name, HostToDevice { id: 300, command }))
        .collect()
}

/// Every message of the board, and every value of every enum in them.
pub(super) fn messages() -> std::vec::Vec<(std::string::String, DeviceToHost)> {
    let mut messages = Vec::<(std::string::String, DeviceToHost), 100>::new();
    let mut add = |name: std::string::String, message| messages.push((name, message)).unwrap();
    for cause in [
        ResetCause::PowerOn,
        ResetCause::BrownOut,
        ResetCause::Pin,
        ResetCause::Software,
        ResetCause::Watchdog,
        ResetCause::Unknown,
    ] {
        add(
            format!("hello-{cause:?}"),
            DeviceToHost::Hello(hello(cause, None)),
        );
    }
    let other = Hello {
        board: BoardModel::BlackPill,
        ..hello(ResetCause::PowerOn, None)
    };
    add("hello-black-pill".to_owned(), DeviceToHost::Hello(other));
    let panic = Some("src/main.rs:1: it fell");
    add(
        "hello-panic".to_owned(),
        DeviceToHost::Hello(hello(ResetCause::Software, panic)),
    );

    let pong = Pong {
        host_time: 5,
        received: Ticks(1_000),
        sent: Ticks(1_100),
    };
    let plan = AlignPlan {
        shift: TickDelta(-777),
        frames: 8,
        arrival_pulse: 1_008,
        arrival: Ticks(9_999_999_999),
    };
    let imu = imu_setup(imu_config(), imu_status(None));
    let imu_of = |model| {
        let sensor = ImuSensor {
            model,
            ..imu.sensor
        };
        QueryImu::wrap(ImuSetup { sensor, ..imu })
    };
    let gnss = GnssReport {
        settings: Some(gnss_settings()),
        status: gnss_status(),
    };
    let gnss_off = GnssReport {
        settings: None,
        status: gnss_status(),
    };
    let replies = [
        ("hello", SayHello::wrap(())),
        ("pong", Ping::wrap(pong)),
        ("trigger-start", StartTrigger::wrap(trigger_status())),
        ("trigger-align", AlignTrigger::wrap(plan)),
        ("trigger-period", SetPeriod::wrap(trigger_status())),
        ("trigger-stop", StopTrigger::wrap(trigger_status())),
        ("trigger-query", QueryTrigger::wrap(trigger_status())),
        ("imu-configure", ConfigureImu::wrap(imu)),
        ("imu-query", QueryImu::wrap(imu)),
        ("imu-unknown", imu_of(ImuModel::Unknown)),
        ("imu-mpu-6050", imu_of(ImuModel::Mpu6050)),
        ("imu-mpu-6500", imu_of(ImuModel::Mpu6500)),
        ("imu-mpu-9250", imu_of(ImuModel::Mpu9250)),
        ("gnss-start", StartGnss::wrap(gnss)),
        ("gnss-stop", StopGnss::wrap(gnss_off)),
        ("gnss-query", QueryGnss::wrap(gnss)),
        ("filler", SendFiller::wrap(())),
        ("self-test", SelfTest::wrap(())),
        ("board-set", SetBoard::wrap(board_settings(None))),
        (
            "board-query",
            QueryBoard::wrap(board_settings(Some(30_000))),
        ),
        ("restart-into-rom", RestartIntoRom::wrap(())),
    ];
    for (name, reply) in replies {
        let result = Ok(reply);
        add(
            format!("answer-{name}"),
            DeviceToHost::Answer(Answer { id: 1, result }),
        );
    }
    let refusals = [
        Refusal::PeriodOutOfRange,
        Refusal::WidthOutOfRange {
            min: MIN_PULSE_WIDTH,
            max: 47_760,
        },
        Refusal::TimeOutOfRange { now: Ticks(42) },
        Refusal::SlewOutOfRange { max: 800_000 },
        Refusal::TriggerStopped,
        Refusal::TriggerRunning,
        Refusal::AlignInProgress,
        Refusal::ImuSettingOutOfRange,
        Refusal::WrongKey,
        Refusal::GnssRunning,
        Refusal::GnssStopping,
        Refusal::GnssDateOutOfRange,
        Refusal::GnssWindowExceeded { ends_us: 512_000 },
        Refusal::NotOnThisBoard,
        Refusal::OutputRunning,
        Refusal::BoardSettingOutOfRange,
        Refusal::NotKept,
    ];
    for (number, refusal) in refusals.into_iter().enumerate() {
        let result = Err(refusal);
        add(
            format!("refusal-{number}"),
            DeviceToHost::Answer(Answer {
                id: u32::MAX,
                result,
            }),
        );
    }
    for (number, state) in [
        TrainState::Stopped,
        TrainState::Waiting,
        TrainState::Running,
    ]
    .into_iter()
    .enumerate()
    {
        let reply = QueryTrigger::wrap(TriggerStatus {
            state,
            ..trigger_status()
        });
        let result = Ok(reply);
        add(
            format!("train-{number}"),
            DeviceToHost::Answer(Answer { id: 2, result }),
        );
    }

    add("status".to_owned(), DeviceToHost::Status(status()));
    for (number, fault) in [
        ImuFault::NoAcknowledge { register: 0x3B },
        ImuFault::BusHeld,
        ImuFault::Timeout { register: 0x6B },
        ImuFault::Bus { register: 0x75 },
        ImuFault::WrongIdentity { found: 0x71 },
        ImuFault::Readback {
            register: 0x1B,
            wrote: 8,
            read: 0,
        },
        ImuFault::NoDataReady,
        ImuFault::NoSuchSetting,
    ]
    .into_iter()
    .enumerate()
    {
        let imu = imu_status(Some(fault));
        add(
            format!("status-imu-fault-{number}"),
            DeviceToHost::Status(Status { imu, ..status() }),
        );
    }
    for (state, clock) in [
        (ImuState::Starting, ImuClock::Unknown),
        (ImuState::Failed, ImuClock::Internal),
    ] {
        let imu = ImuStatus {
            state,
            clock,
            ..imu_status(None)
        };
        add(
            format!("status-imu-{state:?}"),
            DeviceToHost::Status(Status { imu, ..status() }),
        );
    }

    for readback in [None, Some(2)] {
        add(
            format!("pulse-{}", readback.map_or("alone", |_| "read-back")),
            DeviceToHost::Pulse(Pulse {
                output: Output::Camera,
                seq: 5,
                train: 1,
                number: 1_000_000,
                at: Ticks(1_599_871_321_920),
                aligned: readback.is_some(),
                readback,
            }),
        );
    }
    add(
        "arrived".to_owned(),
        DeviceToHost::Arrived(Arrived {
            output: Output::Camera,
            command: 17,
            train: 1,
            pulse: 1_008,
            at: Ticks(9_999_999_999),
            remaining: TickDelta::ZERO,
        }),
    );
    for edge in [Edge::Rising, Edge::Falling] {
        add(
            format!("capture-{edge:?}"),
            DeviceToHost::Capture(Capture {
                seq: 8,
                channel: CaptureChannel::Strobe,
                edge,
                at: Ticks(123_456_789),
                after_loss: edge == Edge::Rising,
            }),
        );
    }
    add(
        "imu".to_owned(),
        DeviceToHost::Imu(ImuSample {
            seq: 1_000,
            at: Ticks(96_000_000),
            flags: ImuFlags::LATE.with(ImuFlags::SATURATED),
            accel: [i16::MIN, -1, 8_192],
            temperature: -521,
            gyro: [i16::MAX, 0, 655],
        }),
    );
    add(
        "filler".to_owned(),
        DeviceToHost::Filler(Filler {
            seq: 2,
            payload: (2..10).collect(),
        }),
    );
    for output in Output::AUXILIARY {
        add(
            format!("pulse-{}", output.number()),
            DeviceToHost::Pulse(Pulse {
                output,
                seq: 6,
                train: 2,
                number: 108_000,
                at: Ticks(9_599_999_999),
                aligned: true,
                readback: None,
            }),
        );
    }
    add(
        "arrived-3".to_owned(),
        DeviceToHost::Arrived(Arrived {
            output: Output::Three,
            command: 18,
            train: 2,
            pulse: 200,
            at: Ticks(9_599_999_999),
            remaining: TickDelta::ZERO,
        }),
    );
    add(
        "pps".to_owned(),
        DeviceToHost::Pps(Pps {
            seq: 9,
            at: Ticks(480_000_000),
            utc: 1_795_234_577,
        }),
    );
    // A new message does not compile here until it has its golden bytes above.
    for (_, message) in &messages {
        match message {
            DeviceToHost::Hello(_)
            | DeviceToHost::Answer(_)
            | DeviceToHost::Status(_)
            | DeviceToHost::Pulse(_)
            | DeviceToHost::Arrived(_)
            | DeviceToHost::Capture(_)
            | DeviceToHost::Imu(_)
            | DeviceToHost::Filler(_)
            | DeviceToHost::Pps(_) => {}
        }
    }
    messages.into_iter().collect()
}
