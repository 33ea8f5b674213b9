//! `smartdepthsync record`: from the twist to an aligned recording.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;

use super::calibration;
use super::profile::{Lesson, learn};
use crate::checks;
use crate::context::Context;
use crate::decimal::{parse_duration, parse_length, parse_real_time};
use crate::operator::AtTerminal;
use crate::options::{PortArg, one_of};
use crate::outcome::{ExitStatus, Failure, next_text};
use crate::recordings::{self, calibrate_command, files_commands};
use crate::rig_profile::{Place, ProfileArg};
use crate::view::View;
use crate::view::state::State;
use board::finding::Finding;
use evaluate::led::calibration::Calibration;
use phone::task::PhoneTask;
use recording::RecordingError;
use recording::folder::check_name;
use recording::profile::Profile;
use recording::session_file::{CHECK_BIAS, CHECK_LEARNT, SessionFile, SessionOutcome};
use recording::strobes::SeenExposures;
use recording::verify::{Verification, verify};
use report::session::{is_lossy, summary};
use report::summary::{Summary, findings_text};
use session::devices::hardware::{AdbClockStarter, SerialConnector};
use session::devices::recorder_process::RecorderProcess;
use session::devices::{Phone, SystemClock};
use session::options::{LED_TICKS, Options, Track, seconds};
use session::run::{Devices, Ended, run as run_session};
use system::ReadMonitor;

/// Length of a calibration between its twists: a minute is the least that a rate is learnt
/// from.
const CALIBRATION_TICKS: u64 = seconds(90);

/// The same after an LED has flashed.
const AFTER_LED_TICKS: u64 = seconds(30);

/// The most problems that are listed at the end.
const MAX_PROBLEMS: usize = 10;

/// Where the options for few stand in the long help.
const MORE: &str = "More";

/// Options of `record`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync record --duration 5m")]
pub(crate) struct RecordArgs {
    /// Duration in board time, such as 90s, 5m or 1h [default: until stopped]
    #[arg(long, value_name = "TIME", value_parser = parse_length)]
    duration: Option<u64>,
    /// Parent folder of the recording's folder
    #[arg(short, long, value_name = "FOLDER", default_value = recordings::FOLDER)]
    out: PathBuf,
    /// Name of the recording's folder [default: date and time]
    #[arg(long, value_parser = check_name)]
    name: Option<String>,
    /// Never prompt, and stop at the first failure; -q and --json imply it
    #[arg(long)]
    yes: bool,
    /// Record for 90 s between two twists, and write what that teaches into the rig profile: the
    /// phone's clocks, with a photodiode on PA2 the middle of the depth exposure, and with --led that
    /// of the phone's
    #[arg(long)]
    calibrate: bool,
    /// Twist again at the end, for a far better skew; `profile learn` needs it
    #[arg(long)]
    second_twist: bool,
    /// Follow the phone's clock through adb during the recording, which keeps the trigger on its
    /// frames for hours: auto (if an adb server has the phone), always (or fail), or never
    #[arg(long, value_name = "WHEN", default_value = "auto", value_parser = one_of(&TRACKS),
          hide_possible_values = true)]
    track: Track,
    /// Leave the phone's files and video on the phone
    #[arg(long)]
    no_fetch: bool,
    #[command(flatten, next_help_heading = MORE)]
    more: MoreArgs,
}

