//! Figures of rigs over what may be true of them.
//!
//! Rigs as modelled, rigs drawn from all ranges at once, and rigs with one value at an end of
//! its range. What each of them does is one of three: [sessions on the models](models), an hour
//! of [tracking](tracking) on clocks and links, or the [whole
//! chain](crate::whole_chain::ranges).
//! A figure is given three times: nominal and over the draws as the 95th percentile of its
//! size, and as the largest where one value alone is moved, with that value.

pub mod models;
pub mod tracking;

use std::fmt;
use std::fmt::Write as _;

use anyhow::Result;
use evaluate::stats::{mean, quantile};
use rig::model_ranges::{MODEL_RANGES, ModelValues};
use rig::random::Seed;
use serde::Serialize;

use crate::workers;

/// Size of a study.
#[derive(Clone, Copy, Debug)]
pub struct StudyOptions {
    /// The first seed; the others follow it.
    pub first_seed: u64,
    /// Rigs as modelled, and rigs that are drawn.
    pub rigs: u32,
    /// Rigs with each value at each end of its range.
    pub rigs_an_end: u32,
    /// Number of rigs that run at the same time.
    pub jobs: u32,
}

/// The rigs of a study, by what may be true of them.
pub struct Rigs<V> {
    /// As modelled.
    pub nominal: V,
    /// Drawn by a seed.
    pub drawn: Box<dyn Fn(Seed) -> V>,
    /// With one value at an end of its range, and that end in words.
    pub extremes: Vec<(String, V)>,
}

impl Rigs<ModelValues> {
    /// Of the ranges of the models. No clock that is drawn warms up by more than
    /// `most_warming_ppm` in ten minutes; with `exposure_locked` the exposure of those that are
    /// drawn is the same in each recording.
    #[must_use]
    pub fn of_models(most_warming_ppm: Option<f64>, exposure_locked: bool) -> Self {
        let drawn = move |seed| {
            let drawn = ModelValues::drawn(seed);
            let drawn = match most_warming_ppm {
                Some(most) => drawn.with_warming_at_most(most),
                None => drawn,
            };
            match exposure_locked {
                true => drawn.with_exposure_locked(),
                false => drawn,
            }
        };
        let ranges = MODEL_RANGES.iter().enumerate();
        let extremes = ranges.flat_map(|(place, range)| {
            range.extremes().into_iter().map(move |end| {
                let name = format!("{}: {end} {}", range.name, range.unit);
                (name, ModelValues::default().with(place, end))
            })
        });
        Self {
            nominal: ModelValues::default(),
            drawn: Box::new(drawn),
            extremes: extremes.collect(),
        }
    }
}

/// The kind of a rig.
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
pub struct Specimen<V = ModelValues> {
    /// Its seed.
    pub seed: u64,
    /// Which.
    pub kind: Kind,
    /// Values of its models.
    pub values: V,
}

/// A figure of a rig's sessions, the same ones in the same order for each rig.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// Its name, with its unit.
    pub name: String,
    /// Its error, by the ground truth.
    pub error: f64,
    /// The stated 1-sigma, where there is one.
    pub sigma: Option<f64>,
}

/// Figures of one rig.
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
pub struct Study {
    /// In the order of kinds and seeds.
    pub rigs: Vec<RigResult>,
}

/// Runs the study with these sessions of each rig; `done` is called for every rig that is
/// ready.
pub fn run<V: Clone + Sync>(
    options: &StudyOptions,
    rigs: &Rigs<V>,
    sessions: impl Fn(&Specimen<V>) -> Result<Vec<Figure>> + Sync,
    done: impl Fn(&RigResult) + Sync,
) -> Study {
    let seeds = |count: u32| (0..count).map(|n| options.first_seed.wrapping_add(n.into()));
    let mut specimens = Vec::new();
    let mut add = |seed, kind, values| {
        specimens.push(Specimen { seed, kind, values });
    };
    for seed in seeds(options.rigs) {
        add(seed, Kind::Nominal, rigs.nominal.clone());
        add(seed, Kind::Drawn, (rigs.drawn)(Seed(seed)));
    }
    for (end, values) in &rigs.extremes {
        for seed in seeds(options.rigs_an_end) {
            add(seed, Kind::Extreme(end.clone()), values.clone());
        }
    }
    let rigs = workers::each(&specimens, options.jobs as usize, |specimen| {
        let result = RigResult {
            seed: specimen.seed,
            kind: specimen.kind.clone(),
            figures: sessions(specimen).map_err(|error| format!("{error:#}")),
        };
        done(&result);
        result
    });
    Study { rigs }
}

impl Study {
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
        let study = Study {
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
