//! The figures of frame sync over the ranges of the models.
//!
//! Rigs as modelled, rigs drawn from all ranges at once, and rigs with one value at an end of
//! its range: each does [`sessions`](models::sessions) on the models,
//! or one of the [whole chain](crate::whole_chain::ranges).
//! A figure is given three times: nominal and over the draws as the 95th percentile of its
//! size, and as the largest where one value alone is moved, with that value.

pub mod models;

use std::fmt;
use std::fmt::Write as _;

use anyhow::Result;
use evaluate::stats::{mean, quantile};
use rig::model_ranges::{MODEL_RANGES, ModelValues};
use rig::random::Seed;
use serde::Serialize;

use crate::workers;

/// What is to be studied.
#[derive(Clone, Copy, Debug)]
pub struct RangeOptions {
    /// The first seed; the others follow it.
    pub first_seed: u64,
    /// Rigs as modelled, and rigs that are drawn.
    pub rigs: u32,
    /// Rigs with each value at each end of its range.
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
    /// As modelled.
    Nominal,
    /// All values drawn by its seed.
    Drawn,
    /// One value at an end of its range, in words.
    Extreme(String),
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nominal => f.write_str("as modelled"),
            Self::Drawn => f.write_str("drawn"),
            Self::Extreme(value) => f.write_str(value),
        }
    }
}

/// One rig of a study.
#[derive(Clone, Debug)]
pub struct Specimen<B = ModelValues> {
    /// Its seed.
    pub seed: u64,
    /// Which.
    pub kind: Kind,
    /// What is true of it.
    pub values: B,
}

/// A figure of a rig's sessions, the same ones in the same order for each rig.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// What it is, with its unit.
    pub name: String,
    /// How wrong it is, by the truth.
    pub error: f64,
    /// The stated 1-sigma, where there is one.
    pub sigma: Option<f64>,
}

/// What came out of one rig.
#[derive(Clone, Debug, Serialize)]
pub struct RigResult {
    /// Its seed.
    pub seed: u64,
    /// Which.
    pub kind: Kind,
    /// The figures of its sessions, or why there are none.
    pub figures: Result<Vec<Figure>, String>,
}

impl fmt::Display for RigResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "seed {} ({})", self.seed, self.kind)?;
        match &self.figures {
            Ok(figures) => figures.iter().try_for_each(|figure| {
                write!(f, "; {}: {:.1}", figure.name, figure.error)?;
                figure.sigma.map_or(Ok(()), |s| write!(f, " ± {s:.1}"))
            }),
            Err(reason) => write!(f, ": {reason}"),
        }
    }
}

/// All rigs.
#[derive(Clone, Debug, Serialize)]
pub struct RangeStudy {
    /// In the order of kinds and seeds.
    pub rigs: Vec<RigResult>,
}

/// Runs the study with these sessions of each rig; `done` is called for every rig that is
/// ready.
pub fn run(
    options: &RangeOptions,
    sessions: impl Fn(&Specimen) -> Result<Vec<Figure>> + Sync,
    done: impl Fn(&RigResult) + Sync,
) -> RangeStudy {
    let seeds = |count: u32| (0..count).map(|n| options.first_seed.wrapping_add(n.into()));
    let mut specimens = Vec::new();
    let mut add = |seed, kind, values| {
        specimens.push(Specimen { seed, kind, values });
    };
    for seed in seeds(options.rigs) {
        let drawn = ModelValues::drawn(Seed(seed));
        let drawn = match options.most_warming_ppm {
            Some(most) => drawn.with_warming_at_most(most),
            None => drawn,
        };
        let drawn = if options.exposure_locked {
            drawn.with_exposure_locked()
        } else {
            drawn
        };
        add(seed, Kind::Nominal, ModelValues::default());
        add(seed, Kind::Drawn, drawn);
    }
    for (place, range) in MODEL_RANGES.iter().enumerate() {
        for end in range.extremes() {
            let kind = Kind::Extreme(format!("{}: {end} {}", range.name, range.unit));
            for seed in seeds(options.rigs_an_end) {
                add(seed, kind.clone(), ModelValues::default().with(place, end));
            }
        }
    }
    each(&specimens, options.jobs, sessions, done)
}

/// Runs a study of these rigs.
pub(crate) fn each<B: Sync>(
    specimens: &[Specimen<B>],
    jobs: u32,
    sessions: impl Fn(&Specimen<B>) -> Result<Vec<Figure>> + Sync,
    done: impl Fn(&RigResult) + Sync,
) -> RangeStudy {
    let rigs = workers::each(specimens, jobs as usize, |specimen| {
        let result = RigResult {
            seed: specimen.seed,
            kind: specimen.kind.clone(),
            figures: sessions(specimen).map_err(|error| format!("{error:#}")),
        };
        done(&result);
        result
    });
    RangeStudy { rigs }
}

