//! Traits of real streams, imposed on views of the real twist: each is found and named, and
//! the stated sigma is honest in spite of it.

use rayon::prelude::*;
use twist_scenarios::{RealMotion, TwistSpec};
use twist_sync::{
    Estimate, FaultKind, Gate, GateKind, GyroTrack, Options, Stream, Warning, estimate_offset,
};

/// Noise of a sample of either gyroscope, rad/s.
const NOISE: f64 = 1.4e-3;
/// Trials for each trait.
const TRIALS: u64 = 24;

type Trait = Box<dyn Fn(&RealMotion, u64) -> GyroTrack + Sync>;

struct Case {
    name: &'static str,
    /// Creates recording b for a seed.
    b: Trait,
    /// Largest rms of the offset's error, µs, of the offset's error over its sigma, and of the
    /// skew's. With 24 trials, 1.3 and 1.5 are two and 3.5 sigmas above one.
    limits: (f64, f64, f64),
    /// Condition that each estimate must meet.
    is_found: fn(&Estimate) -> bool,
}

fn case(
    name: &'static str,
    limits: (f64, f64, f64),
    is_found: fn(&Estimate) -> bool,
    b: impl Fn(&RealMotion, u64) -> GyroTrack + Sync + 'static,
) -> Case {
    let b = Box::new(b);
    Case {
        name,
        b,
        limits,
        is_found,
    }
}

fn warned(estimate: &Estimate, is: impl Fn(&Warning) -> bool) -> bool {
    estimate.report.warnings.iter().any(is)
}

/// Values that are held are recognised, with the rate at which they change to a twentieth.
fn is_held(estimate: &Estimate, hz: f64) -> bool {
    let is_near = |rate_hz: f64| (rate_hz - hz).abs() < 0.048 * hz;
    warned(
        estimate,
        |w| matches!(w, Warning::Held { rate_hz, .. } if is_near(*rate_hz)),
    )
}

fn has_no(estimate: &Estimate, kind: FaultKind) -> bool {
    estimate
        .report
        .faults
        .iter()
        .all(|fault| fault.kind != kind)
}

/// A recording sampled at `sampled` and stamped with `stamps`.
fn stamped(
    motion: &RealMotion,
    seed: u64,
    sampled: &[f64],
    stamps: impl Fn(f64) -> f64,
) -> GyroTrack {
    let view = motion.view(seed, sampled, NOISE);
    let stamps: Vec<f64> = sampled[..view.len()].iter().map(|&t| stamps(t)).collect();
    GyroTrack::from_seconds(&stamps, view.w)
}

/// Samples of `slow_hz`, raised to `hz` by `between`: of two neighbours and the place.
fn raised(
    slow_hz: f64,
    hz: f64,
    between: fn(f64, f64, f64) -> f64,
) -> impl Fn(&RealMotion, u64) -> GyroTrack {
    move |motion, seed| {
        let slow = motion.view(seed, &motion.regular(seed, slow_hz), NOISE);
        let first = slow.epoch_s;
        let count = ((slow.len() - 2) as f64 * hz / slow_hz) as usize;
        let times: Vec<f64> = (0..count).map(|k| first + k as f64 / hz).collect();
        let value = |t: &f64| {
            let x = (t - first) * slow_hz + 1e-9;
            let k = x as usize;
            std::array::from_fn(|axis| between(slow.w[k][axis], slow.w[k + 1][axis], x - k as f64))
        };
        let w = times.iter().map(value).collect();
        GyroTrack::from_seconds(&times, w)
    }
}

fn is_coarse(warning: &Warning) -> bool {
    matches!(
        warning,
        Warning::CoarseStamps {
            stream: Stream::B,
            ..
        }
    )
}

