//! One estimate of the clock relation from two recordings, or a refusal.
//!
//! Order of work: check each stream on its own ([`super::timestamps`],
//! [`super::samples`]); coarse lags ([`super::coarse`]); a quick fit at each and
//! the choice between them; the full fit ([`super::fit`]); faults that show
//! against the other stream ([`super::crosscheck`]) and the fit without them;
//! sigma; gates.
//!
//! The fit is not symmetric in its two streams, so which of the two is the
//! model is decided by the recordings themselves, not by the order of the
//! arguments: exchanging the arguments negates the offset at the same instant.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use serde::Serialize;

use super::clock::{ClockRelation, Wander};
use super::coarse;
use super::crosscheck::{self, Misfit, Stretch};
use super::faults::{Action, Fault, FaultKind, Stream, recurrence};
use super::fit::{self, Calibration, Fit, FitOptions, Link, Node};
use super::gates::Gate;
use super::samples;
use super::signal::{Signal, Smoothing};
use super::spline::Vec3;
use super::timestamps;
use super::track::GyroTrack;

/// Settings of [`estimate_offset`]. The defaults are right for a twist by hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// −3 dB frequency of the zero-phase low-pass, Hz.
    pub low_pass_hz: f64,
    /// Degree of the splines: 3, 5 or 7.
    pub spline_degree: usize,
    /// Delay of the board's gyroscope filter in seconds, subtracted from its timestamps.
    pub mcu_delay_s: f64,
    /// Delay of the phone's gyroscope filter in seconds, subtracted from its timestamps.
    pub phone_delay_s: f64,
    /// Estimates with a larger 1-sigma are refused, seconds.
    pub sigma_limit_s: f64,
    /// Least time that both recordings must have in common, seconds.
    pub min_overlap_s: f64,
    /// Whether faults are looked for and left out. Off only to see their effect.
    pub handle_faults: bool,
    /// Wander of the clocks, for the prediction from the result.
    pub wander: Wander,
    /// Where to look for the offset (phone − mcu): centre and half-width in
    /// seconds, if something is known about it.
    pub search: Option<(f64, f64)>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            low_pass_hz: 25.0,
            spline_degree: 5,
            mcu_delay_s: 0.0,
            phone_delay_s: 0.0,
            sigma_limit_s: 100e-6,
            min_overlap_s: 1.5,
            handle_faults: true,
            wander: Wander::default(),
            search: None,
        }
    }
}

/// An accepted estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The relation of the clocks with its covariance; its reference is the
    /// centroid of the motion's information.
    pub clock: ClockRelation,
    /// `phone rate = calibration · board rate + bias`.
    pub calibration: [[f64; 3]; 3],
    /// Difference of the gyroscopes' biases in the phone's axes, rad/s.
    pub bias: Vec3,
    /// What [`Report`] says about it.
    pub report: Report,
}

impl Estimate {
    /// 1-sigma of the offset at the reference, seconds.
    #[must_use]
    pub fn offset_sigma_s(&self) -> f64 {
        self.clock.covariance[0][0].sqrt()
    }

    /// 1-sigma of the skew.
    #[must_use]
    pub fn skew_sigma(&self) -> f64 {
        self.clock.covariance[1][1].sqrt()
    }
}

/// Why there is no estimate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("no trustworthy clock relation: {}", .report.failures())]
pub struct Refusal {
    /// What was measured; at least one gate is not passed.
    pub report: Report,
}

/// What an estimate or a refusal is based on.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Report {
    /// Rms of the in-band residual over the overlap and the axes, rad/s.
    pub residual_rms: Option<f64>,
    /// Rms of the motion over the overlap and the axes, rad/s.
    pub motion_rms: Option<f64>,
    /// Time both recordings have in common and that was used, seconds.
    pub overlap_s: Option<f64>,
    /// Faults of both streams.
    pub faults: Vec<Fault>,
    /// All gates that could be judged.
    pub gates: Vec<Gate>,
    /// Things to know about an estimate that is accepted nevertheless.
    pub warnings: Vec<String>,
}

