//! `smartdepthsync doctor`: is everything there for a recording, and if not,
//! what to do.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use protocol::{
    DeviceToHost, ImuClock, ImuState, Period, TICK_HZ, TrainState, TriggerStart, TriggerStatus,
};
use serde::Serialize;

use super::PortArg;
use crate::board::{Board, BoardError};
use crate::cli::Context;
use crate::imu::{Scale, Summary};
use crate::outcome::{ExitStatus, Failure, Outcome, Report as ErrorReport};
use crate::phone::{PhoneClient, Settings};
use crate::profile::Profile;
use crate::record::rig::free_space;
use crate::session::Event;

/// How long the IMU is looked at, ticks.
const IMU_TIME: u64 = 2 * TICK_HZ as u64;

/// How long the trigger is tried, ticks.
const TRIGGER_TIME: u64 = TICK_HZ as u64 / 2;

/// Nothing at all comes for so long: the link is dead.
const LINK_PATIENCE: Duration = Duration::from_secs(20);

/// More noise than this at rest is no rest, or a bad sensor: rad/s. The data
/// sheet gives 0.06 °/s rms = 0.001 rad/s at 100 Hz.
const GYRO_NOISE_LIMIT: f64 = 0.01;

/// Free space below which a recording may not fit, bytes.
const DISK_LOW: u64 = 2_000_000_000;

/// A learnt skew or a measured bias older than this should be measured again, days.
const OLD_DAYS: i32 = 90;

/// Options of `doctor`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// The rig profile; without it, the published rig's
    #[arg(long, value_name = "FILE")]
    profile: Option<PathBuf>,
    /// The phone's address, instead of the profile's
    #[arg(long, value_name = "HOST[:PORT]")]
    phone: Option<String>,
    /// Folder for recordings
    #[arg(long, value_name = "FOLDER", default_value = "recordings")]
    out: PathBuf,
    /// Do not try the trigger (no pulses on the wire)
    #[arg(long)]
    no_trigger: bool,
    /// Do not look for the phone
    #[arg(long)]
    no_phone: bool,
}

/// How a check ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Verdict {
    Good,
    /// It works, but less well than it could.
    Warning,
    /// A recording will not work.
    Bad,
}

/// One check.
#[derive(Debug, Serialize)]
struct Check {
    name: &'static str,
    verdict: Verdict,
    found: String,
    next_step: Option<String>,
}

#[derive(Debug, Default, Serialize)]
struct Checks {
    checks: Vec<Check>,
}

impl Checks {
    fn good(&mut self, name: &'static str, found: impl Into<String>) {
        self.add(name, Verdict::Good, found.into(), None);
    }

    fn warn(&mut self, name: &'static str, found: impl Into<String>, next: &str) {
        self.add(name, Verdict::Warning, found.into(), Some(next.to_owned()));
    }

    fn bad(&mut self, name: &'static str, failure: Failure) {
        let report = ErrorReport::of(&failure.into());
        self.add(name, Verdict::Bad, report.message, report.next_step);
    }

    fn add(&mut self, name: &'static str, verdict: Verdict, found: String, next: Option<String>) {
        self.checks.push(Check {
            name,
            verdict,
            found,
            next_step: next,
        });
    }
}

