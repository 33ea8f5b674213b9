//! The depth recorder as a process: any command, started without a shell and watched.
//!
//! The recorder runs in a process group of its own, so a Ctrl-C at the terminal reaches only
//! this program, which then stops the recorder when its turn has come. Its output goes into a
//! file in the recording's folder. It is asked to stop with a signal, and killed if it does not
//! end in time.
//!
//! A [guard](Guard) stops the recorder if this program is killed. It is a shell that is started
//! before the recorder and reads from a pipe of this program. When the pipe is closed, it stops
//! the process group that it shares with the recorder.

use std::fs::File;
use std::io::{self, Read as _};
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};

use recording::profile::{Depth, StopSignal};
use rustix::process::Signal;
use system::Process;

use crate::devices::{DepthRecorder, RecorderEnd, RecorderError};

/// Name of the file with the recorder's output.
pub const LOG_FILE: &str = "depth_recorder.log";

/// The process of a depth recorder, once it was started.
#[derive(Default)]
pub struct RecorderProcess {
    running: Option<Running>,
}

/// A recorder that has not been seen to end.
struct Running {
    process: Process,
    program: String,
    /// Signal that asks it to stop.
    stop: Signal,
    /// Leader of its process group; `None` if the recorder leads its own.
    _guard: Option<Guard>,
}

impl DepthRecorder for RecorderProcess {
    fn start(&mut self, depth: &Depth, folder: &Path) -> Result<bool, RecorderError> {
        let Some((program, arguments)) = depth.recorder.command.split_first() else {
            return Ok(false);
        };
        let arguments = arguments.iter().map(|text| fill_in(text, depth, folder));
        let (stop, signal) = match depth.recorder.stop {
            StopSignal::Interrupt => (Signal::INT, "INT"),
            StopSignal::Terminate => (Signal::TERM, "TERM"),
        };
        let guard = Guard::start(signal, depth.recorder.stop_timeout_s);
        let guard = guard.inspect_err(|error| {
            tracing::warn!("the depth recorder would outlive a kill of this program: {error}");
        });
        let guard = guard.ok();
        let leader = guard.as_ref().map(|guard| &guard.0);
        let process =
            start(program, arguments, folder, leader).map_err(|source| RecorderError {
                program: program.clone(),
                source,
            })?;
        self.running = Some(Running {
            process,
            program: program.clone(),
            stop,
            _guard: guard,
        });
        Ok(true)
    }

    fn poll(&mut self) -> Option<RecorderEnd> {
        let running = self.running.as_mut()?;
        let (status, is_as_asked) = match running.process.try_wait() {
            Ok(None) => return None,
            Ok(Some(status)) => (status.to_string(), is_as_asked(status, running.stop)),
            Err(error) => (format!("cannot be watched: {error}"), false),
        };
        let program = self.running.take()?.program;
        Some(RecorderEnd {
            program,
            status,
            is_as_asked,
        })
    }

    fn ask_to_stop(&mut self) {
        if let Some(running) = &self.running
            && let Err(error) = running.process.signal(running.stop)
        {
            tracing::warn!("cannot signal the depth recorder: {error}");
        }
    }

    fn kill(&mut self) {
        self.running = None;
    }
}

/// Stops its process group after the end of this program, even if that was killed.
struct Guard(Process);

/// Script of the guard: ignores the signals that ask to stop, prints a line when it is ready,
/// and waits for the end of its input. Then it asks its group to stop with `$0`, and kills the
/// group `$1` seconds later.
const GUARD: &str =
    "trap '' INT TERM; echo; read -r _; kill -s \"$0\" 0; sleep \"$1\"; kill -s KILL 0";

