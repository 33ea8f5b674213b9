//! Any bytes as a depth recording: no panic, no unbounded memory.
#![no_main]

use std::io::Cursor;

use libfuzzer_sys::fuzz_target;
use smartdepthsync::extract::mkv::k4a::{Content, Recording};

fuzz_target!(|data: &[u8]| {
    for content in [Content::Times, Content::Pixels] {
        let Ok(mut recording) = Recording::new(Cursor::new(data)) else {
            return;
        };
        let mut bytes = 0;
        while let Ok(Some(batch)) = recording.next_batch(content) {
            bytes += batch.depth.iter().map(|image| image.bytes.len()).sum::<usize>();
        }
        assert!(bytes <= data.len());
    }
});
