//! Where the trigger must be sent so that the depth camera is exposed in the
//! middle of the phone's frames. Pure arithmetic.
//!
//! ```text
//! phone time of the middle   m = phase + exposure/2 + start of the row − start of the first row
//! board time of it           b = clock⁻¹(m)
//! trigger edge               e = b − center_offset − bias
//! period on the board        p = frame period / (1 + rate) · (phone frames to a depth frame)
//! ```
//!
//! `phase` is the timestamp of one frame, the start of exposure of its first
//! row. `center_offset` is from the trigger's edge to the middle of exposure of
//! the depth image; `bias` is what `evaluate --calibrate` measured to be left
//! over, depth minus phone.
//!
//! The phase depends on the offset of the clocks at the time of that frame,
//! the drift on frame period and rate. A single twist gives the skew to about
//! 1 ppm, and `video_start` the frame period to about 1 ppm: each 60 µs/min. So
//! both are taken from the profile once they have been learnt. A frame period in the
//! phone's time stays; a skew ages, and moves with the temperature ([`aged`]): twists at a
//! distance before the recording know today's ([`Course`]).

use jiff::Timestamp;
use protocol::TICK_HZ;

use crate::rates::{Course, Rate};
use recording::profile::{Learnt, Phone, Profile};
use recording::session_file::{Alignment, FramePeriodSource, Placement, Video};
use timebase::{BoardSeconds, ClockModel, PhoneSeconds, Wander};

/// How far a learnt value may be from the one measured now, in sigmas of both.
const CONSISTENT_SIGMAS: f64 = 5.0;

/// 1-sigma of the timestamp of one of the phone's frames, ns: nobody documents it,
/// and the assumed value is rather too large than too small.
const FRAME_JITTER_NS: f64 = 2_000.0;

/// Intervals whose mean `video_start` reports.
const INTERVALS: f64 = 59.0;

/// 1-sigma of the mean frame duration that `video_start` reports, ns: the mean
/// of 59 intervals whose ends have that jitter.
const VIDEO_START_SIGMA_NS: f64 = std::f64::consts::SQRT_2 * FRAME_JITTER_NS / INTERVALS;

/// So many of the first frames may be lost or doubled.
const MOST_ODD_FRAMES: f64 = 3.0;

/// How far the span of the first frames may be from a whole number of periods, in periods:
/// phones are off by less than half a percent.
const WHOLE: f64 = 0.35;

/// 1-sigma of what a skew moves for each °C of the board: a plain crystal is specified
/// within ±30 ppm over some 100 °C, with a slope of about so much in the middle, 1/°C.
const TEMPERATURE_PER_C: f64 = 0.3e-6;

/// The most that the sigma of a skew grows with its age: rooms and seasons.
const MOST_AGED: f64 = 2e-6;

/// How far the trigger's period may be from that of the depth camera's mode, relative to
/// it. Phones are off by some 0.1 %; a camera that is driven at another rate makes no
/// frames, and at a thousand a second may come to harm.
const NEAR_MODE: f64 = 0.1;

/// Why there is no alignment.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AlignmentError {
    /// The phone's frame period is not one that the trigger can make.
    #[error(
        "the phone's frames would drive the depth camera every {:.3} ms; expected its mode's {:.3} ms within 10 %",
        period_ns * 1e-6,
        expected_ns * 1e-6
    )]
    FramePeriod {
        /// As reported or learnt, times the frames to a depth frame.
        period_ns: f64,
        /// That of the depth camera's mode.
        expected_ns: f64,
    },
    /// The result is before the board's reset or not a number.
    #[error(
        "the phone's frame lies at {board_s} s of board time: the clock relation is of another session"
    )]
    OutOfRange {
        /// Where the arithmetic led.
        board_s: f64,
    },
}

/// An alignment and what to know about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// The alignment.
    pub alignment: Alignment,
    /// Remarks for the user.
    pub remarks: Vec<String>,
}

