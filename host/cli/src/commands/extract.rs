//! `smartdepthsync extract`: a recording into a data set in board time.

use std::path::{Path, PathBuf};

use crate::advice::bag_step;
use crate::context::Context;
use crate::options::one_of;
use crate::outcome::{ExitStatus, Failure, RAISE_LIMITS, file_step, next_text};
use crate::recordings::{self, RecordingArg};
use crate::rig_profile::{Place, ProfileArg};
use extract::error::ExtractError;
use extract::geometry::View;
use extract::inputs::InputsError;
use extract::layout::Format;
use extract::options::Options;
use extract::output::folder::OutputDirError;
use extract::run::{Job, run as extract};
use phone::video_files::FilesError;
use recording::profile::Profile;
use recording::session_file::SessionFile;
use report::REPORT_FILE;
use system::ReadMonitor;

/// The formats on the command line.
const FORMATS: [(&str, Format); 5] = [
    ("euroc", Format::Euroc),
    ("tum", Format::Tum),
    ("topics", Format::Topics),
    ("kalibr", Format::Kalibr),
    ("ros2", Format::Ros2),
];

/// The cameras that depth is registered to.
const VIEWS: [(&str, View); 2] = [("phone", View::Phone), ("color", View::Color)];

/// Where the options for few stand in the long help.
const MORE: &str = "More";

/// Options of `extract`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync extract recordings/walk --format tum")]
pub(crate) struct ExtractArgs {
    #[command(flatten)]
    recording: RecordingArg,
    /// Format: EuRoC (ASL), TUM RGB-D, one folder per topic as by the published extractor, input of
    /// Kalibr's bag creator, or a ROS 2 bag (MCAP)
    #[arg(long, default_value = "euroc", value_parser = one_of(&FORMATS))]
    format: Format,
    /// Output folder [default: RECORDING-FORMAT beside the recording]
    #[arg(short, long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Replace an earlier extraction in the output folder
    #[arg(long)]
    overwrite: bool,
    /// Folder with the phone's files, or the video itself [default: the recording's folder]. With
    /// several phones, give the name too; may be repeated
    #[arg(long, value_name = "[NAME=]PATH")]
    phone: Vec<String>,
    /// Recording of the depth camera: an .mkv file, or a ROS 2 bag of its driver (its folder, or
    /// its .mcap file) [default: the one in the recording's folder]
    #[arg(long, value_name = "PATH")]
    depth: Option<PathBuf>,
    /// Reproject depth into another camera, at the size of its images: the phone's, whose
    /// intrinsics and both cameras' poses the profile must hold, or the depth camera's colour
    /// camera
    #[arg(long, value_parser = one_of(&VIEWS))]
    register: Option<View>,
    #[command(flatten, next_help_heading = MORE)]
    more: MoreArgs,
}

/// Options of `extract` that its short help leaves out.
#[derive(Debug, clap::Args)]
struct MoreArgs {
    /// Rig profile that overrides the recording's: constants and geometry of the first phone and of
    /// the depth camera
    #[arg(long, value_name = "FILE", hide_short_help = true)]
    profile: Option<PathBuf>,
    /// Topic of the depth images, if a bag has several
    #[arg(long, value_name = "TOPIC", hide_short_help = true)]
    depth_topic: Option<String>,
    /// Include pairs from outside the aligned span, and pairs more than 10 ms apart
    #[arg(long, hide_short_help = true)]
    all_pairs: bool,
    /// Also write infrared images
    #[arg(long, hide_short_help = true)]
    infrared: bool,
    /// Pulse of the first depth frame (its row in pulses.csv), if nothing else shows it
    #[arg(long, value_name = "N", hide_short_help = true)]
    first_pulse: Option<usize>,
}

/// Runs the command.
///
/// # Errors
///
/// There is no recording, the output folder cannot be used, or a file cannot be
/// written. Missing and damaged parts end in [`ExitStatus::Loss`].
pub(crate) fn run(args: &ExtractArgs, context: &Context) -> Result<ExitStatus, Failure> {
    let recording = args.recording.find(context)?;
    let out = match &args.out {
        Some(out) => out.clone(),
        None => default_out(&recording, args.format)?,
    };
    let mut phones = Vec::new();
    let mut unnamed = Vec::new();
    for given in &args.phone {
        match given.split_once('=') {
            // A path that is there is one, whatever is in it.
            Some((name, path)) if !Path::new(given).exists() => {
                phones.push((name.to_owned(), PathBuf::from(path)));
            }
            _ => unnamed.push(PathBuf::from(given)),
        }
    }
    if unnamed.len() > 1 {
        return Err(
            Failure::new(ExitStatus::Usage, "--phone was given twice without a name")
                .next_step("of several phones, give --phone NAME=PATH"),
        );
    }
    let more = &args.more;
    let profile = more.profile.as_deref().map(Profile::load).transpose()?;
    let mut job = Job {
        recording,
        phone: unnamed.pop(),
        depth: args.depth.clone(),
        format: args.format,
        out,
        options: Options {
            first_pulse: more.first_pulse,
            depth_topic: more.depth_topic.clone(),
            all_pairs: more.all_pairs,
            infrared: more.infrared,
            view: args.register,
            profile,
            phones,
        },
        overwrite: args.overwrite,
        monitor: ReadMonitor::default(),
    };
    let report = context.over_files(|monitor| {
        job.monitor = monitor.clone();
        extract(&job)
    })?;
    let folder = recordings::folder_of(&job.recording);
    let session = SessionFile::load(folder).ok();
    report::extraction::write(&job.out, &report, folder, session.as_ref())
        .map_err(|error| Failure::file("write the report in", &job.out, &error))?;
    // The recording may lie where nothing can be written.
    let (page, checked) = (job.out.join(REPORT_FILE), report.verification.clone());
    if let Err(error) = report::session::link_page(folder, &page, Some(checked)) {
        tracing::info!("the report of the recording is as it was: {error}");
    }
    context.print_checks(&report, || {
        let text = report::extraction::summary(&report, folder, session.as_ref()).text();
        let (out, page) = (job.out.display(), job.out.join(REPORT_FILE));
        let next = session.as_ref();
        let next = next.map_or_else(Vec::new, |session| next_commands(folder, session));
        let next = next_text(&next);
        format!("{text}written to {out}\nreport {}\n{next}", page.display())
    })?;
    let is_lossy = session.is_some_and(|session| report::session::is_lossy(&session, None));
    Ok(ExitStatus::of_loss(is_lossy || !report.losses.is_empty()))
}

