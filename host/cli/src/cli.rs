//! The command line: one subcommand a file in `commands/`.
//!
//! A new subcommand is a module in `commands/` with a documented
//! `#[derive(clap::Args)] pub(crate) struct Args` and
//! `pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure>`,
//! a variant of [`Command`] and an arm in [`Command::run`].
//!
//! Results go to standard output (text, or one JSON document with `--json`);
//! logs, progress and errors go to standard error.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use clap::{Parser, Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use serde_json::json;
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::commands;
use crate::log::{self, Lines};
use crate::outcome::{ExitStatus, Failure};
use crate::terminal::{Shown, harmless};
use phone::StopSignal;

/// Hardware sync of a phone's video with a depth camera, from a microcontroller.
#[derive(Debug, Parser)]
#[command(name = "smartdepthsync", version, max_term_width = 100)]
#[command(
    after_help = "Exit codes: 0 good, 3 refused, 4 finished with loss, 5 to 14 errors \
    with a reason, 130 interrupted. All of them: docs/exit-codes.md."
)]
pub struct Cli {
    /// Options of every subcommand.
    #[command(flatten)]
    global: Global,
    /// What to do.
    #[command(subcommand)]
    command: Command,
}

/// Where the options of every subcommand stand in a help: below its own.
const GLOBAL: &str = "Options of every command";

/// Options of every subcommand.
#[derive(Clone, Debug, clap::Args)]
pub struct Global {
    /// Print the result as JSON
    #[arg(long, global = true, help_heading = GLOBAL)]
    pub json: bool,
    /// Log more on standard error: -v info, -vv debug, -vvv trace
    #[arg(short, long, global = true, help_heading = GLOBAL, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Form of the log
    #[arg(long, global = true, help_heading = GLOBAL, value_enum, default_value_t = LogFormat::Text)]
    pub log_format: LogFormat,
}

/// Form of the log on standard error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// Lines for people.
    Text,
    /// One JSON object a line.
    Json,
}

/// The subcommands, in the order of their use.
#[derive(Debug, Subcommand)]
enum Command {
    /// List the serial ports, and which look like the board
    Ports(commands::ports::Args),
    /// Show who the board is: ID, firmware, uptime, last reset
    Info(commands::info::Args),
    /// Measure whether a new board does what it must, with a report to send
    BringUp(commands::bring_up::Args),
    /// Make the profile of a rig by questions, check the rig, and name the next command
    Setup(commands::setup::Args),
    /// Check that the rig is ready for a recording; each problem is listed with its fix
    Doctor(commands::doctor::Args),
    /// Record: twist, align the trigger to the phone's frames, record, stop
    Record(commands::record::Args),
    /// Check a recording: checksums, losses, the pulses' grid, times
    Verify(commands::verify::Args),
    /// Turn a recording into a data set in board time: EuRoC, TUM RGB-D, ROS, LeRobot, ...
    Extract(commands::extract::Args),
    /// Measure frame sync from the depth camera's strobes on the phone's video
    Evaluate(commands::evaluate::Args),
    /// Write the HTML report of a recording again
    Report(commands::report::Args),
    /// Repair a damaged recording: write what can be read as a new one
    Repair(commands::repair::Args),
    /// Make, check and teach a rig profile by hand
    Profile(commands::profile::Args),
    /// Look at the board live: trigger, gyroscope, rates, losses
    Monitor(commands::monitor::Args),
    /// Talk to the phone's app
    Phone(commands::phone::Args),
    /// The camera trigger by hand: start, align, period, stop, status
    Trigger(commands::trigger::Args),
    /// Pulse per second and NMEA sentences for a lidar: start, stop, status
    Gnss(commands::gnss::Args),
    /// Stream the board's IMU: rate, jitter, noise; to a CSV file
    Imu(commands::imu::Args),
    /// The clock relation of two gyroscope recordings, with its uncertainty
    Offset(commands::offset::Args),
    /// The clocks of any two or more recordings with gyroscopes, over their whole length
    Sync(commands::sync::Args),
    /// Print the completions for a shell
    Completions(commands::completions::Args),
    /// Write the manual pages into a folder
    Man(commands::man::Args),
}

impl Command {
    fn run(&self, context: &Context) -> Result<ExitStatus, Failure> {
        match self {
            Self::Info(args) => commands::info::run(args, context),
            Self::Offset(args) => commands::offset::run(args, context),
            Self::Sync(args) => commands::sync::run(args, context),
            Self::Evaluate(args) => commands::evaluate::run(args, context),
            Self::Ports(args) => commands::ports::run(args, context),
            Self::Phone(args) => commands::phone::run(args, context),
            Self::Record(args) => commands::record::run(args, context),
            Self::Monitor(args) => commands::monitor::run(args, context),
            Self::Doctor(args) => commands::doctor::run(args, context),
            Self::BringUp(args) => commands::bring_up::run(args, context),
            Self::Profile(args) => commands::profile::run(args, context),
            Self::Trigger(args) => commands::trigger::run(args, context),
            Self::Gnss(args) => commands::gnss::run(args, context),
            Self::Imu(args) => commands::imu::run(args, context),
            Self::Extract(args) => commands::extract::run(args, context),
            Self::Verify(args) => commands::verify::run(args, context),
            Self::Setup(args) => commands::setup::run(args, context),
            Self::Report(args) => commands::report::run(args, context),
            Self::Repair(args) => commands::repair::run(args, context),
            Self::Completions(args) => commands::completions::run(args, context),
            Self::Man(args) => commands::man::run(args, context),
        }
    }
}

