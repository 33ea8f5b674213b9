//! The commands of `hil-sim`.

pub(crate) mod bench;
pub(crate) mod chain;
pub(crate) mod demo;
pub(crate) mod faults;
pub(crate) mod frame_sync;
pub(crate) mod hostile;
pub(crate) mod lies;
pub(crate) mod long_run;
pub(crate) mod phone_faults;
pub(crate) mod track_study;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
pub(crate) use rig::serve::speed;
use trials::whole_chain::Programs;

/// Virtual time against real time in a campaign with the real program.
const SPEED: f64 = 8.0;

/// A campaign of sessions with the real program.
#[derive(clap::Args)]
pub(crate) struct Campaign {
    /// The firmware's ELF; without this, what `cargo xtask build` made.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    #[command(flatten)]
    program: Program,
    #[command(flatten)]
    pub(crate) seeds: Seeds,
}

impl Campaign {
    pub(crate) fn programs(&self) -> anyhow::Result<Programs> {
        Ok(Programs {
            smartdepthsync: self.program.path()?,
            elf: self.elf.clone(),
            speed: SPEED,
        })
    }
}

/// Which runs of a campaign.
#[derive(clap::Args)]
pub(crate) struct Seeds {
    /// The first seed.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// How many seeds.
    #[arg(long, default_value_t = 200)]
    pub(crate) count: u64,
}

impl Seeds {
    pub(crate) fn all(&self) -> Vec<u64> {
        (self.seed..self.seed.saturating_add(self.count)).collect()
    }
}

/// Which program runs in a campaign.
#[derive(clap::Args)]
pub(crate) struct Program {
    /// The program under test; the `smartdepthsync` beside this one by default.
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
}

impl Program {
    pub(crate) fn path(&self) -> anyhow::Result<PathBuf> {
        session_program(self.program.as_deref())
    }
}

/// The program of the sessions: the given one, or the one beside this.
pub(crate) fn session_program(given: Option<&Path>) -> anyhow::Result<PathBuf> {
    match given {
        Some(program) => Ok(program.to_owned()),
        None => Ok(std::env::current_exe()
            .context("cannot find this program's folder")?
            .with_file_name(format!("smartdepthsync{}", std::env::consts::EXE_SUFFIX))),
    }
}
