//! `smartdepthsync sync`: the clocks of any two or more recordings with gyroscopes.

mod plot;
mod related;
mod write;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use gyro_files::GyroRecording;
use serde::Serialize;
use twist_sync::network::Network;
use twist_sync::{GyroTrack, WithSigma};

use super::offset::{delay, in_one_unit, plot as twist_plot};
use crate::advice;
use crate::context::Context;
use crate::decimal::seconds;
use crate::outcome::{ExitStatus, Failure};
use related::{Related, Whole};

/// Loops and clocks are looked at so often over a recording.
const LOOKS: u32 = 60;

/// Options of `sync`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Recordings with gyroscopes that were fixed to each other: CSV (ours, the app's,
    /// EuRoC, Sensor Logger), MCAP or its folder (ours, ROS 2 bags), an Azure Kinect's mkv, a
    /// GoPro's mp4; other cameras' videos by the Python package telemetry-parser. FILE@/TOPIC
    /// names one of several topics
    #[arg(value_name = "FILE", num_args = 2.., required = true)]
    pub(crate) recordings: Vec<PathBuf>,
    /// Write the timestamps of all others in the time of the first one's clock, as CSV into
    /// this folder; of videos also when their rows were exposed
    #[arg(long, value_name = "FOLDER")]
    pub(crate) write: Option<PathBuf>,
    /// Draw the relations: of two twists both gyroscopes before and after, else the
    /// estimates over time
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) plot: Option<PathBuf>,
    /// Delay of each gyroscope's low-pass in µs, in the order of the recordings
    #[arg(long, value_name = "US", value_parser = delay, value_delimiter = ',', allow_negative_numbers = true)]
    pub(crate) delay_us: Vec<f64>,
}

/// What `sync --json` prints.
#[derive(Debug, Serialize)]
struct Output {
    accepted: bool,
    /// Why not, if it is not accepted.
    refusal: Option<String>,
    recordings: Vec<Input>,
    pairs: Vec<PairOutput>,
    clocks: Vec<ClockOutput>,
    loops: Vec<LoopOutput>,
    warnings: Vec<String>,
}

/// Recordings are named by their number, from 1.
#[derive(Debug, Serialize)]
struct Input {
    number: usize,
    file: String,
    form: String,
    samples: usize,
    duration_s: f64,
    delay_s: f64,
    damage: Vec<String>,
}

/// The relation of two recordings' clocks: `b = a + offset + skew · (a − reference)`.
#[derive(Debug, Serialize)]
struct PairOutput {
    a: usize,
    b: usize,
    accepted: bool,
    refusal: Option<String>,
    /// Time of clock a at which the rest holds.
    reference_ns: Option<i64>,
    offset_ns: Option<i64>,
    offset_sigma_us: Option<f64>,
    skew_ppm: Option<f64>,
    skew_sigma_ppm: Option<f64>,
    /// Windows that were looked at, used, and left out because they contradict the rest.
    windows: usize,
    used: usize,
    contradicting: usize,
    faults: Vec<String>,
    left_out: Vec<String>,
}

/// A recording's clock against the first one's in the one solution of all pairs.
#[derive(Debug, Serialize)]
struct ClockOutput {
    recording: usize,
    /// Time of the first one's clock at which offset and sigma hold: the middle.
    reference_ns: i64,
    offset_ns: i64,
    sigma_us: f64,
    /// The largest sigma over the first recording.
    largest_sigma_us: f64,
}

/// By how much a loop of three does not close, over the first recording.
#[derive(Debug, Serialize)]
struct LoopOutput {
    recordings: [usize; 3],
    closure_rms_us: f64,
    /// The sum of the variances of its pairs says so much.
    sigma_rms_us: f64,
}

