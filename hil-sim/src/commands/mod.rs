//! The commands of `hil-sim`.

pub(crate) mod bench;
pub(crate) mod chain;
pub(crate) mod demo;
pub(crate) mod faults;
pub(crate) mod frame_sync;
pub(crate) mod long_run;
pub(crate) mod serve;

use std::path::{Path, PathBuf};

use anyhow::Context as _;

/// The program of the sessions: the given one, or the one beside this.
pub(crate) fn session_program(given: Option<&Path>) -> anyhow::Result<PathBuf> {
    match given {
        Some(program) => Ok(program.to_owned()),
        None => Ok(std::env::current_exe()
            .context("cannot find this program's folder")?
            .with_file_name(format!("smartdepthsync{}", std::env::consts::EXE_SUFFIX))),
    }
}

/// How many times as fast as real time virtual time may pass.
pub(crate) fn speed(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|s| (0.1..=1000.0).contains(s))
        .ok_or_else(|| "expected a number from 0.1 to 1000".to_owned())
}
