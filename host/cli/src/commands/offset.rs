//! `smartdepthsync offset`: the clock relation of two gyroscope recordings.

mod export;
pub(super) mod plot;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::advice;
use crate::context::Context;
use crate::options::number_in;
use crate::outcome::{ExitStatus, Failure};
use phone::gyro_csv::{self, GyroFile};
use session::twist_report::{Device, TwistReport, report_of};
use twist_sync::{
    Action, Estimate, Fault, FaultKind, GyroTrack, Options, Refusal, Stream, estimate_offset,
};

/// Options of `offset`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The board's gyroscope: CSV with a header (time; x, y, z in rad/s or degrees a second;
    /// what `imu --csv` writes is one), or in the phone app's form (no header: x, y, z,
    /// integer nanoseconds)
    #[arg(long, value_name = "FILE")]
    pub(crate) mcu: PathBuf,
    /// The phone's gyroscope, in either form
    #[arg(long, value_name = "FILE")]
    pub(crate) phone: PathBuf,
    /// Draw both gyroscopes before and after, the residual and what was left out
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) plot: Option<PathBuf>,
    /// Write both recordings with times from their first sample and without names, and the
    /// result, to this folder: to be sent to the project
    #[arg(long, value_name = "FOLDER")]
    pub(crate) export: Option<PathBuf>,
    /// Delay of the board gyroscope's low-pass in µs (MPU-9150: 1900 at DLPF 188 Hz)
    #[arg(long, value_name = "US", default_value_t = 0.0, value_parser = delay, allow_negative_numbers = true)]
    pub(crate) mcu_delay_us: f64,
    /// Delay of the phone gyroscope's low-pass in µs, from the rig's profile
    #[arg(long, value_name = "US", default_value_t = 0.0, value_parser = delay, allow_negative_numbers = true)]
    pub(crate) phone_delay_us: f64,
    /// Refuse an offset with a larger 1-sigma, µs
    #[arg(long, value_name = "US", default_value_t = 100.0, value_parser = positive)]
    pub(crate) max_sigma_us: f64,
    /// −3 dB frequency of the zero-phase low-pass, Hz
    #[arg(long, value_name = "HZ", default_value_t = 25.0, value_parser = low_pass)]
    pub(crate) low_pass_hz: f64,
    /// Do not look for faults of the streams, to see what they do to the result
    #[arg(long)]
    pub(crate) keep_faults: bool,
}

pub(super) fn delay(text: &str) -> Result<f64, String> {
    number_in(-1e6..=1e6, text, "microseconds, at most 1000000")
}

fn positive(text: &str) -> Result<f64, String> {
    number_in(f64::MIN_POSITIVE..f64::INFINITY, text, "a number above 0")
}

fn low_pass(text: &str) -> Result<f64, String> {
    number_in(5.0..=100.0, text, "5 to 100 Hz")
}

impl Args {
    fn options(&self) -> Options {
        Options {
            low_pass_hz: self.low_pass_hz,
            a_delay_s: self.mcu_delay_us * 1e-6,
            b_delay_s: self.phone_delay_us * 1e-6,
            sigma_limit_s: self.max_sigma_us * 1e-6,
            handle_faults: !self.keep_faults,
            ..Options::default()
        }
    }
}

/// What `offset --json` prints. Without an accepted estimate its numbers are null.
#[derive(Debug, Serialize)]
struct Output {
    accepted: bool,
    /// Why not, if it is not accepted.
    refusal: Option<String>,
    /// Board time at which the offset holds.
    reference_s: Option<f64>,
    /// Phone − board at the reference.
    offset_s: Option<f64>,
    offset_sigma_s: Option<f64>,
    skew_ppm: Option<f64>,
    skew_sigma_ppm: Option<f64>,
    /// Phone axes = calibration · board axes.
    calibration: Option<[[f64; 3]; 3]>,
    /// Bias of the phone against the board, in the phone's axes, rad/s.
    bias: Option<[f64; 3]>,
    /// Delays that were subtracted from the timestamps. The gyroscopes cannot
    /// see them: an error in their difference is an error of the offset.
    mcu_delay_s: f64,
    phone_delay_s: f64,
    #[serde(flatten)]
    report: TwistReport,
    mcu: Input,
    phone: Input,
}

