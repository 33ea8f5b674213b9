//! What the plots of a report need of the recording, read once from front to back.

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

/// Letters of a sensor's name that are shown.
const MAX_NAME: usize = 200;

/// The most losses that are kept, for an hour of one a second.
const MAX_LOSSES: usize = 3_600;

/// What the plots need of the recording.
#[derive(Debug, Default)]
pub(super) struct Curves {
    /// Rate of rotation, rad/s.
    pub(super) gyro: Envelope,
    pub(super) readback: Envelope,
    pub(super) temperature: Envelope,
    /// From sample to sample of the IMU, µs.
    pub(super) imu_intervals: Envelope,
    /// From pulse to pulse of the camera while it was recorded, µs.
    pub(super) pulse_intervals: Envelope,
    last_imu: Option<f64>,
    last_pulse: Option<f64>,
    /// Both gyroscopes in each twist.
    pub(super) twists: Vec<TwistRates>,
    /// Depth less phone at each pulse, µs.
    pub(super) phase: Envelope,
    frames: Option<Frames>,
    /// Where messages are missing by the board's numbers: when, of which stream, how many.
    pub(super) losses: Vec<(Ticks, Stream, u32)>,
    /// The next number of each stream.
    expected: [Option<u32>; Stream::ALL.len()],
    /// Pulses of auxiliary outputs by the sensor's name: how many, first and last.
    pub(super) outputs: BTreeMap<String, (u64, Ticks, Ticks)>,
    /// Seconds of a lidar: how many, the last with the UTC that it was told, ns; and
    /// whether all tell one relation.
    pub(super) gnss: Option<Gnss>,
    pub(super) broken_off: bool,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Gnss {
    pub(super) seconds: u64,
    pub(super) last: Ticks,
    pub(super) utc_ns: i64,
    pub(super) changed: bool,
}

impl Curves {
    /// Reads a recording.
    ///
    /// # Errors
    ///
    /// It cannot be read. A recording that is damaged gives what is left.
    pub(super) fn read(
        recording: &Path,
        session: &SessionFile,
        monitor: &ReadMonitor,
    ) -> Result<Self, RecordingError> {
        let mut curves = Self {
            twists: TwistRates::of_session(recording, session, monitor),
            frames: Frames::of_session(recording, session, monitor),
            ..Self::default()
        };
        let mut reader = Reader::with_monitor(recording, monitor)?;
        for entry in reader.by_ref() {
            match entry {
                Ok(entry) => {
                    curves.number(entry.at, &entry);
                    curves.take(entry.at, &entry.item, session);
                }
                Err(error @ RecordingError::Io { .. }) => return Err(error),
                Err(_) => curves.broken_off = true,
            }
        }
        curves.broken_off |= reader.broken_off();
        Ok(curves)
    }

    /// Follows the board's number of a message.
    fn number(&mut self, at: Ticks, entry: &Entry) {
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

    fn take(&mut self, at: Ticks, item: &Item, session: &SessionFile) {
        let x = at.as_secs_f64();
        match item {
            Item::Imu(imu) => {
                if let Some(last) = self.last_imu.replace(x) {
                    self.imu_intervals.add(x, (x - last) * 1e6);
                }
                for twist in &mut self.twists {
                    twist.take(at, imu);
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
                    if let Some(difference) = frames.and_then(|it| it.difference_us(at)) {
                        self.phase.add(x, difference);
                    }
                }
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
