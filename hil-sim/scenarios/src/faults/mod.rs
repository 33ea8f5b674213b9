//! The fault campaign: a recording, and things that go wrong while it runs.
//!
//! One run is one seed: a [`plan`] of one to four faults at random times, the
//! real firmware on the simulated board, and the host tool's own code from the
//! link to the finished recording, in one process on virtual time. So a seed
//! gives the same run to the byte, however fast the machine is
//! ([`Verdict::digest`]). Faults that need the phone or the real process have runs of
//! another kind (`process.rs`).
//!
//! Judged, against what really happened:
//!
//! - every edge of the trigger, told or not, against the arithmetic of its train;
//! - every pulse, sample and capture that the host was given, against the pin or
//!   the sensor's registers ([`crate::board_truth`]);
//! - what the host says is missing, against what is missing;
//! - the recording: it opens, it holds every pulse and sample that the host was
//!   given once, and nothing else; killed, all but the last second;
//! - board time goes on, or the board says that it was reset and why;
//! - the session goes on afterwards, with loss told, or ends with the exit code
//!   and a next step; after a reset of the board, its train is on its grid again
//!   and the new run is put where it was, as well as the mark says.
//!
//! Limit: a power cut or a held bus in the middle of a transfer can damage the
//! bytes of that one sample unnoticed, because I2C has no checksum. Such a
//! sample is counted ([`Verdict::disturbed`]) and no error.

mod happenings;
mod judge;
pub mod plan;
pub(crate) mod process;
mod scene;
mod stage;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, SystemTime};

use board::Board;
use board::StreamCounts;
use board::imu::Scale;
use phone::task::PhoneTask;
use protocol::{Output, TICK_HZ};
use recording::profile::Profile;
use recording::session_file::{SessionFile, Span};
use recording::writer::Writer;
use serde::Serialize;
use session::watch::{Grid, Watch};
use smartdepthsync::context::{Context, Global, Interrupt, LogFormat, Said};
use smartdepthsync::outcome::ExitStatus;
use smartdepthsync::record::journal::Journal;
use smartdepthsync::record::link::BoardLink;
use smartdepthsync::record::live::Live;
use smartdepthsync::record::operator::Operator;
use smartdepthsync::record::phones::Phones;
use smartdepthsync::record::rig::Rig as HostRig;
use smartdepthsync::record::track::Track;
use smartdepthsync::record::{Connector as _, Options as RecordOptions, Stop, close};
use smartdepthsync::rig_profile::{Place, Source};

use crate::board_truth::{TRAIN, Train};
use crate::programs::Programs;
use crate::workers;
use plan::Plan;
use rig::random::Seed;
use rig::wiring::{self, BoardKind};
use scene::Report;
use stage::Stage;

/// How long the session waits for a lost link: its default.
const LINK_PATIENCE: Duration = Duration::from_secs(60);
/// The host's time of day, which stands still but for being set: s since 1970.
const TIME_OF_DAY: u64 = 1_800_000_000;
/// How often the host asks for the state of the train while recording.
const ASK_TICKS: u64 = TICK_HZ as u64;

/// How a run went that passed.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// What went wrong in it.
    pub plan: Plan,
    /// Exit code of the session.
    pub exit_code: u8,
    /// Virtual seconds.
    pub virtual_s: f64,
    /// Pulses at the pin, each exact.
    pub pulses: u64,
    /// Pulses, samples and captures that the host was given, each right.
    pub delivered: u64,
    /// Samples whose transfer a fault hit.
    pub disturbed: u64,
    /// Pulses that the host was not told of, and says so.
    pub pulses_lost: u64,
    /// Samples likewise.
    pub samples_lost: u64,
    /// Edges of the strobe likewise.
    pub captures_lost: u64,
    /// Frames damaged on the way, and told as damaged.
    pub damaged_frames: u32,
    /// How often the link was taken up again.
    pub reconnects: u32,
    /// Runs of the board.
    pub runs: usize,
    /// How far the session put a later run of the board off its true place, µs.
    pub joint_error_us: Option<f64>,
    /// What it said that might be, 1-sigma in µs.
    pub joint_sigma_us: Option<f64>,
    /// Problems that the session told of, by kind.
    pub problems: BTreeMap<String, u32>,
    /// CRC-32 of all bytes that the host was given: two runs of a seed are alike
    /// if this is. 0 of a run with the real program, which is not the same to the
    /// byte.
    pub digest: u32,
}