impl Guard {
    /// Starts the guard in a process group of its own, and waits until it is ready. Fails if
    /// there is no shell.
    fn start(signal: &str, patience_s: u32) -> io::Result<Self> {
        let mut command = Command::new("sh");
        command
            .args(["-c", GUARD, signal])
            .arg(patience_s.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .process_group(0);
        let mut guard = Self(Process::spawn(&mut command)?);
        let (ready, _) = guard.0.take_outputs();
        let mut ready = ready.ok_or(io::ErrorKind::BrokenPipe)?;
        ready.read_exact(&mut [0])?;
        Ok(guard)
    }
}

fn start(
    program: &str,
    arguments: impl Iterator<Item = String>,
    folder: &Path,
    leader: Option<&Process>,
) -> io::Result<Process> {
    let log = File::create(folder.join(LOG_FILE))?;
    let mut command = Command::new(program);
    command
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(log.try_clone()?)
        .stderr(log);
    Process::spawn_in_group(&mut command, leader)
}

/// Returns true if this is how a program ends that the signal asked to stop.
fn is_as_asked(status: ExitStatus, stop: Signal) -> bool {
    let number = stop.as_raw();
    status.success() || status.signal() == Some(number) || status.code() == Some(128 + number)
}

fn fill_in(text: &str, depth: &Depth, folder: &Path) -> String {
    text.replace("{folder}", &folder.to_string_lossy())
        .replace("{fps}", &depth.fps.to_string())
        .replace("{mode}", &depth.mode)
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::profile::Profile;
    use std::time::Duration;

    fn depth(command: &[&str]) -> Depth {
        let mut depth = Profile::published().unwrap().depth;
        depth.recorder.command = command.iter().map(|&text| text.to_owned()).collect();
        depth.recorder.stop_timeout_s = 2;
        depth
    }

    fn wait() {
        std::thread::sleep(Duration::from_millis(10));
    }

    #[test]
    fn without_a_command_there_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = RecorderProcess::default();
        assert!(!recorder.start(&depth(&[]), folder.path()).unwrap());
    }

    #[test]
    fn a_program_that_is_not_there_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = RecorderProcess::default();
        let error = recorder.start(&depth(&["no-such-k4arecorder"]), folder.path());
        assert_eq!(error.unwrap_err().program, "no-such-k4arecorder");
    }

    fn end_of(recorder: &mut RecorderProcess) -> RecorderEnd {
        loop {
            match recorder.poll() {
                Some(end) => return end,
                None => wait(),
            }
        }
    }

    #[test]
    fn arguments_are_passed_without_a_shell() {
        let folder = tempfile::tempdir().unwrap();
        let depth = depth(&["echo", "$(id) {folder}", "{fps}"]);
        let mut recorder = RecorderProcess::default();
        assert!(recorder.start(&depth, folder.path()).unwrap());
        assert_eq!(end_of(&mut recorder).program, "echo");
        assert_eq!(recorder.poll(), None);
        let output = std::fs::read_to_string(folder.path().join(LOG_FILE)).unwrap();
        assert_eq!(output, format!("$(id) {} 30\n", folder.path().display()));
    }

    /// A recorder that has printed `ready`.
    fn start_ready(depth: &Depth, folder: &Path) -> RecorderProcess {
        let mut recorder = RecorderProcess::default();
        assert!(recorder.start(depth, folder).unwrap());
        while std::fs::read_to_string(folder.join(LOG_FILE)).unwrap() != "ready\n" {
            wait();
        }
        recorder
    }

    #[test]
    fn it_is_asked_to_stop_and_killed_only_if_it_does_not() {
        let folder = tempfile::tempdir().unwrap();
        // A shell may have started the tests with SIGINT ignored, which children inherit.
        let polite = [
            "env",
            "--default-signal=INT",
            "sh",
            "-c",
            "echo ready; exec sleep 100",
        ];
        let mut recorder = start_ready(&depth(&polite), folder.path());
        recorder.ask_to_stop();
        assert!(end_of(&mut recorder).is_as_asked);

        let deaf = [
            "sh",
            "-c",
            "trap '' INT; echo ready; sleep 100 & wait; sleep 100",
        ];
        let mut recorder = start_ready(&depth(&deaf), folder.path());
        recorder.ask_to_stop();
        for _ in 0..20 {
            wait();
        }
        assert_eq!(recorder.poll(), None);
        recorder.kill();
        assert_eq!(recorder.poll(), None);
    }

    /// The end of a program closes its pipes.
    #[test]
    fn a_guard_stops_it_after_the_end_of_the_program_and_kills_it_if_it_must() {
        let polite = ["sh", "-c", "echo ready; exec sleep 100"];
        let deaf = ["sh", "-c", "trap '' TERM; echo ready; exec sleep 100"];
        for (command, signal) in [(&polite, Signal::TERM), (&deaf, Signal::KILL)] {
            let folder = tempfile::tempdir().unwrap();
            let mut depth = depth(command);
            depth.recorder.stop = StopSignal::Terminate;
            let mut recorder = start_ready(&depth, folder.path());
            let running = recorder.running.as_mut().unwrap();
            let guard = running._guard.as_mut().unwrap();
            drop(guard.0.take_stdin());
            let status = loop {
                match running.process.try_wait().unwrap() {
                    Some(status) => break status,
                    None => wait(),
                }
            };
            assert_eq!(status.signal(), Some(signal.as_raw()));
        }
    }
}
