//! The bytes of every message, pinned.
//!
//! `tests/golden.txt` holds one frame a line: a name, and the frame in hex, with
//! its delimiter. A change there is a change of the wire format and needs a new
//! `PROTOCOL_VERSION`. After such a change, `BLESS=1 cargo test -p
//! smartdepthsync-protocol --test golden` writes the file anew, and
//! `docs/protocol.md` has to be brought up to date with it: that page names the
//! checksum of the file.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fmt::Write;
use std::path::PathBuf;

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

fn imu_status(last_fault: Option<ImuFault>) -> ImuStatus {
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

fn hello(reset_cause: ResetCause, last_panic: Option<&str>) -> Hello {
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

fn status() -> Status {
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
            oversize: 7,
            cobs: 8,
            checksum: 9,
            message: 10,
            lost_bytes: 11,
        },
        connects: 12,
        cpu_permille: 55,
        stack_used: 4_096,
        stack_size: 110_000,
        trigger: trigger_status(),
        trigger_latency: 120,
        handlers: handlers(),
        die_decidegrees: Some(-123),
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
fn commands() -> std::vec::Vec<(std::string::String, HostToDevice)> {
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
    let filler = SendFiller {
        bytes_per_second: u32::MAX,
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
        ("filler".to_owned(), filler.into()),
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
        | Command::QueryGnss(_) => true,
    };
    commands
        .into_iter()
        .inspect(|(_, command)| assert!(known(command)))
        .map(|(name, command)| (name, HostToDevice { id: 300, command }))
        .collect()
}

/// Every message of the board, and every value of every enum in them.
fn messages() -> std::vec::Vec<(std::string::String, DeviceToHost)> {
    let mut messages = Vec::<(std::string::String, DeviceToHost), 100>::new();
    let mut add = |name: std::string::String, message| messages.push((name, message)).unwrap();
    for cause in [
        ResetCause::PowerOn,
        ResetCause::BrownOut,
        ResetCause::Pin,
        ResetCause::Software,
        ResetCause::Watchdog,
        ResetCause::WindowWatchdog,
        ResetCause::LowPower,
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
    for output in Output::FURTHER {
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

fn hex(bytes: &[u8]) -> std::string::String {
    bytes
        .iter()
        .fold(std::string::String::new(), |mut text, byte| {
            write!(text, "{byte:02x}").unwrap();
            text
        })
}

fn bytes(hex: &str) -> std::vec::Vec<u8> {
    let digits = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
    (0..hex.len()).step_by(2).map(digits).collect()
}

fn golden() -> std::string::String {
    let mut text = format!("protocol-version {PROTOCOL_VERSION}\n");
    let mut buffer = [0; MAX_FRAME];
    for (name, command) in commands() {
        let frame = encode(&command, &mut buffer).unwrap();
        writeln!(text, "to-device/{name} {}", hex(frame)).unwrap();
    }
    for (name, message) in messages() {
        let frame = encode(&message, &mut buffer).unwrap();
        writeln!(text, "to-host/{name} {}", hex(frame)).unwrap();
    }
    text
}

fn path(relative: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(relative)
}

#[test]
fn every_message_has_its_golden_bytes() {
    let path = path("tests/golden.txt");
    let now = golden();
    if std::env::var_os("BLESS").is_some() {
        std::fs::write(&path, &now).unwrap();
    }
    let pinned = std::fs::read_to_string(&path).unwrap();
    for (line, (now, pinned)) in now.lines().zip(pinned.lines()).enumerate() {
        assert_eq!(
            now,
            pinned,
            "line {}: the wire format has changed",
            line + 1
        );
    }
    assert_eq!(now.lines().count(), pinned.lines().count());
}

#[test]
fn the_golden_bytes_are_read_back_as_the_same_messages() {
    let mut host = Decoder::<DeviceToHost>::new();
    let mut board = Decoder::<HostToDevice>::new();
    let mut buffer = [0; MAX_FRAME];
    for (name, message) in messages() {
        let mut frame = encode(&message, &mut buffer).unwrap();
        assert_eq!(host.next(&mut frame), Some(Ok(message)), "{name}");
        assert!(frame.is_empty());
    }
    for (name, command) in commands() {
        let mut frame = encode(&command, &mut buffer).unwrap();
        assert_eq!(board.next(&mut frame), Some(Ok(command)), "{name}");
    }
}

/// The frames of a board that spoke version 2, and what they say today.
#[test]
fn recorded_frames_of_version_2_are_read() {
    let pinned = include_str!("version_2.txt");
    let read = |name: &str| {
        let line = pinned.lines().find_map(|line| line.strip_prefix(name));
        let frame = bytes(line.unwrap().trim());
        read_recorded(2, frame.strip_suffix(&[0]).unwrap()).unwrap()
    };
    let today: std::collections::HashMap<_, _> = messages().into_iter().collect();
    for (then, now) in [
        ("pulse-alone", "pulse-alone"),
        ("pulse-read-back", "pulse-read-back"),
        ("output-pulse-2", "pulse-2"),
        ("output-pulse-3", "pulse-3"),
        ("output-pulse-4", "pulse-4"),
        ("arrived", "arrived"),
        ("output-arrived", "arrived-3"),
        ("capture-Rising", "capture-Rising"),
        ("imu", "imu"),
        ("filler", "filler"),
        ("pps", "pps"),
    ] {
        assert_eq!(read(&format!("{then} ")).as_ref(), today.get(now), "{then}");
    }
    let mut hello = hello(ResetCause::PowerOn, None);
    hello.protocol_version = 2;
    assert_eq!(read("hello-PowerOn "), Some(DeviceToHost::Hello(hello)));
    let mut status = status();
    status.handlers = Handlers::default();
    status.handlers.trigger.cycles = 2 * 13_000;
    status.die_decidegrees = None;
    assert_eq!(read("status "), Some(DeviceToHost::Status(status)));
    for answer in ["answer-pong ", "answer-align ", "answer-imu "] {
        assert_eq!(read(answer), None);
    }
    // And as a frame of any other version they are not taken for something else.
    let pps = bytes("110a0980f0f0e401a2ec88b00db03598ba");
    for version in [0, 1, 3, PROTOCOL_VERSION, PROTOCOL_VERSION + 1] {
        assert_eq!(read_recorded(version, &pps), Err(FrameError::Message));
    }
    let mut damaged = pps;
    damaged[5] ^= 1;
    assert_eq!(read_recorded(2, &damaged), Err(FrameError::Checksum));
}

/// The frames of a board that spoke version 3: all but hellos and answers are as today.
#[test]
fn recorded_frames_of_version_3_are_read() {
    let today: std::collections::HashMap<_, _> = messages().into_iter().collect();
    let (mut read, mut answers) = (0, 0);
    for line in include_str!("version_3.txt").lines() {
        let Some((name, frame)) = line.split_once(' ').filter(|(name, _)| *name != "#") else {
            continue;
        };
        let frame = bytes(frame);
        let message = read_recorded(3, frame.strip_suffix(&[0]).unwrap()).unwrap();
        if name.starts_with("answer-") {
            assert_eq!(message, None, "{name}");
            answers += 1;
            continue;
        }
        let mut expected = today[name].clone();
        if let DeviceToHost::Hello(hello) = &mut expected {
            hello.protocol_version = 3;
        }
        assert_eq!(message, Some(expected), "{name}");
        read += 1;
    }
    assert_eq!((read, answers), (31, 3));
}

/// A frame of this version is read as the decoder reads it.
#[test]
fn recorded_frames_of_this_version_are_read() {
    let mut buffer = [0; MAX_FRAME];
    for (name, message) in messages() {
        let frame = encode(&message, &mut buffer).unwrap();
        let frame = frame.strip_suffix(&[0]).unwrap();
        let read = read_recorded(PROTOCOL_VERSION, frame);
        assert_eq!(read, Ok(Some(message)), "{name}");
    }
}

/// The page that describes the format names the checksum of the golden bytes:
/// whoever changes one has to look at the other.
#[test]
fn the_page_about_the_protocol_was_looked_at() {
    let pinned = std::fs::read(path("tests/golden.txt")).unwrap();
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&pinned);
    let page = std::fs::read_to_string(path("../docs/protocol.md")).unwrap();
    let mark = format!("`{crc:08x}`");
    assert!(
        page.contains(&mark),
        "docs/protocol.md does not name the checksum {mark} of tests/golden.txt: \
         bring the page up to date with the format, then its checksum"
    );
}

/// The longest messages fit into a frame.
#[test]
fn no_message_is_longer_than_a_frame() {
    let mut longest = [0; MAX_FRAME];
    let text = "x".repeat(MAX_PANIC);
    let mut hello = hello(ResetCause::Software, Some(&text));
    hello.now = Ticks(u64::MAX);
    hello.epoch = u32::MAX;
    hello.tick_hz = u32::MAX;
    encode(&DeviceToHost::Hello(hello), &mut longest).unwrap();
    let filler = Filler {
        seq: u32::MAX,
        payload: (0..MAX_FILLER).map(|_| 0).collect(),
    };
    encode(&DeviceToHost::Filler(filler), &mut longest).unwrap();

    let all = u32::MAX;
    let mut status = status();
    status.seq = all;
    status.at = Ticks(u64::MAX);
    status.epoch = all;
    status.dropped = Dropped {
        answers: all,
        pulses: all,
        captures: all,
        imu: all,
        status: all,
        outputs: all,
    };
    status.link = LinkCounters {
        frames: all,
        oversize: all,
        cobs: all,
        checksum: all,
        message: all,
        lost_bytes: all,
    };
    status.connects = all;
    status.cpu_permille = u16::MAX;
    status.stack_used = all;
    status.stack_size = all;
    status.trigger = TriggerStatus {
        state: TrainState::Slewing,
        train: all,
        period: Period(u64::MAX),
        width: all,
        pulses: u64::MAX,
        next_edge: Ticks(u64::MAX),
        next_fraction: all,
        late: all,
        readback: Readback {
            seen: all,
            missing: all,
            stray: all,
            delay: Some(i32::MIN),
        },
    };
    status.trigger_latency = all;
    let handler = HandlerTime {
        calls: all,
        cycles: all,
        worst: all,
    };
    status.handlers = Handlers {
        trigger: handler,
        outputs: handler,
        handover: handler,
        usb: handler,
    };
    status.die_decidegrees = Some(i16::MIN);
    status.strobe_overcaptures = all;
    status.strobe_floods = all;
    status.imu = ImuStatus {
        samples: all,
        late: all,
        overcaptures: all,
        recoveries: all,
        ..imu_status(Some(ImuFault::Readback {
            register: 0xFF,
            wrote: 0xFF,
            read: 0xFF,
        }))
    };
    status.outputs = [OutputStatus {
        state: TrainState::Slewing,
        train: all,
        pulses: u64::MAX,
        late: all,
    }; 3];
    status.output_latency = all;
    status.gnss = GnssStatus {
        state: TrainState::Slewing,
        pulses: u64::MAX,
        sentences: all,
        missed: all,
        late: all,
    };
    encode(&DeviceToHost::Status(status), &mut longest).unwrap();
}