fn cases() -> Vec<Case> {
    let any = |_: &Estimate| true;
    vec![
        case(
            "no trait",
            (14.0, 1.4, 1.4),
            |e| {
                e.report.warnings == [Warning::OneAxis]
                    && e.report.faults.iter().all(|f| f.kind == FaultKind::Outlier)
            },
            |motion, seed| motion.view(seed, &motion.regular(seed, 416.0), NOISE),
        ),
        case(
            "stamps cut to 1 ms",
            (560.0, 1.4, 1.5),
            |e| warned(e, is_coarse),
            |motion, seed| {
                stamped(motion, seed, &motion.regular(seed, 119.7), |t| {
                    (t * 1e3).floor() * 1e-3
                })
            },
        ),
        case(
            "stamps cut to 10 ms",
            (5600.0, 1.4, 1.5),
            |e| warned(e, is_coarse),
            |motion, seed| {
                stamped(motion, seed, &motion.regular(seed, 84.3), |t| {
                    (t * 1e2).floor() * 1e-2
                })
            },
        ),
        case(
            "120 Hz raised to 286 Hz",
            (40.0, 1.5, 1.5),
            |e| {
                warned(
                    e,
                    |w| matches!(w, Warning::Interpolated { rate_hz, .. } if (rate_hz - 120.0).abs() < 6.0),
                ) && has_no(e, FaultKind::DisplacedClass)
            },
            raised(120.0, 286.0, |a, b, x| a + (b - a) * x),
        ),
        case(
            "values held four times",
            (40.0, 1.5, 1.5),
            |e| is_held(e, 125.0),
            raised(125.0, 500.0, |a, _, _| a),
        ),
        case(
            "values of 50 Hz held four times",
            (60.0, 1.5, 1.5),
            |e| is_held(e, 50.0),
            raised(50.0, 200.0, |a, _, _| a),
        ),
        // Each 16th distance is three quarters of the others, and so the samples are.
        case(
            "a true pattern of sampling",
            (20.0, 1.4, 1.5),
            |e| has_no(e, FaultKind::TimestampSawtooth),
            |motion, seed| {
                let mut t = 0.01;
                let times: Vec<f64> = (0..900)
                    .map(|k| {
                        t += if (k + seed) % 16 == 0 {
                            7.5595e-3
                        } else {
                            10.0793e-3
                        };
                        t
                    })
                    .collect();
                motion.view(seed, &times, NOISE)
            },
        ),
        case(
            "the same of the stamps alone",
            (40.0, 1.5, 1.5),
            |e| !has_no(e, FaultKind::TimestampSawtooth),
            |motion, seed| {
                let mean = (15.0 * 10.0793e-3 + 7.5595e-3) / 16.0;
                let sampled: Vec<f64> = motion.regular(seed, 1.0 / mean);
                let view = motion.view(seed, &sampled, NOISE);
                let stamps: Vec<f64> = (0..view.len())
                    .map(|k| {
                        let place = ((k as u64 + seed) % 16) as f64;
                        sampled[k] + (place - 7.5) * (10.0793e-3 - mean)
                    })
                    .collect();
                GyroTrack::from_seconds(&stamps, view.w)
            },
        ),
        case(
            "five samples of 150 rad/s",
            (14.0, 1.5, 1.5),
            any,
            |motion, seed| {
                let mut view = motion.view(seed, &motion.regular(seed, 243.0), NOISE);
                for k in 0..5 {
                    let at = (seed as usize * 131 + k * 421) % view.len();
                    view.w[at][k % 3] = 150.0;
                }
                view
            },
        ),
        case("a weak sensor", (500.0, 1.4, 1.5), any, |motion, seed| {
            motion.view(seed, &motion.regular(seed, 100.0), 18e-3)
        }),
    ]
}