impl Report {
    /// The reasons of the gates that were not passed.
    #[must_use]
    pub fn failures(&self) -> String {
        let reasons: Vec<String> = self
            .gates
            .iter()
            .filter(|g| !g.passed)
            .map(|g| {
                format!(
                    "{} ({} {:.3e} {}, limit {:.3e})",
                    g.reason, g.name, g.value, g.unit, g.limit
                )
            })
            .collect();
        reasons.join("; ")
    }

    fn refused(self) -> Refusal {
        Refusal { report: self }
    }
}

/// A stream after its own checks.
struct Prepared {
    stream: Stream,
    epoch_s: f64,
    t: Vec<f64>,
    w: Vec<Vec3>,
    usable: Vec<bool>,
    step_s: f64,
    noise: Vec3,
    unresolved_s: f64,
    faults: Vec<Fault>,
}

impl Prepared {
    fn new(stream: Stream, track: &GyroTrack, delay_s: f64, handle: bool) -> Option<Self> {
        let n = track.t.len().min(track.w.len());
        let w = track.w[..n].to_vec();
        let finite: Vec<bool> = w
            .iter()
            .map(|v| v.iter().all(|x| x.is_finite() && x.abs() < 1e4))
            .collect();
        let checked = timestamps::check(stream, &track.t[..n], &finite)?;
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
        if !handle {
            // As given, apart from what cannot be computed with.
            out.t = track.t[..n].to_vec();
            out.faults
                .retain(|f| matches!(f.kind, FaultKind::NotFinite | FaultKind::TimestampOrder));
            out.usable = vec![true; n];
            for fault in &out.faults {
                for &k in &fault.samples {
                    out.usable[k] = false;
                }
            }
            return Some(out);
        }
        let own = samples::check(stream, &out.t, &out.w, &mut out.usable, out.step_s);
        out.noise = own.noise;
        out.unresolved_s = out.unresolved_s.hypot(own.unresolved_s);
        out.faults.extend(own.faults);
        Some(out)
    }

    fn max_gap_s(&self) -> f64 {
        (3.6 * self.step_s).max(0.01)
    }

    fn signal(&self, smoothing: &Smoothing) -> Signal {
        Signal::new(
            &self.t,
            &self.w,
            &self.usable,
            self.step_s,
            self.max_gap_s(),
            smoothing,
        )
    }

    fn usable_count(&self) -> usize {
        self.usable.iter().filter(|&&u| u).count()
    }

    /// How far a step between neighbours near `t` is from a whole number of
    /// sampling steps, as a part of one.
    fn odd_step_near(&self, t: f64) -> f64 {
        let from = self.t.partition_point(|&x| x < t - 0.2);
        let to = self.t.partition_point(|&x| x <= t + 0.2);
        self.t[from..to]
            .windows(2)
            .map(|p| (p[1] - p[0]) / self.step_s)
            .map(|steps| (steps - steps.round()).abs())
            .fold(0.0, f64::max)
    }

    /// Samples that are there at all: a held sample is no sample.
    fn real_count(&self) -> usize {
        let held: usize = self
            .faults
            .iter()
            .filter(|f| f.kind == FaultKind::CopiedSample && f.count * 5 > self.t.len())
            .map(|f| f.samples.len())
            .sum();
        (self.t.len() - held).max(1)
    }

    fn noise_variance(&self) -> f64 {
        self.noise.iter().map(|n| n * n).sum::<f64>() / 3.0
    }

    fn leave_out(&mut self, kind: FaultKind, samples: Vec<usize>, displacement_s: Option<f64>) {
        if samples.is_empty() {
            return;
        }
        for &k in &samples {
            self.usable[k] = false;
        }
        let known = self
            .faults
            .iter_mut()
            .find(|f| f.kind == kind && kind == FaultKind::Outlier);
        if let Some(fault) = known {
            fault.samples.extend(samples);
            fault.samples.sort_unstable();
            fault.count = fault.samples.len();
            fault.period = recurrence(&fault.samples).map(|(p, _)| p as f64);
        } else {
            self.faults.push(Fault {
                stream: self.stream,
                kind,
                count: samples.len(),
                period: recurrence(&samples).map(|(p, _)| p as f64),
                displacement_s,
                action: Action::LeftOut,
                samples,
            });
        }
    }
}

