//! Bodies of the fuzz targets: a function of the input bytes for each. They are shared by the
//! targets of `cargo fuzz` (in `host/dev/fuzz/fuzz_targets/`) and the short run over corpus and
//! mutations in the tests (`host/cli/tests/it/fuzz_smoke.rs`).
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::missing_panics_doc
)]

use std::io::Cursor;

use board::Conversation;
use evaluate::footage::read_timestamps;
use extract::depth::k4a::{Content, Recording};
use phone::answer::{self, Answer, Lines};
use phone::file_name::safe_file_name;
use phone::requests::{ImuBody, VideoHeader, VideoStart};
use phone::rows::{RowError, Rows};
use phone::video::{parse_presentation_times, parse_probe};
use protocol::{Decoder, HostToDevice};
use recording::profile::Profile;
use recording::reader::Reader;
use recording::verify::verify;
use system::ReadMonitor;

/// Reads any bytes as a depth recording: no panic, no unbounded memory.
pub fn depth_recording(data: &[u8]) {
    for content in [Content::Times, Content::Pixels] {
        let Ok(mut recording) = Recording::new(Cursor::new(data)) else {
            return;
        };
        let mut bytes = 0;
        while let Ok(Some(batch)) = recording.next_batch(content) {
            bytes += batch
                .depth
                .iter()
                .map(|image| image.bytes.len())
                .sum::<usize>();
        }
        assert!(bytes <= data.len());
    }
}

/// Reads any bytes as the phone's CSV files: no panic, times in order.
pub fn phone_csv(data: &[u8]) {
    let mut rows = Rows::new(data);
    let mut last = None;
    loop {
        match rows.next_sample() {
            Ok(Some(sample)) => {
                assert!(last.is_none_or(|last| sample.time > last));
                assert!(sample.xyz.iter().all(|value| value.is_finite()));
                last = Some(sample.time);
            }
            Err(RowError::Bad(_)) => {}
            Ok(None) | Err(RowError::Io(_)) => break,
        }
    }
    let mut rows = Rows::new(data);
    while !matches!(rows.next_timestamp(), Ok(None) | Err(RowError::Io(_))) {}
}

/// Reads the answer in `bytes`, passed in pieces of `step` bytes. Returns its end and its body.
fn read_answer(bytes: &[u8], step: usize) -> (Option<Answer>, Vec<String>) {
    let mut imu = ImuBody::default();
    let mut body = Vec::new();
    let mut lines = Lines::new(1 << 16);
    let mut pieces = bytes.chunks(step.max(1));
    let mut piece = &bytes[..0];
    let next = || {
        loop {
            if let Some(line) = lines.next(&mut piece).map_err(drop)? {
                return Ok(line);
            }
            piece = pieces.next().ok_or(())?;
        }
    };
    let receive = |_, line: &str| {
        let _ = imu.line(1, line);
        body.push(line.to_owned());
        assert!(safe_file_name(line).len() <= 101);
        Ok(())
    };
    let answer = answer::read(next, receive, drop).ok();
    let _ = (
        imu.finish(),
        VideoStart::parse(&body),
        VideoHeader::parse(&body),
    );
    (answer, body)
}

/// Reads any bytes, in any split, as the phone's answer to each of the
/// requests: no panic, and the same outcome for every split.
pub fn phone_answer(data: &[u8]) {
    let Some((&step, bytes)) = data.split_first() else {
        return;
    };
    let whole = read_answer(bytes, usize::MAX);
    let split = read_answer(bytes, usize::from(step));
    assert_eq!(whole, split);
}

