//! The study of drift: how far the predicted relation of the clocks is from the
//! true one, 1, 5 and 10 minutes after the last data, and within a recording.
//!
//! Everything is simulated: the gyroscopes with their noise, and clocks whose
//! skew walks at random by the stated wander (rms change in one minute). Each
//! session runs the whole estimate on simulated recordings.
//!
//! `sync_study [--trials N]`
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use clap::Parser;
use rayon::prelude::*;
use twist_scenarios::{ClockPath, Motion, Twist, TwistSpec, rms};
use twist_sync::{ClockCourse, ClockRelation, Options, Wander, course_of_tracks, estimate_offset};

/// Drift of the published system, µs in a minute.
const PUBLISHED_US_PER_MIN: f64 = 16.34;

#[derive(Parser)]
struct Args {
    /// Sessions per case
    #[arg(long, default_value_t = 60)]
    trials: u64,
}

/// (error, sigma) in seconds at the instants that are judged.
type Errors = Vec<(f64, f64)>;

fn judge(
    model: impl Fn(f64) -> ClockRelation,
    twist: &Twist,
    from_s: f64,
    ahead: &[f64],
) -> Errors {
    // The prediction's error is counted from the last data: what is wrong there
    // is the offset's error, which the alignment has anyway.
    ahead
        .iter()
        .map(|s| {
            let at = twist.boot_s + from_s + s;
            let model = model(at);
            (
                model.offset - twist.offset_at(at),
                model.covariance[0][0].sqrt(),
            )
        })
        .collect()
}

fn options(wander: f64) -> Options {
    Options {
        wander: Wander(wander),
        sigma_limit_s: 1e-3,
        ..Options::default()
    }
}

fn twist_at(path: &ClockPath, seed: u64, start_s: f64, motion: Motion, duration_s: f64) -> Twist {
    let spec = TwistSpec {
        motion,
        duration_s,
        ..TwistSpec::default()
    };
    twist_scenarios::twist_on(&spec, seed, path, start_s)
}

const AHEAD_S: [f64; 4] = [0.0, 60.0, 300.0, 600.0];
const HAND: Motion = Motion::Twist(2.0, 4.0);
const CARRIED: Motion = Motion::Natural(0.8, 1.6);

fn relation(twist: &Twist, wander: f64) -> Option<ClockRelation> {
    let estimate = estimate_offset(&twist.a, &twist.b, &options(wander)).ok()?;
    Some(estimate.clock)
}

/// Errors of a relation's predictions, `from_s` after the beginning and later.
fn judge_ahead(clock: &ClockRelation, twist: &Twist, from_s: f64) -> Errors {
    judge(|t| clock.referenced_at(t), twist, from_s, &AHEAD_S)
}

fn one_twist(path: &ClockPath, seed: u64, wander: f64) -> Option<Errors> {
    let twist = twist_at(path, seed, 0.0, HAND, 9.0);
    Some(judge_ahead(&relation(&twist, wander)?, &twist, 9.0))
}

/// One twist, with the skew learnt in an earlier session to 0.03 ppm.
fn known_skew(path: &ClockPath, seed: u64, wander: f64) -> Option<Errors> {
    let twist = twist_at(path, seed, 0.0, HAND, 9.0);
    let mut clock = relation(&twist, wander)?;
    let learnt = ((seed as f64 * 0.618_034).fract() - 0.5) * 12.0_f64.sqrt() * 0.03e-6;
    clock.skew = twist.skew + learnt;
    clock.covariance = [[clock.covariance[0][0], 0.0], [0.0, 0.03e-6 * 0.03e-6]];
    Some(judge_ahead(&clock, &twist, 9.0))
}

fn two_twists(path: &ClockPath, seed: u64, wander: f64) -> Option<Errors> {
    let early = twist_at(path, seed, 0.0, HAND, 9.0);
    let late = twist_at(path, seed + 1, 60.0, HAND, 9.0);
    let joined = relation(&early, wander)?.joined(&relation(&late, wander)?);
    Some(judge_ahead(&joined, &late, 69.0))
}

