//! Cancellation of work, and progress of long reads.
//!
//! Both are handles: the owner of the work makes one and passes it to each reader. A reader calls
//! [`ReadMonitor::check`] before each of its reads, so a loop over an input needs no check of its
//! own: its next read fails with an error for which [`is_cancelled`] is true.

use std::error::Error;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A question that work asks while it lasts: is it cancelled? Cheap to clone.
///
/// The default is never cancelled.
#[derive(Clone, Default)]
pub struct Cancel(Option<Arc<dyn Fn() -> bool + Send + Sync>>);

impl Cancel {
    /// Creates a question that is answered by `is_requested`.
    pub fn when(is_requested: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(is_requested)))
    }

    /// Returns true once the work is to end.
    #[must_use]
    pub fn is_requested(&self) -> bool {
        self.0.as_ref().is_some_and(|is_requested| is_requested())
    }
}

impl fmt::Debug for Cancel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Cancel").field(&self.is_requested()).finish()
    }
}

/// Position of a read in its file.
#[derive(Clone, Copy, Debug)]
pub struct ReadProgress<'a> {
    /// The file that is read.
    pub path: &'a Path,
    /// Bytes before the next read.
    pub position: u64,
    /// Bytes of the whole file, or 0 if that is unknown.
    pub length: u64,
}

type Report = Arc<dyn Fn(&ReadProgress<'_>) + Send + Sync>;

/// Follows reads and cancels them. Cheap to clone.
///
/// The default reports nothing and never cancels.
#[derive(Clone, Default)]
pub struct ReadMonitor {
    cancel: Cancel,
    report: Option<Report>,
    has_cancelled: Arc<AtomicBool>,
}

impl ReadMonitor {
    /// Creates a monitor whose reads fail once `cancel` is requested, and that passes the position
    /// before each read to `report`.
    pub fn new(cancel: Cancel, report: impl Fn(&ReadProgress<'_>) + Send + Sync + 'static) -> Self {
        Self {
            cancel,
            report: Some(Arc::new(report)),
            has_cancelled: Arc::default(),
        }
    }

    /// Returns true if reads are to end, after which the caller's work is not complete.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        let is_requested = self.cancel.is_requested();
        self.has_cancelled.fetch_or(is_requested, Ordering::Relaxed);
        is_requested
    }

    /// Returns true if a read, or work that asked, was cancelled.
    #[must_use]
    pub fn has_cancelled(&self) -> bool {
        self.has_cancelled.load(Ordering::Relaxed)
    }

    /// Reports a read that is about to begin.
    ///
    /// # Errors
    ///
    /// Reads are cancelled; [`is_cancelled`] is true for the error.
    pub fn check(&self, progress: &ReadProgress<'_>) -> io::Result<()> {
        if let Some(report) = &self.report {
            report(progress);
        }
        if self.is_cancelled() {
            return Err(io::Error::other(Cancelled));
        }
        Ok(())
    }

    /// Returns the question of a program that reads the file at `path`. Each time it is asked, the
    /// read is reported, without position and length.
    #[must_use]
    pub fn cancel_reading(&self, path: &Path) -> Cancel {
        let (monitor, path) = (self.clone(), PathBuf::from(path));
        Cancel::when(move || {
            let progress = ReadProgress {
                path: &path,
                position: 0,
                length: 0,
            };
            monitor.check(&progress).is_err()
        })
    }
}

impl fmt::Debug for ReadMonitor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ReadMonitor").field(&self.cancel).finish()
    }
}

/// Payload of the [`io::Error`] of a cancelled read.
#[derive(Debug, thiserror::Error)]
#[error("stopped before its end")]
pub(crate) struct Cancelled;

/// Returns true if `error` or one of its sources is that of a cancelled read or program.
#[must_use]
pub fn is_cancelled(error: &(dyn Error + 'static)) -> bool {
    let is_cancelled = |error: &(dyn Error + 'static)| {
        let io = error.downcast_ref::<io::Error>();
        let payload = io.and_then(io::Error::get_ref);
        payload.is_some_and(|payload| payload.is::<Cancelled>())
    };
    std::iter::successors(Some(error), |&error| error.source()).any(is_cancelled)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("outer")]
    struct Outer(#[source] io::Error);

    #[test]
    fn a_cancelled_read_is_found_among_the_sources_of_an_error() {
        let monitor = ReadMonitor::new(Cancel::when(|| true), |_| ());
        let progress = ReadProgress {
            path: Path::new("file"),
            position: 0,
            length: 0,
        };
        assert!(!monitor.has_cancelled());
        let error = monitor.check(&progress).unwrap_err();
        assert!(monitor.has_cancelled());
        assert_eq!(error.to_string(), "stopped before its end");
        assert!(is_cancelled(&error));
        assert!(is_cancelled(&Outer(error)));
        assert!(!is_cancelled(&Outer(io::Error::other("disk"))));
        assert!(monitor.cancel_reading(progress.path).is_requested());
        assert!(ReadMonitor::default().check(&progress).is_ok());
    }
}
