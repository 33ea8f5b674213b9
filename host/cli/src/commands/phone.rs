//! `smartdepthsync phone imu|start|stop|get-video|get-files`: the app's four requests, one
//! at a time, and the files that it does not send.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Subcommand;
use serde::Serialize;
use serde_json::json;

use crate::advice::at_phone;
use crate::context::Context;
use crate::decimal::parse_real_time;
use crate::outcome::{ExitStatus, Failure, refuse_to_overwrite};
use crate::rig_profile::ProfileArg;
use clock::PhoneNanos;
use phone::adb;
use phone::requests::MAX_IMU_DURATION;
use phone::{PhoneClient, PhoneError, Settings};

/// Control the phone's app (OpenCamera Sensors, with its remote control switched on).
#[derive(Debug, clap::Args)]
pub(crate) struct PhoneArgs {
    #[command(flatten)]
    connection: ConnectionArgs,
    #[command(subcommand)]
    request: Request,
}

/// Options for reaching the phone.
#[derive(Clone, Debug, clap::Args)]
struct ConnectionArgs {
    /// Address of the phone, as the app's dialog shows it; without a port, 6969 [default: the
    /// profile's]
    #[arg(long, global = true, value_name = "HOST[:PORT]")]
    phone: Option<String>,
    /// Longest wait for the phone, in addition to the time that the request itself takes
    #[arg(long, global = true, value_name = "TIME", default_value = "15s", value_parser = parse_real_time)]
    timeout: Duration,
}

/// One of the app's requests.
#[derive(Debug, Subcommand)]
enum Request {
    /// Record the phone's gyroscope for a while
    Imu(ImuArgs),
    /// Start a video, and print the phase and duration of its frames
    #[command(after_help = "Example: smartdepthsync phone start")]
    Start,
    /// Stop the video
    #[command(after_help = "Example: smartdepthsync phone stop")]
    Stop,
    /// Download the last video
    GetVideo(GetVideoArgs),
    /// Copy the other files of a video from the phone's storage, by `adb`
    GetFiles(GetFilesArgs),
}

/// Options of `phone imu`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync phone imu --duration 5s --out gyro.csv")]
struct ImuArgs {
    /// Length of the recording
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = imu_duration)]
    duration: Duration,
    /// Save the samples to this file, in the app's format
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the file if it is there
    #[arg(long)]
    overwrite: bool,
}

/// Options of `phone get-video`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync phone get-video --recorded --out recordings/walk")]
struct GetVideoArgs {
    /// Folder for the video, which keeps a safe form of its name, or the file to write
    #[arg(short, long, value_name = "PATH", default_value = ".")]
    out: PathBuf,
    /// Overwrite an existing file
    #[arg(long)]
    overwrite: bool,
    /// Confirm that the app has made a video since it was opened. Without one, the request crashes
    /// the app, and with it a recording in progress
    #[arg(long)]
    recorded: bool,
    /// Longest wait for the app to finish the file
    #[arg(long, value_name = "TIME", default_value = "120s", value_parser = parse_real_time)]
    ready: Duration,
}

/// Options of `phone get-files`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: smartdepthsync phone get-files --phase 1234567890 --out recordings/walk"
)]
struct GetFilesArgs {
    /// Phase that `phone start` printed or `session.json` holds, which identifies the video
    #[arg(long, value_name = "NS")]
    phase: i64,
    /// Folder for the files, such as the recording's
    #[arg(short, long, value_name = "FOLDER", default_value = ".")]
    out: PathBuf,
    /// Also copy the video
    #[arg(long)]
    video: bool,
}

