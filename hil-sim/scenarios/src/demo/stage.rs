//! Sessions of `smartdepthsync`, as processes of their own, one after the other
//! on one simulated rig that runs all the time.
//!
//! The sessions see a serial port and a TCP port as on hardware. They are given
//! a profile with the constants that a real rig's owner would have measured
//! ([`rig::owner_profile`]), and nothing that a session finds out by itself.
//! [`Stage::learn`] adds what a session has taught, by the tool's own command.
//!
//! The rig is twisted all the time: a session may ask for it at any moment. What
//! else it does has no part in the figures.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, anyhow, bail};
use recording::folder;

use super::judge::Truth;
use crate::programs::{Programs, said};
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::{PhoneConfig, SimPhone};
use rig::random::Seed;
use rig::rig_config::RigConfig;
use rig::running_rig::RunningRig;
use rig::table::Table;
use rig::wiring;
use stm32f4_sim::time::SimTime;

/// What a stage is made of.
#[derive(Clone, Debug)]
pub struct StageOptions {
    /// The one seed of all randomness.
    pub seed: u64,
    /// Folder for recordings, the phone's files and the profile.
    pub out: PathBuf,
    /// What runs.
    pub programs: Programs,
    /// Sessions say nothing unless they fail.
    pub quiet: bool,
    /// The program `hil-sim`, whose depth recorder is used in front of a scene with
    /// something to look at; without it nothing records the depth camera.
    pub recorder: Option<PathBuf>,
}

/// A rig that runs, and where its sessions leave their files.
pub struct Stage {
    options: StageOptions,
    rig: RunningRig,
    table: Option<Table>,
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
        if options.recorder.is_some() {
            phone.camera.show_ball();
        }
        let programs = &options.programs;
        let board = wiring::board_of(config.board, programs.elf.as_deref());
        let rig = RunningRig::start(config, board, Some((phone, 0)), programs.pace())?;
        let profile = out.join("rig.toml");
        let mut text = rig.profile()?;
        let mut table = None;
        if let (Some(recorder), Some(phone)) = (&options.recorder, rig.phone()) {
            let laid = Table::new(rig.parts(), phone, recorder)?;
            text += &laid.recorder();
            table = Some(laid);
        }
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
            .args(arguments);
        if let Some(table) = &self.table {
            command.env("PATH", table.search_path());
        }
        let ended = self.run(&mut command);
        if !self.rig.is_running() {
            bail!("the simulated board has failed during a session");
        }
        ended?;
        Ok(self.options.out.join(name))
    }

    /// Has `smartdepthsync profile learn` write into the profile what a session
    /// has taught. It must be the last one that recorded a video.
    ///
    /// # Errors
    ///
    /// The phone has no files of it, or nothing can be learnt.
    pub fn learn(&self, recording: &Path) -> Result<()> {
        let phone = self.phone()?;
        phone
            .wait_saved()
            .map_err(|e| anyhow!("the simulated phone: {e}"))?;
        let videos = phone.videos();
        let video = videos.last().context("the phone has recorded no video")?;
        let mut command = self.options.programs.tool();
        command
            .args(["profile", "learn"])
            .arg(recording)
            .arg("--profile")
            .arg(&self.profile)
            .arg("--timestamps")
            .arg(&video.timestamps);
        self.run(&mut command)
    }

    /// Ends the rig and tells the truth.
    ///
    /// # Errors
    ///
    /// The firmware has failed, or the phone could not save a file.
    pub fn end(self) -> Result<Truth> {
        Truth::of(self.rig.stop().context("the simulated rig")?)
    }

    /// Runs a program to its end.
    fn run(&self, command: &mut Command) -> Result<()> {
        let programs = &self.options.programs;
        if self.options.quiet {
            let output = programs.output(command)?;
            if !output.status.success() {
                bail!("{command:?} ended with {}", said(&output));
            }
        } else {
            let status = command.status();
            let status = status.with_context(|| programs.cannot_start())?;
            if !status.success() {
                bail!("{command:?} ended with {status}");
            }
        }
        Ok(())
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