/// What every subcommand is given.
#[derive(Clone, Debug)]
pub struct Context {
    /// Options of every subcommand.
    pub global: Global,
    /// Set by Ctrl-C and by termination signals.
    pub interrupt: Interrupt,
    /// Where things are said while a live view has the terminal.
    pub said: Said,
}

/// What is said while a live view has the terminal, the latest last; standard
/// error is not written to meanwhile.
#[derive(Clone, Debug, Default)]
pub struct Said(Arc<Mutex<Option<VecDeque<String>>>>);

impl Said {
    /// How many lines are kept.
    const KEPT: usize = 20;

    fn slot(&self) -> MutexGuard<'_, Option<VecDeque<String>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A live view takes the terminal, or gives it back.
    pub(crate) fn divert(&self, to_view: bool) {
        *self.slot() = to_view.then(VecDeque::new);
    }

    /// Whether a live view has the terminal.
    pub(crate) fn is_diverted(&self) -> bool {
        self.slot().is_some()
    }

    /// The last lines.
    pub(crate) fn lines(&self) -> Vec<String> {
        self.slot().iter().flatten().cloned().collect()
    }

    /// Takes a line, if a live view has the terminal.
    fn take(&self, text: &str) -> bool {
        let mut slot = self.slot();
        let Some(lines) = slot.as_mut() else {
            return false;
        };
        lines.push_back(text.to_owned());
        if lines.len() > Self::KEPT {
            lines.pop_front();
        }
        true
    }
}

impl Context {
    /// One that says nothing but results.
    #[cfg(test)]
    pub(crate) fn quiet(interrupt: Interrupt) -> Self {
        Self {
            global: Global {
                json: true,
                verbose: 0,
                log_format: LogFormat::Text,
            },
            interrupt,
            said: Said::default(),
        }
    }

    /// Prints a result: `json` as one document with `--json`, else `text`.
    /// A reader that has gone away (`| head`) is no error, nor is a terminal that
    /// was closed.
    ///
    /// # Errors
    ///
    /// Standard output cannot be written, or the value has no JSON form.
    pub(crate) fn print<T: Serialize>(
        &self,
        value: &T,
        text: impl FnOnce() -> String,
    ) -> Result<(), Failure> {
        self.print_json(value)?;
        self.print_text(text)
    }

    /// Prints a result with `--json`.
    ///
    /// # Errors
    ///
    /// As [`Context::print`].
    pub(crate) fn print_json<T: Serialize>(&self, value: &T) -> Result<(), Failure> {
        if self.global.json {
            write_stdout(&serde_json::to_string_pretty(value)?, Shown::Json)?;
        }
        Ok(())
    }

    /// Prints a result without `--json`.
    ///
    /// # Errors
    ///
    /// As [`Context::print`].
    pub(crate) fn print_text(&self, text: impl FnOnce() -> String) -> Result<(), Failure> {
        if !self.global.json {
            write_stdout(&text(), Shown::ForPeople)?;
        }
        Ok(())
    }

    /// As [`Context::print`], for a text with lines of checks: their marks are coloured on
    /// a terminal.
    ///
    /// # Errors
    ///
    /// As [`Context::print`].
    pub(crate) fn print_checks<T: Serialize>(
        &self,
        value: &T,
        text: impl FnOnce() -> String,
    ) -> Result<(), Failure> {
        let is_plain = self.global.json || !is_coloured();
        if is_plain {
            return self.print(value, text);
        }
        Ok(write_stdout(&text(), Shown::WithMarks)?)
    }

    /// Says something to the person who waits, on standard error; silent with
    /// `--json`.
    pub(crate) fn say(&self, text: impl AsRef<str>) {
        if !self.global.json && !self.said.take(text.as_ref()) {
            // Nobody to tell it to if standard error is gone.
            let text = harmless(text.as_ref(), Shown::ForPeople);
            let _ = writeln!(io::stderr().lock(), "{text}");
        }
    }

