//! The commands of `hil-sim`.

pub(crate) mod bench;
pub(crate) mod chain;
pub(crate) mod demo;
pub(crate) mod faults;
pub(crate) mod frame_sync;
pub(crate) mod hostile;
pub(crate) mod long_run;
pub(crate) mod phone_faults;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
pub(crate) use rig::serve::speed;

/// The program of the sessions: the given one, or the one beside this.
pub(crate) fn session_program(given: Option<&Path>) -> anyhow::Result<PathBuf> {
    match given {
        Some(program) => Ok(program.to_owned()),
        None => Ok(std::env::current_exe()
            .context("cannot find this program's folder")?
            .with_file_name(format!("smartdepthsync{}", std::env::consts::EXE_SUFFIX))),
    }
}
