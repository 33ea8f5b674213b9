//! Matches depth frames to the trigger pulses that made them.
//!
//! The camera stamps a frame with the centre of its exposure on its own clock
//! (90 kHz, hundreds of ppm off, unknown zero); the board knows the pulses to the
//! tick. Frames are lost at the start, in between and at the end, so counting
//! from the first is wrong. They are matched *by time* instead:
//!
//! 1. The pattern of the pulses (a change of phase during alignment, a pause, a
//!    missing pulse) is searched for in the frames, at every shift by whole
//!    periods ([`pattern`]). Offset and rate, with the slow wander of the
//!    camera's clock, are fitted robustly at each ([`fit`]).
//! 2. A perfectly periodic train fits equally well at every shift. Nothing is
//!    guessed then: unless a [`Hint`] (from the camera's gyroscope, a recorded
//!    offset or the user) singles out one shift, the result is
//!    [`MatchError::Ambiguous`] with the shifts that remain.
//! 3. At the known shift every frame gets the pulse nearest to it
//!    ([`assign`]). Its board time is the pulse's edge plus the mode's
//!    edge-to-centre time, exact to a tick and independent of the camera's clock.
//!
//! Pulses and frames are compared in f64 nanoseconds relative to the first of
//! each (exact for 104 days); the resulting timestamps are integers of the
//! board's clock and never pass through a float.
//!
//! Limits: the frame rate is that of the pulses (not a fraction of it); more than
//! half of the frames have a pulse in the recording, or more than half of the pulses
//! a frame; there are at least [`MIN_FRAMES`] of each.

mod assign;
pub(crate) mod fit;
mod pattern;

pub(crate) use self::assign::{Assignment, FrameState};
use self::pattern::Trains;

use std::fmt;

use crate::time::{BoardNanos, DeviceNanos, PiecewiseMap};

/// Fewest frames, and fewest pulses, that are matched.
pub(crate) const MIN_FRAMES: usize = 10;

/// Period of the camera's 90 kHz clock, ns.
pub(crate) const DEVICE_TICK_NS: f64 = 1e9 / 90_000.0;

/// A trigger pulse as recorded by the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PulseTime {
    /// Number of its train.
    pub(crate) train: u32,
    /// Number in the train, from 0.
    pub(crate) number: u64,
    /// Board time of the rising edge.
    pub(crate) at: BoardNanos,
    /// Phone time of the edge, ns, by the relation that was known then; 0 if there was none.
    pub(crate) phone: i64,
}

/// Independent evidence that singles out one shift by whole periods.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Hint {
    /// A relation of the two clocks.
    Clock {
        /// Origin of the relation.
        source: HintSource,
        /// Device time to board time.
        map: PiecewiseMap<DeviceNanos, BoardNanos>,
        /// Instant at which the relation is most accurate.
        around: DeviceNanos,
        /// Standard deviation of the relation there, ns, constant errors included.
        sigma: f64,
        /// Time from pulse to centre of exposure, ns.
        center: i64,
    },
    /// The user's statement: index, in the list of pulses, of the first frame's pulse.
    FirstPulse(usize),
}

/// Origin of a [`Hint`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HintSource {
    /// The index of the first frame's pulse that the user gave.
    User,
    /// The camera's gyroscope against the board's.
    CameraGyroscope,
    /// The clock offset that the published system recorded.
    RecordedOffset,
}

impl fmt::Display for HintSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::User => "the user",
            Self::CameraGyroscope => "the camera's gyroscope",
            Self::RecordedOffset => "the recorded offset",
        })
    }
}

/// Evidence that decided between the shifts by whole periods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decision {
    /// The pattern of the pulses alone.
    Pattern {
        /// χ² of the next best shift less that of the best; infinite without another shift.
        margin: f64,
    },
    /// A hint, with which the pattern agrees without being decisive.
    Hint {
        /// Origin of the hint.
        source: HintSource,
        /// Number of shifts that the pattern left open; 0 if the pattern was not used.
        left: usize,
    },
}

impl fmt::Display for Decision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Pattern { margin } if margin.is_finite() => {
                write!(f, "the pattern of the pulses (χ² margin {margin:.0})")
            }
            Self::Pattern { .. } => f.write_str("the pattern of the pulses"),
            Self::Hint { source, left: 0 } => source.fmt(f),
            Self::Hint { source, left } => write!(f, "{source} (of {left} possible shifts)"),
        }
    }
}

/// Depth frames matched to pulses.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DepthMatch {
    /// One assignment for each frame, in the given order.
    pub(crate) frames: Vec<Assignment>,
    /// Indices of pulses without a frame, between the first and the last matched one.
    pub(crate) missing: Vec<usize>,
    /// Evidence for the shift.
    pub(crate) decision: Decision,
    /// Rate of the camera's clock relative to the board's, minus one.
    pub(crate) rate_error: f64,
    /// 1-sigma of the rate.
    pub(crate) rate_sigma: f64,
    /// Robust standard deviation of frame time minus pulse time, ns.
    pub(crate) residual: f64,
    /// Map from device time to *pulse* time (the edge-to-centre time is yet to be added).
    pub(crate) clock: PiecewiseMap<DeviceNanos, BoardNanos>,
}

