//! The depth camera's clock: which frame was made by which trigger pulse.
//!
//! The camera stamps a frame with the centre of its exposure in its own clock
//! (90 kHz, hundreds of ppm off, unknown zero); the board knows the pulses to the
//! tick. Frames are lost at the start, in between and at the end, so counting
//! from the first is wrong. Here they are matched *by time*:
//!
//! 1. The pattern of the pulses (a change of phase during alignment, a pause, a
//!    missing pulse) is looked for in the frames, at every shift by whole
//!    periods ([`pattern`]). Offset and rate, with the slow wander of the
//!    camera's clock, are fitted robustly at each ([`fit`]).
//! 2. A perfectly periodic train fits at every shift alike. That is not
//!    guessed away: unless something else tells the shifts apart (a [`Hint`], from
//!    the camera's gyroscope or from the user), the answer is
//!    [`MatchError::Ambiguous`] with the shifts that remain.
//! 3. With the shift known, every frame takes the pulse next to it
//!    ([`assign`]); its time in board time is the pulse's edge plus the mode's
//!    edge-to-centre time, exact to a tick and free of the camera's clock.
//!
//! Pulses and frames are compared in f64 nanoseconds relative to the first of
//! each (exact for 104 days); the timestamps that come out are integers of the
//! board and never were floats.
//!
//! Limits: the frame rate is that of the pulses (not a fraction of it); more than
//! half of the frames have a pulse in the recording, or more than half of the pulses
//! a frame; at least [`MIN_FRAMES`].

pub(crate) mod assign;
pub(crate) mod fit;
pub(crate) mod pattern;

pub(crate) use assign::{Assignment, FrameState};

use crate::time::{BoardNanos, DeviceNanos, PiecewiseMap};

/// Fewest frames and pulses that are matched.
pub(crate) const MIN_FRAMES: usize = 10;

/// Tick of the camera's clock: 90 kHz.
pub(crate) const DEVICE_TICK_NS: f64 = 1e9 / 90_000.0;

/// A trigger pulse as recorded by the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PulseTime {
    /// The train it belongs to.
    pub(crate) train: u32,
    /// Its number in the train, from 0.
    pub(crate) number: u64,
    /// Rising edge.
    pub(crate) at: BoardNanos,
}

/// Something that tells shifts by whole periods apart.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Hint {
    /// A relation of the clocks found by other means.
    Clock {
        /// Device time to board time.
        map: PiecewiseMap<DeviceNanos, BoardNanos>,
        /// Where it is known best.
        around: DeviceNanos,
        /// Its standard deviation in ns, with all constant errors.
        sigma: f64,
        /// From pulse to centre of exposure, in ns.
        center: i64,
    },
    /// The index (into the list of pulses) of the first frame's pulse.
    FirstPulse(usize),
}

/// What decided between shifts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Decision {
    /// The pattern of the pulses alone. `margin` is by how much the next best
    /// shift fits worse (χ²).
    Pattern {
        /// χ² of the next best shift less that of the best.
        margin: f64,
    },
    /// The hint; the pattern agrees with it but does not decide alone.
    Hint {
        /// How many shifts the pattern left.
        left: usize,
    },
}

/// Frames with their pulses.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DepthMatch {
    /// One for each frame, in the order given.
    pub(crate) frames: Vec<Assignment>,
    /// Indices of pulses between the first and last matched one that have no frame.
    pub(crate) missing: Vec<usize>,
    /// What decided.
    pub(crate) decision: Decision,
    /// Rate of the camera's clock against the board's, minus one.
    pub(crate) rate_error: f64,
    /// 1-sigma of the rate.
    pub(crate) rate_sigma: f64,
    /// Robust standard deviation of frame time against pulse, in ns.
    pub(crate) residual: f64,
    /// Device time to *pulse* time (add the edge-to-centre time), in pieces.
    pub(crate) clock: PiecewiseMap<DeviceNanos, BoardNanos>,
}

