//! Compares the files of a phone's video with each other, and with what the phone reported when the
//! video began.
//!
//! A file that ends at a whole line looks complete to a reader of rows. So gyroscope and
//! accelerometer must cover the span of the frames at their own rate, and the frames must have the
//! period and the phase that the trigger was aligned to.
//!
//! Limits: damaged rows are left out and not reported here. Without frame timestamps the sensors
//! are compared with nothing.

use std::io::{self, BufReader};
use std::path::Path;

use clock::PhoneNanos;
use clock::frames::frame_period;
use system::ReadMonitor;

use crate::rows::{RowError, Rows};
use crate::video_files::VideoFiles;

/// Longest time that a sensor may begin after the first frame, or end before the last, ns. The app
/// starts and stops both with the video, one after the other.
const BEYOND_NS: i64 = 500_000_000;

/// Shortest pause that counts as a gap, in median distances of samples, and in ns.
const GAP_STEPS: i64 = 10;
const GAP_NS: i64 = 100_000_000;

/// Steps from which the median distance of samples is taken.
const STEPS: usize = 1_000;

/// Accepted deviation of a frame period, in its 1-sigmas, and relative to the period besides: the
/// period of a phone changes by a few ppm while it warms up.
const SIGMAS: f64 = 5.0;
const WARMS: f64 = 20e-6;

/// Intervals whose mean the app reports as the frame duration.
const INTERVALS: f64 = 59.0;

/// Largest distance of the reported phase from a frame, in parts of a period.
const PHASE: f64 = 0.1;

/// The frames as the alignment of the trigger assumed them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AssumedFrames {
    /// Timestamp of one frame, on the clock of the frames.
    pub phase: PhoneNanos,
    /// Distance of the frames, ns.
    pub period_ns: f64,
    /// 1-sigma of the distance, ns, if it is known.
    pub sigma_ns: Option<f64>,
    /// Clock of the phone's sensors minus the clock of its frames, ns.
    pub boot_minus_frames_ns: i64,
}

/// A contradiction between the files of a phone's video, or with what was assumed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PhoneFault {
    /// A file has no rows.
    #[error("the file of the phone's {what} has no rows")]
    Empty {
        /// Content of the file.
        what: &'static str,
    },
    /// A sensor does not cover the frames.
    #[error("the phone's {what} {}", uncovered(*.begin_s, *.end_s))]
    Short {
        /// Content of the file.
        what: &'static str,
        /// First sample after the first frame, s, if that is too long.
        begin_s: f64,
        /// Last frame after the last sample, s, if that is too long.
        end_s: f64,
    },
    /// A sensor pauses.
    #[error("the phone's {what} pauses {count} times, for up to {longest_s:.2} s")]
    Gaps {
        /// Content of the file.
        what: &'static str,
        /// Number of pauses.
        count: u64,
        /// The longest, s.
        longest_s: f64,
    },
    /// The frames have another period than was assumed.
    #[error(
        "the phone's frames are {found_ns:.1} ns apart by their own timestamps, and the trigger was set for \
         {assumed_ns:.1} ns: {:+.0} µs a minute", drift(*.found_ns, *.assumed_ns)
    )]
    Period {
        /// Period by the timestamps, ns.
        found_ns: f64,
        /// Period that the trigger was set for, ns.
        assumed_ns: f64,
    },
    /// The frames have another phase than was reported.
    #[error(
        "the frame by which the trigger was aligned lies {:+.0} µs from the nearest of the phone's own timestamps",
        .off_ns * 1e-3
    )]
    Phase {
        /// Distance from the nearest frame, ns.
        off_ns: f64,
    },
}

fn drift(found_ns: f64, assumed_ns: f64) -> f64 {
    (found_ns / assumed_ns - 1.0) * 60e6
}

fn uncovered(begin_s: f64, end_s: f64) -> String {
    match (begin_s > 0.0, end_s > 0.0) {
        (true, true) => {
            format!(
                "begins {begin_s:.1} s after the first frame and ends {end_s:.1} s before the last"
            )
        }
        (true, false) => format!("begins {begin_s:.1} s after the first frame"),
        _ => format!("ends {end_s:.1} s before the last frame"),
    }
}

