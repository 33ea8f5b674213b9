//! What the tests of the simulated phone share.
#![allow(dead_code, reason = "each test program uses a part of it")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, SystemTime};

use hil_sim::flash_log::{Dark, FlashSource};
use hil_sim::motion::{Motion, MotionSpec};
use hil_sim::phone::{PhoneConfig, SimPhone, Surroundings};
use hil_sim::random::{Seed, Stream};
use hil_sim::true_clock::TrueClock;

/// A phone whose rig walks, in true time `speed` times as fast as real time.
pub(crate) struct Bench {
    pub(crate) phone: SimPhone,
    pub(crate) clock: TrueClock,
    pub(crate) motion: Arc<Motion>,
}

impl Bench {
    pub(crate) fn new(seed: u64, speed: f64, edit: impl FnOnce(&mut PhoneConfig)) -> Self {
        Self::with(seed, TrueClock::run_at(speed), Arc::new(Dark), edit)
    }

    pub(crate) fn with(
        seed: u64,
        clock: TrueClock,
        light: Arc<dyn FlashSource>,
        edit: impl FnOnce(&mut PhoneConfig),
    ) -> Self {
        let mut config = PhoneConfig::draw(Seed(seed));
        edit(&mut config);
        let spec: MotionSpec = "walk".parse().unwrap();
        let motion = spec.build(Seed(seed).stream(Stream::Motion)).unwrap();
        let surroundings = Surroundings {
            clock: clock.clone(),
            motion: Arc::clone(&motion),
            light,
        };
        Self {
            phone: SimPhone::start(config, surroundings, 0).unwrap(),
            clock,
            motion,
        }
    }

    pub(crate) fn address(&self) -> String {
        self.phone.address().to_string()
    }

    pub(crate) fn connect(&self) -> Raw {
        Raw::new(TcpStream::connect(self.phone.address()).unwrap())
    }

    /// Runs `smartdepthsync phone …` against this phone.
    pub(crate) fn command(&self, arguments: &[&str], folder: &Path) -> Output {
        Command::new(smartdepthsync())
            .arg("phone")
            .args(arguments)
            .args(["--phone", &self.address()])
            .current_dir(folder)
            .output()
            .unwrap()
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.clock.stop();
    }
}

/// A connection that is read and written as it is.
pub(crate) struct Raw {
    reader: BufReader<TcpStream>,
}

impl Raw {
    fn new(stream: TcpStream) -> Self {
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        Self {
            reader: BufReader::new(stream),
        }
    }

    pub(crate) fn send(&mut self, text: &str) {
        self.reader.get_mut().write_all(text.as_bytes()).unwrap();
    }

    pub(crate) fn line(&mut self) -> String {
        let mut line = String::new();
        self.reader.read_line(&mut line).unwrap();
        assert!(line.ends_with('\n'), "the phone left: {line:?}");
        line.pop();
        line
    }

    /// The lines of one answer, without `end`.
    pub(crate) fn answer(&mut self) -> Vec<String> {
        let mut lines = Vec::new();
        loop {
            let line = self.line();
            if line == "end" {
                return lines;
            }
            lines.push(line);
        }
    }

    pub(crate) fn ask(&mut self, request: &str) -> Vec<String> {
        self.send(&format!("{request}\n"));
        self.answer()
    }

    pub(crate) fn bytes(&mut self, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        self.reader.read_exact(&mut bytes).unwrap();
        bytes
    }

    /// Whether nothing comes for a while.
    pub(crate) fn is_silent(&mut self, time: Duration) -> bool {
        let stream = self.reader.get_ref();
        stream.set_read_timeout(Some(time)).unwrap();
        let silent = self.reader.buffer().is_empty() && stream.peek(&mut [0]).is_err();
        let stream = self.reader.get_ref();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        silent
    }
}

/// The program under test. Cargo builds it with the whole workspace; with this
/// package alone it may be missing or old, and is built here.
pub(crate) fn smartdepthsync() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let test = std::env::current_exe().unwrap();
        let profile = test.parent().and_then(Path::parent).unwrap();
        let program = profile.join(format!("smartdepthsync{}", std::env::consts::EXE_SUFFIX));
        let built = program.metadata().and_then(|m| m.modified());
        let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../host");
        if built.is_ok_and(|built| built > newest(&sources)) {
            return program;
        }
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args(["build", "-p", "smartdepthsync", "--bin", "smartdepthsync"]);
        if profile.ends_with("release") {
            cargo.arg("--release");
        }
        let status = cargo.status().unwrap();
        assert!(status.success(), "smartdepthsync could not be built");
        program
    })
}

/// When the newest file below `folder` was changed.
fn newest(folder: &Path) -> SystemTime {
    let mut newest = SystemTime::UNIX_EPOCH;
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let metadata = entry.metadata().unwrap();
        newest = newest.max(if metadata.is_dir() {
            self::newest(&entry.path())
        } else {
            metadata.modified().unwrap()
        });
    }
    newest
}
