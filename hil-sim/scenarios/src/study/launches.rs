//! One rig launched again and again, measured from its strobes as the published rig was: the
//! spread of the phase between launches, and the drift over five minutes.
//!
//! A launch is a session of its own: connect, twist, align, record. The firmware's binary, its
//! link and the program's session make it, the phone's video is rendered and encoded, and the
//! program's `evaluate` measures the video. Beside each figure stands that of the ground truth.
//! The profile has learnt frame period and skew from one session before; the trigger does not
//! follow the phone's clock, as the published one does not.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use evaluate::precision::BiasStatistics;
use evaluate::stats::mean;
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use rig::wiring;
use serde::Serialize;
use session::options::Track;

use crate::calibration::{teach, wishes};
use crate::judge::Truth;
use crate::programs::{Programs, ask};
use crate::virtual_session::SessionBench;
use crate::whole_chain::{new_folder, number};
use crate::workers;

/// Frames that `evaluate precision` uses, the last ones.
const FRAMES: usize = 16;

/// Options of the study.
#[derive(Clone, Debug, clap::Args)]
pub struct LaunchesOptions {
    /// The rig's seed.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Launches of which the phase is measured.
    #[arg(long, default_value_t = 52, value_parser = clap::value_parser!(u32).range(2..=1_000))]
    pub launches: u32,
    /// Seconds of each.
    #[arg(long, value_name = "SECONDS", default_value_t = 10,
          value_parser = clap::value_parser!(u32).range(5..=600))]
    pub seconds: u32,
    /// Launches of which the drift is measured.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub drifts: u32,
    /// Seconds of each.
    #[arg(long, value_name = "SECONDS", default_value_t = 300,
          value_parser = clap::value_parser!(u32).range(30..=3_600))]
    pub drift_seconds: u32,
    /// Folder for the recordings; it is replaced.
    #[arg(long, value_name = "DIR", default_value = "target/launches")]
    pub out: PathBuf,
}

/// A measured value of a launch, and the true one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Measured {
    /// From the strobes.
    pub value: f64,
    /// Its stated 1-sigma.
    pub sigma: f64,
    /// By the ground truth.
    pub truth: f64,
}

/// The figures of the study. All are of the simulated rig.
#[derive(Clone, Debug, Serialize)]
pub struct Launches {
    /// Phase of each launch, µs.
    pub phases: Vec<Measured>,
    /// Drift of each long launch, µs/min.
    pub drifts: Vec<Measured>,
}

/// Sessions of one kind.
#[derive(Clone, Copy)]
enum Kind {
    Phase,
    Drift,
}

/// Launches the rig of the seed as often as asked; short and long launches beside each other, each
/// kind from a cold rig.
///
/// # Errors
///
/// A session fails or finishes with loss, or its video cannot be evaluated.
pub fn run(options: &LaunchesOptions, programs: &Programs) -> Result<Launches> {
    let parts = [(Kind::Phase, "phase"), (Kind::Drift, "drift")];
    let done = workers::each(&parts, parts.len(), |&(kind, name)| {
        let folder = new_folder(&options.out.join(name))?;
        measured(kind, options, programs, &folder)
    });
    let mut done = done.into_iter();
    let mut next = || done.next().context("a part of the study is missing")?;
    Ok(Launches {
        phases: next()?,
        drifts: next()?,
    })
}

fn measured(
    kind: Kind,
    options: &LaunchesOptions,
    programs: &Programs,
    out: &Path,
) -> Result<Vec<Measured>> {
    let seed = Seed(options.seed);
    let config = RigConfig::published(seed).with_motion(MotionSpec::always(Gesture::WeakTwist));
    let mut phone = PhoneConfig::draw(seed);
    phone.storage = Some(out.join("phone"));
    let board = wiring::board_of(config.board, programs.elf.as_deref());
    let mut bench = SessionBench::new(config, board, vec![phone], &[], out)?;
    bench.copies_files = true;
    teach(&mut bench, Track::Never, programs)?;
    let (count, seconds) = match kind {
        Kind::Phase => (options.launches, options.seconds),
        Kind::Drift => (options.drifts, options.drift_seconds),
    };
    let launch = |number| {
        let mut wishes = wishes(&bench, &format!("launch_{number}"), seconds, Track::Never);
        wishes.second_twist = false;
        let ended = bench.run(&wishes).good();
        Ok(ended.with_context(|| format!("launch {number}"))?.folder)
    };
    let folders: Vec<PathBuf> = (1..=count).map(launch).collect::<Result<_>>()?;
    let truth = Truth::from_run(bench.stop()?)?;
    match kind {
        Kind::Phase => phases(&folders, &truth, programs),
        Kind::Drift => drifts(&folders, &truth, programs),
    }
}