/// Returns the commands to type next about a recording that was extracted.
fn next_commands(folder: &Path, session: &SessionFile) -> Vec<String> {
    if !session.has_recorded() {
        return recordings::next_commands(folder, Some(session));
    }
    let mut commands = recordings::files_commands(folder, Some(session));
    let (own, place) = match ProfileArg::default().load() {
        Ok((profile, place)) if place.path.is_some() => (profile, place),
        _ => (session.profile.clone(), Place { path: None }),
    };
    if !commands.is_empty() {
        let recording = system::shell_word(folder);
        commands.push(format!("smartdepthsync extract {recording} --overwrite"));
    } else if own.phone.learnt.is_none() && place.path.is_some() {
        commands.push(String::from("smartdepthsync record --calibrate"));
    } else if own.frame_sync.bias_measured.is_none() {
        commands.push(recordings::calibrate_command(&[folder], &place));
    } else {
        commands.push(String::from("smartdepthsync record --duration 1m"));
    }
    commands
}

/// `RECORDING-FORMAT` beside the recording.
fn default_out(recording: &Path, format: Format) -> Result<PathBuf, Failure> {
    let full = recording.canonicalize().map_err(|error| {
        Failure::new(
            ExitStatus::Storage,
            format!("reading {}: {error}", recording.display()),
        )
        .next_step("give the folder of a recording")
    })?;
    // A file in a recording's folder stands for the folder.
    let base = recordings::folder_of(&full);
    let name = base
        .file_name()
        .ok_or_else(|| {
            Failure::new(ExitStatus::Usage, "the recording has no name")
                .next_step("give the output folder with --out")
        })?
        .to_string_lossy()
        .into_owned();
    let stem = name.strip_suffix(".mcap").unwrap_or(&name);
    Ok(base.with_file_name(format!("{stem}-{}", format.name())))
}

impl From<ExtractError> for Failure {
    fn from(error: ExtractError) -> Self {
        let (status, step) = match &error {
            ExtractError::Inputs(
                InputsError::Io { error, .. } | InputsError::Phone(FilesError::Io { error, .. }),
            )
            | ExtractError::OutputDir(OutputDirError::Io { error, .. }) => {
                (ExitStatus::Storage, file_step(error.kind()))
            }
            ExtractError::Inputs(InputsError::Phone(_)) => {
                (ExitStatus::Usage, "name the video itself with --phone")
            }
            ExtractError::Inputs(InputsError::Recording(error)) => {
                (ExitStatus::Usage, bag_step(error))
            }
            ExtractError::Inputs(InputsError::UnknownPhone { .. }) => (
                ExitStatus::Usage,
                "give --phone NAME=PATH as the phone is called in the profile",
            ),
            ExtractError::Inputs(_) => (ExitStatus::Usage, "name the depth recording with --depth"),
            ExtractError::OutputDir(OutputDirError::Other { .. }) => (
                ExitStatus::Usage,
                "replace it with --overwrite, or give another folder with --out",
            ),
            ExtractError::OutputDir(OutputDirError::Busy { .. }) => (
                ExitStatus::Usage,
                "wait until it has ended, or give another folder with --out",
            ),
            ExtractError::OutputDir(_) => (
                ExitStatus::Usage,
                "give another folder with --out, or remove this one",
            ),
            ExtractError::Board(_) | ExtractError::Missing(_) => (
                ExitStatus::Storage,
                "check that the file is a recording and that it was copied in full",
            ),
            ExtractError::Write { .. } | ExtractError::Depth(_) | ExtractError::Video(_) => (
                ExitStatus::Storage,
                "make room or check the rights, and run it again: it keeps what is there",
            ),
            ExtractError::Thread(_) => (ExitStatus::Storage, RAISE_LIMITS),
            ExtractError::Cancelled => (
                ExitStatus::Interrupted,
                "run the same command again to go on",
            ),
        };
        Self::new(status, error.to_string()).next_step(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_output_lies_beside_the_recording() {
        let folder = tempfile::tempdir().unwrap();
        let recording = folder.path().canonicalize().unwrap().join("walk");
        std::fs::create_dir(&recording).unwrap();
        let out = default_out(&recording, Format::Tum).unwrap();
        assert_eq!(out, recording.with_file_name("walk-tum"));
        let bag = recording.with_file_name("old.mcap");
        std::fs::write(&bag, "").unwrap();
        assert_eq!(
            default_out(&bag, Format::Euroc).unwrap(),
            bag.with_file_name("old-euroc")
        );
        let own = recording.join("recording.mcap");
        std::fs::write(&own, "").unwrap();
        assert_eq!(default_out(&own, Format::Tum).unwrap(), out);
    }
}
