//! Fuzz target for `fuzz_bodies::video_metadata`.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| fuzz_bodies::video_metadata(data));
