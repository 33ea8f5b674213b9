//! Recordings of other makers, by the Python package `telemetry-parser` of the authors of
//! Gyroflow, <https://github.com/AdrianEddy/telemetry-parser>.
//!
//! It runs in a process of its own, the `python3` of `PATH`: bytes of a file reach its
//! assertions. `telemetry.py` prints a line about the camera and CSV. Rates are in degrees a
//! second, by the package's README (`bin/python-module/README.md`), axes those of the camera
//! as it turns them. Times are as it gives them; mostly they count from the first frame.
//!
//! Videos of DJI have no gyroscope, but the camera's orientation
//! (<https://github.com/gyroflow/gyroflow/issues/1139>): the rates are those that turn each
//! into the next. Of a GoPro MAX, whose video has both, they are its gyroscope's to 0.06 of
//! 6.9 °/s rms, up to a rotation.

use std::fs::File;
use std::io::{self, BufRead as _, BufReader, ErrorKind, Read as _, Seek as _, SeekFrom};
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};

use phone::gyro_csv::{self, CsvError};

use crate::{GyroFileError, GyroRecording, mp4};

const SCRIPT: &str = include_str!("telemetry.py");
/// What the script exits with.
const NO_PACKAGE: i32 = 3;
const REFUSED: i32 = 4;

/// The longest that it may take, seconds.
const MAX_SECONDS: u32 = 600;
/// The most memory, bytes. The package takes 1.1 kB a sample: two hours at 1 kHz.
const MAX_MEMORY: u64 = 8 << 30;
/// The longest CSV, bytes: 80 for each sample of that memory.
const MAX_OUTPUT: u64 = 600 << 20;
/// The longest line about the camera or an error, bytes.
const MAX_LINE: u64 = 500;

/// Why `telemetry-parser` gives no gyroscope.
#[derive(Debug, thiserror::Error)]
pub enum TelemetryError {
    /// There is no Python.
    #[error("`python3` was not found")]
    NoPython,
    /// Python has no such package.
    #[error("`python3` cannot load the package telemetry-parser: {0}")]
    NoPackage(String),
    /// The package cannot read the file.
    #[error("telemetry-parser cannot read it: {0}")]
    Refused(String),
    /// There are no rates in the file.
    #[error("telemetry-parser finds neither a gyroscope nor an orientation in it")]
    None,
    /// What it prints is not what the script prints.
    #[error("the output of `python3` was not understood: {0}")]
    Output(CsvError),
    /// It crashed, or took too long or too much.
    #[error(
        "telemetry-parser ended with {0}; it may take {MAX_SECONDS} s and {memory} GB of memory",
        memory = MAX_MEMORY >> 30
    )]
    Ended(ExitStatus),
    /// Ctrl-C.
    #[error("stopped")]
    Stopped,
    /// It cannot be run.
    #[error("cannot run `python3`: {0}")]
    Run(#[from] io::Error),
}

pub(crate) fn read(path: &Path, what: &'static str) -> Result<GyroRecording, GyroFileError> {
    run(Command::new("python3"), path, MAX_SECONDS)
        .map_err(|error| GyroFileError::Telemetry { what, error })
}

