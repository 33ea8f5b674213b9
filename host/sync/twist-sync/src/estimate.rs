//! One estimate of the clock relation from two recordings, or a refusal.
//!
//! Order of work: check each stream on its own ([`crate::stream`]); coarse lags
//! ([`coarse`]) and the choice between them ([`lag`]); the full fit ([`fit`]); faults
//! that show against the other stream ([`pair`]) and the fit without them; sigma; gates
//! ([`gates`]).

mod axes;
mod bands;
mod calibration;
mod coarse;
mod crosscheck;
mod fit;
mod gates;
mod lag;
mod options;
mod pair;
mod report;
mod rigid;
mod wander;

use nalgebra::{Matrix2, Matrix3, SymmetricEigen, Vector2, Vector3};

use self::axes::{Dispersion, LateAxis};
use self::calibration::Calibration;
use self::fit::Fit;
pub use self::gates::{Gate, GateKind};
pub use self::options::Options;
use self::pair::{Pair, Settings};
pub use self::report::{Estimate, Refusal, Report, Warning};
use self::rigid::Stretch;
use crate::clock::{ClockRelation, Wander, transition};
use crate::faults::{Stream, Why};
use crate::signal::Signal;
use crate::stream::{CheckedStream, Made, filter};
use crate::track::GyroTrack;

/// Numerical error of the fit, seconds: keeps the sigmas of noiseless data above zero.
const NUMERICAL_FLOOR_S: f64 = 0.02e-6;
/// Probability of a late axis above which its samples are moved.
const BEYOND_DOUBT: f64 = 0.9;
/// Lateness of an axis above which its samples are moved, seconds.
const MUCH_LATER_S: f64 = 0.3e-3;
/// Parts of the overlap that must agree about the offset.
const PARTS: f64 = 8.0;
/// Refinements of a long filter's shape.
const REFINED: usize = 2;
/// Power of the motion about the second axis over that about the first, below which the motion
/// counts as being about one axis.
const SECOND_AXIS: f64 = 0.01;

/// Relates the two clocks.
///
/// `a` and `b` are recordings of the same motion by two gyroscopes that are rigidly
/// attached to each other, in any orientation, on any two clocks.
///
/// # Errors
///
/// Returns a [`Refusal`] with the gates that were not passed if the recordings do not give a
/// trustworthy relation.
pub fn estimate_offset(
    a: &GyroTrack,
    b: &GyroTrack,
    options: &Options,
) -> Result<Estimate, Refusal> {
    // What is uncertain because fast motion shows another relation may be certain from slow motion.
    let limit_s = options.sigma_limit_s;
    let unlimited = Options {
        sigma_limit_s: f64::INFINITY,
        ..*options
    };
    let (full, differ) = in_band(a, b, &unlimited);
    let limited = |mut refusal: Refusal| {
        refusal.report.limit_sigma(limit_s);
        refusal
    };
    let full = full.map_err(limited);
    let is_left_out = |estimate: &Estimate| !estimate.report.left_out.is_empty();
    let is_doubtful = match &full {
        Ok(estimate) => differ || is_left_out(estimate),
        Err(refusal) => bands::is_explainable(refusal),
    };
    let mut found = if is_doubtful {
        let lower = |options: &Options| in_band(a, b, options).0;
        bands::joined(full, differ, &unlimited, lower).map_err(limited)?
    } else {
        full?
    };
    found.report.limit_sigma(limit_s);
    if found.report.is_passed() {
        Ok(found)
    } else {
        let report = found.report;
        Err(Refusal { report })
    }
}

/// Estimates the relation in one band. Returns true as well if slow motion contradicts it.
///
/// If a filter is long, the shape that leaves least of the motion unexplained counts, or that the
/// delay is a delay alone.
fn in_band(a: &GyroTrack, b: &GyroTrack, options: &Options) -> (Result<Estimate, Refusal>, bool) {
    let delays = [options.a_delay_s, options.b_delay_s];
    let alone = with_shape(a, b, options, None);
    if delays.iter().all(|delay_s| *delay_s < filter::LONG_S) {
        return alone;
    }
    let unexplained = |(found, _): &(Result<Estimate, Refusal>, bool)| match found {
        Ok(Estimate { report, .. }) | Err(Refusal { report }) => {
            let share = report.residual_rms.zip(report.motion_rms);
            share.map_or(f64::INFINITY, |(left, motion)| left / motion)
        }
    };
    let of_shape = |shape: f64| (shape, with_shape(a, b, options, Some(shape)));
    let mut shapes = filter::SHAPES.map(of_shape).to_vec();
    let square = |of: &(f64, (Result<Estimate, Refusal>, bool))| (of.0, unexplained(&of.1).powi(2));
    for _ in 0..REFINED {
        let squares: Vec<(f64, f64)> = shapes.iter().map(square).collect();
        let threes = squares.windows(3).map(|own| [own[0], own[1], own[2]]);
        let three = threes.min_by(|x, y| x[1].1.total_cmp(&y[1].1));
        let Some(shape) = three.and_then(filter::likeliest) else {
            break;
        };
        shapes.push(of_shape(shape));
        shapes.sort_by(|x, y| x.0.total_cmp(&y.0));
    }
    let best = |x, y| {
        if unexplained(&y) < unexplained(&x) {
            y
        } else {
            x
        }
    };
    shapes.into_iter().map(|of| of.1).fold(alone, best)
}

