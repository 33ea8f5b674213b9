//! Searches for the shift by whole periods at which the frames fit the pulses.
//!
//! Frames and pulses both get ordinals: time differences rounded to whole
//! periods and summed, so that a lost frame or pulse is a step of two. A
//! *shift* is the pulse ordinal that belongs to frame ordinal 0. At the right shift the
//! distances frame − pulse (modulo a period, since a phase jump of half a
//! period can be counted either way; unwrapped along time) are a slow
//! function of time ([`fit::smooth`]) plus the noise of the camera's tick. At a wrong
//! shift, the difference of the phases remains wherever the phase was moved.
//!
//! Shifts are compared by χ² over the frames that have a pulse at both, so that
//! where pulses are regular, all shifts cost the same and none wins by chance. A
//! frame before the first pulse is evidence against a shift (the camera waits for
//! pulses); a frame after the last one is not (the camera continues without them).
//!
//! All this assumes that the camera follows each pulse. When a pulse is later than expected
//! by more than the camera's waiting time, the camera may already have begun a frame: the
//! frames then follow the move one pulse late, which looks exactly like the next shift.
//! The waiting time is not documented. Where the trigger moved by more than
//! [`FOLLOWED`] at a time, the neighbours of the best shift therefore remain
//! candidates, whatever their χ².

use rayon::prelude::*;

use super::fit::{self, Smooth, median};
use super::{DEVICE_TICK_NS, MIN_FRAMES, MatchError, PulseTime};
use crate::time::{BoardNanos, DeviceNanos, PiecewiseMap};

/// Smallest χ² by which every other shift must fit worse for a decision.
const DECISIVE: f64 = 30.0;
/// Largest χ² of one frame.
const CAP: f64 = 100.0;
/// χ² of a frame before the first pulse.
const TOO_EARLY: f64 = 9.0;
/// Number of frames in the first, coarse comparison.
const COARSE: usize = 300;
/// Number of shifts on either side of the best that are always compared in full.
const NEAR: usize = 64;
/// Largest number of shifts that are compared in full.
const MAX_FULL: usize = 1000;
/// Largest number of times that the best shift may change during a comparison.
const ROUNDS: usize = 8;
/// Number of frames from which the shift implied by a clock relation is taken.
const AT_ANCHOR: usize = 1000;
/// Largest deviation of a pulse from its expected time that a camera is certain to
/// follow, ns: twice the usual slew.
const FOLLOWED: f64 = 200e3;
/// Standard deviation of a device time, ns: one tick, uniformly distributed.
pub(crate) const TICK_SIGMA: f64 = DEVICE_TICK_NS / 3.464_101_615;
/// Longest recording, ns: 30 days.
const MAX_SPAN: f64 = 30.0 * 86_400.0 * 1e9;
/// Largest ordinal; times beyond it are damaged.
const MAX_ORDINAL: i64 = 1 << 40;
/// Largest relative difference of the two periods.
const MAX_RATE_DIFFERENCE: f64 = 0.002;

/// The trains of frames and pulses, with an ordinal for each.
#[derive(Clone, Debug)]
pub(crate) struct Trains {
    /// Period of the pulses, ns.
    pub(super) period: f64,
    /// Period of the frames, ns of the device.
    frame_period: f64,
    /// (ordinal, distance from the first frame in ns of the device), in time order.
    frames: Vec<(i64, f64)>,
    /// Distance of the pulse at each ordinal from the first pulse, ns.
    pulses: Vec<Option<f64>>,
    /// Distance of each pulse from the first one, in order, ns.
    pub(super) pulse_times: Vec<f64>,
    /// Ordinal of each pulse.
    ordinals: Vec<i64>,
    /// True if there were pulses before the first recorded one, so that frames may be
    /// earlier than it.
    pub(super) earlier_pulses: bool,
    /// True if the trigger moved faster than a camera is certain to follow.
    pub(super) moved_fast: bool,
    /// Device time of the first frame.
    pub(super) device_zero: DeviceNanos,
    /// Board time of the first pulse.
    pub(super) board_zero: BoardNanos,
}