/// Options of `record` that its short help leaves out.
#[derive(Debug, clap::Args)]
struct MoreArgs {
    #[command(flatten)]
    port: PortArg,
    #[command(flatten)]
    profile: ProfileArg,
    /// With --calibrate: first flash an LED on PE14 (Black Pill: PA5) at the phone for a minute, and
    /// write into the profile when the phone's rows are exposed
    #[arg(long, hide_short_help = true, requires = "calibrate")]
    led: bool,
    /// Number of twists before the recording, a minute apart: two show the present rate of the
    /// clocks, three or more how it changes while the rig warms up
    #[arg(long, value_name = "NUMBER", default_value_t = 1, hide_short_help = true,
          value_parser = clap::value_parser!(u32).range(1..=5))]
    twists: u32,
    /// Set a mark this long after the start; may be repeated
    #[arg(long = "marker", value_name = "TIME", hide_short_help = true,
          value_parser = parse_duration)]
    markers: Vec<u64>,
    /// Align the trigger this far ahead of the phone's frames, such as 4ms, so that an end of the
    /// strobe train is in the picture, for `evaluate precision --calibrate`
    #[arg(long, value_name = "TIME", hide_short_help = true, value_parser = parse_real_time,
          conflicts_with = "calibrate")]
    shift: Option<Duration>,
    /// Print plain lines instead of the live view
    #[arg(long, hide_short_help = true)]
    plain: bool,
    /// Print events as JSON objects, one per line, and nothing else on standard output; implies
    /// --plain
    #[arg(long, hide_short_help = true)]
    events: bool,
    /// Also record each frame of the USB link as received, for a bug report
    #[arg(long, hide_short_help = true)]
    raw_link: bool,
}

/// When the phone's clock is followed.
const TRACKS: [(&str, Track); 3] = [
    ("auto", Track::IfThere),
    ("always", Track::Always),
    ("never", Track::Never),
];

impl RecordArgs {
    fn options(&self) -> Options {
        let length = if self.more.led {
            AFTER_LED_TICKS
        } else {
            CALIBRATION_TICKS
        };
        let calibration = self.calibrate.then_some(length);
        let duration = self.duration.or(calibration);
        let more = &self.more;
        Options {
            name: self.name.clone(),
            duration,
            markers: more.markers.clone(),
            track: self.track,
            twists: more.twists,
            led: if self.more.led { LED_TICKS } else { 0 },
            second_twist: self.second_twist || self.calibrate,
            fetch_video: !self.no_fetch,
            fetch_files: !self.no_fetch,
            raw_link: more.raw_link,
            ..Options::into_folder(self.out.clone())
        }
    }
}

/// The object of `--json`.
#[derive(Debug, Serialize)]
struct PrintedSession<'a> {
    folder: PathBuf,
    report: Option<PathBuf>,
    verdict: Summary,
    /// Commands to type next.
    next: Vec<String>,
    /// True of a calibration that has not measured the middle of the depth exposure.
    #[serde(skip)]
    lacks_depth: bool,
    /// With `--calibrate`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    learnt: Vec<Lesson>,
    /// With `--calibrate`: the depth exposures that were written into the profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<SeenExposures>,
    /// With `--led`: the phone's rows that were written into the profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    rows: Option<Calibration>,
    #[serde(flatten)]
    session: &'a SessionFile,
}

