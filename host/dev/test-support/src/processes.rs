//! Programs that tests run.

use std::ffi::OsStr;
use std::fmt;
use std::io::Write as _;
use std::ops::Deref;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

/// Returns true if a program runs that only some tests need. Without it they leave their part out
/// and say so; on CI they fail.
#[must_use]
pub fn is_installed(program: &str, package: &str) -> bool {
    let option = if program == "tmux" { "-V" } else { "--version" };
    let mut command = Command::new(program);
    let is_installed = command.arg(option).output().is_ok();
    if !is_installed {
        let reason = format!("no {program}: sudo apt-get install {package}");
        assert!(std::env::var_os("CI").is_none(), "{reason}");
        let thread = std::thread::current();
        // Not by a macro: the harness hides what a good test prints.
        let _ = writeln!(
            std::io::stderr(),
            "left out of {}: {reason}",
            thread.name().unwrap_or_default()
        );
    }
    is_installed
}

/// Longest wait for a program, which only ends one that hangs.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Returns a command for a program that is killed when the thread that started it ends, also
/// where the test itself is killed.
pub fn bound(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new("setpriv");
    command.args(["--pdeathsig", "KILL", "--"]).arg(program);
    command
}

/// A program that has ended. It displays as its command, its exit status and all its output.
pub struct Ran {
    command: String,
    output: Output,
}

impl Ran {
    /// Runs a program to its end.
    pub fn new(command: &mut Command) -> Self {
        let output = command.output();
        let command = line(command);
        let output = output.unwrap_or_else(|error| panic!("{command}: {error}"));
        Self { command, output }
    }

    /// Asserts its exit code, and that its output has these words.
    pub fn ended_with(&self, code: i32, words: &[&str]) {
        assert_eq!(self.output.status.code(), Some(code), "{self}");
        let said = [&self.output.stdout[..], &self.output.stderr].concat();
        let said = String::from_utf8_lossy(&said);
        for word in words {
            assert!(said.contains(word), "{word:?} is missing: {self}");
        }
    }

    /// Returns the JSON that it printed.
    #[must_use]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.output.stdout).unwrap_or_else(|e| panic!("{e}: {self}"))
    }
}

impl fmt::Display for Ran {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { command, output } = self;
        let text = |bytes| String::from_utf8_lossy(bytes);
        let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
        write!(
            f,
            "$ {command}\n{}\n--- stdout:\n{stdout}\n--- stderr:\n{stderr}",
            output.status
        )
    }
}

impl fmt::Debug for Ran {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl Deref for Ran {
    type Target = Output;

    fn deref(&self) -> &Output {
        &self.output
    }
}

/// Runs a program to its end, which must be a success.
pub fn run(command: &mut Command) -> Ran {
    let ran = Ran::new(command);
    assert!(ran.output.status.success(), "{ran}");
    ran
}

/// A command as it would be typed.
pub fn line(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    let words: Vec<_> = words.map(OsStr::to_string_lossy).collect();
    words.join(" ")
}

/// Waits until a process catches SIGINT: before that, the signal ends it at once.
pub fn wait_until_caught(process: u32) {
    let begun = Instant::now();
    loop {
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
        let mask = status
            .lines()
            .find_map(|line| line.strip_prefix("SigCgt:\t"));
        // proc(5): bit 0 is signal 1.
        if u64::from_str_radix(mask.unwrap(), 16).unwrap() & (1 << (2 - 1)) != 0 {
            return;
        }
        assert!(begun.elapsed() < PATIENCE, "it does not catch SIGINT");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Returns the processor time that a process has used so far, s; `None` once it is gone.
pub fn worked_s(process: u32) -> Option<f64> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // proc(5): the name is in brackets; from its state on, user and system time are the
    // 12th and the 13th, in hundredths.
    let (_, rest) = stat.rsplit_once(") ")?;
    let times = rest.split(' ').skip(11).take(2);
    Some(times.map(|time| time.parse::<f64>().unwrap()).sum::<f64>() / 100.0)
}
