//! The measurement on a recording whose session has flashed the LED.

use std::path::Path;

use clock::{BoardToPhone, PhoneNanos};
use phone::{frame_timestamps, video_files};
use protocol::TICK_HZ;
use recording::Item;
use recording::profile::measured::{MeasuredPhone, PhoneRows};
use recording::reader::Reader;
use recording::session_file::{LedRun, SessionFile};
use serde::Serialize;
use system::ReadMonitor;

use super::film::Film;
use super::{Expected, LedFlash, MeasuredRows, measure};
use crate::EvaluateError;

/// Most by which the middle of the middle row's exposure is off what a profile without
/// measurement expects, µs: delays of gyroscopes, and half of the longest readout and exposure.
const WITHIN_US: f64 = 25_000.0;

/// Measured rows of the phone that the trigger was aligned to, and the constants that follow.
#[derive(Debug, Clone, Serialize)]
pub struct Calibration {
    /// The rows as measured.
    #[serde(flatten)]
    pub rows: MeasuredRows,
    /// The constants that go into the profile.
    pub constants: PhoneRows,
    /// The conditions of the measurement.
    pub measured: MeasuredPhone,
}

impl Calibration {
    /// Describes it in a sentence.
    #[must_use]
    pub fn text(&self) -> String {
        let (rows, [delay_us, sigma_us]) = (&self.rows, self.constants.gyro_delay_us);
        format!(
            "the LED shows the middle row exposed {:.1} µs after a frame's timestamp, ± {:.1} µs with \
             the clocks: {} flashes in {} frames, readout {}, {:.4} ± {:.4} µs a row; so the \
             gyroscope's delay is {delay_us:.1} µs",
            rows.middle_us,
            sigma_us,
            rows.flashes,
            rows.frames,
            rows.direction.name(),
            rows.row_time_us,
            rows.row_time_sigma_us,
        )
    }
}

/// Measures the rows by the flashes that the recording holds, on the video in its folder. `None`
/// if no LED has flashed.
///
/// # Errors
///
/// The video, its timestamps or the relation of the clocks are missing, a file cannot be read, or
/// the video does not show the LED.
pub fn calibrate(
    folder: &Path,
    session: &SessionFile,
    monitor: &ReadMonitor,
) -> Result<Option<Calibration>, EvaluateError> {
    let Some(led) = &session.led else {
        return Ok(None);
    };
    let phone = &session.profile.phone;
    let place = folder.join(session.phone_folder(&phone.name));
    let missing = || EvaluateError::LedUnseen {
        path: place.clone(),
    };
    let record = session.reference().ok_or_else(missing)?;
    let (video, clock) = record.video.zip(record.clock).ok_or_else(missing)?;
    let files = video_files::find(&place, None).ok().flatten();
    let files = files.and_then(|files| files.video.zip(files.frames));
    let (film, stamps) = files.ok_or_else(missing)?;
    let stamps = frame_timestamps::read(&stamps, monitor).map_err(|_| missing())?;
    let from_s = led.span.from.as_secs_f64();
    let board_us = |stamp: &PhoneNanos| {
        let boot = PhoneNanos(stamp.0.saturating_add(video.boot_minus_frames_ns));
        (clock.to_board(boot.seconds()).0 - from_s) * 1e6
    };
    let times_us: Vec<f64> = stamps.iter().map(board_us).collect();
    let film = Film::read_file(&film, &times_us, None, monitor)?;
    let exposure_us = video.exposure_us().unwrap_or(phone.exposure_us);
    let expected = Expected {
        middle_us: 0.5 * (exposure_us + phone.readout_us),
        within_us: WITHIN_US,
    };
    let rows = measure(&film, &flashes(folder, session, led)?, &expected)?;
    let readout = |row_us: f64| row_us * rows.rows.saturating_sub(1) as f64;
    let readout_us = [readout(rows.row_time_us), readout(rows.row_time_sigma_us)];
    // What a wrong delay moves in the relation of the clocks is in the measured time.
    let delay_us = phone.gyro_delay_us + rows.middle_us - 0.5 * (exposure_us + readout_us[0]);
    let middle_s = 0.5 * (from_s + led.span.to.as_secs_f64());
    let clock_us = clock.offset_at(middle_s).sigma * 1e6;
    let constants = PhoneRows {
        gyro_delay_us: [delay_us, rows.middle_sigma_us.hypot(clock_us)],
        readout_us,
        direction: rows.direction,
    };
    Ok(Some(Calibration {
        rows,
        constants,
        measured: MeasuredPhone {
            date: session.day(),
            phone: phone.name.clone(),
            exposure_us,
            app: record.version.clone(),
        },
    }))
}

/// The flashes, from the beginning of the LED's run.
fn flashes(
    folder: &Path,
    session: &SessionFile,
    led: &LedRun,
) -> Result<Vec<LedFlash>, EvaluateError> {
    let name = session.profile.output_name(led.output);
    let is_camera = led.output.is_camera();
    let micros = |ticks: f64| ticks * 1e6 / f64::from(TICK_HZ);
    let length_us = micros(led.length.into());
    let mut flashes = Vec::new();
    for entry in Reader::open(folder)? {
        let pulse = match entry?.item {
            Item::Output(pulse) if !is_camera && pulse.header.frame_id == name => pulse,
            Item::Pulse(pulse) if is_camera => pulse,
            _ => continue,
        };
        if (led.span.from.0..=led.span.to.0).contains(&pulse.ticks) {
            flashes.push(LedFlash {
                middle_us: micros((pulse.ticks - led.span.from.0) as f64) + 0.5 * length_us,
                length_us,
            });
        }
    }
    Ok(flashes)
}
