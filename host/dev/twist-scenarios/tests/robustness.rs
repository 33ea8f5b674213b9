//! The clock estimate on faulty, odd and hopeless streams: each result is either right within
//! its sigma or refused.
//!
//! Each case damages a simulated twist in one way. Cases marked [`Refused`] must be refused
//! every time, those marked [`Accepted`] accepted every time. The error of an accepted offset
//! or skew must be below 5.5 of its own sigmas, and that of the offset below 0.4 ms.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use twist_scenarios::{Motion, Twist, TwistSpec, displace};
use twist_sync::estimate_offset;

/// Twists per case.
const TRIALS: u64 = 5;
/// Largest error of an accepted estimate, in its own sigmas.
const WRONG: f64 = 5.5;
/// Largest error of an accepted offset, seconds: four times the 100 µs beyond which an estimate
/// is refused for its sigma.
const CAP_S: f64 = 400e-6;

/// Required outcome of a case.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Expect {
    Accepted,
    /// Accepted or refused, but not wrong.
    Either,
    Refused,
}
use Expect::{Accepted, Either, Refused};

type Damage = Box<dyn Fn(&mut Twist, u64) + Sync>;

struct Case {
    name: &'static str,
    spec: TwistSpec,
    damage: Damage,
    expect: Expect,
}

/// A twist of the base scenario with damage.
fn damaged(
    name: &'static str,
    expect: Expect,
    damage: impl Fn(&mut Twist, u64) + Sync + 'static,
) -> Case {
    Case {
        name,
        spec: TwistSpec::default(),
        damage: Box::new(damage),
        expect,
    }
}

/// An undamaged twist that differs from the base scenario.
fn other(name: &'static str, expect: Expect, change: fn(&mut TwistSpec)) -> Case {
    let mut spec = TwistSpec::default();
    change(&mut spec);
    Case {
        name,
        spec,
        damage: Box::new(|_, _| {}),
        expect,
    }
}

/// Returns a random number in [0, 1) that depends on the key alone.
fn random(key: u64) -> f64 {
    Pcg64::seed_from_u64(key).random()
}

/// Every `period`th sample of b belongs to another time.
fn class(name: &'static str, expect: Expect, period: usize, by_s: f64) -> Case {
    damaged(name, expect, move |twist, seed| {
        displace(&mut twist.b, by_s, |k| k % period == seed as usize % period);
    })
}

/// The stamps of b are off by `by_s` in this part of the recording.
fn step(name: &'static str, expect: Expect, from: f64, to: f64, by_s: f64) -> Case {
    damaged(name, expect, move |twist, _| {
        let n = twist.b.len() as f64;
        for t in &mut twist.b.t[(n * from) as usize..(n * to) as usize] {
            *t += by_s;
        }
    })
}

/// The rates of b are changed, sample by sample.
fn rates(
    name: &'static str,
    expect: Expect,
    change: impl Fn(&mut [f64; 3], f64) + Sync + 'static,
) -> Case {
    damaged(name, expect, move |twist, _| {
        for (w, t) in twist.b.w.iter_mut().zip(&twist.b.t) {
            change(w, *t);
        }
    })
}

