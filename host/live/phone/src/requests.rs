//! The four requests to the app, and the bodies of its answers.
//!
//! The body of an IMU recording is parsed line by line, so that even a long one is never held
//! as text.

use std::str::FromStr;
use std::time::Duration;

use super::answer::MalformedAnswer;
use super::error::PhoneError;
use super::file_name::without_number;
use super::samples::{PhoneSample, SAMPLE_LINE, parse_sample};
use clock::PhoneNanos;

/// Longest IMU recording that may be requested. The app keeps the whole answer
/// in memory before it sends a byte of it.
pub const MAX_IMU_DURATION: Duration = Duration::from_secs(3600);

/// Most bytes of answer for a second of IMU recording: two sensors at 1 kHz with lines of
/// 100 bytes, and a factor of two for safety.
const IMU_BYTES_PER_SECOND: u64 = 400_000;

/// Most bytes of an answer apart from the samples of an IMU recording.
pub(super) const SMALL_ANSWER: u64 = 64 * 1024;

/// A request to record the phone's gyroscope for a while.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImuRequest {
    /// Duration of the recording, in whole milliseconds up to [`MAX_IMU_DURATION`].
    pub duration: Duration,
    /// True to request the accelerometer too. Its samples are ignored.
    pub accelerometer: bool,
}

impl ImuRequest {
    /// Creates a request for the gyroscope alone.
    #[must_use]
    pub const fn gyroscope(duration: Duration) -> Self {
        Self {
            duration,
            accelerometer: false,
        }
    }

    /// Returns the line of the request, with its line end.
    ///
    /// # Errors
    ///
    /// The duration is out of range.
    pub fn line(&self) -> Result<String, PhoneError> {
        let ms = self.duration.as_millis();
        if ms == 0 || self.duration > MAX_IMU_DURATION {
            return Err(PhoneError::Argument(format!(
                "the duration of an IMU recording is 1 ms to {} s, not {:?}",
                MAX_IMU_DURATION.as_secs(),
                self.duration
            )));
        }
        let accel = u8::from(self.accelerometer);
        Ok(format!(
            "imu?duration={ms}&accel={accel}&gyro=1&magnetic=0\n"
        ))
    }

    /// Returns the most bytes that the answer may have.
    pub(crate) fn answer_limit(&self) -> u64 {
        let seconds = self.duration.as_secs().saturating_add(1);
        seconds
            .saturating_mul(IMU_BYTES_PER_SECOND)
            .saturating_add(SMALL_ANSWER)
    }

    /// Checks that a recording is not far shorter than requested: at least four fifths of the
    /// duration, less half a second for the start of the sensor. Requests of under a second always
    /// pass.
    pub(crate) fn check_length(&self, samples: &[PhoneSample]) -> Result<(), PhoneError> {
        let asked = self.duration;
        let least = (asked * 4 / 5).saturating_sub(Duration::from_millis(500));
        let got = match samples {
            [first, .., last] => last.time.0.saturating_sub(first.time.0).max(0),
            _ => 0,
        };
        let got = Duration::from_nanos(got.unsigned_abs());
        if asked >= Duration::from_secs(1) && got < least {
            return Err(PhoneError::TooShort { asked, got });
        }
        Ok(())
    }
}

/// Parser of the body of an answer to an IMU request: for each sensor the name of its file, its
/// samples, and the line `sensor_end`.
#[derive(Debug, Default)]
pub struct ImuBody {
    gyroscope: Option<Vec<PhoneSample>>,
    /// True within the file of the gyroscope, false within another, `None` between files.
    is_gyroscope: Option<bool>,
}

impl ImuBody {
    /// Parses one line; `number` is its number in the answer.
    ///
    /// # Errors
    ///
    /// The line violates the protocol.
    pub fn line(&mut self, number: u64, line: &str) -> Result<(), MalformedAnswer> {
        let wrong = |expected| MalformedAnswer::line(number, expected, line);
        let Some(is_gyroscope) = self.is_gyroscope else {
            let name = line.strip_suffix(".csv").map(without_number);
            let is = |sensor| name.is_some_and(|name| name.ends_with(sensor));
            if is("gyro") && self.gyroscope.replace(Vec::new()).is_some() {
                return Err(wrong("each sensor's file once"));
            }
            if !is("gyro") && !is("accel") {
                return Err(wrong("a file name that ends in accel.csv or gyro.csv"));
            }
            self.is_gyroscope = Some(is("gyro"));
            return Ok(());
        };
        if line == "sensor_end" {
            self.is_gyroscope = None;
            return Ok(());
        }
        let sample = parse_sample(line).ok_or_else(|| wrong(SAMPLE_LINE))?;
        if is_gyroscope {
            self.gyroscope.get_or_insert_default().push(sample);
        }
        Ok(())
    }

