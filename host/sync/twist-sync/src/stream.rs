//! One stream, after the checks that do not need the other.

mod classes;
pub(crate) mod filter;
mod samples;
mod sampling;
mod timestamps;

use std::borrow::Cow;

use nalgebra::Matrix2;

pub(crate) use self::samples::Made;
pub(crate) use self::sampling::Sampling;
use self::timestamps::Pattern;
use crate::GyroTrack;
use crate::estimate::Options;
use crate::faults::{Action, Fault, FaultKind, Stream, recurrence};
use crate::signal::interpolant::{Uneven, Vec3};
use crate::signal::neighbours::{self, Samples};
use crate::signal::{self, Resampled, Smooth};

/// Largest angular rate that counts as valid, rad/s.
const LARGEST_RATE: f64 = 1e4;

/// Probability that the slow deviation is the stamps' error where the fast one is.
const STAMPS_ERR: f64 = 0.9;
/// Difference of the logarithms of two likelihoods that decides.
const DECISIVE: f64 = 5.0;

/// A stream whose timestamps and samples were checked.
pub(crate) struct CheckedStream<'a> {
    pub(crate) stream: Stream,
    /// Clock reading at relative time zero, without the filter's delay, seconds.
    pub(crate) epoch_s: f64,
    pub(crate) t: Vec<f64>,
    pub(crate) w: Cow<'a, [Vec3]>,
    pub(crate) usable: Vec<bool>,
    /// Typical distance of samples, seconds.
    pub(crate) step_s: f64,
    noise: Vec3,
    /// 1-sigma of the stream's time due to its faults, seconds.
    pub(crate) unresolved_s: f64,
    /// 1-sigma of the stream's rate due to its faults.
    pub(crate) unresolved_skew: f64,
    /// Step of coarse stamps, seconds; 0 for fine ones.
    pub(crate) resolution_s: f64,
    /// Deviation of the stamps that may be the samples' own.
    pub(crate) pattern: Option<Pattern>,
    /// Slow deviation of the stamps from regular sampling, with the probability beforehand that
    /// it is their error.
    pub(crate) wander: Option<(Sampling, f64)>,
    /// Covariance of shift and rate at a time, if that deviation is the stamps' error.
    pub(crate) line: Option<(f64, Matrix2<f64>)>,
    /// Origin of a stream that was made from slower samples.
    pub(crate) made: Option<Made>,
    pub(crate) faults: Vec<Fault>,
    /// True if times, rates or the usable samples changed since the stream was smoothed.
    pub(crate) is_changed: bool,
}

impl<'a> CheckedStream<'a> {
    /// Checks a stream; `None` with fewer than eight usable samples. Without
    /// [`Options::handle_faults`], only values that cannot be computed with are left out.
    pub(crate) fn new(
        stream: Stream,
        track: &'a GyroTrack,
        delay_s: f64,
        known_jump_s: f64,
        options: &Options,
    ) -> Option<Self> {
        let handle_faults = options.handle_faults;
        let (t, w) = (&track.t[..], &track.w[..]);
        let finite: Vec<bool> = w
            .iter()
            .map(|v| v.iter().all(|x| x.is_finite() && x.abs() < LARGEST_RATE))
            .collect();
        let first_s = (!options.exact_stamps).then_some(track.epoch_s);
        let checked = timestamps::check(stream, t, &finite, known_jump_s, first_s)?;
        let mut out = Self {
            stream,
            epoch_s: track.epoch_s - delay_s,
            t: checked.t,
            w: Cow::Borrowed(w),
            usable: checked.usable,
            step_s: checked.step_s,
            noise: [0.0; 3],
            unresolved_s: checked.unresolved_s,
            unresolved_skew: checked.unresolved_skew,
            resolution_s: checked.resolution_s,
            pattern: checked.pattern,
            wander: None,
            line: None,
            made: None,
            faults: checked.faults,
            is_changed: true,
        };
        if handle_faults {
            if let Some(sampling) = checked.sampling {
                out.judge_fast(sampling, checked.shared);
            }
            // Jumps of the stamps are no displaced samples; those of the samples are not theirs.
            let pattern = out.pattern.as_ref().filter(|p| p.sawtooth.is_some());
            let even = pattern.map(|pattern| {
                let pairs = out.t.iter().zip(&pattern.later_s);
                pairs.map(|(t, later)| t - later).collect::<Vec<f64>>()
            });
            let samples = Samples {
                t: even.as_deref().unwrap_or(&out.t),
                w,
                step_s: out.step_s,
            };
            let own = samples::check(stream, samples, out.resolution_s, &mut out.usable);
            out.made = own.made;
            if let Some(Made::Held(rate_hz)) = own.made {
                out.step_s = 1.0 / rate_hz;
            }
            out.noise = own.noise;
            out.unresolved_s = out.unresolved_s.hypot(own.unresolved_s);
            out.faults.extend(own.faults);
        } else {
            out.t = t.to_vec();
            (out.pattern, out.unresolved_skew) = (None, 0.0);
            out.faults
                .retain(|f| matches!(f.kind, FaultKind::NotFinite | FaultKind::TimestampOrder));
            out.usable.fill(true);
            for fault in &out.faults {
                neighbours::leave_out(&mut out.usable, &fault.samples);
            }
        }
        Some(out)
    }

