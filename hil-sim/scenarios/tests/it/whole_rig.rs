//! Sessions of `smartdepthsync record`, as processes, on the whole rig.

use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::support;
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::{PhoneConfig, SimPhone};
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use rig::whole_rig::running_rig::{Pace, RunningRig};
use rig::wiring;
use rig::wiring::jumpers::Jumpers;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use stm32f4_sim::sim::SimBuilder;
use stm32f4_sim::time::SimDuration;
use test_support::{TestFolder, processes};

/// The longest that anything is waited for, in real time: it only ends what hangs.
pub(crate) const PATIENCE: Duration = Duration::from_secs(300);

/// Virtual time against real time: fast enough for many sessions. What a test acts within
/// lasts at least 10 s of it, a second for a busy machine.
pub(crate) const SPEED: f64 = 10.0;

/// A rig whose operator twists it all the time, with a folder for recordings.
pub(crate) struct WholeRig {
    pub(crate) rig: RunningRig,
    pub(crate) folder: TestFolder,
}

impl WholeRig {
    pub(crate) fn new(seed: u64, speed: f64) -> Self {
        Self::with(seed, speed, |_, _| {})
    }

    pub(crate) fn with(
        seed: u64,
        speed: f64,
        edit: impl FnOnce(&mut RigConfig, &mut PhoneConfig),
    ) -> Self {
        Self::wired(seed, speed, edit, |board| board)
    }

    /// With the read-back wired, unlike the published rig.
    pub(crate) fn with_readback(seed: u64, speed: f64) -> Self {
        let wires = Jumpers {
            strobe: None,
            ..Jumpers::default()
        };
        let wire = |board: SimBuilder| board.model(Arc::new(Mutex::new(wires)));
        Self::wired(seed, speed, |_, _| {}, wire)
    }

    fn wired(
        seed: u64,
        speed: f64,
        edit: impl FnOnce(&mut RigConfig, &mut PhoneConfig),
        wire: impl FnOnce(SimBuilder) -> SimBuilder,
    ) -> Self {
        let folder = support::folder_in_memory();
        let mut config =
            RigConfig::published(Seed(seed)).with_motion(MotionSpec::always(Gesture::Twist));
        let mut phone = PhoneConfig::draw(Seed(seed));
        // A small picture: videos are not what is tested here.
        (phone.camera.rows, phone.camera.columns) = (120, 16);
        phone.storage = Some(folder.path().join("phone"));
        edit(&mut config, &mut phone);
        let pace = Pace {
            speed: Some(speed),
            wait_for_host: false,
        };
        let board = wiring::board_of(config.board, None).tolerate_failures();
        let rig = RunningRig::start(config, wire(board), Some((phone, 0)), pace).unwrap();
        Self { rig, folder }
    }

    pub(crate) fn phone(&self) -> &SimPhone {
        self.rig.phone().unwrap()
    }

    /// The owner's profile, with a faster way to the grid, samples that the simulated board
    /// makes in half the time, and short twists: the phone must answer within 15 s more than a
    /// twist takes, also where a busy machine needs five seconds for one of the rig's.
    pub(crate) fn profile(&self) -> String {
        let profile = self.rig.profile().unwrap();
        profile.replace("[phone]\n", "[phone]\ntwist_s = 3\n")
            + "\n[align]\nslew_us = 1000\n\n[imu]\nrate_hz = 200\nlow_pass_hz = 98\n"
    }