/// Reads any bytes, in any split, from the board's link: no panic, the same events for every
/// split, and at most three per byte.
pub fn link(data: &[u8]) {
    let Some((&step, bytes)) = data.split_first() else {
        return;
    };
    let events = |step: usize| {
        let mut conversation = Conversation::new(1);
        conversation.keep_frames(true);
        for piece in bytes.chunks(step.max(1)) {
            conversation.receive(piece);
        }
        let mut events = Vec::new();
        while let Some(event) = conversation.next_event() {
            events.push(format!("{event:?}"));
        }
        events
    };
    let whole = events(usize::MAX);
    assert!(whole.len() <= 3 * bytes.len() + 1);
    assert_eq!(whole, events(usize::from(step)));
}

/// Reads and verifies any bytes as a recording: no panic.
pub fn recording(data: &[u8]) {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("recording.mcap");
    std::fs::write(&place, data).unwrap();
    if let Ok(reader) = Reader::open(&place) {
        for entry in reader {
            if entry.is_err() {
                break;
            }
        }
    }
    if let Ok(verified) = verify(&place, &ReadMonitor::default()) {
        assert!(verified.file.bytes == data.len() as u64);
    }
}

/// Parses any text as a rig profile: no panic.
pub fn profile(data: &[u8]) {
    if let Ok(text) = std::str::from_utf8(data) {
        let _ = Profile::parse(text, None);
    }
}

/// Imports any text as a result of Kalibr: no panic, and the resulting profile is valid.
pub fn camchain(data: &[u8]) {
    let path = std::path::Path::new("rig.toml");
    if let Ok(chain) = std::str::from_utf8(data)
        && let Ok((text, _)) =
            recording::kalibr::into_profile(recording::profile::DEFAULT, path, None, chain)
    {
        Profile::parse(&text, None).unwrap();
    }
}

/// Reads any bytes as a depth camera's calibration: no panic.
pub fn calibration(data: &[u8]) {
    for color in [None, Some((1280, 720)), Some((2048, 1536))] {
        let _ = extract::geometry::check_calibration(data, "NFOV_UNBINNED", color);
    }
}

/// Loads any bytes as a session file, and any text with a checksum that is right: no panic.
pub fn session_file(data: &[u8]) {
    use recording::session_file::{SessionFile, with_checksum, without_checksum};
    let folder = tempfile::tempdir().unwrap();
    let load = |data: &[u8]| {
        std::fs::write(folder.path().join("session.json"), data).unwrap();
        let _ = SessionFile::load(folder.path());
    };
    load(data);
    if let Ok(text) = std::str::from_utf8(data) {
        load(with_checksum(&without_checksum(text)).as_bytes());
    }
}

/// Decodes any bytes, in any split, as commands from the host, like the firmware: the same
/// commands for every split, and at most one per byte.
pub fn commands(data: &[u8]) {
    let Some((&step, bytes)) = data.split_first() else {
        return;
    };
    let decoded = |step: usize| {
        let mut decoder = Decoder::<HostToDevice>::new();
        let mut all = Vec::new();
        for mut piece in bytes.chunks(step.max(1)) {
            while let Some(result) = decoder.next(&mut piece) {
                all.push(result);
            }
            assert!(piece.is_empty());
        }
        all
    };
    let whole = decoded(usize::MAX);
    assert!(whole.len() <= bytes.len());
    assert_eq!(whole, decoded(usize::from(step)));
}

/// Reads any bytes as metadata of a video, from `ffprobe` and from the phone's file of frame
/// times: no panic, and plausible values.
pub fn video_metadata(data: &[u8]) {
    if let Ok(info) = parse_probe(data) {
        assert!(info.width > 0 && info.height > 0);
        assert!(info.rate.is_none_or(|rate| rate.is_finite() && rate > 0.0));
    }
    if let Some(times) = parse_presentation_times(&String::from_utf8_lossy(data)) {
        assert!(times.first() == Some(&0) && times.is_sorted());
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("VID_timestamps.csv");
    std::fs::write(&file, data).unwrap();
    if let Ok(times) = read_timestamps(&file, &ReadMonitor::default()) {
        // The app may get a frame twice, with one time.
        assert!(times.is_sorted());
    }
}
