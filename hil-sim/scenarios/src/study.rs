//! Figures of rigs over the model ranges.
//!
//! Rigs as modelled, and rigs drawn from all ranges at once. Each of them does [sessions on the
//! models](models), an hour of [tracking](tracking) on clocks and links, [sessions through the
//! firmware, link and program](sessions), or the [whole chain](crate::whole_chain::ranges).
//! A figure is given as the 95th percentile of its size, nominal and over the draws, with the
//! rms of error over stated sigma of both, and as the largest over the draws with its cause: of
//! all values of that rig the one without which the figure is smallest.

pub mod launches;
pub mod models;
pub mod sessions;
pub mod tracking;

use std::fmt;
use std::fmt::Write as _;

use anyhow::Result;
use evaluate::stats::{mean, quantile};
use rig::model_ranges::ModelValues;
use rig::random::Seed;
use serde::Serialize;

use crate::workers;

/// Size of a study.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct StudyOptions {
    /// Rigs as modelled, and rigs that are drawn.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub rigs: u32,
    /// The first rig's seed; the others follow it.
    #[arg(long, default_value_t = 1)]
    pub first_seed: u64,
    /// Leave the rigs as modelled out.
    #[arg(long)]
    pub drawn_alone: bool,
    /// Number of rigs that run at the same time.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub jobs: u32,
}

/// The values of a rig without each of them, which is in words.
pub type Without<V> = Box<dyn Fn(&V) -> Vec<(String, V)>>;

/// The rigs of a study.
pub struct Rigs<V> {
    /// As modelled.
    pub nominal: V,
    /// Drawn by a seed.
    pub drawn: Box<dyn Fn(Seed) -> V>,
    /// A drawn one without each of its values; none where that takes too long.
    pub without: Without<V>,
}

impl Rigs<ModelValues> {
    /// Draws rigs from the ranges of the models; with `exposure_locked` a rig's exposure is the same
    /// in each recording.
    #[must_use]
    pub fn of_models(exposure_locked: bool) -> Self {
        let drawn = move |seed| {
            if exposure_locked {
                ModelValues::drawn(seed).with_exposure_locked()
            } else {
                ModelValues::drawn(seed)
            }
        };
        Self {
            nominal: ModelValues::nominal_by_hand(),
            drawn: Box::new(drawn),
            without: Box::new(ModelValues::each_without_one),
        }
    }

    /// The same, but the causes are not looked for.
    #[must_use]
    pub fn without_causes(mut self) -> Self {
        self.without = Box::new(|_| Vec::new());
        self
    }
}

/// The kind of a rig.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Kind {
    /// As modelled.
    Nominal,
    /// All values drawn by its seed.
    Drawn,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nominal => f.write_str("as modelled"),
            Self::Drawn => f.write_str("drawn"),
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

/// A figure of a rig's sessions. There may be several of one name.
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
    /// The figures of its sessions, or the reason why there are none.
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
    /// In the order of seeds.
    pub rigs: Vec<RigResult>,
    /// The largest error of a figure over the drawn rigs, by its name.
    pub worst: Vec<Worst>,
}

/// The largest error of a figure.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Worst {
    /// Name of the figure.
    pub name: String,
    /// The rig's seed.
    pub seed: u64,
    /// The error.
    pub error: f64,
    /// The value without which it is smallest, and the error then.
    pub cause: Option<(String, f64)>,
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
        if !options.drawn_alone {
            add(seed, Kind::Nominal, rigs.nominal.clone());
        }
        add(seed, Kind::Drawn, (rigs.drawn)(Seed(seed)));
    }
    let results = workers::each(&specimens, options.jobs as usize, |specimen| {
        let result = RigResult {
            seed: specimen.seed,
            kind: specimen.kind,
            figures: sessions(specimen).map_err(|error| format!("{error:#}")),
        };
        done(&result);
        result
    });
    let mut study = Study {
        rigs: results,
        worst: Vec::new(),
    };
    study.worst = study.worst_without_cause();
    // Each rig that is worst in something, without each of its values.
    let mut seeds: Vec<u64> = study.worst.iter().map(|worst| worst.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let variants = seeds.into_iter().flat_map(|seed| {
        let without = (rigs.without)(&(rigs.drawn)(Seed(seed)));
        without.into_iter().map(move |(words, values)| {
            let kind = Kind::Drawn;
            (words, Specimen { seed, kind, values })
        })
    });
    let variants: Vec<(String, Specimen<V>)> = variants.collect();
    let others = workers::each(&variants, options.jobs as usize, |(words, specimen)| {
        let figures = sessions(specimen).ok()?;
        Some((specimen.seed, words.clone(), figures))
    });
    for worst in &mut study.worst {
        let of_rig = others
            .iter()
            .flatten()
            .filter(|other| other.0 == worst.seed);
        let errors = of_rig.filter_map(|(_, words, figures)| {
            let own = figures.iter().filter(|figure| figure.name == worst.name);
            let largest = own.map(|figure| figure.error).max_by(by_size)?;
            Some((words.clone(), largest))
        });
        worst.cause = errors.min_by(|a, b| by_size(&a.1, &b.1));
    }
    study
}

