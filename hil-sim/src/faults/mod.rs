//! The fault campaign: a recording, and things that go wrong while it runs.
//!
//! One run is one seed: a [`plan`] of one to four faults at random times, the
//! real firmware on the simulated board, and the host tool's own code from the
//! link to the finished recording, in one process on virtual time. So a seed
//! gives the same run to the byte, however fast the machine is
//! ([`Verdict::digest`]).
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
//!   and a next step.
//!
//! Limit: a power cut or a held bus in the middle of a transfer can damage the
//! bytes of that one sample unnoticed, because I2C has no checksum. Such a
//! sample is counted ([`Verdict::disturbed`]) and no error.

pub mod plan;
mod scene;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use protocol::{DeviceToHost, ImuFlags, Period, ResetCause, TICK_HZ, Ticks, TriggerStart};
use serde::Serialize;
use smartdepthsync::board::Board;
use smartdepthsync::cli::{Context, Global, Interrupt, LogFormat, Said};
use smartdepthsync::imu::Scale;
use smartdepthsync::live_data::FoxgloveArg;
use smartdepthsync::outcome::ExitStatus;
use smartdepthsync::profile::Profile;
use smartdepthsync::record::live::Live;
use smartdepthsync::record::operator::Operator;
use smartdepthsync::record::phone_task::PhoneTask;
use smartdepthsync::record::rig::{Parts, Rig as HostRig};
use smartdepthsync::record::watch::{Grid, Watch};
use smartdepthsync::record::{Connector as _, Options as RecordOptions, Stop, steps};
use smartdepthsync::recording::reader::{Item, Reader};
use smartdepthsync::recording::session_file::{SessionFile, Span};
use smartdepthsync::recording::writer::Writer;
use smartdepthsync::session::StreamCounts;

use crate::board_truth::Train;
use crate::random::Seed;
use crate::rig::Rig;
use crate::time::SimDuration;
use plan::{Fault, Plan};
use scene::{Delivered, Report, Stage, imu_is_well, time_of};

/// How long the session waits for a lost link: its default.
const LINK_PATIENCE: Duration = Duration::from_secs(60);
/// Width of a pulse: 12 µs.
const WIDTH: u32 = 12 * (TICK_HZ / 1_000_000);
/// The period that a phone reports for 30 frames a second, in picoseconds.
const PERIOD_PICOS: u64 = 33_330_652_540;
/// What a kill may cost, as the recording promises.
const KILL_COSTS: SimDuration = SimDuration::from_millis(1_000);
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
    /// Problems that the session told of, by kind.
    pub problems: BTreeMap<String, u32>,
    /// CRC-32 of all bytes that the host was given: two runs of a seed are alike
    /// if this is.
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

/// Runs one seed. `elf` is the firmware; without it, the default one. Files go
/// into `folder`.
///
/// # Errors
///
/// Something was not as promised.
pub fn run(seed: Seed, elf: Option<&Path>, folder: &Path) -> Result<Verdict, Finding> {
    let plan = Plan::draw(seed);
    run_plan(&plan, elf, folder)
}

