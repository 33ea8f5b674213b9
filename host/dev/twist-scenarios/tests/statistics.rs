//! Statistics of the clock estimate on simulated twists, scenario by scenario.
//!
//! All figures are of simulated recordings. The number of trials per scenario is
//! 40, or `SYNC_TRIALS`; the full study of 300 is `cargo xtask bench sync`.

use rayon::prelude::*;
use twist_scenarios::{Scenario, Twist, TwistSpec, options};
use twist_sync::{Estimate, FaultKind, GyroTrack, Options, Refusal, estimate_offset};

fn trials() -> u64 {
    std::env::var("SYNC_TRIALS")
        .ok()
        .and_then(|s| s.parse().ok())
        .unwrap_or(40)
}

fn error_s(estimate: &Estimate, twist: &Twist) -> f64 {
    estimate.clock.offset - twist.offset_at(estimate.clock.reference)
}

/// Runs the trials of the scenario at this position in the list.
fn run(place: u64, scenario: &Scenario) -> Vec<(Twist, Result<Estimate, Refusal>)> {
    let options = options(&scenario.spec);
    // Seeds are far apart, so that each trial has its own boot times, and each scenario its own
    // motions: the same forty in all would be forty twists in the pool.
    (0..trials())
        .into_par_iter()
        .map(|trial| {
            let seed = 1000 * (place * trials() + trial) + 7;
            let twist = twist_scenarios::twist(&scenario.spec, seed);
            let result = estimate_offset(&twist.a, &twist.b, &options);
            (twist, result)
        })
        .collect()
}