    /// Removes the fast deviation of the stamps from regular sampling if the samples follow
    /// better from their neighbours without it.
    fn judge_fast(&mut self, mut sampling: Sampling, is_removed: bool) {
        let mut prior = if is_removed { STAMPS_ERR } else { 0.5 };
        if !is_removed {
            let regular: Vec<f64> = self
                .t
                .iter()
                .zip(&sampling.fast_s)
                .map(|(t, f)| t - f)
                .collect();
            let (w, step_s) = (&self.w[..], self.step_s);
            let against =
                [&self.t, &regular].map(|t| Samples { t, w, step_s }.predictions(&self.usable));
            let better = neighbours::better_ln(&against[0], &against[1]);
            // A line that keeps all within one step of the stamps is no coincidence.
            if better > DECISIVE || sampling.is_whole && better > -DECISIVE {
                prior = STAMPS_ERR;
                self.t = regular;
            } else if better < -DECISIVE {
                prior = 1.0 - STAMPS_ERR;
            } else {
                // The other stream decides about all of it.
                let both = sampling.slow_s.iter_mut().zip(&sampling.fast_s);
                both.for_each(|(slow, fast)| *slow += fast);
            }
        }
        if sampling.is_whole {
            self.line = Some((sampling.middle, sampling.covariance * prior));
        } else {
            self.wander = Some((sampling, prior));
        }
    }

    /// Removes the slow deviation of the stamps from regular sampling, scaled by its posterior
    /// probability, which `probability` computes from the prior one. Returns that scale.
    pub(crate) fn correct_wander(&mut self, probability: impl Fn(f64) -> f64) -> f64 {
        let Some((sampling, prior)) = self.wander.take() else {
            return 0.0;
        };
        let part = probability(prior);
        self.line = Some((sampling.middle, sampling.covariance * part));
        if part > 1e-3 {
            self.is_changed = true;
            let pairs = self.t.iter_mut().zip(&sampling.slow_s);
            pairs.for_each(|(t, later)| *t -= part * later);
        }
        part
    }

    /// Removes the sawtooth of the stamps, scaled by its posterior probability, which
    /// `probability` computes from the prior one. Returns that scale.
    pub(crate) fn correct_sawtooth(&mut self, probability: impl Fn(f64) -> f64) -> f64 {
        let Some(Pattern { later_s, sawtooth }) = self.pattern.take() else {
            return 0.0;
        };
        let Some(sawtooth) = sawtooth else {
            return 0.0;
        };
        let part = probability(sawtooth.prior);
        if part < 1e-3 {
            return 0.0;
        }
        self.is_changed = true;
        self.t
            .iter_mut()
            .zip(&later_s)
            .for_each(|(t, later)| *t -= part * later);
        self.unresolved_s = self.unresolved_s.hypot(part.sqrt() * sawtooth.open_s);
        self.unresolved_skew = self.unresolved_skew.hypot(part.sqrt() * sawtooth.open_skew);
        if part > 0.5 {
            self.faults.push(sawtooth.fault);
        }
        part
    }

    /// Replaces the rates of an axis by those that it shows `later_s` later.
    pub(crate) fn advance_axis(&mut self, axis: usize, later_s: f64) {
        let kept = neighbours::kept(&self.usable);
        let times: Vec<f64> = kept.iter().map(|&k| self.t[k]).collect();
        let rates: Vec<Vec3> = kept.iter().map(|&k| self.w[k]).collect();
        let Some(recorded) = Uneven::new(&times, &rates) else {
            return;
        };
        let last = recorded.domain().1;
        self.is_changed = true;
        let w = self.w.to_mut();
        for k in kept {
            // Beyond the end nothing is known.
            let at = self.t[k] + later_s;
            if at > last || at < times[0] {
                self.usable[k] = false;
            } else {
                w[k][axis] = recorded.value(at)[axis];
            }
        }
    }

