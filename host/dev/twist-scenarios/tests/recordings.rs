//! Whole recordings whose clocks step, whose windows are weak, or that do not belong together.

use rayon::prelude::*;
use twist_scenarios::{Motion, Twist, TwistSpec};
use twist_sync::{ClockRelation, GyroTrack, Options, course_of_tracks, estimate_offset};

/// Recordings of minutes of carrying the rig around, at 100 Hz.
fn carried(seed: u64, seconds: f64, peak: f64) -> Twist {
    let mut spec = TwistSpec {
        motion: Motion::Natural(peak, 2.0 * peak),
        duration_s: seconds,
        ..TwistSpec::default()
    };
    (spec.a.rate_hz, spec.b.rate_hz) = (100.0, 100.01);
    twist_scenarios::twist(&spec, seed)
}

#[test]
fn a_step_of_a_clock_is_found_with_its_time_and_size() {
    for (trial, (at, by_s)) in [
        (0.22, 10e-3),
        (0.3, -1.0),
        (0.55, 1.0),
        (0.8, 3.5),
        (0.6, -2e-3),
    ]
    .into_iter()
    .enumerate()
    {
        let mut twist = carried(9000 + 1000 * trial as u64, 100.0, 0.8);
        let from = (twist.b.len() as f64 * at) as usize;
        twist.b.t[from..].iter_mut().for_each(|t| *t += by_s);
        let step_s = twist.a.epoch_s + 100.0 * at;
        let clock = course_of_tracks(&twist.a, &twist.b, None, &Options::for_windows()).unwrap();
        let [step] = clock.course.steps[..] else {
            panic!("{at} {by_s}: {:?}", clock.course.steps);
        };
        assert!(
            step.from_s - 0.5 < step_s && step_s < step.to_s + 0.5,
            "{step:?} {step_s}"
        );
        assert!(
            (step.by.value - by_s).abs() < 4.0 * step.by.sigma,
            "{step:?}"
        );
        for tenth in 0..10 {
            let at_s = twist.a.epoch_s + 5.0 + 10.0 * f64::from(tenth);
            let expected = twist.offset_at(at_s) + if at_s > step_s { by_s } else { 0.0 };
            let found = clock.course.at(at_s).offset_at(at_s);
            let error = found.value - expected;
            assert!(
                error.abs() < 4.5 * found.sigma,
                "{at} {by_s}: {error} at {tenth}, {}",
                found.sigma
            );
        }
    }
}

/// Jumps by half a sampling step: at 3 s, within the first window, and in the middle.
#[test]
fn a_jump_below_a_millisecond_is_found_or_in_the_sigma() {
    let by_s = 0.6e-3;
    for (trial, after_s) in [3.0, 13.0, 33.0, 47.0].repeat(4).into_iter().enumerate() {
        let mut twist = carried(70_000 + 1000 * (trial as u64 / 4), 90.0, 0.8);
        let jump_s = twist.b.t[0] + after_s;
        let after = twist.b.t.partition_point(|t| *t <= jump_s);
        twist.b.t[after..].iter_mut().for_each(|t| *t += by_s);
        let clock = course_of_tracks(&twist.a, &twist.b, None, &Options::for_windows()).unwrap();
        let course = &clock.course;
        assert!(
            after_s < 20.0 || course.steps.len() == 1,
            "{after_s} {trial}: {:?}",
            course.steps
        );
        for since_s in 1..90 {
            let at_s = twist.a.epoch_s + f64::from(since_s);
            let is_after = f64::from(since_s) > after_s;
            let expected = twist.offset_at(at_s) + if is_after { by_s } else { 0.0 };
            let found = course.at(at_s).offset_at(at_s);
            let z = (found.value - expected) / found.sigma;
            assert!(
                z.abs() < 4.0,
                "{after_s} {trial}: {z} sigmas at {since_s} s"
            );
        }
        let (from, to) = course.span();
        let begins = std::iter::once(from).chain(course.steps.iter().map(|step| step.to_s));
        let ends = course.steps.iter().map(|step| step.from_s).chain([to]);
        for (begin, end) in begins.zip(ends) {
            let relation = course.at(0.5 * (begin + end));
            let z = (relation.skew - twist.skew) / relation.covariance[1][1].sqrt();
            assert!(
                z.abs() < 4.0,
                "{after_s} {trial}: the skew is {z} sigmas off"
            );
        }
    }
}