/// Result of the search.
#[derive(Clone, Debug)]
pub(crate) struct Found {
    /// The best shift.
    pub(crate) best: i64,
    /// All shifts that cannot be distinguished from it, itself included.
    pub(crate) left: Vec<i64>,
    /// χ² of the next best shift less that of the best.
    pub(crate) margin: f64,
    /// Robust standard deviation at the best shift, ns.
    pub(crate) scatter: f64,
}

/// Fit at one shift.
#[derive(Clone, Debug)]
pub(crate) struct Fitted {
    /// Frame − pulse (as distances, frame scaled by the ratio of the periods)
    /// against the frame's scaled distance.
    pub(crate) smooth: Smooth,
    /// Robust standard deviation, ns.
    pub(crate) scatter: f64,
}

impl Trains {
    /// Counts frames and pulses in whole periods.
    ///
    /// # Errors
    ///
    /// Fails if the camera did not run at the rate of the pulses.
    pub(crate) fn new(frames: &[DeviceNanos], pulses: &[PulseTime]) -> Result<Self, MatchError> {
        let mut order: Vec<DeviceNanos> = frames.to_vec();
        order.sort_unstable();
        // A stamp days away from the others is damaged; it must not
        // stretch the fit over that time.
        let middle = order.get(order.len() / 2).copied().unwrap_or_default();
        order.retain(|at| distance(at.0, middle.0).abs() <= MAX_SPAN / 2.0);
        let zero = order.first().copied().unwrap_or_default();
        let board_zero = pulses.first().map_or(BoardNanos(0), |pulse| pulse.at);
        let times: Vec<f64> = order.iter().map(|at| distance(at.0, zero.0)).collect();
        let pulse_times: Vec<f64> = pulses
            .iter()
            .map(|pulse| distance(pulse.at.0, board_zero.0))
            .collect();
        let frame_period = median(steps(&times));
        let period = median(steps(&pulse_times));
        // Compared this way round so that a period that is not a number fails too.
        let plausible = (frame_period / period - 1.0).abs() < MAX_RATE_DIFFERENCE;
        if !plausible {
            return Err(MatchError::OtherRate {
                frame_period_us: frame_period / 1e3,
                pulse_period_us: period / 1e3,
            });
        }
        let frame_ordinals = ordinals(&times, frame_period);
        let ordinals = ordinals(&pulse_times, period);
        // The median is accurate to a tick of the camera only.
        let frame_period = mean_period(&frame_ordinals, &times).unwrap_or(frame_period);
        let period = mean_period(&ordinals, &pulse_times).unwrap_or(period);
        let moved_fast = moved_fast(&ordinals, &pulse_times, period);
        let length = ordinals.last().map_or(0, |&last| last + 1);
        // Hostile times must not claim memory: beyond this length, pulses are too far
        // apart to be one recording.
        let length = usize::try_from(length)
            .unwrap_or(0)
            .min(pulses.len() * 64 + 1_000_000);
        let mut at_ordinal = vec![None; length];
        for (&ordinal, &time) in ordinals.iter().zip(&pulse_times) {
            if let Some(slot) = usize::try_from(ordinal)
                .ok()
                .and_then(|o| at_ordinal.get_mut(o))
            {
                *slot = Some(time);
            }
        }
        Ok(Self {
            period,
            frame_period,
            frames: frame_ordinals.into_iter().zip(times).collect(),
            pulses: at_ordinal,
            pulse_times,
            ordinals,
            earlier_pulses: pulses.first().is_some_and(|pulse| pulse.number > 0),
            moved_fast,
            device_zero: zero,
            board_zero,
        })
    }

    /// Returns the distance of the last frame from the first, ns of the device.
    pub(super) fn end(&self) -> f64 {
        self.frames.last().map_or(0.0, |frame| frame.1)
    }

    /// Returns the board nanoseconds per device nanosecond, from the periods.
    pub(super) fn ratio(&self) -> f64 {
        self.period / self.frame_period
    }

    fn pulse(&self, ordinal: i64) -> Option<f64> {
        let slot = usize::try_from(ordinal).ok()?;
        self.pulses.get(slot).copied().flatten()
    }