fn by_size(a: &f64, b: &f64) -> std::cmp::Ordering {
    a.abs().total_cmp(&b.abs())
}

impl Study {
    /// The figures of rigs of a kind, each with its rig.
    fn figures_of(&self, kind: Kind) -> impl Iterator<Item = (&RigResult, &Figure)> {
        let rigs = self.rigs.iter().filter(move |rig| rig.kind == kind);
        rigs.flat_map(|rig| {
            rig.figures
                .iter()
                .flatten()
                .map(move |figure| (rig, figure))
        })
    }

    /// Names of the figures, as they come.
    fn names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for figure in self
            .rigs
            .iter()
            .filter_map(|rig| rig.figures.as_ref().ok())
            .flatten()
        {
            if !names.contains(&figure.name.as_str()) {
                names.push(&figure.name);
            }
        }
        names
    }

    fn worst_without_cause(&self) -> Vec<Worst> {
        let worst = self.names().into_iter().filter_map(|name| {
            let drawn = self
                .figures_of(Kind::Drawn)
                .filter(|(_, figure)| figure.name == name);
            let (rig, figure) = drawn.max_by(|a, b| by_size(&a.1.error, &b.1.error))?;
            Some(Worst {
                name: name.to_owned(),
                seed: rig.seed,
                error: figure.error,
                cause: None,
            })
        });
        worst.collect()
    }

    /// The table for the terminal and the book.
    #[must_use]
    pub fn table(&self) -> String {
        let mut out = String::from(
            "| session, figure | nominal, 95 % | error over sigma: rms, 95 % | drawn, 95 % | error over sigma: rms, 95 % | drawn, worst | which is less without |\n\
             |---|---|---|---|---|---|---|\n",
        );
        for name in self.names() {
            let _ = write!(out, "| {name} ");
            for kind in [Kind::Nominal, Kind::Drawn] {
                let own = self
                    .figures_of(kind)
                    .filter(|(_, figure)| figure.name == name);
                let own: Vec<&Figure> = own.map(|(_, figure)| figure).collect();
                let sizes: Vec<f64> = own.iter().map(|figure| figure.error.abs()).collect();
                let size = quantile(&sizes, 0.95).map_or("-".to_owned(), digits);
                let _ = write!(out, "| {size} | {} ", over_sigma(&own));
            }
            let worst = self.worst.iter().find(|worst| worst.name == name);
            let error = worst.map_or("-".to_owned(), |worst| digits(worst.error.abs()));
            let cause = worst.and_then(|worst| worst.cause.as_ref());
            let cause = cause.map_or("-".to_owned(), |(words, left)| {
                format!("{words} ({})", digits(left.abs()))
            });
            let _ = writeln!(out, "| {error} | {cause} |");
        }
        let (failed, all) = (self.failed().count(), self.rigs.len());
        let _ = writeln!(
            out,
            "\n{failed} of {all} rigs had no session: they are in none of the figures"
        );
        out
    }

    /// Rigs without sessions, and why.
    pub fn failed(&self) -> impl Iterator<Item = (&RigResult, &str)> {
        self.rigs.iter().filter_map(|rig| match &rig.figures {
            Ok(_) => None,
            Err(reason) => Some((rig, reason.as_str())),
        })
    }
}