/// Reason why frames and pulses were not matched.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MatchError {
    /// There are too few frames or pulses.
    #[error(
        "{frames} depth frames and {pulses} pulses cannot be matched; expected at least {MIN_FRAMES} of each"
    )]
    TooFew {
        /// Number of frames.
        frames: usize,
        /// Number of pulses.
        pulses: usize,
    },
    /// The camera did not run at the rate of the pulses.
    #[error(
        "the depth camera runs at {frame_period_us:.1} µs a frame and the trigger at {pulse_period_us:.1} µs; \
         it did not follow the trigger (check the sync cable and `--external-sync sub`)"
    )]
    OtherRate {
        /// Median frame period on the camera's clock, µs.
        frame_period_us: f64,
        /// Median distance of pulses, µs.
        pulse_period_us: f64,
    },
    /// The frames scatter around the pulses.
    #[error(
        "the depth frames do not follow the pulses: they scatter by {scatter_us:.0} µs around them at best; \
         the camera ran free, or the files belong to different recordings"
    )]
    NotFollowing {
        /// Robust scatter at the best shift, µs.
        scatter_us: f64,
    },
    /// Several shifts by whole periods fit equally well.
    #[error(
        "which pulse made the first depth frame is ambiguous: {}, so {} shifts by whole periods \
         cannot be told apart (first frame at pulse {} to {}); {}; start the depth recorder before the trigger is aligned and with a slew of 200 µs or \
         less, or give the pulse with --first-pulse",
        .0.why(), .0.shifts, .0.first, .0.last, .0.about_imu()
    )]
    Ambiguous(Ambiguity),
    /// The camera was not configured to follow the trigger.
    #[error(
        "the depth camera was recorded as {sync} (its file's K4A_WIRED_SYNC_MODE; expected SUBORDINATE): \
         no pulse made its frames, and nothing else times them; check the sync cable and record with \
         `--external-sync sub`"
    )]
    OtherSync {
        /// Sync mode that the file states.
        sync: String,
    },
    /// Pattern and hint contradict each other.
    #[error(
        "the pattern of the pulses puts the first depth frame at pulse {pattern}, but {by} \
         says pulse {hint}; not guessing between them"
    )]
    Conflict {
        /// Index of the first frame's pulse by the pattern.
        pattern: i64,
        /// Index of the first frame's pulse by the hint.
        hint: i64,
        /// Origin of the hint.
        by: HintSource,
    },
}

/// Shifts that fit equally well.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ambiguity {
    /// Number of shifts.
    pub shifts: usize,
    /// Index of the first frame's pulse at the smallest shift.
    pub first: i64,
    /// Index of the first frame's pulse at the largest shift.
    pub last: i64,
    /// True if the trigger moved faster than a camera is certain to follow, so that a
    /// neighbouring shift cannot be ruled out.
    pub moved_fast: bool,
    /// True if the recording has samples of the camera's IMU, which did not settle it.
    pub has_imu: bool,
}

impl Ambiguity {
    const fn about_imu(self) -> &'static str {
        if self.has_imu {
            "the camera's gyroscope does not tell them apart either (it needs some seconds of turning by hand)"
        } else {
            "record with the camera's IMU on"
        }
    }

    const fn why(self) -> &'static str {
        if self.moved_fast {
            "the trigger moved by more than 200 µs at a time, which a camera may follow a frame late"
        } else {
            "the pulses are too regular"
        }
    }
}

/// Matches depth frames to pulses.
///
/// `frames` are device times in the order of the file; `pulses` are sorted by time.
///
/// # Errors
///
/// Returns a [`MatchError`] rather than a guess.
pub(crate) fn match_frames(
    frames: &[DeviceNanos],
    pulses: &[PulseTime],
    hint: Option<Hint>,
) -> Result<DepthMatch, MatchError> {
    if frames.len() < MIN_FRAMES || pulses.len() < MIN_FRAMES {
        return Err(MatchError::TooFew {
            frames: frames.len(),
            pulses: pulses.len(),
        });
    }
    let trains = Trains::new(frames, pulses)?;
    let found = pattern::search(&trains);
    if found.scatter > trains.period * 0.1 {
        return Err(MatchError::NotFollowing {
            scatter_us: found.scatter / 1000.0,
        });
    }
    let (shift, decision) = decide(&trains, &found, hint)?;
    let fitted = trains.fit(shift);
    Ok(assign::assign(&trains, shift, &fitted, frames, decision))
}

/// Returns the shift that pattern and hint agree on.
fn decide(
    trains: &Trains,
    found: &pattern::Found,
    hint: Option<Hint>,
) -> Result<(i64, Decision), MatchError> {
    let hinted = match hint {
        None => None,
        Some(Hint::FirstPulse(index)) => {
            let shift = trains.shift_of_pulse(index);
            shift.map(|shift| (shift, HintSource::User))
        }
        // A hint coarser than a sixth of a period is not reliable.
        Some(Hint::Clock { sigma, .. }) if sigma >= trains.period / 6.0 => None,
        Some(Hint::Clock {
            source,
            map,
            around,
            center,
            ..
        }) => {
            let shift = trains.shift_by_clock(&map, around, center);
            shift.map(|shift| (shift, source))
        }
    };
    let unique = found.left.len() == 1;
    match hinted {
        Some((shift, by)) if !found.left.contains(&shift) => Err(MatchError::Conflict {
            pattern: trains.index_of(found.best),
            hint: trains.index_of(shift),
            by,
        }),
        Some((shift, source)) if !unique => Ok((
            shift,
            Decision::Hint {
                source,
                left: found.left.len(),
            },
        )),
        _ if unique => Ok((
            found.best,
            Decision::Pattern {
                margin: found.margin,
            },
        )),
        _ => Err(MatchError::Ambiguous(Ambiguity {
            shifts: found.left.len(),
            first: trains.index_of(found.left.iter().copied().min().unwrap_or(found.best)),
            last: trains.index_of(found.left.iter().copied().max().unwrap_or(found.best)),
            moved_fast: trains.moved_fast,
            has_imu: false,
        })),
    }
}

#[cfg(test)]
mod tests;
