//! Sessions of `smartdepthsync`, as processes of their own, one after the other
//! on one simulated rig that runs all the time.
//!
//! The sessions see a serial port and a TCP port as on hardware. They are given
//! a profile with the constants that a real rig's owner would have measured
//! ([`rig::owner_profile`]), and nothing that a session finds out by itself.
//!
//! The rig is twisted all the time: a session may ask for it at any moment. What
//! else it does has no part in the figures.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use recording::folder;

use crate::judge::Truth;
use crate::programs::Programs;
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::{PhoneConfig, SimPhone};
use rig::random::Seed;
use rig::rig_config::RigConfig;
use rig::running_rig::{Pace, RunningRig};
use rig::table::Table;
use rig::wiring;
use stm32f4_sim::time::SimTime;

/// Parts of a stage.
#[derive(Clone, Debug)]
pub struct StageOptions {
    /// The one seed of all randomness.
    pub seed: u64,
    /// Folder for recordings, the phone's files and the profile.
    pub out: PathBuf,
    /// The programs that run.
    pub programs: Programs,
    /// At most so many times real time.
    pub speed: f64,
    /// The program `hil-sim`, whose depth recorder is used in front of a scene with
    /// something to look at.
    pub recorder: PathBuf,
}

/// A rig that runs, and where its sessions leave their files.
pub struct Stage {
    options: StageOptions,
    rig: RunningRig,
    table: Table,
    profile: PathBuf,
}

impl Stage {
    /// Sets a rig up and lets it run.
    ///
    /// # Errors
    ///
    /// A part of it cannot be started, or a file cannot be written.
    pub fn start(options: StageOptions) -> Result<Self> {
        let out = &options.out;
        let seed = Seed(options.seed);
        let config = RigConfig::published(seed).with_motion(MotionSpec::always(Gesture::Twist));
        let mut phone = PhoneConfig::draw(seed);
        // A phone knows nothing of the rigs before it, whose dates were the same.
        phone.storage = Some(folder::create(out, "phone")?);
        phone.camera.show_ball();
        let programs = &options.programs;
        let board = wiring::board_of(config.board, programs.elf.as_deref());
        let pace = Pace {
            speed: Some(options.speed),
            wait_for_host: true,
        };
        let rig = RunningRig::start(config, board, Some((phone, 0)), pace)?;
        let profile = out.join("rig.toml");
        let phone = rig.phone().context("the rig has no phone")?;
        let table = Table::new(rig.parts(), phone, &options.recorder)?;
        let text = rig.profile()? + &table.recorder();
        std::fs::write(&profile, text)
            .with_context(|| format!("cannot write {}", profile.display()))?;
        Ok(Self {
            options,
            rig,
            table,
            profile,
        })
    }

    /// The rig profile, as it is by now.
    #[must_use]
    pub fn profile(&self) -> &Path {
        &self.profile
    }

    /// The phone, whose storage no other rig has used.
    ///
    /// # Errors
    ///
    /// The rig has none.
    pub fn phone(&self) -> Result<&SimPhone> {
        self.rig.phone().context("the rig has no phone")
    }

    /// Board time now.
    #[must_use]
    pub fn now(&self) -> SimTime {
        self.rig.now()
    }

    /// Runs `smartdepthsync record` for `seconds` of board time, and gives the recording's
    /// folder.
    ///
    /// # Errors
    ///
    /// The session fails, or finishes with loss.
    pub fn session(&self, name: &str, seconds: u32, arguments: &[&str]) -> Result<PathBuf> {
        let name = free_name(&self.options.out, name);
        let (port, out) = (self.rig.port(), &self.options.out);
        let programs = &self.options.programs;
        let mut command = programs.record(port, &self.profile, out, &name);
        command
            .args(["--duration", &format!("{seconds}s")])
            .args(arguments)
            .env("PATH", self.table.search_path());
        let status = command.status().with_context(|| programs.cannot_start());
        if !self.rig.is_running() {
            bail!("the simulated board has failed during a session");
        }
        let status = status?;
        ensure!(status.success(), "{command:?} ended with {status}");
        Ok(self.options.out.join(name))
    }

    /// Ends the rig and tells the truth.
    ///
    /// # Errors
    ///
    /// The firmware has failed, or the phone could not save a file.
    pub fn end(self) -> Result<Truth> {
        Truth::of(self.rig.stop().context("the simulated rig")?)
    }
}

/// A name in `folder` that is not taken.
fn free_name(folder: &Path, name: &str) -> String {
    let mut free = name.to_owned();
    let mut number = 1u32;
    while folder.join(&free).exists() {
        number += 1;
        free = format!("{name}_{number}");
    }
    free
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(free_name(folder.path(), "recording"), "recording");
        std::fs::create_dir(folder.path().join("recording")).unwrap();
        assert_eq!(free_name(folder.path(), "recording"), "recording_2");
    }
}
