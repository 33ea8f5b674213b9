//! The command line: one subcommand a file in `commands/`.
//!
//! A new subcommand is a module in `commands/` with a documented
//! `#[derive(clap::Args)] pub(crate) struct RecordArgs` (named after the command) and
//! `pub(crate) fn run(args: &RecordArgs, context: &Context) -> Result<ExitStatus, Failure>`,
//! a variant of [`Command`] and an arm in [`Command::run`].
//!
//! No other module imports this one: what the subcommands share is in [`crate::context`] and
//! [`crate::options`].

use std::ffi::OsString;
use std::io::{self, IsTerminal as _, Write as _};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::{CommandFactory as _, Parser, Subcommand};
use serde_json::json;
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::commands;
use crate::context::{Context, Global, Interrupt, write_stdout};
use crate::log::Lines;
use crate::outcome::{ExitStatus, Failure, next_text};
use crate::terminal::{Shown, harmless};

/// Hardware sync of a phone's video with a depth camera, from a microcontroller.
#[derive(Debug, Parser)]
#[command(name = "smartdepthsync", version, max_term_width = 100)]
#[command(after_help = "Example: smartdepthsync setup\n\
    Exit codes: 0 good, 2 usage, 3 refused, 4 finished with loss, 5 no port, 6 no permission, \
    7 busy, 8 not this board, 9 another version, 10 no answer, 11 link lost, 12 phone, \
    13 storage, 14 depth recorder, 130 interrupted; 1 any other error.")]
pub struct Cli {
    /// Options of every subcommand.
    #[command(flatten)]
    global: Global,
    /// The subcommand.
    #[command(subcommand)]
    command: Command,
}

/// The subcommands, in the order of their use.
#[derive(Debug, Subcommand)]
enum Command {
    /// Create a rig profile interactively, check the rig, and name the next command
    Setup(commands::setup::SetupArgs),
    /// Check that the rig is ready for a recording; each problem is listed with its fix
    Doctor(commands::doctor::DoctorArgs),
    /// Record a session: twist, align the trigger to the phone's frames, record, stop
    Record(commands::record::RecordArgs),
    /// Turn a recording into a data set in board time: EuRoC, TUM RGB-D, ROS, ...
    Extract(commands::extract::ExtractArgs),
    /// Measure frame sync from the depth camera's strobes on the phone's video
    Evaluate(commands::evaluate::EvaluateArgs),
    /// Check a recording, and rewrite its report
    Verify(commands::verify::VerifyArgs),
    /// Watch the board live: trigger, gyroscope, rates, losses
    Monitor(commands::monitor::MonitorArgs),
    /// Operate the board by hand: list, info, flash, test, trigger, imu, pps
    Board(commands::board::BoardArgs),
    /// Control the phone's app
    Phone(commands::phone::PhoneArgs),
    /// Create, check and calibrate a rig profile
    Profile(commands::profile::ProfileArgs),
    /// Print the completions for a shell
    #[command(hide = true)]
    Completions(commands::completions::CompletionsArgs),
    /// Write the manual pages into a folder
    #[command(hide = true)]
    Man(commands::man::ManArgs),
}

impl Command {
    fn run(&self, context: &Context) -> Result<ExitStatus, Failure> {
        match self {
            Self::Setup(args) => commands::setup::run(args, context),
            Self::Doctor(args) => commands::doctor::run(args, context),
            Self::Record(args) => commands::record::run(args, context),
            Self::Extract(args) => commands::extract::run(args, context),
            Self::Evaluate(args) => commands::evaluate::run(args, context),
            Self::Verify(args) => commands::verify::run(args, context),
            Self::Monitor(args) => commands::monitor::run(args, context),
            Self::Board(args) => commands::board::run(args, context),
            Self::Phone(args) => commands::phone::run(args, context),
            Self::Profile(args) => commands::profile::run(args, context),
            Self::Completions(args) => commands::completions::run(args, Cli::command(), context),
            Self::Man(args) => commands::man::run(args, Cli::command(), context),
        }
    }
}

/// Runs the program and returns its exit status.
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
    };
    match cli.command.run(&context) {
        Ok(status) => status,
        Err(failure) => {
            print_failure(&context, &failure);
            failure.status()
        }
    }
}

fn print_failure(context: &Context, failure: &Failure) {
    if context.global.json {
        return print_error(failure);
    }
    let step = failure.what_to_do();
    let next = next_text(failure.next());
    let text = format!("error: {failure}\nhelp: {step}\n{next}");
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
        "next": failure.next(),
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
        0 if global.quiet => LevelFilter::ERROR,
        0 => LevelFilter::WARN,
        1 => LevelFilter::INFO,
        2 => LevelFilter::DEBUG,
        _ => LevelFilter::TRACE,
    };
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(|| Lines)
        .with_ansi(io::stderr().is_terminal());
    let lines = lines.without_time().with_target(false);
    tracing_subscriber::registry()
        .with(level)
        .with(lines)
        .init();
}