#[test]
fn weak_windows_add_up() {
    for trial in 0..3 {
        let twist = carried(31_000 + 1000 * trial, 100.0, 0.2);
        let whole = estimate_offset(&twist.a, &twist.b, &Options::for_windows()).unwrap();
        // A tenth of it has 3.2 times its sigma: most windows alone are above the limit.
        let options = Options {
            sigma_limit_s: 2.5 * whole.offset_sigma_s(),
            ..Options::for_windows()
        };
        let clock = course_of_tracks(&twist.a, &twist.b, None, &options).unwrap();
        let refused: usize = clock.refused.iter().map(|own| own.count).sum();
        let alone = clock.windows - refused;
        assert!(
            clock.estimates.len() < alone,
            "each of {alone} windows passed alone"
        );
        let at_s = whole.clock.reference;
        let found: ClockRelation = clock.course.at(at_s);
        let error = found.offset - twist.offset_at(at_s);
        assert!(error.abs() < 4.0 * found.offset_at(at_s).sigma, "{error}");
    }
}

#[test]
fn a_stretch_without_a_relation_is_named_and_widens_the_sigma() {
    let mut twist = carried(60_000, 120.0, 0.8);
    let other = carried(61_000, 120.0, 0.8).b;
    let apart = 4000..8000;
    twist.b.w[apart.clone()].copy_from_slice(&other.w[apart]);
    let clock = course_of_tracks(&twist.a, &twist.b, None, &Options::for_windows()).unwrap();
    let refused: usize = clock.refused.iter().map(|own| own.count).sum();
    assert!(refused >= 3, "{:?}", clock.refused);
    let [stretch] = clock.course.unsupported[..] else {
        panic!("{:?}", clock.course.unsupported);
    };
    let [from_s, to_s] = [stretch.from_s, stretch.to_s].map(|t| t - twist.a.epoch_s);
    assert!(
        (30.0..51.0).contains(&from_s) && (69.0..91.0).contains(&to_s),
        "{from_s} to {to_s}"
    );
    let sigma = |at_s: f64| {
        let at_s = twist.a.epoch_s + at_s;
        let found = clock.course.at(at_s).offset_at(at_s);
        assert!((found.value - twist.offset_at(at_s)).abs() < 4.5 * found.sigma);
        found.sigma
    };
    assert!(
        sigma(60.0) > 3.0 * sigma(20.0),
        "{} {}",
        sigma(60.0),
        sigma(20.0)
    );
}

#[test]
fn recordings_that_do_not_belong_together_are_refused() {
    let tracks: Vec<Twist> = (0..25)
        .map(|k| carried(50_000 + 1000 * k, 40.0, 0.8))
        .collect();
    let pairs: Vec<(usize, usize)> = (0..25)
        .flat_map(|i| (0..25).map(move |j| (i, j)))
        .filter(|(i, j)| i != j)
        .collect();
    assert_eq!(pairs.len(), 600);
    let is_accepted = |&&(i, j): &&(usize, usize)| {
        let (a, b): (&GyroTrack, &GyroTrack) = (&tracks[i].a, &tracks[j].b);
        estimate_offset(a, b, &Options::for_windows()).is_ok()
            || (i + j).is_multiple_of(10)
                && course_of_tracks(a, b, None, &Options::for_windows()).is_ok()
    };
    let accepted: Vec<_> = pairs.par_iter().filter(is_accepted).collect();
    assert!(accepted.is_empty(), "{accepted:?}");
}

#[test]
fn periodic_motion_is_ambiguous_over_a_whole_recording() {
    let noise = |seed: f64| 1e-3 * ((seed * 12.9898).sin() * 43_758.545_3).fract();
    let turned = |from: f64, seed: f64| -> GyroTrack {
        let times: Vec<f64> = (0..6000).map(|k| from + 0.01 * f64::from(k)).collect();
        let rate = |&t: &f64| {
            let phase = std::f64::consts::PI * t;
            let clean = [
                phase.sin(),
                0.5 * (2.0 * phase).cos(),
                0.3 * (3.0 * phase).sin(),
            ];
            let axis = |k: usize| clean[k] + noise(t + seed + k as f64);
            [axis(0), axis(1), axis(2)]
        };
        GyroTrack::from_seconds(&times, times.iter().map(rate).collect())
    };
    let (a, b) = (turned(0.0, 0.3), turned(7.0, 0.7));
    let refused = course_of_tracks(&a, &b, None, &Options::for_windows()).unwrap_err();
    let said = refused.to_string();
    assert!(said.contains("several time shifts"), "{said}");
}
