//! Stretches in which the two gyroscopes are not one body: they are left out, with their cause.

use twist_scenarios::{Grip, Twist, TwistSpec};
use twist_sync::{Estimate, LeftOut, Options, Why, estimate_offset};

fn twist(grip: Grip, seed: u64) -> Twist {
    let spec = TwistSpec {
        grip,
        ..TwistSpec::default()
    };
    twist_scenarios::twist(&spec, seed)
}

/// Returns the estimate, which must be right within five sigmas.
fn right(twist: &Twist) -> Estimate {
    let estimate = estimate_offset(&twist.a, &twist.b, &Options::default()).unwrap();
    let error = estimate.clock.offset - twist.offset_at(estimate.clock.reference);
    assert!(error.abs() < 5.0 * estimate.offset_sigma_s(), "{error}");
    estimate
}

/// Returns the stretches that were left out for reasons that `is` accepts.
fn left_out(estimate: &Estimate, is: fn(&Why) -> bool) -> Vec<LeftOut> {
    let all = estimate.report.left_out.iter();
    all.filter(|l| is(&l.why)).copied().collect()
}

const fn is_apart(why: &Why) -> bool {
    matches!(why, Why::Apart)
}

#[test]
fn a_firm_hold_leaves_nothing_out() {
    for seed in 0..10 {
        let estimate = right(&twist(Grip::Firm, 1000 * seed + 23));
        assert_eq!(estimate.report.left_out, []);
    }
}

#[test]
fn holding_late_and_letting_go_are_named_with_their_times() {
    for seed in 0..10 {
        let late = twist(Grip::Late(0.8, 1.5), 1000 * seed + 29);
        let found = left_out(&right(&late), is_apart);
        let ends = late.loose_s[0].1 - late.a.epoch_s;
        // The motion begins after a second of rest.
        assert!(
            found[0].from_s < 1.5 && (found[0].to_s - ends).abs() < 0.6,
            "{found:?} {ends}"
        );

        let early = twist(Grip::LetGo(0.8, 1.5), 1000 * seed + 31);
        let found = left_out(&right(&early), is_apart);
        let begins = early.loose_s[0].0 - early.a.epoch_s;
        let last = found.last().unwrap();
        assert!(
            last.to_s > 7.9 && (last.from_s - begins).abs() < 0.6,
            "{found:?} {begins}"
        );
    }
}

#[test]
fn slips_of_rotation_and_steps_of_time_are_distinguished() {
    for seed in 0..10 {
        let slip = twist(Grip::Slip(6.0, 6.0), 1000 * seed + 37);
        let found = right(&slip).report.left_out;
        let longest =
            |x: &&LeftOut, y: &&LeftOut| (x.to_s - x.from_s).total_cmp(&(y.to_s - y.from_s));
        assert!(
            found
                .iter()
                .max_by(longest)
                .is_some_and(|l| is_apart(&l.why)),
            "{found:?}"
        );
        assert!(!found.iter().any(|l| matches!(l.why, Why::TimeStep(_))));

        let mut step = twist(Grip::Firm, 1000 * seed + 41);
        let n = step.b.len();
        step.b.t[n * 3 / 4..].iter_mut().for_each(|t| *t += 0.03);
        let found = left_out(&right(&step), |why| matches!(why, Why::TimeStep(_)));
        let Why::TimeStep(by_s) = found[0].why else {
            unreachable!()
        };
        assert!((by_s - 0.03).abs() < 0.5e-3, "{by_s}");
    }
}
