//! Middle of the depth exposure as a recording's photodiode has seen it, written into the rig
//! profile.

use std::path::Path;

use crate::outcome::{Failure, write_file};
use recording::profile::measured::{MeasuredDepth, with_depth};
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
    let text = system::read_text(profile, MAX_LENGTH)
        .map_err(|error| Failure::file("read", profile, &error))?;
    let began = session.began().unwrap_or_else(jiff::Timestamp::now);
    let date = began.to_zoned(jiff::tz::TimeZone::system()).date();
    let now = Profile::parse(&text, Some(profile))?.depth;
    if !MeasuredDepth::of(&session.profile.depth, date).holds_for(&now) {
        return Ok(None);
    }
    let constant = [seen.center_us, seen.sigma_us];
    write_file(profile, &with_depth(&text, profile, constant, date)?)?;
    Ok(Some(seen))
}