/// Checks the rig.
///
/// # Errors
///
/// None but those of printing; what is wrong is in the result.
pub fn run(args: &Args, context: &Context) -> anyhow::Result<Outcome> {
    let mut checks = Checks::default();
    let mut status = ExitStatus::Good;
    let mut profile = check_profile(args, &mut checks, &mut status);
    if let (Some(profile), Some(phone)) = (&mut profile, &args.phone) {
        profile.phone.address.clone_from(phone);
    }
    check_disk(&args.out, &mut checks);
    check_ffmpeg(&mut checks);
    if let Some(profile) = &profile {
        check_recorder(profile, &mut checks, &mut status);
    }
    match args.port.open() {
        Ok(mut board) => {
            check_firmware(&board, &mut checks);
            let looked = check_imu(&mut board, &mut checks, context)
                .and_then(|()| check_trigger(args, &mut board, &mut checks, context));
            if let Err(error) = looked {
                note(&mut checks, &mut status, "board", error.into());
            }
        }
        Err(failure) => note(&mut checks, &mut status, "board", failure),
    }
    if let Some(profile) = profile.filter(|_| !args.no_phone) {
        check_phone(&profile, &mut checks, &mut status, context);
    }
    if checks
        .checks
        .iter()
        .any(|check| check.verdict == Verdict::Bad)
        && status == ExitStatus::Good
    {
        status = ExitStatus::Error;
    }
    context.print(&checks, || text(&checks))?;
    if context.interrupt.requested() {
        return Ok(Outcome::Interrupted);
    }
    Ok(match status {
        ExitStatus::Good => Outcome::Good,
        status => Outcome::Told(status),
    })
}

fn note(checks: &mut Checks, status: &mut ExitStatus, name: &'static str, failure: Failure) {
    if *status == ExitStatus::Good {
        *status = failure.status();
    }
    checks.bad(name, failure);
}

fn check_profile(args: &Args, checks: &mut Checks, status: &mut ExitStatus) -> Option<Profile> {
    let profile = match &args.profile {
        Some(path) => Profile::load(path),
        None => Profile::published(),
    };
    let profile = match profile {
        Ok(profile) => profile,
        Err(error) => {
            note(checks, status, "profile", error.into());
            return None;
        }
    };
    let today = jiff::Zoned::now().date();
    let age = |date: jiff::civil::Date| today.since(date).map_or(0, |span| span.get_days());
    if args.profile.is_none() {
        checks.warn(
            "profile",
            "none given: the published rig's",
            "`smartdepthsync profile init rig.toml`, and give it with --profile",
        );
    } else {
        checks.good("profile", profile.name.clone());
    }
    match &profile.phone.learnt {
        None => checks.warn(
            "learnt clocks",
            "nothing: the phase may drift by tens of µs a minute",
            "record with --second-twist, then `smartdepthsync profile learn`",
        ),
        Some(learnt) if age(learnt.learnt) > OLD_DAYS => checks.warn(
            "learnt clocks",
            format!("from {}", learnt.learnt),
            "crystals age: learn again",
        ),
        Some(learnt) => checks.good(
            "learnt clocks",
            format!(
                "frame period {:.3} ns, skew {}, from {}",
                learnt.frame_period_ns,
                learnt
                    .skew
                    .map_or(String::from("not learnt"), |skew| format!(
                        "{:+.3} ppm",
                        skew * 1e6
                    )),
                learnt.learnt
            ),
        ),
    }
    match profile.frame_sync.bias_measured {
        None => checks.warn(
            "constant bias",
            "not measured: there may be ms between the cameras",
            "measure it: `smartdepthsync evaluate precision ... --calibrate`",
        ),
        Some(date) if age(date) > OLD_DAYS => checks.warn(
            "constant bias",
            format!("measured on {date}"),
            "measure it again after changes of the rig",
        ),
        Some(date) => checks.good(
            "constant bias",
            format!("{:+.1} µs, measured on {date}", profile.frame_sync.bias_us),
        ),
    }
    Some(profile)
}

fn check_disk(out: &Path, checks: &mut Checks) {
    // The folder may not be there yet: the nearest one above it is.
    let place = out
        .ancestors()
        .map(|folder| {
            if folder.as_os_str().is_empty() {
                Path::new(".")
            } else {
                folder
            }
        })
        .find(|folder| folder.exists())
        .unwrap_or_else(|| Path::new("."));
    match free_space(place) {
        Some(free) if free < DISK_LOW => checks.warn(
            "disk",
            format!("{} MB are free", free / 1_000_000),
            "free some space: an hour takes about 150 MB, videos several GB",
        ),
        Some(free) => checks.good("disk", format!("{} GB are free", free / 1_000_000_000)),
        None => checks.warn(
            "disk",
            "free space is not known",
            "see that there is enough",
        ),
    }
}