/// Runs the command.
///
/// # Errors
///
/// The phone cannot be reached, does not keep to its protocol, or refuses; or
/// a file cannot be written. All are [`Failure`]s.
pub(crate) fn run(args: &PhoneArgs, context: &Context) -> Result<ExitStatus, Failure> {
    let mut settings = Settings {
        connect: args.connection.timeout.min(Duration::from_secs(5)),
        margin: args.connection.timeout,
        cancel: context.interrupt.cancel(),
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
        Request::GetVideo(video) => settings.video_ready = video.ready,
        Request::Imu(imu) => {
            if let Some(path) = &imu.out {
                refuse_to_overwrite(path, imu.overwrite)?;
            }
        }
        Request::Start | Request::Stop => {}
    }
    let address = match &args.connection.phone {
        Some(address) => address.clone(),
        None => ProfileArg::default().load()?.0.phone.address,
    };
    if address.is_empty() {
        return Err(PhoneError::Argument(
            "which phone? Give --phone <host>, as the app's dialog shows it".to_owned(),
        )
        .into());
    }
    ask(&address, settings, &args.request, context).map_err(|failure| at_phone(failure, &address))
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

fn record_imu(
    client: &mut PhoneClient,
    args: &ImuArgs,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    #[derive(Serialize)]
    struct Recorded {
        samples: usize,
        first_ns: Option<i64>,
        last_ns: Option<i64>,
        rate_hz: Option<f64>,
        interval_max_us: Option<f64>,
        file: Option<String>,
    }
    let bar = context.spinner();
    let seconds = args.duration.as_secs_f64();
    bar.set_message(format!("recording on the phone for {seconds:.1} s"));
    bar.enable_steady_tick(Duration::from_millis(200));
    let samples = client.gyroscope(args.duration);
    bar.finish_and_clear();
    let samples = samples?;
    if let Some(path) = &args.out {
        phone::save_samples(path, &samples, args.overwrite)?;
    }
    let times: Vec<i64> = samples.iter().map(|sample| sample.time.0).collect();
    let (first_ns, last_ns) = (times.first().copied(), times.last().copied());
    let length_ns = last_ns
        .zip(first_ns)
        .map(|(to, from)| to.saturating_sub(from))
        .filter(|&length| length > 0);
    let intervals = times.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
    context.show(&Recorded {
        samples: times.len(),
        first_ns,
        last_ns,
        rate_hz: length_ns.map(|length| (times.len() - 1) as f64 * 1e9 / length as f64),
        interval_max_us: intervals.max().map(|interval| interval as f64 * 1e-3),
        file: args.out.as_ref().map(|path| path.display().to_string()),
    })?;
    Ok(ExitStatus::of_loss(samples.is_empty()))
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
    let asked = client.clock()?.map(Into::into);
    let start = client.start_video(asked).map_err(|error| {
        if !error.is_before_request() {
            context.say(format!(
                "{error}: making sure that no video runs on the phone"
            ));
        }
        client.undo_start(error)
    })?;
    context.show(&Started {
        app_version: client.version().map(|v| v.as_str()),
        phase_ns: start.phase.0,
        frame_duration_ns: start.frame_duration_ns,
        exposure_ns: start.exposure_ns,
    })
}

fn stop(client: &mut PhoneClient, context: &Context) -> Result<(), Failure> {
    // The app answers a stop with success even if no video runs. Where it does not say whether
    // one does, it is stopped all the same.
    let recorded = client.is_recording();
    if recorded.is_err() {
        client.reconnect()?;
    }
    client.stop_video()?;
    match &recorded {
        Ok(false) => context.say("no video was running"),
        Ok(true) => {}
        Err(error) => context.say(format!("whether a video was running is not known: {error}")),
    }
    let stopped = match &recorded {
        Ok(true) => "stopped: yes",
        Ok(false) => "stopped: no",
        Err(_) => "stopped: not reported",
    };
    context.print(&json!({ "stopped": recorded.ok() }), || stopped.to_owned())
}

fn get_video(
    client: &mut PhoneClient,
    args: &GetVideoArgs,
    context: &Context,
) -> Result<(), Failure> {
    #[derive(Serialize)]
    struct Saved<'a> {
        path: String,
        bytes: u64,
        phone_name: &'a str,
        seconds: f64,
    }
    let template = "{bar:30} {bytes}/{total_bytes} {bytes_per_sec}, {eta} left";
    let bar = context.progress(Some(0), template);
    let begin = Instant::now();
    let saved = client.get_video(&args.out, args.overwrite, &mut |received, size| {
        bar.set_length(size);
        bar.set_position(received);
    });
    bar.finish_and_clear();
    let saved = saved?;
    context.show(&Saved {
        path: saved.path.display().to_string(),
        bytes: saved.size,
        phone_name: &saved.phone_name,
        seconds: begin.elapsed().as_secs_f64(),
    })
}

fn get_files(args: &GetFilesArgs, context: &Context) -> Result<ExitStatus, Failure> {
    let phase = PhoneNanos(args.phase);
    let cancel = context.interrupt.cancel();
    let copied = adb::fetch(phase, &args.out, args.video, &cancel);
    let files = copied.map_err(|error| {
        context.say(format!("by MTP: {}", adb::copy_command(phase, &args.out)));
        PhoneError::from(error)
    })?;
    let files: Vec<String> = files
        .iter()
        .map(|file| file.display().to_string())
        .collect();
    context.show(&BTreeMap::from([("files", files)]))?;
    Ok(ExitStatus::Good)
}

fn imu_duration(text: &str) -> Result<Duration, String> {
    let time = parse_real_time(text)?;
    // The app counts whole milliseconds.
    let time = Duration::from_millis((time.as_secs_f64() * 1e3).round() as u64);
    if time.is_zero() || time > MAX_IMU_DURATION {
        return Err(format!("expected 1ms to {} s", MAX_IMU_DURATION.as_secs()));
    }
    Ok(time)
}