fn digits(value: f64) -> String {
    if value < 1.0 {
        format!("{value:.2}")
    } else {
        format!("{value:.1}")
    }
}

/// Errors over their stated sigmas: rms and 95th percentile, 1 and 2 if those are honest.
fn over_sigma(figures: &[&Figure]) -> String {
    let ratio = |figure: &&Figure| Some((figure.error / figure.sigma?).abs());
    let ratios: Vec<f64> = figures.iter().filter_map(ratio).collect();
    let squares: Vec<f64> = ratios.iter().map(|ratio| ratio.powi(2)).collect();
    quantile(&ratios, 0.95).map_or("-".to_owned(), |most| {
        format!("{:.2}, {most:.1}", mean(&squares).sqrt())
    })
}

#[cfg(test)]
mod tests {
    use super::models::sessions;
    use super::*;
    use rig::model_ranges::MODEL_RANGES;

    #[test]
    fn a_warming_crystal_drifts() {
        let warming = MODEL_RANGES
            .iter()
            .position(|b| b.name == "warming of the phone's clock")
            .unwrap();
        let nominal = ModelValues::default();
        let usual = sessions(1, &nominal).unwrap();
        let warm = sessions(1, &nominal.with(warming, 5.0)).unwrap();
        // Some µs of phase; what was learnt allows for warming since, three twists do not
        // take their noise for it.
        assert!(usual.learnt.phase_us.abs() < 15.0, "{usual:?}");
        let learnt = usual.learnt;
        let sigmas = learnt.drift_us_per_min / learnt.drift_sigma_us_per_min;
        assert!(sigmas.abs() < 3.0, "{usual:?}");
        assert!(usual.three_twists.drift_us_per_min.abs() < 8.0, "{usual:?}");
        assert!(usual.two_twists.drift_us_per_min.abs() < 15.0, "{usual:?}");
        assert_eq!(usual.twists.len(), 14);
        let skews = usual
            .twists
            .iter()
            .filter(|twist| twist.name.contains("ppm"));
        assert!(
            skews.clone().all(|skew| skew.error.abs() < 3.0),
            "{usual:?}"
        );
        // 5 ppm in ten minutes is 150 µs/min on the average of the first five, and more
        // twists foresee more of it.
        let two = warm.two_twists.drift_us_per_min.abs();
        let three = warm.three_twists.drift_us_per_min.abs();
        assert!((40.0..200.0).contains(&two), "{warm:?}");
        assert!(three < two, "{warm:?}");
    }

    #[test]
    fn the_worst_rig_is_given_with_its_cause() {
        let rigs = Rigs {
            nominal: vec![0.0; 2],
            drawn: Box::new(|seed| vec![seed.0 as f64, 10.0]),
            without: Box::new(|values: &Vec<f64>| {
                let one = ("first".to_owned(), vec![0.0, values[1]]);
                vec![one, ("second".to_owned(), vec![values[0], 0.0])]
            }),
        };
        let options = StudyOptions {
            first_seed: 1,
            rigs: 3,
            drawn_alone: false,
            jobs: 2,
        };
        let figure = |error| Figure {
            name: "phase".to_owned(),
            error,
            sigma: Some(2.0),
        };
        let sessions = |rig: &Specimen<Vec<f64>>| match (rig.seed, rig.kind) {
            (2, Kind::Nominal) => anyhow::bail!("no twist"),
            _ => Ok(vec![figure(1.0), figure(rig.values.iter().sum())]),
        };
        let study = run(&options, &rigs, sessions, |_| ());
        let worst = Worst {
            name: "phase".to_owned(),
            seed: 3,
            error: 13.0,
            cause: Some(("second".to_owned(), 3.0)),
        };
        assert_eq!(study.worst, [worst]);
        let table = study.table();
        assert!(table.contains("| 13.0 | second (3.0) |"), "{table}");
        // Errors of 1, 11, 1, 12, 1 and 13 at a sigma of 2.
        assert!(table.contains("| 4.27, 6.4 |"), "{table}");
        assert!(table.contains("1 of 6 rigs had no session"), "{table}");
    }
}
