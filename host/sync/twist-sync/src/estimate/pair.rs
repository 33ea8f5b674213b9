//! The two streams in their roles in the fit, and removal of the samples of each that do not
//! fit the other.
//!
//! The fit is not symmetric: one stream is the model, the other the data. The recordings
//! themselves determine the roles, not the order in which they are given: exchanging them
//! negates the offset at the same instant.

use nalgebra::Matrix2;

use super::axes::LateAxis;
use super::calibration::{self, Calibration};
use super::crosscheck::{self, Evidence, Misfit, Stretch};
use super::fit::{self, Fit, FitOptions, Link};
use super::rigid;
use crate::clock::transition;
use crate::faults::{Action, Fault, FaultKind, LeftOut, Why};
use crate::signal::neighbours;
use crate::signal::{Smooth, kernel_length_s, kernel_sigma_s};
use crate::stream::CheckedStream;

/// Time that is left out on either side of a displaced stretch, seconds: its ends are known to
/// one block.
const STRETCH_MARGIN_S: f64 = 0.15;
/// Largest difference of the displacements of stretches that belong together, seconds.
const SAME_SHIFT_S: f64 = 50e-6;
/// Length of the blocks in the search for jumps of the relation, seconds.
const STRETCH_BLOCK_S: f64 = 0.1;
/// Least low-pass for the search of single samples, Hz: wider than the fit's, so
/// that knocks look alike in both streams.
const OUTLIER_LOW_PASS_HZ: f64 = 45.0;

/// The two streams in their roles.
pub(crate) struct Pair<'a> {
    pub(crate) model: CheckedStream<'a>,
    pub(crate) data: CheckedStream<'a>,
    pub(crate) a_is_model: bool,
    /// Stretches of both streams that were left out.
    pub(crate) left_out: Vec<LeftOut>,
}

/// Both streams low-passed and continuous.
pub(crate) struct Signals {
    pub(crate) model: Smooth,
    pub(crate) data: Smooth,
}

/// The settings of the fit, for the noise of a pair.
#[derive(Clone, Copy)]
pub(crate) struct Settings {
    pub(crate) low_pass_hz: f64,
    /// Distance of the data's nodes, seconds.
    pub(crate) step_s: f64,
    pub(crate) fit: FitOptions,
}

impl Settings {
    pub(crate) fn new(low_pass_hz: f64, pair: &Pair<'_>) -> Self {
        // Sums of products of what the kernel leaves are exact to exp(−π²) on this grid.
        let step_s = kernel_sigma_s(low_pass_hz);
        let in_band = |s: &CheckedStream<'_>| s.smooth_noise(low_pass_hz).powi(2);
        Self {
            low_pass_hz,
            step_s,
            fit: FitOptions {
                iterations: 40,
                settled_s: 10e-9,
                oversampling: (kernel_length_s(low_pass_hz) / step_s).max(1.0),
                noise_variance: in_band(&pair.model) + in_band(&pair.data),
                memory_s: 0.3,
            },
        }
    }

    /// Low-pass for the search of single samples, Hz.
    fn wide_hz(&self) -> f64 {
        self.low_pass_hz.max(OUTLIER_LOW_PASS_HZ)
    }
}

impl<'a> Pair<'a> {
    /// Assigns the roles: the better sampled stream is the model.
    pub(crate) fn new(a: CheckedStream<'a>, b: CheckedStream<'a>) -> Self {
        let key = |s: &CheckedStream<'_>| (s.usable_count() as f64, -s.noise_variance(), s.w[0][0]);
        let a_is_model = key(&a) >= key(&b);
        let (model, data) = if a_is_model { (a, b) } else { (b, a) };
        Self {
            model,
            data,
            a_is_model,
            left_out: Vec::new(),
        }
    }

    /// Leaves out the stretches that the relation does not explain.
    pub(crate) fn leave_out_unexplained(&mut self, link: &Link, stretches: &[rigid::Stretch]) {
        for stretch in stretches {
            if let Why::TimeStep(later_s) = stretch.why {
                self.leave_out_step(link, (stretch.from, stretch.to), -later_s);
                continue;
            }
            self.note(link, (stretch.from, stretch.to), stretch.why);
            let of_model = (link.model_time(stretch.from), link.model_time(stretch.to));
            let (model, data) = (&mut self.model, &mut self.data);
            for (stream, within) in [(model, of_model), (data, (stretch.from, stretch.to))] {
                let samples = stream.usable_within(within);
                stream.leave_out(FaultKind::NotOneBody, samples, None);
            }
        }
    }