/// Records.
///
/// # Errors
///
/// A step failed; what was recorded before is kept.
pub(crate) fn run(args: &RecordArgs, context: &Context) -> Result<ExitStatus, Failure> {
    if args.more.events && context.global.json {
        return Err(Failure::new(
            ExitStatus::Usage,
            "--events and --json both print on standard output",
        )
        .next_step("give one of them"));
    }
    let (mut profile, place) = args.more.profile.load()?;
    if let Some(shift) = args.more.shift {
        profile.frame_sync.shift_us = shift.as_secs_f64() * 1e6;
    }
    let to_teach = if args.calibrate {
        Some(calibrates(args, &place)?)
    } else {
        None
    };
    let Ended {
        result,
        folder,
        mut file,
    } = record(args, &profile, &place, context)?;
    let outcome = match result {
        // Nothing between begin and end is not what was asked for.
        Ok(SessionOutcome::Good | SessionOutcome::Loss) => ExitStatus::Good,
        Ok(SessionOutcome::Interrupted) => ExitStatus::Interrupted,
        Ok(SessionOutcome::Failed) => ExitStatus::Error,
        Err(error) => {
            let _ = write_report(&folder, &file);
            context.say(format!("what was recorded is in {}", folder.display()));
            let next = if file.has_recorded() {
                format!("smartdepthsync verify {}", system::shell_word(&folder))
            } else {
                format!("smartdepthsync doctor{}", place.option())
            };
            return Err(Failure::from(error).commands(vec![next]));
        }
    };
    let to_teach = to_teach.filter(|_| file.has_recorded());
    let taught = match to_teach {
        Some(profile) => teach(profile, &folder, &mut file, context)?,
        None => Taught::default(),
    };
    // The recording is complete without its report.
    let (verification, html) = match write_report(&folder, &file) {
        Ok((verification, path)) => (Some(verification), Some(path)),
        Err(error) => {
            context.say(format!("warning: cannot write the report: {error}"));
            (None, None)
        }
    };
    let outcome = match outcome {
        ExitStatus::Good => ExitStatus::of_loss(is_lossy(&file, verification.as_ref())),
        other => other,
    };
    let report = PrintedSession {
        verdict: summary(&folder, &file, verification.as_ref()),
        next: next_commands(
            args,
            &folder,
            &file,
            (to_teach, taught.not_learnt.is_some()),
            &place,
        ),
        folder,
        report: html,
        lacks_depth: to_teach.is_some() && file.exposures.is_none(),
        learnt: taught.learnt,
        depth: taught.depth,
        rows: taught.rows,
        session: &file,
    };
    if args.more.events {
        context.say(text(&report));
    } else {
        context.print_checks(&report, || text(&report))?;
    }
    let not_learnt = taught
        .not_learnt
        .map(|failure| failure.about("the recording is there, but no clock was learnt from it"));
    let no_rows = taught.no_rows.map(|failure| {
        failure.about("the recording is there, but the phone's rows were not measured")
    });
    match (not_learnt, no_rows) {
        (Some(failure), other) => {
            if let Some(other) = other {
                context.say(other.to_string());
            }
            Err(failure)
        }
        (None, Some(failure)) => Err(failure),
        (None, None) => Ok(outcome),
    }
}

/// Lessons of a calibration, and the reasons for those that are missing.
#[derive(Debug, Default)]
struct Taught {
    depth: Option<SeenExposures>,
    learnt: Vec<Lesson>,
    rows: Option<Calibration>,
    not_learnt: Option<Failure>,
    no_rows: Option<Failure>,
}

/// Writes what a recording teaches into the profile, and its checks into the session.
fn teach(
    profile: &Path,
    folder: &Path,
    file: &mut SessionFile,
    context: &Context,
) -> Result<Taught, Failure> {
    let mut taught = Taught::default();
    let clocks = calibration::write_depth(profile, file).and_then(|seen| {
        taught.depth = seen;
        context.over_files(|monitor| learn(profile, folder, file, None, None, monitor))
    });
    match clocks {
        Ok(lessons) => taught.learnt = lessons,
        Err(failure) => taught.not_learnt = Some(failure),
    }
    match calibration::write_rows(profile, folder, file, context) {
        Ok(found) => taught.rows = found,
        Err(failure) => taught.no_rows = Some(failure),
    }
    let mut known = Vec::new();
    if taught.not_learnt.is_none() {
        known.push(CHECK_LEARNT);
    }
    if taught.depth.is_some() && taught.rows.is_some() {
        known.push(CHECK_BIAS);
    }
    for check in &mut file.preflight {
        if let Some(kind) = known.iter().find(|&&kind| check.kind == kind) {
            *check = Finding::good(*kind, "from this recording");
        }
    }
    file.save(folder)?;
    Ok(taught)
}

/// Checks a recording, and writes its report.
fn write_report(
    folder: &Path,
    session: &SessionFile,
) -> Result<(Verification, PathBuf), RecordingError> {
    let monitor = ReadMonitor::default();
    let verification = verify(folder, &monitor)?;
    let page = report::session::write(folder, session, &verification, &monitor)?;
    Ok((verification, page))
}

