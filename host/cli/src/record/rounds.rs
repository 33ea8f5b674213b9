//! What is looked at once a second: the depth recorder and the disk.

use std::time::{Duration, Instant};

use super::Stop;
use super::depth_recorder::DepthRecorder;
use super::journal::Journal;
use crate::outcome::{ExitStatus, Failure};
use recording::MCAP_FILE;
use recording::finding::Finding;
use recording::finding::Severity;

/// How often they are looked at.
const EVERY: Duration = Duration::from_secs(1);

/// Below this much free space a warning is given, bytes. An hour of recording is
/// about 150 MB, and videos go to the phone.
const DISK_LOW: u64 = 1_000_000_000;

/// Below this much free space the session is stopped while it still can be
/// closed well, bytes.
const DISK_FULL: u64 = 20_000_000;

/// The depth recorder while it runs, and when both were looked at.
pub(super) struct Rounds {
    pub(super) depth: Option<DepthRecorder>,
    last: Instant,
    disk_warned: bool,
}

impl Rounds {
    pub(super) fn new() -> Self {
        Self {
            depth: None,
            last: Instant::now(),
            disk_warned: false,
        }
    }

    /// Starts the depth recorder of the profile, if there is one.
    pub(super) fn start_recorder(&mut self, journal: &mut Journal<'_>) -> Result<(), Stop> {
        self.depth = DepthRecorder::start(&journal.file.profile.depth, &journal.folder)?;
        if self.depth.is_some() {
            journal.info("depth_recorder", "the depth recorder runs")?;
        }
        Ok(())
    }

    /// Looks, if it is time to. A full disk ends the session unless it is `closing`.
    pub(super) fn look(&mut self, journal: &mut Journal<'_>, closing: bool) -> Result<(), Stop> {
        if self.last.elapsed() < EVERY {
            return Ok(());
        }
        self.last = Instant::now();
        if let Some(text) = self.depth.as_mut().and_then(DepthRecorder::gone) {
            journal.problem(Finding::bad("depth_recorder_gone", text))?;
        }
        if !journal.folder.join(MCAP_FILE).exists() && !closing {
            return Err(Failure::new(
                ExitStatus::Storage,
                format!(
                    "the recording in {} was deleted or moved",
                    journal.folder.display()
                ),
            )
            .next_step("leave the folder in its place while it is recorded into, and record again")
            .into());
        }
        let Some(free) = free_space(&journal.folder) else {
            return Ok(());
        };
        if free < DISK_FULL && !closing {
            return Err(Failure::new(
                ExitStatus::Storage,
                format!("the disk is full: {} MB are left", free / 1_000_000),
            )
            .next_step("free some space; what was recorded is kept")
            .into());
        }
        if free < DISK_LOW && !self.disk_warned {
            self.disk_warned = true;
            let text = format!("the disk is nearly full: {} MB are left", free / 1_000_000);
            journal.tell(Severity::Check, "disk_nearly_full", &text)?;
        }
        Ok(())
    }
}

/// Free space for this user on the disk of a folder, bytes; `None` where it
/// cannot be told.
pub(crate) fn free_space(folder: &std::path::Path) -> Option<u64> {
    let stat = rustix::fs::statvfs(folder).ok()?;
    Some(stat.f_bavail.saturating_mul(stat.f_frsize))
}