    /// Waits until some board time has passed.
    pub(crate) fn wait_ms(&self, ms: u64) {
        let until = self.rig.now() + SimDuration::from_millis(ms);
        while self.rig.now() < until {
            assert!(self.rig.is_running(), "the board has failed");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// `smartdepthsync record` on this rig, not yet started, with nobody there.
    pub(crate) fn record(&self, name: &str, arguments: &[&str]) -> Command {
        let mut command = support::tool();
        command.args(self.recording_of(name, &self.profile()));
        command.arg("--yes").args(arguments);
        command
    }

    /// Returns the arguments of a recording by this profile.
    pub(crate) fn recording_of(&self, name: &str, profile: &str) -> Vec<OsString> {
        let file = self.folder.path().join(format!("{name}.toml"));
        std::fs::write(&file, profile).unwrap();
        let (port, out) = (self.rig.port(), self.out());
        let options: [(&str, &OsStr); 4] = [
            ("--port", port.as_ref()),
            ("--profile", file.as_ref()),
            ("--out", out.as_ref()),
            ("--name", name.as_ref()),
        ];
        let options = options
            .into_iter()
            .flat_map(|(option, value)| [option.into(), value.into()]);
        std::iter::once("record".into()).chain(options).collect()
    }

    /// The folder of all recordings.
    pub(crate) fn out(&self) -> PathBuf {
        self.folder.path().join("recordings")
    }

    pub(crate) fn recording(&self, name: &str) -> PathBuf {
        self.out().join(name)
    }
}

/// A program that runs, with what it says as it says it. It is ended when dropped.
pub(crate) struct Session {
    command: String,
    child: Child,
    said: Arc<Mutex<String>>,
    readers: Vec<JoinHandle<()>>,
}

impl Session {
    pub(crate) fn start(command: &mut Command) -> Self {
        let command = command.stdin(Stdio::null());
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let said = Arc::new(Mutex::new(String::new()));
        let out = listen(child.stdout.take().unwrap(), &said);
        let err = listen(child.stderr.take().unwrap(), &said);
        Self {
            command: processes::line(command),
            child,
            said,
            readers: vec![out, err],
        }
    }

    fn said(&self) -> String {
        self.said.lock().unwrap().clone()
    }

    /// The same of one that has ended: what it said last may still be on its way.
    fn all_said(&mut self) -> String {
        for reader in self.readers.drain(..) {
            reader.join().unwrap();
        }
        self.said()
    }

    /// Waits for an event of `record --events`; fails when the program ends before.
    pub(crate) fn wait_for(&mut self, name: &str, is_it: impl Fn(&Value) -> bool) {
        let begun = Instant::now();
        let has_come = |said: &str| {
            said.lines().any(|line| {
                let event = serde_json::from_str::<Value>(line);
                event.is_ok_and(|event| event["event"] == name && is_it(&event))
            })
        };
        while !has_come(&self.said()) {
            if let Some(status) = self.child.try_wait().unwrap() {
                let said = self.all_said();
                assert!(
                    has_come(&said),
                    "{}\n{status} before {name}\n{said}",
                    self.command
                );
                return;
            }
            let said = self.said();
            assert!(
                begun.elapsed() < PATIENCE,
                "{}\nno {name}\n{said}",
                self.command
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Waits for its end: status, and all that it said.
    pub(crate) fn end(mut self) -> (ExitStatus, String) {
        let begun = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return (status, self.all_said());
            }
            assert!(
                begun.elapsed() < PATIENCE,
                "{}\nno end\n{}",
                self.command,
                self.said()
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Waits for its end, which must be this exit code.
    pub(crate) fn ends_with(self, code: i32) -> String {
        let command = self.command.clone();
        let (status, said) = self.end();
        assert_eq!(status.code(), Some(code), "{command}\n{said}");
        said
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        // It has ended, or is no longer needed.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Adds all that comes out of a pipe to what was said, by whole lines: those of the other pipe
/// come between them.
fn listen(pipe: impl Read + Send + 'static, said: &Arc<Mutex<String>>) -> JoinHandle<()> {
    let said = Arc::clone(said);
    std::thread::spawn(move || {
        let mut pipe = BufReader::new(pipe);
        let mut line = Vec::new();
        while let Ok(1..) = pipe.read_until(b'\n', &mut line) {
            said.lock()
                .unwrap()
                .push_str(&String::from_utf8_lossy(&line));
            line.clear();
        }
    })
}
