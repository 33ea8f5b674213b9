//! Middles of the two exposures as a recording has measured them with photodiode and LED, written
//! into the rig profile.

use std::path::Path;

use crate::context::Context;
use crate::outcome::{Failure, write_file};
use evaluate::led::calibration::{Calibration, calibrate};
use recording::profile::measured::{MeasuredDepth, with_depth, with_phone};
use recording::profile::{MAX_LENGTH, Profile};
use recording::session_file::SessionFile;
use recording::strobes::SeenExposures;

/// Writes the middle of the depth exposure, if a photodiode has seen it and the profile has the
/// same camera, mode and rate still.
///
/// # Errors
///
/// The profile cannot be read or written.
pub(crate) fn write_depth(
    profile: &Path,
    session: &SessionFile,
) -> Result<Option<SeenExposures>, Failure> {
    let Some(seen) = session.exposures else {
        return Ok(None);
    };
    let (text, date) = (read(profile)?, session.day());
    let now = Profile::parse(&text, Some(profile))?.depth;
    if !MeasuredDepth::of(&session.profile.depth, date).holds_for(&now) {
        return Ok(None);
    }
    let constant = [seen.center_us, seen.sigma_us];
    write_file(profile, &with_depth(&text, profile, constant, date)?)?;
    Ok(Some(seen))
}

/// Measures the rows of the phone by the flashes of the LED on its video, and writes them; `None`
/// if no LED has flashed.
///
/// # Errors
///
/// A file is missing or cannot be read or written, or the video does not show the LED.
pub(crate) fn write_rows(
    profile: &Path,
    folder: &Path,
    session: &SessionFile,
    context: &Context,
) -> Result<Option<Calibration>, Failure> {
    if session.led.is_none() {
        return Ok(None);
    }
    context.say("looking for the LED on the video");
    let found = context.over_files(|monitor| calibrate(folder, session, monitor))?;
    let Some(found) = found else {
        return Ok(None);
    };
    let text = with_phone(&read(profile)?, profile, &found.constants, &found.measured)?;
    write_file(profile, &text)?;
    Ok(Some(found))
}

fn read(path: &Path) -> Result<String, Failure> {
    system::read_text(path, MAX_LENGTH).map_err(|error| Failure::file("read", path, &error))
}
