//! `ffmpeg` and `ffprobe` while they run, within limits: neither a video nor a program that
//! stands for them makes us wait, read or keep messages for ever.

use std::io::{self, Read as _};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::process::{Pid, Signal, kill_process_group};
use system::{Reading, look};

use super::{VideoError, run_error};

/// Bytes of messages that are kept.
const KEPT_MESSAGES: u64 = 16 * 1024;

/// Bytes of one read of an answer.
const BLOCK: usize = 64 * 1024;

/// Time between two looks at whether to stop: 100 ms.
const LOOK: Timespec = Timespec {
    tv_sec: 0,
    tv_nsec: 100_000_000,
};

/// What a program may do before it is ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Time without a byte while one is waited for, and from the last byte to the end.
    pub(super) silence: Duration,
    /// Bytes of messages. A damaged video makes some 100 a frame.
    pub(super) messages: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            silence: Duration::from_secs(60),
            messages: 64 << 20,
        }
    }
}

/// A program while it runs. Dropping it ends it, with all that it started.
#[derive(Debug)]
pub(super) struct Running {
    name: &'static str,
    /// The video.
    path: PathBuf,
    child: Child,
    /// `None` after the end.
    pipe: Option<ChildStdout>,
    /// The beginning of its messages, once they end or are too many.
    messages: Receiver<String>,
    has_too_many: Arc<AtomicBool>,
    limits: Limits,
}

impl Running {
    /// Starts a program on a video.
    pub(super) fn start(
        name: &'static str,
        command: &mut Command,
        path: &Path,
        limits: Limits,
    ) -> Result<Self, VideoError> {
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C at the terminal is for us, and what it starts ends with it.
            .process_group(0)
            .spawn()
            .map_err(|error| run_error(name, error))?;
        let (sender, messages) = channel();
        let has_too_many = Arc::new(AtomicBool::new(false));
        if let Some(stderr) = child.stderr.take() {
            let too_many = Arc::clone(&has_too_many);
            std::thread::spawn(move || {
                let (kept, all) = keep_start(stderr, limits.messages);
                too_many.store(!all, Ordering::Relaxed);
                // Nobody may wait for it any more.
                let _ = sender.send(kept);
            });
        }
        Ok(Self {
            name,
            path: path.to_owned(),
            pipe: child.stdout.take(),
            child,
            messages,
            has_too_many,
            limits,
        })
    }

    /// Reads up to `most` bytes into `out`; fewer at the end of what it writes.
    pub(super) fn read(&mut self, most: usize, out: &mut Vec<u8>) -> Result<usize, VideoError> {
        out.resize(most, 0);
        let (mut read, mut heard) = (0, Instant::now());
        while read < most {
            self.may_go_on(heard)?;
            let Some(pipe) = &mut self.pipe else { break };
            let mut ready = [PollFd::new(pipe, PollFlags::IN)];
            let is_ready = match poll(&mut ready, Some(&LOOK)) {
                Ok(count) => count > 0,
                Err(Errno::INTR) => false,
                Err(error) => return Err(run_error(self.name, error.into())),
            };
            if is_ready {
                let free = out.get_mut(read..).unwrap_or_default();
                match pipe.read(free) {
                    Ok(0) => self.pipe = None,
                    Ok(more) => (read, heard) = (read + more, Instant::now()),
                    Err(error) => return Err(run_error(self.name, error)),
                }
            }
        }
        out.truncate(read);
        Ok(read)
    }

    /// Reads what it writes to its end; `None` if that is more than `most` bytes.
    pub(super) fn read_all(&mut self, most: usize) -> Result<Option<Vec<u8>>, VideoError> {
        let (mut all, mut part) = (Vec::new(), Vec::new());
        while self.read(BLOCK, &mut part)? > 0 {
            all.append(&mut part);
            if all.len() > most {
                return Ok(None);
            }
        }
        Ok(Some(all))
    }

