//! The alignment of the trigger to the phone's frames, from the profile and the answer to
//! `video_start`. The mathematics is in [`clock::alignment`].

use clock::PhoneSeconds;
use clock::alignment::{AlignmentError, GridPlan, Placement, Target, aged_skew_sigma};
use clock::frames::{Frames, FramesRemark, LearntFrames};
use clock::rates::{Course, PLANNED_S, Rate, warming_share};
use clock::twists::KnownSkew;
use jiff::Timestamp;
use protocol::TriggerAlign;
use recording::profile::{Learnt, Phone, Profile};
use recording::session_file::{Alignment, Video};

/// A planned alignment.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// The command to the board.
    pub command: TriggerAlign,
    /// The alignment as the session file stores it, without its arrival.
    pub alignment: Alignment,
    /// Remarks for the user.
    pub remarks: Vec<String>,
}

/// Returns the rate of this phone against this board as the profile has learnt it, with its
/// uncertainty at present and at this temperature of the board in °C. `None` if none was learnt,
/// or with another board.
#[must_use]
pub fn skew_prior(
    phone: &Phone,
    board_id: &str,
    now: Timestamp,
    temperature_c: Option<f64>,
) -> Option<KnownSkew> {
    let learnt = phone.learnt.as_ref()?;
    if learnt.board_id.as_deref().is_some_and(|id| id != board_id) {
        return None;
    }
    let age_s = age_s(learnt, now);
    let temperatures = temperature_c.zip(learnt.board_temperature_c);
    // Temperatures of the board cover its crystal; the phone's share of the warming is left.
    let unknown = temperatures.map_or(1.0, |_| std::f64::consts::FRAC_1_SQRT_2);
    Some(KnownSkew {
        rate: Rate {
            skew: learnt.skew?,
            sigma: aged_skew_sigma(learnt.skew_sigma?, age_s, temperatures),
        },
        warmed: unknown * warming_share(age_s),
    })
}

/// Age of what was learnt, s. Without a time of day, a day is added to the age of its date.
fn age_s(learnt: &Learnt, now: Timestamp) -> f64 {
    const DAY_S: f64 = 86_400.0;
    let age_s = match learnt.time {
        Some(time) => now.duration_since(time).as_secs_f64(),
        None => {
            let today = now.to_zoned(jiff::tz::TimeZone::system()).date();
            let days = today.since(learnt.learnt).map_or(0, |span| span.get_days());
            f64::from(days + 1) * DAY_S
        }
    };
    age_s.abs()
}

/// Plans the alignment to the frame whose timestamp the phone reported.
///
/// # Errors
///
/// The phone's frame period does not fit the depth camera's mode, or the frame is before the
/// board's reset.
pub fn plan(profile: &Profile, course: &Course, video: &Video) -> Result<Planned, AlignmentError> {
    let (frames, remarks) = frames(&profile.phone, video);
    let mut remarks: Vec<String> = remarks.iter().map(ToString::to_string).collect();
    let exposure_us = video.exposure_us().unwrap_or_else(|| {
        remarks.push(format!(
            "the app does not report the exposure; the profile's {} µs is used",
            profile.phone.exposure_us
        ));
        profile.phone.exposure_us
    });
    if !profile.phone.exposure_locked {
        remarks.push(String::from(
            "the exposure is not known to be locked: a frame rate that follows the light loses the \
             phase, which shows only when the video's timestamps are fetched; lock exposure and ISO \
             in the app's settings, then set exposure_locked = true in the profile",
        ));
    }
    let middle_row_us = profile.phone.middle_row_us();
    let center_offset_us = profile.depth.center_offset_us;
    let (bias_us, shift_us) = (profile.frame_sync.bias_us, profile.frame_sync.shift_us);
    let target = Target {
        middle: middle(video, exposure_us, middle_row_us),
        lead_s: (center_offset_us + bias_us + shift_us) * 1e-6,
        ratio: profile.frame_ratio(),
        depth_fps: profile.depth.fps,
    };
    let plan = GridPlan::new(course, frames, &target)?;
    let mut alignment = Alignment {
        exposure_us,
        middle_row_us,
        center_offset_us,
        bias_us,
        shift_us,
        constant_sigma_us: Some(profile.constant_sigma_us(exposure_us)),
        constant_part: Some(profile.constant_part(exposure_us)),
        bias_is_measured: profile.is_constant_measured(exposure_us),
        plan,
        phase_sigma_us: 0.0,
        largest_sigma_us: None,
        end_sigma_us: None,
        drift_sigma_us_per_min: plan.drift_sigma_over(PLANNED_S),
        arrival_pulse: None,
        arrival: None,
    };
    alignment.phase_sigma_us = alignment.stated_sigma_us_at(plan.anchor.into());
    Ok(Planned {
        command: plan.command(profile.slew()),
        alignment,
        remarks,
    })
}

/// The phone's frames by its profile and its report.
fn frames(phone: &Phone, video: &Video) -> (Frames, Vec<FramesRemark>) {
    let learnt = phone.learnt.as_ref().map(|learnt| LearntFrames {
        period_ns: learnt.frame_period_ns,
        sigma_ns: learnt.frame_period_sigma_ns,
        jitter_ns: learnt.frame_jitter_ns,
        exposure_us: learnt.exposure_us,
    });
    let reported_ns = video.frame_duration_ns;
    Frames::known(learnt.as_ref(), reported_ns, video.exposure_us())
}

/// Middle of the exposure of the frame whose timestamp the phone reported.
fn middle(video: &Video, exposure_us: f64, middle_row_us: f64) -> PhoneSeconds {
    let to_middle = (exposure_us / 2.0 + middle_row_us) * 1e-6;
    PhoneSeconds(video.on_boot_clock().seconds().0 + to_middle)
}

/// Predicts the position of another phone's frames against the depth images, whose grid
/// follows the reference phone. `course` relates the clock of that phone to the board's, `video`
/// is its answer.
#[must_use]
pub fn placement(
    profile: &Profile,
    phone: &Phone,
    course: &Course,
    video: &Video,
    alignment: &Alignment,
) -> Placement {
    let (frames, _) = frames(phone, video);
    let exposure_us = video.exposure_us().unwrap_or(phone.exposure_us);
    let middle = middle(video, exposure_us, phone.middle_row_us());
    let to_depth_s = (alignment.center_offset_us + alignment.bias_us) * 1e-6;
    let ratio = profile.frame_ratio();
    let plan = &alignment.plan;
    let mut placement = plan.placement(course, &frames, middle, to_depth_s, ratio);
    let constant_us = profile.other_constant_sigma_us(phone, exposure_us);
    placement.offset_sigma_us = placement.offset_sigma_us.hypot(constant_us);
    placement
}

#[cfg(test)]
mod tests;
