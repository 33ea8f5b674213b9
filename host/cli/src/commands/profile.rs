//! `smartdepthsync profile`: make, check and teach a rig profile.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Subcommand;
use serde::Serialize;

use super::calibration;
use super::setup::CameraArg;
use crate::context::Context;
use crate::new_profile::{self, Camera};
use crate::outcome::{ExitStatus, Failure, write_file};
use crate::recordings::{self, RecordingArg};
use crate::rig_profile::ProfileArg;
use clock::frames::{LearntFrames, frame_period};
use evaluate::led::calibration::Calibration;
use phone::rows::RowError;
use phone::{frame_timestamps, video_files};
use recording::camera::{DEFAULT_CAMERA, Model};
use recording::kalibr::{self, KalibrError};
use recording::profile::{DEFAULT, Learnt, MAX_LENGTH, Profile};
use recording::session_file::SessionFile;
use recording::strobes::SeenExposures;
use report::summary::facts_text;
use session::learn;
use system::ReadMonitor;

/// Options of `profile`.
#[derive(Debug, clap::Args)]
pub(crate) struct ProfileArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Write a commented profile to start from; never overwrites
    #[command(after_help = "Example: smartdepthsync profile init rig.toml --camera oak")]
    Init {
        /// The file to write
        file: PathBuf,
        #[command(flatten)]
        camera: CameraArg,
    },
    /// Check a profile and print it with all defaults filled in
    #[command(after_help = "Example: smartdepthsync profile check rig.toml")]
    Check {
        /// The profile
        file: PathBuf,
    },
    /// Learn the phones' frame periods, from two twists the rates of their clocks, and what
    /// photodiode and LED have shown
    #[command(after_help = "Example: smartdepthsync profile learn recordings/walk")]
    Learn {
        #[command(flatten)]
        recording: RecordingArg,
        #[command(flatten)]
        profile: ProfileArg,
        /// Phone to learn about, if the rig has several [default: all of them]
        #[arg(long, value_name = "NAME")]
        phone: Option<String>,
        /// The app's file of frame timestamps, if it is not in the recording's folder; of
        /// several phones it is the reference's, or that of --phone
        #[arg(long, value_name = "FILE")]
        timestamps: Option<PathBuf>,
    },
    /// Import intrinsics and poses of the cameras from Kalibr's camchain-imucam.yaml
    #[command(
        after_help = "Example: smartdepthsync profile import-kalibr rig.toml chain-camchain-imucam.yaml"
    )]
    ImportKalibr {
        /// Profile to update; its comments are kept
        file: PathBuf,
        /// The result of kalibr_calibrate_imu_camera: cam0 is the phone, cam1 the depth
        /// camera's colour
        #[arg(value_name = "CAMCHAIN")]
        chain: PathBuf,
        /// Phone that is cam0, if the rig has several [default: the reference]
        #[arg(long, value_name = "NAME")]
        phone: Option<String>,
    },
}

/// Runs `profile`.
///
/// # Errors
///
/// A file cannot be read or written, or nothing can be learnt.
pub(crate) fn run(args: &ProfileArgs, context: &Context) -> Result<ExitStatus, Failure> {
    match &args.action {
        Action::Init { file, camera } => init(file, camera, context),
        Action::Check { file } => {
            let profile = Profile::load(file)?;
            let text = profile.to_toml().map_err(|error| {
                let message = format!("the profile has no TOML form: {error}");
                Failure::new(ExitStatus::Error, message)
            })?;
            context.print(&profile, || text)?;
            Ok(ExitStatus::Good)
        }
        Action::Learn {
            recording,
            profile,
            phone,
            timestamps,
        } => {
            let place = profile.place();
            let file = place.file()?;
            // A profile that cannot be read is reported first.
            read(file)?;
            let recording = recording.find(context)?;
            let folder = recordings::folder_of(&recording);
            let session = SessionFile::load(folder)?;
            let (phone, timestamps) = (phone.as_deref(), timestamps.as_deref());
            let learnt = context
                .over_files(|monitor| learn(file, folder, &session, phone, timestamps, monitor))?;
            let depth = calibration::write_depth(file, &session)?;
            let rows = calibration::write_rows(file, folder, &session, context)?;
            let learnt = Learned {
                learnt,
                depth,
                rows,
            };
            context.print(&learnt, || learnt.text())?;
            Ok(ExitStatus::Good)
        }
        Action::ImportKalibr { file, chain, phone } => {
            import(file, chain, phone.as_deref(), context)
        }
    }
}

