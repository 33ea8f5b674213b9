//! The grid of trigger edges that exposes the depth camera in the middle of the phone's frames.
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
//! the depth image; `bias` is the remaining difference, depth minus phone, that
//! `evaluate --calibrate` measured.
//!
//! The phase depends on the offset of the clocks at the time of that frame,
//! the drift on frame period and rate. A single twist gives the skew to about
//! 1 ppm, and `video_start` the frame period to about 1 ppm: each 60 µs/min. So
//! both are taken from the profile once they have been learnt. A frame period in the
//! phone's time stays, unless it follows the exposure; a skew ages, and moves with the
//! temperature ([`aged_skew_sigma`]) and while the rig warms up: twists at some distance in time
//! before the recording measure today's skew ([`crate::twists`]).

use std::fmt::{self, Display, Formatter};

use protocol::{EdgeGrid, Period, TICK_HZ, Ticks, TriggerAlign};
use serde::{Deserialize, Serialize};

use crate::frames::{Frames, NEAR_MODE};
use crate::rates::{Course, RateChange};
use crate::{BoardSeconds, BoardToPhone, ClockRelation, PhoneSeconds, Wander};

/// 1-sigma of the change of a skew per °C of the board, 1/°C: a plain crystal is specified
/// within ±30 ppm over some 100 °C, with about this slope in the middle.
const TEMPERATURE_PER_C: f64 = 0.3e-6;

/// Largest 1-sigma that age alone adds to a skew: rooms and seasons.
const MOST_AGED: f64 = 2e-6;

/// Reason for which no grid can be planned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AlignmentError {
    /// The phone's frame period is not one that the trigger can make.
    #[error(
        "the phone's frames would drive the depth camera every {:.3} ms; expected its mode's {:.3} ms within 10 %",
        period_ns * 1e-6,
        expected_ns * 1e-6
    )]
    FramePeriod {
        /// Reported or learnt frame period times the number of phone frames per depth frame, ns.
        period_ns: f64,
        /// Period of the depth camera's mode, ns.
        expected_ns: f64,
    },
    /// The first edge is before the board's reset or not a number.
    #[error(
        "the phone's frame lies at {board_s} s of board time: the clock relation is of another session"
    )]
    OutOfRange {
        /// Computed board time of the first edge, s.
        board_s: f64,
    },
}

/// 1-sigma of a learnt skew at present, apart from warming up. It grows with the age of the skew
/// as clocks wander, up to a limit, and with the change of the board's temperature, given as
/// (now, then) in °C; without temperatures the age covers their influence too.
#[must_use]
pub fn aged_skew_sigma(sigma: f64, age_s: f64, temperatures_c: Option<(f64, f64)>) -> f64 {
    let walked = (Wander::default().diffusion() * age_s).sqrt();
    sigma
        .hypot(walked.min(MOST_AGED))
        .hypot(by_temperature(temperatures_c))
}

/// 1-sigma of the change of a skew between two temperatures of the board, (now, then) in °C.
fn by_temperature(temperatures_c: Option<(f64, f64)>) -> f64 {
    temperatures_c.map_or(0.0, |(now, then)| TEMPERATURE_PER_C * (now - then))
}

/// Demands on a grid of trigger edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Middle of the exposure of one of the phone's frames.
    pub middle: PhoneSeconds,
    /// Time from a trigger edge to the middle of that exposure, s.
    pub lead_s: f64,
    /// Number of phone frames per depth frame.
    pub ratio: u32,
    /// Frames per second of the depth camera's mode.
    pub depth_fps: u32,
}

/// A grid of trigger edges on the phone's frames, and the relation of the clocks that it was
/// planned with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GridPlan {
    /// The phone's frames.
    pub frames: Frames,
    /// Relation of the clocks at the last twist.
    pub clock: ClockRelation,
    /// Change of its skew from its reference on.
    #[serde(default)]
    pub change: RateChange,
    /// Temperature of the board's IMU at the last twist, °C.
    pub board_temperature_c: Option<f64>,
    /// One edge of the grid.
    pub anchor: Ticks,
    /// Period of the grid; in the file as 2⁻³² ticks.
    #[serde(rename = "period_q32")]
    pub period: Period,
}

impl GridPlan {
    /// Plans the grid whose edges precede the middles of the phone's exposures by the target's lead.
    ///
    /// # Errors
    ///
    /// The grid would begin before the board's reset, or its period is not that of the depth
    /// camera's mode.
    pub fn new(course: &Course, frames: Frames, target: &Target) -> Result<Self, AlignmentError> {
        let middle = course.clock.to_board(target.middle);
        let edge = BoardSeconds(middle.0 - target.lead_s);
        if !(edge.0 > 0.0 && edge.0 < 1e9) {
            return Err(AlignmentError::OutOfRange { board_s: edge.0 });
        }
        let ratio = f64::from(target.ratio);
        let period_s = frames.period_ns * 1e-9 * ratio / (1.0 + course.rate_from(edge).skew);
        let expected_s = 1.0 / f64::from(target.depth_fps);
        let is_near = (period_s / expected_s - 1.0).abs() <= NEAR_MODE;
        if !is_near {
            return Err(AlignmentError::FramePeriod {
                period_ns: frames.period_ns * ratio,
                expected_ns: expected_s * 1e9,
            });
        }
        Ok(Self {
            frames,
            clock: course.clock,
            change: course.change,
            board_temperature_c: None,
            anchor: edge.ticks(),
            // At 30 fps 1.6·10⁶ · 2³² is below 2⁵³: exact to 2⁻³² ticks.
            period: Period::from_ticks_f64(period_s * f64::from(TICK_HZ)),
        })
    }