/// Relates the two clocks.
///
/// `mcu` and `phone` are recordings of the same motion by two gyroscopes that
/// are rigidly attached to each other, in any orientation, on any two clocks.
///
/// # Errors
///
/// A [`Refusal`] with the gates that were not passed: what was found is not good
/// enough to be called the relation of these clocks.
pub fn estimate_offset(
    mcu: &GyroTrack,
    phone: &GyroTrack,
    options: &Options,
) -> Result<Estimate, Refusal> {
    let mut report = Report::default();
    let mcu_p = Prepared::new(Stream::Mcu, mcu, options.mcu_delay_s, options.handle_faults);
    let phone_p = Prepared::new(
        Stream::Phone,
        phone,
        options.phone_delay_s,
        options.handle_faults,
    );
    let fewest = |p: &Option<Prepared>| p.as_ref().map_or(0, Prepared::usable_count);
    report.gates.push(Gate::at_least(
        "samples",
        fewest(&mcu_p).min(fewest(&phone_p)) as f64,
        100.0,
        "samples",
        "a recording has too few usable samples",
    ));
    let (Some(mcu_p), Some(phone_p)) = (mcu_p, phone_p) else {
        return Err(report.refused());
    };
    if !report.gates[0].passed {
        report.faults = [mcu_p.faults, phone_p.faults].concat();
        return Err(report.refused());
    }
    // The better sampled stream is the model; the order of the arguments has no say.
    let key = |p: &Prepared| (p.usable_count() as f64, -p.noise_variance(), p.w[0][0]);
    let mcu_is_model = key(&mcu_p) >= key(&phone_p);
    let (mut a, mut b) = if mcu_is_model {
        (mcu_p, phone_p)
    } else {
        (phone_p, mcu_p)
    };
    let outcome = related(&mut a, &mut b, mcu_is_model, options, &mut report);
    report.faults = if mcu_is_model {
        [a.faults.clone(), b.faults.clone()].concat()
    } else {
        [b.faults.clone(), a.faults.clone()].concat()
    };
    let Some(found) = outcome else {
        if report.gates.iter().all(|g| g.passed) {
            report.gates.push(Gate::at_least(
                "solvable",
                0.0,
                1.0,
                "",
                "the recordings share too little usable time for a fit",
            ));
        }
        return Err(report.refused());
    };
    if report.gates.iter().any(|g| !g.passed) {
        return Err(report.refused());
    }
    let calibration = found.calibration;
    Ok(Estimate {
        clock: found.clock,
        calibration: std::array::from_fn(|r| std::array::from_fn(|c| calibration.matrix[(r, c)])),
        bias: calibration.bias.into(),
        report,
    })
}

struct Found {
    clock: ClockRelation,
    calibration: Calibration,
}

/// Data of the second stream for the fit: every `step` seconds.
fn data_step(smoothing: &Smoothing) -> f64 {
    0.75 * smoothing.kernel_sigma_s()
}

fn related(
    a: &mut Prepared,
    b: &mut Prepared,
    mcu_is_model: bool,
    options: &Options,
    report: &mut Report,
) -> Option<Found> {
    let smoothing = Smoothing {
        low_pass_hz: options.low_pass_hz,
        spline_degree: options.spline_degree,
    };
    let sigma_t = smoothing.kernel_sigma_s();
    let mut signal_a = a.signal(&smoothing);
    let mut signal_b = b.signal(&smoothing);

    let moving = rms(&signal_a).min(rms(&signal_b));
    report.gates.push(Gate::at_least(
        "motion",
        moving,
        LEAST_MOTION,
        "rad/s rms",
        "too little motion: twist the rig by hand for some seconds",
    ));
    if !report.gates.last()?.passed {
        return None;
    }

    // In-band noise of one node, both streams.
    let gain = |p: &Prepared| p.step_s / (2.0 * std::f64::consts::PI.sqrt() * sigma_t);
    let noise_variance = a.noise_variance() * gain(a) + b.noise_variance() * gain(b);
    let step = data_step(&smoothing);
    let fit_options = FitOptions {
        iterations: 40,
        oversampling: (2.0 * std::f64::consts::PI.sqrt() * sigma_t / step).max(1.0),
        rate_sigma: 300e-6,
        noise_variance,
        memory_s: 0.12,
    };

    let start = choose_lag(
        a,
        b,
        &signal_a,
        &signal_b,
        mcu_is_model,
        options,
        &fit_options,
        report,
    )?;
    let mut data = signal_b.sampled(step);
    let mut best = fit::fit(&signal_a, &data, start, None, &fit_options)?;
    let mut largest_share = 1.0;
    if options.handle_faults {
        for _ in 0..4 {
            let changed_outliers = leave_out_outliers(a, b, &smoothing, &best, noise_variance);
            if changed_outliers {
                signal_a = a.signal(&smoothing);
                signal_b = b.signal(&smoothing);
                data = signal_b.sampled(step);
                best = fit::fit(&signal_a, &data, best.link, None, &fit_options)?;
            }
            let parts = crosscheck::stretches(&best, 0.1);
            let changed_stretches = parts.len() > 1;
            if changed_stretches {
                let share = leave_out_stretches(a, b, &best.link, &parts);
                largest_share *= share;
                signal_b = b.signal(&smoothing);
                data = signal_b.sampled(step);
                best = fit::fit(&signal_a, &data, best.link, None, &fit_options)?;
            }
            if !changed_outliers && !changed_stretches {
                break;
            }
        }
    }
    Some(judged(
        a,
        b,
        &best,
        mcu_is_model,
        options,
        &fit_options,
        largest_share,
        report,
    ))
}