fn check_ffmpeg(checks: &mut Checks) {
    let version = Command::new("ffmpeg")
        .arg("-version")
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output();
    match version {
        Ok(output) if output.status.success() => {
            let text = String::from_utf8_lossy(&output.stdout);
            let first = text.lines().next().unwrap_or_default();
            let short: Vec<&str> = first.split_whitespace().take(3).collect();
            checks.good("ffmpeg", short.join(" "));
        }
        _ => checks.warn(
            "ffmpeg",
            "not found",
            "extract and evaluate need it: install ffmpeg",
        ),
    }
}

fn check_recorder(profile: &Profile, checks: &mut Checks, status: &mut ExitStatus) {
    let Some(program) = profile.depth.recorder.command.first() else {
        checks.good("depth recorder", "none in the profile: start it yourself");
        return;
    };
    let found = if program.contains('/') {
        Path::new(program).is_file()
    } else {
        std::env::var_os("PATH").is_some_and(|path| {
            std::env::split_paths(&path).any(|folder| folder.join(program).is_file())
        })
    };
    if found {
        checks.good("depth recorder", program.clone());
    } else {
        note(
            checks,
            status,
            "depth recorder",
            Failure::new(
                ExitStatus::DepthRecorder,
                format!("the program `{program}` is not found"),
            )
            .next_step("install it, or change `command` in `[depth.recorder]`"),
        );
    }
}

fn check_firmware(board: &Board, checks: &mut Checks) {
    let hello = board.hello();
    let (major, minor, patch) = hello.firmware_version;
    checks.good(
        "board",
        format!(
            "{}, firmware {major}.{minor}.{patch}, up {:.1} s",
            protocol::usb::serial_number(&hello.board_id),
            hello.now.as_secs_f64()
        ),
    );
    if let Some(panic) = &hello.last_panic {
        checks.warn(
            "last panic",
            panic.to_string(),
            "report it; the board has restarted since",
        );
    }
}

/// Takes events for so long in board time. Ends early on Ctrl-C.
fn listen(
    board: &mut Board,
    context: &Context,
    ticks: u64,
    mut take: impl FnMut(&Event),
) -> Result<(), BoardError> {
    let (now, _) = board.ping()?;
    let end = now.0.saturating_add(ticks);
    let mut sign = board.now();
    while board.session().latest().0 < end && !context.interrupt.requested() {
        match board.next_event(Duration::from_millis(100))? {
            Some(event) => {
                sign = board.now();
                take(&event);
            }
            None if board.now().saturating_sub(sign) > LINK_PATIENCE => {
                return Err(BoardError::NoAnswer {
                    command: "any message",
                });
            }
            None => {}
        }
    }
    Ok(())
}