impl PhoneFault {
    /// Returns a stable word for the kind.
    #[must_use]
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Empty { .. } => "phone_file_empty",
            Self::Short { .. } => "phone_file_short",
            Self::Gaps { .. } => "phone_file_gaps",
            Self::Period { .. } => "phone_period",
            Self::Phase { .. } => "phone_phase",
        }
    }

    /// Returns advice.
    #[must_use]
    pub const fn next_step(&self) -> &'static str {
        match self {
            Self::Empty { .. } | Self::Short { .. } | Self::Gaps { .. } => {
                "copy the phone's files again; they are complete on the phone if the app was left open"
            }
            Self::Period { .. } | Self::Phase { .. } => {
                "record again with `record --calibrate`, which measures the phone's frame period"
            }
        }
    }
}

/// Span and pauses of a sensor's file.
struct Sensor {
    first: i64,
    last: i64,
    gaps: u64,
    longest: i64,
}

/// Reads the times of a sensor's rows; `None` if there are none.
fn sensor(path: &Path, monitor: &ReadMonitor) -> io::Result<Option<Sensor>> {
    let mut rows = rows_of(path, monitor)?;
    let mut times = std::iter::from_fn(|| {
        next(&mut rows, |rows| {
            Ok(rows.next_sample()?.map(|sample| sample.time))
        })
    });
    let Some(first) = times.next().transpose()? else {
        return Ok(None);
    };
    let mut sensor = Sensor {
        first: first.0,
        last: first.0,
        gaps: 0,
        longest: 0,
    };
    // The rate is that of the first steps; they are held until it is known.
    let mut steps: Vec<i64> = Vec::new();
    let mut limit = None;
    for time in times {
        let time = time?.0;
        let step = time.saturating_sub(sensor.last);
        sensor.last = time;
        match limit {
            Some(limit) => sensor.step(step, limit),
            None => steps.push(step),
        }
        if limit.is_none() && steps.len() == STEPS {
            limit = Some(sensor.limit(&mut steps));
        }
    }
    if limit.is_none() {
        sensor.limit(&mut steps);
    }
    Ok(Some(sensor))
}

impl Sensor {
    fn step(&mut self, step: i64, limit: i64) {
        if step > limit {
            self.gaps += 1;
            self.longest = self.longest.max(step);
        }
    }

    /// Returns the shortest pause by the median of steps, and judges those.
    fn limit(&mut self, steps: &mut [i64]) -> i64 {
        let mut sorted = steps.to_vec();
        sorted.sort_unstable();
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or_default();
        let limit = median.saturating_mul(GAP_STEPS).max(GAP_NS);
        for step in steps {
            self.step(*step, limit);
        }
        limit
    }
}

type FileRows = Rows<BufReader<system::Input>>;

fn rows_of(path: &Path, monitor: &ReadMonitor) -> io::Result<FileRows> {
    let input = system::open(path, monitor)?.skipping_holes();
    Ok(Rows::new(BufReader::with_capacity(256 * 1024, input)))
}

/// Returns the next good row.
fn next(
    rows: &mut FileRows,
    read: impl Fn(&mut FileRows) -> Result<Option<PhoneNanos>, RowError>,
) -> Option<io::Result<PhoneNanos>> {
    loop {
        match read(rows) {
            Ok(time) => return time.map(Ok),
            Err(RowError::Bad(_)) => {}
            Err(RowError::Io(error)) => return Some(Err(error)),
        }
    }
}

