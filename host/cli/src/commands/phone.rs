//! `smartdepthsync phone imu|start|stop|get-video|get-files`: the app's four requests, one
//! at a time, and the files that it does not send.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Subcommand;
use serde::Serialize;
use serde_json::json;

use crate::advice::{TICK_SENSORS, at_phone};
use crate::context::Context;
use crate::options::number_in;
use crate::outcome::{ExitStatus, Failure};
use phone::adb;
use phone::requests::MAX_IMU_DURATION;
use phone::{ImuRequest, PhoneClient, PhoneError, Sensor, SensorRecording, Settings, VideoTarget};
use timebase::PhoneNanos;

/// Talk to the phone's app (OpenCamera Sensors, remote control switched on).
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    connection: ConnectionArgs,
    #[command(subcommand)]
    request: Request,
}

/// How to reach the phone.
#[derive(Clone, Debug, clap::Args)]
struct ConnectionArgs {
    /// The phone's address, as the app's dialog shows it; port 6969 unless given
    #[arg(long, global = true, value_name = "HOST[:PORT]")]
    phone: Option<String>,
    /// How long to wait for the phone, beyond the time that the request itself takes
    #[arg(long, global = true, value_name = "SECONDS", default_value = "15", value_parser = seconds)]
    timeout: Duration,
}

/// One of the app's requests.
#[derive(Debug, Subcommand)]
enum Request {
    /// Record the phone's motion sensors for a while
    Imu(ImuArgs),
    /// Start a video; prints the phase and duration of its frames
    Start,
    /// Stop the video
    Stop,
    /// Download the last video
    GetVideo(GetVideoArgs),
    /// Copy the other files of a video from the phone's storage, by `adb`
    GetFiles(GetFilesArgs),
}

/// Options of `phone imu`.
#[derive(Debug, clap::Args)]
struct ImuArgs {
    /// How long to record
    #[arg(long, default_value = "10", value_parser = imu_seconds)]
    seconds: Duration,
    /// Record the accelerometer too
    #[arg(long)]
    accel: bool,
    /// Record the magnetometer too
    #[arg(long)]
    magnetic: bool,
    /// Do not record the gyroscope
    #[arg(long)]
    no_gyro: bool,
    /// Save gyro.csv, accel.csv, magnetic.csv in this folder, as the app writes them
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Overwrite existing files
    #[arg(long)]
    overwrite: bool,
}

/// Options of `phone get-video`.
#[derive(Debug, clap::Args)]
struct GetVideoArgs {
    /// Folder for the video (it keeps a safe form of its name), or the file to write
    #[arg(long, value_name = "PATH", default_value = ".")]
    out: PathBuf,
    /// Overwrite an existing file
    #[arg(long)]
    overwrite: bool,
    /// The app has made a video since it was opened. Without one, the request ends the app,
    /// and a video that it would be recording: so it is not asked unless you say so
    #[arg(long)]
    recorded: bool,
    /// Largest video that is accepted, in bytes
    #[arg(long, value_name = "BYTES", default_value_t = 64 << 30)]
    max_bytes: u64,
    /// How long the app may take to finish the file before it sends it
    #[arg(long, value_name = "SECONDS", default_value = "120", value_parser = seconds)]
    ready: Duration,
}

/// Options of `phone get-files`.
#[derive(Debug, clap::Args)]
struct GetFilesArgs {
    /// The phase that `phone start` printed, or `session.json` has: it names the video
    #[arg(long, value_name = "NS")]
    phase: i64,
    /// Folder for the files, such as the recording's
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    out: PathBuf,
    /// Copy the video too
    #[arg(long)]
    video: bool,
}

/// Runs the command.
///
/// # Errors
///
/// The phone cannot be reached, does not keep to its protocol, or refuses; or
/// a file cannot be written. All are [`Failure`]s.
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    let mut settings = Settings {
        connect: args.connection.timeout.min(Duration::from_secs(5)),
        margin: args.connection.timeout,
        stop: context.interrupt.stop_signal(),
        ..Settings::default()
    };
    match &args.request {
        Request::GetFiles(files) => return get_files(files, context),
        Request::GetVideo(video) if !video.recorded => {
            return Err(PhoneError::Argument(
                "has the app made a video since it was opened? Without one it ends at this \
                 request. If it has, give --recorded"
                    .to_owned(),
            )
            .into());
        }
        Request::GetVideo(video) => {
            settings.max_video = video.max_bytes;
            settings.video_ready = video.ready;
        }
        Request::Imu(imu) => check_imu(imu)?,
        Request::Start | Request::Stop => {}
    }
    let address = args.connection.phone.as_deref().ok_or_else(|| {
        PhoneError::Argument(
            "which phone? Give --phone <host>, as the app's dialog shows it".to_owned(),
        )
    })?;
    ask(address, settings, &args.request, context).map_err(|failure| at_phone(failure, address))
}