/// Runs a plan, which need not be one of a seed.
///
/// # Errors
///
/// Something was not as promised.
pub fn run_plan(plan: &Plan, elf: Option<&Path>, folder: &Path) -> Result<Verdict, Finding> {
    session(plan, elf, folder)
        .and_then(|ended| judge(plan, &ended))
        .map_err(|what| Finding {
            plan: plan.clone(),
            what,
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
    let mut builder = Rig::builder();
    if let Some(elf) = elf {
        builder = builder.elf(elf);
    }
    let recording = folder.join(format!("seed-{}", plan.seed));
    let killed = folder.join(format!("seed-{}-killed", plan.seed));
    for place in [&recording, &killed] {
        if place.exists() {
            std::fs::remove_dir_all(place).map_err(|error| error.to_string())?;
        }
        std::fs::create_dir_all(place).map_err(|error| error.to_string())?;
    }
    let (from, to) = (recording.clone(), killed.clone());
    let stage = Stage::open(plan, builder, move || copy_files(&from, &to))?;
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
            Err(smartdepthsync::board::BoardError::Open(_)) => {}
            Err(error) => return Err(error.to_string()),
        }
    };
    // The ids of commands are part of what goes over the link: fixed, for a run
    // that repeats.
    let mut board = Board::connect_from(link, 1).map_err(|error| error.to_string())?;
    let imu = board.imu().map_err(|error| error.to_string())?;
    let scale = Scale::of(&imu).ok_or("the board gave no scale for its IMU")?;
    let writer = Writer::create(&recording).map_err(|error| error.to_string())?;
    let parts = Parts {
        context: &context,
        profile: &profile,
        connector: &mut connector,
        board,
        imu,
        scale,
        phone: PhoneTask::start("127.0.0.1:1".to_owned()).map_err(|error| error.to_string())?,
        operator: Operator::absent(),
        live: Live::open(&context, false),
        link_patience: LINK_PATIENCE,
        writer,
        folder: recording.clone(),
        file: SessionFile::new(format!("seed-{}", plan.seed), profile.clone()),
    };
    let mut host = HostRig::new(parts);
    let result = record(&mut host, &stage, plan);
    let options = RecordOptions {
        out: folder.to_path_buf(),
        name: None,
        duration: None,
        own_profile: true,
        link_patience: LINK_PATIENCE,
        plain: true,
        yes: true,
        markers: Vec::new(),
        second_twist: false,
        fetch_video: false,
        foxglove: FoxgloveArg::default(),
    };
    let counts = host.board.session().counts();
    let damaged_frames = host.board.session().damaged_frames();
    let result = steps::close(&mut host, &options, result);
    let (status, next_step) = match &result {
        Ok(()) if host.has_problems() => (ExitStatus::Loss, true),
        Ok(()) => (ExitStatus::Good, true),
        Err(Stop::Interrupted) => (ExitStatus::Interrupted, true),
        Err(Stop::Failed(failure)) => (failure.status(), failure.has_next_step()),
    };
    let file = host.file.clone();
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
    let up = host.now.0 + 2 * u64::from(TICK_HZ);
    host.pump_until(|host| (host.now.0 >= up).then_some(()))?;
    let Some(period) = Period::from_picos(PERIOD_PICOS) else {
        return Ok(());
    };
    host.trigger_started = true;
    let status = host.call(|board| {
        board.start_trigger(TriggerStart {
            period,
            width: WIDTH,
            first_edge: None,
        })
    })?;
    let train = Train {
        first: status.next_edge,
        period,
        width: WIDTH,
    };
    stage
        .begin(train)
        .map_err(smartdepthsync::board::BoardError::from)
        .map_err(smartdepthsync::outcome::Failure::from)?;
    host.board.start_counting();
    let from = host.now;
    host.file.recorded = Some(Span { from, to: from });
    host.watch = Some(Watch::new(
        Grid {
            anchor: train.first,
            period,
        },
        train.first,
    ));
    let end = from.0 + plan.length_us * u64::from(TICK_HZ / 1_000_000);
    let mut ask = from.0 + ASK_TICKS;
    while host.now.0 < end {
        host.pump(Duration::from_millis(20))?;
        if host.now.0 >= ask {
            ask = host.now.0 + ASK_TICKS;
            host.call(Board::trigger)?;
        }
    }
    Ok(())
}