fn natural(path: &ClockPath, seed: u64, wander: f64) -> Option<Errors> {
    let recording = twist_at(path, seed + 2, 0.0, CARRIED, 300.0);
    let course = course(&recording, wander)?;
    let latest = course.at(course.span().1);
    Some(judge_ahead(&latest, &recording, 300.0))
}

/// The relation inside a recording of ten minutes, at 19 instants.
fn whole(path: &ClockPath, seed: u64, wander: f64) -> Option<Errors> {
    let recording = twist_at(path, seed + 3, 0.0, CARRIED, 600.0);
    let course = course(&recording, wander)?;
    let inside: Vec<f64> = (1..20).map(|k| 30.0 * f64::from(k)).collect();
    Some(judge(|t| course.at(t), &recording, 0.0, &inside))
}

fn course(recording: &Twist, wander: f64) -> Option<ClockCourse> {
    let estimated = course_of_tracks(&recording.a, &recording.b, None, &options(wander));
    estimated.ok().map(|clock| clock.course)
}

fn main() {
    let args = Args::parse();
    println!(
        "Simulated; {} sessions per case (a tenth of it, at least 6, for whole recordings).",
        args.trials
    );
    println!("Errors are rms in µs; in brackets error over sigma, rms.\n");
    println!(
        "| wander, ppm a minute | data | at the end | 1 min later | 5 min later | 10 min later | µs/min over 10 min |"
    );
    println!("|---|---|---|---|---|---|---|");
    let few = (args.trials / 10).max(6);
    for ppm in [0.01, 0.02, 0.05] {
        let wander = ppm * 1e-6;
        type Case = fn(&ClockPath, u64, f64) -> Option<Errors>;
        let cases: [(&str, Case, u64); 4] = [
            ("one twist", one_twist, args.trials),
            (
                "one twist, skew learnt before (0.03 ppm)",
                known_skew,
                args.trials,
            ),
            ("two twists, 60 s apart", two_twists, args.trials),
            ("5 min of natural motion", natural, few),
        ];
        for (name, case, trials) in cases {
            let all = sessions(case, trials, wander, 1000.0);
            let column = |k: usize| {
                let error = rms(all.iter().map(|e| e[k].0)) * 1e6;
                let honest = rms(all.iter().map(|e| e[k].0 / e[k].1));
                format!("{error:.1} ({honest:.2})")
            };
            let per_minute = rms(all.iter().map(|e| e[3].0 - e[0].0)) * 1e6 / 10.0;
            println!(
                "| {ppm} | {name} | {} | {} | {} | {} | {per_minute:.2} |",
                column(0),
                column(1),
                column(2),
                column(3)
            );
        }
        let all = sessions(whole, few, wander, 700.0);
        let error = rms(all.iter().flatten().map(|e| e.0)) * 1e6;
        let honest = rms(all.iter().flatten().map(|e| e.0 / e.1));
        println!(
            "| {ppm} | whole recording of 10 min, smoothed | {error:.1} ({honest:.2}) within | – | – | – | – |"
        );
    }
    println!("| | published system | | | | | {PUBLISHED_US_PER_MIN} |");
}

fn sessions(
    case: fn(&ClockPath, u64, f64) -> Option<Errors>,
    trials: u64,
    wander: f64,
    length_s: f64,
) -> Vec<Errors> {
    let all: Vec<Option<Errors>> = (0..trials)
        .into_par_iter()
        .map(|trial| {
            let seed = 1000 * (trial + 1);
            let skew = 1e-6 * 40.0 * ((trial as f64 * 0.754_877).fract() - 0.5);
            let path = ClockPath::new(seed, skew, wander, length_s, 0.0);
            case(&path, seed, wander)
        })
        .collect();
    let failed = all.iter().filter(|e| e.is_none()).count();
    if failed > 0 {
        println!("({failed} of {trials} sessions refused)");
    }
    all.into_iter().flatten().collect()
}
