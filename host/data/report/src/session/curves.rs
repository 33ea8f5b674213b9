//! The data of a recording that the plots of its report show, read in one pass.

use std::collections::BTreeMap;
use std::path::Path;

use protocol::Ticks;

use super::MAX_LISTED;
use super::measured::{Frames, TwistRates, norm};
use crate::chart::Envelope;
use board::{Stream, follow};
use recording::RecordingError;
use recording::reader::{Entry, Item, Reader};
use recording::session_file::SessionFile;
use system::ReadMonitor;

/// Most letters of a sensor's name.
const MAX_NAME: usize = 200;

/// Most steps of the trigger's period that are drawn: those of a day.
const MAX_STEPS: usize = 20_000;

/// Most losses that are stored: one a second for an hour.
const MAX_LOSSES: usize = 3_600;

/// Data of a recording for the plots.
#[derive(Debug, Default)]
pub(super) struct Curves {
    /// Magnitude of the angular rate, rad/s.
    pub(super) gyro: Envelope,
    /// Delay of the read-back behind the trigger's edge, ticks.
    pub(super) readback: Envelope,
    /// Temperature of the IMU, °C.
    pub(super) temperature: Envelope,
    /// Time from sample to sample of the IMU, µs.
    pub(super) imu_intervals: Envelope,
    /// Time from pulse to pulse of the camera while it was recorded, µs.
    pub(super) pulse_intervals: Envelope,
    last_imu: Option<f64>,
    last_pulse: Option<f64>,
    /// Rates of both gyroscopes in each twist.
    pub(super) twists: Vec<TwistRates>,
    /// Board time, s, and 1-sigma of the phase, µs, at each step of a trigger that follows the phone's
    /// clock.
    pub(super) tracked_us: Vec<(f64, f64)>,
    /// Depth minus phone at each pulse, µs.
    pub(super) phase: Envelope,
    frames: Option<Frames>,
    /// Gaps in the board's numbers: time, stream and number of missing messages.
    pub(super) losses: Vec<(Ticks, Stream, u32)>,
    /// Next number of each stream.
    expected: [Option<u32>; Stream::ALL.len()],
    /// Pulses of auxiliary outputs by the sensor's name: number, first and last.
    pub(super) outputs: BTreeMap<String, (u64, Ticks, Ticks)>,
    /// Seconds that a lidar received.
    pub(super) gnss: Option<Gnss>,
    /// True if the recording is not closed, or damaged.
    pub(super) broken_off: bool,
}

/// The seconds with UTC that the board sent to a lidar.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gnss {
    /// Number of seconds.
    pub(super) seconds: u64,
    /// Begin of the last second.
    pub(super) last: Ticks,
    /// UTC of the last second, ns.
    pub(super) utc_ns: i64,
    /// True if the relation of UTC to board time changed.
    pub(super) changed: bool,
}

impl Curves {
    /// Reads a recording. Damaged parts are skipped.
    ///
    /// # Errors
    ///
    /// Fails if the files cannot be read.
    pub(super) fn read(
        recording: &Path,
        session: &SessionFile,
        monitor: &ReadMonitor,
    ) -> Result<Self, RecordingError> {
        let mut curves = Self {
            twists: TwistRates::from_session(recording, session, monitor),
            frames: Frames::from_session(recording, session, monitor),
            ..Self::default()
        };
        let mut reader = Reader::with_monitor(recording, monitor)?;
        for entry in reader.by_ref() {
            match entry {
                Ok(entry) => {
                    curves.check_number(entry.at, &entry);
                    curves.add(entry.at, &entry.item, session);
                }
                Err(error @ RecordingError::Io { .. }) => return Err(error),
                Err(_) => curves.broken_off = true,
            }
        }
        curves.broken_off |= reader.broken_off();
        Ok(curves)
    }

    /// Checks the board's number of a message for a gap.
    fn check_number(&mut self, at: Ticks, entry: &Entry) {
        let Some(stream) = entry.item.topic().stream() else {
            return;
        };
        let Some(expected) = self.expected.get_mut(stream as usize) else {
            return;
        };
        if let Some(missing @ 1..) = follow(expected, entry.sequence)
            && self.losses.len() < MAX_LOSSES
        {
            self.losses.push((at, stream, missing));
        }
    }

    fn add(&mut self, at: Ticks, item: &Item, session: &SessionFile) {
        let x = at.as_secs_f64();
        match item {
            Item::Imu(imu) => {
                if let Some(last) = self.last_imu.replace(x) {
                    self.imu_intervals.add(x, (x - last) * 1e6);
                }
                for twist in &mut self.twists {
                    twist.add(at, imu);
                }
                self.gyro.add(x, norm(imu.angular_velocity));
            }
            Item::Temperature(value) => self.temperature.add(x, value.temperature),
            Item::Pulse(pulse) => {
                if pulse.readback {
                    self.readback.add(x, f64::from(pulse.readback_ticks));
                }
                if session.alignment.is_some()
                    && let Some(span) = session.recorded
                    && (span.from..=span.to).contains(&at)
                {
                    if let Some(last) = self.last_pulse.replace(x) {
                        self.pulse_intervals.add(x, (x - last) * 1e6);
                    }
                    let frames = self.frames.as_mut();
                    if let Some(difference) = frames.and_then(|frames| frames.difference_us(at)) {
                        self.phase.add(x, difference);
                    }
                }
            }
            Item::Period(period) if self.tracked_us.len() < MAX_STEPS => {
                self.tracked_us.push((x, period.phase_sigma_us));
            }
            Item::Output(pulse) => {
                // A damaged recording may hold any name.
                let name: String = pulse.header.frame_id.chars().take(MAX_NAME).collect();
                if self.outputs.len() < MAX_LISTED || self.outputs.contains_key(&name) {
                    let seen = self.outputs.entry(name).or_insert((0, at, at));
                    *seen = (seen.0 + 1, seen.1, at);
                }
            }
            Item::Gnss(second) => {
                let utc_ns = second.time_ref.nanos();
                let relation = |at: Ticks, utc: i64| i128::from(utc) - i128::from(at.as_nanos());
                let (seconds, changed) = self.gnss.map_or((0, false), |gnss| {
                    let moved = relation(gnss.last, gnss.utc_ns) != relation(at, utc_ns);
                    (gnss.seconds, gnss.changed || moved)
                });
                self.gnss = Some(Gnss {
                    seconds: seconds + 1,
                    last: at,
                    utc_ns,
                    changed,
                });
            }
            _ => {}
        }
    }
}