#[test]
fn every_scenario_meets_its_figures() {
    let mut failures = Vec::new();
    // Over all honest scenarios: squares of error over sigma of offset and skew, number.
    let mut pooled = [0.0; 3];
    for (place, scenario) in (0..).zip(twist_scenarios::scenarios()) {
        let results = run(place, &scenario);
        let mut accepted = 0;
        let (mut squares, mut normalised, mut skews) = (0.0, 0.0, 0.0);
        let mut refusals = Vec::new();
        for (trial, (twist, result)) in results.iter().enumerate() {
            match (result, scenario.rmse_us) {
                (Ok(estimate), Some(_)) => {
                    let error = error_s(estimate, twist);
                    let z = error / estimate.offset_sigma_s();
                    accepted += 1;
                    squares += error * error;
                    normalised += z * z;
                    skews += ((estimate.clock.skew - twist.skew) / estimate.skew_sigma()).powi(2);
                    if z.abs() > 6.0 {
                        failures.push(format!(
                            "{}: trial {trial}: wrong and accepted, {:.2} µs at sigma {:.2} µs",
                            scenario.name,
                            error * 1e6,
                            estimate.offset_sigma_s() * 1e6
                        ));
                    }
                }
                (Ok(_), None) => failures.push(format!(
                    "{}: trial {trial}: accepted what must be refused",
                    scenario.name
                )),
                (Err(refusal), Some(_)) => {
                    refusals.push(format!(
                        "{}: trial {trial}: refused: {refusal}",
                        scenario.name
                    ));
                }
                (Err(refusal), None) => {
                    if refusal.report.gates.iter().all(|g| g.passed) {
                        failures.push(format!(
                            "{}: trial {trial}: refused without a reason",
                            scenario.name
                        ));
                    }
                }
            }
        }
        if f64::from(accepted) < scenario.accepted * results.len() as f64 {
            failures.append(&mut refusals);
        }
        let Some(limit) = scenario.rmse_us else {
            println!("{:28} all {} refused", scenario.name, results.len());
            continue;
        };
        let rmse = (squares / f64::from(accepted.max(1))).sqrt() * 1e6;
        let z = (normalised / f64::from(accepted.max(1))).sqrt();
        let of_skew = (skews / f64::from(accepted.max(1))).sqrt();
        println!(
            "{:28} rmse {rmse:6.2} µs, error/sigma {z:.2}, of the skew {of_skew:.2}",
            scenario.name
        );
        if rmse > limit {
            failures.push(format!("{}: rmse {rmse:.2} µs > {limit} µs", scenario.name));
        }
        // 40 trials scatter by 11 %: the bounds of the full study, widened by 2 sigma.
        let slack = 2.0 / (2.0 * trials() as f64).sqrt();
        let honest = 0.8 - slack..1.25 + slack;
        if scenario.honest {
            let own = [normalised, skews, f64::from(accepted)];
            pooled
                .iter_mut()
                .zip(own)
                .for_each(|(sum, own)| *sum += own);
        }
        let is_right = |required: bool, ratio: f64| !required || honest.contains(&ratio);
        if !(is_right(scenario.honest, z) && is_right(scenario.honest_skew, of_skew)) {
            failures.push(format!(
                "{}: error over sigma {z:.2}, of the skew {of_skew:.2}",
                scenario.name
            ));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    // Over 900 twists scatter by 2.4 %: a sigma that is wrong by a fifth everywhere fails.
    let [offset, skew] = [pooled[0], pooled[1]].map(|sum| f64::sqrt(sum / pooled[2]));
    println!("all honest scenarios: error/sigma {offset:.3}, of the skew {skew:.3}");
    assert!((0.9..1.15).contains(&offset), "{offset:.3}");
    assert!((0.9..1.15).contains(&skew), "{skew:.3}");
}

#[test]
fn exchanging_the_inputs_negates_the_offset() {
    (0..2_u64).into_par_iter().for_each(|trial| {
        for scenario in twist_scenarios::scenarios()
            .iter()
            .filter(|s| s.rmse_us.is_some())
        {
            let twist = twist_scenarios::twist(&scenario.spec, 1000 * trial + 11);
            let there = estimate_offset(&twist.a, &twist.b, &Options::default()).unwrap();
            let back = estimate_offset(&twist.b, &twist.a, &Options::default()).unwrap();
            let at_same_instant = there.clock.a_to_b(there.clock.reference);
            assert!(
                (at_same_instant - back.clock.reference).abs() < 1e-6,
                "{}",
                scenario.name
            );
            let left_out = [&there, &back].map(|estimate| estimate.report.left_out.len());
            assert_eq!(left_out[0], left_out[1], "{}", scenario.name);
            assert!(
                (there.clock.offset + back.clock.offset).abs() < 1e-9,
                "{}: {} {}",
                scenario.name,
                there.clock.offset,
                back.clock.offset
            );
        }
    });
}

/// The two roles in the fit differ, but the result must not depend on them.
#[test]
fn the_roles_of_the_streams_do_not_matter() {
    for trial in 0..20 {
        let twist = twist_scenarios::twist(&TwistSpec::default(), 1000 * trial + 13);
        let there = estimate_offset(&twist.a, &twist.b, &Options::default()).unwrap();
        // The stream with more samples is the model: cut the one, then the other.
        let cut = |track: &GyroTrack| track.between(track.epoch_s + 0.02, f64::INFINITY);
        let a = estimate_offset(&cut(&twist.a), &twist.b, &Options::default()).unwrap();
        let b = estimate_offset(&twist.a, &cut(&twist.b), &Options::default()).unwrap();
        for other in [a, b] {
            let moved = other.clock.offset_at(there.clock.reference).value - there.clock.offset;
            assert!(moved.abs() < 1e-6, "{moved}");
        }
    }
}

#[test]
fn irrelevant_changes_move_the_offset_by_less_than_a_sigma() {
    for trial in 0..12 {
        let twist = twist_scenarios::twist(&TwistSpec::default(), 1000 * trial + 17);
        let base = estimate_offset(&twist.a, &twist.b, &Options::default()).unwrap();
        let moved = |a: &GyroTrack, options: &Options| {
            let other = estimate_offset(a, &twist.b, options).unwrap();
            let shift = other.clock.offset_at(base.clock.reference).value - base.clock.offset;
            shift / other.offset_sigma_s()
        };
        for low_pass_hz in [15.0, 20.0, 35.0, 50.0] {
            let z = moved(
                &twist.a,
                &Options {
                    low_pass_hz,
                    ..Options::default()
                },
            );
            assert!(z.abs() < 1.0, "{low_pass_hz} Hz: {z}");
        }
        let half = GyroTrack {
            epoch_s: twist.a.epoch_s,
            t: twist.a.t.iter().copied().step_by(2).collect(),
            w: twist.a.w.iter().copied().step_by(2).collect(),
        };
        let z = moved(&half, &Options::default());
        assert!(z.abs() < 1.6, "every other sample: {z}");
    }
}

#[test]
fn the_real_twist_is_stable_and_its_faults_are_found() {
    let read = |name: &str| {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../sync/twist-sync-python/python/twist_sync/example")
            .join(name);
        twist_scenarios::read_csv(&path).unwrap()
    };
    let mcu = read("mcu_gyro_data.csv");
    let phone = read("smartphone_gyro_data.csv");
    let estimate = estimate_offset(&mcu, &phone, &Options::default()).unwrap();
    // Between −3 and +3 sigma of what independent variants agree on.
    assert!((estimate.clock.offset_at(1267.0).value - 947_848.638_471).abs() < 60e-6);
    assert!(estimate.offset_sigma_s() < 40e-6);
    let kinds: Vec<FaultKind> = estimate.report.faults.iter().map(|f| f.kind).collect();
    for kind in [
        FaultKind::CopiedSample,
        FaultKind::DisplacedClass,
        FaultKind::TimestampSawtooth,
    ] {
        assert!(kinds.contains(&kind), "{kind:?} missing in {kinds:?}");
    }
    let faulty = estimate_offset(
        &mcu,
        &phone,
        &Options {
            handle_faults: false,
            ..Options::default()
        },
    )
    .unwrap();
    let moved = faulty.clock.offset_at(estimate.clock.reference).value - estimate.clock.offset;
    assert!(moved < -80e-6, "the faults move the answer by {moved}");
}

/// Errors of offset and skew of the accepted twists of a family, in their own sigmas.
fn errors(name: &str, seed: u64, trials: u64) -> Vec<[f64; 2]> {
    errors_below(name, seed, trials, 20e-3)
}

/// The same of those whose 1-sigma is below a limit, seconds.
fn errors_below(name: &str, seed: u64, trials: u64, sigma_limit_s: f64) -> Vec<[f64; 2]> {
    let families = twist_scenarios::families();
    let place = families.iter().position(|f| f.name.contains(name)).unwrap();
    let twists = (0..trials).into_par_iter().filter_map(|trial| {
        let (twist, options, _) =
            families[place].twist(seed + 1000 * (1000 * place as u64 + trial));
        let options = Options {
            sigma_limit_s,
            ..options
        };
        let estimate = estimate_offset(&twist.a, &twist.b, &options).ok()?;
        let error = estimate.clock.offset - twist.offset_at(estimate.clock.reference);
        let of_skew = estimate.clock.skew - twist.skew;
        Some([
            error / estimate.offset_sigma_s(),
            of_skew / estimate.skew_sigma(),
        ])
    });
    twists.collect()
}

fn largest(errors: &[[f64; 2]]) -> f64 {
    let sizes = errors.as_flattened().iter().map(|z| z.abs());
    sizes.fold(0.0, f64::max)
}

/// Of the wrong sign by milliseconds without slow motion's say. The full band's sigma, which may
/// be beyond the limit, is no reason for a refusal.
#[test]
fn aliased_vibration_does_not_move_the_relation() {
    let errors = errors_below("aliased", 31_000, 16, 100e-6);
    assert!(errors.len() >= 13, "{errors:?}");
    assert!(largest(&errors) < 4.5, "{errors:?}");
}

/// Stamps that slip by their step once in a twist, that are late by more than a sample, or that
/// swing more slowly than the twist.
#[test]
fn stamps_of_slow_and_one_sided_errors_move_the_relation_within_its_sigma() {
    for name in [
        "rounded to 1 ms, near whole ms",
        "latency",
        "swing",
        "spread back",
    ] {
        let errors = errors(name, 31_000_003, 36);
        assert!(errors.len() >= 34, "{name}: {}", errors.len());
        assert!(largest(&errors) < 4.5, "{name}: {errors:?}");
    }
}

/// Off by 150 µs if the filter counts as its delay and dispersion alone.
#[test]
fn a_long_low_pass_does_not_move_the_relation() {
    let damping = [std::f64::consts::FRAC_1_SQRT_2, 0.85, 1.0];
    for (seed, damping) in (0..).zip(damping) {
        let mut spec = TwistSpec::default();
        (spec.b.filter_hz, spec.b.filter_damping) = (Some(10.0), damping);
        let twist = twist_scenarios::twist(&spec, 31_000_007 + seed);
        let estimate =
            estimate_offset(&twist.a, &twist.b, &twist_scenarios::options(&spec)).unwrap();
        let error = error_s(&estimate, &twist);
        let z = error / estimate.offset_sigma_s();
        assert!(
            error.abs() < 20e-6 && z.abs() < 4.0,
            "{damping}: {error}, {z}"
        );
    }
}