    /// Returns the samples of the gyroscope after the end of the answer, or `None` if it has no file
    /// of the gyroscope because the app's settings disable it.
    ///
    /// # Errors
    ///
    /// The answer ended within a file.
    pub fn finish(self) -> Result<Option<Vec<PhoneSample>>, MalformedAnswer> {
        match self.is_gyroscope {
            None => Ok(self.gyroscope),
            Some(_) => Err(MalformedAnswer::Missing {
                expected: "the line sensor_end",
            }),
        }
    }
}

/// The answer to `video_start`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VideoStart {
    /// Phase of the video's frames: the start of exposure of one frame's first row. (The app takes
    /// frame 60, counted from 0.)
    pub phase: PhoneNanos,
    /// Mean duration of the frames before that one, in nanoseconds.
    pub frame_duration_ns: f64,
    /// Exposure time in nanoseconds, from app version v.0.1.1 on if the camera reports it.
    pub exposure_ns: Option<u64>,
    /// Clock of the phone's sensors minus the clock of its frames, in nanoseconds.
    pub boot_minus_frames_ns: i64,
}

/// The phone's clocks at the request of a video.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Asked {
    /// Clock of the sensors, `CLOCK_BOOTTIME`.
    pub boot: PhoneNanos,
    /// Time that the phone has slept since it was started, in nanoseconds: `CLOCK_BOOTTIME` minus
    /// `CLOCK_MONOTONIC`. `None` if they were not both read.
    pub slept_ns: Option<i64>,
}

impl From<PhoneNanos> for Asked {
    fn from(boot: PhoneNanos) -> Self {
        Self {
            boot,
            slept_ns: None,
        }
    }
}

/// Fewest frame durations from a start to the frame of the phase.
const PHASE_FRAMES: f64 = 59.0;

/// Largest difference of two readings of one clock, in nanoseconds: they are taken one after the
/// other.
const ONE_CLOCK_NS: i64 = 1_000;

impl VideoStart {
    /// Checks the phase against the time of the request, and finds the clock of the frames. `took`
    /// is the time from the request to the answer on this computer, and `patience` the longest
    /// time that was allowed.
    ///
    /// Android stamps frames with the sensors' clock if the camera reports `REALTIME`, and else
    /// mostly with `CLOCK_MONOTONIC`, which stops while the phone sleeps; the app reports neither.
    /// If the phone has slept for longer than the answer took, the phase lies between request and
    /// answer on only one of the two clocks.
    ///
    /// # Errors
    ///
    /// The phase is earlier than the video's frames can be, or it fits both clocks.
    pub fn checked(
        self,
        asked: Option<Asked>,
        took: Duration,
        patience: Duration,
    ) -> Result<Self, PhoneError> {
        let least_s = PHASE_FRAMES * self.frame_duration_ns * 1e-9;
        let after_s = |offset_ns: i64| {
            asked.map_or(took.as_secs_f64(), |asked| {
                let phase = self.phase.0.saturating_add(offset_ns);
                phase.saturating_sub(asked.boot.0) as f64 * 1e-9
            })
        };
        let early = least_s - after_s(0);
        let slept = asked.and_then(|asked| asked.slept_ns);
        let Some(slept) = slept.filter(|slept| slept.abs() > ONE_CLOCK_NS) else {
            if early > 0.0 {
                return Err(PhoneError::StalePhase { early });
            }
            return Ok(self);
        };
        let fits = |slept| (least_s..=patience.as_secs_f64()).contains(&after_s(slept));
        match (fits(0), fits(slept)) {
            (true, false) => Ok(self),
            (false, true) => Ok(Self {
                boot_minus_frames_ns: slept,
                ..self
            }),
            (true, true) => Err(PhoneError::FrameClock {
                slept_s: slept as f64 * 1e-9,
            }),
            (false, false) => Err(PhoneError::StalePhase { early }),
        }
    }

