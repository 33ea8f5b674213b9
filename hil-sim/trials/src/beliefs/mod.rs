//! The figures of frame sync over what may be true instead of what is believed.
//!
//! Rigs as believed, rigs drawn from the ranges of all beliefs at once, and rigs with one
//! belief at an end of its range: each does [`sessions`](session::sessions) on the models.
//! A figure is given three times: nominal and over the draws as the 95th percentile of its
//! size, and as the largest where one belief alone is moved, with that belief.

pub mod session;

use std::fmt::Write as _;

use evaluate::stats::{mean, quantile};
use rig::beliefs::{BELIEFS, Beliefs};
use rig::random::Seed;
use serde::Serialize;

use crate::workers;
use session::{Judged, Sessions, sessions};

/// What is to be studied.
#[derive(Clone, Copy, Debug)]
pub struct BeliefOptions {
    /// The first seed; the others follow it.
    pub first_seed: u64,
    /// Rigs as believed, and rigs that are drawn.
    pub rigs: u32,
    /// Rigs with each belief at each end of its range.
    pub rigs_an_end: u32,
    /// No clock that is drawn warms up by more, ppm in ten minutes.
    pub most_warming_ppm: Option<f64>,
    /// The exposure of those that are drawn is the same in each recording.
    pub exposure_locked: bool,
    /// How many run at the same time.
    pub jobs: u32,
}

/// Which rig a result is of.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Kind {
    /// As believed.
    Nominal,
    /// All beliefs drawn by its seed.
    Drawn,
    /// One belief at an end of its range, in words.
    Extreme(String),
}

/// One rig.
#[derive(Clone, Debug, Serialize)]
pub struct RigResult {
    /// Its seed.
    pub seed: u64,
    /// Which.
    pub kind: Kind,
    /// Its sessions, or why there are none.
    pub sessions: Result<Sessions, String>,
}

/// All rigs.
#[derive(Clone, Debug, Serialize)]
pub struct BeliefStudy {
    /// In the order of kinds and seeds.
    pub rigs: Vec<RigResult>,
}

/// Runs the study; `done` is called for every rig that is ready.
pub fn run(options: &BeliefOptions, done: impl Fn(&RigResult) + Sync) -> BeliefStudy {
    let seeds = |count: u32| (0..count).map(|n| options.first_seed.wrapping_add(n.into()));
    let mut plans: Vec<(u64, Kind, Beliefs)> = Vec::new();
    for seed in seeds(options.rigs) {
        let drawn = Beliefs::drawn(Seed(seed));
        let drawn = match options.most_warming_ppm {
            Some(most) => drawn.with_warming_at_most(most),
            None => drawn,
        };
        let drawn = if options.exposure_locked {
            drawn.with_exposure_locked()
        } else {
            drawn
        };
        plans.push((seed, Kind::Nominal, Beliefs::default()));
        plans.push((seed, Kind::Drawn, drawn));
    }
    for (place, belief) in BELIEFS.iter().enumerate() {
        for end in belief.extremes() {
            let kind = Kind::Extreme(format!("{}: {end} {}", belief.name, belief.unit));
            for seed in seeds(options.rigs_an_end) {
                plans.push((seed, kind.clone(), Beliefs::default().with(place, end)));
            }
        }
    }
    let rigs = workers::each(&plans, options.jobs as usize, |(seed, kind, beliefs)| {
        let result = RigResult {
            seed: *seed,
            kind: kind.clone(),
            sessions: sessions(*seed, beliefs).map_err(|error| format!("{error:#}")),
        };
        done(&result);
        result
    });
    BeliefStudy { rigs }
}