/// Compares the files of a video with each other, and with the frames that were assumed.
///
/// # Errors
///
/// A file cannot be read, or reads are cancelled.
pub fn check(
    files: &VideoFiles,
    assumed: Option<&AssumedFrames>,
    monitor: &ReadMonitor,
) -> io::Result<Vec<PhoneFault>> {
    let mut faults = Vec::new();
    let mut frames = Vec::new();
    if let Some(path) = &files.frames {
        let mut rows = rows_of(path, monitor)?;
        let read = std::iter::from_fn(|| next(&mut rows, FileRows::next_timestamp));
        frames = read.collect::<io::Result<Vec<PhoneNanos>>>()?;
        if frames.is_empty() {
            let what = "frame timestamps";
            faults.push(PhoneFault::Empty { what });
        }
    }
    let boot_ns = assumed.map_or(0, |assumed| assumed.boot_minus_frames_ns);
    let on_boot = |time: &PhoneNanos| time.0.saturating_add(boot_ns);
    let span = frames.first().map(on_boot).zip(frames.last().map(on_boot));
    for (what, path) in [("gyroscope", &files.gyro), ("accelerometer", &files.accel)] {
        let Some(path) = path else { continue };
        let Some(sensor) = sensor(path, monitor)? else {
            faults.push(PhoneFault::Empty { what });
            continue;
        };
        let beyond_s = |ns: i64| {
            let is_beyond = ns > BEYOND_NS;
            if is_beyond { ns as f64 * 1e-9 } else { 0.0 }
        };
        let (begin_s, end_s) = span.map_or((0.0, 0.0), |(first, last)| {
            (
                beyond_s(sensor.first.saturating_sub(first)),
                beyond_s(last.saturating_sub(sensor.last)),
            )
        });
        if begin_s > 0.0 || end_s > 0.0 {
            faults.push(PhoneFault::Short {
                what,
                begin_s,
                end_s,
            });
        }
        if sensor.gaps > 0 {
            faults.push(PhoneFault::Gaps {
                what,
                count: sensor.gaps,
                longest_s: sensor.longest as f64 * 1e-9,
            });
        }
    }
    if let Some(assumed) = assumed {
        faults.extend(frames_differ(&frames, assumed));
    }
    Ok(faults)
}