/// Largest part of the motion's rms that the quick fit may leave unexplained,
/// faults not yet removed. Unrelated twists leave more than half.
const UNEXPLAINED_AT_FIRST: f64 = 0.2;

/// Least rms of the in-band rate, rad/s: a hand at rest or a table stays below.
const LEAST_MOTION: f64 = 0.05;

fn rms(signal: &Signal) -> f64 {
    let values = signal.sampled(0.02);
    let n = values.len().max(1) as f64;
    let mut mean = [0.0; 3];
    for (_, v) in &values {
        for axis in 0..3 {
            mean[axis] += v[axis] / n;
        }
    }
    let sum: f64 = values
        .iter()
        .map(|(_, v)| (0..3).map(|i| (v[i] - mean[i]).powi(2)).sum::<f64>())
        .sum();
    (sum / n).sqrt()
}

#[allow(clippy::too_many_arguments)]
fn choose_lag(
    a: &Prepared,
    b: &Prepared,
    signal_a: &Signal,
    signal_b: &Signal,
    mcu_is_model: bool,
    options: &Options,
    fit_options: &FitOptions,
    report: &mut Report,
) -> Option<Link> {
    let mut candidates = coarse::candidates(
        (&a.t, &a.w, &a.usable),
        (&b.t, &b.w, &b.usable),
        options.min_overlap_s,
    );
    if let Some((centre, half_width)) = options.search {
        let expected = if mcu_is_model { centre } else { -centre } + a.epoch_s - b.epoch_s;
        candidates.retain(|c| (c.lag_s - expected).abs() <= half_width);
    }
    let data = signal_b.sampled(coarse::BIN_S);
    let quick = FitOptions {
        iterations: 8,
        oversampling: 1.0,
        ..*fit_options
    };
    // (evidence, unexplained part, fit): evidence is n·ln(unexplained).
    let mut tried: Vec<(f64, f64, Fit)> = Vec::new();
    for candidate in &candidates {
        let link = Link {
            at_a: 0.0,
            at_b: candidate.lag_s,
            rate: 1.0,
        };
        let Some(fit) = fit::fit(signal_a, &data, link, Some(Matrix3::identity()), &quick) else {
            continue;
        };
        let motion = fit.motion_variance();
        if motion.is_nan() || motion <= 0.0 {
            continue;
        }
        let unexplained = (fit.residual_variance() / motion).max(1e-14);
        let lag = |f: &Fit| f.link.b_time(f.link.at_a) - f.link.at_a;
        if tried
            .iter()
            .any(|(_, _, f)| (lag(f) - lag(&fit)).abs() < 0.02)
        {
            continue;
        }
        tried.push((fit.nodes.len() as f64 * unexplained.ln(), unexplained, fit));
    }
    tried.sort_by(|x, y| x.0.total_cmp(&y.0));
    let overlap = tried
        .first()
        .map_or(0.0, |(_, _, f)| f.nodes.len() as f64 * coarse::BIN_S);
    report.gates.push(Gate::at_least(
        "overlap",
        overlap,
        options.min_overlap_s,
        "s",
        "the recordings have too little time in common",
    ));
    if overlap < options.min_overlap_s {
        return None;
    }
    let (evidence, unexplained, chosen) = tried.first()?;
    report.gates.push(Gate::at_most(
        "explained",
        100.0 * unexplained.sqrt(),
        100.0 * UNEXPLAINED_AT_FIRST,
        "% of the motion's rms",
        "at no lag does one motion explain the other: not rigidly attached, or not recordings of the same twist",
    ));
    if *unexplained > UNEXPLAINED_AT_FIRST * UNEXPLAINED_AT_FIRST {
        return None;
    }
    // How much worse the best rival explains the motion. Rivals whose evidence
    // is far weaker (short overlaps, where anything fits) do not count.
    let rival = tried[1..]
        .iter()
        .filter(|(other, _, _)| *other < 0.5 * evidence)
        .map(|(_, other, _)| other / unexplained)
        .fold(f64::INFINITY, f64::min);
    report.gates.push(Gate::at_least(
        "unique_peak",
        rival.min(1e6),
        4.0,
        "times the residual power",
        "several lags explain the motion about equally well: twist irregularly",
    ));
    (rival >= 4.0).then_some(chosen.link)
}

