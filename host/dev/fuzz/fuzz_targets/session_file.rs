//! Fuzz target for `fuzz_bodies::session_file`.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| fuzz_bodies::session_file(data));