fn import(
    file: &Path,
    chain: &Path,
    phone: Option<&str>,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    let text = read(file)?;
    let profile = Profile::parse(&text, Some(file))?;
    if let Some(name) = phone
        && !profile.all_phones().any(|phone| phone.name == name)
    {
        let message = format!("the profile has no phone called {name:?}");
        return Err(Failure::new(ExitStatus::Usage, message)
            .next_step("give --phone as the phone is called in the profile"));
    }
    let phone = phone.unwrap_or(&profile.phone.name);
    let (text, imported) = kalibr::into_profile(&text, file, Some(phone), &read(chain)?).map_err(
        |error| match error {
            KalibrError::Profile(error) => error.into(),
            KalibrError::Chain(_) => Failure::new(
                ExitStatus::Error,
                format!("{}: {error}", chain.display()),
            )
            .next_step(
                "calibrate cameras and IMU with Kalibr on what `extract --format kalibr` writes",
            ),
        },
    )?;
    write_file(file, &text)?;
    context.show(&imported)?;
    Ok(ExitStatus::Good)
}

fn init(file: &Path, given: &CameraArg, context: &Context) -> Result<ExitStatus, Failure> {
    let model = given.camera.or_else(|| Model::find(DEFAULT_CAMERA));
    let text = match model {
        Some(model) if *given != CameraArg::default() => {
            let mut camera = Camera::new(model, given.mode(model)?);
            camera.exposure_us = given.exposure_us(camera.mode)?;
            new_profile::text(&camera, &[])?
        }
        _ => DEFAULT.to_owned(),
    };
    File::create_new(file)
        .and_then(|mut created| created.write_all(text.as_bytes()))
        .map_err(|error| Failure::file("write", file, &error))?;
    context.show(&BTreeMap::from([("profile", file.display().to_string())]))?;
    Ok(ExitStatus::Good)
}

/// Lessons of a recording, for `--json`.
#[derive(Debug, Serialize)]
struct Learned {
    learnt: Vec<Lesson>,
    /// The depth exposures that a photodiode saw.
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<SeenExposures>,
    /// The phone's rows by the LED.
    #[serde(skip_serializing_if = "Option::is_none")]
    rows: Option<Calibration>,
}

impl Learned {
    fn text(&self) -> String {
        let mut text: String = self.learnt.iter().map(Lesson::text).collect();
        let depth = self.depth.as_ref().map(SeenExposures::text);
        let rows = self.rows.as_ref().map(Calibration::text);
        for line in depth.into_iter().chain(rows) {
            text += &format!("{line}\n");
        }
        text
    }
}

/// The clocks of a phone as learnt from a recording, for `--json`.
#[derive(Debug, Serialize)]
pub(crate) struct Lesson {
    /// The phone's name.
    phone: String,
    /// Where it was written to.
    profile: PathBuf,
    learnt: Learnt,
    frames: usize,
    missing_frames: u64,
    timestamp_jitter_ns: f64,
}

