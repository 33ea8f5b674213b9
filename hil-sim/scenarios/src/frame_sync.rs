//! Phase and drift of the frames from launch to launch, by the ground truth.
//!
//! A launch is a rig of its own seed: clocks up to ±50 ppm and hours apart,
//! sensors mounted at random. On each rig two sessions are run on virtual time
//! ([`crate::virtual_session`]): one with nothing learnt, from which the profile
//! learns, and one with the learnt profile. The phase error of a session is the
//! depth camera's middle of exposure minus the phone's, at the start of the
//! recorded span; its drift is the change of that over the span.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use evaluate::stats::{mean, quantile, standard_deviation};
use recording::profile::Profile;
use recording::session_file::SessionFile;
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::rig_config::RigConfig;
use rig::wiring;
use serde::Serialize;
use session::options::seconds;

use crate::judge::{Truth, TwistVerdict, Verdict};
use crate::programs::{Programs, ask};
use crate::virtual_session::Bench;
use crate::whole_chain::new_folder;
use crate::workers;

/// Figures of the paper for its rig (66.3 µs IQR and 61.6 µs SD of the phase
/// from launch to launch, 16.34 µs/min of drift).
pub(crate) const PAPER: (f64, f64, f64) = (66.3, 61.6, 16.34);

/// Settings of the measurement.
#[derive(Clone, Debug)]
pub struct FrameSyncOptions {
    /// The first rig's seed; the others follow it.
    pub first_seed: u64,
    /// Number of rigs.
    pub launches: u32,
    /// Length of each recording, seconds of board time.
    pub seconds: u32,
    /// Number of rigs that run at the same time.
    pub jobs: u32,
    /// Folder of the recordings.
    pub out: PathBuf,
    /// The programs that run.
    pub programs: Programs,
    /// Recordings are kept; otherwise they go as soon as they are judged.
    pub keep: bool,
}

/// One session, judged.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Launch {
    /// The rig.
    pub seed: u64,
    /// Phase error at the start, µs.
    pub phase_error_us: f64,
    /// Its stated 1-sigma, µs.
    pub phase_sigma_us: f64,
    /// Drift of the phase, µs a minute.
    pub drift_us_per_min: f64,
    /// Its stated 1-sigma, µs a minute.
    pub drift_sigma_us_per_min: f64,
    /// Error of the clock offset at the start, µs.
    pub offset_error_us: f64,
    /// Its stated 1-sigma, µs.
    pub offset_sigma_us: f64,
    /// The twist alone.
    pub twist: TwistVerdict,
    /// Messages, pulses and frames that are missing.
    pub lost: u64,
}

/// Launches of one kind in a few numbers.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Spread {
    /// Their number.
    pub launches: usize,
    /// Mean phase error, µs.
    pub bias_us: f64,
    /// Standard deviation of the phase error, µs.
    pub sd_us: f64,
    /// Interquartile range of the phase error, µs.
    pub iqr_us: f64,
    /// Largest phase error without its sign, µs.
    pub worst_us: f64,
    /// Mean drift without its sign, µs a minute.
    pub drift_us_per_min: f64,
    /// Largest drift without its sign, µs a minute.
    pub worst_drift_us_per_min: f64,
    /// RMS of phase errors over their stated sigmas: 1 if those are honest.
    pub phase_sigmas: f64,
    /// The same for the drifts.
    pub drift_sigmas: f64,
    /// The same for the clock offset at the start.
    pub offset_sigmas: f64,
    /// The same for what the twist alone said of the offset.
    pub twist_offset_sigmas: f64,
    /// The same for what the twist alone said of the skew.
    pub twist_skew_sigmas: f64,
}

/// All launches.
#[derive(Clone, Debug, Serialize)]
pub struct FrameSync {
    /// Length of each recording, seconds of board time.
    pub seconds: u32,
    /// With an uncalibrated profile.
    pub fresh: Vec<Launch>,
    /// With the profile that the session before has taught.
    pub learnt: Vec<Launch>,
    /// Rigs on which a session failed, with the reason. They are in none of the
    /// figures.
    pub failed: Vec<FailedLaunch>,
}

/// A rig on which a session failed.
#[derive(Clone, Debug, Serialize)]
pub struct FailedLaunch {
    /// The rig.
    pub seed: u64,
    /// Why.
    pub reason: String,
}