    /// The command that moves the trigger onto this grid by at most `slew` ticks a pulse.
    #[must_use]
    pub const fn command(&self, slew: u32) -> TriggerAlign {
        TriggerAlign {
            anchor: self.anchor,
            period: self.period,
            slew,
        }
    }

    /// Returns the edges of the grid.
    #[must_use]
    pub fn grid(&self) -> EdgeGrid {
        EdgeGrid::new(self.anchor, self.period)
    }

    fn course(&self) -> Course {
        let (clock, change) = (self.clock, self.change);
        Course { clock, change }
    }

    /// Predicted 1-sigma of the mean drift over the first `seconds` from the anchor on, µs/min: of
    /// the rate of the clocks over that time, which changes while a rig warms up, and of the frame
    /// period.
    #[must_use]
    pub fn drift_sigma_over(&self, seconds: f64) -> f64 {
        let rate = self
            .course()
            .rate_over(self.anchor.into(), seconds.max(1.0));
        rate.sigma.hypot(self.frames.relative_sigma()) * 60e6
    }

    /// Predicted 1-sigma of the phase at a board time, µs, without that of the rig's constants.
    ///
    /// The correct position of the grid depends on the offset of the clocks at that time, whose
    /// uncertainty includes skew and warming, on how many frames of
    /// an uncertain period lie between, and on how far the grid's even pulses are from a rate that
    /// is known to change.
    #[must_use]
    pub fn phase_sigma_us_at(&self, at: BoardSeconds) -> f64 {
        let course = self.course();
        let offset_us = course.offset_sigma_at(at) * 1e6;
        offset_us
            .hypot(self.frames_sigma_us(at))
            .hypot(course.bend(self.anchor.into(), at) * 1e6)
    }

    /// [`Self::phase_sigma_us_at`] the current board time, increased by the change of the board's
    /// temperature (now given in °C) since the last twist, as if that had been even.
    #[must_use]
    pub fn phase_sigma_us_now(&self, now: BoardSeconds, temperature_c: Option<f64>) -> f64 {
        let temperatures = temperature_c.zip(self.board_temperature_c);
        let since = now.0 - self.clock.reference;
        self.phase_sigma_us_at(now)
            .hypot(by_temperature(temperatures) * since / 2.0 * 1e6)
    }

    /// Share of the phone's frames in [`Self::phase_sigma_us_at`], µs: the jitter of the one
    /// timestamp that the phone gave, and the number of frames of an uncertain period since.
    pub(crate) fn frames_sigma_us(&self, at: BoardSeconds) -> f64 {
        let since = at.0 - self.anchor.as_secs_f64();
        (self.frames.jitter_ns() * 1e-3).hypot(since * self.frames.relative_sigma() * 1e6)
    }

    /// Predicts the position of another phone's frames against the depth images of this grid.
    ///
    /// `course` relates the clock of that phone, `middle` is the middle of the exposure of one of
    /// its frames, `to_depth_s` the time from a trigger edge to the middle of a depth exposure, and
    /// `ratio` the number of reference frames per depth frame. The offset is counted from the
    /// nearest depth image, as if there were one for each frame of the reference phone.
    #[must_use]
    pub fn placement(
        &self,
        course: &Course,
        frames: &Frames,
        middle: PhoneSeconds,
        to_depth_s: f64,
        ratio: u32,
    ) -> Placement {
        let middle = course.clock.to_board(middle);
        let rate = course.rate_from(middle);
        let depth = BoardSeconds(self.anchor.as_secs_f64() + to_depth_s);
        let grid_s = self.period.as_secs_f64() / f64::from(ratio);
        let apart = middle.0 - depth.0;
        let own_s = frames.period_ns * 1e-9 / (1.0 + rate.skew);
        let offset_sigma_us = course.offset_sigma_at(middle) * 1e6;
        Placement {
            offset_us: (apart - (apart / grid_s).round() * grid_s) * 1e6,
            offset_sigma_us: offset_sigma_us.hypot(frames.jitter_ns() * 1e-3),
            drift_us_per_min: (own_s / grid_s - 1.0) * 60e6,
            drift_sigma_us_per_min: rate.sigma.hypot(frames.relative_sigma()) * 60e6,
        }
    }
}

/// Predicted position of a phone's frames against a grid that follows another phone; an
/// extraction measures it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Placement {
    /// Middle of exposure of the middle row minus that of the nearest depth image,
    /// at the phone's first frame, µs; within half a period of the grid.
    pub offset_us: f64,
    /// 1-sigma of the offset, µs.
    pub offset_sigma_us: f64,
    /// Drift of the offset, µs/min: the frame periods of the two phones differ.
    pub drift_us_per_min: f64,
    /// 1-sigma of the drift, µs/min.
    pub drift_sigma_us_per_min: f64,
}

impl Display for Placement {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "its frames are {:+.1} ± {:.1} µs from the depth images, moving by {:+.1} ± {:.1} \
             µs/min (1-sigma); they cannot be shifted",
            self.offset_us,
            self.offset_sigma_us,
            self.drift_us_per_min,
            self.drift_sigma_us_per_min
        )
    }
}
