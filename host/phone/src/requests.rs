//! The four requests of the app, and what their answers' bodies mean.
//!
//! The body of an IMU recording is taken line by line, so that even a long one is never held
//! as text.

use std::str::FromStr;
use std::time::Duration;

use super::answer::MalformedAnswer;
use super::error::PhoneError;
use super::samples::{PhoneSample, SAMPLE_LINE, Sensor, parse_sample};
use timebase::PhoneNanos;

/// Longest IMU recording that may be asked for. The app keeps the whole answer
/// in memory before it sends a byte of it.
pub const MAX_IMU_DURATION: Duration = Duration::from_secs(3600);

/// Bytes of answer that a second of IMU recording may bring: three sensors at
/// 1 kHz with lines of 100 bytes, and twice that for safety.
const IMU_BYTES_PER_SECOND: u64 = 600_000;

/// Bytes of answer that are accepted beside an IMU recording's samples, and in
/// all for the other requests.
pub(super) const SMALL_ANSWER: u64 = 64 * 1024;

/// A request to record the phone's motion sensors for a while.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImuRequest {
    /// How long to record; whole milliseconds, up to [`MAX_IMU_DURATION`].
    pub duration: Duration,
    /// Record the accelerometer.
    pub accelerometer: bool,
    /// Record the gyroscope.
    pub gyroscope: bool,
    /// Record the magnetometer.
    pub magnetometer: bool,
}

impl ImuRequest {
    /// The gyroscope alone, for `duration`: what a twist needs.
    #[must_use]
    pub const fn gyroscope(duration: Duration) -> Self {
        Self {
            duration,
            accelerometer: false,
            gyroscope: true,
            magnetometer: false,
        }
    }

    /// Whether `sensor` is asked for.
    #[must_use]
    pub const fn wants(&self, sensor: Sensor) -> bool {
        match sensor {
            Sensor::Accelerometer => self.accelerometer,
            Sensor::Gyroscope => self.gyroscope,
            Sensor::Magnetometer => self.magnetometer,
        }
    }

    /// The request's line with its one line end.
    ///
    /// # Errors
    ///
    /// The duration is out of range, or no sensor is asked for.
    pub fn line(&self) -> Result<String, PhoneError> {
        let ms = self.duration.as_millis();
        if ms == 0 || self.duration > MAX_IMU_DURATION {
            return Err(PhoneError::Argument(format!(
                "the duration of an IMU recording is 1 ms to {} s, not {:?}",
                MAX_IMU_DURATION.as_secs(),
                self.duration
            )));
        }
        if !Sensor::ALL.into_iter().any(|s| self.wants(s)) {
            return Err(PhoneError::Argument(
                "an IMU recording needs at least one sensor".to_owned(),
            ));
        }
        Ok(format!(
            "imu?duration={ms}&accel={}&gyro={}&magnetic={}\n",
            u8::from(self.accelerometer),
            u8::from(self.gyroscope),
            u8::from(self.magnetometer),
        ))
    }

    /// Most bytes that the answer may have.
    pub(super) fn answer_limit(&self) -> u64 {
        let seconds = self.duration.as_secs().saturating_add(1);
        seconds
            .saturating_mul(IMU_BYTES_PER_SECOND)
            .saturating_add(SMALL_ANSWER)
    }
}

/// A recording of one sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorRecording {
    /// Which sensor.
    pub sensor: Sensor,
    /// The file's name on the phone. Off the network: for display only.
    pub file_name: String,
    /// The samples in the order in which they came.
    pub samples: Vec<PhoneSample>,
}

/// The answer to an IMU request.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ImuRecording {
    /// One recording a requested sensor, as the app sent them.
    pub recordings: Vec<SensorRecording>,
    /// Requested sensors of which it sent no file: they are not ticked in its settings.
    pub missing: Vec<Sensor>,
}

