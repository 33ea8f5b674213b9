//! The live view in a real terminal emulator (tmux), on the simulated rig: three
//! sizes, a storm of sizes, a terminal that is closed, keys. What was on the screen
//! is kept in `target/tmp/live_view` for people to look at.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use crate::support;
use crate::whole_rig::{PATIENCE, WholeRig};
use board::finding::Severity;
use recording::reader::Reader;
use recording::session_file::{SessionFile, SessionOutcome};
use recording::verify::verify;
use rig::phone::LinkFault;
use test_support::processes;

/// A terminal of a tmux server of its own, with the program in it. The program is not bound to the
/// test: a closed terminal ends it by SIGHUP, and it then closes its files. Its exit code comes from a file: tmux (3.3a) loses it now and then, where the terminal is
/// closed before the program's end is noticed.
pub(crate) struct Tmux {
    /// Holds the server's socket and the exit code.
    folder: tempfile::TempDir,
    server: Child,
}

impl Tmux {
    fn start(width: u16, height: u16, arguments: &[OsString]) -> Self {
        let program = support::smartdepthsync().as_os_str();
        let words = arguments.iter().map(OsString::as_os_str);
        let words: Vec<&OsStr> = [program].into_iter().chain(words).collect();
        Self::run_in(width, height, &words)
    }

