//! The commands of `hil-sim`.

pub(crate) mod demo;
pub(crate) mod faults;
pub(crate) mod study;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use scenarios::programs::Programs;
use serde::Serialize;

/// The program under test.
#[derive(clap::Args)]
pub(crate) struct Program {
    /// The program under test; the `smartdepthsync` beside this one by default.
    #[arg(long, value_name = "FILE", global = true)]
    program: Option<PathBuf>,
}

impl Program {
    pub(crate) fn path(&self) -> Result<PathBuf> {
        match &self.program {
            Some(program) => Ok(program.clone()),
            None => Ok(std::env::current_exe()
                .context("cannot find this program's folder")?
                .with_file_name(format!("smartdepthsync{}", std::env::consts::EXE_SUFFIX))),
        }
    }
}

/// The programs of sessions on the simulated rig.
#[derive(clap::Args)]
pub(crate) struct Sessions {
    /// The firmware's ELF; without this, what `cargo xtask build` made.
    #[arg(long, value_name = "FILE", global = true)]
    elf: Option<PathBuf>,
    #[command(flatten)]
    program: Program,
}

impl Sessions {
    pub(crate) fn programs(&self) -> Result<Programs> {
        Ok(Programs {
            smartdepthsync: self.program.path()?,
            elf: self.elf.clone(),
        })
    }
}

/// The runs of a campaign.
#[derive(clap::Args)]
pub(crate) struct Seeds {
    /// The first seed.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// Number of seeds.
    #[arg(long, default_value_t = 200)]
    pub(crate) count: u64,
}

impl Seeds {
    pub(crate) fn all(&self) -> Vec<u64> {
        (self.seed..self.seed.saturating_add(self.count)).collect()
    }

    /// Names the seeds of the campaign `name` that failed, if there are any.
    pub(crate) fn fail_for(&self, name: &str, failed: impl Iterator<Item = u64>) -> Result<()> {
        let failed: Vec<String> = failed.map(|seed| seed.to_string()).collect();
        if failed.is_empty() {
            return Ok(());
        }
        bail!(
            "{} of {} seeds failed: {}; `cargo xtask hil-sim {name} --seed N --count 1` repeats one",
            failed.len(),
            self.count,
            failed.join(", ")
        );
    }
}

/// Writes figures to a file, as JSON, where one is asked for.
pub(crate) fn write_json(path: Option<&Path>, figures: &impl Serialize) -> Result<()> {
    let Some(path) = path else {
        return Ok(());
    };
    let json = serde_json::to_string_pretty(figures)?;
    std::fs::write(path, json + "\n").with_context(|| format!("cannot write {}", path.display()))
}
