//! The bytes of every message, pinned.
//!
//! A line of `tests/golden.txt` is a name, a frame in hex with its delimiter, and the message in
//! it as JSON. A change of the bytes is a change of the wire format and needs a new
//! `PROTOCOL_VERSION`. A new message, variant or field goes into the JSON; then
//! `SMARTDEPTHSYNC_BLESS=1 cargo test -p smartdepthsync-protocol` writes the bytes.

use std::fmt::{Debug, Write};
use std::path::PathBuf;

use protocol::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Names of lines with commands.
const TO_DEVICE: &str = "to-device/";

fn path() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden.txt")
}

/// The lines after the first: name, frame, message.
fn lines(text: &str) -> impl Iterator<Item = [&str; 3]> {
    text.lines().skip(1).map(|line| {
        let parts: Vec<&str> = line.splitn(3, ' ').collect();
        parts.try_into().unwrap()
    })
}

/// The frame of a message in hex. It is read back as the same message: by the decoder, and as a
/// single frame of a recording, where damage is found.
fn hex<M: DeserializeOwned + Serialize + PartialEq + Debug>(json: &str) -> String {
    let message: M = serde_json::from_str(json).unwrap_or_else(|e| panic!("{json}: {e}"));
    let mut buffer = [0; MAX_FRAME];
    let frame = encode(&message, &mut buffer).unwrap();
    let mut rest = frame;
    let read: M = Decoder::new().next(&mut rest).unwrap().unwrap();
    assert_eq!((&read, rest), (&message, &[][..]));
    let single = frame.strip_suffix(&[0]).unwrap();
    assert_eq!(decode_frame(single), Ok(message));
    let mut damaged = single.to_vec();
    damaged[single.len() / 2] ^= 1;
    assert!(decode_frame::<M>(&damaged).is_err(), "{json}");
    frame.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

#[test]
fn every_message_has_its_golden_bytes() {
    let pinned = std::fs::read_to_string(path()).unwrap();
    let mut now = format!("protocol-version {PROTOCOL_VERSION}\n");
    for [name, _, json] in lines(&pinned) {
        let frame = match name.starts_with(TO_DEVICE) {
            true => hex::<HostToDevice>(json),
            false => hex::<DeviceToHost>(json),
        };
        writeln!(now, "{name} {frame} {json}").unwrap();
    }
    if std::env::var_os("SMARTDEPTHSYNC_BLESS").is_some() {
        std::fs::write(path(), &now).unwrap();
    }
    for (now, pinned) in now.lines().zip(pinned.lines()) {
        assert_eq!(now, pinned, "the wire format has changed");
    }
}

/// Names of the variants of an enum, by what serde says of a wrong one.
fn variants<T: DeserializeOwned>() -> Vec<String> {
    let error = serde_json::from_str::<T>("\"?\"")
        .err()
        .unwrap()
        .to_string();
    let names = error.split('`').skip(3).step_by(2);
    names.map(str::to_owned).collect()
}

#[test]
fn every_variant_has_a_line() {
    let pinned = std::fs::read_to_string(path()).unwrap().replace('{', "");
    for (field, variants) in [
        ("\"command\":", variants::<Command>()),
        (" ", variants::<DeviceToHost>()),
        ("\"Ok\":", variants::<Reply>()),
        ("\"Err\":", variants::<Refusal>()),
        ("\"output\":", variants::<Output>()),
        ("\"failure\":", variants::<Failure>()),
        ("\"low_pass\":", variants::<LowPass>()),
        ("\"gyro_range\":", variants::<GyroRange>()),
        ("\"accel_range\":", variants::<AccelRange>()),
        ("\"baud\":", variants::<Baud>()),
        ("\"sentences\":", variants::<Sentences>()),
        ("\"reset_cause\":", variants::<ResetCause>()),
        ("\"board\":", variants::<BoardModel>()),
        ("\"state\":", variants::<TrainState>()),
        ("\"state\":", variants::<ImuState>()),
        ("\"clock\":", variants::<ImuClock>()),
        ("\"model\":", variants::<ImuModel>()),
        ("\"last_fault\":", variants::<ImuFault>()),
        ("\"channel\":", variants::<CaptureChannel>()),
        ("\"edge\":", variants::<Edge>()),
    ] {
        assert!(!variants.is_empty(), "{field}");
        for variant in variants {
            let there = pinned.contains(&format!("{field}\"{variant}\""));
            assert!(there, "{field}{variant} has no line");
        }
    }
}

/// The longest messages, with lines above, fit into a frame.
#[test]
fn the_longest_messages_are_as_long_as_they_can_be() {
    let pinned = std::fs::read_to_string(path()).unwrap();
    let longest = |name| {
        let [_, frame, json] = lines(&pinned).find(|line| line[0] == name).unwrap();
        (frame.len() / 2, serde_json::from_str(json).unwrap())
    };
    let (_, DeviceToHost::Hello(hello)) = longest("to-host/longest-hello") else {
        panic!("no hello");
    };
    assert_eq!(hello.last_panic.unwrap().len(), MAX_PANIC);
    let (_, DeviceToHost::Filler(filler)) = longest("to-host/longest-filler") else {
        panic!("no filler");
    };
    assert_eq!(filler.payload.len(), MAX_FILLER);
    let (length, _) = longest("to-host/longest-status");
    let lengths = lines(&pinned).map(|line| line[1].len() / 2);
    assert_eq!(lengths.max(), Some(length));
}

#[test]
fn more_than_a_frame_is_none() {
    let oversize = decode_frame::<DeviceToHost>(&[1; MAX_FRAME + 1]);
    assert_eq!(oversize, Err(FrameError));
}