#[derive(Debug, Serialize)]
struct Input {
    file: String,
    form: String,
    samples: usize,
    duration_s: f64,
}

impl Input {
    fn new(path: &Path, file: &GyroFile) -> Self {
        let t = &file.track.t;
        Self {
            file: path.display().to_string(),
            form: file.form.to_string(),
            samples: t.len(),
            duration_s: t.last().copied().unwrap_or(0.0),
        }
    }
}

impl Output {
    /// `inputs` are those of the board and of the phone.
    fn new(
        result: &Result<Estimate, Refusal>,
        options: &Options,
        [mcu, phone]: [Input; 2],
    ) -> Self {
        let estimate = result.as_ref().ok();
        let refusal = result.as_ref().err();
        Self {
            accepted: estimate.is_some(),
            refusal: refusal.map(|refusal| refusal.report.failures()),
            reference_s: estimate.map(|e| e.clock.reference),
            offset_s: estimate.map(|e| e.clock.offset),
            offset_sigma_s: estimate.map(Estimate::offset_sigma_s),
            skew_ppm: estimate.map(|e| e.clock.skew * 1e6),
            skew_sigma_ppm: estimate.map(|e| e.skew_sigma() * 1e6),
            calibration: estimate.map(|e| e.calibration),
            bias: estimate.map(|e| e.bias),
            mcu_delay_s: options.a_delay_s,
            phone_delay_s: options.b_delay_s,
            report: report_of(result).into(),
            mcu,
            phone,
        }
    }
}

/// Brings both to rad/s where one is in degrees a second: gyroscopes on one body turn at
/// the same rate, so a ratio near 57 is a unit. Says so.
pub(super) fn in_one_unit(tracks: [&mut GyroTrack; 2], names: [&str; 2]) -> Option<String> {
    let degree = 180.0 / std::f64::consts::PI;
    let [a, b] = tracks;
    let (of_a, of_b) = (typical_rate(a)?, typical_rate(b)?);
    let ratio = (of_a / of_b).max(of_b / of_a);
    // A factor of two for parts of the recordings that the other does not have.
    if !(0.5 * degree..2.0 * degree).contains(&ratio) {
        return None;
    }
    let (track, name) = if of_a > of_b {
        (a, names[0])
    } else {
        (b, names[1])
    };
    track
        .w
        .iter_mut()
        .flatten()
        .for_each(|rate| *rate = rate.to_radians());
    Some(format!(
        "the rates of {name} are {ratio:.0} times those of the other: taken as degrees a \
         second and converted"
    ))
}

/// A large rate of the motion, without the largest: the 90 % quantile.
fn typical_rate(track: &GyroTrack) -> Option<f64> {
    let norm = |w: &[f64; 3]| w.iter().map(|x| x * x).sum::<f64>().sqrt();
    let mut rates: Vec<f64> = track.w.iter().map(norm).filter(|x| x.is_finite()).collect();
    let at = rates.len() * 9 / 10;
    if rates.is_empty() {
        return None;
    }
    let (_, &mut rate, _) = rates.select_nth_unstable_by(at, f64::total_cmp);
    (rate > 0.0).then_some(rate)
}

/// Relates the clocks of two recordings.
///
/// # Errors
///
/// A file cannot be read or is damaged, or the plot cannot be written. A refused
/// estimate is no error but [`ExitStatus::Refused`].
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    let options = args.options();
    let mut mcu = read(&args.mcu)?;
    let mut phone = read(&args.phone)?;
    let unit = in_one_unit(
        [&mut mcu.track, &mut phone.track],
        ["the board", "the phone"],
    );
    let result = estimate_offset(&mcu.track, &phone.track, &options);
    if let Some(path) = &args.plot {
        let svg = plot::svg(NAMES, [&mcu.track, &phone.track], &result, &options);
        plot::write(path, &svg, context)?;
    }
    let inputs = [Input::new(&args.mcu, &mcu), Input::new(&args.phone, &phone)];
    let mut output = Output::new(&result, &options, inputs);
    output.report.warnings.extend(unit);
    if let Some(folder) = &args.export {
        export::write(folder, [&mcu.track, &phone.track], &options)?;
        context.say(format!("exported: {}", folder.display()));
    }
    context.print(&output, || text(&output, &report_of(&result).faults))?;
    Ok(match output.accepted {
        true => ExitStatus::Good,
        false => ExitStatus::Refused,
    })
}