/// Leaves out single samples of either stream; whether there were any.
fn leave_out_outliers(
    a: &mut Prepared,
    b: &mut Prepared,
    smoothing: &Smoothing,
    fit: &Fit,
    noise_variance: f64,
) -> bool {
    // Wider than the fit's filter, so that knocks look alike in both streams.
    let wide = Smoothing {
        low_pass_hz: smoothing.low_pass_hz.max(45.0),
        ..*smoothing
    };
    let link = fit.link;
    let mut of_b = crosscheck::outliers(
        &b.t,
        &b.w,
        &b.usable,
        &a.signal(&wide),
        |t| link.a_time(t),
        &fit.calibration,
    );
    let reverse: Vec<Node> = fit
        .nodes
        .iter()
        .map(|n| Node {
            x: n.y,
            y: n.x,
            ..*n
        })
        .collect();
    let back = fit::regress(&reverse, noise_variance);
    let mut of_a = crosscheck::outliers(
        &a.t,
        &a.w,
        &a.usable,
        &b.signal(&wide),
        |t| link.b_time(t),
        &back,
    );
    // One fault may show in both: it belongs to the stream where it is larger.
    let near_s = 1.5 * (a.step_s + b.step_s);
    let larger_nearby =
        |own: &Misfit, time: f64, others: &[Misfit], times: &dyn Fn(usize) -> f64| {
            others
                .iter()
                .any(|o| (times(o.index) - time).abs() < near_s && o.sigmas > own.sigmas)
        };
    let (all_a, all_b) = (of_a.clone(), of_b.clone());
    of_a.retain(|m| !larger_nearby(m, a.t[m.index], &all_b, &|k| link.a_time(b.t[k])));
    of_b.retain(|m| !larger_nearby(m, link.a_time(b.t[m.index]), &all_a, &|k| a.t[k]));
    let found = !of_a.is_empty() || !of_b.is_empty();
    let indices = |misfits: Vec<Misfit>| misfits.into_iter().map(|m| m.index).collect();
    a.leave_out(FaultKind::Outlier, indices(of_a), None);
    b.leave_out(FaultKind::Outlier, indices(of_b), None);
    found
}

