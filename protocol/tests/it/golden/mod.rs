//! The bytes of every message, pinned.
//!
//! `tests/golden.txt` holds one frame a line: a name, and the frame in hex, with
//! its delimiter. A change there is a change of the wire format and needs a new
//! `PROTOCOL_VERSION`. After such a change, `BLESS=1 cargo test -p
//! smartdepthsync-protocol` writes the file again.

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

/// By the decoder, and as single frames of a recording, where damage is found.
#[test]
fn the_golden_bytes_are_read_back_as_the_same_messages() {
    let mut host = Decoder::<DeviceToHost>::new();
    let mut board = Decoder::<HostToDevice>::new();
    let mut buffer = [0; MAX_FRAME];
    for (name, message) in messages() {
        let frame = encode(&message, &mut buffer).unwrap();
        let mut rest = frame;
        assert_eq!(host.next(&mut rest), Some(Ok(message.clone())), "{name}");
        assert!(rest.is_empty());
        let frame = frame.strip_suffix(&[0]).unwrap();
        assert_eq!(decode_frame(frame), Ok(message), "{name}");
        let mut damaged = frame.to_vec();
        damaged[frame.len() / 2] ^= 1;
        assert!(decode_frame::<DeviceToHost>(&damaged).is_err(), "{name}");
    }
    for (name, command) in commands() {
        let mut frame = encode(&command, &mut buffer).unwrap();
        assert_eq!(board.next(&mut frame), Some(Ok(command)), "{name}");
    }
    let oversize = decode_frame::<DeviceToHost>(&[1; MAX_FRAME + 1]);
    assert_eq!(oversize, Err(FrameError));
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
        lost_frames: all,
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
    status.masked = Masked {
        all,
        below_trigger: all,
    };
    status.die_decidegrees = Some(i16::MIN);
    status.supply_mv = Some(u16::MAX);
    status.usb = UsbCounters {
        resets: all,
        suspends: all,
        stuck: all,
    };
    status.resets = [u8::MAX; ResetCause::COUNT];
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