fn displaced_and_copied() -> Vec<Case> {
    vec![
        class("every 7th sample by 0.9 ms", Accepted, 7, 0.9e-3),
        class("every 16th sample by -1.1 ms", Accepted, 16, -1.1e-3),
        class("every 5th sample by 1 ms", Accepted, 5, 1e-3),
        class("every 4th sample by 1 ms", Accepted, 4, 1e-3),
        class("every 3rd sample by 1 ms", Accepted, 3, 1e-3),
        class("every 100th sample by 1 ms", Accepted, 100, 1e-3),
        // It is unknown which half is right.
        class("every other sample by 1 ms", Refused, 2, 1e-3),
        class("every other sample by 0.3 ms", Refused, 2, 0.3e-3),
        damaged("two neighbours of ten by 1 ms", Accepted, |twist, seed| {
            displace(&mut twist.b, 1e-3, |k| (k + seed as usize) % 10 < 2);
        }),
        damaged("every 10.37th sample by 1 ms", Accepted, |twist, seed| {
            displace(&mut twist.b, 1e-3, |k| {
                ((k as f64 + seed as f64) / 10.37).fract() < 0.0965
            });
        }),
        damaged("5 % at random by 1 ms", Accepted, |twist, seed| {
            displace(&mut twist.b, 1e-3, |k| random(k as u64 * 977 + seed) < 0.05);
        }),
        damaged("10 % at random are copies", Accepted, |twist, seed| {
            for k in 1..twist.b.len() {
                if random(k as u64 * 977 + seed) < 0.10 {
                    twist.b.w[k] = twist.b.w[k - 1];
                }
            }
        }),
        damaged("every 10th copies the next", Accepted, |twist, seed| {
            for k in (seed as usize % 10..twist.b.len() - 1).step_by(10) {
                twist.b.w[k] = twist.b.w[k + 1];
            }
        }),
        damaged("each sample twice", Accepted, |twist, _| {
            for k in 0..twist.b.len() {
                twist.b.w[k] = twist.b.w[k - k % 2];
            }
        }),
        damaged("each sample three times", Accepted, |twist, _| {
            for k in 0..twist.b.len() {
                twist.b.w[k] = twist.b.w[k - k % 3];
            }
        }),
        other("faulty stream a", Accepted, |s| {
            s.a.faulty = true;
            s.a.sawtooth_s = Some((57e-6, 1.1));
        }),
        other("both streams faulty", Accepted, |s| {
            s.a.faulty = true;
            s.b.faulty = true;
        }),
    ]
}

fn timestamps() -> Vec<Case> {
    let every_tenth = |by_s: f64| {
        move |twist: &mut Twist, seed: u64| {
            for t in twist.b.t.iter_mut().skip(seed as usize % 10).step_by(10) {
                *t += by_s;
            }
        }
    };
    vec![
        damaged("every 10th stamp +1 ms", Accepted, every_tenth(1e-3)),
        damaged("every 10th stamp -1.2 ms", Accepted, every_tenth(-1.2e-3)),
        step("step of 5 ms at 70 %", Accepted, 0.7, 1.0, 5e-3),
        step("step of 1 ms at 75 %", Accepted, 0.75, 1.0, 1e-3),
        step("step of 30 ms at 80 %", Either, 0.8, 1.0, 30e-3),
        step("step of 100 ms in the middle", Refused, 0.5, 1.0, 0.1),
        step("step of 1 ms in the middle", Refused, 0.5, 1.0, 1e-3),
        step("step of 0.3 ms in the middle", Refused, 0.5, 1.0, 0.3e-3),
        step("block off by 3 ms", Accepted, 0.4, 0.55, 3e-3),
        damaged(
            "five short blocks off by 1.5 ms",
            Accepted,
            |twist, seed| {
                for j in 0..5 {
                    let from = (random(seed * 5 + j) * 4000.0) as usize + 200;
                    for t in twist.b.t.iter_mut().skip(from).take(20) {
                        *t += 1.5e-3;
                    }
                }
            },
        ),
        damaged("stamps with 0.3 ms of noise", Accepted, |twist, seed| {
            for (k, t) in twist.b.t.iter_mut().enumerate() {
                *t += (random(k as u64 + seed * 10_007) - 0.5) * 1e-3;
            }
        }),
        other("samples with 0.3 ms of jitter", Accepted, |s| {
            s.b.jitter_s = 0.3e-3;
        }),
        other("sawtooth and jitter", Accepted, |s| {
            s.b.jitter_s = 20e-6;
            s.b.sawtooth_s = Some((57e-6, 0.5));
        }),
        other("sawtooth of 0.05 s", Accepted, |s| {
            s.b.sawtooth_s = Some((57e-6, 0.05));
        }),
        other("sawtooth of 3.3 s", Accepted, |s| {
            s.b.sawtooth_s = Some((57e-6, 3.3));
        }),
        other("sawtooth of 7 s", Accepted, |s| {
            s.b.sawtooth_s = Some((57e-6, 7.0));
        }),
    ]
}