/// Relates the clocks of recordings.
///
/// # Errors
///
/// A file cannot be read or written, or has no gyroscope. Recordings that cannot be
/// related are no error but [`ExitStatus::Refused`].
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    if args.delay_us.len() > args.recordings.len() {
        return Err(Failure::new(
            ExitStatus::Usage,
            format!(
                "--delay-us has {} values for {} recordings",
                args.delay_us.len(),
                args.recordings.len()
            ),
        )
        .next_step("give one for each recording, in their order"));
    }
    let files: Vec<_> = args.recordings.iter().map(|path| topic_of(path)).collect();
    let mut recordings: Vec<GyroRecording> = Vec::new();
    for (file, topic) in &files {
        let read = gyro_files::read(file, topic.as_deref());
        recordings.push(read.map_err(|error| advice::gyro_file(file, error))?);
    }
    let mut tracks: Vec<_> = recordings.iter().map(GyroRecording::track).collect();
    let mut warnings = Vec::new();
    if let [first, others @ ..] = tracks.as_mut_slice() {
        for (k, other) in others.iter_mut().enumerate() {
            let names = ["recording 1", &format!("recording {}", k + 2)];
            warnings.extend(in_one_unit([first, other], names));
        }
    }
    warnings.extend(recordings.iter().enumerate().filter_map(coarse_stamps));
    let delays: Vec<f64> = (0..tracks.len())
        .map(|k| args.delay_us.get(k).map_or(0.0, |us| us * 1e-6))
        .collect();
    let count = tracks.len();
    let pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| [a, b]));
    let pairs: Vec<Related> = pairs
        .map(|of| related::related(of, &tracks, &delays))
        .collect();
    let good = pairs.iter().filter_map(|related| {
        let [a, b] = related.of;
        let course = related.course.as_ref().ok()?.clone();
        Some(twist_sync::network::Pair { a, b, course })
    });
    let network = Network::new(count, good.collect());
    let mut output = Output {
        accepted: network.is_ok(),
        refusal: network.as_ref().err().map(ToString::to_string),
        recordings: inputs(args, &recordings, &delays),
        pairs: pairs
            .iter()
            .map(|related| pair(related, &recordings))
            .collect(),
        clocks: Vec::new(),
        loops: Vec::new(),
        warnings,
    };
    if let Some(path) = &args.plot {
        let twist = match pairs.as_slice() {
            [only] => only.whole.as_deref(),
            _ => None,
        };
        let svg = match twist {
            Some(Whole { result, options }) => {
                // With the offset of the clocks, not that of the first samples.
                let between = recordings[1].first().saturating_sub(recordings[0].first());
                let between_s = between as f64 * 1e-9;
                let b = GyroTrack {
                    epoch_s: tracks[1].epoch_s + between_s,
                    ..tracks[1].clone()
                };
                let mut result = result.clone();
                if let Ok(estimate) = &mut result {
                    estimate.clock.offset += between_s;
                }
                let names = ["recording 1", "recording 2"];
                twist_plot::svg(names, [&tracks[0], &b], &result, options)
            }
            None => plot::svg(&pairs),
        };
        twist_plot::write(path, &svg, context)?;
    }
    if let Ok(network) = &network {
        let length_s = tracks[0].t.last().copied().unwrap_or(0.0);
        (output.clocks, output.loops) = solution(network, length_s, &recordings);
        if let Some(folder) = &args.write {
            let names: Vec<&Path> = files.iter().map(|(file, _)| file.as_path()).collect();
            write::timestamps(folder, network, &recordings, &names)?;
            context.say(format!("written: {}", folder.display()));
        }
    }
    let lossy = recordings.iter().any(|r| !r.damage.is_empty());
    context.print(&output, || text(&output))?;
    Ok(if output.accepted {
        ExitStatus::of_loss(lossy)
    } else {
        ExitStatus::Refused
    })
}

/// What the estimates do not know of a recording's times.
fn coarse_stamps((k, recording): (usize, &GyroRecording)) -> Option<String> {
    let step_us = recording.stamp_step_ns? as f64 * 1e-3;
    // The standard deviation of what is rounded.
    let sigma_us = step_us / 12.0_f64.sqrt();
    Some(format!(
        "recording {}: its camera stamps to {:.0} ms, which moves its clock by {sigma_us:.0} µs (1-sigma); \
         no sigma here contains that",
        k + 1,
        step_us * 1e-3
    ))
}

/// Takes `FILE@/TOPIC` apart.
fn topic_of(path: &Path) -> (PathBuf, Option<String>) {
    let split = path.to_str().and_then(|text| text.rsplit_once("@/"));
    match split {
        Some((file, topic)) if !path.exists() => (file.into(), Some(format!("/{topic}"))),
        _ => (path.to_owned(), None),
    }
}

fn inputs(args: &Args, recordings: &[GyroRecording], delays: &[f64]) -> Vec<Input> {
    let all = args.recordings.iter().zip(recordings).zip(delays);
    all.enumerate()
        .map(|(k, ((path, recording), &delay_s))| {
            let last = recording.times.last().copied().unwrap_or(0);
            Input {
                number: k + 1,
                file: path.display().to_string(),
                form: recording.form.clone(),
                samples: recording.times.len(),
                duration_s: last.saturating_sub(recording.first()) as f64 * 1e-9,
                delay_s,
                damage: recording.damage.clone(),
            }
        })
        .collect()
}

/// Seconds as whole nanoseconds from a time on.
fn nanos_from(first: i64, seconds: f64) -> i64 {
    first.saturating_add((seconds * 1e9).round() as i64)
}

fn pair(related: &Related, recordings: &[GyroRecording]) -> PairOutput {
    let [a, b] = related.of;
    let (of_a, of_b) = (&recordings[a], &recordings[b]);
    let course = related.course.as_ref().ok();
    let middle = course.map(|course| {
        let (from, to) = course.span();
        course.at(0.5 * (from + to))
    });
    let between = of_b.first().saturating_sub(of_a.first());
    PairOutput {
        a: a + 1,
        b: b + 1,
        accepted: course.is_some(),
        refusal: related.course.as_ref().err().cloned(),
        reference_ns: middle.map(|m| nanos_from(of_a.first(), m.reference)),
        offset_ns: middle.map(|m| nanos_from(between, m.offset)),
        offset_sigma_us: middle.map(|m| m.offset_at(m.reference).sigma * 1e6),
        skew_ppm: middle.map(|m| m.skew * 1e6),
        skew_sigma_ppm: middle.map(|m| m.skew_sigma_at(m.reference) * 1e6),
        windows: related.windows,
        used: course.map_or(0, |course| course.used),
        contradicting: course.map_or(0, |course| course.contradicting),
        faults: related.faults.clone(),
        left_out: related.left_out.clone(),
    }
}