impl RangeStudy {
    /// The figure at a place, of each rig that has one.
    fn at(&self, place: usize) -> impl Iterator<Item = (&Kind, &Figure)> {
        self.rigs.iter().filter_map(move |rig| {
            let figures = rig.figures.as_ref().ok()?;
            Some((&rig.kind, figures.get(place)?))
        })
    }

    /// The table for the terminal and the book.
    #[must_use]
    pub fn table(&self) -> String {
        let mut out = String::from(
            "| session, figure | nominal, 95 % | drawn, 95 % | drawn: error over sigma | worst | with |\n\
             |---|---|---|---|---|---|\n",
        );
        let mut place = 0;
        while let Some((_, Figure { name, .. })) = self.at(place).next() {
            let of = |wanted: &Kind| -> Vec<&Figure> {
                let all = self.at(place).filter(|(kind, _)| *kind == wanted);
                all.map(|(_, figure)| figure).collect()
            };
            let size = |figures: &[&Figure]| {
                let sizes: Vec<f64> = figures.iter().map(|figure| figure.error.abs()).collect();
                quantile(&sizes, 0.95).map_or("-".to_owned(), |size| format!("{size:.1}"))
            };
            let drawn = of(&Kind::Drawn);
            let (worst, with) = match self.worst(place) {
                Some((worst, with)) => (format!("{worst:.1}"), with),
                None => ("-".to_owned(), "-"),
            };
            let _ = writeln!(
                out,
                "| {name} | {} | {} | {} | {worst} | {with} |",
                size(&of(&Kind::Nominal)),
                size(&drawn),
                over_sigma(&drawn),
            );
            place += 1;
        }
        let (failed, all) = (self.failed().count(), self.rigs.len());
        let _ = writeln!(
            out,
            "\n{failed} of {all} rigs had no session: they are in none of the figures"
        );
        out
    }

    /// The largest error where one value is at an end of its range, and that value.
    fn worst(&self, place: usize) -> Option<(f64, &str)> {
        let sizes = self.at(place).filter_map(|(kind, figure)| match kind {
            Kind::Extreme(value) => Some((figure.error.abs(), value.as_str())),
            Kind::Nominal | Kind::Drawn => None,
        });
        sizes.max_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Rigs without sessions, and why.
    pub fn failed(&self) -> impl Iterator<Item = (&RigResult, &str)> {
        self.rigs.iter().filter_map(|rig| match &rig.figures {
            Ok(_) => None,
            Err(reason) => Some((rig, reason.as_str())),
        })
    }
}

/// RMS of errors over their stated sigmas: 1 if those are honest.
fn over_sigma(figures: &[&Figure]) -> String {
    let squares: Vec<f64> = figures
        .iter()
        .filter_map(|figure| Some((figure.error / figure.sigma?).powi(2)))
        .collect();
    if squares.is_empty() {
        return "-".to_owned();
    }
    format!("{:.2}", mean(&squares).sqrt())
}

#[cfg(test)]
mod tests {
    use super::models::sessions;
    use super::*;

    #[test]
    fn a_warming_crystal_drifts_and_is_named() {
        let warming = MODEL_RANGES
            .iter()
            .position(|b| b.name.contains("phone's clock"))
            .unwrap();
        let kind = Kind::Extreme(format!("{}: 5", MODEL_RANGES[warming].name));
        let nominal = ModelValues::default();
        let usual = sessions(1, &nominal).unwrap();
        let warm = sessions(1, &nominal.with(warming, 5.0)).unwrap();
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
        let rig = |kind: &Kind, figures| RigResult {
            seed: 1,
            kind: kind.clone(),
            figures,
        };
        let study = RangeStudy {
            rigs: vec![
                rig(&Kind::Nominal, Ok(usual.figures())),
                rig(&kind, Ok(warm.figures())),
                rig(&Kind::Drawn, Err("no twist".to_owned())),
            ],
        };
        let table = study.table();
        let name = "two twists, cold rig: drift, five minutes (µs/min)";
        let place = usual.figures().iter().position(|f| f.name == name);
        let worst = study.worst(place.unwrap()).unwrap();
        assert_eq!(worst, (two, kind.to_string().as_str()));
        let row = format!("| {two:.1} | {kind} |");
        let rows = |line: &&str| line.starts_with(&format!("| {name} |")) && line.ends_with(&row);
        assert_eq!(table.lines().filter(rows).count(), 1, "{table}");
        assert!(table.contains("1 of 3 rigs had no session"), "{table}");
    }
}