fn run(mut python: Command, path: &Path, seconds: u32) -> Result<GyroRecording, TelemetryError> {
    let mut child = python
        .args(["-c", SCRIPT])
        .arg(path)
        .args([seconds.to_string(), MAX_MEMORY.to_string()])
        .env("PYTHONIOENCODING", "utf-8:replace")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|error| match error.kind() {
            ErrorKind::NotFound => TelemetryError::NoPython,
            _ => error.into(),
        })?;
    let mut said = String::new();
    let samples = child.stdout.take().map(|pipe| {
        let mut output = BufReader::new(pipe).take(MAX_OUTPUT);
        output.by_ref().take(MAX_LINE).read_line(&mut said)?;
        let samples = gyro_csv::read(&mut output);
        // To its end, so that it ends by itself.
        io::copy(&mut output, &mut io::sink())?;
        samples
    });
    let _ = child.kill();
    let status = child.wait()?;
    let said = said.trim().to_owned();
    match (status.code(), samples.unwrap_or(Err(CsvError::Empty))) {
        (Some(0), Ok(file)) => Ok(GyroRecording {
            form: format!("{said}, by telemetry-parser"),
            times: file.times,
            rates: file.track.w,
            ..GyroRecording::default()
        }),
        (Some(0), Err(CsvError::Empty)) => Err(TelemetryError::None),
        (Some(0), Err(error)) => Err(TelemetryError::Output(error)),
        (Some(NO_PACKAGE), _) => Err(TelemetryError::NoPackage(said)),
        (Some(REFUSED), _) => Err(TelemetryError::Refused(said)),
        _ if is_interrupt(status) => Err(TelemetryError::Stopped),
        _ => Err(TelemetryError::Ended(status)),
    }
}

/// Whether Ctrl-C, which goes to the child too, has ended it.
fn is_interrupt(status: ExitStatus) -> bool {
    #[cfg(unix)]
    {
        const SIGINT: i32 = 2;
        std::os::unix::process::ExitStatusExt::signal(&status) == Some(SIGINT)
    }
    #[cfg(not(unix))]
    {
        let _ = status;
        false
    }
}

/// Whether a file that is no MP4 begins as one that the package reads: MXF (SMPTE ST 377-1),
/// QuickTime without a brand, R3D of RED, logs of Gyroflow and of Betaflight's blackbox.
pub(crate) fn is_known(first: &[u8]) -> bool {
    let boxes: [&[u8]; 5] = [b"wide", b"mdat", b"moov", b"RED1", b"RED2"];
    let begins: [&[u8]; 3] = [
        &[0x06, 0x0e, 0x2b, 0x34],
        b"GYROFLOW IMU LOG",
        b"H Product:Blackb",
    ];
    first.get(4..8).is_some_and(|kind| boxes.contains(&kind))
        || begins.iter().any(|begin| first.starts_with(begin))
}

