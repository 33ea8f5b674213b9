//! Runs with the real program: `smartdepthsync record` as a process of its own, on
//! the running rig with its phone, for the faults that need one of these.
//!
//! Such a run has its faults at the same board times each time it is made; when the
//! processes get to run is the machine's, so it is not the same to the byte.
//!
//! Judged: the exit code and the words; the files, which `verify` must not find
//! damaged; every sample in them against the sensor's registers and its edge, to the
//! tick; every pulse against the grid; a killed or broken-off recording lacks at
//! most its last second; the phone is left as it should be.

use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Command, ExitStatus as ProcessStatus, Stdio};
use std::time::{Duration, Instant};

use board::imu::Scale;
use protocol::{ImuFlags, ImuSample, TICK_HZ, Ticks};
use recording::MCAP_FILE;
use recording::reader::{Item, Reader};
use recording::session_file::SessionFile;
use report::verify::{Verdict as Checked, verify};
use rustix::process::{Resource, Rlimit, Signal, prlimit};
use smartdepthsync::outcome::ExitStatus;

use super::Verdict;
use super::plan::{Event, Fault, Plan};
use crate::board_truth::captured;
use crate::programs::Programs;
use crate::session::Session;
use rig::imu::SampleRecord;
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::{LinkFault, PhoneConfig, SimPhone};
use rig::random::Seed;
use rig::rig_config::RigConfig;
use rig::running_rig::{Pace, RunTruth, RunningRig};
use rig::wiring::{self, UNITS_PER_TICK};
use stm32f4_sim::time::{SimDuration, SimTime};

/// The longest that anything is waited for, in real time.
const PATIENCE: Duration = Duration::from_secs(180);
/// What a kill or a full disk may cost, s.
const COSTS_S: f64 = 1.0;
/// Board time before them that passes as fast as real time: in what a sample needs from the
/// board to the file, more of a faster board's would pass. A chunk of the file is shorter.
const LAST: SimDuration = SimDuration::from_millis(600);
/// How many of a mark's sigmas a later run may be off its place, as in [`super::judge`].
const SIGMAS: f64 = 5.0;
/// How often a session is begun: its patience with the phone is real time, which a
/// busy machine may not have.
const TRIES: usize = 3;
/// What it says when it records.
const RECORDS: &str = "recording for";

/// What was done and seen.
struct Seen {
    status: ProcessStatus,
    said: String,
    /// When it was killed.
    killed: Option<SimTime>,
    /// When the disk was full.
    full: Option<SimTime>,
    /// When the phone was last not to be reached.
    phone_away: Option<SimTime>,
    /// It still recorded when the session had ended.
    phone_records: bool,
}

/// Runs a plan.
pub(super) fn run(plan: &Plan, programs: &Programs, folder: &Path) -> Result<Verdict, String> {
    let place = folder.join(format!("seed-{}", plan.seed));
    if place.exists() {
        std::fs::remove_dir_all(&place).map_err(|error| error.to_string())?;
    }
    std::fs::create_dir_all(&place).map_err(|error| error.to_string())?;
    let rig = start_rig(plan.seed, programs, &place)?;
    let profile = rig.profile().map_err(|error| format!("{error:#}"))?;
    let mut last = None;
    for attempt in 0..TRIES {
        let name = format!("try-{attempt}");
        let record = Record {
            port: rig.port(),
            profile: &profile,
            seconds: plan.length_us.div_ceil(1_000_000),
            place: &place,
            name: &name,
        };
        let mut session = Session::start(&mut record.command(programs)?)?;
        if !records(&mut session)? {
            last = Some(session.said());
            drop(session);
            stop_phone(phone(&rig)?);
            continue;
        }
        let recording = place.join(&name);
        let seen = happen(&rig, plan, session, &recording)?;
        stop_phone(phone(&rig)?);
        let truth = rig.stop().map_err(|error| format!("{error:#}"))?;
        return judge(plan, &seen, &recording, &truth);
    }
    Err(format!(
        "no session came to record: {}",
        last.unwrap_or_default()
    ))
}

