//! From a run that is matched to the next one, by the camera's clock.

use super::{FLOOR, Part, Recording, Run, RunError, relation};
use crate::depth_clock::fit::{self, median};
use crate::depth_clock::pattern::{TICK_SIGMA, distance};
use crate::depth_clock::{Assignment, FrameState, Hint, MIN_FRAMES, MatchError, match_running};
use crate::time::{AffineMap, BoardNanos, DeviceNanos};

/// 1-sigma of how the camera's clock may change its rate over a gap: a crystal's with
/// temperature.
const DRIFT: f64 = 1e-6;
/// A prediction must be known so much better than a period.
const PER_PERIOD: f64 = 12.0;
/// Sigmas that a prediction may be off.
const SIGMAS: f64 = 5.0;
/// How far the rates of two runs may be apart, beyond their uncertainties.
const RATE_MARGIN: f64 = 5e-6;
/// Share of the frames within a run that must have a pulse.
const FOLLOWING: f64 = 0.8;
/// Frames next to a gap that show whether a prediction came true.
const NEAR: usize = 150;
/// Frames on each side of where the camera takes up the pulses. A board needs longer to
/// start again, so those in front are the camera's own.
const AROUND: usize = 12;
/// So many frames from the first pulse it is looked whether that is elsewhere.
const REACH: usize = 60;
/// So many frames may a camera need to follow the pulses again.
const LATE_FRAMES: usize = 3;
/// χ² of one frame at most.
const CAP: f64 = 100.0;
/// χ² by which another beginning must fit better.
const DECISIVE: f64 = 60.0;

