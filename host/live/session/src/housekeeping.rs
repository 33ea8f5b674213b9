//! Watches the depth recorder and the disk, once a second.

use std::path::Path;
use std::time::Duration;

use recording::MCAP_FILE;
use recording::profile::Depth;

use crate::devices::{Clock, DepthRecorder};
use crate::error::{SessionError, Stop};
use crate::event::SessionEvent;
use crate::log::Log;

/// Interval of the looks.
const EVERY: Duration = Duration::from_secs(1);

/// Free space below which a warning is given, bytes. An hour of recording takes about 150 MB;
/// videos are stored on the phone.
const DISK_LOW: u64 = 1_000_000_000;

/// Free space below which the session is stopped, bytes: enough to close it properly.
pub const DISK_FULL: u64 = 20_000_000;

/// The depth recorder, and the time of the last look.
pub(crate) struct Housekeeping<'a> {
    pub(crate) recorder: &'a mut dyn DepthRecorder,
    /// True if the recorder was started, and its end was not seen yet.
    pub(crate) recorder_runs: bool,
    last: Duration,
    has_warned: bool,
}

impl<'a> Housekeeping<'a> {
    pub(crate) fn new(recorder: &'a mut dyn DepthRecorder, now: Duration) -> Self {
        Self {
            recorder,
            recorder_runs: false,
            last: now,
            has_warned: false,
        }
    }

    /// Starts the depth recorder that `depth` names, if there is one.
    pub(crate) fn start_recorder(&mut self, depth: &Depth, log: &mut Log<'_>) -> Result<(), Stop> {
        self.recorder_runs = self.recorder.start(depth, &log.folder)?;
        if self.recorder_runs {
            log.report(SessionEvent::RecorderStarted)?;
        }
        Ok(())
    }

    /// Looks at recorder and disk if it is time to. A full disk ends the session unless it is
    /// `closing`.
    pub(crate) fn look(
        &mut self,
        clock: &dyn Clock,
        log: &mut Log<'_>,
        closing: bool,
    ) -> Result<(), Stop> {
        let now = clock.now();
        if now.saturating_sub(self.last) < EVERY {
            return Ok(());
        }
        self.last = now;
        if self.recorder_runs
            && !closing
            && let Some(end) = self.recorder.poll()
        {
            self.recorder_runs = false;
            log.report(SessionEvent::RecorderGone { end })?;
        }
        let Ok(file) = log.folder.join(MCAP_FILE).metadata() else {
            if closing {
                return Ok(());
            }
            let folder = log.folder.clone();
            return Err(SessionError::RecordingMoved { folder }.into());
        };
        let Some(free) = free_space(&log.folder) else {
            return Ok(());
        };
        log.publish(SessionEvent::Disk {
            free,
            recorded: file.len(),
        });
        if free < DISK_FULL && !closing {
            return Err(SessionError::DiskFull { free }.into());
        }
        if free < DISK_LOW && !self.has_warned {
            self.has_warned = true;
            log.report(SessionEvent::DiskNearlyFull { free })?;
        }
        Ok(())
    }
}

/// Returns the free space for this user on the disk of a folder, bytes; `None` if the system
/// does not report it.
#[must_use]
pub fn free_space(folder: &Path) -> Option<u64> {
    let stat = rustix::fs::statvfs(folder).ok()?;
    Some(stat.f_bavail.saturating_mul(stat.f_frsize))
}