    /// Returns (scaled distance of the frame, frame − pulse, periods subtracted from it)
    /// for the frames that have a pulse at a shift.
    ///
    /// In order of time, each frame gets the number of periods that puts it nearest to
    /// those before it.
    fn points(&self, shift: i64, stride: usize) -> Vec<(f64, f64, f64)> {
        let ratio = self.ratio();
        let mut near = None;
        let mut points = Vec::with_capacity(self.frames.len() / stride + 1);
        for frame in self.frames.iter().step_by(stride) {
            let Some(pulse) = self.pulse(frame.0 + shift) else {
                continue;
            };
            let x = frame.1 * ratio;
            let raw = x - pulse;
            let near = near.get_or_insert(raw - (raw / self.period).round() * self.period);
            let turns = ((raw - *near) / self.period).round();
            let y = raw - turns * self.period;
            *near += 0.25 * (y - *near);
            points.push((x, y, turns));
        }
        points
    }

    /// Returns the whole periods, ns, to add to `scaled − smooth(scaled)` for the pulse's
    /// distance, as they are at the first frames.
    pub(super) fn base(&self, shift: i64) -> f64 {
        let turns = self
            .points(shift, 1)
            .iter()
            .take(15)
            .map(|point| point.2)
            .collect();
        -median(turns) * self.period
    }

    /// Fits all frames at a shift.
    pub(crate) fn fit(&self, shift: i64) -> Fitted {
        self.fit_points(&self.points(shift, 1))
    }

    fn fit_points(&self, points: &[(f64, f64, f64)]) -> Fitted {
        let pairs: Vec<(f64, f64)> = points.iter().map(|&(x, y, _)| (x, y)).collect();
        let Some(smooth) = fit::smooth(&pairs, TICK_SIGMA) else {
            return Fitted {
                smooth: Smooth::default(),
                scatter: f64::INFINITY,
            };
        };
        let distances = pairs
            .iter()
            .map(|&(x, y)| (y - smooth.at(x)).abs())
            .collect();
        Fitted {
            smooth,
            scatter: 1.4826 * median(distances),
        }
    }

    /// Returns the index of the first pulse at or after an ordinal; the ordinal itself if it
    /// is negative, that is before the first pulse.
    pub(super) fn index_of(&self, ordinal: i64) -> i64 {
        if ordinal < 0 {
            return ordinal;
        }
        self.ordinals.partition_point(|&o| o < ordinal) as i64
    }

    /// Returns the shift at which frame ordinal 0 has this pulse.
    pub(super) fn shift_of_pulse(&self, index: usize) -> Option<i64> {
        self.ordinals.get(index).copied()
    }

    /// Returns the shift implied by a clock relation: the median over the frames nearest to
    /// `around`, where the relation is most accurate.
    pub(super) fn shift_by_clock(
        &self,
        map: &PiecewiseMap<DeviceNanos, BoardNanos>,
        around: DeviceNanos,
        center: i64,
    ) -> Option<i64> {
        let at = distance(around.0, self.device_zero.0);
        let anchor = self.frames.partition_point(|frame| frame.1 < at);
        let start = anchor
            .saturating_sub(AT_ANCHOR / 2)
            .min(self.frames.len().saturating_sub(AT_ANCHOR));
        let near = self.frames.iter().skip(start).take(AT_ANCHOR);
        let shifts = near.filter_map(|&(ordinal, time)| {
            let device = DeviceNanos(self.device_zero.0.saturating_add(time as i64));
            let board = map.apply(device)?.0.saturating_sub(center);
            let (pulse, after) = self.nearest_pulse(distance(board, self.board_zero.0));
            let is_near = after.abs() < self.period * 0.5;
            is_near.then(|| (self.ordinals[pulse] - ordinal) as f64)
        });
        let shifts: Vec<f64> = shifts.collect();
        (!shifts.is_empty()).then(|| median(shifts) as i64)
    }

    /// Returns the index of the pulse nearest to a distance from the first one, and the
    /// distance from that pulse, ns.
    pub(super) fn nearest_pulse(&self, time: f64) -> (usize, f64) {
        let distance = |index: usize| time - self.pulse_times[index];
        let after = self.pulse_times.partition_point(|&pulse| pulse < time);
        let left = after.saturating_sub(1);
        let right = after.min(self.pulse_times.len() - 1);
        if distance(left).abs() <= distance(right).abs() {
            (left, distance(left))
        } else {
            (right, distance(right))
        }
    }