/// Why frames and pulses were not matched.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum MatchError {
    /// Not enough to work with.
    #[error(
        "{frames} depth frames and {pulses} pulses cannot be matched; expected at least {MIN_FRAMES} of each"
    )]
    TooFew {
        /// Frames.
        frames: usize,
        /// Pulses.
        pulses: usize,
    },
    /// The camera did not run at the rate of the pulses.
    #[error(
        "the depth camera runs at {frame_period_us:.1} µs a frame and the trigger at {pulse_period_us:.1} µs; \
         it did not follow the trigger (check the sync cable and `--external-sync sub`)"
    )]
    OtherRate {
        /// Median frame period, µs of the device.
        frame_period_us: f64,
        /// Median distance of pulses, µs.
        pulse_period_us: f64,
    },
    /// Frames scatter around the pulses.
    #[error(
        "the depth frames do not follow the pulses: they scatter by {scatter_us:.0} µs around them at best; \
         the camera ran free, or the files belong to different recordings"
    )]
    NotFollowing {
        /// Robust scatter of the best shift, µs.
        scatter_us: f64,
    },
    /// Several shifts by whole periods fit alike.
    #[error(
        "which pulse made the first depth frame is ambiguous: {}, so {} shifts by whole periods \
         cannot be told apart (first frame at pulse {} to {}); {}; start the depth recorder before the trigger is aligned and with a slew of 200 µs or \
         less, or give the pulse with --first-pulse",
        .0.why(), .0.shifts, .0.first, .0.last, .0.about_imu()
    )]
    Ambiguous(Ambiguity),
    /// The camera was not told to follow the trigger.
    #[error(
        "the depth camera was recorded as {sync} (its file's K4A_WIRED_SYNC_MODE; expected SUBORDINATE): \
         no pulse made its frames, and nothing else times them; check the sync cable and record with \
         `--external-sync sub`"
    )]
    OtherSync {
        /// The sync mode.
        sync: String,
    },
    /// Pattern and hint contradict each other.
    #[error(
        "the pattern of the pulses puts the first depth frame at pulse {pattern}, but {by} \
         says pulse {hint}; not guessing between them"
    )]
    Conflict {
        /// Pulse index by the pattern.
        pattern: i64,
        /// Pulse index by the hint.
        hint: i64,
        /// Where the hint came from.
        by: &'static str,
    },
}

/// The shifts that remain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ambiguity {
    /// How many shifts.
    pub(crate) shifts: usize,
    /// Pulse index of the first frame at the smallest of them.
    pub(crate) first: i64,
    /// The same at the largest.
    pub(crate) last: i64,
    /// The trigger moved faster than a camera follows for certain, so that a
    /// neighbouring shift cannot be ruled out.
    pub(crate) moved_fast: bool,
    /// The recording has the camera's IMU, and its gyroscope does not tell either.
    pub(crate) has_imu: bool,
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
/// `frames` are device times in the order of the file; `pulses` are sorted by
/// time.
///
/// # Errors
///
/// See [`MatchError`]: nothing is guessed.
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
    let grid = pattern::Grid::new(frames, pulses)?;
    let found = pattern::search(&grid);
    if found.scatter > grid.period * 0.1 {
        return Err(MatchError::NotFollowing {
            scatter_us: found.scatter / 1000.0,
        });
    }
    let (shift, decision) = decide(&grid, &found, hint)?;
    let fitted = grid.fit(shift);
    Ok(assign::assign(&grid, shift, &fitted, frames, decision))
}

fn decide(
    grid: &pattern::Grid,
    found: &pattern::Found,
    hint: Option<Hint>,
) -> Result<(i64, Decision), MatchError> {
    let hinted = match hint {
        None => None,
        Some(Hint::FirstPulse(index)) => {
            grid.shift_of_pulse(index).map(|shift| (shift, "the user"))
        }
        // A hint that is coarser than a sixth of a period tells nothing reliably.
        Some(Hint::Clock { sigma, .. }) if sigma >= grid.period / 6.0 => None,
        Some(Hint::Clock {
            map,
            around,
            center,
            ..
        }) => {
            let shift = grid.shift_by_clock(&map, around, center);
            shift.map(|shift| (shift, "the camera's gyroscope"))
        }
    };
    let unique = found.left.len() == 1;
    match hinted {
        Some((shift, by)) if !found.left.contains(&shift) => Err(MatchError::Conflict {
            pattern: grid.index_of(found.best),
            hint: grid.index_of(shift),
            by,
        }),
        Some((shift, _)) if !unique => Ok((
            shift,
            Decision::Hint {
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
            first: grid.index_of(found.left.iter().copied().min().unwrap_or(found.best)),
            last: grid.index_of(found.left.iter().copied().max().unwrap_or(found.best)),
            moved_fast: grid.moved_fast,
            has_imu: false,
        })),
    }
}

#[cfg(test)]
mod tests;