fn phases(folders: &[PathBuf], truth: &Truth, programs: &Programs) -> Result<Vec<Measured>> {
    let paths: Vec<&Path> = folders.iter().map(PathBuf::as_path).collect();
    let json = ask(programs, &["evaluate", "precision"], &paths)?;
    let results = json["recordings"].as_array().context("no recordings")?;
    ensure!(
        results.len() == folders.len(),
        "{} of {} launches were measured: {}",
        results.len(),
        folders.len(),
        json["left_out"]
    );
    let phase = |(folder, result): (&PathBuf, _)| {
        let phases = truth.judge(folder)?.phases;
        let last = phases.get(phases.len().saturating_sub(FRAMES)..);
        let last: Vec<f64> = last.into_iter().flatten().map(|p| p.error_us).collect();
        Ok(Measured {
            value: number(result, "bias_us")?,
            sigma: number(result, "sigma_us")?,
            truth: mean(&last),
        })
    };
    folders.iter().zip(results).map(phase).collect()
}

fn drifts(folders: &[PathBuf], truth: &Truth, programs: &Programs) -> Result<Vec<Measured>> {
    let drift = |folder: &PathBuf| {
        // The program finds the window itself.
        let json = ask(programs, &["evaluate", "drift"], &[folder])?;
        Ok(Measured {
            value: number(&json, "drift_us_per_min")?,
            sigma: number(&json, "drift_sigma_us_per_min")?,
            truth: truth.judge(folder)?.phase.drift_us_per_min,
        })
    };
    folders.iter().map(drift).collect()
}

/// SD and IQR between launches, µs, each with its own uncertainty.
fn spread(values: &[f64]) -> [(f64, f64); 2] {
    let found = BiasStatistics::from_values(values, &vec![0.0; values.len()]);
    let pair = |value: Option<f64>, sigma: Option<f64>| {
        (value.unwrap_or(f64::NAN), sigma.unwrap_or(f64::NAN))
    };
    [
        pair(
            found.and_then(|f| f.sd_us),
            found.and_then(|f| f.sd_sigma_us),
        ),
        pair(
            found.and_then(|f| f.iqr_us),
            found.and_then(|f| f.iqr_sigma_us),
        ),
    ]
}

pub(super) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    mean(&values.map(|value| value * value).collect::<Vec<_>>()).sqrt()
}

impl fmt::Display for Launches {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let values = |of: fn(&Measured) -> f64| self.phases.iter().map(of).collect::<Vec<f64>>();
        let measured = spread(&values(|m| m.value));
        let truth = spread(&values(|m| m.truth));
        writeln!(
            f,
            "| simulated, {} launches of one rig, {} of them long | from the strobes | ground truth |\n|---|---|---|",
            self.phases.len() + self.drifts.len(),
            self.drifts.len()
        )?;
        for ((name, (value, sigma)), (true_value, _)) in
            ["SD", "IQR"].into_iter().zip(measured).zip(truth)
        {
            writeln!(
                f,
                "| phase between launches, {name} (µs) | {value:.1} ± {sigma:.1} | {true_value:.1} |"
            )?;
        }
        let drift = |of: fn(&Measured) -> f64| rms(self.drifts.iter().map(of));
        writeln!(
            f,
            "| drift over a long launch, rms (µs/min) | {:.2} | {:.2} |",
            drift(|m| m.value),
            drift(|m| m.truth)
        )?;
        let over = |all: &[Measured]| rms(all.iter().map(|m| (m.value - m.truth) / m.sigma));
        let (phase, drift) = (over(&self.phases), over(&self.drifts));
        write!(
            f,
            "\nError of the strobes' answer over its stated sigma, rms: {phase:.2} (phase), {drift:.2} (drift)"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_gives_the_spread_and_the_rms() {
        let measured = |value, truth| Measured {
            value,
            sigma: 0.5,
            truth,
        };
        let study = Launches {
            phases: [(1.0, 0.5), (2.0, 2.5), (3.0, 3.0), (4.0, 4.0), (5.0, 5.0)]
                .map(|(value, truth)| measured(value, truth))
                .to_vec(),
            drifts: vec![measured(3.0, 3.0), measured(-4.0, -5.0)],
        };
        let text = study.to_string();
        // SD √2.5 and quartiles 2 and 4; √((9 + 16) / 2).
        assert!(text.contains("SD (µs) | 1.6 ±"), "{text}");
        assert!(text.contains("IQR (µs) | 2.0 ±"), "{text}");
        assert!(text.contains("rms (µs/min) | 3.54 | 4.12 |"), "{text}");
        // Two errors of one sigma in five launches, one of two in two.
        assert!(text.contains("rms: 0.63 (phase), 1.41 (drift)"), "{text}");
    }
}
