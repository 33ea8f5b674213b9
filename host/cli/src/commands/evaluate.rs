//! `smartdepthsync evaluate precision|drift`: frame sync measured from strobes on video.

use std::path::{Path, PathBuf};

use clap::Subcommand;
use jiff::civil::Date;
use serde::Serialize;

use crate::context::Context;
use crate::decimal::{parse_micros, parse_seconds};
use crate::options::one_of;
use crate::outcome::{ExitStatus, Failure, file_step, next_text, refuse_to_overwrite, write_file};
use crate::recordings;
use crate::rig_profile::{Place, ProfileArg};
use evaluate::calibrate::{read_profile, write_bias};
use evaluate::drift::{self, Drift};
use evaluate::footage::Footage;
use evaluate::footage::Region;
use evaluate::precision::{self, BiasStatistics, Precision, RecordingResult};
use evaluate::stats::mean;
use evaluate::train::TrainGeometry;
use evaluate::{EvaluateError, KnownReadout, Settings};
use phone::file_name::VIDEO_ENDINGS;
use recording::SESSION_FILE;
use recording::profile::Direction;
use report::evaluation::{drift_summary, precision_summary};

/// Degrees by which an image is turned against the sensor, and which way it is read out then.
const ROTATIONS: [(&str, Direction); 4] = [
    ("0", Direction::Down),
    ("90", Direction::Left),
    ("180", Direction::Up),
    ("270", Direction::Right),
];

/// Arguments of `evaluate`.
#[derive(Debug, clap::Args)]
pub(crate) struct EvaluateArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Bias from perfect sync, and its spread over recordings
    Precision(PrecisionArgs),
    /// Drift over one long recording
    Drift(DriftArgs),
}

#[derive(Debug, clap::Args)]
struct CommonArgs {
    /// Strobe train: nfov, wfov, a mode such as WFOV_2X2BINNED, or COUNT,PITCH_US,DURATION_US
    #[arg(long, default_value = "nfov", value_name = "TRAIN")]
    train: TrainGeometry,
    /// Clockwise rotation of the image relative to the sensor's readout, in degrees
    #[arg(long, default_value = "0", value_name = "DEGREES", value_parser = one_of(&ROTATIONS))]
    rotation: Direction,
    /// Part of the image to evaluate, in pixels
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT")]
    region: Option<Region>,
    /// Exposure of a row, such as 500us, if known to 2 %
    #[arg(long, value_name = "TIME", value_parser = parse_micros)]
    exposure: Option<f64>,
    /// Row time, such as 10.2us, if known to 0.5 %
    #[arg(long, value_name = "TIME", value_parser = parse_micros)]
    row_time: Option<f64>,
    /// Expected bias, which identifies the flashes where the picture does not
    #[arg(long, value_name = "TIME", value_parser = parse_micros, allow_hyphen_values = true)]
    near: Option<f64>,
    /// Delay of the light path from strobe to LED, subtracted
    #[arg(long, value_name = "TIME", value_parser = parse_micros, default_value = "0us",
          allow_hyphen_values = true)]
    path_delay: f64,
    /// Start at this time of the recording, such as 10s
    #[arg(long, value_name = "TIME", value_parser = parse_seconds)]
    from: Option<f64>,
    /// Stop at this time of the recording
    #[arg(long, value_name = "TIME", value_parser = parse_seconds)]
    to: Option<f64>,
    /// Write a report with all pictures to this HTML file
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the file of --out if it is there
    #[arg(long)]
    overwrite: bool,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: smartdepthsync evaluate precision recordings/walk --calibrate rig.toml"
)]
struct PrecisionArgs {
    /// Folders of recordings, or videos; each is one recording
    #[arg(required = true, value_name = "VIDEO_OR_FRAMES")]
    inputs: Vec<PathBuf>,
    /// Number of frames with flashes to use from each recording, counted from its end
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u16).range(1..=1000))]
    frames: u16,
    /// Write the bias into this rig profile
    #[arg(long, value_name = "PROFILE")]
    calibrate: Option<PathBuf>,
    #[command(flatten)]
    common: CommonArgs,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: smartdepthsync evaluate drift recordings/walk --out recordings/walk/drift.html"
)]
struct DriftArgs {
    /// Folder of the recording, or video
    #[arg(value_name = "VIDEO_OR_FRAMES")]
    input: PathBuf,
    #[command(flatten)]
    common: CommonArgs,
}

impl CommonArgs {
    /// Refuses what cannot be written, before hours of work.
    fn check_targets(&self) -> Result<(), Failure> {
        let mut out = self.out.iter();
        out.try_for_each(|path| refuse_to_overwrite(path, self.overwrite))
    }

