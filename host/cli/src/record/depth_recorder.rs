//! The depth recorder: any command, started without a shell and watched.
//!
//! It runs in a process group of its own, so a Ctrl-C at the terminal reaches
//! this program only, which then stops the recorder in its turn. Its output goes
//! into a file in the recording's folder. It is asked to stop with a signal and
//! killed if it does not end in time.
//!
//! If this program is killed, it can do nothing of that any more. So a [guard](Guard)
//! waits beside it: a shell that reads from a pipe of ours, which ends when we do. Where
//! that was killed too, the next start says that a recorder is [left over](left_over): a
//! recorder has the process that started it in its environment ([`STARTED_BY`]).

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::Path;
use std::process::{Child, Command, ExitStatus as ProcessStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};

use crate::outcome::{ExitStatus, Failure};
use recording::profile::{Depth, StopSignal};

/// Name of the file that keeps what it says.
pub(crate) const LOG_FILE: &str = "depth_recorder.log";

/// Variable of a recorder's environment: the process of the program that started it.
const STARTED_BY: &str = "SMARTDEPTHSYNC_STARTED_BY";

/// Process groups of depth recorders whose `record` has gone, on Linux. A recorder and
/// what it started are one group, whose leader is a child of `record`.
pub(crate) fn left_over() -> BTreeSet<u32> {
    let Ok(processes) = fs::read_dir("/proc") else {
        return BTreeSet::new();
    };
    processes
        .flatten()
        .filter_map(|entry| {
            // Those of other users cannot be read, and are not ours.
            let environment = fs::read(entry.path().join("environ")).ok()?;
            let mut variables = environment.split(|&byte| byte == 0);
            let started_by = variables.find_map(|variable| {
                let name_less = variable.strip_prefix(STARTED_BY.as_bytes())?;
                std::str::from_utf8(name_less.strip_prefix(b"=")?).ok()
            })?;
            let (_, group) = parent_and_group(&entry.path())?;
            let leader = parent_and_group(&Path::new("/proc").join(group.to_string()));
            let is_watched = leader.is_some_and(|(parent, _)| started_by == parent.to_string());
            (!is_watched).then_some(group)
        })
        .collect()
}

/// Parent and process group of a process, by its folder in `/proc` (proc(5), `stat`).
fn parent_and_group(process: &Path) -> Option<(u32, u32)> {
    let stat = fs::read_to_string(process.join("stat")).ok()?;
    // The name in brackets may hold anything.
    let (_, behind_name) = stat.rsplit_once(')')?;
    let mut fields = behind_name.split_whitespace().skip(1);
    Some((fields.next()?.parse().ok()?, fields.next()?.parse().ok()?))
}

/// A depth recorder that runs.
pub(crate) struct DepthRecorder {
    child: Child,
    name: String,
    /// What asks it to stop.
    stop: Signal,
    patience: Duration,
    ended: bool,
    /// Goes with the recorder.
    _guard: Option<Guard>,
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

impl DepthRecorder {
    /// Starts the profile's command; `None` if there is none.
    ///
    /// # Errors
    ///
    /// There is no such program, or it may not be run.
    pub(crate) fn start(depth: &Depth, folder: &Path) -> Result<Option<Self>, Failure> {
        let Some((program, arguments)) = depth.recorder.command.split_first() else {
            return Ok(None);
        };
        let failed = |reason: std::io::Error| {
            Failure::new(
                ExitStatus::DepthRecorder,
                format!("cannot start the depth recorder `{program}`: {reason}"),
            )
            .next_step(
                "install it, or change `command` in `[depth.recorder]` of the rig profile; an \
                 empty list records without it",
            )
        };
        let log = File::create(folder.join(LOG_FILE)).map_err(failed)?;
        let log_too = log.try_clone().map_err(failed)?;
        let mut command = Command::new(program);
        command
            .args(arguments.iter().map(|text| fill_in(text, depth, folder)))
            .env(STARTED_BY, std::process::id().to_string())
            .stdin(Stdio::null())
            .stdout(log)
            .stderr(log_too)
            .process_group(0);
        let child = command.spawn().map_err(failed)?;
        let recorder = &depth.recorder;
        let (stop, signal) = match recorder.stop {
            StopSignal::Interrupt => (Signal::INT, "INT"),
            StopSignal::Terminate => (Signal::TERM, "TERM"),
        };
        Ok(Some(Self {
            _guard: Guard::over(child.id(), signal, recorder.stop_timeout_s),
            child,
            name: program.clone(),
            stop,
            patience: Duration::from_secs(recorder.stop_timeout_s.into()),
            ended: false,
        }))
    }