impl ImuRecording {
    /// The file's samples of `sensor`.
    ///
    /// # Errors
    ///
    /// The phone sent no file of it.
    pub fn take(mut self, sensor: Sensor) -> Result<Vec<PhoneSample>, PhoneError> {
        let found = self.recordings.iter().position(|r| r.sensor == sensor);
        let found = found.ok_or(PhoneError::SensorMissing { sensor })?;
        Ok(self.recordings.swap_remove(found).samples)
    }

    /// Refuses a recording that is far shorter than the request: less than four fifths of
    /// it, and of what is missing half a second is a sensor's own to begin. Of a request
    /// of under a second nothing is said, nor of the magnetometer: a phone may lack one,
    /// and its file is empty then.
    pub(super) fn check_length(&self, request: ImuRequest) -> Result<(), PhoneError> {
        let asked = request.duration;
        if asked < Duration::from_secs(1) {
            return Ok(());
        }
        let least = (asked * 4 / 5).saturating_sub(Duration::from_millis(500));
        for SensorRecording {
            sensor, samples, ..
        } in &self.recordings
        {
            let got = match samples.as_slice() {
                [first, .., last] => last.time.0.saturating_sub(first.time.0).max(0),
                _ => 0,
            };
            let got = Duration::from_nanos(got.unsigned_abs());
            if *sensor != Sensor::Magnetometer && got < least {
                let sensor = *sensor;
                return Err(PhoneError::TooShort { sensor, asked, got });
            }
        }
        Ok(())
    }

    /// The samples of `sensor`, if it was recorded.
    #[must_use]
    pub fn samples(&self, sensor: Sensor) -> Option<&[PhoneSample]> {
        self.recordings
            .iter()
            .find(|r| r.sensor == sensor)
            .map(|r| r.samples.as_slice())
    }
}

/// Reads the body of an answer to an IMU request.
#[derive(Debug)]
pub struct ImuBody {
    request: ImuRequest,
    done: Vec<SensorRecording>,
    current: Option<SensorRecording>,
}

impl ImuBody {
    /// A parser for the answer to `request`.
    #[must_use]
    pub fn new(request: ImuRequest) -> Self {
        Self {
            request,
            done: Vec::new(),
            current: None,
        }
    }

    /// Takes one line; `number` is its number in the answer.
    pub fn line(&mut self, number: u64, line: &str) -> Result<(), MalformedAnswer> {
        let wrong = |expected| MalformedAnswer::line(number, expected, line);
        if let Some(recording) = &mut self.current {
            if line == "sensor_end" {
                self.done.extend(self.current.take());
                return Ok(());
            }
            let sample = parse_sample(line).ok_or_else(|| wrong(SAMPLE_LINE))?;
            recording.samples.push(sample);
            return Ok(());
        }
        let sensor = Sensor::of_file(line)
            .ok_or_else(|| wrong("a file name that ends in accel.csv, gyro.csv or magnetic.csv"))?;
        if !self.request.wants(sensor) {
            return Err(wrong("the file of a requested sensor"));
        }
        if self.done.iter().any(|r| r.sensor == sensor) {
            return Err(wrong("each sensor's file once"));
        }
        self.current = Some(SensorRecording {
            sensor,
            file_name: line.to_owned(),
            samples: Vec::new(),
        });
        Ok(())
    }

    /// The recording, once the answer has ended.
    pub fn finish(self) -> Result<ImuRecording, MalformedAnswer> {
        if self.current.is_some() {
            return Err(MalformedAnswer::Missing {
                expected: "the line sensor_end",
            });
        }
        let came = |sensor: &Sensor| self.done.iter().any(|r| r.sensor == *sensor);
        let missing = Sensor::ALL
            .into_iter()
            .filter(|sensor| self.request.wants(*sensor) && !came(sensor))
            .collect();
        Ok(ImuRecording {
            recordings: self.done,
            missing,
        })
    }
}