/// Runs the session on the devices of this computer.
fn record(
    args: &RecordArgs,
    profile: &Profile,
    place: &Place,
    context: &Context,
) -> Result<Ended, Failure> {
    let mut phones: Vec<Box<dyn Phone>> = Vec::new();
    for phone in profile.all_phones() {
        let task = PhoneTask::start(phone.address.clone()).map_err(|error| {
            Failure::new(ExitStatus::Error, format!("no thread: {error}"))
                .next_step("close other programs: the system gives no more threads")
        })?;
        phones.push(Box::new(task));
    }
    let is_silent = context.is_silent();
    let asks = !args.yes && !is_silent;
    let more = &args.more;
    let wants_screen = !(more.plain || more.events || is_silent);
    let state = State::of_session(profile, asks);
    let mut view = View::open(context, state, wants_screen, more.events);
    let mut operator = AtTerminal::new(view.take_keys(), asks, &context.interrupt);
    let devices = Devices {
        connector: &mut SerialConnector {
            port: more.port.path(Some(profile)),
        },
        phones,
        phone_clock: &mut AdbClockStarter {
            cancel: context.interrupt.cancel(),
        },
        recorder: &mut RecorderProcess::default(),
        host_checks: &mut || checks::host(profile, place, &args.out),
        clock: &SystemClock,
        operator: &mut operator,
        events: &mut |event| view.take(event),
    };
    let ended = run_session(&args.options(), profile, devices);
    // Restores the terminal before anything else is printed.
    drop(view);
    let ended = ended.map_err(|error| {
        let next = format!("smartdepthsync doctor{}", place.option());
        Failure::from(error).commands(vec![next])
    });
    ended?.ok_or_else(|| {
        Failure::new(
            ExitStatus::Interrupted,
            "stopped before anything was recorded",
        )
        .next_step("start it again when you are ready")
    })
}

/// The profile that a calibration teaches.
fn calibrates<'a>(args: &RecordArgs, place: &'a Place) -> Result<&'a Path, Failure> {
    let file = place.file()?;
    match args.duration {
        Some(ticks) if ticks < seconds(60) => Err(Failure::new(
            ExitStatus::Usage,
            "a calibration needs a minute or more between its two twists",
        )
        .next_step("give a --duration of 60s or more, or leave it out")),
        _ => Ok(file),
    }
}

/// Returns the next commands, ready to be pasted. `to_teach` is the profile of a calibration, and
/// true if nothing was learnt for it.
fn next_commands(
    args: &RecordArgs,
    folder: &Path,
    session: &SessionFile,
    to_teach: (Option<&Path>, bool),
    place: &Place,
) -> Vec<String> {
    if !session.has_recorded() {
        return vec![format!("smartdepthsync doctor{}", place.option())];
    }
    let mut commands = files_commands(folder, Some(session));
    let recording = system::shell_word(folder);
    match to_teach {
        (Some(profile), true) => {
            let profile = system::shell_word(profile);
            commands.push(format!(
                "smartdepthsync profile learn {recording} --profile {profile}"
            ));
        }
        (Some(_), false) => {
            let profile = place.option();
            commands.push(format!("smartdepthsync record --duration 1m{profile}"));
        }
        (None, _) if args.more.shift.is_some() => {
            commands.push(calibrate_command(&[folder], place));
        }
        (None, _) => commands.push(format!("smartdepthsync extract {recording}")),
    }
    commands
}

/// Returns the text at the end: the verdict, each remark once, and the next commands.
fn text(printed: &PrintedSession<'_>) -> String {
    let session = printed.session;
    let verdict = &printed.verdict;
    let mut text = format!("{}\n{}", verdict.text, findings_text(&verdict.parts));
    // A single problem is a part of the verdict.
    if session.problems.len() > 1 {
        text += &findings_text(session.problems.iter().take(MAX_PROBLEMS));
    }
    let more = session.problems.len().saturating_sub(MAX_PROBLEMS);
    if more > 0 {
        text += &format!("and {more} more, in session.json\n");
    }
    text.extend(printed.learnt.iter().map(Lesson::text));
    if let Some(depth) = &printed.depth {
        text += &format!("{}; written to the profile\n", depth.text());
    }
    if printed.lacks_depth {
        text += "the middle of the depth exposure was not measured: that takes a photodiode on the \
                 strobe input, in front of the depth camera's illuminator\n";
    }
    if let Some(rows) = &printed.rows {
        text += &format!("{}; written to the profile\n", rows.text());
    }
    text += &match &printed.report {
        Some(html) => format!("report {}\n", html.display()),
        None => format!("folder {}\n", printed.folder.display()),
    };
    text + &next_text(&printed.next)
}
