//! Where the trigger must be sent so that the depth camera is exposed in the
//! middle of the phone's frames. Pure arithmetic.
//!
//! ```text
//! phone time of the middle   m = phase + exposure/2 + start of the row − start of the first row
//! board time of it           b = clock⁻¹(m)
//! trigger edge               e = b − center_offset − bias − shift
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
//! phone's time stays, unless it follows the exposure; a skew ages, and moves with the
//! temperature ([`aged`]) and while the rig warms up: twists at a distance before the
//! recording know today's ([`clock::twists`]).

use jiff::Timestamp;
use protocol::TICK_HZ;

use clock::rates::{CONSISTENT_SIGMAS, Course, Rate, warming_share};
use clock::twists::KnownSkew;
use clock::{BoardSeconds, ClockModel, PhoneSeconds, Wander};
use recording::profile::{Learnt, Phone, Profile};
use recording::session_file::{Alignment, FramePeriodSource, Placement, Video};

/// 1-sigma of the timestamp of one of the phone's frames, ns, until a recording has taught it.
/// Qualcomm's older drivers read the clock in an interrupt handler (`msm_isp_get_timestamp`), the
/// newer ones latch it in hardware to 52 ns (`cam_ife_csid`), and the answer does not tell which. A
/// handler of Linux on ARM runs some 10 µs after its edge; that is taken to scatter by half of itself.
const FRAME_JITTER_NS: f64 = 5_000.0;

/// Intervals whose mean `video_start` reports.
const INTERVALS: f64 = 59.0;

/// 1-sigma of how much longer a frame is for each ms of exposure, ns: some phones lengthen
/// their frames. A guess.
const PERIOD_OF_EXPOSURE_NS_PER_MS: f64 = 100.0;

/// Where exposures that differ make the frame period this uncertain, it is said, µs/min.
const TELLING_DRIFT_US_PER_MIN: f64 = 5.0;

/// So many of the first frames may be lost or doubled: with more the phone is in another mode
/// as far as anybody knows, which is refused.
const MOST_ODD_FRAMES: f64 = NEAR_MODE * INTERVALS;

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
) -> Option<KnownSkew> {
    let learnt = phone.learnt.as_ref()?;
    if learnt.board_id.as_deref().is_some_and(|id| id != board_id) {
        return None;
    }
    let age_s = age_s(learnt, now);
    let warmer = temperature_c.zip(learnt.board_temperature_c);
    // Where the board's temperatures tell of its crystal, the phone's is left of the two.
    let unknown = warmer.map_or(1.0, |_| std::f64::consts::FRAC_1_SQRT_2);
    Some(KnownSkew {
        rate: Rate {
            skew: learnt.skew?,
            sigma: aged(learnt.skew_sigma?, age_s, warmer),
        },
        warmed: unknown * warming_share(age_s),
    })
}

/// How long ago it was learnt, s. Without a time of day it is a day older than its date.
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

/// 1-sigma of a learnt skew now, but for the warming: with its age it walks as clocks
/// wander, up to a limit, and it moves with the temperature of the board, which is now and
/// was then so many °C; without temperatures the age stands for them too.
fn aged(sigma: f64, age_s: f64, warmer: Option<(f64, f64)>) -> f64 {
    let walked = (Wander::default().diffusion() * age_s).sqrt();
    sigma.hypot(walked.min(MOST_AGED)).hypot(moved(warmer))
}

/// 1-sigma of what a skew has moved since the board was of another temperature: now and
/// then, °C.
fn moved(warmer: Option<(f64, f64)>) -> f64 {
    warmer.map_or(0.0, |(now, then)| TEMPERATURE_PER_C * (now - then))
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
    let since = now.0 - alignment.clock.reference.0;
    phase_sigma_us_at(alignment, now).hypot(moved(warmer) * since / 2.0 * 1e6)
}