    /// Returns the shifts at which at least half of the frames, or half as many as there are
    /// pulses if that is fewer, lie within the pulses: a camera continues without them.
    fn shifts(&self) -> std::ops::Range<i64> {
        let frames = self.frames.last().map_or(0, |frame| frame.0);
        let pulses = self.pulses.len() as i64;
        let half = frames.min(pulses) / 2;
        let early = if self.earlier_pulses {
            -half
        } else {
            -(half.min(30))
        };
        early..(pulses - half).max(early + 1)
    }

    /// Returns the distance of each frame from its pulse at a shift.
    fn distances(&self, shift: i64, stride: usize) -> Distances {
        let points = self.points(shift, stride);
        if points.len() < MIN_FRAMES {
            return Distances::default();
        }
        let fitted = self.fit_points(&points);
        let mut points = points.into_iter();
        let frames = self.frames.iter().step_by(stride).map(|frame| {
            let ordinal = frame.0 + shift;
            if self.pulse(ordinal).is_none() {
                let early = ordinal < 0 && !self.earlier_pulses;
                return if early {
                    Place::TooEarly
                } else {
                    Place::NoPulse
                };
            }
            points.next().map_or(Place::NoPulse, |(x, y, _)| {
                Place::Distance((y - fitted.smooth.at(x)) as f32)
            })
        });
        Distances {
            frames: frames.collect(),
            scatter: fitted.scatter,
        }
    }
}

/// Place of a frame at one shift.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    /// Before the first pulse that the camera can have received.
    TooEarly,
    /// Where no pulse is recorded.
    NoPulse,
    /// Distance from the pulse on the fitted clock, ns.
    Distance(f32),
}

impl Place {
    fn cost(self, sigma: f64) -> Option<f64> {
        match self {
            Self::TooEarly => Some(TOO_EARLY),
            Self::NoPulse => None,
            Self::Distance(distance) => {
                let ratio = f64::from(distance) / sigma;
                Some((ratio * ratio).min(CAP))
            }
        }
    }
}

#[derive(Clone, Debug, Default)]
struct Distances {
    frames: Vec<Place>,
    scatter: f64,
}

/// Returns χ² of `other` less that of `best`, over the frames that have a pulse at both.
fn excess_cost(best: &Distances, other: &Distances, sigma: f64) -> f64 {
    if other.frames.is_empty() {
        return f64::INFINITY;
    }
    best.frames
        .iter()
        .zip(&other.frames)
        .map(|(best, other)| match (best, other) {
            // Impossible at one of the shifts, and without a pulse at the other.
            (Place::NoPulse, Place::TooEarly) => TOO_EARLY,
            (Place::TooEarly, Place::NoPulse) => -TOO_EARLY,
            _ => match (best.cost(sigma), other.cost(sigma)) {
                (Some(best), Some(other)) => other - best,
                _ => 0.0,
            },
        })
        .sum()
}

/// Searches for the best shift, and keeps those that a late camera could also mean.
pub(crate) fn search(trains: &Trains) -> Found {
    let mut found = search_all(trains);
    if trains.moved_fast {
        for shift in [found.best - 1, found.best + 1] {
            if !found.left.contains(&shift) {
                found.left.push(shift);
            }
        }
    }
    found
}