fn judge(plan: &Plan, ended: &Ended) -> Result<Verdict, String> {
    let report = &ended.report;
    if let Some(wrong) = &report.wrong {
        return Err(wrong.clone());
    }
    judge_end(plan, ended)?;
    let losses = judge_losses(plan, ended)?;
    judge_recording(ended)?;
    if let Some(killed) = report.killed {
        let promised = killed.units().saturating_sub(KILL_COSTS.units());
        let given: Vec<&Delivered> = report
            .delivered
            .iter()
            .filter(|delivered| delivered.at.units() <= promised)
            .collect();
        contains(&ended.killed, &given, "the killed recording")?;
    }
    let compared = report.compared;
    let mut problems = BTreeMap::new();
    for problem in &ended.file.problems {
        *problems.entry(problem.kind.clone()).or_default() += 1;
    }
    Ok(Verdict {
        plan: plan.clone(),
        exit_code: ended.status.code(),
        virtual_s: report.ended.as_secs_f64(),
        pulses: compared.pulses,
        delivered: compared.reports + compared.samples + compared.captures,
        disturbed: compared.disturbed,
        pulses_lost: losses,
        samples_lost: ended.counts.imu.lost,
        captures_lost: ended.counts.captures.lost,
        damaged_frames: ended.damaged_frames,
        reconnects: ended.file.reconnects,
        runs: report.hellos.len(),
        problems,
        digest: report.digest,
    })
}

/// The session went on, or ended as it should.
fn judge_end(plan: &Plan, ended: &Ended) -> Result<(), String> {
    let report = &ended.report;
    let kinds: Vec<&str> = ended
        .file
        .problems
        .iter()
        .map(|p| p.kind.as_str())
        .collect();
    if !ended.next_step {
        return Err(format!("{:?} without a next step", ended.status));
    }
    let runs = report.hellos.len();
    let expected_runs = 1 + usize::from(plan.resets());
    if runs != expected_runs {
        return Err(format!(
            "the host saw {runs} runs of the board, not {expected_runs}; {:?}, {kinds:?}",
            ended.status
        ));
    }
    if plan.resets() {
        let cause = report.hellos.last().map(|hello| hello.reset_cause);
        let expected = plan.events.iter().find_map(|event| match event.fault {
            Fault::ResetPressed => Some(ResetCause::Pin),
            Fault::WatchdogReset => Some(ResetCause::Watchdog),
            Fault::SupplyReset => Some(ResetCause::PowerOn),
            _ => None,
        });
        if cause != expected {
            return Err(format!("reset by {cause:?}, not {expected:?}"));
        }
        // A session either goes on behind a mark, or ends and says why.
        return match ended.status {
            ExitStatus::LinkLost | ExitStatus::Loss if !kinds.is_empty() => Ok(()),
            status => Err(format!("{status:?} after a reset; {kinds:?}")),
        };
    }
    let harmless = plan
        .events
        .iter()
        .all(|e| matches!(e.fault, Fault::HostKilled | Fault::DepthCameraStopped));
    match ended.status {
        ExitStatus::Good | ExitStatus::Loss => {}
        status => return Err(format!("the session ended with {status:?}; {kinds:?}")),
    }
    if harmless && ended.status != ExitStatus::Good {
        return Err(format!("loss without a reason: {kinds:?}"));
    }
    // It was whole again by the end.
    let late = |message: &DeviceToHost| {
        report.delivered.iter().rev().find(|delivered| {
            core::mem::discriminant(&delivered.message) == core::mem::discriminant(message)
        })
    };
    let Some(status) = &report.status else {
        return Err("no status ever came".to_owned());
    };
    if !imu_is_well(status) {
        return Err(format!("the IMU did not come back: {:?}", status.imu));
    }
    let last = late(&DeviceToHost::Status(status.clone()));
    let quiet = SimDuration::from_millis(1_500);
    if last.is_none_or(|last| report.ended.since(last.at) > quiet) {
        return Err("the link did not come back".to_owned());
    }
    Ok(())
}

