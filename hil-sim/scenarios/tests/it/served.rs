//! `hil-sim serve`: a rig that waits for commands, and the words that it takes meanwhile.

use std::fmt::Debug;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use crate::support;
use crate::whole_rig::PATIENCE;
use serde_json::Value;
use test_support::TestFolder;
use test_support::processes::{self, Ran};

/// A rig that waits for commands, and what it said at first.
pub(crate) struct Served {
    child: Child,
    pub(crate) commands: Vec<String>,
}

impl Served {
    /// Starts a rig with a phone and a profile, `rig.toml` in a folder.
    pub(crate) fn start(folder: &Path, options: &[&str]) -> Self {
        let mut child = processes::bound(env!("CARGO_BIN_EXE_hil-sim"))
            .args(["serve", "--seed", "3", "--quiet"])
            .args(["--tolerate-failures", "--phone", "0"])
            .args(["--profile", "rig.toml", "--truth", "truth.csv"])
            .args(options)
            .current_dir(folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut commands: Vec<String> = Vec::new();
        for line in lines.map_while(Result::ok) {
            let is_last = line.starts_with("Each command");
            commands.push(line);
            if is_last {
                break;
            }
        }
        Self { child, commands }
    }

    /// Types a line at the rig.
    fn say(&mut self, line: &str) {
        writeln!(self.child.stdin.as_mut().unwrap(), "{line}").unwrap();
    }

    /// Returns the rest of a line that it printed.
    pub(crate) fn printed(&self, name: &str) -> &str {
        let mut lines = self.commands.iter();
        lines
            .find_map(|line| line.strip_prefix(name))
            .unwrap()
            .trim()
    }

    /// Returns the next line of its errors.
    fn complaint(&mut self) -> String {
        let mut line = String::new();
        let errors = self.child.stderr.as_mut().unwrap();
        BufReader::new(errors).read_line(&mut line).unwrap();
        line
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Asks until an answer is as expected, and returns it.
fn until<T: Debug>(mut ask: impl FnMut() -> T, is_expected: impl Fn(&T) -> bool) -> T {
    let begun = Instant::now();
    loop {
        let answer = ask();
        if is_expected(&answer) {
            return answer;
        }
        assert!(begun.elapsed() < PATIENCE, "it stays at {answer:?}");
    }
}

/// The program sees each change that a word makes to the rig.
#[test]
fn each_word_does_to_the_rig_what_it_says() {
    let folder = TestFolder::new();
    let mut rig = Served::start(folder.path(), &["--speed", "2", "--motion", "rest"]);
    let (port, phone) = (
        rig.printed("port:").to_owned(),
        rig.printed("phone:").to_owned(),
    );
    let tool = |words: &str| {
        let mut command = support::tool();
        Ran::new(
            command
                .arg("--json")
                .args(words.split(' '))
                .current_dir(folder.path()),
        )
    };
    let board = |words: &str| tool(&format!("board {words} --port {port}"));
    let is_good = |ran: &Ran| ran.status.success();
    let is_gone = |ran: &Ran| !matches!(ran.status.code(), Some(0 | 4));

    until(|| board("info"), is_good);
    rig.say("unplug");
    until(|| board("info"), is_gone);
    rig.say("plug");
    until(|| board("info"), is_good);

    let listens = || tool(&format!("phone imu --duration 1s --phone {phone}"));
    until(listens, is_good);
    rig.say("phone off");
    until(listens, is_gone);
    rig.say("phone on");
    until(listens, is_good);

    board("trigger start --fps 30");
    let edges = |what: &str| {
        board("trigger status").json()["readback"][what]
            .as_u64()
            .unwrap()
    };
    until(|| edges("seen"), |seen| *seen > 0);
    rig.say("readback off");
    until(|| edges("missing"), |missing| *missing > 0);
    rig.say("readback on");
    let before = edges("seen");
    until(|| edges("seen"), |seen| *seen > before + 10);

    let turned = || spread(&board("imu --duration 1s").json());
    until(turned, |rate| *rate < 0.05);
    // It is short: one more for each look until one falls into it.
    let knocked = || {
        rig.say("knock");
        turned()
    };
    until(knocked, |rate| *rate > 0.2);
    until(turned, |rate| *rate < 0.05);
    rig.say("twist");
    until(turned, |rate| *rate > 0.5);

    let brightest = || {
        let video = "get-video --recorded --overwrite --out lamp.mp4";
        for words in ["start", "stop", video] {
            until(|| tool(&format!("phone {words} --phone {phone}")), is_good);
        }
        brightest(&folder.path().join("lamp.mp4"))
    };
    assert!(brightest() > BALL);
    rig.say("lamp on");
    assert!(brightest() < BALL);
    rig.say("lamp off");
    assert!(brightest() > BALL);
    rig.say("lamp of");
    assert!(rig.complaint().contains("lamp on, lamp off"));
}

/// Brightness between that of the ball and that of the wall with the strobes' light on it.
const BALL: u8 = 125;

/// Returns the largest brightness in a video.
fn brightest(video: &Path) -> u8 {
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-v", "error", "-i"]).arg(video);
    ffmpeg.args(["-pix_fmt", "gray", "-f", "rawvideo", "-"]);
    let pixels = processes::run(&mut ffmpeg);
    *pixels.stdout.iter().max().unwrap()
}

/// Returns the largest standard deviation of a rate of turn in a look at the IMU, rad/s.
fn spread(imu: &Value) -> f64 {
    let axes = imu["gyro_noise_rad_s"].as_array().unwrap().iter();
    axes.map(|axis| axis.as_f64().unwrap()).fold(0.0, f64::max)
}
