//! The demonstration: whole sessions on the simulated rig, judged by the truth.
//!
//! The rig runs in this process; each session is the program `smartdepthsync
//! record` as a process of its own ([`stage`]). First comes a session with
//! nothing learnt, as on a new rig, from which the profile learns the rates of
//! the phone's clock and frames; then the one that is shown. Both are judged.

pub mod data_set;
pub mod report;
pub mod stage;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};

use crate::judge::Verdict;
use report::Figures;
use stage::{Stage, StageOptions};

/// Seconds of board time that are recorded unless asked otherwise.
pub const DEFAULT_SECONDS: u32 = 60;

/// Longest and shortest recording, seconds.
pub const SECONDS: std::ops::RangeInclusive<u32> = 5..=3600;

/// Length of the session that teaches, seconds: two twists that are a minute
/// apart, the least that `smartdepthsync profile learn` takes a skew from.
const TEACHING_SECONDS: u32 = 60;

/// Settings of a demo.
#[derive(Clone, Debug)]
pub struct DemoOptions {
    /// The rig and where its files go.
    pub stage: StageOptions,
    /// Seconds of board time to record.
    pub seconds: u32,
    /// Show the session with nothing learnt alone.
    pub fresh: bool,
}

/// Files of a run.
#[derive(Debug)]
pub struct Demo {
    /// The figures.
    pub figures: Figures,
    /// The recording's folder.
    pub recording: PathBuf,
    /// The data set.
    pub data: data_set::DataSet,
    /// The report.
    pub report: PathBuf,
    /// The whole verdict.
    pub verdict: Verdict,
}

/// Runs the demonstration.
///
/// # Errors
///
/// A part of it cannot be started, a session fails, or what it left cannot be
/// judged.
pub fn run(options: &DemoOptions) -> Result<Demo> {
    let begun = Instant::now();
    let stage = Stage::start(options.stage.clone())?;
    let taught = match options.fresh {
        true => None,
        false => Some(stage.session("teaching", TEACHING_SECONDS, &["--calibrate"])?),
    };
    let arguments = ["--second-twist"];
    let recording = stage.session("recording", options.seconds, &arguments)?;
    let virtual_s = stage.now().as_secs_f64();
    let phone = stage.phone()?.storage().to_owned();
    let truth = stage.end()?;
    let verdict = truth.judge(&recording)?;
    let before = taught
        .map(|recording| truth.judge(&recording))
        .transpose()?;
    let programs = &options.stage.programs;
    let data = data_set::make(truth, &recording, phone, programs).context("the data set")?;
    let figures = Figures::new(
        &verdict,
        before.as_ref(),
        virtual_s,
        begun.elapsed().as_secs_f64(),
        options.stage.seed,
    );
    let report = options.stage.out.join("report.html");
    std::fs::write(&report, report::page(&figures, &verdict, &data))
        .with_context(|| format!("cannot write {}", report.display()))?;
    Ok(Demo {
        figures,
        recording,
        data,
        report,
        verdict,
    })
}