/// Plans the alignment.
///
/// # Errors
///
/// The phone's figures lead nowhere.
pub fn plan(profile: &Profile, course: &Course, video: &Video) -> Result<Planned, AlignmentError> {
    let clock = &course.clock;
    let mut remarks = Vec::new();
    let frames = frame_period(&profile.phone, video, &mut remarks);
    let (frame_period_ns, frame_period_sigma_ns) = (frames.period_ns, frames.sigma_ns);
    let exposure_us = video.exposure_us().unwrap_or_else(|| {
        remarks.push(format!(
            "the app does not report the exposure; the profile's {} µs is used",
            profile.phone.exposure_us
        ));
        profile.phone.exposure_us
    });
    let middle_row_us = profile.phone.middle_row_us();
    let center_offset_us = profile.depth.center_offset_us;
    let (bias_us, shift_us) = (profile.frame_sync.bias_us, profile.frame_sync.shift_us);
    let constant_sigma_us = profile.constant_sigma_us(exposure_us);
    if !profile.phone.exposure_locked {
        remarks.push(String::from(
            "the exposure is not known to be locked: a frame rate that follows the light loses the \
             phase, which shows only when the video's timestamps are fetched; lock exposure and ISO \
             in the app's settings, then set exposure_locked = true in the profile",
        ));
    }

    let middle = middle(clock, video, exposure_us, middle_row_us);
    let edge = BoardSeconds(middle.0 - (center_offset_us + bias_us + shift_us) * 1e-6);
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
            shift_us,
            constant_sigma_us: Some(constant_sigma_us),
            constant_part: Some(profile.constant_part(exposure_us)),
            bias_is_measured: profile.frame_sync.bias_measured.is_some(),
            frame_period_ns,
            frame_period_sigma_ns: Some(frame_period_sigma_ns),
            frame_period_source: frames.source,
            frame_jitter_ns: Some(frames.jitter_ns),
            clock: *clock,
            change: course.change,
            board_temperature_c: None,
            anchor: edge.ticks(),
            period_q32,
            phase_sigma_us: phase_sigma_us(course, edge, frames.jitter_ns).hypot(constant_sigma_us),
            drift_sigma_us_per_min: drift_sigma_us_per_min(rate, &frames),
            arrival_pulse: None,
            arrival: None,
        },
        remarks,
    })
}

/// Board time of the middle of the frame that the phone gave the timestamp of.
fn middle(clock: &ClockModel, video: &Video, exposure_us: f64, middle_row_us: f64) -> BoardSeconds {
    let to_middle = (exposure_us / 2.0 + middle_row_us) * 1e-6;
    clock.to_board(PhoneSeconds(video.on_boot_clock().seconds().0 + to_middle))
}

/// 1-sigma of where a frame lies in board time, µs: the relation of the clocks and
/// the jitter of the one timestamp that the phone gives.
fn phase_sigma_us(course: &Course, at: BoardSeconds, jitter_ns: f64) -> f64 {
    (course.offset_sigma_at(at) * 1e6).hypot(jitter_ns * 1e-3)
}

/// 1-sigma of the mean frame duration that `video_start` reports, ns: the mean of 59
/// intervals whose ends have that jitter.
fn video_start_sigma_ns(jitter_ns: f64) -> f64 {
    std::f64::consts::SQRT_2 * jitter_ns / INTERVALS
}

/// 1-sigma of how frames move against pulses, µs/min: the rate and the frame period.
fn drift_sigma_us_per_min(rate: Rate, frames: &Frames) -> f64 {
    rate.sigma.hypot(frames.sigma_ns / frames.period_ns) * 60e6
}

/// Predicted 1-sigma of the mean drift over so many seconds from the anchor on, µs/min: of the
/// rate of the clocks over that time, which changes while a rig warms up, and of the frame period.
#[must_use]
pub fn drift_sigma_over(alignment: &Alignment, seconds: f64) -> f64 {
    let course = Course {
        clock: alignment.clock,
        change: alignment.change,
    };
    let anchor = BoardSeconds(alignment.anchor.as_secs_f64());
    let rate = course.rate_over(anchor, seconds.max(1.0));
    let period_sigma = frame_period_sigma(alignment);
    rate.sigma.hypot(period_sigma) * 60e6
}

/// 1-sigma of the phone's frame period, as a part of it.
fn frame_period_sigma(alignment: &Alignment) -> f64 {
    // Sessions of before have neither.
    let jitter_ns = alignment.frame_jitter_ns.unwrap_or(FRAME_JITTER_NS);
    let reported_ns = || video_start_sigma_ns(jitter_ns);
    let sigma_ns = alignment.frame_period_sigma_ns.unwrap_or_else(reported_ns);
    sigma_ns / alignment.frame_period_ns
}

/// Predicted 1-sigma of the phase at a board time, µs, without the constant's.
///
/// Where the grid is right on the phone's frames depends on the offset of the clocks
/// *then*, whose uncertainty holds what skew and warming add, on how many frames of
/// an uncertain period lie between, and on how far the grid's even pulses are from a rate that
/// is known to change.
#[must_use]
pub fn phase_sigma_us_at(alignment: &Alignment, at: BoardSeconds) -> f64 {
    let course = Course {
        clock: alignment.clock,
        change: alignment.change,
    };
    let anchor = BoardSeconds(alignment.anchor.as_secs_f64());
    let offset_us = course.offset_sigma_at(at) * 1e6;
    offset_us
        .hypot(frames_sigma_us(alignment, at))
        .hypot(course.bend(anchor, at) * 1e6)
}

