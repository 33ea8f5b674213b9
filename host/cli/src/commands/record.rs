//! `smartdepthsync record`: from the twist to an aligned recording.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::profile::{Lesson, learn};
use crate::checks::{self, text_of_judgement};
use crate::context::Context;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};
use crate::record::track::Track;
use crate::record::{self, Ended, Options, SerialConnector};
use crate::rig_profile::{Place, ProfileArg};
use phone::adb::get_files_command;
use recording::session_file::{OtherPhone, SessionFile};
use report::session::{Judgement, files_to_fetch, findings, has_recorded, sigmas};
use timebase::PhoneNanos;

/// How long a calibration records between its twists: a minute is the least that a rate is
/// learnt from.
const CALIBRATION_TICKS: u64 = record::seconds(90);

/// Options of `record`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    port: PortArg,
    #[command(flatten)]
    profile: ProfileArg,
    /// A phone's address, instead of the profile's; of several phones with its name
    #[arg(long, value_name = "[NAME=]HOST[:PORT]")]
    phone: Vec<String>,
    /// Of several phones, the one that the trigger is aligned to, instead of the profile's
    #[arg(long, value_name = "NAME")]
    reference: Option<String>,
    #[command(flatten)]
    options: Options,
    /// Record for 90 s between two twists, and write what that teaches about the phone's
    /// clocks into the rig profile
    #[arg(long)]
    calibrate: bool,
    /// Follow the phone's clock through adb while it records, so that the trigger stays on
    /// its frames for hours; an error if that cannot be. Unless given, it is followed where an
    /// adb server runs and has the phone
    #[arg(long)]
    track: bool,
    /// Do not follow the phone's clock: nothing is started on the phone
    #[arg(long, conflicts_with = "track")]
    no_track: bool,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct PrintedSession<'a> {
    folder: PathBuf,
    report: Option<PathBuf>,
    verdict: Judgement,
    /// What to type next.
    next: Vec<String>,
    /// With `--calibrate`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    learnt: Vec<Lesson>,
    #[serde(flatten)]
    session: &'a SessionFile,
}

/// Records.
///
/// # Errors
///
/// A step failed; what was recorded before is kept.
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    let (mut profile, place) = args.profile.load()?;
    for phone in &args.phone {
        profile.set_address(phone)?;
    }
    if let Some(name) = &args.reference {
        profile.set_reference(name)?;
    }
    let to_teach = match args.calibrate {
        true => Some(calibrates(args, &place)?),
        false => None,
    };
    let mut options = args.options.clone();
    options.profile = place.clone();
    options.track = match (args.track, args.no_track) {
        (true, _) => Track::Always,
        (_, true) => Track::Never,
        _ => Track::IfThere,
    };
    if args.calibrate {
        options.duration.get_or_insert(CALIBRATION_TICKS);
        options.second_twist = true;
    }
    let mut connector = SerialConnector {
        port: args.port.port.clone(),
    };
    let Ended {
        result,
        folder,
        file,
    } = record::run(&options, &profile, context, &mut connector)?;
    // The recording is there, whatever becomes of its report.
    let html = match report::session::write(&folder, &file, &|| false) {
        Ok(path) => Some(path),
        Err(error) => {
            context.say(format!("warning: cannot write the report: {error}"));
            None
        }
    };
    let outcome = match result {
        Ok(outcome) => outcome,
        Err(failure) => {
            context.say(format!("what was recorded is in {}", folder.display()));
            return Err(failure);
        }
    };
    let (learnt, not_learnt) = match to_teach.filter(|_| has_recorded(&file)) {
        Some(profile) => match learn(profile, &folder, &file, None, None) {
            Ok(learnt) => (learnt, None),
            Err(failure) => (Vec::new(), Some(failure)),
        },
        None => (Vec::new(), None),
    };
    let report = PrintedSession {
        verdict: Judgement::of(&folder, &file),
        next: next_commands(&folder, &file, to_teach.filter(|_| not_learnt.is_some())),
        folder,
        report: html,
        learnt,
        session: &file,
    };
    context.print_checks(&report, || summary(&report))?;
    match not_learnt {
        Some(failure) => {
            Err(failure.about("the recording is there, but nothing was learnt from it"))
        }
        None => Ok(outcome),
    }
}

/// The profile that a calibration teaches.
fn calibrates<'a>(args: &Args, place: &'a Place) -> Result<&'a Path, Failure> {
    let file = place.file()?;
    match args.options.duration {
        Some(ticks) if ticks < record::seconds(60) => Err(Failure::new(
            ExitStatus::Usage,
            "a calibration needs a minute or more between its two twists",
        )
        .next_step("give a --duration of 60s or more, or leave it out")),
        _ => Ok(file),
    }
}