    fn settings(&self) -> Result<Settings, EvaluateError> {
        let settings = Settings {
            train: self.train,
            readout: self.rotation,
            region: self.region,
            exposure_us: self.exposure,
            row_time_us: self.row_time,
            near_us: self.near.unwrap_or(0.0),
            path_delay_us: self.path_delay,
            from_s: self.from,
            to_s: self.to,
            ..Settings::default()
        };
        settings.check()?;
        Ok(settings)
    }
}

/// The measured bias as it was written into the rig profile.
#[derive(Debug, Serialize)]
struct Calibrated {
    profile: PathBuf,
    /// Bias that was subtracted while recording, µs; mean over recordings.
    applied_bias_us: f64,
    /// New bias, µs.
    bias_us: f64,
    /// Its standard uncertainty, µs.
    bias_sigma_us: f64,
    /// Date.
    measured: Date,
}

impl Calibrated {
    fn text(&self) -> String {
        format!(
            "written to {}: frame_sync.bias_us = {:.3} ± {:.3} µs (applied while recording: {:.3} µs)\n",
            self.profile.display(),
            self.bias_us,
            self.bias_sigma_us,
            self.applied_bias_us
        )
    }
}

#[derive(Serialize)]
struct PrecisionOutput<'a> {
    settings: &'a Settings,
    #[serde(flatten)]
    precision: &'a Precision,
    calibrated: Option<Calibrated>,
    /// Commands to type next.
    next: Vec<String>,
}

#[derive(Serialize)]
struct DriftOutput<'a> {
    settings: &'a Settings,
    #[serde(flatten)]
    drift: &'a Drift,
    /// Commands to type next.
    next: Vec<String>,
}

/// Runs `evaluate`.
///
/// # Errors
///
/// Nothing could be measured, or a file cannot be read or written.
pub(crate) fn run(args: &EvaluateArgs, context: &Context) -> Result<ExitStatus, Failure> {
    match &args.what {
        What::Precision(args) => run_precision(args, context),
        What::Drift(args) => run_drift(args, context),
    }
}

impl From<EvaluateError> for Failure {
    fn from(error: EvaluateError) -> Self {
        use EvaluateError as E;
        let (status, step) = match &error {
            E::Setting(_) => (
                ExitStatus::Usage,
                "change the option; `smartdepthsync help evaluate` explains each",
            ),
            E::RegionOutside { .. } => (ExitStatus::Usage, REGION),
            E::TooFewRows { .. } | E::Unsupported { .. } => (ExitStatus::Error, REGION),
            E::FrameSize { .. } => (
                ExitStatus::Error,
                "evaluate recordings of one camera mode at a time",
            ),
            E::Ffmpeg(_) => (
                ExitStatus::Error,
                "install ffmpeg (Debian, Ubuntu: `sudo apt-get install ffmpeg`)",
            ),
            E::NoVideo { copy, .. } => {
                let step = match copy {
                    Some(copy) => format!("`{copy}` copies it by USB; or give the video itself"),
                    None => String::from(
                        "give the phone's video itself, or the folder of a recording that has it",
                    ),
                };
                return Self::new(ExitStatus::Usage, error.to_string()).next_step(step);
            }
            E::NotAVideo { .. } => (
                ExitStatus::Usage,
                "give a video; of single images `ffmpeg` makes one: `ffmpeg -pattern_type glob -i '*.png' -c:v ffv1 video.mkv`",
            ),
            E::Io { source, .. } => (ExitStatus::Storage, file_step(source.kind())),
            E::Timestamps { .. } => (
                ExitStatus::Usage,
                "fetch the app's `..._timestamps.csv` again: one integer of nanoseconds a line; without \
                 it beside the video its frames count as evenly spaced",
            ),
            E::NoFrames { .. } => (
                ExitStatus::Error,
                "choose another --from and --to within the recording",
            ),
            E::NoFlashes { .. } | E::OnlyFlicker { .. } | E::TooFewFrames { .. } => (
                ExitStatus::Refused,
                "look at the video: the re-transmitter's flashes must be in view, on a picture that \
                 is otherwise still",
            ),
            E::Unproven { .. } => (
                ExitStatus::Refused,
                "record once more with the trigger moved (`smartdepthsync record --shift 4ms`) and \
                 give both recordings to `evaluate precision`; or give --row-time if it is known",
            ),
            E::RowTime { .. } => (
                ExitStatus::Refused,
                "switch lamps off that are dimmed; if the readout of the profile is a guess, say so with \
                 a `readout_sigma_us` as large as that guess is uncertain",
            ),
            E::NotInStep { .. } => (
                ExitStatus::Refused,
                "if the trigger is still being aligned there, choose a later time with --from; \
                 otherwise switch lamps off that are dimmed",
            ),
            E::LedUnseen { .. } => (
                ExitStatus::Phone,
                "calibrate again, and let the phone's files be fetched",
            ),
            E::Led(_) => (
                ExitStatus::Refused,
                "hold the LED to the lens, a sheet of paper between, other lights off, exposure and \
                 frame rate locked, and calibrate again",
            ),
            E::Profile(error) => return error.into(),
            E::Session(error) => return error.into(),
        };
        Self::new(status, error.to_string()).next_step(step)
    }
}