/// Estimates the relation in one band with long filters of this shape.
fn with_shape(
    a: &GyroTrack,
    b: &GyroTrack,
    options: &Options,
    shape: Option<f64>,
) -> (Result<Estimate, Refusal>, bool) {
    let mut differ = false;
    let mut report = Report::default();
    let unequal = a.unequal().max(b.unequal());
    if unequal > 0 {
        report.judge(Gate::lengths(unequal));
        return (Err(Refusal { report }), false);
    }
    let a = CheckedStream::new(Stream::A, a, options.a_delay_s, 0.0, options);
    let jump_s = options.b_jump_s;
    let b = CheckedStream::new(Stream::B, b, options.b_delay_s, jump_s, options);
    let usable = |s: &Option<CheckedStream<'_>>| s.as_ref().map_or(0, CheckedStream::usable_count);
    let enough = report.judge(Gate::samples(usable(&a).min(usable(&b))));
    let Some((a, b)) = a.zip(b) else {
        return (Err(Refusal { report }), false);
    };
    let sampled = report.judge(Gate::rate(a.step_s.max(b.step_s)));
    let (mut a, mut b) = (a, b);
    if let Some(shape) = shape {
        for (stream, delay_s) in [(&mut a, options.b_delay_s), (&mut b, options.a_delay_s)] {
            if delay_s >= filter::LONG_S {
                stream.pass_through(delay_s, shape);
            }
        }
    }
    let mut pair = Pair::new(a, b);
    let mut dispersions = [options.a_delay_s, options.b_delay_s]
        .map(|delay_s| axes::dispersion(delay_s, shape.filter(|_| delay_s >= filter::LONG_S)));
    if pair.a_is_model {
        dispersions.reverse();
    }
    let [data, model] = dispersions;
    let dispersion = data.less(model);
    let found = enough
        .and(sampled)
        .and_then(|()| related(&mut pair, options, dispersion, &mut report, &mut differ));
    report.faults = pair.faults();
    report.left_out = pair.left_out;
    let result = match found {
        Some((clock, calibration)) if report.is_passed() => Ok(Estimate {
            clock,
            calibration: calibration.matrix.transpose().into(),
            bias: calibration.bias.into(),
            report,
        }),
        found => {
            if found.is_none() && report.is_passed() {
                report.gates.push(Gate::unsolvable());
            }
            // The causes of other failures come first.
            let causes = causes([&pair.model, &pair.data]);
            report
                .gates
                .splice(0..0, causes.into_iter().filter(|gate| !gate.passed));
            Err(Refusal { report })
        }
    };
    (result, differ)
}

/// Judges faults of whole recordings that make all other gates fail.
fn causes(streams: [&CheckedStream<'_>; 2]) -> [Gate; 2] {
    let used = |s: &CheckedStream<'_>| -> Vec<Vector3<f64>> {
        let kept = (0..s.w.len()).filter(|&k| s.usable[k]);
        kept.map(|k| s.w[k].into()).collect()
    };
    let rates = streams.map(used);
    let constant = |rates: &Vec<Vector3<f64>>| {
        let is_constant = |&axis: &usize| rates.iter().all(|w| w[axis] == rates[0][axis]);
        (0..3).filter(is_constant).count()
    };
    let [a, b] = rates.each_ref().map(constant);
    let [x, y] = rates
        .each_ref()
        .map(|w| fit::variance(w.iter().copied()).sqrt());
    // A recording without any motion says nothing about its unit.
    let ratio = if x.min(y) > 0.0 {
        x.max(y) / x.min(y)
    } else {
        1.0
    };
    [Gate::axes(a.max(b)), Gate::unit(ratio)]
}

