//! The board's pulses beside the frames of a video: where each frame's train should be.

use std::path::Path;

use clock::BoardToPhone as _;
use protocol::Ticks;
use recording::reader::{Item, Reader};
use recording::session_file::SessionFile;
use recording::{MCAP_FILE, RecordingError};
use system::ReadMonitor;

use crate::EvaluateError;

/// Pulses on the clock of the phone's frames.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Trigger {
    /// Edges, ns, ascending.
    edges: Vec<i64>,
    /// Centre of the train minus the edge, minus the middle row's centre of exposure plus the frame's
    /// timestamp, µs. It need not be exact: it tells which pulse is a frame's.
    offset_us: f64,
}

impl Trigger {
    /// Reads the pulses of a recording that aligned its trigger; `None` if it has none.
    ///
    /// # Errors
    ///
    /// Fails if the recording cannot be read. Damaged parts are left out.
    pub(super) fn read(
        folder: &Path,
        session: &SessionFile,
        monitor: &ReadMonitor,
    ) -> Result<Option<Self>, EvaluateError> {
        let reference = session.reference();
        let video = reference.and_then(|phone| phone.video);
        let known = session.alignment.zip(session.clock()).zip(video);
        let Some(((alignment, clock), video)) = known else {
            return Ok(None);
        };
        if !folder.join(MCAP_FILE).is_file() {
            return Ok(None);
        }
        let mut edges = Vec::new();
        for entry in Reader::with_monitor(folder, monitor)? {
            match entry {
                Ok(entry) => {
                    if let Item::Pulse(pulse) = entry.item {
                        let at = clock.ticks_to_phone(Ticks(pulse.ticks)).0;
                        edges.push(at.saturating_sub(video.boot_minus_frames_ns));
                    }
                }
                // A message that cannot be read is left out, as damage is.
                Err(RecordingError::Message { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        edges.sort_unstable();
        let phone = &session.profile.phone;
        let middle_us = 0.5 * alignment.exposure_us + phone.middle_row_us();
        Ok((!edges.is_empty()).then_some(Self {
            edges,
            offset_us: alignment.center_offset_us - middle_us,
        }))
    }

    /// Returns the place of the nearest train in a frame, µs after the middle row's centre of exposure,
    /// but for a constant. The frame is `time_s` after the one at `first_ns`.
    pub(crate) fn bias_us(&self, first_ns: i64, time_s: f64) -> Option<f64> {
        let frame = first_ns.saturating_add((time_s * 1e9).round() as i64);
        let wanted = frame.saturating_sub((self.offset_us * 1e3) as i64);
        let after = self.edges.partition_point(|edge| *edge < wanted);
        let near = [after.checked_sub(1), Some(after)];
        let near = near.into_iter().flatten().filter_map(|k| self.edges.get(k));
        let edge = near.min_by_key(|edge| edge.abs_diff(wanted))?;
        Some(edge.saturating_sub(frame) as f64 * 1e-3 + self.offset_us)
    }
}