/// What to type next, ready to be pasted. `to_teach` is a profile that could not be taught
/// yet.
fn next_commands(folder: &Path, session: &SessionFile, to_teach: Option<&Path>) -> Vec<String> {
    if !has_recorded(session) {
        return Vec::new();
    }
    let missing = files_to_fetch(folder, session);
    let mut commands: Vec<String> = missing
        .iter()
        .map(|(phase, place)| get_files_command(PhoneNanos(*phase), place, true))
        .collect();
    let recording = files::shell_word(folder);
    if let Some(profile) = to_teach {
        let profile = files::shell_word(profile);
        commands.push(format!(
            "smartdepthsync profile learn {recording} --profile {profile}"
        ));
    }
    commands.push(format!("smartdepthsync extract {recording}"));
    commands
}

fn summary(report: &PrintedSession<'_>) -> String {
    let session = report.session;
    let mut text = text_of_judgement(&report.verdict);
    let found: Vec<_> = findings(session).collect();
    if !found.is_empty() {
        let _ = write!(
            text,
            "\nbefore the recording the checks found\n{}",
            checks::text(found)
        );
    }
    text.push('\n');
    if has_recorded(session) {
        what_was_recorded(&mut text, report);
    } else {
        let _ = writeln!(text, "folder       {}", report.folder.display());
    }
    for lesson in &report.learnt {
        let _ = write!(text, "\nlearnt, for the next recording\n{}", lesson.text());
    }
    if !report.next.is_empty() {
        text.push_str("\nnext\n");
    }
    for command in &report.next {
        let _ = writeln!(text, "  {command}");
    }
    text
}

fn what_was_recorded(text: &mut String, report: &PrintedSession<'_>) {
    let session = report.session;
    let _ = writeln!(text, "recording    {}", report.folder.display());
    if let Some(html) = &report.report {
        let _ = writeln!(text, "report       {}", html.display());
    }
    if let Some(span) = session.recorded {
        let _ = writeln!(
            text,
            "length       {:.3} s of board time",
            (span.to - span.from).as_secs_f64()
        );
    }
    if let Some(clock) = session.clock {
        let (offset_us, skew_ppm) = sigmas(&clock);
        let (offset, skew) = (clock.offset, clock.skew * 1e6);
        let _ = writeln!(
            text,
            "clocks       offset {offset:.6} s ± {offset_us:.2} µs, skew {skew:+.4} ± {skew_ppm:.4} ppm"
        );
    }
    if let Some(alignment) = session.alignment {
        let _ = writeln!(text, "alignment    {}", alignment.promise());
    }
    for phone in &session.phones {
        let _ = writeln!(text, "{}", phone_line(phone));
    }
    let counts = session.counts;
    let _ = writeln!(
        text,
        "received     {} pulses, {} IMU samples, {} strobe edges; {} messages lost, {} frames damaged, {} reconnects",
        counts.pulses.received,
        counts.imu.received,
        counts.captures.received,
        counts.lost(),
        session.damaged_frames,
        session.reconnects
    );
    if counts.disordered() > 0 {
        let _ = writeln!(
            text,
            "disordered   {} messages came twice, or with numbers that do not follow",
            counts.disordered()
        );
    }
    if !session.markers.is_empty() {
        let _ = writeln!(text, "marks        {}", session.markers.len());
    }
    for problem in session.problems.iter().take(10) {
        let _ = writeln!(
            text,
            "problem      {} s: {}",
            problem.seconds(),
            problem.text
        );
    }
    if session.problems.len() > 10 {
        let _ = writeln!(
            text,
            "             and {} more, in session.json",
            session.problems.len() - 10
        );
    }
}

fn phone_line(phone: &OtherPhone) -> String {
    let mut text = format!("phone        {}", phone.name);
    if let Some(clock) = phone.clock {
        let (sigma, _) = sigmas(&clock);
        let _ = write!(text, ": offset {:.6} s ± {sigma:.2} µs", clock.offset);
    }
    if let Some(placed) = phone.placement {
        let _ = write!(
            text,
            "; frames {:+.1} ± {:.1} µs from the depth images, moving by {:+.1} ± {:.1} µs/min",
            placed.offset_us,
            placed.offset_sigma_us,
            placed.drift_us_per_min,
            placed.drift_sigma_us_per_min
        );
    }
    text
}