    /// Parses the body of an answer. Ignores lines that later versions of the app may add.
    ///
    /// # Errors
    ///
    /// A line is missing or malformed.
    pub fn parse(body: &[String]) -> Result<Self, MalformedAnswer> {
        let expected = "the phase: whole nanoseconds of the phone's clock";
        let phase = field(body, 0, expected, |&ns: &i64| ns > 0)?;
        // 1 ms to 1 s: far wider than any camera's video.
        let expected = "a frame duration of 1,000,000 to 1,000,000,000 ns";
        let frame_duration_ns = field(body, 1, expected, |ns: &f64| (1e6..=1e9).contains(ns))?;
        let expected = "an exposure time of at most 1,000,000,000 ns";
        let exposure = body
            .get(2)
            .map(|_| field(body, 2, expected, |&ns: &u64| ns <= 1_000_000_000));
        Ok(Self {
            phase: PhoneNanos(phase),
            frame_duration_ns,
            // The app writes 0 where the camera does not report an exposure.
            exposure_ns: exposure.transpose()?.filter(|&ns| ns > 0),
            boot_minus_frames_ns: 0,
        })
    }
}

/// Parses the line at an index of a short body, which follows the two lines of status and version.
fn field<T: FromStr>(
    body: &[String],
    place: usize,
    expected: &'static str,
    is_right: impl Fn(&T) -> bool,
) -> Result<T, MalformedAnswer> {
    let line = body
        .get(place)
        .ok_or(MalformedAnswer::Missing { expected })?;
    let value = line.trim().parse().ok().filter(is_right);
    value.ok_or_else(|| MalformedAnswer::line(place as u64 + 3, expected, line))
}

/// The answer to `get_video`, before the bytes of the video.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VideoHeader {
    /// Size of the video in bytes.
    pub size: u64,
    /// Name on the phone. It comes from the network: make a path of it only with
    /// [`safe_file_name`](super::file_name::safe_file_name).
    pub file_name: String,
}

