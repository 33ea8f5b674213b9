//! A child process that never outlives its owner.

use std::io;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus};

use rustix::process::{Pid, Signal, kill_process, kill_process_group};

/// A child process. Dropping it kills the child, and its process group if it has one of its own,
/// and waits for the child's end, so that no zombie is left.
#[derive(Debug)]
pub struct Process {
    child: Child,
    /// Receives the signals instead of the child alone.
    group: Option<Pid>,
    /// The end was reported; the child's number may be another's since.
    has_ended: bool,
}

impl Process {
    /// Starts a program.
    ///
    /// # Errors
    ///
    /// The program cannot be started.
    pub fn spawn(command: &mut Command) -> io::Result<Self> {
        Ok(Self {
            child: command.spawn()?,
            group: None,
            has_ended: false,
        })
    }

    /// Starts a program in the process group that `leader` leads, or as the leader of a new one.
    /// A Ctrl-C at the terminal does not reach the group, and signals go to all of it.
    ///
    /// # Errors
    ///
    /// The program cannot be started.
    pub fn spawn_in_group(command: &mut Command, leader: Option<&Self>) -> io::Result<Self> {
        let leader = leader.map(|leader| Pid::from_child(&leader.child));
        let group = leader.map_or(0, Pid::as_raw_pid);
        let child = command.process_group(group).spawn()?;
        let group = leader.unwrap_or_else(|| Pid::from_child(&child));
        Ok(Self {
            child,
            group: Some(group),
            has_ended: false,
        })
    }

    /// Takes the pipe to the child's standard input, if there is one. Dropping it closes it.
    pub const fn take_stdin(&mut self) -> Option<ChildStdin> {
        self.child.stdin.take()
    }

    /// Takes the pipes from the child's standard output and standard error, where there are any.
    pub const fn take_outputs(&mut self) -> (Option<ChildStdout>, Option<ChildStderr>) {
        (self.child.stdout.take(), self.child.stderr.take())
    }

    /// Returns the exit status once the child has ended. Processes that it left are no longer
    /// killed.
    ///
    /// # Errors
    ///
    /// The system does not report it.
    pub fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
        let status = self.child.try_wait()?;
        self.has_ended |= status.is_some();
        Ok(status)
    }

    /// Sends a signal to the child, or to its group.
    ///
    /// # Errors
    ///
    /// The process no longer exists.
    pub fn signal(&self, signal: Signal) -> io::Result<()> {
        match self.group {
            Some(group) => kill_process_group(group, signal)?,
            None => kill_process(Pid::from_child(&self.child), signal)?,
        }
        Ok(())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if !self.has_ended {
            // These fail only if it has just ended.
            let _ = self.signal(Signal::KILL);
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