fn ask(
    address: &str,
    settings: Settings,
    request: &Request,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    let mut client = PhoneClient::connect(address, settings)?;
    match request {
        Request::Imu(imu) => return record_imu(&mut client, imu, context),
        Request::Start => start(&mut client, context)?,
        Request::Stop => stop(&mut client, context)?,
        Request::GetVideo(video) => get_video(&mut client, video, context)?,
        Request::GetFiles(files) => return get_files(files, context),
    }
    Ok(ExitStatus::Good)
}

/// A recording of one sensor, as `--json` prints it.
#[derive(Debug, Serialize)]
struct SensorSummary {
    sensor: String,
    unit: &'static str,
    samples: usize,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
    rate_hz: Option<f64>,
    interval_max_us: Option<f64>,
    file: Option<PathBuf>,
}

impl SensorSummary {
    fn of(recording: &SensorRecording, file: Option<PathBuf>) -> Self {
        let times: Vec<i64> = recording.samples.iter().map(|s| s.time.0).collect();
        let (first_ns, last_ns) = (times.first().copied(), times.last().copied());
        let length_ns = last_ns
            .zip(first_ns)
            .map(|(to, from)| to.saturating_sub(from));
        let intervals = times.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
        Self {
            sensor: recording.sensor.to_string(),
            unit: recording.sensor.unit(),
            samples: times.len(),
            first_ns,
            last_ns,
            rate_hz: length_ns
                .filter(|&length| length > 0)
                .map(|length| (times.len() - 1) as f64 * 1e9 / length as f64),
            interval_max_us: intervals.max().map(|interval| interval as f64 * 1e-3),
            file,
        }
    }

    fn text(&self) -> String {
        if self.samples == 0 {
            return format!("{}: no samples: the phone lacks this sensor", self.sensor);
        }
        let mut text = format!("{}: {} samples", self.sensor, self.samples);
        if let (Some(rate), Some(longest)) = (self.rate_hz, self.interval_max_us) {
            text.push_str(&format!(
                ", {rate:.2} Hz (longest interval {longest:.1} µs)"
            ));
        }
        if let Some(file) = &self.file {
            text.push_str(&format!(", saved as {}", file.display()));
        }
        text
    }
}

fn imu_request(args: &ImuArgs) -> ImuRequest {
    ImuRequest {
        duration: args.seconds,
        accelerometer: args.accel,
        gyroscope: !args.no_gyro,
        magnetometer: args.magnetic,
    }
}

/// Refuses what cannot become a recording before the phone is bothered.
fn check_imu(args: &ImuArgs) -> Result<(), PhoneError> {
    let request = imu_request(args);
    request.line()?;
    let Some(folder) = &args.out else {
        return Ok(());
    };
    std::fs::create_dir_all(folder).map_err(|source| PhoneError::File {
        action: "save in",
        path: folder.clone(),
        source,
    })?;
    for sensor in Sensor::ALL {
        let path = folder.join(sensor.file_suffix());
        if request.wants(sensor) && !args.overwrite && path.symlink_metadata().is_ok() {
            return Err(PhoneError::TargetExists { path });
        }
    }
    Ok(())
}

fn record_imu(
    client: &mut PhoneClient,
    args: &ImuArgs,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    let request = imu_request(args);
    let bar = context.spinner();
    let seconds = args.seconds.as_secs_f64();
    bar.set_message(format!("recording on the phone for {seconds:.1} s"));
    bar.enable_steady_tick(Duration::from_millis(200));
    let recording = client.imu(request);
    bar.finish_and_clear();
    let recording = recording?;
    if let (true, Some(&sensor)) = (recording.recordings.is_empty(), recording.missing.first()) {
        return Err(PhoneError::SensorMissing { sensor }.into());
    }
    let mut summaries = Vec::new();
    for recording in &recording.recordings {
        let file = match &args.out {
            Some(folder) if !recording.samples.is_empty() => {
                let path = folder.join(recording.sensor.file_suffix());
                phone::save_samples(&path, &recording.samples, args.overwrite)?;
                Some(path)
            }
            _ => None,
        };
        summaries.push(SensorSummary::of(recording, file));
    }
    /// What `--json` prints.
    #[derive(Serialize)]
    struct Summaries<'a> {
        sensors: &'a [SensorSummary],
        /// Sensors that were asked for and have no file.
        missing: Vec<String>,
    }
    let missing: Vec<String> = recording.missing.iter().map(Sensor::to_string).collect();
    let empty = summaries.iter().any(|summary| summary.samples == 0);
    let printed = Summaries {
        sensors: &summaries,
        missing,
    };
    context.print(&printed, || {
        let came = summaries.iter().map(SensorSummary::text);
        let missing = &printed.missing;
        let missing = missing
            .iter()
            .map(|sensor| format!("{sensor}: the phone sent no file: {TICK_SENSORS}"));
        came.chain(missing).collect::<Vec<_>>().join("\n")
    })?;
    Ok(ExitStatus::of_loss(empty || !recording.missing.is_empty()))
}

