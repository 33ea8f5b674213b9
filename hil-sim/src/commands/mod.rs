//! The commands of `hil-sim`.

pub(crate) mod bench;
pub(crate) mod demo;
pub(crate) mod long_run;
pub(crate) mod serve;

/// How many times as fast as real time virtual time may pass.
pub(crate) fn speed(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|s| (0.1..=1000.0).contains(s))
        .ok_or_else(|| "expected a number from 0.1 to 1000".to_owned())
}
