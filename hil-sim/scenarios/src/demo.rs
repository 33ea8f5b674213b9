//! The demonstration: whole sessions on the simulated rig, judged by the ground truth.
//!
//! The sessions are the program's own, on virtual time ([`crate::virtual_session`]), so that a
//! seed gives the same figures on any machine. Nothing about the rig is given: its constants are
//! drawn, and its owner begins with the profile of a first set-up. A calibration with LED and
//! photodiode teaches the profile; then comes the session that is shown. The phone hangs on a
//! cable, so the trigger follows its clock, unless the demonstration is to do without. The rig is
//! twisted all the time: a session may ask for it at any moment.

pub mod data_set;
pub mod report;

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use anyhow::{Context, Result};
use recording::folder;
use rig::clocks::link_delay::LinkRanges;
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use rig::wiring;
use rig::wiring::jumpers::Jumpers;
use session::options::{LED_TICKS, Track};

use crate::calibration;
use crate::judge::{Truth, Verdict};
use crate::programs::Programs;
use crate::virtual_session::SessionBench;
use report::{Figures, SessionFigures};

/// Settings of a demo.
#[derive(Clone, Debug, clap::Args)]
pub struct DemoOptions {
    /// Seed of all random numbers: clocks, mounting, motion, noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Seconds of board time to record.
    #[arg(long, value_name = "SECONDS", default_value_t = 60,
          value_parser = clap::value_parser!(u32).range(5..=3_600))]
    pub seconds: u32,
    /// Folder for the recording, the phone's files and the report.
    #[arg(long, value_name = "DIR", default_value = "target/demo")]
    pub out: PathBuf,
    /// The phone does not hang on a cable: its clock is not followed.
    #[arg(long)]
    pub without_cable: bool,
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
pub fn run(options: &DemoOptions, programs: &Programs) -> Result<Demo> {
    let begun = Instant::now();
    let out = &options.out;
    let seed = Seed(options.seed);
    let mut config = RigConfig::published(seed).with_motion(MotionSpec::always(Gesture::WeakTwist));
    let mut phone = PhoneConfig::draw(seed);
    // A phone knows nothing of the rigs before it, whose dates were the same.
    let storage = folder::create(out, "phone")?;
    phone.storage = Some(storage.clone());
    phone.camera.show_ball();
    calibration::hide_constants(seed, &mut config, &mut phone);
    // The read-back is wired, as its owner would.
    let wires = Jumpers {
        strobe: None,
        ..Jumpers::default()
    };
    let board = wiring::board_of(config.board, programs.elf.as_deref());
    let board = board.model(Arc::new(Mutex::new(wires)));
    let mut bench = SessionBench::new(config, board, vec![phone], &[], out)?;
    (bench.has_recorder, bench.shows_ball) = (true, true);
    bench.copies_files = true;
    bench.hands().set_clock_to_now();
    bench.phone_link = (!options.without_cable).then_some(LinkRanges::PHONE_USB);
    let track = if options.without_cable {
        Track::Never
    } else {
        Track::Always
    };
    calibration::set_up(&mut bench, programs)?;
    let taught = calibration::calibrate(&mut bench, track, LED_TICKS, programs)?;
    let wishes = calibration::wishes(&bench, "recording", options.seconds, track);
    let recording = bench.run(&wishes).good()?.folder;
    let virtual_s = bench.with(|rig| rig.now()).as_secs_f64();
    let truth = Truth::from_run(bench.stop()?)?;
    let verdict = truth.judge(&recording)?;
    let before = truth.judge(&taught)?;
    let data = data_set::make(truth, &recording, storage, programs).context("the data set")?;
    let figures = Figures {
        session: SessionFigures::from_verdict(&verdict),
        virtual_s,
        wall_s: begun.elapsed().as_secs_f64(),
        seed: options.seed,
        before_learning: SessionFigures::from_verdict(&before),
    };
    let report = options.out.join("report.html");
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