fn sensors() -> Vec<Case> {
    vec![
        other("b at 100 Hz", Accepted, |s| s.b.rate_hz = 100.0),
        other("1 kHz and 200 Hz", Accepted, |s| {
            s.a.rate_hz = 1000.0;
            s.b.rate_hz = 200.0;
        }),
        other("five times the noise", Accepted, |s| {
            s.a.noise = 7e-3;
            s.b.noise = 6e-3;
        }),
        other("filters of 188 and 20 Hz", Accepted, |s| {
            s.a.filter_hz = Some(188.0);
            s.b.filter_hz = Some(20.0);
        }),
        other("20 % lost", Accepted, |s| s.b.lost = 0.2),
        other("both clipped hard", Accepted, |s| {
            s.motion = Motion::Twist(8.0, 10.0);
            (s.a.range, s.b.range) = (Some(4.363), Some(4.363));
        }),
        other("clipped, one axis", Accepted, |s| {
            s.motion = Motion::SingleAxis(5.0, 8.0);
            s.a.range = Some(4.363);
        }),
        Case {
            damage: Box::new(|twist, seed| {
                for (k, w) in twist.a.w.iter_mut().enumerate() {
                    for (axis, rate) in w.iter_mut().enumerate() {
                        *rate += 2e-3 * (random((k * 3 + axis) as u64 + seed * 7919) - 0.5);
                    }
                }
            }),
            ..other("clipped before the noise", Either, |s| {
                s.motion = Motion::Twist(5.0, 7.0);
                (s.a.range, s.a.lsb) = (Some(4.363), 0.0);
            })
        },
        other("coarse steps of the values", Accepted, |s| {
            s.a.lsb = 5e-3;
            s.b.lsb = 8.7e-3;
        }),
        rates("large bias", Accepted, |w, _| {
            w[0] += 0.3;
            w[1] -= 0.2;
        }),
        rates("bias that drifts", Accepted, |w, t| w[0] += 0.01 * t / 9.0),
        rates("mirrored axis", Accepted, |w, _| w[2] = -w[2]),
        rates("scale off by 5 %", Accepted, |w, _| {
            *w = w.map(|x| 1.05 * x)
        }),
        rates("not linear by 0.5 %", Accepted, |w, _| {
            *w = w.map(|x| x * (1.0 + 0.005 * x.abs() / 4.0));
        }),
        damaged("forty spikes", Accepted, |twist, seed| {
            for j in 0..40 {
                let k = (random(seed * 41 + j) * 4400.0) as usize;
                twist.b.w[k][1] += 3.0;
            }
        }),
    ]
}