/// What the host says is missing is what is missing. Gives the pulses.
fn judge_losses(plan: &Plan, ended: &Ended) -> Result<u64, String> {
    let report = &ended.report;
    let told = ended.counts.pulses;
    let first_epoch = report.hellos.first().map_or(0, |hello| hello.epoch);
    let of_run = |pick: fn(&DeviceToHost) -> Option<u32>| -> Vec<u32> {
        report
            .delivered
            .iter()
            .filter(|delivered| delivered.epoch == first_epoch)
            .filter_map(|delivered| pick(&delivered.message))
            .collect()
    };
    let pulses = of_run(|message| match message {
        DeviceToHost::Pulse(pulse) => Some(pulse.seq),
        _ => None,
    });
    // By the pin: numbers from the first to the last that were told, less those
    // that were.
    let missing = report.pulses_between.saturating_sub(pulses.len() as u64);
    if missing != told.lost {
        return Err(format!(
            "{missing} pulses are missing, the host says {}",
            told.lost
        ));
    }
    for (name, seqs, told) in [
        (
            "samples",
            of_run(|message| match message {
                DeviceToHost::Imu(sample) => Some(sample.seq),
                _ => None,
            }),
            ended.counts.imu,
        ),
        (
            "captures",
            of_run(|message| match message {
                DeviceToHost::Capture(capture) => Some(capture.seq),
                _ => None,
            }),
            ended.counts.captures,
        ),
    ] {
        let span = match (seqs.first(), seqs.last()) {
            (Some(first), Some(last)) => u64::from(last.wrapping_sub(*first)) + 1,
            _ => 0,
        };
        let missing = span.saturating_sub(seqs.len() as u64);
        // Those of a run after a reset count too.
        if missing != told.lost && !plan.resets() {
            return Err(format!(
                "{missing} {name} are missing, the host says {}",
                told.lost
            ));
        }
    }
    // Without a fault of the IMU, an edge of data-ready without a sample is a
    // sample that was lost on the link.
    let imu_fault = plan.events.iter().any(|event| event.fault.hits_imu());
    let marked = report
        .delivered
        .iter()
        .any(|delivered| match &delivered.message {
            DeviceToHost::Imu(sample) => sample.flags.has(ImuFlags::FIRST),
            _ => false,
        });
    if imu_fault
        && !plan.resets()
        && !marked
        && ended.counts.imu.lost == 0
        && report.compared.samples_missing > 50
    {
        return Err(format!(
            "{} samples are missing without a mark",
            report.compared.samples_missing
        ));
    }
    Ok(missing)
}

/// The finished recording holds what the host was given.
fn judge_recording(ended: &Ended) -> Result<(), String> {
    let first = ended.report.hellos.first().map_or(0, |hello| hello.epoch);
    let one_run = ended.report.hellos.len() <= 1 || ended.status != ExitStatus::Loss;
    let given: Vec<&Delivered> = ended
        .report
        .delivered
        .iter()
        .filter(|delivered| !one_run || delivered.epoch == first)
        .collect();
    contains(&ended.folder, &given, "the recording")
}

/// Each pulse and sample is in the file as often as it was given.
fn contains(folder: &Path, given: &[&Delivered], what: &str) -> Result<(), String> {
    let mut pulses: BTreeMap<Ticks, i64> = BTreeMap::new();
    let mut samples: BTreeMap<Ticks, i64> = BTreeMap::new();
    for delivered in given {
        let Some(at) = time_of(&delivered.message) else {
            continue;
        };
        match &delivered.message {
            DeviceToHost::Pulse(_) => *pulses.entry(at).or_default() += 1,
            DeviceToHost::Imu(_) => *samples.entry(at).or_default() += 1,
            _ => {}
        }
    }
    let reader = Reader::open(folder).map_err(|error| format!("{what}: {error}"))?;
    for entry in reader {
        let entry = entry.map_err(|error| format!("{what}: {error}"))?;
        let count = match &entry.item {
            Item::Pulse(_) => pulses.get_mut(&entry.at),
            Item::Imu(_) => samples.get_mut(&entry.at),
            _ => None,
        };
        if let Some(count) = count {
            *count -= 1;
        }
    }
    for (name, left) in [("pulses", &pulses), ("samples", &samples)] {
        let missing = left.values().filter(|&&count| count > 0).count();
        let twice = left.values().filter(|&&count| count < 0).count();
        if missing + twice > 0 {
            let first = left.iter().find(|(_, count)| **count != 0);
            return Err(format!(
                "{what} lacks {missing} {name} and has {twice} twice, first {first:?}"
            ));
        }
    }
    Ok(())
}
