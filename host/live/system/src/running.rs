//! The output of another program, within limits: neither a program nor what it reads makes its
//! caller wait, read or keep messages without end.

use std::io::{self, Read};
use std::process::{ChildStderr, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use crate::monitor::{Cancel, Cancelled};
use crate::process::Process;

/// Bytes kept of the beginning of the messages, and at least as many of their end.
const KEPT: usize = 16 * 1024;

/// Bytes of one read.
const BLOCK: usize = 64 * 1024;

/// Interval of the checks of the limits while nothing arrives: 100 ms.
const CHECK: Timespec = Timespec {
    tv_sec: 0,
    tv_nsec: 100_000_000,
};

/// The same once the program's output has ended: 2 ms.
const END_CHECK: Timespec = Timespec {
    tv_sec: 0,
    tv_nsec: 2_000_000,
};

/// Bounds of a program's run. The program is killed where it exceeds one of them.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Longest time from the start to the end.
    pub run: Option<Duration>,
    /// Longest wait for the next output, and from the last to the end.
    pub silence: Option<Duration>,
    /// Most bytes on standard error.
    pub messages: u64,
    /// Ends the run early.
    pub cancel: Cancel,
    /// Runs the program in a process group of its own, which Ctrl-C at the terminal does not reach
    /// and which is killed as a whole.
    pub own_group: bool,
}

impl Default for Limits {
    /// No limit of time, 64 MiB of messages, the group of the caller.
    fn default() -> Self {
        Self {
            run: None,
            silence: None,
            messages: 64 << 20,
            cancel: Cancel::default(),
            own_group: false,
        }
    }
}

/// Reason why a program gave no result.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The program cannot be started.
    #[error("{0}")]
    Start(#[source] io::Error),
    /// The program's output cannot be read.
    #[error("{0}")]
    Read(#[source] io::Error),
    /// The run took longer than this.
    #[error("no answer within {0:?}")]
    Late(Duration),
    /// Nothing was written for this time.
    #[error("it did nothing for {0:?}")]
    Silent(Duration),
    /// Standard error has more bytes than this.
    #[error("it wrote more than {0} bytes of messages")]
    Messages(u64),
    /// Standard output has more bytes than this.
    #[error("its answer has more than {0} bytes")]
    Output(usize),
    /// The caller asked to stop.
    #[error("stopped before its end")]
    Cancelled,
}

impl From<RunError> for io::Error {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Start(error) | RunError::Read(error) => error,
            RunError::Cancelled => Self::other(Cancelled),
            error => Self::other(error),
        }
    }
}

/// Result of a program that has ended.
#[derive(Clone, Debug)]
pub struct Output {
    /// Exit status.
    pub status: ExitStatus,
    /// Standard output that was not read before.
    pub stdout: Vec<u8>,
    /// Standard error without the whitespace around it; of a long one its beginning and its end.
    pub messages: String,
}

/// Runs a program to its end and returns what it wrote, up to `most` bytes.
///
/// # Errors
///
/// The program cannot be started, or exceeds a limit. Its exit status is no error.
pub fn run(command: &mut Command, limits: Limits, most: usize) -> Result<Output, RunError> {
    Running::start(command, limits)?.finish(most)
}

/// A program whose output is read while it runs. Dropping it kills the program.
#[derive(Debug)]
pub struct Running {
    process: Process,
    /// `None` after its end.
    stdout: Option<ChildStdout>,
    stderr: Option<ChildStderr>,
    messages: Messages,
    started: Instant,
    limits: Limits,
}

impl Running {
    /// Starts a program without standard input.
    ///
    /// # Errors
    ///
    /// The program cannot be started.
    pub fn start(command: &mut Command, limits: Limits) -> Result<Self, RunError> {
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let process = if limits.own_group {
            Process::spawn_in_group(command, None)
        } else {
            Process::spawn(command)
        };
        let mut process = process.map_err(RunError::Start)?;
        let (stdout, stderr) = process.take_outputs();
        Ok(Self {
            process,
            stdout,
            stderr,
            messages: Messages::default(),
            started: Instant::now(),
            limits,
        })
    }

    /// Fills `out` with the next `most` bytes of standard output; fewer at its end.
    ///
    /// # Errors
    ///
    /// A limit is exceeded, or reading fails.
    pub fn read(&mut self, most: usize, out: &mut Vec<u8>) -> Result<usize, RunError> {
        out.resize(most, 0);
        let (mut read, mut last) = (0, Instant::now());
        while read < most && self.stdout.is_some() {
            self.check(last)?;
            let [is_out, _] = self.receive(&CHECK)?;
            let Some(stdout) = self.stdout.as_mut().filter(|_| is_out) else {
                continue;
            };
            match stdout.read(out.get_mut(read..).unwrap_or_default()) {
                Ok(0) => self.stdout = None,
                Ok(more) => (read, last) = (read + more, Instant::now()),
                Err(error) => return Err(RunError::Read(error)),
            }
        }
        out.truncate(read);
        Ok(read)
    }

    /// Reads the rest of standard output, up to `most` bytes, and waits for the program's end.
    ///
    /// # Errors
    ///
    /// A limit is exceeded, or the program cannot be waited for.
    pub fn finish(mut self, most: usize) -> Result<Output, RunError> {
        let (mut stdout, mut part) = (Vec::new(), Vec::new());
        while self.read(BLOCK, &mut part)? > 0 {
            stdout.append(&mut part);
            if stdout.len() > most {
                return Err(RunError::Output(most));
            }
        }
        let since = Instant::now();
        let mut status = None;
        loop {
            self.check(since)?;
            let [_, is_message] = self.receive(&END_CHECK)?;
            if let Some(status) = status.filter(|_| !is_message) {
                return Ok(Output {
                    status,
                    stdout,
                    messages: self.messages.text(),
                });
            }
            if status.is_none() {
                status = self.process.try_wait().map_err(RunError::Read)?;
            }
        }
    }