    /// Filters the usable samples as the other gyroscope's low-pass of this delay and shape does.
    pub(crate) fn pass_through(&mut self, delay_s: f64, shape: f64) {
        let kept = neighbours::kept(&self.usable);
        let times: Vec<f64> = kept.iter().map(|&k| self.t[k]).collect();
        let rates: Vec<Vec3> = kept.iter().map(|&k| self.w[k]).collect();
        let filtered = filter::filtered(&times, &rates, delay_s, shape);
        let w = self.w.to_mut();
        kept.iter().zip(filtered).for_each(|(&k, rate)| w[k] = rate);
        self.epoch_s -= delay_s;
    }

    pub(crate) fn smooth(&mut self, low_pass_hz: f64) -> Smooth {
        self.is_changed = false;
        let (w, usable) = (&self.w, &self.usable);
        let resampled = Resampled::new(&self.t, w, usable, self.step_s, low_pass_hz);
        Smooth::new(resampled, low_pass_hz)
    }

    pub(crate) fn usable_count(&self) -> usize {
        self.usable.iter().filter(|&&u| u).count()
    }

    /// Returns the usable samples from one time to another.
    pub(crate) fn usable_within(&self, (from, to): (f64, f64)) -> Vec<usize> {
        let within = from..=to;
        (0..self.t.len())
            .filter(|&k| self.usable[k] && within.contains(&self.t[k]))
            .collect()
    }

    /// Returns the part of the samples that can be used. Samples that the sensor repeated do
    /// not count, nor do those left out because the two gyroscopes were not one body, which is
    /// no fault of the stream.
    pub(crate) fn usable_part(&self) -> f64 {
        let is_none = |f: &&Fault| match f.kind {
            FaultKind::CopiedSample => f.count * 5 > self.t.len(),
            FaultKind::NotOneBody => true,
            _ => false,
        };
        let none = self.faults.iter().filter(is_none).map(|f| f.samples.len());
        self.usable_count() as f64 / (self.t.len() - none.sum::<usize>()).max(1) as f64
    }

    /// Returns the largest deviation of the steps between neighbours near `t` from a whole
    /// number of sampling steps, as a part of one step.
    pub(crate) fn odd_step_near(&self, t: f64) -> f64 {
        let from = self.t.partition_point(|&x| x < t - 0.2);
        let to = self.t.partition_point(|&x| x <= t + 0.2);
        self.t[from..to]
            .windows(2)
            .map(|p| (p[1] - p[0]) / self.step_s)
            .map(|steps| (steps - steps.round()).abs())
            .fold(0.0, f64::max)
    }

    /// Returns the variance of the white noise of one sample, mean of the axes, (rad/s)².
    pub(crate) fn noise_variance(&self) -> f64 {
        self.noise.iter().map(|n| n * n).sum::<f64>() / 3.0
    }

    /// Returns the 1-sigma of that noise after a low-pass, rad/s.
    pub(crate) fn smooth_noise(&self, low_pass_hz: f64) -> f64 {
        (self.noise_variance() * self.step_s / signal::kernel_length_s(low_pass_hz)).sqrt()
    }

    pub(crate) fn leave_out(
        &mut self,
        kind: FaultKind,
        samples: Vec<usize>,
        displacement_s: Option<f64>,
    ) {
        if samples.is_empty() {
            return;
        }
        neighbours::leave_out(&mut self.usable, &samples);
        self.is_changed = true;
        let mut fault = Fault {
            displacement_s,
            ..Fault::new(self.stream, kind, samples, Action::LeftOut)
        };
        // Outliers of all rounds are one fault.
        let known = |f: &Fault| f.kind == kind && kind == FaultKind::Outlier;
        let place = self.faults.iter().position(known);
        if let Some(place) = place {
            fault.samples.extend(&self.faults[place].samples);
            fault.samples.sort_unstable();
            fault.count = fault.samples.len();
        }
        fault.period = recurrence(&fault.samples);
        match place {
            Some(place) => self.faults[place] = fault,
            None => self.faults.push(fault),
        }
    }
}