/// Writes what a recording teaches about the clocks of one phone, or of all, into a profile.
/// Frame timestamps are those in the recording's folder unless they are given.
///
/// # Errors
///
/// The session knows no such phone, its timestamps are missing or teach nothing, or the
/// profile cannot be read or written.
pub(crate) fn learn(
    file: &Path,
    folder: &Path,
    session: &SessionFile,
    phone: Option<&str>,
    timestamps: Option<&Path>,
    monitor: &ReadMonitor,
) -> Result<Vec<Lesson>, Failure> {
    let reference = session.profile.phone.name.as_str();
    if let Some(timestamps) = timestamps {
        let name = phone.unwrap_or(reference);
        return Ok(vec![learn_from(file, session, name, timestamps, monitor)?]);
    }
    let names: Vec<&str> = match phone {
        Some(name) => vec![name],
        None => session
            .profile
            .all_phones()
            .map(|phone| phone.name.as_str())
            .collect(),
    };
    names
        .into_iter()
        .map(|name| {
            let place = folder.join(session.phone_folder(name));
            let files = video_files::find(&place, None).ok().flatten();
            let timestamps = files.and_then(|files| files.frames).ok_or_else(|| {
                let message = format!("no frame timestamps of {name} in {}", place.display());
                Failure::new(ExitStatus::Phone, message)
                    .next_step("fetch the phone's files into that folder, or give --timestamps")
            })?;
            learn_from(file, session, name, &timestamps, monitor)
        })
        .collect()
}

fn learn_from(
    file: &Path,
    session: &SessionFile,
    phone: &str,
    timestamps: &Path,
    monitor: &ReadMonitor,
) -> Result<Lesson, Failure> {
    let text = read(file)?;
    let shown = timestamps.display();
    let times = frame_timestamps::read(timestamps, monitor).map_err(|error| match error {
        RowError::Io(error) => Failure::file("read", timestamps, &error),
        RowError::Bad(row) => Failure::new(ExitStatus::Usage, format!("{shown}: {row}")).next_step(
            "give the app's `..._timestamps.csv` of that recording: one integer of nanoseconds a \
             line",
        ),
    })?;
    let period = frame_period(&times).map_err(|error| {
        Failure::new(ExitStatus::Refused, format!("{shown}: {error}"))
            .next_step("give the timestamps of a longer recording, whole as the app wrote them")
    })?;
    let recorded = session.phone(phone).ok_or_else(|| {
        Failure::new(
            ExitStatus::Usage,
            format!("the recording has no phone called {phone:?}"),
        )
        .next_step("give --phone as the phone is called in the recording's session.json")
    })?;
    let skew = learn::skew_of_twists(recorded);
    let twists = recorded.twists.iter().filter(|twist| twist.accepted);
    let origin = learn::Origin {
        board_id: session.board.as_ref().map(|board| board.id.as_str()),
        // A session file has the time when it began; one that has not is taken for today's.
        time: session.began().unwrap_or_else(jiff::Timestamp::now),
        board_temperature_c: twists
            .filter_map(|twist| twist.board_temperature_c)
            .next_back(),
    };
    let frames = LearntFrames {
        period_ns: period.period_ns,
        sigma_ns: period.sigma_ns,
        jitter_ns: Some(period.jitter_ns),
        exposure_us: recorded.video.and_then(|video| video.exposure_us()),
    };
    let learnt = learn::learnt(&frames, skew, &origin);
    let text = learn::into_profile(&text, file, Some(phone), &learnt)?;
    write_file(file, &text)?;
    Ok(Lesson {
        phone: phone.to_owned(),
        profile: file.to_owned(),
        frames: period.frames,
        missing_frames: period.missing,
        timestamp_jitter_ns: period.jitter_ns,
        learnt,
    })
}

impl Lesson {
    pub(crate) fn text(&self) -> String {
        let learnt = &self.learnt;
        let skew = match (learnt.skew, learnt.skew_sigma) {
            (Some(skew), Some(sigma)) => {
                format!("{:+.4} ± {:.4} ppm", skew * 1e6, sigma * 1e6)
            }
            _ => String::from(
                "not learnt: it takes two twists at least a minute apart (`record --calibrate`)",
            ),
        };
        let period = format!(
            "{:.4} ± {:.4} ns, from {} frames ({} missing), jitter {:.0} ns",
            learnt.frame_period_ns,
            learnt.frame_period_sigma_ns,
            self.frames,
            self.missing_frames,
            self.timestamp_jitter_ns
        );
        facts_text(&[
            ("phone", self.phone.clone()),
            ("frame period", period),
            ("skew", skew),
            ("written to", self.profile.display().to_string()),
        ])
    }
}

fn read(path: &Path) -> Result<String, Failure> {
    system::read_text(path, MAX_LENGTH).map_err(|error| Failure::file("read", path, &error))
}