/// A rig whose operator twists it all the time, with a small and quick phone.
pub(crate) fn start_rig(
    seed: u64,
    programs: &Programs,
    place: &Path,
) -> Result<RunningRig, String> {
    let seed = Seed(seed);
    let config = RigConfig::published(seed).with_motion(MotionSpec::always(Gesture::Twist));
    let mut phone = PhoneConfig::draw(seed);
    // Small and quick: videos are not what is judged here.
    phone.camera.rows = 120;
    phone.camera.columns = 16;
    phone.camera.first_frame_ms = (20.0, 50.0);
    phone.storage = Some(place.join("phone"));
    let board = wiring::board_of(config.board, programs.elf.as_deref()).tolerate_failures();
    let pace = Pace {
        wait_for_host: false,
        ..programs.pace()
    };
    RunningRig::start(config, board, Some((phone, 0)), pace).map_err(|error| format!("{error:#}"))
}

fn phone(rig: &RunningRig) -> Result<&SimPhone, String> {
    rig.phone().ok_or_else(|| "the rig has no phone".to_owned())
}

/// Its owner stops what a session left.
pub(crate) fn stop_phone(phone: &SimPhone) {
    if phone.is_recording() {
        phone.press_record();
    }
}

/// A recording that is to be made.
pub(crate) struct Record<'a> {
    pub(crate) port: &'a Path,
    /// The owner's profile; the twist is made shorter, and the way to the grid faster.
    pub(crate) profile: &'a str,
    pub(crate) seconds: u64,
    /// Where it and its profile go.
    pub(crate) place: &'a Path,
    pub(crate) name: &'a str,
}

impl Record<'_> {
    pub(crate) fn command(&self, programs: &Programs) -> Result<Command, String> {
        let profile = self.profile.replace("[phone]\n", "[phone]\ntwist_s = 6\n");
        let file = self.place.join("rig.toml");
        std::fs::write(&file, profile + "\n[align]\nslew_us = 1000\n")
            .map_err(|error| error.to_string())?;
        let record = programs.record(self.port, &file, self.place, self.name);
        // Whoever runs this may have switched the signal off that a full disk is here.
        let mut command = Command::new("env");
        command
            .stdin(Stdio::null())
            .arg("--default-signal=XFSZ")
            .arg(record.get_program())
            .args(record.get_args())
            .args(["--duration", &format!("{}s", self.seconds)]);
        Ok(command)
    }
}