/// Keeps the stretches that agree with the one that weighs most; returns the
/// share of the information that is kept.
fn leave_out_stretches(a: &mut Prepared, b: &mut Prepared, link: &Link, parts: &[Stretch]) -> f64 {
    // Group stretches whose displacement is the same.
    let share_near = |centre: f64| -> f64 {
        parts
            .iter()
            .filter(|p| (p.shift_s - centre).abs() < SAME_SHIFT_S)
            .map(|p| p.share)
            .sum()
    };
    let Some(main) = parts
        .iter()
        .max_by(|x, y| share_near(x.shift_s).total_cmp(&share_near(y.shift_s)))
    else {
        return 1.0;
    };
    let mut share = 0.0;
    for part in parts {
        if (part.shift_s - main.shift_s).abs() < SAME_SHIFT_S {
            share += part.share;
            continue;
        }
        // The stream whose timestamps are odd at the ends of the stretch.
        let oddness = |p: &Prepared, time: &dyn Fn(f64) -> f64| {
            let at = |t: f64| p.odd_step_near(time(t));
            at(part.from).max(at(part.to))
        };
        let of_a = oddness(a, &|t| link.a_time(t)) > oddness(b, &|t| t);
        let (stream, from, to) = if of_a {
            (&mut *a, link.a_time(part.from), link.a_time(part.to))
        } else {
            (&mut *b, part.from, part.to)
        };
        let samples: Vec<usize> = (0..stream.t.len())
            .filter(|&k| {
                stream.usable[k]
                    && stream.t[k] >= from - STRETCH_MARGIN_S
                    && stream.t[k] <= to + STRETCH_MARGIN_S
            })
            .collect();
        let displacement = part.shift_s - main.shift_s;
        let displacement = if of_a { displacement } else { -displacement };
        stream.leave_out(FaultKind::TimestampStep, samples, Some(displacement));
    }
    share
}

/// Left out on either side of a displaced stretch: its ends are known to a block.
const STRETCH_MARGIN_S: f64 = 0.15;

/// Stretches closer than this belong together, seconds.
const SAME_SHIFT_S: f64 = 50e-6;

#[allow(clippy::too_many_arguments)]
fn judged(
    a: &Prepared,
    b: &Prepared,
    fit: &Fit,
    mcu_is_model: bool,
    options: &Options,
    fit_options: &FitOptions,
    largest_share: f64,
    report: &mut Report,
) -> Found {
    // Covariance of (shift, rate) at the present reference.
    let covariance = fit.covariance;
    // The reference at which shift and rate are independent.
    let ideal = fit.ideal_covariance;
    let centroid = fit.link.at_b
        - if ideal[1][1] > 0.0 {
            ideal[0][1] / ideal[1][1]
        } else {
            0.0
        };
    let (first, last) = (
        fit.nodes.first().map_or(0.0, |n| n.t),
        fit.nodes.last().map_or(0.0, |n| n.t),
    );
    let centroid = centroid.clamp(first, last.max(first));
    let moved = centroid - fit.link.at_b;
    let link = fit.link.moved_to(centroid);
    let shift_variance =
        covariance[0][0] + 2.0 * moved * covariance[0][1] + moved * moved * covariance[1][1];
    let cross = covariance[0][1] + moved * covariance[1][1];

    let unresolved = a.unresolved_s.hypot(b.unresolved_s);
    let variance = shift_variance + unresolved * unresolved + NUMERICAL_FLOOR_S * NUMERICAL_FLOOR_S;

    // Seen as (model stream → data stream): b = a + offset + skew·(a − reference).
    let model_to_data = ClockRelation {
        reference: a.epoch_s + link.at_a,
        offset: (b.epoch_s - a.epoch_s) + (link.at_b - link.at_a),
        skew: 1.0 / link.rate - 1.0,
        covariance: [[variance, cross], [cross, covariance[1][1]]],
        wander: options.wander,
    };
    let clock = if mcu_is_model {
        model_to_data
    } else {
        model_to_data.inverted()
    };

    let as_phone_of_mcu: Vec<Node> = if mcu_is_model {
        fit.nodes.clone()
    } else {
        fit.nodes
            .iter()
            .map(|n| Node {
                x: n.y,
                y: n.x,
                ..*n
            })
            .collect()
    };
    let calibration = fit::regress(&as_phone_of_mcu, fit_options.noise_variance);
    let residual_rms = {
        let sum: f64 = as_phone_of_mcu
            .iter()
            .map(|n| (n.y - calibration.matrix * n.x - calibration.bias).norm_squared())
            .sum();
        (sum / (3.0 * as_phone_of_mcu.len().max(1) as f64)).sqrt()
    };
    let motion_rms = fit.motion_variance().sqrt();
    report.residual_rms = Some(residual_rms);
    report.motion_rms = Some(motion_rms);
    report.overlap_s = Some(
        fit.nodes.len() as f64
            * data_step(&Smoothing {
                low_pass_hz: options.low_pass_hz,
                spline_degree: options.spline_degree,
            }),
    );

    let allowed = 0.03 * motion_rms + 3.0 * fit_options.noise_variance.sqrt();
    report.gates.push(Gate::at_most(
        "residual",
        residual_rms,
        allowed,
        "rad/s rms",
        "one motion does not explain the other: not rigidly attached, or not recordings of the same twist",
    ));
    let part = |p: &Prepared| p.usable_count() as f64 / p.real_count() as f64;
    let kept = part(a).min(part(b));
    report.gates.push(Gate::at_least(
        "usable",
        kept * 100.0,
        50.0,
        "% of a stream",
        "too many samples had to be left out",
    ));
    report.gates.push(Gate::at_least(
        "one_relation",
        largest_share * 100.0,
        60.0,
        "% of the information",
        "the relation of the clocks jumps within the recording and no part prevails",
    ));
    let scatter = local_scatter(fit);
    report.gates.push(Gate::at_most(
        "consistent",
        scatter * 1e6,
        LOCAL_SCATTER_LIMIT_S * 1e6,
        "µs rms between parts",
        "parts of the overlap disagree about the offset",
    ));
    report.gates.push(Gate::at_most(
        "sigma",
        clock.covariance[0][0].sqrt() * 1e6,
        options.sigma_limit_s * 1e6,
        "µs",
        "the offset is not known well enough: twist more, or about more axes",
    ));
    let skew_sigma = clock.covariance[1][1].sqrt();
    report.gates.push(Gate::at_most(
        "skew",
        clock.skew.abs() * 1e6,
        (SKEW_LIMIT + 3.0 * skew_sigma) * 1e6,
        "ppm",
        "no two crystals differ that much: a timestamp unit or a recording is wrong",
    ));
    report.gates.push(Gate::at_least(
        "settled",
        f64::from(u8::from(fit.settled)),
        1.0,
        "",
        "the fit did not settle",
    ));
    warn(a, b, fit, unresolved, report);
    Found { clock, calibration }
}

