//! `ffmpeg` while it runs.

use std::io::{self, Read};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::thread::JoinHandle;

use super::{VideoError, run_error};

/// Bytes of ffmpeg's messages that are kept.
const MAX_MESSAGES: u64 = 16 * 1024;

/// `ffmpeg` while it runs. Dropping it stops it.
#[derive(Debug)]
pub(super) struct Ffmpeg {
    child: Child,
    messages: Option<JoinHandle<String>>,
}

impl Ffmpeg {
    /// Starts it.
    pub(super) fn start(command: &mut Command) -> Result<Self, VideoError> {
        let mut child = command
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| run_error("ffmpeg", error))?;
        Ok(Self {
            messages: child
                .stderr
                .take()
                .map(|stderr| std::thread::spawn(move || keep_start(stderr))),
            child,
        })
    }

    /// What it writes to, if that is a pipe.
    pub(super) fn output(&mut self) -> Option<ChildStdout> {
        self.child.stdout.take()
    }

    /// Waits until it has ended; returns what it complained about.
    pub(super) fn end(&mut self) -> Result<Option<String>, VideoError> {
        let status = self.child.wait();
        let status = status.map_err(|error| run_error("ffmpeg", error))?;
        let messages = self.messages.take().and_then(|thread| thread.join().ok());
        // The first line names the cause; with `-v error` there is little else.
        Ok(match messages.unwrap_or_default().lines().next() {
            Some(first) => Some(first.to_owned()),
            None => (!status.success()).then(|| "no message".to_owned()),
        })
    }
}

impl Drop for Ffmpeg {
    fn drop(&mut self) {
        // Both calls may find that it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads everything, so that `ffmpeg` never waits, and keeps the beginning.
fn keep_start(mut stderr: ChildStderr) -> String {
    let mut kept = Vec::new();
    let _ = stderr.by_ref().take(MAX_MESSAGES).read_to_end(&mut kept);
    let _ = io::copy(&mut stderr, &mut io::sink());
    String::from_utf8_lossy(&kept).trim().to_owned()
}