fn check_imu(board: &mut Board, checks: &mut Checks, context: &Context) -> Result<(), BoardError> {
    let mut summary = Summary::default();
    let setup = board.imu()?;
    let scale = Scale::of(&setup);
    board.start_counting();
    listen(board, context, IMU_TIME, |event| match (event, &scale) {
        (Event::Message(DeviceToHost::Imu(sample)), Some(scale)) => {
            summary.add(&scale.apply(sample));
        }
        (Event::Lost { .. }, _) => summary.gap(),
        _ => {}
    })?;
    let setup = board.imu()?;
    let report = summary.report();
    let wiring = "check its wiring: PB6/PB7 I2C, PA1 data-ready, PA8 clock, 3.3 V";
    if setup.status.state != ImuState::Running || report.samples == 0 {
        let fault = setup
            .status
            .last_fault
            .map_or(String::from("no fault reported"), |fault| {
                format!("{fault:?}")
            });
        checks.add(
            "IMU",
            Verdict::Bad,
            format!("no samples ({:?}, {fault})", setup.status.state),
            Some(wiring.to_owned()),
        );
        return Ok(());
    }
    checks.good(
        "IMU",
        format!(
            "{} samples, {:.3} Hz, jitter {:.2} ticks",
            report.samples,
            report.rate_hz.unwrap_or_default(),
            report.interval_jitter_ticks.unwrap_or_default()
        ),
    );
    match setup.status.clock {
        ImuClock::External => checks.good("IMU clock", "19.2 MHz from the board"),
        ImuClock::Internal => checks.warn(
            "IMU clock",
            "its own: samples are up to 1 % off their nominal distance",
            "wire PA8 to the sensor's CLKIN",
        ),
        ImuClock::Unknown => checks.warn("IMU clock", "not known yet", wiring),
    }
    let noise = report
        .gyro_noise_rad_s
        .iter()
        .flatten()
        .fold(0.0_f64, |most, &axis| most.max(axis));
    if noise > GYRO_NOISE_LIMIT {
        checks.warn(
            "IMU noise",
            format!("{noise:.4} rad/s"),
            "keep the rig still while this runs; if it was still, the sensor or its supply is bad",
        );
    } else {
        checks.good("IMU noise", format!("{noise:.5} rad/s"));
    }
    let lost = board.session().counts().lost();
    if lost > 0 || board.session().damaged_frames() > 0 {
        checks.warn(
            "link",
            format!(
                "{lost} messages lost, {} frames damaged in 2 s",
                board.session().damaged_frames()
            ),
            "use another USB port or cable, without a hub",
        );
    } else {
        checks.good("link", "nothing lost");
    }
    Ok(())
}

fn check_trigger(
    args: &Args,
    board: &mut Board,
    checks: &mut Checks,
    context: &Context,
) -> Result<(), BoardError> {
    let before = board.trigger()?;
    let after = if before.state == TrainState::Stopped && !args.no_trigger {
        board.start_trigger(TriggerStart {
            period: Period::from_ticks(TICK_HZ / 30),
            width: 12 * TICK_HZ / 1_000_000,
            first_edge: None,
        })?;
        let listened = listen(board, context, TRIGGER_TIME, |_| {});
        let after = board.stop_trigger()?;
        listened?;
        after
    } else {
        before
    };
    judge_readback(&after, checks);
    Ok(())
}

fn judge_readback(status: &TriggerStatus, checks: &mut Checks) {
    let readback = &status.readback;
    match (readback.seen, readback.missing, readback.delay) {
        (0, 0, _) => checks.warn(
            "trigger read-back",
            format!("not wired ({} pulses made)", status.pulses),
            "wire the trigger behind its buffer to PA3 to have every pulse proved",
        ),
        (seen, 0, delay) => checks.good(
            "trigger read-back",
            format!(
                "{seen} pulses seen, delay {} ticks",
                delay.unwrap_or_default()
            ),
        ),
        (seen, missing, _) => checks.add(
            "trigger read-back",
            Verdict::Bad,
            format!(
                "{missing} of {} pulses missing",
                seen.saturating_add(missing)
            ),
            Some(String::from(
                "check the buffer and the wire from PA5 to PA3",
            )),
        ),
    }
}

fn check_phone(profile: &Profile, checks: &mut Checks, status: &mut ExitStatus, context: &Context) {
    let interrupt = context.interrupt.clone();
    let settings = Settings {
        margin: Duration::from_secs(5),
        stop: crate::phone::StopSignal::new(move || interrupt.requested()),
        ..Settings::default()
    };
    let version =
        PhoneClient::connect(&profile.phone.address, settings).and_then(|mut phone| phone.probe());
    match version {
        Ok(version) => checks.good(
            "phone",
            format!("app {version} at {}", profile.phone.address),
        ),
        Err(error) => note(checks, status, "phone", error.into()),
    }
}

fn text(checks: &Checks) -> String {
    let mut text = String::new();
    for check in &checks.checks {
        let mark = match check.verdict {
            Verdict::Good => "ok  ",
            Verdict::Warning => "warn",
            Verdict::Bad => "BAD ",
        };
        let _ = writeln!(text, "{mark}  {:<18} {}", check.name, check.found);
        if let Some(step) = &check.next_step {
            let _ = writeln!(text, "      {:<18} -> {step}", "");
        }
    }
    text
}