/// A run that did not pass.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{plan}\n  {what}")]
pub struct Finding {
    /// What went wrong in it.
    pub plan: Plan,
    /// What should not be.
    pub what: String,
}

/// Runs one seed. Files go into `folder`.
///
/// # Errors
///
/// Something was not as promised.
pub fn run(seed: Seed, programs: &Programs, folder: &Path) -> Result<Verdict, Finding> {
    let plan = Plan::draw(seed);
    run_plan(&plan, programs, folder)
}

/// Runs a plan, which need not be one of a seed.
///
/// # Errors
///
/// Something was not as promised.
pub fn run_plan(plan: &Plan, programs: &Programs, folder: &Path) -> Result<Verdict, Finding> {
    let result = if process::is_needed(plan) {
        process::run(plan, programs, folder)
    } else {
        session(plan, programs.elf.as_deref(), folder).and_then(|ended| judge::judge(plan, &ended))
    };
    result.map_err(|what| Finding {
        plan: plan.clone(),
        what,
    })
}

/// Runs seeds, as many at a time as the machine has processors, each told when it is
/// done; gives their results in order.
pub fn campaign(
    seeds: &[u64],
    programs: &Programs,
    folder: &Path,
    done: &(dyn Fn(u64, &Result<Verdict, Finding>) + Sync),
) -> Vec<Result<Verdict, Finding>> {
    let jobs = std::thread::available_parallelism().map_or(1, usize::from);
    workers::each(seeds, jobs, |&seed| {
        let result = run(Seed(seed), programs, folder);
        done(seed, &result);
        result
    })
}

/// A session that has ended.
struct Ended {
    folder: PathBuf,
    killed: PathBuf,
    status: ExitStatus,
    next_step: bool,
    file: SessionFile,
    counts: StreamCounts,
    damaged_frames: u32,
    report: Report,
}