impl Spread {
    /// Of these launches; nothing for fewer than two.
    #[must_use]
    pub fn of(launches: &[Launch]) -> Option<Self> {
        let phases: Vec<f64> = launches.iter().map(|l| l.phase_error_us).collect();
        let drifts: Vec<f64> = launches.iter().map(|l| l.drift_us_per_min.abs()).collect();
        let sigmas = |of: fn(&Launch) -> (f64, f64)| {
            let ratios = launches.iter().map(of).map(|(error, sigma)| error / sigma);
            mean(&ratios.map(|ratio| ratio * ratio).collect::<Vec<_>>()).sqrt()
        };
        let most = |values: &[f64]| values.iter().map(|v| v.abs()).fold(0.0, f64::max);
        Some(Self {
            launches: launches.len(),
            bias_us: mean(&phases),
            sd_us: standard_deviation(&phases)?,
            iqr_us: quantile(&phases, 0.75)? - quantile(&phases, 0.25)?,
            worst_us: most(&phases),
            drift_us_per_min: mean(&drifts),
            worst_drift_us_per_min: most(&drifts),
            phase_sigmas: sigmas(|l| (l.phase_error_us, l.phase_sigma_us)),
            drift_sigmas: sigmas(|l| (l.drift_us_per_min, l.drift_sigma_us_per_min)),
            offset_sigmas: sigmas(|l| (l.offset_error_us, l.offset_sigma_us)),
            twist_offset_sigmas: sigmas(|l| (l.twist.offset.error_us, l.twist.offset.sigma_us)),
            twist_skew_sigmas: sigmas(|l| (l.twist.skew_error_ppm, l.twist.skew_sigma_ppm)),
        })
    }
}