/// What the profile has learnt about the rate of this phone against this board, where it
/// can be used, as far as it is still known now and at this temperature of the board in °C.
#[must_use]
pub fn skew_prior(
    phone: &Phone,
    board_id: &str,
    now: Timestamp,
    temperature_c: Option<f64>,
) -> Option<Rate> {
    let learnt = phone.learnt.as_ref()?;
    if learnt.board_id.as_deref().is_some_and(|id| id != board_id) {
        return None;
    }
    Some(Rate {
        skew: learnt.skew?,
        sigma: aged(learnt, learnt.skew_sigma?, now, temperature_c),
    })
}

/// 1-sigma of a learnt skew now: with its age it walks as clocks wander, up to a limit, and
/// it moves with the temperature. Without a time of day it is a day older than its date;
/// without temperatures the age stands for them too.
fn aged(learnt: &Learnt, sigma: f64, now: Timestamp, temperature_c: Option<f64>) -> f64 {
    const DAY_S: f64 = 86_400.0;
    let age_s = match learnt.time {
        Some(time) => now.duration_since(time).as_secs_f64(),
        None => {
            let today = now.to_zoned(jiff::tz::TimeZone::system()).date();
            let days = today.since(learnt.learnt).map_or(0, |span| span.get_days());
            f64::from(days + 1) * DAY_S
        }
    };
    let walked = (Wander::default().diffusion() * age_s.abs()).sqrt();
    let warmer = temperature_c.zip(learnt.board_temperature_c);
    let moved = warmer.map_or(0.0, |(now, then)| TEMPERATURE_PER_C * (now - then));
    sigma.hypot(walked.min(MOST_AGED)).hypot(moved)
}

/// 1-sigma of the phase now, µs, as [`phase_sigma_us_at`] predicts it and with what the
/// temperature of the board in °C has done since the last twist: as if evenly.
#[must_use]
pub fn phase_sigma_us_now(
    alignment: &Alignment,
    now: BoardSeconds,
    temperature_c: Option<f64>,
) -> f64 {
    let warmer = temperature_c.zip(alignment.board_temperature_c);
    let moved = warmer.map_or(0.0, |(now, then)| TEMPERATURE_PER_C * (now - then));
    let since = now.0 - alignment.clock.reference.0;
    phase_sigma_us_at(alignment, now).hypot(moved * since / 2.0 * 1e6)
}

/// Takes a skew known from before into a relation of the clocks.
///
/// The Kalman update with a measurement of the skew alone: the offset moves with
/// it as their covariance says. `None` if the two contradict each other.
#[must_use]
pub fn with_known_skew(clock: &ClockModel, skew: f64, sigma: f64) -> Option<ClockModel> {
    let p = clock.covariance;
    let innovation = skew - clock.skew;
    let variance = p[1][1] + sigma * sigma;
    if !variance.is_normal() || innovation.abs() > CONSISTENT_SIGMAS * variance.sqrt() {
        return None;
    }
    let gain = [p[0][1] / variance, p[1][1] / variance];
    let cross = p[0][1] * (1.0 - gain[1]);
    Some(ClockModel {
        offset: clock.offset + gain[0] * innovation,
        skew: clock.skew + gain[1] * innovation,
        covariance: [
            [p[0][0] - gain[0] * p[0][1], cross],
            [cross, p[1][1] * (1.0 - gain[1])],
        ],
        ..*clock
    })
}