fn motions() -> Vec<Case> {
    vec![
        other("0.3 rad/s", Accepted, |s| {
            s.motion = Motion::Twist(0.3, 0.3)
        }),
        other("0.1 rad/s", Either, |s| s.motion = Motion::Twist(0.1, 0.1)),
        other("1.1 rad/s about one axis", Accepted, |s| {
            s.motion = Motion::SingleAxis(1.1, 1.1);
        }),
        other("4 s", Accepted, |s| s.duration_s = 4.0),
        other("3.5 s, b 0.9 s late", Accepted, |s| {
            s.duration_s = 3.5;
            s.b_starts_s = 0.9;
        }),
        other("3 of 9 s in common", Accepted, |s| s.b_starts_s = 6.0),
        other("1.5 of 9 s in common", Refused, |s| s.b_starts_s = 7.5),
        other("2 of 9 s, one axis", Accepted, |s| {
            s.b_starts_s = 7.0;
            s.motion = Motion::SingleAxis(2.0, 4.0);
        }),
        other("half in common, one axis", Accepted, |s| {
            s.b_starts_s = 4.5;
            s.motion = Motion::SingleAxis(2.0, 4.0);
        }),
        other("nothing in common", Refused, |s| s.b_starts_s = 12.0),
        other("nothing in common, one axis", Refused, |s| {
            s.b_starts_s = 12.0;
            s.motion = Motion::SingleAxis(2.0, 4.0);
        }),
        other("carried around", Accepted, |s| {
            s.motion = Motion::Natural(0.3, 1.0);
        }),
        other("carried around slowly", Either, |s| {
            s.motion = Motion::Natural(0.1, 0.2);
        }),
        other("unrelated, carried around", Refused, |s| {
            s.motion = Motion::Natural(0.3, 1.0);
            s.unrelated = true;
        }),
        other("unrelated, short, one axis", Refused, |s| {
            s.motion = Motion::SingleAxis(2.0, 4.0);
            s.unrelated = true;
            s.duration_s = 4.0;
        }),
        other("unrelated, 0.2 rad/s", Refused, |s| {
            s.motion = Motion::Twist(0.2, 0.3);
            s.unrelated = true;
        }),
        damaged("b lay still", Refused, |twist, seed| {
            let still = TwistSpec {
                motion: Motion::Still,
                ..TwistSpec::default()
            };
            twist.b = twist_scenarios::twist(&still, seed).b;
        }),
        damaged("one period again and again", Refused, |twist, seed| {
            let frequency = 1.0 + random(seed);
            let rate = |t: f64| 3.0 * (std::f64::consts::TAU * frequency * t).sin();
            for (k, w) in twist.a.w.iter_mut().enumerate() {
                let (v, e) = (rate(twist.a.t[k]), random(k as u64 + seed) - 0.5);
                *w = [v + 1e-3 * e, 0.3 * v + 1e-3 * e, -0.2 * v - 1e-3 * e];
            }
            for (k, w) in twist.b.w.iter_mut().enumerate() {
                let (v, e) = (rate(twist.b.t[k] + 0.3), random(31 * k as u64 + seed));
                *w = [0.3 * v - 1e-3 * e, v + 1e-3 * e, -0.2 * v + 1e-3 * e];
            }
        }),
        damaged("not fixed to each other", Refused, |twist, seed| {
            let frequency = random(seed) * 6.0 + 2.0;
            for (w, t) in twist.b.w.iter_mut().zip(&twist.b.t) {
                for (axis, rate) in w.iter_mut().enumerate() {
                    *rate += 0.15 * (frequency * t + axis as f64).sin();
                }
            }
        }),
    ]
}

/// Runs a case and returns its violations.
fn judge(case: &Case) -> Vec<String> {
    let options = twist_scenarios::options(&case.spec);
    let mut wrong = Vec::new();
    let (mut accepted, mut squares, mut largest) = (0, 0.0, 0.0_f64);
    for seed in 0..TRIALS {
        let mut twist = twist_scenarios::twist(&case.spec, seed * 1000 + 3);
        (case.damage)(&mut twist, seed);
        match estimate_offset(&twist.a, &twist.b, &options) {
            Ok(estimate) => {
                let error = estimate.clock.offset - twist.offset_at(estimate.clock.reference);
                let of_skew = (estimate.clock.skew - twist.skew) / estimate.skew_sigma();
                let sigmas = (error / estimate.offset_sigma_s()).abs().max(of_skew.abs());
                accepted += 1;
                squares += error * error;
                largest = largest.max(sigmas);
                if case.expect == Refused || sigmas > WRONG || error.abs() > CAP_S {
                    wrong.push(format!(
                        "{}: seed {seed}: accepted with {:+.1} µs of error, of offset or skew {sigmas:.1} sigmas",
                        case.name,
                        error * 1e6
                    ));
                }
            }
            Err(refusal) if case.expect == Accepted => {
                wrong.push(format!("{}: seed {seed}: refused: {refusal}", case.name));
            }
            Err(_) => {}
        }
    }
    println!(
        "{:32} accepted {accepted} of {TRIALS}, rms error {:7.2} µs, at most {largest:.2} sigmas",
        case.name,
        (squares / f64::from(accepted.max(1))).sqrt() * 1e6
    );
    wrong
}

fn check(cases: Vec<Case>) {
    let wrong: Vec<String> = cases.par_iter().flat_map(judge).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn displaced_and_copied_samples() {
    check(displaced_and_copied());
}

#[test]
fn damaged_timestamps() {
    check(timestamps());
}

#[test]
fn other_sensors() {
    check(sensors());
}

#[test]
fn other_motions() {
    check(motions());
}