impl VideoHeader {
    /// Parses the body of an answer.
    ///
    /// # Errors
    ///
    /// A line is missing or malformed.
    pub fn parse(body: &[String]) -> Result<Self, MalformedAnswer> {
        let size = field(
            body,
            0,
            "the size of the video in bytes, above 0",
            |&size: &u64| size > 0,
        )?;
        let file_name = body.get(1).cloned().ok_or(MalformedAnswer::Missing {
            expected: "the name of the video",
        })?;
        Ok(Self { size, file_name })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn imu(lines: &[&str]) -> Result<Option<Vec<PhoneSample>>, MalformedAnswer> {
        let mut body = ImuBody::default();
        for (i, line) in lines.iter().enumerate() {
            body.line(i as u64 + 3, line)?;
        }
        body.finish()
    }

    const fn asked(duration: Duration) -> ImuRequest {
        ImuRequest {
            duration,
            accelerometer: true,
        }
    }

    #[test]
    fn the_request_is_one_line() {
        assert_eq!(
            asked(Duration::from_secs(1)).line().unwrap(),
            "imu?duration=1000&accel=1&gyro=1&magnetic=0\n"
        );
        for duration in [Duration::ZERO, Duration::from_secs(3601)] {
            assert!(asked(duration).line().is_err());
        }
    }

    #[test]
    fn reads_the_gyroscope_and_ignores_the_accelerometer() {
        let accel = ["xaccel.csv", "1,2,3,4", "sensor_end"];
        assert_eq!(imu(&accel).unwrap(), None);
        // The second and third recordings within one second have other names.
        for name in ["VID_20210504_161730gyro.csv", "xgyro_1.csv", "gyro (1).csv"] {
            let gyro = [name, "1,2,3,4", "1,2,3,5", "sensor_end"];
            let samples = imu(&[&accel[..], &gyro].concat()).unwrap().unwrap();
            assert_eq!(samples.len(), 2, "{name}");
        }
        assert_eq!(imu(&["xgyro.csv", "sensor_end"]).unwrap(), Some(Vec::new()));
    }

    #[test]
    fn a_recording_that_broke_off_is_too_short() {
        let recorded = |end_ns: i64| {
            let last = format!("1,2,3,{end_ns}");
            let lines = ["xgyro.csv", "1,2,3,5", &last, "sensor_end"];
            let samples = imu(&lines).unwrap().unwrap();
            asked(Duration::from_secs(4)).check_length(&samples)
        };
        assert!(recorded(3_990_000_000).is_ok());
        let error = recorded(900_000_000).unwrap_err().to_string();
        assert!(error.contains("0.9 s of the 4.0 s"), "{error}");
    }

    #[test]
    fn refuses_damaged_recordings() {
        for (lines, expected) in [
            (&["xgyro.csv", "1,2,3"][..], "x,y,z,timestamp_ns"),
            (&["xgyro.csv", "1,2,3,4"], "sensor_end"),
            (&["xgyro.csv", "sensor_end", "ygyro.csv"], "once"),
            (&["1,2,3,4"], "a file name"),
            (&["gyro_161730.csv"], "a file name"),
            (&["gyro.txt"], "a file name"),
        ] {
            let e = imu(lines).unwrap_err().to_string();
            assert!(e.contains(expected), "{lines:?}: {e}");
        }
    }

    fn start(lines: &[&str]) -> Result<VideoStart, MalformedAnswer> {
        let body: Vec<String> = lines.iter().map(|&line| line.to_owned()).collect();
        VideoStart::parse(&body)
    }

    #[test]
    fn reads_the_phase_of_both_versions() {
        let old = start(&["949113215987860", "3.3330652542372882E7"]).unwrap();
        assert_eq!(old.phase, PhoneNanos(949_113_215_987_860));
        assert_eq!(old.frame_duration_ns, 33_330_652.542_372_882);
        assert_eq!(old.exposure_ns, None);
        let new = start(&["1", "3.3333333E7", "1000000", "one more line"]).unwrap();
        assert_eq!(new.exposure_ns, Some(1_000_000));
        assert_eq!(start(&["1", "3.3E7", "0"]).unwrap().exposure_ns, None);
    }

    #[test]
    fn refuses_damaged_phases() {
        for lines in [
            &["-5", "3.3E7"][..],
            &["x", "3.3E7"],
            &["1", "NaN"],
            &["1", "3.3E17"],
            &["1", "3.3E7", "-1"],
            &["1"],
            &[],
        ] {
            assert!(start(lines).is_err(), "{lines:?}");
        }
    }

    /// The request is at 40,000 s of the sensors' clock, the answer 2.5 s later, and the frame of
    /// the phase 2.4 s after the request.
    #[test]
    fn the_clock_of_the_frames_is_the_one_that_the_phase_fits() {
        let second = 1_000_000_000_i64;
        let asked = |slept_ns| Asked {
            boot: PhoneNanos(40_000 * second),
            slept_ns,
        };
        let start = |offset_ns: i64| VideoStart {
            phase: PhoneNanos(40_002 * second + second * 4 / 10 - offset_ns),
            frame_duration_ns: 1e9 / 30.0,
            exposure_ns: None,
            boot_minus_frames_ns: 0,
        };
        let checked = |offset_ns, slept_ns| {
            start(offset_ns).checked(
                Some(asked(slept_ns)),
                Duration::ZERO,
                Duration::from_secs(25),
            )
        };
        let hour = 3_600 * second;
        for (offset, slept, expected) in [
            (0, None, 0),
            (0, Some(0), 0),
            (0, Some(-700), 0),
            (0, Some(hour), 0),
            (hour, Some(hour), hour),
            (30 * second, Some(30 * second), 30 * second),
        ] {
            let start = checked(offset, slept).unwrap();
            assert_eq!(start.boot_minus_frames_ns, expected, "{offset} {slept:?}");
        }
        for (offset, slept) in [(hour, None), (hour, Some(2 * hour)), (hour, Some(0))] {
            let error = checked(offset, slept).unwrap_err();
            assert!(matches!(error, PhoneError::StalePhase { .. }), "{error}");
        }
        for (offset, slept) in [(0, Some(5 * second)), (0, Some(20_000))] {
            let error = checked(offset, slept).unwrap_err();
            assert!(matches!(error, PhoneError::FrameClock { .. }), "{error}");
        }
    }
}
