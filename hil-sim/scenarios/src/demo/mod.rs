//! The demonstration: whole sessions on the simulated rig, judged by the truth.
//!
//! The rig runs in this process; each session is the program `smartdepthsync
//! record` as a process of its own ([`stage`]). First comes a session with
//! nothing learnt, as on a new rig, from which the profile learns the rates of
//! the phone's clock and frames; then the one that is shown. Both are judged.

pub mod data_set;
pub mod report;
pub mod stage;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use recording::reader::{Item, Reader};
use recording::session_file::SessionFile;

use crate::judge::Verdict;
use crate::programs::said;
use report::Figures;
use stage::{Stage, StageOptions};

/// Seconds of board time that are recorded unless asked otherwise.
pub const DEFAULT_SECONDS: u32 = 60;

/// Longest and shortest recording, seconds.
pub const SECONDS: std::ops::RangeInclusive<u32> = 5..=3600;

/// Length of the session that teaches, seconds: two twists that are a minute
/// apart, the least that `smartdepthsync profile learn` takes a skew from.
const TEACHING_SECONDS: u32 = 60;

/// What to show.
#[derive(Clone, Debug)]
pub struct DemoOptions {
    /// The rig and where its files go.
    pub stage: StageOptions,
    /// Seconds of board time to record.
    pub seconds: u32,
    /// Show the session with nothing learnt alone.
    pub fresh: bool,
}

/// What a run has left.
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
    let profile = stage.profile().to_owned();
    let taught = match options.fresh {
        true => None,
        false => Some(stage.session("teaching", TEACHING_SECONDS, &["--calibrate"])?),
    };
    let arguments = ["--second-twist", "--fetch-video"];
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
    let twist = twist_plot(options, &profile, &recording)?;
    let figures = Figures::new(
        &verdict,
        before.as_ref(),
        virtual_s,
        begun.elapsed().as_secs_f64(),
        options.stage.seed,
    );
    let report = options.stage.out.join("report.html");
    std::fs::write(
        &report,
        report::page(&figures, &verdict, &data, twist.as_deref()),
    )
    .with_context(|| format!("cannot write {}", report.display()))?;
    Ok(Demo {
        figures,
        recording,
        data,
        report,
        verdict,
    })
}

/// Has `smartdepthsync offset` draw the first twist; nothing if there is none.
fn twist_plot(options: &DemoOptions, profile: &Path, recording: &Path) -> Result<Option<String>> {
    let session = SessionFile::load(recording)?;
    let mut twists = session
        .reference()
        .into_iter()
        .flat_map(|phone| &phone.twists);
    let Some(twist) = twists.find(|twist| twist.accepted) else {
        return Ok(None);
    };
    let (Some(phone), Some(imu)) = (&twist.phone_gyro, &session.imu) else {
        return Ok(None);
    };
    let mut csv = String::from("time_s,x,y,z\n");
    for entry in Reader::open(recording)? {
        let entry = entry?;
        if entry.at < twist.span.from || entry.at > twist.span.to {
            continue;
        }
        if let Item::Imu(sample) = entry.item {
            let [x, y, z] = sample.angular_velocity;
            let _ = writeln!(csv, "{:.9},{x},{y},{z}", entry.at.as_secs_f64());
        }
    }
    let board = options.stage.out.join("twist_board_gyro.csv");
    std::fs::write(&board, csv).with_context(|| format!("cannot write {}", board.display()))?;
    let plot = options.stage.out.join("twist.svg");
    let rig = recording::profile::Profile::load(profile)?;
    let programs = &options.stage.programs;
    let mut command = programs.tool();
    command
        .arg("offset")
        .arg("--mcu")
        .arg(&board)
        .arg("--phone")
        .arg(recording.join(phone))
        .arg("--plot")
        .arg(&plot)
        .args(["--mcu-delay-us", &imu.scale.gyro_delay_us.to_string()])
        .args(["--phone-delay-us", &rig.phone.gyro_delay_us.to_string()]);
    let output = programs.output(&mut command)?;
    ensure!(
        output.status.success(),
        "the plot of the twist failed: {}",
        said(&output)
    );
    let svg = std::fs::read_to_string(&plot)
        .with_context(|| format!("cannot read {}", plot.display()))?;
    Ok(Some(svg))
}