/// Waits until it records; false if it ends before.
fn records(session: &mut Session) -> Result<bool, String> {
    let begun = Instant::now();
    while !session.said().contains(RECORDS) {
        if session.ended()?.is_some() {
            return Ok(false);
        }
        if begun.elapsed() > PATIENCE {
            return Err(format!("it never records: {}", session.said()));
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Ok(true)
}

/// Lets happen what is planned, until the session ends.
fn happen(
    rig: &RunningRig,
    plan: &Plan,
    mut session: Session,
    recording: &Path,
) -> Result<Seen, String> {
    let zero = rig.now();
    let mut turns: Vec<(SimTime, Event, bool)> = Vec::new();
    for event in &plan.events {
        turns.push((event.begins(zero), *event, true));
        if event.for_us > 0 {
            turns.push((event.ends(zero), *event, false));
        }
    }
    turns.sort_by_key(|turn| std::cmp::Reverse(turn.0));
    let costs = |fault| matches!(fault, Fault::ProcessKilled | Fault::DiskFull);
    let mut end = turns
        .iter()
        .rfind(|turn| costs(turn.1.fault))
        .map(|turn| turn.0);
    let (mut killed, mut full, mut away) = (None, None, 0_u32);
    let mut last_away = None;
    let begun = Instant::now();
    let status = loop {
        if let Some(status) = session.ended()? {
            break status;
        }
        if begun.elapsed() > PATIENCE || !rig.is_running() {
            return Err(format!("it does not end: {}", session.said()));
        }
        let now = rig.now();
        if end.take_if(|end| now + LAST >= *end).is_some() {
            rig.set_speed(1.0);
        }
        if away > 0 {
            last_away = Some(now);
        }
        let Some((_, event, begins)) = turns.pop_if(|turn| turn.0 <= now) else {
            std::thread::sleep(Duration::from_millis(1));
            continue;
        };
        let phone = phone(rig)?;
        match event.fault {
            Fault::PhoneGone if begins => {
                away += 1;
                phone.leave_network();
            }
            Fault::PhoneGone => {
                away -= 1;
                phone.join_network().map_err(|error| error.to_string())?;
            }
            Fault::WifiStalled => {
                away = if begins { away + 1 } else { away - 1 };
                phone.set_fault(begins.then_some(LinkFault::Silent));
            }
            Fault::DiskFull => {
                full = Some(now);
                fill_disk(&session, recording)?;
            }
            Fault::ProcessKilled => {
                killed = Some(now);
                session.signal(Signal::KILL)?;
            }
            Fault::UsbUnplugged if begins => rig.unplug(),
            Fault::UsbUnplugged => rig.plug(),
            Fault::ResetPressed => rig.press_reset(),
            other => return Err(format!("{other:?} is no fault of this kind of run")),
        }
    };
    let said = session.all_said();
    let phone = phone(rig)?;
    let seen = Seen {
        status,
        said,
        killed,
        full,
        phone_away: last_away,
        phone_records: phone.is_recording(),
    };
    phone.set_fault(None);
    if away > 0 {
        phone.join_network().map_err(|error| error.to_string())?;
    }
    Ok(seen)
}

/// From now on no file of the process may grow beyond what the recording is.
fn fill_disk(session: &Session, recording: &Path) -> Result<(), String> {
    let size = std::fs::metadata(recording.join(MCAP_FILE)).map_err(|error| error.to_string())?;
    let limit = Rlimit {
        current: Some(size.len()),
        maximum: Some(size.len()),
    };
    prlimit(Some(session.pid()?), Resource::Fsize, limit)
        .map(drop)
        .map_err(|error| error.to_string())
}

fn judge(plan: &Plan, seen: &Seen, recording: &Path, truth: &RunTruth) -> Result<Verdict, String> {
    let said = |what: String| format!("{what}; it said: {}", seen.said.trim());
    let file = SessionFile::load(recording).map_err(|error| error.to_string())?;
    let kinds: Vec<&str> = file.problems.iter().map(|p| p.kind.as_str()).collect();
    let disturbed = plan.has(Fault::UsbUnplugged) || plan.has(Fault::ResetPressed);
    // Only a phone that was away while it was to be stopped may be given up, and only
    // that may be left recording.
    let missed = kinds.contains(&"phone_lost");
    let zero = truth.zero.ok_or("the board's zero is not known")?;
    // A later run of the board is where the mark says, within its sigmas.
    let unsure_us = file
        .runs
        .last()
        .map_or(0.0, |run| SIGMAS * run.shift_sigma_us);
    let unsure = (unsure_us * f64::from(TICK_HZ / 1_000_000)) as u64;
    let recorded_to = file.recorded.map_or(Ticks(0), |span| span.to);
    let to_be_stopped = Ticks(recorded_to.0.saturating_sub(unsure));
    if missed
        && seen
            .phone_away
            .is_none_or(|last| ticks_at(zero, last) < to_be_stopped)
    {
        return Err(said(format!(
            "the phone was there and is missed: {kinds:?}"
        )));
    }
    if seen.phone_records && seen.killed.is_none() && !missed {
        return Err(said("the phone was left recording".to_owned()));
    }
    let expected = match (seen.killed, seen.full) {
        (Some(_), _) => None,
        (None, Some(_)) => Some(ExitStatus::Storage),
        (None, None) if disturbed || missed => Some(ExitStatus::Loss),
        (None, None) => Some(ExitStatus::Good),
    };
    let code = expected.map(|status| i32::from(status.code()));
    if seen.status.code() != code || (code.is_none() && seen.status.signal() != Some(9)) {
        return Err(said(format!(
            "it ended with {}, expected {expected:?}; {kinds:?}",
            seen.status
        )));
    }
    if expected == Some(ExitStatus::Storage) && !seen.said.contains("File too large") {
        return Err(said("it does not say that the disk is full".to_owned()));
    }
    let resets = usize::from(plan.has(Fault::ResetPressed));
    let ended_early = seen.killed.or(seen.full);
    if ended_early.is_none() && file.runs.len() != resets {
        return Err(said(format!(
            "{} resets in the session file",
            file.runs.len()
        )));
    }
    let checked = verify(recording, &|| false).map_err(|error| error.to_string())?;
    if checked.verdict == Checked::Damaged {
        return Err(format!("verify says: {:?}", checked.findings));
    }
    let compared = compare(recording, &file, truth)?;
    if let Some(at) = ended_early {
        // While the link or the board is away, nothing comes to be lost.
        let end = at.since(zero).as_secs_f64();
        let missing = end - compared.last_s;
        if missing > COSTS_S && !disturbed {
            return Err(said(format!("{missing:.3} s are missing at the end")));
        }
    }
    let lost = |name: &str| checked.streams.get(name).map_or(0, |stream| stream.missing);
    let mut problems = std::collections::BTreeMap::new();
    for kind in kinds {
        *problems.entry(kind.to_owned()).or_default() += 1;
    }
    Ok(Verdict {
        plan: plan.clone(),
        exit_code: expected.map_or(137, ExitStatus::code),
        virtual_s: truth.end.as_secs_f64(),
        pulses: checked.grid.map_or(0, |grid| grid.checked),
        delivered: compared.samples,
        disturbed: 0,
        pulses_lost: lost("pulses"),
        samples_lost: lost("imu"),
        captures_lost: lost("captures"),
        damaged_frames: u32::try_from(checked.damaged_frames).unwrap_or(u32::MAX),
        reconnects: file.reconnects,
        runs: 1 + file.runs.len(),
        joint_error_us: None,
        joint_sigma_us: file.runs.last().map(|run| run.shift_sigma_us),
        problems,
        digest: 0,
    })
}

/// The board's tick count at a time, if it was zero at `zero`.
fn ticks_at(zero: SimTime, at: SimTime) -> Ticks {
    Ticks(at.units().saturating_sub(zero.units()) / UNITS_PER_TICK)
}

struct Compared {
    samples: u64,
    last_s: f64,
}

/// Every sample of the first run is that of the sensor's registers, at its edge.
fn compare(recording: &Path, file: &SessionFile, truth: &RunTruth) -> Result<Compared, String> {
    let zero = truth.zero.ok_or("the board's zero is not known")?;
    let scale: Scale = file
        .imu
        .as_ref()
        .ok_or("no scale in the session file")?
        .scale;
    let tick = |record: &SampleRecord| Ticks(captured(record.at, zero.units()));
    let mut records = truth.imu.iter().filter(|record| record.edge).peekable();
    let mut compared = Compared {
        samples: 0,
        last_s: 0.0,
    };
    for entry in Reader::open(recording).map_err(|error| error.to_string())? {
        let entry = entry.map_err(|error| error.to_string())?;
        match entry.item {
            // Later runs are placed by the host's clock, which is slower here.
            Item::Run(_) => break,
            Item::Imu(imu) => {
                while records.next_if(|record| tick(record) < entry.at).is_some() {}
                let Some(record) = records.next().filter(|record| tick(record) == entry.at) else {
                    return Err(format!("a sample at {:?} without an edge", entry.at));
                };
                let expected = scale.apply(&ImuSample {
                    seq: 0,
                    at: entry.at,
                    flags: ImuFlags::default(),
                    accel: record.values.accel,
                    temperature: record.values.temperature,
                    gyro: record.values.gyro,
                });
                let found = imu.angular_velocity;
                if found != expected.gyro {
                    return Err(format!(
                        "the sample at {:?} is {found:?}, in the registers {:?}",
                        entry.at, expected.gyro
                    ));
                }
                compared.samples += 1;
                compared.last_s = entry.at.as_secs_f64();
            }
            _ => {}
        }
    }
    Ok(compared)
}

/// Whether a run of this plan needs the program as a process.
pub(super) fn is_needed(plan: &Plan) -> bool {
    plan.events.iter().any(|event| event.fault.needs_process())
}