    /// Waits for output, and keeps what is on standard error. Returns which of standard output and
    /// standard error have something or have ended.
    fn receive(&mut self, longest: &Timespec) -> Result<[bool; 2], RunError> {
        let mut files = Vec::with_capacity(2);
        files.extend((self.stdout.iter()).map(|pipe| PollFd::new(pipe, PollFlags::IN)));
        files.extend((self.stderr.iter()).map(|pipe| PollFd::new(pipe, PollFlags::IN)));
        match poll(&mut files, Some(longest)) {
            Ok(_) => {}
            Err(Errno::INTR) => return Ok([false, false]),
            Err(error) => return Err(RunError::Read(error.into())),
        }
        let mut ready = files.iter().map(|file| !file.revents().is_empty());
        let is_out = self.stdout.is_some() && ready.next() == Some(true);
        let is_message = self.stderr.is_some() && ready.next() == Some(true);
        if let Some(stderr) = self.stderr.as_mut().filter(|_| is_message) {
            let mut block = vec![0; BLOCK];
            match stderr.read(&mut block) {
                Ok(0) | Err(_) => self.stderr = None,
                Ok(read) => self.messages.add(block.get(..read).unwrap_or_default()),
            }
        }
        Ok([is_out, is_message])
    }

    /// Compares the run with its limits; `last` is the time of the last output.
    fn check(&self, last: Instant) -> Result<(), RunError> {
        let limits = &self.limits;
        if limits.cancel.is_requested() {
            return Err(RunError::Cancelled);
        }
        if self.messages.bytes > limits.messages {
            return Err(RunError::Messages(limits.messages));
        }
        if let Some(run) = limits.run.filter(|&run| self.started.elapsed() > run) {
            return Err(RunError::Late(run));
        }
        let silence = limits.silence;
        match silence.filter(|&silence| last.elapsed() > silence) {
            Some(silence) => Err(RunError::Silent(silence)),
            None => Ok(()),
        }
    }
}

/// Standard error so far.
#[derive(Debug, Default)]
struct Messages {
    bytes: u64,
    kept: Vec<u8>,
}

impl Messages {
    /// Adds what was read, and forgets the middle of what has become too long.
    fn add(&mut self, block: &[u8]) {
        self.bytes += block.len() as u64;
        self.kept.extend(block);
        if self.kept.len() > 4 * KEPT {
            self.kept.drain(KEPT..self.kept.len() - KEPT);
        }
    }

    fn text(&self) -> String {
        String::from_utf8_lossy(&self.kept).trim().to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> Limits {
        Limits {
            silence: Some(Duration::from_millis(300)),
            messages: 1 << 20,
            own_group: true,
            ..Limits::default()
        }
    }

    /// Runs a line of the shell.
    fn shell(line: &str, limits: Limits) -> Result<Output, RunError> {
        run(Command::new("sh").args(["-c", line]), limits, 1 << 20)
    }

    #[test]
    fn a_program_that_exceeds_a_limit_is_killed() {
        for (line, why) in [
            ("sleep 1000", "nothing for"),
            ("echo begin; sleep 1000 & sleep 1000", "nothing for"),
            ("exec >&-; sleep 1000", "nothing for"),
            ("exec >&- 2>&-; sleep 1000", "nothing for"),
            ("yes >&2", "bytes of messages"),
            ("exec >&-; yes >&2", "bytes of messages"),
            ("yes", "answer has more than"),
        ] {
            let error = shell(line, limits()).unwrap_err().to_string();
            assert!(error.contains(why), "{line}: {error}");
        }
        let short = Limits {
            run: Some(Duration::from_millis(200)),
            ..limits()
        };
        let late = shell("while :; do echo; sleep 0.01; done", short);
        assert!(matches!(late, Err(RunError::Late(_))), "{late:?}");
        let cancelled = Limits {
            cancel: Cancel::when(|| true),
            ..limits()
        };
        let cancelled = shell("exec sleep 1000", cancelled);
        assert!(matches!(cancelled, Err(RunError::Cancelled)));
        let none = run(&mut Command::new("/no/such/program"), limits(), 0);
        assert!(matches!(none, Err(RunError::Start(_))));
    }

    #[test]
    fn output_messages_and_status_are_returned() {
        for line in [
            "echo out; echo why >&2; exit 3",
            "echo why >&2; exec 2>&-; sleep 0.1; echo out; exit 3",
        ] {
            let output = shell(line, limits()).unwrap();
            assert_eq!(output.stdout, b"out\n");
            assert_eq!(output.messages, "why");
            assert_eq!(output.status.code(), Some(3));
        }
    }

    #[test]
    fn long_messages_keep_their_beginning_and_their_end() {
        let output = shell("echo first >&2; seq 100000 >&2; echo last >&2", limits()).unwrap();
        let messages = output.messages;
        assert!(messages.starts_with("first\n1\n") && messages.ends_with("\n100000\nlast"));
        assert!(messages.len() <= 4 * KEPT, "{}", messages.len());
    }

    #[test]
    fn a_process_that_outlives_its_parent_does_not_keep_the_caller() {
        let begun = Instant::now();
        let output = shell("echo out; sleep 5 >&- & exit 0", Limits::default()).unwrap();
        assert_eq!(output.stdout, b"out\n");
        assert!(begun.elapsed() < Duration::from_secs(4));
    }
}