/// Compares the timestamps of frames with what was assumed of them. Too few frames show nothing.
fn frames_differ(frames: &[PhoneNanos], assumed: &AssumedFrames) -> Option<PhoneFault> {
    let found = frame_period(frames).ok()?;
    let reported_ns = std::f64::consts::SQRT_2 * found.jitter_ns / INTERVALS;
    let sigma_ns = assumed.sigma_ns.unwrap_or(0.0).max(reported_ns);
    let most_ns = SIGMAS * sigma_ns.hypot(found.sigma_ns) + WARMS * found.period_ns;
    if (found.period_ns - assumed.period_ns).abs() > most_ns {
        return Some(PhoneFault::Period {
            found_ns: found.period_ns,
            assumed_ns: assumed.period_ns,
        });
    }
    let after = frames.partition_point(|time| *time < assumed.phase);
    let near = [after.checked_sub(1)?, after];
    let near = near.into_iter().filter_map(|place| frames.get(place));
    let distances = near.map(|time| {
        let distance = assumed.phase.0.saturating_sub(time.0) as f64;
        // Frames may be missing around it.
        distance - (distance / found.period_ns).round() * found.period_ns
    });
    let off_ns = distances.min_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    let is_off = off_ns.abs() > PHASE * found.period_ns + SIGMAS * found.jitter_ns;
    is_off.then_some(PhoneFault::Phase { off_ns })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    const PERIOD: i64 = 33_330_652;

    fn rows(step: i64, count: i64, row: &str) -> Vec<String> {
        (0..count)
            .map(|k| format!("{row}{}\n", 7_000_000_000 + k * step))
            .collect()
    }

    fn write(folder: &Path, name: &str, rows: &[String]) -> Option<std::path::PathBuf> {
        let path = folder.join(name);
        fs::write(&path, rows.concat()).unwrap();
        Some(path)
    }

    /// Twenty seconds at 30 frames and 400 and 100 samples a second.
    fn files(folder: &Path) -> VideoFiles {
        VideoFiles {
            name: String::from("VID"),
            video: None,
            frames: write(folder, "VID_imu_timestamps.csv", &rows(PERIOD, 600, "")),
            gyro: write(folder, "VIDgyro.csv", &rows(2_500_000, 8_000, "0,0,1,")),
            accel: write(folder, "VIDaccel.csv", &rows(10_000_000, 2_000, "0,0,9,")),
        }
    }

    fn assumed() -> AssumedFrames {
        AssumedFrames {
            phase: PhoneNanos(7_000_000_000 + 100 * PERIOD),
            period_ns: PERIOD as f64,
            sigma_ns: None,
            boot_minus_frames_ns: 0,
        }
    }

    #[test]
    fn a_sensor_that_is_cut_at_a_line_is_short() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path());
        let check = || check(&files, Some(&assumed()), &ReadMonitor::default()).unwrap();
        assert_eq!(check(), []);
        for (name, step, what) in [
            ("VIDgyro.csv", 2_500_000, "gyroscope"),
            ("VIDaccel.csv", 10_000_000, "accelerometer"),
        ] {
            let whole = rows(step, 20_000_000_000 / step, "0,0,1,");
            for part in [0, 1, 10, 50, 90] {
                write(folder.path(), name, &whole[..whole.len() * part / 100]);
                let [fault] = check().try_into().unwrap();
                match fault {
                    PhoneFault::Empty { what: found } => assert_eq!((found, part), (what, 0)),
                    PhoneFault::Short {
                        what: found,
                        begin_s,
                        end_s,
                    } => {
                        assert_eq!((found, begin_s), (what, 0.0));
                        assert!((end_s - 0.2 * (100 - part) as f64).abs() < 0.1, "{end_s}");
                    }
                    other => panic!("{other:?}"),
                }
            }
            // The begin is cut, or the middle.
            write(folder.path(), name, &whole[whole.len() / 2..]);
            assert!(matches!(check()[..], [PhoneFault::Short { begin_s, .. }] if begin_s > 9.0));
            let without = [&whole[..whole.len() / 2], &whole[whole.len() * 3 / 5..]].concat();
            write(folder.path(), name, &without);
            assert!(
                matches!(check()[..], [PhoneFault::Gaps { count: 1, longest_s, .. }] if longest_s > 1.9)
            );
            write(folder.path(), name, &whole);
        }
        let sparse = fs::OpenOptions::new()
            .write(true)
            .open(files.gyro.as_ref().unwrap())
            .unwrap();
        sparse.set_len(0).unwrap();
        sparse.set_len(1 << 40).unwrap();
        assert!(matches!(
            check()[..],
            [PhoneFault::Empty { what: "gyroscope" }]
        ));
    }

    #[test]
    fn frames_must_have_the_period_and_phase_that_were_assumed() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path());
        let check = |assumed: AssumedFrames| {
            check(&files, Some(&assumed), &ReadMonitor::default()).unwrap()
        };
        for off in [1e-2, -1e-2, 1e-3, 1e-4] {
            let period_ns = PERIOD as f64 * (1.0 + off);
            let faults = check(AssumedFrames {
                period_ns,
                ..assumed()
            });
            assert!(
                matches!(faults[..], [PhoneFault::Period { .. }]),
                "{off}: {faults:?}"
            );
            // A period that is known no better is no contradiction.
            let sigma_ns = Some(PERIOD as f64 * off.abs());
            assert_eq!(
                check(AssumedFrames {
                    period_ns,
                    sigma_ns,
                    ..assumed()
                }),
                []
            );
        }
        let phase = PhoneNanos(assumed().phase.0 + PERIOD / 3);
        let faults = check(AssumedFrames { phase, ..assumed() });
        assert!(
            matches!(faults[..], [PhoneFault::Phase { off_ns }] if off_ns > 11e6),
            "{faults:?}"
        );
        // A clock that stood still while the phone slept.
        let slept = 3_600_000_000_000;
        let faults = check(AssumedFrames {
            boot_minus_frames_ns: slept,
            ..assumed()
        });
        assert!(matches!(
            faults[..],
            [PhoneFault::Short { .. }, PhoneFault::Short { .. }]
        ));
    }
}