/// The relation of the clocks and of the sensors, all gates judged; `None` where a
/// gate or the equations stop the work early.
fn related(
    pair: &mut Pair<'_>,
    options: &Options,
    dispersion: Dispersion,
    report: &mut Report,
    differ: &mut bool,
) -> Option<(ClockRelation, Calibration)> {
    let mut signals = pair.signals(options.low_pass_hz);
    report.judge(Gate::motion(
        rms(&signals.model.signal).min(rms(&signals.data.signal)),
    ))?;
    let settings = Settings::new(options.low_pass_hz, pair);
    let (start, unexplained) = lag::chosen(pair, &signals, options, &settings, report)?;
    let mut in_one_relation = 1.0;
    if !unexplained.is_empty() {
        pair.leave_out_unexplained(&start, &unexplained);
        let is_step = |s: &&Stretch| matches!(s.why, Why::TimeStep(_));
        let loose = unexplained.iter().filter(|s| !is_step(s));
        let one_body = rigid::kept_share(loose);
        report.judge(Gate::one_body(one_body))?;
        let steps = 1.0 - rigid::kept_share(unexplained.iter().filter(is_step));
        in_one_relation = 1.0 - steps / one_body;
    }
    let mut fit = pair.fitted(&mut signals, start, &settings)?;
    *differ = bands::differ(&fit, pair, &signals, &settings);
    let (mut kept_share, mut open) = (1.0, Matrix2::zeros());
    let mut late_axis = None;
    let first = fit.link;
    let mut late = axes::found(&fit, &settings.fit, dispersion);
    if options.handle_faults {
        // A surely late axis would look like faults of its samples.
        late_axis = late
            .as_ref()
            .and_then(|late| late.axis)
            .filter(|late| late.probability > BEYOND_DOUBT && late.by.value.abs() > MUCH_LATER_S);
        if let Some(late) = &late_axis {
            pair.advance(late);
            fit = pair.fitted(&mut signals, fit.link, &settings)?;
        }
        let left_open = pair.review(&fit, &signals, &settings);
        if pair.is_changed() {
            fit = pair.fitted(&mut signals, fit.link, &settings)?;
        }
        (fit, kept_share) = pair.without_faults(fit, &mut signals, &settings)?;
        open = left_open + pair.open_jumps(&fit, &signals, &settings);
    }
    // An axis that was advanced says nothing more about the offset.
    let least = late_axis.map_or(0.0, |late| late.variance);
    if fit.link != first {
        late = axes::found(&fit, &settings.fit, dispersion);
    }
    if let Some(late) = late {
        fit.link.at_model += late.shift[0];
        fit.link.rate += late.shift[1];
        fit.covariance = late.covariance;
        let wider = (least / fit.covariance[(0, 0)]).max(1.0);
        let wider = Matrix2::from_diagonal(&Vector2::new(wider.sqrt(), 1.0));
        fit.covariance = wider * fit.covariance * wider;
        late_axis = late_axis.or(late.axis);
    }
    wander::include_wander(&mut fit, settings.fit.oversampling);
    let noise_s = fit.covariance[(0, 0)].sqrt();
    fit.covariance += open + pair.of_stamps(&fit.link);
    report.common_s = common_s(pair);
    let clock = clock_of(pair, &fit, report.common_s, options.wander);
    let calibration = calibration(pair, &fit, &settings, report);
    let kept = pair.model.usable_part().min(pair.data.usable_part());
    let used_s = report.overlap_s.unwrap_or(0.0);
    report.gates.extend([
        Gate::usable(kept),
        Gate::one_relation(in_one_relation * kept_share),
        Gate::overlap(used_s, options.min_overlap_s),
        Gate::consistent(
            crosscheck::local_scatter(&fit, PARTS),
            PARTS.sqrt() * noise_s,
        ),
        Gate::sigma(clock.covariance[0][0].sqrt(), options.sigma_limit_s),
        Gate::skew(clock.skew, clock.covariance[1][1].sqrt()),
        Gate::settled(fit.settled),
    ]);
    report.warnings = warnings(pair, &fit, late_axis);
    report.together = together(pair, &fit);
    Some((clock, calibration))
}

/// Rms of the motion about its mean, all axes together, rad/s.
fn rms(signal: &Signal) -> f64 {
    let values = signal.sampled(0.02);
    let variance = fit::variance(values.iter().map(|(_, v)| Vector3::from(*v)));
    (3.0 * variance).sqrt()
}

/// 1-sigma of the offset due to unresolved faults of both streams, seconds.
fn unresolved_s(pair: &Pair<'_>) -> f64 {
    pair.model.unresolved_s.hypot(pair.data.unresolved_s)
}

/// Part of the offset's 1-sigma that all estimates of these streams share, seconds: half a step
/// of coarse stamps.
fn common_s(pair: &Pair<'_>) -> f64 {
    0.5 * pair.model.resolution_s.hypot(pair.data.resolution_s)
}

