//! One stream after the checks that need no other.

use crate::GyroTrack;
use crate::faults::{Action, Fault, FaultKind, Stream, recurrence};
use crate::interpolant::Vec3;
use crate::neighbours::{self, Samples};
use crate::samples;
use crate::signal::Resampled;
use crate::timestamps;

/// Rates above this are no rates, rad/s.
const LARGEST_RATE: f64 = 1e4;

/// A stream whose timestamps and samples were checked.
pub(crate) struct CheckedStream<'a> {
    pub(crate) stream: Stream,
    /// Clock reading at relative time zero, without the filter's delay, seconds.
    pub(crate) epoch_s: f64,
    pub(crate) t: Vec<f64>,
    pub(crate) w: &'a [Vec3],
    pub(crate) usable: Vec<bool>,
    /// Typical distance of samples, seconds.
    pub(crate) step_s: f64,
    noise: Vec3,
    /// 1-sigma of time that the faults leave open, seconds.
    pub(crate) unresolved_s: f64,
    pub(crate) faults: Vec<Fault>,
}

impl<'a> CheckedStream<'a> {
    /// `None` with fewer than eight usable samples. With `handle_faults` off only
    /// what cannot be computed with is left out.
    pub(crate) fn new(
        stream: Stream,
        track: &'a GyroTrack,
        delay_s: f64,
        handle_faults: bool,
    ) -> Option<Self> {
        let n = track.t.len().min(track.w.len());
        let (t, w) = (&track.t[..n], &track.w[..n]);
        let finite: Vec<bool> = w
            .iter()
            .map(|v| v.iter().all(|x| x.is_finite() && x.abs() < LARGEST_RATE))
            .collect();
        let checked = timestamps::check(stream, t, &finite)?;
        let mut out = Self {
            stream,
            epoch_s: track.epoch_s - delay_s,
            t: checked.t,
            w,
            usable: checked.usable,
            step_s: checked.step_s,
            noise: [0.0; 3],
            unresolved_s: checked.unresolved_s,
            faults: checked.faults,
        };
        if handle_faults {
            let samples = Samples {
                t: &out.t,
                w,
                step_s: out.step_s,
            };
            let own = samples::check(stream, samples, &mut out.usable);
            out.noise = own.noise;
            out.unresolved_s = out.unresolved_s.hypot(own.unresolved_s);
            out.faults.extend(own.faults);
        } else {
            out.t = t.to_vec();
            out.faults
                .retain(|f| matches!(f.kind, FaultKind::NotFinite | FaultKind::TimestampOrder));
            out.usable.fill(true);
            for fault in &out.faults {
                neighbours::leave_out(&mut out.usable, &fault.samples);
            }
        }
        Some(out)
    }

    pub(crate) fn resampled(&self, low_pass_hz: f64) -> Resampled {
        Resampled::new(&self.t, self.w, &self.usable, self.step_s, low_pass_hz)
    }

    pub(crate) fn usable_count(&self) -> usize {
        self.usable.iter().filter(|&&u| u).count()
    }

    /// The usable samples from one time to another.
    pub(crate) fn usable_within(&self, (from, to): (f64, f64)) -> Vec<usize> {
        let within = from..=to;
        (0..self.t.len())
            .filter(|&k| self.usable[k] && within.contains(&self.t[k]))
            .collect()
    }

    /// Part of the samples that can be used. A sample that the sensor held over
    /// from the one before is no sample, and what is left out because the two
    /// gyroscopes were not one body is no fault of the stream.
    pub(crate) fn usable_part(&self) -> f64 {
        let is_none = |f: &&Fault| match f.kind {
            FaultKind::CopiedSample => f.count * 5 > self.t.len(),
            FaultKind::NotOneBody | FaultKind::Slipped => true,
            _ => false,
        };
        let none = self.faults.iter().filter(is_none).map(|f| f.samples.len());
        self.usable_count() as f64 / (self.t.len() - none.sum::<usize>()).max(1) as f64
    }

    /// Distance of a step between neighbours near `t` from a whole number of
    /// sampling steps, as a part of one.
    pub(crate) fn odd_step_near(&self, t: f64) -> f64 {
        let from = self.t.partition_point(|&x| x < t - 0.2);
        let to = self.t.partition_point(|&x| x <= t + 0.2);
        self.t[from..to]
            .windows(2)
            .map(|p| (p[1] - p[0]) / self.step_s)
            .map(|steps| (steps - steps.round()).abs())
            .fold(0.0, f64::max)
    }

    /// White noise of one sample, mean of the axes, (rad/s)².
    pub(crate) fn noise_variance(&self) -> f64 {
        self.noise.iter().map(|n| n * n).sum::<f64>() / 3.0
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