    /// Brings a value of the model and one of the data into the order of a and b.
    pub(crate) fn a_and_b<T>(&self, of_model: T, of_data: T) -> (T, T) {
        if self.a_is_model {
            (of_model, of_data)
        } else {
            (of_data, of_model)
        }
    }

    fn a(&self) -> &CheckedStream<'a> {
        self.a_and_b(&self.model, &self.data).0
    }

    /// Converts a time of the data to seconds from the first sample of a.
    pub(crate) fn since_first_of_a(&self, link: &Link, t: f64) -> f64 {
        self.a_and_b(link.model_time(t), t).0 - self.a().t[0]
    }

    /// Records a stretch of the data's time that is left out.
    fn note(&mut self, link: &Link, (from, to): (f64, f64), why: Why) {
        let a = self.a();
        let usable = neighbours::kept(&a.usable);
        let (Some(&first), Some(&last)) = (usable.first(), usable.last()) else {
            return;
        };
        let since = |k: usize| a.t[k] - a.t[0];
        let bounded = |t: f64| {
            let t = self.since_first_of_a(link, t);
            t.clamp(since(first), since(last))
        };
        let left_out = LeftOut {
            from_s: bounded(from),
            to_s: bounded(to),
            why,
        };
        self.left_out.push(left_out);
    }

    /// Returns all faults, those of a first.
    pub(crate) fn faults(&self) -> Vec<Fault> {
        let (a, b) = self.a_and_b(&self.model.faults, &self.data.faults);
        [&a[..], b].concat()
    }

    pub(crate) fn signals(&mut self, low_pass_hz: f64) -> Signals {
        Signals {
            model: self.model.smooth(low_pass_hz),
            data: self.data.smooth(low_pass_hz),
        }
    }

    /// Returns true if a stream has changed since it was smoothed.
    pub(crate) fn is_changed(&self) -> bool {
        self.model.is_changed || self.data.is_changed
    }

    /// Runs the full fit on the current streams.
    pub(crate) fn fitted(
        &mut self,
        signals: &mut Signals,
        start: Link,
        settings: &Settings,
    ) -> Option<Fit> {
        if self.model.is_changed {
            signals.model = self.model.smooth(settings.low_pass_hz);
        }
        if self.data.is_changed {
            signals.data = self.data.smooth(settings.low_pass_hz);
        }
        let data = signals.data.signal.sampled(settings.step_s);
        fit::fit(&signals.model.signal, &data, start, None, &settings.fit)
    }

    /// Leaves out samples that do not fit the other stream and fits again, until none
    /// are found or four times. Returns the fit and the share of the information that is kept
    /// if the relation jumps.
    pub(crate) fn without_faults(
        &mut self,
        mut fit: Fit,
        signals: &mut Signals,
        settings: &Settings,
    ) -> Option<(Fit, f64)> {
        let mut kept_share = 1.0;
        for _ in 0..4 {
            let outliers = self.leave_out_outliers(&fit, signals, settings);
            if outliers {
                fit = self.fitted(signals, fit.link, settings)?;
            }
            let stretches = crosscheck::stretches(&fit, STRETCH_BLOCK_S);
            let jumps = stretches.len() > 1;
            if jumps {
                kept_share *= self.leave_out_stretches(&fit.link, &stretches);
                fit = self.fitted(signals, fit.link, settings)?;
            }
            if !outliers && !jumps {
                break;
            }
        }
        Some((fit, kept_share))
    }

    /// Compares the faults that each stream shows by itself with the other stream, and revokes
    /// those that the content does not confirm. Returns the covariance of (shift, rate) due to
    /// what remains undecided.
    pub(crate) fn review(
        &mut self,
        fit: &Fit,
        signals: &Signals,
        settings: &Settings,
    ) -> Matrix2<f64> {
        let mut open = Matrix2::zeros();
        for of_data in [false, true] {
            let pattern = self.stream(of_data).pattern.as_ref();
            if let Some(pattern) = pattern.filter(|p| p.sawtooth.is_some()) {
                let evidence = self.evidence_of(of_data, fit, signals, settings);
                let usable = &self.stream(of_data).usable;
                let found = evidence(usable, &|k| pattern.later_s[k]);
                drop(evidence);
                if let Some(found) = found {
                    let stream = self.stream_mut(of_data);
                    let part = stream.correct_sawtooth(|prior| found.probability(prior));
                    open += found.open(part * (1.0 - part));
                }
            }
            open += self.review_wander(of_data, fit, signals, settings);
            let stream = self.stream(of_data);
            let is_class = |f: &&Fault| f.kind == FaultKind::DisplacedClass;
            let classes: Vec<Fault> = stream.faults.iter().filter(is_class).cloned().collect();
            if classes.is_empty() {
                continue;
            }
            let evidence = self.evidence_of(of_data, fit, signals, settings);
            let is_confirmed = |class: &Fault| {
                let mut usable = stream.usable.clone();
                let mut later = vec![0.0; stream.t.len()];
                for &k in &class.samples {
                    usable[k] = true;
                    later[k] = class.displacement_s.unwrap_or(0.0);
                }
                let found = evidence(&usable, &|k| later[k]);
                found.is_none_or(|found| found.probability(0.5) > 0.5)
            };
            let revoked = classes.into_iter().filter(|class| !is_confirmed(class));
            let revoked: Vec<Fault> = revoked.collect();
            drop(evidence);
            let stream = self.stream_mut(of_data);
            for class in revoked {
                if class.action == Action::LeftOut {
                    class.samples.iter().for_each(|&k| stream.usable[k] = true);
                    stream.is_changed = true;
                } else {
                    stream.unresolved_s = 0.0;
                }
                stream.faults.retain(|fault| *fault != class);
            }
        }
        open
    }

    /// Corrects a slow deviation from regular sampling as far as the other stream bears it out.
    fn review_wander(
        &mut self,
        of_data: bool,
        fit: &Fit,
        signals: &Signals,
        settings: &Settings,
    ) -> Matrix2<f64> {
        let Some((sampling, _)) = self.stream(of_data).wander.as_ref() else {
            return Matrix2::zeros();
        };
        let evidence = self.evidence_of(of_data, fit, signals, settings);
        let usable = &self.stream(of_data).usable;
        let found = evidence(usable, &|k| sampling.slow_s[k]);
        drop(evidence);
        let Some(found) = found else {
            return Matrix2::zeros();
        };
        let stream = self.stream_mut(of_data);
        let part = stream.correct_wander(|prior| found.probability(prior));
        found.open(part * (1.0 - part))
    }

    /// Covariance of (shift, rate) at the reference that the stamps' errors leave.
    pub(crate) fn of_stamps(&self, link: &Link) -> Matrix2<f64> {
        let at = |stream: &CheckedStream<'_>, reference: f64| {
            stream
                .line
                .map_or(Matrix2::zeros(), |(middle, covariance)| {
                    let step = transition(reference - middle);
                    step * covariance * step.transpose()
                })
        };
        at(&self.data, link.at_data) + at(&self.model, link.at_model)
    }

    /// Returns the covariance of (shift, rate) due to single jumps of the stamps within the used
    /// samples: if the clock jumped, it is unknown which side is right.
    pub(crate) fn open_jumps(
        &self,
        fit: &Fit,
        signals: &Signals,
        settings: &Settings,
    ) -> Matrix2<f64> {
        let mut open = Matrix2::zeros();
        for of_data in [false, true] {
            let stream = self.stream(of_data);
            let jumps = stream.pattern.as_ref().filter(|p| p.sawtooth.is_none());
            if let Some(jumps) = jumps {
                let evidence = self.evidence_of(of_data, fit, signals, settings);
                let found = evidence(&stream.usable, &|k| jumps.later_s[k]);
                open += found.map_or(Matrix2::zeros(), |found| found.open(found.probability(0.5)));
            }
        }
        open
    }

    /// Undoes the lateness of an axis.
    pub(crate) fn advance(&mut self, late: &LateAxis) {
        let stream = self.stream_mut(late.of_data);
        stream.advance_axis(late.axis, late.by.value);
    }

    fn stream_mut(&mut self, of_data: bool) -> &mut CheckedStream<'a> {
        if of_data {
            &mut self.data
        } else {
            &mut self.model
        }
    }

    fn stream(&self, of_data: bool) -> &CheckedStream<'a> {
        if of_data { &self.data } else { &self.model }
    }

    /// Returns a function that compares the stamps of one stream with the other stream. Its
    /// arguments are the samples to use, and the lateness of each stamp that is to be judged.
    fn evidence_of(
        &self,
        of_data: bool,
        fit: &Fit,
        signals: &Signals,
        settings: &Settings,
    ) -> impl Fn(&[bool], &dyn Fn(usize) -> f64) -> Option<Evidence> {
        let other = if of_data {
            &signals.model
        } else {
            &signals.data
        };
        let other = other.wide(settings.wide_hz());
        let (link, reference, calibration) = if of_data {
            (fit.link, fit.link.at_data, fit.calibration)
        } else {
            (fit.link, fit.link.at_model, self.backwards(fit, settings))
        };
        let stream = self.stream(of_data);
        let (t, w) = (&stream.t, &stream.w);
        move |usable, later_s| {
            let time = |t: f64| {
                if of_data {
                    link.model_time(t)
                } else {
                    link.data_time(t)
                }
            };
            crosscheck::evidence(
                (t, w, usable),
                other,
                time,
                &calibration,
                reference,
                later_s,
            )
        }
    }

    /// Returns the calibration that gives the model's rate from the data's.
    fn backwards(&self, fit: &Fit, settings: &Settings) -> Calibration {
        let rates = fit.nodes.iter().map(|n| (n.y, n.x));
        calibration::regress(rates, settings.fit.noise_variance)
    }

    /// Leaves out single samples of either stream; returns true if there were any.
    fn leave_out_outliers(&mut self, fit: &Fit, signals: &Signals, settings: &Settings) -> bool {
        let wide_hz = settings.wide_hz();
        let (model, data, link) = (&self.model, &self.data, fit.link);
        let of_data = crosscheck::outliers(
            (&data.t, &data.w, &data.usable),
            signals.model.wide(wide_hz),
            model.smooth_noise(wide_hz),
            |t| link.model_time(t),
            &fit.calibration,
        );
        let of_model = crosscheck::outliers(
            (&model.t, &model.w, &model.usable),
            signals.data.wide(wide_hz),
            data.smooth_noise(wide_hz),
            |t| link.data_time(t),
            &self.backwards(fit, settings),
        );
        // One fault may show in both: it belongs to the stream where it is larger.
        let near_s = 1.5 * (model.step_s + data.step_s);
        type Timed = (f64, Misfit);
        let of_data: Vec<Timed> = of_data
            .into_iter()
            .map(|m| (link.model_time(data.t[m.index]), m))
            .collect();
        let of_model: Vec<Timed> = of_model
            .into_iter()
            .map(|m| (model.t[m.index], m))
            .collect();
        let largest = |own: &[Timed], others: &[Timed]| -> Vec<usize> {
            let is_outdone = |(time, own): &Timed| {
                let mut near = others
                    .iter()
                    .filter(|other| (other.0 - time).abs() < near_s);
                near.any(|(_, other)| other.sigmas > own.sigmas)
            };
            own.iter()
                .filter(|own| !is_outdone(own))
                .map(|(_, m)| m.index)
                .collect()
        };
        let model_samples = largest(&of_model, &of_data);
        let data_samples = largest(&of_data, &of_model);
        let found = !model_samples.is_empty() || !data_samples.is_empty();
        self.model
            .leave_out(FaultKind::Outlier, model_samples, None);
        self.data.leave_out(FaultKind::Outlier, data_samples, None);
        found
    }

    /// Keeps the stretches that agree with the one that weighs most; returns the
    /// share of the information that is kept.
    fn leave_out_stretches(&mut self, link: &Link, stretches: &[Stretch]) -> f64 {
        // Stretches whose displacement is the same count together.
        let share_near = |centre: f64| -> f64 {
            stretches
                .iter()
                .filter(|s| (s.shift_s - centre).abs() < SAME_SHIFT_S)
                .map(|s| s.share)
                .sum()
        };
        let Some(main) = stretches
            .iter()
            .max_by(|x, y| share_near(x.shift_s).total_cmp(&share_near(y.shift_s)))
        else {
            return 1.0;
        };
        for stretch in stretches {
            let displacement = stretch.shift_s - main.shift_s;
            if displacement.abs() >= SAME_SHIFT_S {
                self.leave_out_step(link, (stretch.from, stretch.to), displacement);
            }
        }
        share_near(main.shift_s)
    }

    /// Leaves out a stretch of the data's time that is displaced by `displacement_s`, in the
    /// model's time, from the stream whose timestamps are odd at its ends.
    fn leave_out_step(&mut self, link: &Link, in_data: (f64, f64), displacement_s: f64) {
        let by_s = if self.a_is_model {
            -displacement_s
        } else {
            displacement_s
        };
        self.note(link, in_data, Why::TimeStep(by_s));
        let in_model = (link.model_time(in_data.0), link.model_time(in_data.1));
        let oddness = |stream: &CheckedStream<'_>, (from, to): (f64, f64)| {
            stream.odd_step_near(from).max(stream.odd_step_near(to))
        };
        let of_model = oddness(&self.model, in_model) > oddness(&self.data, in_data);
        let (stream, (from, to), displacement_s) = if of_model {
            (&mut self.model, in_model, displacement_s)
        } else {
            (&mut self.data, in_data, -displacement_s)
        };
        let samples = stream.usable_within((from - STRETCH_MARGIN_S, to + STRETCH_MARGIN_S));
        stream.leave_out(FaultKind::TimestampStep, samples, Some(displacement_s));
    }
}