/// Clocks and loops over the first recording.
fn solution(
    network: &Network,
    length_s: f64,
    recordings: &[GyroRecording],
) -> (Vec<ClockOutput>, Vec<LoopOutput>) {
    let looks: Vec<f64> = (0..=LOOKS)
        .map(|k| length_s * f64::from(k) / f64::from(LOOKS))
        .collect();
    let over_time: Vec<Vec<WithSigma>> = looks.iter().map(|&t| network.at(t)).collect();
    let middle_s = 0.5 * length_s;
    let first = recordings[0].first();
    let at_middle = network.at(middle_s);
    let clocks = at_middle.iter().enumerate().skip(1).map(|(k, offset)| {
        let between = recordings[k].first().saturating_sub(first);
        let sigmas = over_time.iter().map(|all| all[k].sigma);
        ClockOutput {
            recording: k + 1,
            reference_ns: nanos_from(first, middle_s),
            offset_ns: nanos_from(between, offset.value),
            sigma_us: offset.sigma * 1e6,
            largest_sigma_us: sigmas.fold(0.0, f64::max) * 1e6,
        }
    });
    let closures: Vec<_> = looks.iter().map(|&t| network.closures(t)).collect();
    let of_middle = network.closures(middle_s);
    let loops = of_middle.iter().enumerate().map(|(k, closure)| {
        let rms = |of: fn(WithSigma) -> f64| {
            let squares = closures.iter().filter_map(|all| all.get(k));
            let sum: f64 = squares.map(|c| of(c.error).powi(2)).sum();
            (sum / closures.len() as f64).sqrt() * 1e6
        };
        LoopOutput {
            recordings: closure.devices.map(|device| device + 1),
            closure_rms_us: rms(|error| error.value),
            sigma_rms_us: rms(|error| error.sigma),
        }
    });
    (clocks.collect(), loops.collect())
}

fn text(output: &Output) -> String {
    let mut out = String::new();
    for input in &output.recordings {
        let _ = writeln!(
            out,
            "{}: {} ({}), {} samples, {:.1} s",
            input.number, input.file, input.form, input.samples, input.duration_s
        );
        for damage in &input.damage {
            let _ = writeln!(out, "   damage: {damage}");
        }
    }
    for pair in &output.pairs {
        let _ = write!(out, "{} and {}: ", pair.a, pair.b);
        match (pair.offset_ns, &pair.refusal) {
            (Some(offset), None) => {
                let _ = writeln!(
                    out,
                    "offset {} s ± {:.2} µs, skew {:+.3} ± {:.3} ppm, at {} s of {} ({} of {} windows)",
                    seconds(offset),
                    pair.offset_sigma_us.unwrap_or(f64::NAN),
                    pair.skew_ppm.unwrap_or(f64::NAN),
                    pair.skew_sigma_ppm.unwrap_or(f64::NAN),
                    seconds(pair.reference_ns.unwrap_or(0)),
                    pair.a,
                    pair.used,
                    pair.windows
                );
            }
            (_, refusal) => {
                let why = refusal.as_deref().unwrap_or("no relation");
                let _ = writeln!(out, "REFUSED: {why}");
            }
        }
        for line in pair.left_out.iter().chain(&pair.faults) {
            let _ = writeln!(out, "   {line}");
        }
    }
    for found in &output.loops {
        let [a, b, c] = found.recordings;
        let _ = writeln!(
            out,
            "loop {a}, {b}, {c}: closes to {:.2} µs rms, where the sigmas say {:.2} µs",
            found.closure_rms_us, found.sigma_rms_us
        );
    }
    for clock in &output.clocks {
        let _ = writeln!(
            out,
            "clock {} − clock 1: {} s ± {:.2} µs at {} s of 1; ± {:.2} µs at most over it",
            clock.recording,
            seconds(clock.offset_ns),
            clock.sigma_us,
            seconds(clock.reference_ns),
            clock.largest_sigma_us
        );
    }
    for warning in &output.warnings {
        let _ = writeln!(out, "warning: {warning}");
    }
    match &output.refusal {
        None => out.push_str("accepted\n"),
        Some(refusal) => {
            let _ = writeln!(out, "REFUSED: {refusal}");
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_stands_behind_the_file() {
        let (file, topic) = topic_of(Path::new("a.mcap@/imu/data"));
        assert_eq!(file, Path::new("a.mcap"));
        assert_eq!(topic.as_deref(), Some("/imu/data"));
        assert_eq!(topic_of(Path::new("a@b.csv")).1, None);
    }
}