/// Plans the alignment.
///
/// # Errors
///
/// The phone's figures lead nowhere.
pub fn plan(profile: &Profile, course: &Course, video: &Video) -> Result<Planned, AlignmentError> {
    let clock = &course.clock;
    let mut remarks = Vec::new();
    let (frame_period_ns, frame_period_sigma_ns, source) =
        frame_period(&profile.phone, video, &mut remarks);
    let exposure_us = reported_exposure_us(video).unwrap_or_else(|| {
        remarks.push(format!(
            "the app does not report the exposure; the profile's {} µs is used",
            profile.phone.exposure_us
        ));
        profile.phone.exposure_us
    });
    let middle_row_us = profile.middle_row_us();
    let center_offset_us = profile.depth.center_offset_us;
    let bias_us = profile.frame_sync.bias_us;

    let middle = middle(clock, video, exposure_us, middle_row_us);
    let edge = BoardSeconds(middle.0 - (center_offset_us + bias_us) * 1e-6);
    if !(edge.0 > 0.0 && edge.0 < 1e9) {
        return Err(AlignmentError::OutOfRange { board_s: edge.0 });
    }
    let ratio = f64::from(profile.frame_ratio());
    let rate = course.rate_from(edge);
    let period_s = frame_period_ns * 1e-9 * ratio / (1.0 + rate.skew);
    let expected_s = 1.0 / f64::from(profile.depth.fps);
    let is_near = (period_s / expected_s - 1.0).abs() <= NEAR_MODE;
    if !is_near {
        return Err(AlignmentError::FramePeriod {
            period_ns: frame_period_ns * ratio,
            expected_ns: expected_s * 1e9,
        });
    }
    // At 30 fps 1.6·10⁶ · 2³² is below 2⁵³: exact to 2⁻³² ticks.
    let period_q32 = (period_s * f64::from(TICK_HZ) * 4_294_967_296.0).round() as u64;

    Ok(Planned {
        alignment: Alignment {
            exposure_us,
            middle_row_us,
            center_offset_us,
            bias_us,
            frame_period_ns,
            frame_period_sigma_ns,
            frame_period_source: source,
            clock: *clock,
            change: course.change,
            board_temperature_c: None,
            anchor: edge.ticks(),
            period_q32,
            phase_sigma_us: phase_sigma_us(course, edge),
            drift_sigma_us_per_min: drift_sigma_us_per_min(
                rate,
                frame_period_ns,
                frame_period_sigma_ns,
            ),
            arrival_pulse: None,
            arrival: None,
        },
        remarks,
    })
}

/// What the app reported of the exposure, µs.
fn reported_exposure_us(video: &Video) -> Option<f64> {
    let exposure = video.exposure_ns.filter(|&exposure| exposure > 0)?;
    Some(exposure as f64 * 1e-3)
}

/// Board time of the middle of the frame that the phone gave the timestamp of.
fn middle(clock: &ClockModel, video: &Video, exposure_us: f64, middle_row_us: f64) -> BoardSeconds {
    let to_middle = (exposure_us / 2.0 + middle_row_us) * 1e-6;
    clock.to_board(PhoneSeconds(video.phase.seconds().0 + to_middle))
}

/// 1-sigma of where a frame lies in board time, µs: the relation of the clocks and
/// the jitter of the one timestamp that the phone gives.
fn phase_sigma_us(course: &Course, at: BoardSeconds) -> f64 {
    (course.offset_sigma_at(at) * 1e6).hypot(FRAME_JITTER_NS * 1e-3)
}

/// 1-sigma of a frame period relative to it; without one it is that of the period
/// that `video_start` reports.
fn relative_period_sigma(frame_period_ns: f64, sigma_ns: Option<f64>) -> f64 {
    sigma_ns.unwrap_or(VIDEO_START_SIGMA_NS) / frame_period_ns
}

/// 1-sigma of how frames move against pulses, µs/min: the rate and the frame period.
fn drift_sigma_us_per_min(rate: Rate, frame_period_ns: f64, sigma_ns: Option<f64>) -> f64 {
    let period_sigma = relative_period_sigma(frame_period_ns, sigma_ns);
    rate.sigma.hypot(period_sigma) * 60e6
}

/// Predicted 1-sigma of the phase at a board time, µs, without the constants'.
///
/// Where the grid is right on the phone's frames depends on the offset of the clocks
/// *then*, whose uncertainty holds what skew and warming add, and on how many frames of
/// an uncertain period lie between.
#[must_use]
pub fn phase_sigma_us_at(alignment: &Alignment, at: BoardSeconds) -> f64 {
    let since = at.0 - alignment.anchor.as_secs_f64();
    let period_sigma =
        relative_period_sigma(alignment.frame_period_ns, alignment.frame_period_sigma_ns);
    let course = Course {
        clock: alignment.clock,
        change: alignment.change,
    };
    phase_sigma_us(&course, at).hypot(since * period_sigma * 1e6)
}