/// Next step for a part of the picture without flashes.
const REGION: &str = "give a --region inside the picture, or leave it out";

fn run_precision(args: &PrecisionArgs, context: &Context) -> Result<ExitStatus, Failure> {
    args.common.check_targets()?;
    let mut settings = args.common.settings()?;
    // A profile that cannot be read is found out before hours of work.
    let profile = args.calibrate.as_deref().map(read_profile).transpose()?;
    let profile_bias = profile
        .as_ref()
        .map_or(0.0, |known| known.frame_sync.bias_us);
    settings.known_readout = profile.map(|known| KnownReadout::of_phone(&known.phone));
    let inputs = recordings_of(&args.inputs, context)?;
    let count = inputs.len();
    let mut done = 0;
    let mut each = |path: &Path, result: &Result<RecordingResult, String>| {
        done += 1;
        if count > 1 {
            let said = match result {
                Ok(r) => format!("{:+.3} ± {:.3} µs", r.bias_us, r.sigma_us),
                Err(reason) => format!("left out: {reason}"),
            };
            context.say(format!("{done}/{count} {}: {said}", path.display()));
        }
    };
    let (result, shown) = context.over_files(|monitor| {
        settings.monitor = monitor.clone();
        precision::evaluate(&inputs, &settings, args.frames.into(), &mut each)
    })?;
    let Some(shown) = shown else {
        return Err(Failure::new(
            ExitStatus::Refused,
            format!(
                "none of {count} recordings could be evaluated; the first: {}",
                result
                    .left_out
                    .first()
                    .map_or("no reason", |l| l.reason.as_str())
            ),
        )
        .next_step("fix what the reason names; -v lists the reason of every recording"));
    };
    let calibrated = match &args.calibrate {
        Some(profile) => Some(calibrate(profile, profile_bias, args, &result)?),
        None => None,
    };
    let is_written = calibrated.is_some();
    if let Some(path) = &args.common.out {
        let shown = &shown.shown;
        let html = report::evaluation::precision(&result, is_written, shown, &settings, path);
        write_file(path, &html)?;
        show_in_recordings(&inputs, path);
    }
    let output = PrecisionOutput {
        settings: &settings,
        precision: &result,
        calibrated,
        next: vec![next_command(args, &inputs, &result)],
    };
    context.print_checks(&output, || {
        let calibrated = output.calibrated.as_ref().map(Calibrated::text);
        precision_summary(&result, is_written).text()
            + &calibrated.unwrap_or_default()
            + &next_text(&output.next)
    })?;
    Ok(ExitStatus::of_loss(!result.left_out.is_empty()))
}

/// Returns the recordings and videos among the inputs: a file in a recording's folder stands for
/// the folder, and data sets, which `recordings/*` has too, are left out.
fn recordings_of(inputs: &[PathBuf], context: &Context) -> Result<Vec<PathBuf>, Failure> {
    let mut found = Vec::new();
    for input in inputs {
        let input = recording_of(input);
        if input.join(extract::report::FILE).is_file() && !input.join(SESSION_FILE).exists() {
            context.say(format!("{} is a data set: left out", input.display()));
        } else if !found.contains(&input) {
            found.push(input);
        }
    }
    if found.is_empty() {
        return Err(Failure::new(
            ExitStatus::Usage,
            "there are data sets alone, no recordings",
        )
        .next_step("give the folders of the recordings that they were made of"));
    }
    Ok(found)
}

/// Returns the folder that a file in a recording stands for; a video stands for itself.
fn recording_of(input: &Path) -> PathBuf {
    let ending = input.extension().unwrap_or_default().to_ascii_lowercase();
    if VIDEO_ENDINGS.iter().any(|video| ending == *video) {
        input.to_owned()
    } else {
        recordings::folder_of(input).to_owned()
    }
}