    /// Waits for its end; whether it succeeded, and the beginning of its messages.
    pub(super) fn end(&mut self) -> Result<(bool, String), VideoError> {
        self.pipe = None;
        let since = Instant::now();
        let (mut said, mut ended) = (None, None);
        loop {
            self.may_go_on(since)?;
            if said.is_none() {
                said = match self.messages.recv_timeout(Duration::from_millis(10)) {
                    Err(RecvTimeoutError::Timeout) => None,
                    said => Some(said.unwrap_or_default()),
                };
            } else if ended.is_none() {
                let status = self.child.try_wait();
                ended = status.map_err(|error| run_error(self.name, error))?;
                std::thread::sleep(Duration::from_millis(u64::from(ended.is_none())));
            } else if let (Some(said), Some(status)) = (&mut said, ended) {
                return Ok((status.success(), std::mem::take(said)));
            }
        }
    }

    /// Refuses to wait any longer for what was heard last at `heard`.
    fn may_go_on(&self, heard: Instant) -> Result<(), VideoError> {
        let Limits { silence, messages } = self.limits;
        let reading = Reading {
            path: &self.path,
            position: 0,
            length: 0,
        };
        look(&reading).map_err(|error| run_error(self.name, error))?;
        if self.has_too_many.load(Ordering::Relaxed) {
            let what = format!("it wrote more than {messages} bytes of messages");
            return Err(endless(self.name, what));
        }
        match heard.elapsed() > silence {
            true => Err(endless(
                self.name,
                format!("it did nothing for {silence:?}"),
            )),
            false => Ok(()),
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended already, with all that it started.
        let _ = kill_process_group(Pid::from_child(&self.child), Signal::KILL);
        let _ = self.child.wait();
    }
}

/// A program that would not end.
pub(super) fn endless(program: &'static str, what: String) -> VideoError {
    VideoError::Endless { program, what }
}

/// The beginning of what it says, and whether all of it came to no more than `most`. All is
/// read, so that the program never waits.
fn keep_start(stderr: ChildStderr, most: u64) -> (String, bool) {
    let (mut stderr, mut kept) = (stderr.take(most + 1), Vec::new());
    let _ = stderr.by_ref().take(KEPT_MESSAGES).read_to_end(&mut kept);
    let _ = io::copy(&mut stderr, &mut io::sink());
    let kept = String::from_utf8_lossy(&kept).trim().to_owned();
    (kept, stderr.limit() > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs a line of the shell in the place of ffmpeg to its end.
    fn run(line: &str) -> Result<(usize, String), VideoError> {
        let limits = Limits {
            silence: Duration::from_millis(300),
            messages: 1 << 20,
        };
        let mut command = Command::new("sh");
        let command = command.args(["-c", line]);
        let mut running = Running::start("ffmpeg", command, Path::new("x.mp4"), limits)?;
        let read = running
            .read_all(1 << 20)?
            .map_or(usize::MAX, |all| all.len());
        Ok((read, running.end()?.1))
    }

    #[test]
    fn a_program_that_never_ends_is_ended_and_named() {
        for (line, why) in [
            ("sleep 1000", "nothing for"),
            ("echo begin; sleep 1000 & sleep 1000", "nothing for"),
            ("exec >&-; sleep 1000", "nothing for"),
            ("exec >&- 2>&-; sleep 1000", "nothing for"),
            ("yes >&2", "bytes of messages"),
            ("exec >&-; yes >&2", "bytes of messages"),
        ] {
            let error = run(line).unwrap_err();
            assert!(
                matches!(error, VideoError::Endless { .. }),
                "{line}: {error}"
            );
            let said = error.to_string();
            assert!(
                said.contains("ffmpeg") && said.contains(why),
                "{line}: {said}"
            );
        }
        let (read, said) = run("echo out; echo why >&2").unwrap();
        assert_eq!((read, said.as_str()), (4, "why"));
    }

    #[test]
    fn messages_that_end_early_are_kept() {
        let (read, said) = run("echo why >&2; exec 2>&-; sleep 0.1; echo out").unwrap();
        assert_eq!((read, said.as_str()), (4, "why"));
    }
}
