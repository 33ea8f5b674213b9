//! The look at the depth recorder and at the disk, once a second.

use std::path::Path;
use std::time::Duration;

use recording::MCAP_FILE;

use crate::devices::{Clock, DepthRecorder};
use crate::error::{SessionError, Stop};
use crate::event::SessionEvent;
use crate::log::Log;

/// How often they are looked at.
const EVERY: Duration = Duration::from_secs(1);

/// Below this much free space a warning is given, bytes. An hour of recording is
/// about 150 MB, and videos go to the phone.
const DISK_LOW: u64 = 1_000_000_000;

/// Below this much free space the session is stopped while it still can be
/// closed well, bytes.
pub const DISK_FULL: u64 = 20_000_000;

/// The depth recorder, and when both were looked at.
pub(crate) struct Housekeeping<'a> {
    pub(crate) recorder: &'a mut dyn DepthRecorder,
    /// The recorder was started, and has not been seen to end.
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

    /// Starts the depth recorder of the profile, if there is one.
    pub(crate) fn start_recorder(&mut self, log: &mut Log<'_>) -> Result<(), Stop> {
        let depth = &log.file.profile.depth;
        self.recorder_runs = self.recorder.start(depth, &log.folder)?;
        match self.recorder_runs {
            true => log.report(SessionEvent::RecorderStarted),
            false => Ok(()),
        }
    }

    /// Looks, if it is time to. A full disk ends the session unless it is `closing`.
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
            return match closing {
                true => Ok(()),
                false => Err(SessionError::RecordingMoved {
                    folder: log.folder.clone(),
                }
                .into()),
            };
        };
        let Some(free) = free_space(&log.folder) else {
            return Ok(());
        };
        log.tell(SessionEvent::Disk {
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

/// Free space for this user on the disk of a folder, bytes; `None` where the system does
/// not say.
#[must_use]
pub fn free_space(folder: &Path) -> Option<u64> {
    let stat = rustix::fs::statvfs(folder).ok()?;
    Some(stat.f_bavail.saturating_mul(stat.f_frsize))
}