impl Recording<'_> {
    /// Gives the frames that lie in a run by `map` its pulses.
    pub(super) fn place(
        &self,
        run: &Run,
        map: &AffineMap<DeviceNanos, BoardNanos>,
        sigma: f64,
    ) -> Result<Part, RunError> {
        let frames = self.between(run, |frame| map.apply(frame.0).0);
        let pulses = self.pulses_of(run);
        if frames.len() < MIN_FRAMES || pulses.len() < MIN_FRAMES {
            return Err(RunError::TooFew {
                frames: frames.len(),
                pulses: pulses.len(),
            });
        }
        let times: Vec<DeviceNanos> = frames.iter().map(|frame| frame.0).collect();
        let hint = Hint::Clock {
            map: *map,
            sigma,
            center: 0,
        };
        let found = match_running(&times, pulses, Some(hint));
        let mut found = found.map_err(|error| match error {
            MatchError::Conflict { pattern, hint, .. } => RunError::OtherPulse {
                by: pattern.saturating_sub(hint),
            },
            error => RunError::Match(error),
        })?;
        let has_pulse = |frame: &Assignment| frame.state == FrameState::Matched;
        let matched = found.frames.iter().filter(|f| has_pulse(f)).count();
        if (matched as f64) < FOLLOWING * times.len() as f64 {
            return Err(RunError::NotFollowing {
                matched,
                frames: times.len(),
            });
        }
        let first = found.frames.iter().position(has_pulse).unwrap_or(0);
        let last = found.frames.iter().rposition(has_pulse).unwrap_or(0);
        for frame in &mut found.frames {
            frame.pulse = frame.pulse.map(|pulse| pulse + run.pulses.start);
        }
        Ok(Part {
            frames: frames.to_vec(),
            found,
            span: (times[first], times[last]),
        })
    }

    /// Matches a run by the clock of the nearest one that is matched already: the
    /// frames, the 1-sigma of the prediction, and how far they were beside it, ns.
    pub(super) fn carry(
        &self,
        parts: &[Option<Part>],
        anchor: usize,
        index: usize,
    ) -> Result<(Part, f64, f64), RunError> {
        let forward = index > anchor;
        let mut known = (anchor..index).rev().chain(index + 1..=anchor);
        let known = known.find_map(|run| Some((run, parts.get(run)?.as_ref()?)));
        let run = &self.runs[index];
        let Some((from, part)) = known else {
            return Err(RunError::TooFew {
                frames: 0,
                pulses: run.pulses.len(),
            });
        };
        let edge = if forward { part.span.1 } else { part.span.0 };
        let near = if forward { run.first } else { run.last };
        let joints = &self.runs[from.min(index) + 1..=from.max(index)];
        let map = relation(&part.found, edge).ok_or(RunError::Match(MatchError::TooFew {
            frames: part.frames.len(),
            pulses: run.pulses.len(),
        }))?;
        let gap = distance(near.0, map.apply(edge).0).abs();
        let rate = DRIFT.hypot(part.found.rate_sigma) * gap;
        let sigma = joints
            .iter()
            .fold(FLOOR.hypot(rate), |sum, run| sum.hypot(run.sigma));
        let limit = self.period / PER_PERIOD;
        // Negated so that what is not a number fails too.
        let known = sigma < limit;
        if !known {
            return Err(RunError::TooCoarse {
                sigma_us: sigma / 1000.0,
                limit_us: limit / 1000.0,
            });
        }
        let carried = self.place(run, &map, sigma)?;
        let off = self.beside(&carried, &map, forward);
        if off.abs() > SIGMAS * sigma {
            return Err(RunError::Beside {
                off_us: off / 1000.0,
                sigma_us: sigma / 1000.0,
            });
        }
        let rate = carried.found.rate_error - part.found.rate_error;
        let rate_sigma = carried.found.rate_sigma.hypot(part.found.rate_sigma);
        if rate.abs() > RATE_MARGIN + SIGMAS * rate_sigma {
            return Err(RunError::OtherRate { ppm: rate * 1e6 });
        }
        // Two runs side by side: the camera changes over at the later one's first pulse.
        let (later, part) = if forward {
            (run, &carried)
        } else {
            (&self.runs[from], part)
        };
        match self.taken_up(later, part) {
            0 => Ok((carried, sigma, off)),
            by => Err(RunError::TakenUp { by }),
        }
    }

    /// How far the frames next to the gap lie behind their pulses by a prediction, ns.
    fn beside(&self, part: &Part, map: &AffineMap<DeviceNanos, BoardNanos>, forward: bool) -> f64 {
        let assigned = part.frames.iter().zip(&part.found.frames);
        let off: Vec<f64> = assigned
            .filter(|(_, frame)| frame.state == FrameState::Matched)
            .filter_map(|(&(at, _), frame)| {
                let pulse = self.pulses.get(frame.pulse?)?;
                Some(distance(map.apply(at).0, pulse.at.0))
            })
            .collect();
        let near = off.len().min(NEAR);
        let near = if forward {
            &off[..near]
        } else {
            &off[off.len() - near..]
        };
        median(near.to_vec())
    }

    /// By how many frames the camera follows the pulses of a run later (or earlier)
    /// than where the first pulse is, if that shows: in front of it the frames lie on
    /// a line of their own, behind it on the pulses.
    fn taken_up(&self, run: &Run, part: &Part) -> i64 {
        let Some(map) = relation(&part.found, part.span.0) else {
            return 0;
        };
        let half = 0.5 * self.period;
        let distances: Vec<f64> = self
            .frames
            .iter()
            .map(|frame| distance(map.apply(frame.0).0, run.first.0))
            .collect();
        let first = distances.partition_point(|&at| at < -half);
        // Frame less pulse, the pulses going on evenly in front of the first one.
        let beside = |&at: &f64| (at, at - (at / self.period).round() * self.period);
        let cost = |begin: usize| -> Option<f64> {
            let free: Vec<(f64, f64)> = distances
                .get(begin.checked_sub(AROUND)?..begin)?
                .iter()
                .map(beside)
                .collect();
            let held = distances.get(begin..begin + AROUND)?;
            let line = fit::straight(&free)?;
            let chi = |off: f64| (off / TICK_SIGMA).powi(2).min(CAP);
            let free = free.iter().map(|&(x, y)| chi(y - line.0 - line.1 * x));
            let held = held.iter().map(|at| chi(beside(at).1));
            Some(free.sum::<f64>() + held.sum::<f64>())
        };
        let Some(expected) = cost(first) else {
            return 0;
        };
        let begins = first.saturating_sub(REACH)..=first + REACH;
        let best = begins
            .filter_map(|begin| Some((begin, cost(begin)?)))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        match best {
            Some((begin, cost)) if cost + DECISIVE < expected => {
                let by = begin as i64 - first as i64;
                if (0..=LATE_FRAMES as i64).contains(&by) {
                    0
                } else {
                    by
                }
            }
            _ => 0,
        }
    }
}