    /// How it ended, the first time that it is seen to have ended by itself.
    pub(crate) fn gone(&mut self) -> Option<String> {
        if self.ended {
            return None;
        }
        let what = match self.child.try_wait() {
            Ok(None) => return None,
            Ok(Some(status)) => {
                format!("ended by itself ({status}); its output is in {LOG_FILE}")
            }
            Err(error) => format!("cannot be monitored: {error}"),
        };
        self.ended = true;
        Some(format!("the depth recorder `{}` {what}", self.name))
    }

    /// Asks it to stop, waits, and kills it if it does not. `while_waiting` is
    /// called meanwhile. Gives a text if something was wrong with how it ended.
    pub(crate) fn stop(mut self, mut while_waiting: impl FnMut()) -> Option<String> {
        if self.ended {
            return None;
        }
        self.signal(self.stop);
        let asked = Instant::now();
        while asked.elapsed() < self.patience {
            match self.child.try_wait() {
                Ok(None) => while_waiting(),
                Ok(Some(status)) => {
                    self.ended = true;
                    return (!asked_for(status, self.stop)).then(|| {
                        format!("the depth recorder `{}` ended with {status}", self.name)
                    });
                }
                Err(_) => break,
            }
        }
        // Dropping it kills it.
        Some(format!(
            "the depth recorder `{}` did not stop within {} s and was killed; its file may be \
             incomplete",
            self.name,
            self.patience.as_secs()
        ))
    }

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

impl Drop for DepthRecorder {
    /// Nothing that we started outlives us; the guard goes last.
    fn drop(&mut self) {
        if !self.ended {
            self.signal(Signal::KILL);
            // Fails only if it has ended already.
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// Whether it ended as a program does that was asked to.
fn asked_for(status: ProcessStatus, stop: Signal) -> bool {
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
        assert!(
            DepthRecorder::start(&depth(&[]), folder.path())
                .unwrap()
                .is_none()
        );
    }

    #[test]
    fn a_program_that_is_not_there_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let depth = depth(&["no-such-k4arecorder"]);
        let Err(failure) = DepthRecorder::start(&depth, folder.path()) else {
            panic!("started");
        };
        assert_eq!(failure.status(), ExitStatus::DepthRecorder);
        assert!(failure.to_string().contains("no-such-k4arecorder"));
    }

    #[test]
    fn arguments_are_passed_without_a_shell() {
        let folder = tempfile::tempdir().unwrap();
        let depth = depth(&["echo", "$(id) {folder}", "{fps}"]);
        let mut recorder = DepthRecorder::start(&depth, folder.path())
            .unwrap()
            .unwrap();
        let told = loop {
            if let Some(text) = recorder.gone() {
                break text;
            }
            wait();
        };
        assert!(told.contains("ended by itself"), "{told}");
        assert_eq!(recorder.gone(), None);
        let said = std::fs::read_to_string(folder.path().join(LOG_FILE)).unwrap();
        assert_eq!(said, format!("$(id) {} 30\n", folder.path().display()));
    }

    /// A recorder that has said `ready`.
    fn start_ready(command: &[&str], folder: &Path) -> DepthRecorder {
        let recorder = DepthRecorder::start(&depth(command), folder)
            .unwrap()
            .unwrap();
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
        let recorder = start_ready(&polite, folder.path());
        assert_eq!(recorder.stop(wait), None);

        let deaf = [
            "sh",
            "-c",
            "trap '' INT; echo ready; sleep 100 & wait; sleep 100",
        ];
        let recorder = start_ready(&deaf, folder.path());
        let told = recorder.stop(wait).unwrap();
        assert!(told.contains("killed"), "{told}");
    }
}
