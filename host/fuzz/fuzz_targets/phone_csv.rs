//! Any bytes as the phone's CSV files: no panic, times in order.
#![no_main]

use libfuzzer_sys::fuzz_target;
use smartdepthsync::extract::phone::csv::Rows;

fuzz_target!(|data: &[u8]| {
    let mut rows = Rows::new(data);
    let mut last = None;
    while let Ok(Some(sample)) = rows.next_sample() {
        assert!(last.is_none_or(|last| sample.at > last));
        assert!(sample.value.iter().all(|value| value.is_finite()));
        last = Some(sample.at);
    }
    let mut rows = Rows::new(data);
    while let Ok(Some(_)) = rows.next_frame() {}
});