fn session(plan: &Plan, elf: Option<&Path>, folder: &Path) -> Result<Ended, String> {
    let builder = wiring::board_of(BoardKind::default(), elf);
    let recording = folder.join(format!("seed-{}", plan.seed));
    let killed = folder.join(format!("seed-{}-killed", plan.seed));
    for place in [&recording, &killed] {
        if place.exists() {
            std::fs::remove_dir_all(place).map_err(|error| error.to_string())?;
        }
        std::fs::create_dir_all(place).map_err(|error| error.to_string())?;
    }
    let (from, to) = (recording.clone(), killed.clone());
    let clock_step = Arc::new(AtomicI64::new(0));
    let step = Arc::clone(&clock_step);
    let stage = Stage::open(plan, builder, step, move || copy_files(&from, &to))?;
    let mut connector = stage.clone();

    let profile = Profile::published().map_err(|error| error.to_string())?;
    let context = Context {
        global: Global {
            json: true,
            verbose: 0,
            log_format: LogFormat::Text,
        },
        interrupt: Interrupt::default(),
        said: Said::default(),
    };
    let link = loop {
        match connector.connect(None) {
            Ok(link) => break link,
            Err(board::BoardError::Open(_)) => {}
            Err(error) => return Err(error.to_string()),
        }
    };
    // The ids of commands are part of what goes over the link: fixed, for a run
    // that repeats.
    let mut board = Board::connect_from(link, 1).map_err(|error| error.to_string())?;
    let imu = board.imu().map_err(|error| error.to_string())?;
    let scale = Scale::of(&imu).ok_or("the board gave no scale for its IMU")?;
    let mut writer = Writer::create(&recording).map_err(|error| error.to_string())?;
    writer.set_wall_clock(Box::new(move || {
        let seconds = TIME_OF_DAY.saturating_add_signed(clock_step.load(Ordering::Relaxed));
        SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)
    }));
    let link = BoardLink::new(board, scale, &mut connector, LINK_PATIENCE);
    let phone = PhoneTask::start("127.0.0.1:1".to_owned()).map_err(|error| error.to_string())?;
    let phones = Phones::new(&profile, vec![phone]);
    let file = SessionFile::new(format!("seed-{}", plan.seed), profile.clone());
    let live = Live::open(&context, false);
    let journal = Journal::new(&context, live, writer, recording.clone(), file);
    let operator = Operator::absent();
    let mut host = HostRig::new(&context, &profile, link, phones, operator, journal);
    let result = record(&mut host, &stage, plan);
    let options = RecordOptions {
        out: folder.to_path_buf(),
        name: None,
        duration: None,
        profile: Place {
            path: None,
            source: Source::Published,
        },
        link_patience: LINK_PATIENCE,
        track: Track::Never,
        plain: true,
        yes: true,
        markers: Vec::new(),
        twists: 1,
        twist_gap: 0,
        second_twist: false,
        fetch_video: false,
    };
    let result = close::close(&mut host, &options, result);
    let counts = host.link.board.conversation().counts();
    let damaged_frames = host.link.board.conversation().damaged_frames();
    let (status, next_step) = match &result {
        Ok(()) if host.journal.has_problems() => (ExitStatus::Loss, true),
        Ok(()) => (ExitStatus::Good, true),
        Err(Stop::Interrupted) => (ExitStatus::Interrupted, true),
        Err(Stop::Failed(failure)) => (failure.status(), failure.has_next_step()),
    };
    let file = host.journal.file.clone();
    drop(host);
    let report = stage.end().map_err(|error| error.to_string())?;
    Ok(Ended {
        folder: recording,
        killed,
        status,
        next_step,
        file,
        counts,
        damaged_frames,
        report,
    })
}

/// What a kill would leave: the files as the system has them.
fn copy_files(from: &Path, to: &Path) {
    let Ok(files) = std::fs::read_dir(from) else {
        return;
    };
    for file in files.flatten() {
        // A file that is missing in the copy is found when it is judged.
        let _ = std::fs::copy(file.path(), to.join(file.file_name()));
    }
}

/// Starts the train and records, as a session does between its twists.
fn record(host: &mut HostRig<'_>, stage: &Stage, plan: &Plan) -> Result<(), Stop> {
    // The IMU is up.
    let up = host.now().0 + 2 * u64::from(TICK_HZ);
    host.pump_until(|host| (host.now().0 >= up).then_some(()))?;
    host.trigger_started = true;
    let status = host.call(|board| board.start_trigger(Output::Camera, TRAIN))?;
    let train = Train::of(&TRAIN, status.next_edge);
    stage
        .begin(train)
        .map_err(board::BoardError::from)
        .map_err(smartdepthsync::outcome::Failure::from)?;
    host.link.board.start_counting();
    let from = host.now();
    host.journal.file.recorded = Some(Span { from, to: from });
    host.observers.watch = Some(Watch::new(
        Grid {
            anchor: train.first,
            fraction: 0,
            period: train.period,
        },
        train.first,
    ));
    let end = from.0 + plan.length_us * u64::from(TICK_HZ / 1_000_000);
    let mut ask = from.0 + ASK_TICKS;
    while host.now().0 < end {
        host.pump(Duration::from_millis(20))?;
        if host.now().0 >= ask {
            ask = host.now().0 + ASK_TICKS;
            host.call(Board::trigger)?;
        }
    }
    Ok(())
}
