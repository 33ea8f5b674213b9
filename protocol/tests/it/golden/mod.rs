//! The bytes of every message, pinned.
//!
//! `tests/golden.txt` holds one frame a line: a name, and the frame in hex, with
//! its delimiter. A change there is a change of the wire format and needs a new
//! `PROTOCOL_VERSION`. After such a change, `BLESS=1 cargo test -p
//! smartdepthsync-protocol` writes the file anew, and
//! `docs/protocol.md` has to be brought up to date with it: that page names the
//! checksum of the file.

mod messages;

use std::fmt::Write;
use std::path::PathBuf;

use protocol::*;

use messages::{commands, hello, imu_status, messages, status};

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

fn bytes(hex: &str) -> Vec<u8> {
    let digits = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
    (0..hex.len()).step_by(2).map(digits).collect()
}

fn golden() -> String {
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
    let pinned = include_str!("../../version_2.txt");
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
    for line in include_str!("../../version_3.txt").lines() {
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