/// Numerical error of the fit, seconds: keeps the sigma of noiseless data above zero.
const NUMERICAL_FLOOR_S: f64 = 0.02e-6;
/// Largest plausible rate difference of two crystal clocks.
const SKEW_LIMIT: f64 = 500e-6;
/// Largest rms disagreement between parts of the overlap, seconds.
const LOCAL_SCATTER_LIMIT_S: f64 = 400e-6;

/// Rms of the displacements of eight parts of the overlap against the fit.
fn local_scatter(fit: &Fit) -> f64 {
    let parts = crosscheck::local_shifts(fit, 8);
    let (mut sum, mut weight) = (0.0, 0.0);
    for (_, shift, information) in parts {
        sum += information * shift * shift;
        weight += information;
    }
    if weight > 0.0 {
        (sum / weight).sqrt()
    } else {
        0.0
    }
}

fn warn(a: &Prepared, b: &Prepared, fit: &Fit, unresolved: f64, report: &mut Report) {
    let n = fit.nodes.len().max(1) as f64;
    let mean = fit.nodes.iter().map(|n| n.y).sum::<Vector3<f64>>() / n;
    let mut spread = Matrix3::zeros();
    for node in &fit.nodes {
        let d = node.y - mean;
        spread += d * d.transpose() / n;
    }
    let mut powers: Vec<f64> = SymmetricEigen::new(spread)
        .eigenvalues
        .iter()
        .copied()
        .collect();
    powers.sort_by(|x, y| y.total_cmp(x));
    if powers[1] < 0.01 * powers[0] {
        report.warnings.push(
            "motion about one axis only: the offset is good, the calibration is known for that axis alone"
                .to_owned(),
        );
    }
    if unresolved > 0.0 {
        report.warnings.push(format!(
            "the timestamps leave {:.1} µs open (few resets of a sawtooth, or two equal classes of samples); it is part of the sigma",
            unresolved * 1e6
        ));
    }
    for stream in [a, b] {
        let left_out = 1.0 - stream.usable_count() as f64 / stream.t.len().max(1) as f64;
        if left_out > 0.05 {
            report.warnings.push(format!(
                "{:.0} % of the samples of the {} were left out; see faults",
                left_out * 100.0,
                match stream.stream {
                    Stream::Mcu => "board",
                    Stream::Phone => "phone",
                }
            ));
        }
    }
}