    /// A progress bar of this length on standard error; hidden where nobody would see it.
    pub(crate) fn progress(&self, length: Option<u64>, template: &str) -> ProgressBar {
        let is_seen = !self.global.json && !self.said.is_diverted() && io::stderr().is_terminal();
        let target = if is_seen {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        let style =
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        ProgressBar::with_draw_target(length, target).with_style(style)
    }

    /// A spinner with a message.
    pub(crate) fn spinner(&self) -> ProgressBar {
        self.progress(None, "{spinner} {msg}")
    }
}

/// Whether and how often the user wanted to stop.
///
/// The first Ctrl-C (or SIGTERM, SIGHUP) asks the command to stop cleanly; the
/// third ends the process at once.
#[derive(Clone, Debug, Default)]
pub struct Interrupt(Arc<AtomicU32>);

impl Interrupt {
    /// Whether to stop.
    pub(crate) fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 0
    }

    /// Asks to stop, as Ctrl-C does.
    pub(crate) fn request(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether to stop, for those who ask it again and again.
    pub(crate) fn question(&self) -> impl Fn() -> bool {
        || self.requested()
    }

    /// The same for those who talk to a phone.
    pub(crate) fn stop_signal(&self) -> StopSignal {
        let interrupt = self.clone();
        StopSignal::new(move || interrupt.requested())
    }

    fn install(&self) -> Result<(), ctrlc::Error> {
        let interrupt = self.clone();
        ctrlc::set_handler(move || {
            if interrupt.0.fetch_add(1, Ordering::Relaxed) >= 2 {
                std::process::exit(ExitStatus::Interrupted.code().into());
            }
        })
    }
}

/// Runs the program and says how it ended.
pub fn main(args: impl IntoIterator<Item = OsString>) -> ExitStatus {
    let args: Vec<OsString> = args.into_iter().collect();
    let cli = match Cli::try_parse_from(&args) {
        Ok(cli) => cli,
        Err(error) => {
            if error.use_stderr() && args.iter().any(|arg| arg == "--json") {
                let message = error.render().to_string();
                let message = message.trim_start_matches("error: ").trim_end();
                print_error(&Failure::new(ExitStatus::Usage, message));
            }
            // Help and version are asked for and go to standard output.
            let _ = error.print();
            return if error.use_stderr() {
                ExitStatus::Usage
            } else {
                ExitStatus::Good
            };
        }
    };
    start_log(&cli.global);
    let interrupt = Interrupt::default();
    if let Err(error) = interrupt.install() {
        tracing::warn!("Ctrl-C ends the program at once: {error}");
    }
    outlive_largest_file();
    let context = Context {
        global: cli.global,
        interrupt,
        said: Said::default(),
    };
    match cli.command.run(&context) {
        Ok(status) => status,
        Err(failure) => {
            tell_failure(&context, &failure);
            failure.status()
        }
    }
}

fn tell_failure(context: &Context, failure: &Failure) {
    if context.global.json {
        return print_error(failure);
    }
    let step = failure.what_to_do();
    let text = format!("error: {failure}\n  what to do: {step}\n");
    let text = harmless(&text, Shown::ForPeople);
    let _ = io::stderr().lock().write_all(text.as_bytes());
}

/// An error as the one object of `--json`.
fn print_error(failure: &Failure) {
    let document = json!({ "error": {
        "exit_code": failure.status().code(),
        "name": format!("{:?}", failure.status()),
        "message": failure.to_string(),
        "next_step": failure.what_to_do(),
    }});
    let _ = write_stdout(&format!("{document:#}"), Shown::Json);
}

/// A file that reaches the largest size allowed is an error of writing, as a full disk
/// is, and no reason to be ended by a signal: trigger and phone would go on.
fn outlive_largest_file() {
    let seen = Arc::new(AtomicBool::new(false));
    if let Err(error) = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, seen) {
        tracing::warn!("the largest file size ends the program: {error}");
    }
}

fn start_log(global: &Global) {
    let level = match global.verbose {
        0 => LevelFilter::WARN,
        1 => LevelFilter::INFO,
        2 => LevelFilter::DEBUG,
        _ => LevelFilter::TRACE,
    };
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(|| Lines)
        .with_ansi(io::stderr().is_terminal());
    let log = tracing_subscriber::registry().with(log::targets(level));
    match global.log_format {
        LogFormat::Text => log.with(lines.without_time().with_target(false)).init(),
        LogFormat::Json => log.with(lines.json()).init(),
    }
}

/// Whether standard output shows colours, and its user wants them (no-color.org).
fn is_coloured() -> bool {
    io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Whether the terminal was closed: there is nobody to tell it to.
fn is_closed_terminal(error: &io::Error) -> bool {
    rustix::io::Errno::from_io_error(error) == Some(rustix::io::Errno::IO)
}

/// Writes lines.
fn write_stdout(text: &str, shown: Shown) -> io::Result<()> {
    let text = harmless(text.strip_suffix('\n').unwrap_or(text), shown);
    let mut out = io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe || is_closed_terminal(&error) => {
            Ok(())
        }
        result => result,
    }
}
