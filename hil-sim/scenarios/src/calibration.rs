//! The first sessions of a rig's owner: with a profile that a set-up writes and nothing measured,
//! then with what one session has taught.

use std::path::{Path, PathBuf};

use anyhow::Result;
use recording::profile::Profile;
use rig::led::LedConfig;
use rig::model_ranges;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use session::options::{Options, Track, seconds};

use crate::programs::{Programs, ask};
use crate::virtual_session::SessionBench;

/// Length of a session that teaches, seconds: its two twists are at least a minute apart, the
/// least that `smartdepthsync profile learn` takes a skew from.
const TEACHING_SECONDS: u32 = 60;

/// Length of the recording after that, seconds.
const CALIBRATION_SECONDS: u32 = 5;

/// Gives a rig an LED at the phone's lens, and constants between the exposures that its owner does
/// not know, drawn by a seed.
pub fn hide_constants(seed: Seed, rig: &mut RigConfig, phone: &mut PhoneConfig) {
    model_ranges::draw_constants(seed, rig, phone);
    rig.led.get_or_insert(LedConfig::nominal(rig.board));
}

/// Replaces the profile of a rig's owner, who knows all, by that of a first set-up.
///
/// # Errors
///
/// The program cannot write it.
pub fn set_up(bench: &mut SessionBench, programs: &Programs) -> Result<()> {
    let path = bench.out.join("set-up.toml");
    let new = ["profile", "init", "--camera", &bench.profile.depth.camera];
    ask(programs, &new, &[&path])?;
    let mut profile = Profile::load(&path)?;
    let owners = &bench.profile.phone;
    profile.phone.address.clone_from(&owners.address);
    profile.phone.exposure_locked = owners.exposure_locked;
    bench.profile = profile;
    Ok(())
}

/// The options of a session of this length whose video is fetched, into a folder of this name or
/// the next one that is free.
pub(crate) fn wishes(bench: &SessionBench, name: &str, length: u32, track: Track) -> Options {
    Options {
        duration: Some(seconds(length.into())),
        second_twist: true,
        fetch_video: true,
        track,
        ..bench.options(&free_name(&bench.out, name))
    }
}

/// Records for a minute, and lets the profile learn the rates of clocks and frames from it. Returns
/// the recording.
///
/// # Errors
///
/// The session fails, or nothing can be learnt.
pub(crate) fn teach(
    bench: &mut SessionBench,
    track: Track,
    programs: &Programs,
) -> Result<PathBuf> {
    let wishes = wishes(bench, "teaching", TEACHING_SECONDS, track);
    learn(bench, &wishes, programs)
}

/// Does the same after the LED has flashed at the phone for `led` ticks, so that the profile learns
/// the constants too.
///
/// # Errors
///
/// The session fails, or nothing can be learnt.
pub fn calibrate(
    bench: &mut SessionBench,
    track: Track,
    led: u64,
    programs: &Programs,
) -> Result<PathBuf> {
    let mut wishes = wishes(bench, "calibration", CALIBRATION_SECONDS, track);
    wishes.led = led;
    learn(bench, &wishes, programs)
}

fn learn(bench: &mut SessionBench, wishes: &Options, programs: &Programs) -> Result<PathBuf> {
    let recording = bench.run(wishes).good()?.folder;
    let profile = bench.write_profile()?;
    let arguments = ["profile", "learn", "--profile", &profile.to_string_lossy()];
    ask(programs, &arguments, &[&recording])?;
    bench.profile = Profile::load(&profile)?;
    Ok(recording)
}

/// A name in `folder` that is not taken.
fn free_name(folder: &Path, name: &str) -> String {
    let numbered = (2_u32..).map(|number| format!("{name}_{number}"));
    let mut names = std::iter::once(name.to_owned()).chain(numbered);
    let free = names.find(|name| !folder.join(name).exists());
    free.unwrap_or_else(|| name.to_owned())
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