/// The mean frame duration that the phone reports, where frames of the first 60 were lost
/// or doubled made right: their span is a whole number of periods all the same.
fn reported_period(phone: &Phone, video: &Video, remarks: &mut Vec<String>) -> f64 {
    let reported = video.frame_duration_ns;
    let about = phone
        .learnt
        .as_ref()
        .map_or(1e9 / 30.0, |learnt| learnt.frame_period_ns);
    let periods = reported * INTERVALS / about;
    let whole = periods.round();
    let odd = (whole - INTERVALS).abs();
    if odd == 0.0 || odd > MOST_ODD_FRAMES || (periods - whole).abs() > WHOLE {
        return reported;
    }
    let what = if whole > INTERVALS { "lost" } else { "doubled" };
    remarks.push(format!(
        "{odd} of the phone's first 60 frames were {what}: the {reported} ns that it reports \
         are the mean of {whole} periods over {INTERVALS}"
    ));
    reported * INTERVALS / whole
}

/// The learnt frame period where there is one that fits what the phone reports
/// now; else the reported one.
fn frame_period(
    phone: &Phone,
    video: &Video,
    remarks: &mut Vec<String>,
) -> (f64, Option<f64>, FramePeriodSource) {
    let reported = reported_period(phone, video, remarks);
    let Some(learnt) = &phone.learnt else {
        remarks.push(String::from(
            "no frame period learnt yet: the phase may drift by tens of µs a minute \
             (`smartdepthsync profile learn`)",
        ));
        return (reported, None, FramePeriodSource::VideoStart);
    };
    let sigma = learnt.frame_period_sigma_ns.hypot(VIDEO_START_SIGMA_NS);
    if (learnt.frame_period_ns - reported).abs() > CONSISTENT_SIGMAS * sigma {
        remarks.push(format!(
            "the learnt frame period of {} ns does not fit the {reported} ns that the phone \
             reports now (another mode?); the reported one is used",
            learnt.frame_period_ns
        ));
        return (reported, None, FramePeriodSource::VideoStart);
    }
    (
        learnt.frame_period_ns,
        Some(learnt.frame_period_sigma_ns),
        FramePeriodSource::Learnt,
    )
}

/// Where the frames of another phone lie against the depth images, whose grid
/// follows the reference phone.
///
/// `phone` is one of the profile's, `course` its relation to the board, `video` what
/// it answered. The offset is counted from the depth image that is nearest, as if
/// there were one to each frame of the reference phone.
#[must_use]
pub fn placement(
    profile: &Profile,
    phone: &Phone,
    course: &Course,
    video: &Video,
    alignment: &Alignment,
) -> Placement {
    let (period_ns, sigma_ns, _) = frame_period(phone, video, &mut Vec::new());
    let exposure_us = reported_exposure_us(video).unwrap_or(phone.exposure_us);
    let middle = middle(&course.clock, video, exposure_us, phone.middle_row_us());
    let rate = course.rate_from(middle);
    let to_depth = (alignment.center_offset_us + alignment.bias_us) * 1e-6;
    let depth = BoardSeconds(alignment.anchor.as_secs_f64() + to_depth);
    let grid_s = alignment.period_q32 as f64
        / 4_294_967_296.0
        / f64::from(TICK_HZ)
        / f64::from(profile.frame_ratio());
    let apart = middle.0 - depth.0;
    let own_s = period_ns * 1e-9 / (1.0 + rate.skew);
    Placement {
        offset_us: (apart - (apart / grid_s).round() * grid_s) * 1e6,
        offset_sigma_us: phase_sigma_us(course, middle),
        drift_us_per_min: (own_s / grid_s - 1.0) * 60e6,
        drift_sigma_us_per_min: drift_sigma_us_per_min(rate, period_ns, sigma_ns),
    }
}

#[cfg(test)]
mod tests;