fn read(path: &Path) -> Result<GyroFile, Failure> {
    gyro_csv::read_file(path).map_err(|error| advice::gyro_file(path, error.into()))
}

fn text(output: &Output, faults: &[Fault]) -> String {
    let mut out = String::new();
    for (name, input) in [("board", &output.mcu), ("phone", &output.phone)] {
        let _ = writeln!(
            out,
            "{name}: {} samples, {:.2} s, {} ({})",
            input.samples, input.duration_s, input.file, input.form
        );
    }
    for fault in faults {
        let _ = writeln!(out, "fault: {}", fault_text(fault, NAMES));
    }
    if let Some(together) = output.report.together_text() {
        let _ = writeln!(out, "{together}");
    }
    for stretch in &output.report.left_out {
        let _ = writeln!(out, "{}", stretch.text);
    }
    for warning in &output.report.warnings {
        let _ = writeln!(out, "warning: {warning}");
    }
    match (output.offset_s, output.reference_s) {
        (Some(offset), Some(reference)) => {
            let _ = writeln!(
                out,
                "offset (phone − board): {offset:.9} s ± {:.2} µs at board time {reference:.6} s",
                output.offset_sigma_s.unwrap_or(f64::NAN) * 1e6,
            );
            let _ = writeln!(
                out,
                "skew: {:+.2} ppm ± {:.2} ppm",
                output.skew_ppm.unwrap_or(f64::NAN),
                output.skew_sigma_ppm.unwrap_or(f64::NAN)
            );
            let _ = writeln!(
                out,
                "residual: {:.2} mrad/s rms of {:.2} rad/s rms motion, {:.1} s in common",
                output.report.residual_rms.unwrap_or(f64::NAN) * 1e3,
                output.report.motion_rms.unwrap_or(f64::NAN),
                output.report.overlap_s.unwrap_or(f64::NAN)
            );
            let _ = writeln!(
                out,
                "low-pass delays taken into account: board {:.0} µs, phone {:.0} µs (the gyroscopes cannot see an error in these)",
                output.mcu_delay_s * 1e6,
                output.phone_delay_s * 1e6
            );
            out.push_str("accepted\n");
        }
        _ => {
            let _ = writeln!(
                out,
                "REFUSED: {}",
                output.refusal.as_deref().unwrap_or("no estimate")
            );
        }
    }
    out
}

/// The two recordings in words.
const NAMES: [&str; 2] = [Device::Mcu.name(), Device::Phone.name()];

/// A fault of one of two recordings with these names.
pub(super) fn fault_text(fault: &Fault, names: [&str; 2]) -> String {
    let done = match fault.action {
        Action::LeftOut => "left out",
        Action::Corrected => "corrected",
        Action::Noted => "nothing done",
    };
    format!("{}; {done}", fault_found(fault, names))
}

/// A fault without what was done about it.
fn fault_found(fault: &Fault, names: [&str; 2]) -> String {
    let kind = match fault.kind {
        FaultKind::NotFinite => "values that are no numbers",
        FaultKind::TimestampOrder => "timestamps out of order",
        FaultKind::TimestampOutlier => "single timestamps off",
        FaultKind::TimestampSawtooth => "jumps of a sawtooth in the timestamps",
        FaultKind::TimestampStep => "samples in a stretch with displaced timestamps",
        FaultKind::Gap => "gaps",
        FaultKind::Clipped => "clipped samples",
        FaultKind::CopiedSample => "samples that are copies of their neighbour",
        FaultKind::DisplacedClass => "samples of a recurring class that belong to another time",
        FaultKind::Outlier => "single samples that do not fit",
        FaultKind::TimestampFar => "timestamps far from all others",
        FaultKind::NotOneBody => "samples while the two did not move as one body",
        FaultKind::Slipped => "samples while one was turned against the other",
    };
    let name = match fault.stream {
        Stream::A => names[0],
        Stream::B => names[1],
    };
    let mut text = format!("{name}: {} {kind}", fault.count);
    if let Some(period) = fault.period {
        let _ = write!(text, ", every {period} samples");
    }
    if let Some(displacement) = fault.displacement_s {
        let _ = write!(text, ", {:+.0} µs", displacement * 1e6);
    }
    text
}