/// Returns the command to type after a measurement.
fn next_command(args: &PrecisionArgs, inputs: &[PathBuf], result: &Precision) -> String {
    let is_open = result.recordings.iter().all(|r| !r.identity.unique);
    let place = match &args.calibrate {
        Some(path) => Place {
            path: Some(path.clone()),
        },
        None => ProfileArg::default().place(),
    };
    match &place.path {
        None => String::from("smartdepthsync setup"),
        Some(_) if args.calibrate.is_some() => {
            format!("smartdepthsync record --duration 1m{}", place.option())
        }
        Some(_) if is_open && args.common.near.is_none() => {
            format!("smartdepthsync record {SHIFTED}{}", place.option())
        }
        Some(_) => recordings::calibrate_command(inputs, &place),
    }
}

/// Options of a recording that shows an end of the strobe train.
const SHIFTED: &str = "--shift 4ms --duration 1m";

/// Lets the reports of recordings lead to an evaluation in their folder.
fn show_in_recordings(inputs: &[PathBuf], page: &Path) {
    for folder in inputs {
        if let Err(error) = report::session::link_page(folder, page, None) {
            tracing::warn!("the report of {} is as it was: {error}", folder.display());
        }
    }
}

/// Adds the measured bias to the one that was applied, and writes it.
fn calibrate(
    profile: &Path,
    profile_bias: f64,
    args: &PrecisionArgs,
    result: &Precision,
) -> Result<Calibrated, Failure> {
    // What each recording left over, and what had been subtracted from it.
    let applied: Vec<f64> = result
        .recordings
        .iter()
        .map(|r| r.applied_bias_us.unwrap_or(profile_bias))
        .collect();
    let open = result.recordings.iter().any(|r| !r.identity.unique);
    let known = result.recordings.iter().zip(&applied);
    let known = known.filter(|(r, _)| r.identity.unique);
    let known: Vec<f64> = known.map(|(r, applied)| r.bias_us + applied).collect();
    let whole: Vec<f64> = result
        .recordings
        .iter()
        .zip(&applied)
        .map(|(r, applied)| {
            // Which flash is which is seen in a recording that shows an end of the train.
            let all = r.identity.candidates.iter();
            let all = all.map(|candidate| candidate.bias_us + applied);
            let middle = mean(&known);
            let nearest = all.min_by(|a, b| (a - middle).abs().total_cmp(&(b - middle).abs()));
            let is_open = !r.identity.unique && !known.is_empty();
            nearest.filter(|_| is_open).unwrap_or(r.bias_us + applied)
        })
        .collect();
    // A session's clocks are off by as much in all of its frames.
    let sigmas = result.recordings.iter();
    let sigmas = sigmas.map(|r| r.sigma_us.hypot(r.clocks_sigma_us));
    let sigmas: Vec<f64> = sigmas.collect();
    let bias = BiasStatistics::from_values(&whole, &sigmas)
        .ok_or_else(|| Failure::new(ExitStatus::Error, "no bias was measured"))?;
    if open && known.is_empty() && args.common.near.is_none() {
        let place = Place {
            path: Some(profile.to_owned()),
        };
        return Err(Failure::new(
            ExitStatus::Refused,
            format!(
                "the profile was not changed: the frames do not show where the train ends, so the bias is known only up to whole pitches of {} µs",
                args.common.train.pitch_us
            ),
        )
        .next_step(
            "record with the trigger moved, so that an end of the train comes into the picture, and give that recording too; or, if the bias is known to half a pitch, give it with --near",
        )
        .commands(vec![format!("smartdepthsync record {SHIFTED}{}", place.option())]));
    }
    let new = Calibrated {
        profile: profile.to_owned(),
        applied_bias_us: mean(&applied),
        bias_us: bias.mean_us,
        bias_sigma_us: bias.mean_sigma_us,
        measured: jiff::Zoned::now().date(),
    };
    write_bias(profile, new.bias_us, new.bias_sigma_us, new.measured)?;
    Ok(new)
}

fn run_drift(args: &DriftArgs, context: &Context) -> Result<ExitStatus, Failure> {
    args.common.check_targets()?;
    let mut settings = args.common.settings()?;
    let input = recording_of(&args.input);
    let evaluated = context.over_files(|monitor| {
        settings.monitor = monitor.clone();
        let recording = Footage::read(&input, &settings, None)?;
        drift::evaluate(recording, &settings)
    })?;
    if let Some(path) = &args.common.out {
        let html = report::evaluation::drift(&evaluated, &settings, path);
        write_file(path, &html)?;
        show_in_recordings(std::slice::from_ref(&input), path);
    }
    let output = DriftOutput {
        settings: &settings,
        drift: &evaluated.result,
        next: vec![recordings::calibrate_command(
            &[&input],
            &Place { path: None },
        )],
    };
    context.print_checks(&output, || {
        drift_summary(&evaluated.result).text() + &next_text(&output.next)
    })?;
    Ok(ExitStatus::Good)
}
