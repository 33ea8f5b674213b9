//! The checks of this computer and of the rig profile, which `doctor` and a session make
//! beside those of the rig ([`session::checks`]).

use std::path::Path;

use jiff::civil::Date;
use recording::error_budget::{COARSE_US, ErrorPart};
use recording::profile::Profile;
use recording::session_file::{CHECK_BIAS, CHECK_LEARNT};
use rustix::fs::{Access, access};
use session::checks::Checks;
use session::error::Fault;
use session::housekeeping::{DISK_FULL, free_space};

use crate::new_profile::{is_assumed, summary};
use crate::rig_profile::Place;

/// Free space below which a recording may not fit, bytes.
const DISK_LOW: u64 = 2_000_000_000;

/// A learnt skew or a measured bias older than this should be measured again, days.
const OLD_DAYS: i32 = 90;

/// Name of the check of the depth camera's settings.
const CHECK_CAMERA: &str = "depth camera";

/// Checks what does not need the board: profile, disk, ffmpeg, depth recorder. `place` says
/// where the profile is from, `out` where recordings are to go.
pub(crate) fn host(profile: &Profile, place: &Place, out: &Path) -> Checks {
    let mut checks = Checks::default();
    check_profile(&mut checks, profile, place);
    check_camera(&mut checks, profile);
    // The folder may not be there yet: the nearest one above it is.
    let place = out.ancestors().find(|folder| folder.exists());
    let place = place
        .filter(|place| !place.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    check_disk(&mut checks, free_space(place));
    if let Err(error) = access(place, Access::WRITE_OK | Access::EXEC_OK) {
        let found = format!("{}: {}", place.display(), std::io::Error::from(error));
        checks.bad(Fault::Disk, "disk", found, "give another folder with --out");
    }
    check_ffmpeg(&mut checks);
    check_recorder(&mut checks, profile);
    checks
}

/// Returns true if a measurement of this day is to be repeated.
fn is_old(date: Date) -> bool {
    let today = jiff::Zoned::now().date();
    let age = today.since(date).map_or(0, |span| span.get_days());
    age > OLD_DAYS
}

fn check_profile(checks: &mut Checks, profile: &Profile, place: &Place) {
    match place.path {
        Some(_) => checks.good("profile", format!("{} ({place})", profile.name)),
        None => checks.warn(
            "profile",
            place.to_string(),
            "make your own: `smartdepthsync setup`",
        ),
    }
    match &profile.phone.learnt {
        None => checks.warn(
            CHECK_LEARNT,
            "none",
            "`smartdepthsync record --calibrate` learns them in 2 minutes",
        ),
        Some(learnt) if is_old(learnt.learnt) => checks.warn(
            CHECK_LEARNT,
            format!("from {}", learnt.learnt),
            "crystals age: learn again",
        ),
        Some(learnt) => {
            let skew = learnt.skew.map_or(String::from("not learnt"), |skew| {
                format!("{:+.3} ppm", skew * 1e6)
            });
            let (period, date) = (learnt.frame_period_ns, learnt.learnt);
            checks.good(
                CHECK_LEARNT,
                format!("frame period {period:.3} ns, skew {skew}, from {date}"),
            );
        }
    }
    match profile.frame_sync.bias_measured {
        None => check_halves(checks, profile),
        Some(date) if is_old(date) => checks.warn(
            CHECK_BIAS,
            format!("measured on {date}"),
            "measure it again after changes of the rig",
        ),
        Some(date) => checks.good(
            CHECK_BIAS,
            format!("{:+.1} µs, measured on {date}", profile.frame_sync.bias_us),
        ),
    }
}

/// Checks the two halves of a constant that was not measured as a whole.
fn check_halves(checks: &mut Checks, profile: &Profile) {
    let (depth, phone) = (&profile.depth, &profile.phone);
    let exposure_us = (phone.measured.as_ref()).map_or(phone.exposure_us, |of| of.exposure_us);
    let parts = profile.constant_parts(exposure_us);
    let has = |stale: ErrorPart| parts.iter().any(|(part, _)| *part == stale);
    let text = |half: &str, date: Option<Date>, stale: ErrorPart| match date {
        Some(date) if has(stale) => format!("{half} measured on {date} in other conditions"),
        Some(date) => format!("{half} measured on {date}"),
        None => format!("{half} not measured"),
    };
    let depth = depth.measured.as_ref().map(|half| half.date);
    let phone = phone.measured.as_ref().map(|half| half.date);
    let found = format!(
        "{}, {}",
        text("depth", depth, ErrorPart::StaleDepth),
        text("phone", phone, ErrorPart::StalePhone)
    );
    if !profile.is_constant_measured(exposure_us) {
        checks.warn(
            CHECK_BIAS,
            found,
            "`smartdepthsync record --calibrate --led` measures it, with a photodiode and an LED",
        );
    } else if depth.into_iter().chain(phone).any(is_old) {
        checks.warn(
            CHECK_BIAS,
            found,
            "measure it again after changes of the rig",
        );
    } else {
        checks.good(CHECK_BIAS, found);
    }
}

fn check_camera(checks: &mut Checks, profile: &Profile) {
    let Some(model) = profile.depth.model() else {
        return;
    };
    let objections = profile.objections(model);
    for objection in &objections {
        checks.warn(CHECK_CAMERA, objection.found.clone(), &objection.next_step);
    }
    // A measured bias has the error of the centre in it.
    let is_open = profile.frame_sync.bias_measured.is_none()
        && profile.depth.center_offset_sigma_us >= COARSE_US;
    if is_open || is_assumed(model, profile) {
        checks.warn(CHECK_CAMERA, summary(model, profile), MEASURE_CENTER);
    } else if objections.is_empty() {
        checks.good(CHECK_CAMERA, summary(model, profile));
    }
}

/// Next step for a centre of the depth exposure that nobody has measured.
const MEASURE_CENTER: &str = "a measured constant bias takes its error up (see that check)";

fn check_disk(checks: &mut Checks, free: Option<u64>) {
    const STEP: &str = "free some space: an hour takes about 150 MB, videos several GB";
    match free {
        Some(free) if free < DISK_LOW => {
            let found = format!("{} MB are free", free / 1_000_000);
            match free < DISK_FULL {
                // The session would end within a second.
                true => checks.bad(Fault::Disk, "disk", found, STEP),
                false => checks.warn("disk", found, STEP),
            }
        }
        Some(free) => checks.good("disk", format!("{} GB are free", free / 1_000_000_000)),
        None => checks.warn(
            "disk",
            "free space is not known",
            "make sure that there is enough",
        ),
    }
}

fn check_ffmpeg(checks: &mut Checks) {
    match phone::video::version() {
        Some(text) => {
            let first = text.lines().next().unwrap_or_default();
            let short: Vec<&str> = first.split_whitespace().take(3).collect();
            checks.good("ffmpeg", short.join(" "));
        }
        None => checks.warn(
            "ffmpeg",
            "not found",
            "extract and evaluate need it: install ffmpeg",
        ),
    }
}

fn check_recorder(checks: &mut Checks, profile: &Profile) {
    const NAME: &str = "depth recorder";
    match profile.depth.recorder.command.first() {
        None => checks.good(NAME, "none in the profile: start it yourself"),
        Some(program) if system::find_program(program).is_some() => {
            checks.good(NAME, program.clone())
        }
        Some(program) => checks.bad(
            Fault::Recorder,
            NAME,
            format!("the program `{program}` is not found"),
            "install it, or change `command` in `[depth.recorder]`",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcome::{ExitStatus, Failure};

    #[test]
    fn a_disk_that_is_full_is_no_mere_warning() {
        let looked = |free: u64| {
            let mut checks = Checks::default();
            check_disk(&mut checks, Some(free));
            checks
                .result()
                .err()
                .map(|error| Failure::from(error).status())
        };
        assert_eq!(looked(12_000_000), Some(ExitStatus::Storage));
        assert_eq!(looked(500_000_000), None);
    }
}