impl FrameSync {
    /// The table for the terminal and the book.
    #[must_use]
    pub fn table(&self) -> String {
        let mut out = format!(
            "Phase of the frames from launch to launch, and its drift over {} s (simulated):\n\n\
             | | paper | fresh profile | learnt profile |\n|---|---|---|---|\n",
            self.seconds
        );
        let (fresh, learnt) = (Spread::of(&self.fresh), Spread::of(&self.learnt));
        let value = |spread: &Option<Spread>, of: &dyn Fn(&Spread) -> f64, digits: usize| {
            spread
                .as_ref()
                .map_or("-".to_owned(), |s| format!("{:.digits$}", of(s)))
        };
        type Row = (&'static str, Option<f64>, usize, fn(&Spread) -> f64);
        let rows: [Row; 12] = [
            ("launches", None, 0, |s| s.launches as f64),
            ("phase, IQR (µs)", Some(PAPER.0), 2, |s| s.iqr_us),
            ("phase, SD (µs)", Some(PAPER.1), 2, |s| s.sd_us),
            ("phase, mean (µs)", None, 2, |s| s.bias_us),
            ("phase, largest (µs)", None, 2, |s| s.worst_us),
            ("drift, mean (µs/min)", Some(PAPER.2), 2, |s| {
                s.drift_us_per_min
            }),
            ("drift, largest (µs/min)", None, 2, |s| {
                s.worst_drift_us_per_min
            }),
            ("phase over its stated sigma, RMS", None, 2, |s| {
                s.phase_sigmas
            }),
            ("drift over its stated sigma, RMS", None, 2, |s| {
                s.drift_sigmas
            }),
            ("clock offset over its stated sigma, RMS", None, 2, |s| {
                s.offset_sigmas
            }),
            ("twist's offset over its stated sigma, RMS", None, 2, |s| {
                s.twist_offset_sigmas
            }),
            ("twist's skew over its stated sigma, RMS", None, 2, |s| {
                s.twist_skew_sigmas
            }),
        ];
        for (name, paper, digits, of) in rows {
            let _ = writeln!(
                out,
                "| {name} | {} | {} | {} |",
                paper.map_or(String::new(), |p| p.to_string()),
                value(&fresh, &of, digits),
                value(&learnt, &of, digits),
            );
        }
        let lost: u64 = self.fresh.iter().chain(&self.learnt).map(|l| l.lost).sum();
        let _ = writeln!(out, "\nlost in all sessions: {lost}");
        for failed in &self.failed {
            let _ = writeln!(out, "seed {} failed: {}", failed.seed, failed.reason);
        }
        out
    }
}

/// Runs all launches. `done` is called after each rig that went well.
pub fn run(options: &FrameSyncOptions, done: impl Fn(&Launch, &Launch) + Sync) -> FrameSync {
    let seeds: Vec<u64> = (0..options.launches)
        .map(|number| options.first_seed.wrapping_add(number.into()))
        .collect();
    let results = workers::each(&seeds, options.jobs as usize, |&seed| {
        let result = launch(options, seed);
        if let Ok((fresh, learnt)) = &result {
            done(fresh, learnt);
        }
        (seed, result)
    });
    let mut all = FrameSync {
        seconds: options.seconds,
        fresh: Vec::new(),
        learnt: Vec::new(),
        failed: Vec::new(),
    };
    for (seed, result) in results {
        match result {
            Ok((fresh, learnt)) => {
                all.fresh.push(fresh);
                all.learnt.push(learnt);
            }
            Err(error) => all.failed.push(FailedLaunch {
                seed,
                reason: format!("{error:#}"),
            }),
        }
    }
    all
}

/// Both sessions on one rig.
fn launch(options: &FrameSyncOptions, seed: u64) -> Result<(Launch, Launch)> {
    let out = new_folder(&options.out.join(format!("seed_{seed}")))?;
    let config = RigConfig::published(Seed(seed)).with_motion(MotionSpec::always(Gesture::Twist));
    let mut phone = PhoneConfig::draw(Seed(seed));
    phone.storage = Some(out.join("phone"));
    let board = wiring::board_of(config.board, options.programs.elf.as_deref());
    let mut bench = Bench::new(config, board, vec![phone], &[], &out)?;
    let session = |bench: &mut Bench, name: &str| -> Result<PathBuf> {
        let mut wishes = bench.options(name);
        wishes.duration = Some(seconds(options.seconds.into()));
        wishes.second_twist = true;
        Ok(bench.run(&wishes).good()?.folder)
    };
    let fresh = session(&mut bench, "fresh")?;
    let profile = bench.write_profile()?;
    let video = bench.with(|rig| rig.phones.first()?.videos().pop());
    let timestamps = video.context("the phone has recorded no video")?.timestamps;
    ask(
        &options.programs,
        &["profile", "learn", "--profile", &profile.to_string_lossy()],
        &[Path::new("--timestamps"), &timestamps, &fresh],
    )?;
    bench.profile = Profile::load(&profile)?;
    let learnt = session(&mut bench, "learnt")?;
    let truth = Truth::of(bench.stop()?)?;
    let judge = |folder: &Path| -> Result<Launch> {
        let verdict = truth.judge(folder)?;
        Launch::of(seed, &verdict, &SessionFile::load(folder)?)
    };
    let both = (judge(&fresh)?, judge(&learnt)?);
    if !options.keep {
        std::fs::remove_dir_all(&out)
            .with_context(|| format!("cannot remove {}", out.display()))?;
    }
    Ok(both)
}

impl Launch {
    fn of(seed: u64, verdict: &Verdict, session: &SessionFile) -> Result<Self> {
        let alignment = session
            .alignment
            .as_ref()
            .context("the session has aligned nothing")?;
        Ok(Self {
            seed,
            phase_error_us: verdict.phase.start_us,
            phase_sigma_us: alignment.phase_sigma_us,
            drift_us_per_min: verdict.phase.drift_us_per_min,
            drift_sigma_us_per_min: alignment.drift_sigma_us_per_min,
            offset_error_us: verdict.offset_start.error_us,
            offset_sigma_us: verdict.offset_start.sigma_us,
            twist: verdict.twist,
            lost: verdict.lost,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::OffsetError;

    fn launch(seed: u64, phase_error_us: f64, drift_us_per_min: f64) -> Launch {
        Launch {
            seed,
            phase_error_us,
            phase_sigma_us: 2.0,
            drift_us_per_min,
            drift_sigma_us_per_min: 1.0,
            offset_error_us: 4.0,
            offset_sigma_us: 2.0,
            twist: TwistVerdict {
                offset: OffsetError {
                    error_us: -3.0,
                    sigma_us: 3.0,
                },
                skew_error_ppm: 1.5,
                skew_sigma_ppm: 0.5,
            },
            lost: 0,
        }
    }

    #[test]
    fn the_spread_is_that_of_its_launches() {
        let launches: Vec<Launch> = [-2.0, -1.0, 0.0, 1.0, 7.0]
            .into_iter()
            .zip(0..)
            .map(|(phase, seed)| launch(seed, phase, if seed % 2 == 0 { 1.0 } else { -3.0 }))
            .collect();
        let spread = Spread::of(&launches).unwrap();
        assert!((spread.bias_us - 1.0).abs() < 1e-12);
        assert!((spread.sd_us - 12.5_f64.sqrt()).abs() < 1e-12);
        assert!((spread.iqr_us - 2.0).abs() < 1e-12);
        assert_eq!(spread.worst_us, 7.0);
        assert!((spread.drift_us_per_min - 1.8).abs() < 1e-12);
        assert_eq!(spread.worst_drift_us_per_min, 3.0);
        assert!((spread.phase_sigmas - (55.0_f64 / 5.0 / 4.0).sqrt()).abs() < 1e-12);
        let twist = (spread.twist_offset_sigmas, spread.twist_skew_sigmas);
        assert_eq!((spread.offset_sigmas, twist), (2.0, (1.0, 3.0)));
        assert!(Spread::of(&launches[..1]).is_none());
        let table = FrameSync {
            seconds: 300,
            fresh: launches.clone(),
            learnt: launches,
            failed: Vec::new(),
        }
        .table();
        assert!(
            table.contains("| phase, IQR (µs) | 66.3 | 2.00 | 2.00 |"),
            "{table}"
        );
    }
}