/// A session of a rig.
type Which = (&'static str, fn(&Sessions) -> &Judged);

/// A figure, and its stated 1-sigma where there is one.
type Figure = (&'static str, fn(&Judged) -> (f64, Option<f64>));

const SESSIONS: [Which; 5] = [
    ("one twist, nothing learnt", |s| &s.fresh),
    ("one twist, learnt minutes ago", |s| &s.learnt),
    ("two twists, cold rig", |s| &s.two_twists),
    ("three twists, cold rig", |s| &s.three_twists),
    ("three twists, 2 min apart, cold rig", |s| &s.wide_twists),
];

const FIGURES: [Figure; 4] = [
    ("phase at the start (µs)", |j| {
        (j.phase_us, Some(j.phase_sigma_us))
    }),
    ("drift, first minute (µs/min)", |j| {
        (j.drift_1_us_per_min, None)
    }),
    ("drift, five minutes (µs/min)", |j| {
        (j.drift_5_us_per_min, Some(j.drift_sigma_us_per_min))
    }),
    ("clock offset (µs)", |j| {
        (j.offset_us, Some(j.offset_sigma_us))
    }),
];

impl BeliefStudy {
    fn of<'a>(&'a self, kind: &'a Kind) -> impl Iterator<Item = &'a Sessions> {
        let rigs = self.rigs.iter().filter(move |rig| rig.kind == *kind);
        rigs.filter_map(|rig| rig.sessions.as_ref().ok())
    }

    /// The table for the terminal and the book.
    #[must_use]
    pub fn table(&self) -> String {
        let mut out = String::from(
            "| session, figure | nominal, 95 % | drawn, 95 % | drawn: error over sigma | worst | with |\n\
             |---|---|---|---|---|---|\n",
        );
        for (name, of) in SESSIONS {
            for (figure, value) in FIGURES {
                let values = |kind: &Kind| -> Vec<(f64, Option<f64>)> {
                    self.of(kind).map(|sessions| value(of(sessions))).collect()
                };
                let size = |values: &[(f64, Option<f64>)]| {
                    let sizes: Vec<f64> = values.iter().map(|(error, _)| error.abs()).collect();
                    quantile(&sizes, 0.95).map_or("-".to_owned(), |size| format!("{size:.1}"))
                };
                let drawn = values(&Kind::Drawn);
                let (worst, with) = self.worst(|sessions| value(of(sessions)).0);
                let _ = writeln!(
                    out,
                    "| {name}: {figure} | {} | {} | {} | {worst:.1} | {with} |",
                    size(&values(&Kind::Nominal)),
                    size(&drawn),
                    over_sigma(&drawn),
                );
            }
        }
        out
    }

    /// The largest error where one belief is at an end of its range, and that belief.
    fn worst(&self, error: impl Fn(&Sessions) -> f64) -> (f64, &str) {
        let mut worst = (0.0, "-");
        for rig in &self.rigs {
            if let (Kind::Extreme(belief), Ok(sessions)) = (&rig.kind, &rig.sessions) {
                let size = error(sessions).abs();
                if size > worst.0 {
                    worst = (size, belief);
                }
            }
        }
        worst
    }

    /// Rigs without sessions, and why.
    pub fn failed(&self) -> impl Iterator<Item = (&RigResult, &str)> {
        self.rigs.iter().filter_map(|rig| match &rig.sessions {
            Ok(_) => None,
            Err(reason) => Some((rig, reason.as_str())),
        })
    }
}

/// RMS of errors over their stated sigmas: 1 if those are honest.
fn over_sigma(values: &[(f64, Option<f64>)]) -> String {
    let squares: Vec<f64> = values
        .iter()
        .filter_map(|(error, sigma)| sigma.map(|sigma| (error / sigma).powi(2)))
        .collect();
    if squares.is_empty() {
        return "-".to_owned();
    }
    format!("{:.2}", mean(&squares).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warming_crystal_drifts_and_is_named() {
        let warming = BELIEFS
            .iter()
            .position(|b| b.name.contains("phone's clock"))
            .unwrap();
        let kind = Kind::Extreme(format!("{}: 5", BELIEFS[warming].name));
        let rig = |kind: &Kind, beliefs: &Beliefs| RigResult {
            seed: 1,
            kind: kind.clone(),
            sessions: sessions(1, beliefs).map_err(|error| error.to_string()),
        };
        let nominal = Beliefs::default();
        let study = BeliefStudy {
            rigs: vec![
                rig(&Kind::Nominal, &nominal),
                rig(&kind, &nominal.with(warming, 5.0)),
            ],
        };
        assert_eq!(study.failed().count(), 0, "{:?}", study.rigs);
        let of = |kind: &Kind| *study.of(kind).next().unwrap();
        let (usual, warm) = (of(&Kind::Nominal), of(&kind));
        // Some µs of phase; what was learnt allows for warming since, three twists do not
        // take their noise for it.
        assert!(usual.learnt.phase_us.abs() < 15.0, "{usual:?}");
        let learnt = usual.learnt;
        let sigmas = learnt.drift_5_us_per_min / learnt.drift_sigma_us_per_min;
        assert!(sigmas.abs() < 3.0, "{usual:?}");
        assert!(
            usual.three_twists.drift_5_us_per_min.abs() < 8.0,
            "{usual:?}"
        );
        assert!(
            usual.two_twists.drift_5_us_per_min.abs() < 15.0,
            "{usual:?}"
        );
        // 5 ppm in ten minutes is 150 µs/min on the average of the first five, and more
        // twists foresee more of it.
        let two = warm.two_twists.drift_5_us_per_min.abs();
        let three = warm.three_twists.drift_5_us_per_min.abs();
        assert!((40.0..200.0).contains(&two), "{warm:?}");
        assert!(three < two, "{warm:?}");
        let (worst, with) = study.worst(|sessions| sessions.two_twists.drift_5_us_per_min);
        assert_eq!(
            (worst, with),
            (two, format!("{}: 5", BELIEFS[warming].name).as_str())
        );
        assert!(
            study
                .table()
                .contains("two twists, cold rig: drift, five minutes")
        );
    }
}