fn search_all(trains: &Trains) -> Found {
    let stride = trains.frames.len().div_ceil(COARSE);
    let start = trains.shifts().start;
    let coarse: Vec<Distances> = trains
        .shifts()
        .into_par_iter()
        .map(|shift| trains.distances(shift, stride))
        .collect();
    // The noise is unknown as long as the shift is: the smallest scatter of all
    // stands for it, and never less than the tick's.
    let by_scatter = |a: &&Distances, b: &&Distances| a.scatter.total_cmp(&b.scatter);
    let smallest = coarse
        .iter()
        .filter(|c| !c.frames.is_empty())
        .min_by(by_scatter);
    let sigma = smallest.map_or(TICK_SIGMA, |c| c.scatter.max(TICK_SIGMA));
    let is_smallest = |c: &Distances| smallest.is_some_and(|s| std::ptr::eq(s, c));
    let mut best = coarse.iter().position(is_smallest).unwrap_or(0);
    let mut costs = Vec::new();
    for _ in 0..ROUNDS {
        costs = coarse
            .par_iter()
            .map(|c| excess_cost(&coarse[best], c, sigma))
            .collect();
        match costs.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1)) {
            Some((better, cost)) if *cost < 0.0 && better != best => best = better,
            _ => break,
        }
    }
    let close = |limit: f64, near: usize| -> Vec<i64> {
        costs
            .iter()
            .enumerate()
            .filter(|&(index, cost)| *cost < limit || index.abs_diff(best) <= near)
            .map(|(index, _)| start + index as i64)
            .collect()
    };
    let best = start + best as i64;
    let full = close(2.0 * DECISIVE, NEAR);
    if full.len() > MAX_FULL {
        // A train so regular that comparing them all in full cannot decide.
        return Found {
            best,
            left: close(DECISIVE, 0),
            margin: 0.0,
            scatter: trains.fit(best).scatter,
        };
    }
    compare_in_full(trains, &full, best, sigma)
}

/// Compares the remaining shifts over all frames.
fn compare_in_full(trains: &Trains, shifts: &[i64], mut best: i64, sigma: f64) -> Found {
    let mut costs: Vec<(i64, f64)> = Vec::new();
    for _ in 0..ROUNDS {
        let reference = trains.distances(best, 1);
        costs = shifts
            .par_iter()
            .map(|&shift| {
                (
                    shift,
                    excess_cost(&reference, &trains.distances(shift, 1), sigma),
                )
            })
            .collect();
        match costs.iter().min_by(|a, b| a.1.total_cmp(&b.1)) {
            Some(&(shift, cost)) if cost < 0.0 && shift != best => best = shift,
            _ => break,
        }
    }
    let others = costs.iter().filter(|(shift, _)| *shift != best);
    let margin = others.map(|(_, cost)| *cost).fold(f64::INFINITY, f64::min);
    let left = costs
        .iter()
        .filter(|(shift, cost)| *shift == best || *cost < DECISIVE)
        .map(|(shift, _)| *shift)
        .collect();
    Found {
        best,
        left,
        margin,
        scatter: trains.fit(best).scatter,
    }
}

/// Returns `a − b` of two times in ns, without overflow.
pub(crate) fn distance(a: i64, b: i64) -> f64 {
    (i128::from(a) - i128::from(b)) as f64
}

fn steps(times: &[f64]) -> Vec<f64> {
    times
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .filter(|step| *step > 0.0)
        .collect()
}

/// Returns true if two successive pulses are farther from whole periods than a camera is
/// certain to follow.
fn moved_fast(ordinals: &[i64], times: &[f64], period: f64) -> bool {
    ordinals.windows(2).zip(times.windows(2)).any(|(o, t)| {
        let steps = (o[1] - o[0]) as f64;
        // The period is a mean over the recording: allow for its error in a long pause.
        let allowed = FOLLOWED + 1e-6 * steps * period;
        (t[1] - t[0] - steps * period).abs() > allowed
    })
}

/// Returns the mean period: the slope of a robust line through (ordinal, time).
fn mean_period(ordinals: &[i64], times: &[f64]) -> Option<f64> {
    let points: Vec<(f64, f64)> = ordinals
        .iter()
        .map(|&o| o as f64)
        .zip(times.iter().copied())
        .collect();
    let period = fit::robust_line(&points)?;
    (period.is_finite() && period > 0.0).then_some(period)
}

/// Returns the time differences in whole periods, summed. Times closer than a quarter of
/// a period get the same ordinal.
fn ordinals(times: &[f64], period: f64) -> Vec<i64> {
    let mut ordinal = 0_i64;
    let mut last = times.first().copied().unwrap_or(0.0);
    times
        .iter()
        .map(|&time| {
            let step = (time - last) / period;
            if step > 0.25 {
                ordinal = (ordinal + (step.round() as i64).clamp(1, MAX_ORDINAL)).min(MAX_ORDINAL);
                last = time;
            }
            ordinal
        })
        .collect()
}