/// What a video without GoPro's track seems to be: by the formats of its tracks, which
/// ExifTool's tables of QuickTime name, and the end of Insta360's files (`InsvHeader.java`
/// of <https://github.com/alex-plekhanov/insvtools>).
pub(crate) fn kind(file: &mut File, index: &[u8]) -> io::Result<&'static str> {
    const INSTA360: &[u8] = b"8db42d694ccc418790edff439fe026bf";
    for (format, kind) in [
        (b"rtmd", "a video of a Sony camera"),
        (b"djmd", "a video of a DJI camera"),
        (b"camm", "a video with camera motion metadata (CAMM)"),
    ] {
        if mp4::samples(index, format).is_some() {
            return Ok(kind);
        }
    }
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(
        length.saturating_sub(INSTA360.len() as u64),
    ))?;
    let mut end = Vec::new();
    file.take(INSTA360.len() as u64).read_to_end(&mut end)?;
    Ok(match end == INSTA360 {
        true => "a video of an Insta360 camera",
        false => "a video without a track of GoPro's",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What comes of a file if the package is `module`.
    fn with_package(module: &str, seconds: u32) -> Result<GyroRecording, TelemetryError> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("telemetry_parser.py"), module).unwrap();
        let mut python = Command::new("python3");
        python.env("PYTHONPATH", folder.path());
        run(python, Path::new("a.mov"), seconds)
    }

    /// The package with a parser whose methods are `body`.
    fn with_parser(body: &str) -> Result<GyroRecording, TelemetryError> {
        let parser = "class Parser:\n camera, model = 'Cam', 'A\\n\\x1b1'\n def __init__(self, path): self.path = path\n";
        with_package(&format!("import os, sys, time\n{parser} {body}\n"), 60)
    }

    #[test]
    fn rates_are_converted_and_samples_without_them_left_out() {
        let read = with_parser(
            "def normalized_imu(self): return [{'timestamp_ms': 0.5 * k, 'gyro': g} for k, g in \
             enumerate([(180.0, 0.0, -90.0), None, (0, 0, 0)])]",
        )
        .unwrap();
        assert_eq!(read.form, "Cam (A1), by telemetry-parser");
        assert_eq!(read.times, [0, 1_000_000]);
        let pi = std::f64::consts::PI;
        assert_eq!(read.rates, [[pi, 0.0, -0.5 * pi], [0.0; 3]]);
    }

    /// A body that turns about its own axes, fixed and moving, once against the sign.
    #[test]
    fn orientations_give_the_rates_of_the_body() {
        // Half a turn a second about z, then about the body's x.
        let body = "def normalized_imu(self): return []
 def telemetry(self):
  from math import cos, pi, sin, sqrt
  h = 0.25 * pi * 1e-2
  z = [(cos(k * h), 0, 0, sin(k * h)) for k in range(51)]
  w = z[-1]
  x = [(w[0] * cos(k * h), w[0] * sin(k * h), w[3] * sin(k * h), w[3] * cos(k * h)) for k in range(1, 51)]
  all = [dict(zip('wxyz', q if n % 7 else [-c for c in q])) for n, q in enumerate(z + x)]
  yield {'Default': {}}
  yield {'Quaternion': {'Data': [{'t': 10.0 * n, 'v': q} for n, q in enumerate(all)]}}";
        let read = with_parser(body).unwrap();
        assert!(
            read.form.contains("rates of its orientation"),
            "{}",
            read.form
        );
        assert_eq!(read.times.len(), 100);
        let half_turn = 0.5 * std::f64::consts::PI;
        for (k, (at, rate)) in read.times.iter().zip(&read.rates).enumerate() {
            assert_eq!(*at, 5_000_000 + 10_000_000 * k as i64);
            let axis = if k < 50 { 2 } else { 0 };
            for (found, expected) in rate
                .iter()
                .zip([0, 1, 2].map(|a| if a == axis { half_turn } else { 0.0 }))
            {
                assert!((found - expected).abs() < 1e-9, "{k}: {rate:?}");
            }
        }
    }

    #[test]
    fn what_goes_wrong_in_the_package_is_told() {
        let said = |body: &str| with_parser(body).unwrap_err().to_string();
        let cases = [
            (
                "def normalized_imu(self): raise ValueError('No metadata')",
                "cannot read it: ValueError: No metadata",
            ),
            (
                "def normalized_imu(self): return [{'timestamp_ms': 0.0, 'gyro': ('a', float('nan'), 0)}]",
                "not understood: line 2",
            ),
            ("def normalized_imu(self): os.abort()", "signal: 6"),
            (
                "def normalized_imu(self): bytearray(9 << 30)",
                "cannot read it: MemoryError",
            ),
            ("def normalized_imu(self): os._exit(7)", "exit status: 7"),
            (
                "def normalized_imu(self): return []\n def telemetry(self): return [{'Quaternion': {}}]",
                "neither a gyroscope nor",
            ),
        ];
        for (body, expected) in cases {
            let said = said(body);
            assert!(said.contains(expected), "{body}: {said}");
        }
        let missing = with_package(
            "raise ModuleNotFoundError('No module named telemetry_parser')",
            60,
        );
        assert!(
            matches!(missing, Err(TelemetryError::NoPackage(_))),
            "{missing:?}"
        );
        let endless = with_package("import time\nwhile True: time.sleep(1)", 1);
        assert!(endless.unwrap_err().to_string().contains("signal: 14"));
        let interrupted =
            with_package("import os, signal\nos.kill(os.getpid(), signal.SIGINT)", 60);
        assert!(
            matches!(interrupted, Err(TelemetryError::Stopped)),
            "{interrupted:?}"
        );
        let none = run(Command::new("/no/such/python3"), Path::new("a.mov"), 60);
        assert!(matches!(none, Err(TelemetryError::NoPython)), "{none:?}");
    }
}
