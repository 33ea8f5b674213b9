//! Fuzz target for `fuzz_bodies::depth_recording`.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| fuzz_bodies::depth_recording(data));
