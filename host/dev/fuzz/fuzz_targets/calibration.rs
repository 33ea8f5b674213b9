//! Fuzz target for `fuzz_bodies::calibration`.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| fuzz_bodies::calibration(data));