fn start(client: &mut PhoneClient, context: &Context) -> Result<(), Failure> {
    #[derive(Serialize)]
    struct Started {
        app_version: Option<&'static str>,
        phase_ns: i64,
        frame_duration_ns: f64,
        exposure_ns: Option<u64>,
    }
    // A phone that records already is left alone: the request would stop its video.
    let asked = client.clock()?;
    let start = client.start_video(asked).map_err(|error| {
        if !error.is_before_request() {
            context.say(format!(
                "{error}: making sure that no video runs on the phone"
            ));
        }
        client.undo_start(error)
    })?;
    let started = Started {
        app_version: client.version().map(|v| v.as_str()),
        phase_ns: start.phase.0,
        frame_duration_ns: start.frame_duration_ns,
        exposure_ns: start.exposure_ns,
    };
    context.print(&started, || {
        let exposure = match started.exposure_ns {
            Some(ns) => format!("{:.1} us", ns as f64 * 1e-3),
            None => "not reported".to_owned(),
        };
        format!(
            "video started\n  phase           {} ns of the phone's clock\n  frame duration  {:.3} us ({:.4} fps)\n  exposure        {exposure}",
            started.phase_ns,
            started.frame_duration_ns * 1e-3,
            1e9 / started.frame_duration_ns,
        )
    })
}

fn stop(client: &mut PhoneClient, context: &Context) -> Result<(), Failure> {
    client.stop_video()?;
    context.print(&json!({ "stopped": true }), || "video stopped".to_owned())
}

fn get_video(
    client: &mut PhoneClient,
    args: &GetVideoArgs,
    context: &Context,
) -> Result<(), Failure> {
    #[derive(Serialize)]
    struct Saved<'a> {
        path: &'a Path,
        bytes: u64,
        phone_name: &'a str,
        seconds: f64,
    }
    let target = if args.out.is_dir() {
        VideoTarget::Folder(args.out.clone())
    } else {
        VideoTarget::File(args.out.clone())
    };
    let template = "{bar:30} {bytes}/{total_bytes} {bytes_per_sec}, {eta} left";
    let bar = context.progress(Some(0), template);
    let begin = Instant::now();
    let saved = client.get_video(&target, args.overwrite, &mut |received, size| {
        bar.set_length(size);
        bar.set_position(received);
    });
    bar.finish_and_clear();
    let saved = saved?;
    let report = Saved {
        path: &saved.path,
        bytes: saved.size,
        phone_name: &saved.phone_name,
        seconds: begin.elapsed().as_secs_f64(),
    };
    context.print(&report, || {
        format!("{}: {} bytes", saved.path.display(), saved.size)
    })
}

fn get_files(args: &GetFilesArgs, context: &Context) -> Result<ExitStatus, Failure> {
    let phase = PhoneNanos(args.phase);
    let stop = context.interrupt.stop_signal();
    let copied = adb::fetch(phase, &args.out, args.video, &stop);
    let files = copied.map_err(|error| {
        context.say(format!("by MTP: {}", adb::copy_command(phase, &args.out)));
        PhoneError::from(error)
    })?;
    context.print(&BTreeMap::from([("files", &files)]), || {
        let lines = files.iter().map(|path| path.display().to_string());
        lines.collect::<Vec<_>>().join("\n")
    })?;
    Ok(ExitStatus::Good)
}

fn seconds(text: &str) -> Result<Duration, String> {
    number_in(0.01..=86_400.0, text, "seconds, 0.01 to 86400").map(Duration::from_secs_f64)
}

fn imu_seconds(text: &str) -> Result<Duration, String> {
    let most = MAX_IMU_DURATION.as_secs_f64();
    let seconds = number_in(0.001..=most, text, &format!("seconds, 0.001 to {most}"))?;
    // The app counts whole milliseconds.
    Ok(Duration::from_millis((seconds * 1e3).round() as u64))
}