/// Returns the relation of clock b to clock a, at the reference at which offset and skew
/// are independent.
fn clock_of(pair: &Pair<'_>, fit: &Fit, common_s: f64, wander: Wander) -> ClockRelation {
    let ideal = &fit.ideal_covariance;
    let to_centroid = if ideal[(1, 1)] > 0.0 {
        -ideal[(0, 1)] / ideal[(1, 1)]
    } else {
        0.0
    };
    let (first, last) = (
        fit.nodes.first().map_or(0.0, |n| n.t),
        fit.nodes.last().map_or(0.0, |n| n.t),
    );
    let centroid = (fit.link.at_data + to_centroid).clamp(first, last.max(first));
    let step = transition(centroid - fit.link.at_data);
    let link = fit.link.moved_to(centroid);
    let mut covariance = step * fit.covariance * step.transpose();
    covariance[(0, 0)] +=
        unresolved_s(pair).powi(2) + common_s.powi(2) + NUMERICAL_FLOOR_S * NUMERICAL_FLOOR_S;
    covariance[(1, 1)] += pair.model.unresolved_skew.powi(2) + pair.data.unresolved_skew.powi(2);
    // The same error, over the time in which the information is.
    let square_span = (ideal[(0, 0)] + to_centroid * ideal[(0, 1)]) / ideal[(1, 1)];
    if square_span > 0.0 {
        covariance[(1, 1)] += NUMERICAL_FLOOR_S * NUMERICAL_FLOOR_S / square_span;
    }

    let model_to_data = ClockRelation {
        reference: pair.model.epoch_s + link.at_model,
        offset: (pair.data.epoch_s - pair.model.epoch_s) + link.lag_s(),
        skew: 1.0 / link.rate - 1.0,
        covariance: covariance.into(),
        wander,
    };
    if pair.a_is_model {
        model_to_data
    } else {
        model_to_data.inverted()
    }
}

/// Returns the relation of sensor b to sensor a, and reports the residual that it leaves.
fn calibration(
    pair: &Pair<'_>,
    fit: &Fit,
    settings: &Settings,
    report: &mut Report,
) -> Calibration {
    let rates = fit.nodes.iter().map(|node| {
        let (model, data) = node.rates();
        pair.a_and_b(model, data)
    });
    let calibration = calibration::regress(rates.clone(), settings.fit.noise_variance);
    let squares: f64 = rates
        .map(|(a, b)| calibration.residual(&a, &b).norm_squared())
        .sum();
    let residual_rms = (squares / (3.0 * fit.nodes.len().max(1) as f64)).sqrt();
    let motion_rms = fit.motion_variance().sqrt();
    report.residual_rms = Some(residual_rms);
    report.motion_rms = Some(motion_rms);
    report.overlap_s = Some(fit.nodes.len() as f64 * settings.step_s);
    let noise_rms = settings.fit.noise_variance.sqrt();
    report
        .gates
        .push(Gate::residual(residual_rms, motion_rms, noise_rms));
    calibration
}

/// The stretches that were used, in seconds from the first sample of a.
fn together(pair: &Pair<'_>, fit: &Fit) -> Vec<(f64, f64)> {
    let stretches = fit
        .nodes
        .chunk_by(|node, next| next.t - node.t < rigid::JOIN_S);
    stretches
        .filter_map(|nodes| Some((nodes.first()?.t, nodes.last()?.t)))
        .map(|(from, to)| {
            (
                pair.since_first_of_a(&fit.link, from),
                pair.since_first_of_a(&fit.link, to),
            )
        })
        .collect()
}

fn warnings(pair: &Pair<'_>, fit: &Fit, late_axis: Option<LateAxis>) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let n = fit.nodes.len().max(1) as f64;
    let mean = fit::mean(fit.nodes.iter().map(|n| n.y));
    let mut spread = Matrix3::zeros();
    for node in &fit.nodes {
        let d = node.y - mean;
        spread += d * d.transpose() / n;
    }
    let mut powers: [f64; 3] = SymmetricEigen::new(spread).eigenvalues.into();
    powers.sort_by(f64::total_cmp);
    if powers[1] < SECOND_AXIS * powers[2] {
        warnings.push(Warning::OneAxis);
    }
    let sigma_s = unresolved_s(pair);
    if sigma_s > 0.0 {
        warnings.push(Warning::TimeLeftOpen { sigma_s });
    }
    warnings.extend(late_axis.map(|late| {
        Warning::LateAxis {
            stream: if late.of_data {
                &pair.data
            } else {
                &pair.model
            }
            .stream,
            axis: late.axis,
            by: late.by,
        }
    }));
    for checked in [&pair.model, &pair.data] {
        let (stream, resolution_s) = (checked.stream, checked.resolution_s);
        if resolution_s > 0.0 {
            warnings.push(Warning::CoarseStamps {
                stream,
                resolution_s,
            });
        }
        warnings.extend(checked.made.map(|made| match made {
            Made::Interpolated(rate_hz) => Warning::Interpolated { stream, rate_hz },
            Made::Held(rate_hz) => Warning::Held { stream, rate_hz },
        }));
    }
    warnings
}
