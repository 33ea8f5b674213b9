//! The depth recorder as a process: any command, started without a shell and watched.
//!
//! It runs in a process group of its own, so a Ctrl-C at the terminal reaches
//! this program only, which then stops the recorder in its turn. Its output goes
//! into a file in the recording's folder. It is asked to stop with a signal and
//! killed if it does not end in time.
//!
//! If this program is killed, it can do nothing of that any more. So a [guard](Guard)
//! waits beside it: a shell that reads from a pipe of ours, which ends when we do, and then
//! stops the recorder's process group.

use std::fs::File;
use std::io;
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};

use recording::profile::{Depth, StopSignal};
use rustix::process::{Pid, Signal, kill_process_group};

use crate::devices::{DepthRecorder, RecorderEnd, RecorderError};

/// Name of the file that keeps its output.
pub const LOG_FILE: &str = "depth_recorder.log";

/// The depth recorder as a process, once it was started.
#[derive(Default)]
pub struct RecorderProcess {
    running: Option<Running>,
}

/// A recorder that has not been seen to end.
struct Running {
    child: Child,
    program: String,
    /// What asks it to stop.
    stop: Signal,
    /// Goes with the recorder.
    _guard: Option<Guard>,
}

impl DepthRecorder for RecorderProcess {
    fn start(&mut self, depth: &Depth, folder: &Path) -> Result<bool, RecorderError> {
        let Some((program, arguments)) = depth.recorder.command.split_first() else {
            return Ok(false);
        };
        let arguments = arguments.iter().map(|text| fill_in(text, depth, folder));
        let child = start(program, arguments, folder).map_err(|source| RecorderError {
            program: program.clone(),
            source,
        })?;
        let (stop, signal) = match depth.recorder.stop {
            StopSignal::Interrupt => (Signal::INT, "INT"),
            StopSignal::Terminate => (Signal::TERM, "TERM"),
        };
        let patience_s = depth.recorder.stop_timeout_s;
        self.running = Some(Running {
            _guard: Guard::over(child.id(), signal, patience_s),
            child,
            program: program.clone(),
            stop,
        });
        Ok(true)
    }

    fn poll(&mut self) -> Option<RecorderEnd> {
        let running = self.running.as_mut()?;
        let (status, is_as_asked) = match running.child.try_wait() {
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
        if let Some(running) = &self.running {
            running.signal(running.stop);
        }
    }

    fn kill(&mut self) {
        if let Some(mut running) = self.running.take() {
            running.signal(Signal::KILL);
            // Fails only if it has ended already.
            let _ = running.child.kill();
            let _ = running.child.wait();
        }
    }
}

impl Drop for RecorderProcess {
    /// Nothing that we started outlives us; the guard goes last.
    fn drop(&mut self) {
        self.kill();
    }
}

impl Running {
    /// To the whole group, as a Ctrl-C at a terminal does.
    fn signal(&self, signal: Signal) {
        let group = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw);
        if let Some(group) = group
            && let Err(error) = kill_process_group(group, signal)
        {
            tracing::warn!("cannot signal the depth recorder: {error}");
        }
    }
}

/// Stops the recorder's process group once this program has gone, however it went.
struct Guard(Child);

/// Waits for the end of its input, then asks the group `$0` to stop with `$1`, and kills
/// it `$2` seconds later.
const GUARD: &str =
    "read -r _; kill -s \"$1\" -- \"-$0\" && sleep \"$2\" && kill -s KILL -- \"-$0\"";

impl Guard {
    /// `None` where there is no shell: the recorder then outlives a kill.
    fn over(group: u32, signal: &str, patience_s: u32) -> Option<Self> {
        let mut command = Command::new("sh");
        command
            .args(["-c", GUARD, &group.to_string(), signal])
            .arg(patience_s.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            // A Ctrl-C at the terminal is not for it.
            .process_group(0);
        match command.spawn() {
            Ok(child) => Some(Self(child)),
            Err(error) => {
                tracing::warn!("the depth recorder would outlive a kill of this program: {error}");
                None
            }
        }
    }
}

impl Drop for Guard {
    /// The recorder has ended: its number may become another's.
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(
    program: &str,
    arguments: impl Iterator<Item = String>,
    folder: &Path,
) -> io::Result<Child> {
    let log = File::create(folder.join(LOG_FILE))?;
    Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(log.try_clone()?)
        .stderr(log)
        .process_group(0)
        .spawn()
}

/// Tells whether it ended as a program does that was asked to.
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
    fn start_ready(command: &[&str], folder: &Path) -> RecorderProcess {
        let mut recorder = RecorderProcess::default();
        assert!(recorder.start(&depth(command), folder).unwrap());
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
        let mut recorder = start_ready(&polite, folder.path());
        recorder.ask_to_stop();
        assert!(end_of(&mut recorder).is_as_asked);

        let deaf = [
            "sh",
            "-c",
            "trap '' INT; echo ready; sleep 100 & wait; sleep 100",
        ];
        let mut recorder = start_ready(&deaf, folder.path());
        recorder.ask_to_stop();
        for _ in 0..20 {
            wait();
        }
        assert_eq!(recorder.poll(), None);
        recorder.kill();
        assert_eq!(recorder.poll(), None);
    }
}