    /// Runs a program in a terminal of a size.
    pub(crate) fn run_in(width: u16, height: u16, words: &[&OsStr]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("socket");
        // As a daemon it would outlive a test that is killed.
        let server = processes::bound("tmux")
            .args(["-D", "-f", "/dev/null", "-S"])
            .arg(&socket)
            .env("TERM", "xterm")
            .spawn()
            .unwrap();
        let terminal = Self { folder, server };
        let begun = Instant::now();
        while UnixStream::connect(&socket).is_err() {
            assert!(begun.elapsed() < PATIENCE, "no tmux server");
            std::thread::sleep(Duration::from_millis(5));
        }
        let (width, height) = (width.to_string(), height.to_string());
        let size = ["new-session", "-d", "-x", &width, "-y", &height];
        let code = terminal.code_file().to_string_lossy().into_owned();
        let shell = ["sh", "-c", r#""$@"; echo $? > "$0""#, &code];
        let arguments: Vec<&OsStr> = size
            .into_iter()
            .chain(shell)
            .map(OsStr::new)
            .chain(words.iter().copied())
            // What it leaves on the screen stays readable.
            .chain([";", "set-option", "-g", "remain-on-exit", "on"].map(OsStr::new))
            .collect();
        terminal.run(&arguments);
        terminal
    }

    fn code_file(&self) -> PathBuf {
        self.folder.path().join("exit_code")
    }

    fn run(&self, arguments: &[impl AsRef<OsStr>]) -> String {
        let output = Command::new("tmux")
            .arg("-S")
            .arg(self.folder.path().join("socket"))
            .args(arguments)
            // As over SSH: a terminal of sixteen colours at least.
            .env("TERM", "xterm")
            .output()
            .unwrap();
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    fn screen(&self) -> String {
        self.run(&["capture-pane", "-p"])
    }

    /// Returns the lines on the screen and those scrolled off it. Lines that the terminal has broken
    /// are joined.
    pub(crate) fn lines(&self) -> String {
        self.run(&["capture-pane", "-p", "-J", "-S", "-500"])
    }

    /// Drops what went off the screen.
    pub(crate) fn forget(&self) {
        self.run(&["clear-history"]);
    }

    /// Types a line.
    pub(crate) fn line(&self, line: &str) {
        self.run(&["send-keys", "-l", line]);
        self.keys("Enter");
    }

    pub(crate) fn keys(&self, keys: &str) {
        self.run(&["send-keys", keys]);
    }

    fn resize(&self, width: u16, height: u16) {
        let (width, height) = (width.to_string(), height.to_string());
        self.run(&["resize-window", "-x", &width, "-y", &height]);
    }

    /// Waits until all words are on the screen at a time.
    fn wait_for(&self, words: &[&str]) -> String {
        let begun = Instant::now();
        loop {
            let screen = self.screen();
            if words.iter().all(|word| screen.contains(word)) {
                return screen;
            }
            assert!(begun.elapsed() < PATIENCE, "no {words:?} on\n{screen}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// The exit code of the program, once it has ended.
    fn ended(&self) -> i32 {
        let begun = Instant::now();
        loop {
            let written = fs::read_to_string(self.code_file()).unwrap_or_default();
            if let Some(code) = written.strip_suffix('\n') {
                return code.parse().unwrap();
            }
            assert!(begun.elapsed() < PATIENCE, "it goes on:\n{}", self.screen());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// The terminal is closed with everything in it.
    fn close(&self) {
        self.run(&["kill-server"]);
    }
}

impl Drop for Tmux {
    fn drop(&mut self) {
        self.close();
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

fn keep(name: &str, screen: &str) {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("live_view");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join(name), screen).unwrap();
}

fn monitor(rig: &WholeRig) -> [OsString; 3] {
    ["monitor".into(), "--port".into(), rig.rig.port().into()]
}

#[test]
fn the_monitor_shows_the_board_at_three_sizes_and_survives_a_storm_of_them() {
    if !processes::is_installed("tmux", "tmux") {
        return;
    }
    let rig = WholeRig::new(31, 4.0);
    let shown = [
        "MONITOR",
        "trigger and clocks",
        "rates and losses",
        "0 messages",
        "gyroscope of the board",
        "now",
        "q stop",
    ];
    for (width, height) in [(80, 24), (120, 40), (200, 60)] {
        let name = format!("monitor_{width}x{height}.txt");
        let terminal = Tmux::start(width, height, &monitor(&rig));
        // The IMU gives 500 samples a second.
        terminal.wait_for(&["500.0/s"]);
        let screen = terminal.wait_for(&shown);
        keep(&name, &screen);
        assert!(
            screen
                .lines()
                .all(|line| line.chars().count() <= usize::from(width))
        );
        terminal.keys("h");
        terminal.wait_for(&["help", "set a mark"]);
        terminal.keys("h");
        terminal.keys("q");
        assert_eq!(terminal.ended(), 0, "{}", terminal.screen());
    }

    let terminal = Tmux::start(80, 24, &monitor(&rig));
    terminal.wait_for(&shown);
    for step in 0..120_u16 {
        terminal.resize(1 + step * 37 % 200, 1 + step * 13 % 60);
    }
    terminal.resize(80, 24);
    let screen = terminal.wait_for(&shown);
    assert!(screen.contains("0 messages"), "{screen}");
    terminal.keys("C-c");
    // Nothing was lost meanwhile: that would be 4.
    assert_eq!(terminal.ended(), 0, "{}", terminal.screen());
}

#[test]
fn a_recording_is_led_through_its_view_and_takes_marks_by_key() {
    if !processes::is_installed("tmux", "tmux") {
        return;
    }
    let rig = WholeRig::with_readback(33, 3.0);
    // As after `evaluate precision --calibrate`: a picture of the book is made of this.
    let bias = "bias_us = 0.0\nbias_sigma_us = 0.1\nbias_measured = \"2026-01-31\"";
    let profile = format!("{}\n[frame_sync]\n{bias}\n", rig.profile());
    let terminal = Tmux::start(80, 24, &rig.recording_of("seen", &profile));
    terminal.wait_for(&["Twist the rig for"]);
    // The twist lasts until the phone answers.
    rig.phone().set_fault(Some(LinkFault::Held));
    terminal.keys("Enter");
    let screen = terminal.wait_for(&["TWIST 1", "expected 1-sigma of the offset", "ENOUGH"]);
    keep("record_twist_80x24.txt", &screen);
    rig.phone().set_fault(None);
    terminal.wait_for(&["[Enter] go on"]);
    terminal.keys("Enter");
    terminal.wait_for(&["RECORDING", "µs off grid", "ns after the edge"]);
    rig.wait_ms(3_000);
    terminal.keys("m");
    let screen = terminal.wait_for(&["marker 1 at", "GB free"]);
    keep("record_80x24.txt", &screen);
    keep(
        "record_80x24.ansi",
        &terminal.run(&["capture-pane", "-p", "-e"]),
    );
    terminal.keys("q");
    assert_eq!(terminal.ended(), 0, "{}", terminal.screen());
    let session = SessionFile::load(&rig.recording("seen")).unwrap();
    assert_eq!(session.outcome, Some(SessionOutcome::Good));
    assert_eq!(session.markers.len(), 1);
    // What it leaves on the terminal is the summary, as without the view.
    let screen = terminal.screen();
    assert!(screen.contains("smartdepthsync extract"), "{screen}");
    let report = verify(&rig.recording("seen"), &system::ReadMonitor::default()).unwrap();
    assert_ne!(report.severity, Severity::Bad, "{report:#?}");
}

#[test]
fn a_closed_terminal_ends_the_recording_in_order() {
    if !processes::is_installed("tmux", "tmux") {
        return;
    }
    let rig = WholeRig::new(34, 3.0);
    let mut arguments = rig.recording_of("cut", &rig.profile());
    arguments.push("--yes".into());
    let terminal = Tmux::start(100, 30, &arguments);
    terminal.wait_for(&["RECORDING"]);
    rig.wait_ms(2_000);
    terminal.close();
    // It is closed as by Ctrl-C: devices stopped, files finished.
    let folder = rig.recording("cut");
    let begun = Instant::now();
    let session = loop {
        let session = SessionFile::load(&folder).unwrap();
        if session.outcome.is_some() {
            break session;
        }
        assert!(begun.elapsed() < PATIENCE, "the session was not closed");
        std::thread::sleep(Duration::from_millis(100));
    };
    assert_eq!(session.outcome, Some(SessionOutcome::Interrupted));
    assert_eq!(session.counts.lost(), 0);
    assert!(!rig.phone().app.is_recording());
    let mut reader = Reader::open(&folder).unwrap();
    assert!(reader.by_ref().all(|entry| entry.is_ok()));
    assert!(!reader.broken_off());
}
