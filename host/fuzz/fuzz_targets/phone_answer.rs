//! The phone's answers: any bytes in any split, read as the answer to each of
//! the requests. Nothing may panic, and the split must not change the outcome.
#![no_main]

use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use smartdepthsync::phone::ImuRequest;
use smartdepthsync::phone::answer::{AnswerDecoder, AnswerEvent};
use smartdepthsync::phone::file_name::safe_file_name;
use smartdepthsync::phone::requests::{ImuBody, VideoHeaderBody, VideoStartBody};

/// Events of the answer in `bytes`, given in pieces of `step` bytes.
fn read(bytes: &[u8], step: usize) -> (Vec<String>, bool) {
    let mut imu = ImuBody::new(ImuRequest {
        duration: Duration::from_secs(1),
        accelerometer: true,
        gyroscope: true,
        magnetometer: true,
    });
    let (mut start, mut video) = (VideoStartBody::default(), VideoHeaderBody::default());
    let mut decoder = AnswerDecoder::new(1 << 16);
    let mut events = Vec::new();
    for piece in bytes.chunks(step.max(1)) {
        let mut input = piece;
        loop {
            match decoder.next(&mut input) {
                Ok(Some(event)) => {
                    if let AnswerEvent::Line(line) = &event {
                        let _ = imu.line(1, line);
                        let _ = start.line(1, line);
                        let _ = video.line(1, line);
                        assert!(safe_file_name(line).len() <= 101);
                    }
                    events.push(format!("{event:?}"));
                }
                Ok(None) => break,
                Err(_) => return (events, false),
            }
        }
    }
    let _ = (imu.finish(), start.finish(), video.finish());
    (events, true)
}

fuzz_target!(|data: &[u8]| {
    let Some((&step, bytes)) = data.split_first() else {
        return;
    };
    let whole = read(bytes, usize::MAX);
    let split = read(bytes, usize::from(step));
    assert_eq!(whole, split);
});
