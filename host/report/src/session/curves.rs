//! What the plots of a report need of the recording, read once from front to back.

use std::collections::BTreeMap;
use std::path::Path;

use protocol::Ticks;

use super::MAX_LISTED;
use crate::chart::Envelope;
use recording::RecordingError;
use recording::grid::FollowedGrid;
use recording::reader::{Item, Reader};
use recording::session_file::SessionFile;

/// Letters of a sensor's name that are shown.
const MAX_NAME: usize = 200;

/// What the plots need of the recording.
#[derive(Debug, Default)]
pub(super) struct Curves {
    pub(super) gyro: [Envelope; 3],
    pub(super) off_grid: Envelope,
    pub(super) readback: Envelope,
    pub(super) load: Envelope,
    pub(super) temperature: Envelope,
    /// Pulses of auxiliary outputs by the sensor's name: how many, first and last.
    pub(super) outputs: BTreeMap<String, (u64, Ticks, Ticks)>,
    /// Seconds of a lidar: how many, the last with the UTC that it was told, ns; and
    /// whether all tell one relation.
    pub(super) gnss: Option<Gnss>,
    pub(super) broken_off: bool,
    /// The grid of the alignment, from change to change of the trigger's period.
    grid: Option<FollowedGrid>,
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
    pub(super) fn read(recording: &Path, session: &SessionFile) -> Result<Self, RecordingError> {
        let alignment = session.alignment.as_ref();
        let mut curves = Self {
            grid: alignment.map(|alignment| FollowedGrid::new(alignment.into())),
            ..Self::default()
        };
        let mut reader = Reader::open(recording)?;
        for entry in reader.by_ref() {
            match entry {
                Ok(entry) => curves.take(entry.at, &entry.item, session),
                Err(error @ RecordingError::Io { .. }) => return Err(error),
                Err(_) => curves.broken_off = true,
            }
        }
        curves.broken_off |= reader.broken_off();
        Ok(curves)
    }

    fn take(&mut self, at: Ticks, item: &Item, session: &SessionFile) {
        let x = at.as_secs_f64();
        match item {
            Item::Imu(imu) => {
                let rates = imu.angular_velocity;
                for (envelope, rate) in self.gyro.iter_mut().zip(rates) {
                    envelope.add(x, rate);
                }
            }
            Item::Period(period) => {
                if let Some(grid) = &mut self.grid {
                    grid.follow(period.into());
                }
            }
            Item::Temperature(value) => self.temperature.add(x, value.temperature),
            Item::Pulse(pulse) => {
                if pulse.readback {
                    self.readback.add(x, f64::from(pulse.readback_ticks));
                }
                if let (Some(grid), Some(span)) = (&self.grid, session.recorded)
                    && (span.from..=span.to).contains(&at)
                {
                    self.off_grid.add(x, grid.off(at).0 as f64);
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
            Item::Status(status) => {
                let mut values = status.status.iter().flat_map(|part| &part.values);
                let load = values.find(|value| value.key == "cpu_permille");
                if let Some(Ok(load)) = load.map(|load| load.value.parse::<f64>()) {
                    self.load.add(x, load / 10.0);
                }
            }
            _ => {}
        }
    }
}
