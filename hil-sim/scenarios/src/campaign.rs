//! The fault campaign: a session, and things that go wrong while it records.
//!
//! One run is one seed: a [`plan`] of one to four faults at random times, the real firmware
//! on the simulated board, and a whole session on virtual time ([`crate::virtual_session`]).
//! So a seed gives the same recording to the byte, however fast the machine is
//! ([`Verdict::digest`]).
//!
//! Judged, by the ground truth:
//!
//! - every edge of the trigger, reported or not, against the grid of the alignment;
//! - every pulse, sample and capture that the session was given, against the pin or the
//!   sensor's registers ([`crate::board_truth`]);
//! - what is counted as lost, against what is missing;
//! - the recording: it opens, it holds every pulse and sample that the session was given
//!   once, and nothing else; killed, all but the last second;
//! - the session goes on afterwards, with loss reported; after a reset of the board it is
//!   closed properly, with the reset's cause;
//! - the phone is left as it should be.
//!
//! Limit: a power cut or a held bus in the middle of a transfer can damage the bytes of that
//! one sample unnoticed, because I2C has no checksum. Such a sample is counted
//! ([`Verdict::disturbed`]) and no error.

mod happen;
mod judge;
pub mod plan;

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use anyhow::{Context, Result};
use protocol::{Command, Period, SetPeriod, TICK_HZ};
use recording::session_file::SessionOutcome;
use rig::clocks::link_delay::LinkRanges;
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use rig::wiring;
use serde::Serialize;
use session::event::Phase;
use session::options::Track;
use stm32f4_sim::time::SimDuration;

use crate::virtual_session::{Run, SessionBench};
use crate::workers;
use happen::{Flood, Happened};
use plan::Plan;

/// Result of a run that passed.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// The faults in it.
    pub plan: Plan,
    /// Outcome of the session.
    pub outcome: SessionOutcome,
    /// Virtual seconds.
    pub virtual_s: f64,
    /// Pulses at the pin, each exact.
    pub pulses: u64,
    /// Pulses, samples and captures that the session was given, each right.
    pub delivered: u64,
    /// Samples whose transfer a fault hit.
    pub disturbed: u64,
    /// Changes of the trigger's period, which follows the phone's clock.
    pub period_changes: u64,
    /// Pulses that are missing, and counted as lost.
    pub pulses_lost: u64,
    /// Samples likewise.
    pub samples_lost: u64,
    /// Edges of the strobe likewise.
    pub captures_lost: u64,
    /// Frames damaged on the way, and counted as damaged.
    pub damaged_frames: u32,
    /// Number of times that the link was taken up again.
    pub reconnects: u32,
    /// Problems that the session reported, by kind.
    pub problems: BTreeMap<String, u32>,
    /// CRC-32 of the recording: two runs of a seed are alike if this is.
    pub digest: u32,
}

/// A run that did not pass.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{plan}\n  {what}")]
pub struct Finding {
    /// The faults in it.
    pub plan: Plan,
    /// The violated promise.
    pub what: String,
}

/// Runs a plan. Files go into `folder`.
///
/// # Errors
///
/// A promise was not kept.
pub fn run(plan: &Plan, elf: Option<&Path>, folder: &Path) -> Result<Verdict, Finding> {
    let judged = record(plan, elf, folder).and_then(|ended| judge::judge(plan, &ended));
    judged.map_err(|error| Finding {
        plan: plan.clone(),
        what: format!("{error:#}"),
    })
}

/// Runs seeds, as many at a time as the machine has processors; `done` is called with each.
/// Gives their results in order.
pub fn campaign(
    seeds: &[u64],
    elf: Option<&Path>,
    folder: &Path,
    done: &(dyn Fn(u64, &Result<Verdict, Finding>) + Sync),
) -> Vec<Result<Verdict, Finding>> {
    let jobs = std::thread::available_parallelism().map_or(1, usize::from);
    workers::each(seeds, jobs, |&seed| {
        let result = run(&Plan::draw(Seed(seed)), elf, folder);
        done(seed, &result);
        result
    })
}

/// Folders of a run: the recording's is in the first.
#[must_use]
pub fn folders(seed: u64, folder: &Path) -> [PathBuf; 2] {
    ["", "-killed"].map(|kind| folder.join(format!("seed-{seed}{kind}")))
}

/// A session that has ended.
struct Ended {
    run: Run,
    killed: PathBuf,
    happened: Happened,
    truth: rig::whole_rig::running_rig::RunTruth,
    edges: Vec<judge::PinEdge>,
    /// Periods of the trigger that the session has asked for.
    periods: Vec<Period>,
    /// Resets that the watchdog made.
    failures: Vec<stm32f4_sim::sim::Failure>,
    phone_records: bool,
}

/// Runs the session of a plan.
fn record(plan: &Plan, elf: Option<&Path>, folder: &Path) -> Result<Ended> {
    let [place, killed] = folders(plan.seed, folder);
    for folder in [&place, &killed] {
        if folder.exists() {
            std::fs::remove_dir_all(folder)?;
        }
        std::fs::create_dir_all(folder)?;
    }
    let seed = Seed(plan.seed);
    let config = RigConfig::published(seed).with_motion(MotionSpec::always(Gesture::Twist));
    let mut phone = PhoneConfig::draw(seed);
    // Small and quick: videos are not what is judged here.
    (phone.camera.rows, phone.camera.columns) = (120, 16);
    phone.camera.first_frame_ms = (20.0, 50.0);
    let flood = Flood::shared();
    let board = wiring::board_of(config.board, elf)
        .tolerate_failures()
        .model(flood.clone());
    let mut bench = SessionBench::new(config, board, vec![phone], &[], &place)?;
    bench.hurry();
    bench.keeps_messages = true;
    for pin in [wiring::TRIGGER, wiring::STROBE] {
        bench.with(|rig| rig.sim.log_pin(pin));
    }
    let happened = Rc::new(RefCell::new(Happened::default()));
    let stage = happen::Stage {
        happened: Rc::clone(&happened),
        flood,
        hands: bench.hands(),
        files: [place.join("recording"), killed.clone()],
        plan: plan.clone(),
    };
    bench.in_phase(
        |phase| matches!(phase, Phase::Recording { .. }),
        SimDuration::ZERO,
        move |rig| stage.begin(rig),
    );
    let mut options = bench.options("recording");
    options.duration = Some(plan.length_us * u64::from(TICK_HZ / 1_000_000));
    // So that it sends commands all the time.
    bench.phone_link = Some(LinkRanges::PHONE_USB);
    options.track = Track::Always;
    let run = bench.run(&options);
    let periods = bench
        .commands()
        .into_iter()
        .filter_map(|sent| match sent.command {
            Command::SetPeriod(SetPeriod { period, .. }) => Some(period),
            _ => None,
        });
    let periods = periods.collect();
    let (edges, failures, phone_records) = bench.with(|rig| {
        let phone = rig.phones.first();
        let records = phone.is_some_and(|phone| phone.app.is_recording());
        (rig.sim.take_edges(), rig.sim.failures().to_vec(), records)
    });
    let truth = bench.stop()?;
    let happened = Rc::try_unwrap(happened).ok();
    Ok(Ended {
        run,
        killed,
        happened: happened
            .context("something is still to happen")?
            .into_inner(),
        truth,
        edges,
        periods,
        failures,
        phone_records,
    })
}