/// The same with the constant's, which no twist makes smaller.
#[must_use]
pub fn stated_sigma_us_at(alignment: &Alignment, at: BoardSeconds) -> f64 {
    phase_sigma_us_at(alignment, at).hypot(alignment.constant_sigma_us.unwrap_or_default())
}

/// The part of [`phase_sigma_us_at`] that is the phone's frames': the jitter of the one
/// timestamp that the phone gave, and how many frames of an uncertain period lie between.
pub(crate) fn frames_sigma_us(alignment: &Alignment, at: BoardSeconds) -> f64 {
    let since = at.0 - alignment.anchor.as_secs_f64();
    let jitter_ns = alignment.frame_jitter_ns.unwrap_or(FRAME_JITTER_NS);
    (jitter_ns * 1e-3).hypot(since * frame_period_sigma(alignment) * 1e6)
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

/// The phone's frames, as far as they are known.
struct Frames {
    period_ns: f64,
    sigma_ns: f64,
    source: FramePeriodSource,
    jitter_ns: f64,
}

/// The learnt frame period where there is one that fits what the phone reports now, and both
/// together by their variances; else the reported one.
fn frame_period(phone: &Phone, video: &Video, remarks: &mut Vec<String>) -> Frames {
    let reported = reported_period(phone, video, remarks);
    let learnt = phone.learnt.as_ref();
    let jitter_ns = learnt.and_then(|learnt| learnt.frame_jitter_ns);
    let jitter_ns = jitter_ns.unwrap_or(FRAME_JITTER_NS);
    let reported_sigma = video_start_sigma_ns(jitter_ns);
    let as_reported = Frames {
        period_ns: reported,
        sigma_ns: reported_sigma,
        source: FramePeriodSource::VideoStart,
        jitter_ns,
    };
    let Some(learnt) = learnt else {
        remarks.push(String::from(
            "no frame period learnt yet: the phase may drift by hundreds of µs a minute \
             (`smartdepthsync profile learn`)",
        ));
        return as_reported;
    };
    let exposures = learnt.exposure_us.zip(video.exposure_us());
    let by_exposure = exposures.map_or(0.0, |(then, now)| {
        PERIOD_OF_EXPOSURE_NS_PER_MS * 1e-3 * (now - then)
    });
    let learnt_sigma = learnt.frame_period_sigma_ns.hypot(by_exposure);
    let sigma = learnt_sigma.hypot(reported_sigma);
    if (learnt.frame_period_ns - reported).abs() > CONSISTENT_SIGMAS * sigma {
        remarks.push(format!(
            "the learnt frame period of {} ns does not fit the {reported} ns that the phone \
             reports now (another mode?); the reported one is used",
            learnt.frame_period_ns
        ));
        return as_reported;
    }
    let of_reported = (learnt_sigma / sigma).powi(2);
    let sigma_ns = learnt_sigma * reported_sigma / sigma;
    let drift = sigma_ns / learnt.frame_period_ns * 60e6;
    if let Some((then, now)) = exposures
        && drift > TELLING_DRIFT_US_PER_MIN
        && by_exposure.abs() > learnt.frame_period_sigma_ns
    {
        remarks.push(format!(
            "the exposure is {:.1} ms, the frame period was learnt with {:.1} ms and may follow it: \
             the phase may drift by {drift:.0} µs a minute; lock the exposure in the app's settings",
            now * 1e-3,
            then * 1e-3,
        ));
    }
    Frames {
        period_ns: learnt.frame_period_ns + of_reported * (reported - learnt.frame_period_ns),
        sigma_ns,
        source: FramePeriodSource::Learnt,
        jitter_ns,
    }
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
    let frames = frame_period(phone, video, &mut Vec::new());
    let exposure_us = video.exposure_us().unwrap_or(phone.exposure_us);
    let middle = middle(&course.clock, video, exposure_us, phone.middle_row_us());
    let rate = course.rate_from(middle);
    let to_depth = (alignment.center_offset_us + alignment.bias_us) * 1e-6;
    let depth = BoardSeconds(alignment.anchor.as_secs_f64() + to_depth);
    let grid_s = alignment.period_q32 as f64
        / 4_294_967_296.0
        / f64::from(TICK_HZ)
        / f64::from(profile.frame_ratio());
    let apart = middle.0 - depth.0;
    let own_s = frames.period_ns * 1e-9 / (1.0 + rate.skew);
    Placement {
        offset_us: (apart - (apart / grid_s).round() * grid_s) * 1e6,
        offset_sigma_us: phase_sigma_us(course, middle, frames.jitter_ns)
            .hypot(profile.other_constant_sigma_us(phone, exposure_us)),
        drift_us_per_min: (own_s / grid_s - 1.0) * 60e6,
        drift_sigma_us_per_min: drift_sigma_us_per_min(rate, &frames),
    }
}

#[cfg(test)]
mod tests;