#[test]
fn traits_of_real_streams_are_found_and_the_sigma_is_honest() {
    let motion = RealMotion::twist();
    let options = Options {
        sigma_limit_s: 20e-3,
        ..Options::default()
    };
    let judged: Vec<Vec<String>> = cases()
        .par_iter()
        .map(|case| {
            let (mut wrong, mut squares, mut z_offset, mut z_skew) = (Vec::new(), 0.0, 0.0, 0.0);
            let mut accepted = 0.0;
            for seed in 1..=TRIALS {
                let a = motion.view(1000 + seed, &motion.regular(1000 + seed, 500.0), NOISE);
                match estimate_offset(&a, &(case.b)(&motion, seed), &options) {
                    Ok(estimate) => {
                        accepted += 1.0;
                        squares += estimate.clock.offset.powi(2);
                        z_offset += (estimate.clock.offset / estimate.offset_sigma_s()).powi(2);
                        z_skew += (estimate.clock.skew / estimate.skew_sigma()).powi(2);
                        if !(case.is_found)(&estimate) {
                            let report = &estimate.report;
                            wrong.push(format!(
                                "{}: {seed}: {:?} {:?}",
                                case.name,
                                report.warnings,
                                report
                                    .faults
                                    .iter()
                                    .map(|f| (f.kind, f.count))
                                    .collect::<Vec<_>>()
                            ));
                        }
                    }
                    Err(refusal) => wrong.push(format!("{}: {seed}: {refusal}", case.name)),
                }
            }
            let rms = |sum: f64| f64::sqrt(sum / f64::max(accepted, 1.0));
            let found = (1e6 * rms(squares), rms(z_offset), rms(z_skew));
            println!(
                "{:32} rmse {:7.1} µs, error/sigma {:.2}, of the skew {:.2}",
                case.name, found.0, found.1, found.2
            );
            let limits = case.limits;
            if found.0 > limits.0 || found.1 > limits.1 || found.2 > limits.2 {
                wrong.push(format!(
                    "{}: {found:?} where {limits:?} is the limit",
                    case.name
                ));
            }
            wrong
        })
        .collect();
    let wrong = judged.concat();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// With simulated twists about all axes: a twist about one axis often leaves it undecided which
/// stream's axis is late.
#[test]
fn an_axis_that_is_late_is_found_or_in_the_sigma() {
    for (by_s, is_clear) in [
        (4.8e-3, true),
        (0.4e-3, true),
        (0.05e-3, false),
        (0.0, false),
    ] {
        let judged: Vec<(f64, bool)> = (0..TRIALS)
            .into_par_iter()
            .map(|seed| {
                let mut spec = TwistSpec::default();
                spec.b.rate_hz = 104.0;
                let mut twist = twist_scenarios::twist(&spec, 1000 * seed + 61);
                let axis = (seed % 3) as usize;
                let on_time = twist.b.clone();
                twist_scenarios::displace(&mut twist.b, by_s, |_| true);
                for (own, on_time) in twist.b.w.iter_mut().zip(&on_time.w) {
                    let late = own[axis];
                    *own = *on_time;
                    own[axis] = late;
                }
                let estimate = estimate_offset(&twist.a, &twist.b, &Options::default());
                let estimate = estimate.unwrap_or_else(|refusal| panic!("{by_s} {seed}: {refusal}"));
                let error = estimate.clock.offset - twist.offset_at(estimate.clock.reference);
                let is_named = |w: &Warning| {
                    matches!(w, Warning::LateAxis { stream: Stream::B, axis: named, .. } if *named == axis)
                };
                let named = estimate.report.warnings.iter().any(is_named);
                (error / estimate.offset_sigma_s(), named)
            })
            .collect();
        let named = judged.iter().filter(|j| j.1).count();
        let rms = (judged.iter().map(|j| j.0 * j.0).sum::<f64>() / TRIALS as f64).sqrt();
        println!("{by_s}: named {named} of {TRIALS}, error/sigma {rms:.2}");
        assert!(rms < 1.4, "{by_s}: {rms:.2}");
        assert!(
            !is_clear || named as u64 * 10 >= TRIALS * 8,
            "{by_s}: {named}"
        );
        assert!(by_s > 0.0 || named == 0, "{named} named without reason");
    }
}

/// If the clock jumped, it is unknown which side of the jump is right.
#[test]
fn a_jump_of_the_stamps_is_found_or_in_the_sigma() {
    let (mut accepted, mut squares) = (0.0, 0.0);
    for seed in 0..TRIALS {
        let mut twist = twist_scenarios::twist(&TwistSpec::default(), 1000 * seed + 67);
        let at = 2.5 + 0.04 * seed as f64;
        for t in &mut twist.b.t {
            *t += if *t > at { 0.6e-3 } else { 0.0 };
        }
        if let Ok(estimate) = estimate_offset(&twist.a, &twist.b, &Options::default()) {
            let error = estimate.clock.offset - twist.offset_at(estimate.clock.reference);
            let error = error.abs().min((error - 0.6e-3).abs());
            assert!(error < 4.5 * estimate.offset_sigma_s(), "{seed}: {error}");
            accepted += 1.0;
            squares += ((estimate.clock.skew - twist.skew) / estimate.skew_sigma()).powi(2);
        }
    }
    println!(
        "accepted {accepted} of {TRIALS}, skew's error/sigma {:.2}",
        f64::sqrt(squares / accepted)
    );
    assert!(accepted > 0.25 * TRIALS as f64 && squares < 1.4 * 1.4 * accepted);
}

/// Rates of sines, without any noise, as people try it.
#[test]
fn exact_data_are_right_to_a_tenth_of_a_microsecond() {
    let motion = |t: f64| {
        let (x, y) = (2.0 * (3.0 * t).sin(), 1.5 * (4.2 * t).sin());
        [
            x + (7.1 * t).cos(),
            y,
            (2.3 * t).cos() - 0.7 * (5.7 * t).sin(),
        ]
    };
    for (a_hz, b_hz) in [
        (100.0, 100.0),
        (200.0, 100.0),
        (500.0, 500.0),
        (100.0, 120.0),
    ] {
        for one_axis in [false, true] {
            let track = |hz: f64, later_s: f64| {
                let t: Vec<f64> = (0..(10.0 * hz) as usize).map(|k| k as f64 / hz).collect();
                let rate = |t: &f64| match motion(t + later_s) {
                    [x, _, _] if one_axis => [x, 0.0, 0.0],
                    all => all,
                };
                GyroTrack::from_seconds(&t, t.iter().map(rate).collect())
            };
            let (a, b) = (track(a_hz, 0.0), track(b_hz, 0.123_456_7));
            // Without a word they may as well be cut to a hundredth of a second.
            let refusal = estimate_offset(&a, &b, &Options::default()).unwrap_err();
            let is_sigma = |gate: &Gate| !gate.passed && gate.kind == GateKind::Sigma;
            assert!(refusal.report.gates.iter().any(is_sigma));
            let options = Options {
                exact_stamps: true,
                ..Options::default()
            };
            let estimate = estimate_offset(&a, &b, &options);
            let estimate = estimate.unwrap_or_else(|refusal| panic!("{a_hz} {b_hz}: {refusal}"));
            assert!(
                (estimate.clock.offset + 0.123_456_7).abs() < 0.1e-6,
                "{a_hz} {b_hz}"
            );
        }
    }
}

#[test]
fn faults_of_a_whole_recording_are_reported_first() {
    let first = |change: fn(&mut [f64; 3])| {
        let mut twist = twist_scenarios::twist(&TwistSpec::default(), 71_000);
        twist.b.w.iter_mut().for_each(change);
        // Not the same twist: it is refused for more than one reason.
        let other = twist_scenarios::twist(&TwistSpec::default(), 72_000).a;
        let refusal = estimate_offset(&other, &twist.b, &Options::default()).unwrap_err();
        let failed = refusal.report.gates.iter().find(|gate| !gate.passed);
        failed.map(|gate| gate.kind)
    };
    assert_eq!(first(|w| *w = [w[0], 0.0, 0.0]), Some(GateKind::Axes));
    assert_eq!(first(|w| *w = w.map(f64::to_degrees)), Some(GateKind::Unit));
    assert_eq!(first(|_| {}), Some(GateKind::Explained));
    let mut cut = twist_scenarios::twist(&TwistSpec::default(), 71_000);
    cut.b.w.truncate(2000);
    let refusal = estimate_offset(&cut.a, &cut.b, &Options::default()).unwrap_err();
    assert_eq!(refusal.report.gates[0].kind, GateKind::Lengths);
}