/// The answer to `video_start`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VideoStart {
    /// Timestamp of the frame that gives the phase: start of exposure of its
    /// first row. (The app takes the frame with number 60, counted from 0.)
    pub phase: PhoneNanos,
    /// Mean of the frame durations before it, in nanoseconds.
    pub frame_duration_ns: f64,
    /// Exposure time in nanoseconds. From v.0.1.1 on, and only where the
    /// camera reports it.
    pub exposure_ns: Option<u64>,
}

impl VideoStart {
    /// Reads the body of an answer. Lines that later versions of the app may add are passed
    /// over.
    ///
    /// # Errors
    ///
    /// A line is missing, or is not what belongs there.
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
        })
    }
}

/// A line of a short body, which follows two lines of status and version.
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
    /// Size in bytes.
    pub size: u64,
    /// Name on the phone. Off the network: never a path, see
    /// [`super::file_name::safe_file_name`].
    pub file_name: String,
}

impl VideoHeader {
    /// Reads the body of an answer.
    ///
    /// # Errors
    ///
    /// A line is missing, or is not what belongs there.
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

    fn imu(lines: &[&str], request: ImuRequest) -> Result<ImuRecording, MalformedAnswer> {
        let mut body = ImuBody::new(request);
        for (i, line) in lines.iter().enumerate() {
            body.line(i as u64 + 3, line)?;
        }
        body.finish()
    }

    const BOTH: ImuRequest = ImuRequest {
        duration: Duration::from_secs(1),
        accelerometer: true,
        gyroscope: true,
        magnetometer: false,
    };

    #[test]
    fn the_request_is_one_line() {
        assert_eq!(
            BOTH.line().unwrap(),
            "imu?duration=1000&accel=1&gyro=1&magnetic=0\n"
        );
        for duration in [Duration::ZERO, Duration::from_secs(3601)] {
            assert!(ImuRequest::gyroscope(duration).line().is_err());
        }
        let none = ImuRequest {
            gyroscope: false,
            ..ImuRequest::gyroscope(Duration::from_secs(1))
        };
        assert!(none.line().is_err());
    }

    #[test]
    fn reads_the_sensors() {
        let answer = imu(
            &[
                "xaccel.csv",
                "1,2,3,4",
                "sensor_end",
                "xgyro.csv",
                "sensor_end",
            ],
            BOTH,
        )
        .unwrap();
        assert_eq!(answer.samples(Sensor::Accelerometer).unwrap().len(), 1);
        assert_eq!(answer.samples(Sensor::Gyroscope).unwrap().len(), 0);
        assert!(answer.samples(Sensor::Magnetometer).is_none());
    }

    #[test]
    fn a_missing_file_is_named_and_the_others_are_kept() {
        let answer = imu(&["xgyro.csv", "1,2,3,4", "sensor_end"], BOTH).unwrap();
        assert_eq!(answer.missing, [Sensor::Accelerometer]);
        assert_eq!(answer.samples(Sensor::Gyroscope).unwrap().len(), 1);
        let error = answer.clone().take(Sensor::Accelerometer).unwrap_err();
        assert!(error.to_string().contains("accelerometer"), "{error}");
        assert_eq!(answer.take(Sensor::Gyroscope).unwrap().len(), 1);
        let nothing = imu(&[], BOTH).unwrap();
        assert_eq!(nothing.missing, [Sensor::Accelerometer, Sensor::Gyroscope]);
    }

    #[test]
    fn a_recording_that_broke_off_is_too_short() {
        let asked = ImuRequest {
            duration: Duration::from_secs(4),
            magnetometer: true,
            accelerometer: false,
            ..BOTH
        };
        let recorded = |end_ns: i64| {
            let last = format!("1,2,3,{end_ns}");
            let lines = ["xgyro.csv", "1,2,3,5", &last, "sensor_end"];
            let lines = [&lines[..], &["xmagnetic.csv", "sensor_end"]].concat();
            imu(&lines, asked).unwrap().check_length(asked)
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
            (&["xmagnetic.csv"], "requested sensor"),
            (&["1,2,3,4"], "a file name"),
        ] {
            let e = imu(lines, BOTH).unwrap_err().to_string();
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
}
