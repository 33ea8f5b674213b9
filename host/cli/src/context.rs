//! The context of every command: the global options, Ctrl-C, and the printing of results.
//!
//! Results go to standard output (text, or one JSON document with `--json`);
//! progress and errors go to standard error.

use std::error::Error as _;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serde::Serialize;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use system::{Cancel, ReadMonitor, ReadProgress};

use crate::fields;
use crate::outcome::{ExitStatus, Failure, RAISE_LIMITS};
use crate::terminal::{Shown, harmless, wrapped};

/// Where the options of every subcommand stand in a help: below its own.
const GLOBAL: &str = "Options of every command";

/// Options of every subcommand.
#[derive(Clone, Debug, clap::Args)]
pub struct Global {
    /// Print the result as JSON
    #[arg(long, global = true, help_heading = GLOBAL)]
    pub json: bool,
    /// Print only results and errors
    #[arg(short, long, global = true, help_heading = GLOBAL, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Log more on standard error: -v info, -vv debug, -vvv trace
    #[arg(short, long, global = true, help_heading = GLOBAL, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

/// The context of every subcommand.
#[derive(Clone, Debug)]
pub struct Context {
    /// Options of every subcommand.
    pub global: Global,
    /// Set by Ctrl-C and by termination signals.
    pub interrupt: Interrupt,
}

impl Context {
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

    /// Prints the fields of a result: as one JSON object with `--json`, else one a line.
    ///
    /// # Errors
    ///
    /// As [`Context::print`].
    pub(crate) fn show<T: Serialize>(&self, value: &T) -> Result<(), Failure> {
        if self.global.json {
            return self.print_json(value);
        }
        Ok(write_stdout(&fields::text(value)?, Shown::ForPeople)?)
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

    /// As [`Context::print`], for a text with lines of checks: they are broken at the width of a
    /// terminal.
    ///
    /// # Errors
    ///
    /// As [`Context::print`].
    pub(crate) fn print_checks<T: Serialize>(
        &self,
        value: &T,
        text: impl FnOnce() -> String,
    ) -> Result<(), Failure> {
        if self.global.json || !io::stdout().is_terminal() {
            return self.print(value, text);
        }
        // A serial console, among others, does not know its size.
        let size = rustix::termios::tcgetwinsize(io::stdout()).ok();
        let width = size.map_or(0, |size| size.ws_col);
        let width = if width == 0 { 80 } else { width };
        self.print_text(|| wrapped(&text(), width.into()))
    }

    /// Returns true if no progress is reported.
    pub(crate) const fn is_silent(&self) -> bool {
        self.global.json || self.global.quiet
    }

    /// Prints a line for the user on standard error, unless `--json` or `--quiet` is given.
    pub(crate) fn say(&self, text: impl AsRef<str>) {
        if !self.is_silent() {
            let text = harmless(text.as_ref(), Shown::ForPeople);
            let mut stderr = io::stderr().lock();
            // Clears a progress bar.
            let clear = if stderr.is_terminal() { "\r\x1b[K" } else { "" };
            let _ = writeln!(stderr, "{clear}{text}");
        }
    }

    /// Runs work that reads files. Reads under the monitor that it is given end with the first
    /// Ctrl-C, and after a second a bar shows their progress. Work that has no more to read then
    /// keeps its result.
    ///
    /// # Errors
    ///
    /// Those of the work; or a read was interrupted.
    pub(crate) fn over_files<T, E: Into<Failure>>(
        &self,
        work: impl FnOnce(&ReadMonitor) -> Result<T, E>,
    ) -> Result<T, Failure> {
        start_threads()?;
        let bar = Arc::new(ReadingBar::new(self));
        let shown = Arc::clone(&bar);
        let monitor = ReadMonitor::new(self.interrupt.cancel(), move |progress| {
            shown.show(progress);
        });
        let result = work(&monitor).map_err(E::into);
        bar.bar.finish_and_clear();
        match result {
            Err(failure) if failure.status() == ExitStatus::Interrupted => Err(failure),
            // Whatever the work has made of it.
            _ if monitor.has_cancelled() => Err(Failure::new(ExitStatus::Interrupted, "stopped")),
            result => result,
        }
    }

    /// Creates a progress bar of this length on standard error, hidden where it would not be seen.
    pub(crate) fn progress(&self, length: Option<u64>, template: &str) -> ProgressBar {
        let is_seen = !self.is_silent() && io::stderr().is_terminal();
        let target = if is_seen {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        ProgressBar::with_draw_target(length, target).with_style(bar_style(template))
    }

    /// Creates a spinner with a message.
    pub(crate) fn spinner(&self) -> ProgressBar {
        self.progress(None, "{spinner} {msg}")
    }
}

/// The bar of a command that reads files.
struct ReadingBar {
    bar: ProgressBar,
    /// The file that it shows.
    shown: Mutex<PathBuf>,
    begun: Instant,
}

impl ReadingBar {
    const QUIET: Duration = Duration::from_secs(1);

    fn new(context: &Context) -> Self {
        Self {
            bar: context.progress(None, "{msg} {spinner} {elapsed}"),
            shown: Mutex::default(),
            begun: Instant::now(),
        }
    }

    fn show(&self, progress: &ReadProgress<'_>) {
        if self.begun.elapsed() < Self::QUIET || self.bar.is_hidden() {
            return;
        }
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        if *shown != progress.path {
            progress.path.clone_into(&mut shown);
            let name = progress.path.file_name().unwrap_or_default();
            let name = name.to_string_lossy();
            let message = format!("reading {}", harmless(&name, Shown::ForPeople));
            self.bar.set_message(message);
            if progress.length > 0 {
                self.bar
                    .set_style(bar_style("{msg} {wide_bar} {percent:>3} % {eta:>4}"));
                self.bar.set_length(progress.length);
            }
            self.bar.enable_steady_tick(Self::QUIET);
        }
        self.bar.set_position(progress.position);
    }
}

/// Number of times that the user asked to stop.
///
/// The first Ctrl-C (or SIGTERM, SIGHUP) asks the command to stop cleanly; the
/// third ends the process at once.
#[derive(Clone, Debug, Default)]
pub struct Interrupt(Arc<Interrupts>);

#[derive(Debug, Default)]
struct Interrupts {
    count: AtomicU32,
    /// True if one was a termination signal.
    terminates: AtomicBool,
}

impl Interrupt {
    /// Returns true if the user asked to stop.
    pub(crate) fn requested(&self) -> bool {
        self.count() > 0
    }

    /// Returns the number of times that the user asked.
    pub(crate) fn count(&self) -> u32 {
        self.0.count.load(Ordering::Relaxed)
    }

    /// Returns true if the system asked, which soon ends every program.
    pub(crate) fn terminates(&self) -> bool {
        self.0.terminates.load(Ordering::Relaxed)
    }

    /// Asks to stop, as Ctrl-C does.
    pub(crate) fn request(&self) {
        self.0.count.fetch_add(1, Ordering::Relaxed);
    }

    /// Returns a closure that returns true if the user asked to stop.
    pub(crate) fn question(&self) -> impl Fn() -> bool {
        || self.requested()
    }

    /// Returns a handle that cancels work once the user asked to stop.
    pub(crate) fn cancel(&self) -> Cancel {
        let interrupt = self.clone();
        Cancel::when(move || interrupt.requested())
    }

    /// Installs the handlers of Ctrl-C, SIGTERM and SIGHUP.
    ///
    /// # Errors
    ///
    /// The system refuses a handler.
    pub(crate) fn install(&self) -> io::Result<()> {
        let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
        let interrupt = self.clone();
        let heard = move || {
            for signal in signals.forever() {
                if signal != SIGINT {
                    interrupt.0.terminates.store(true, Ordering::Relaxed);
                }
                if interrupt.0.count.fetch_add(1, Ordering::Relaxed) >= 2 {
                    std::process::exit(ExitStatus::Interrupted.code().into());
                }
            }
        };
        let thread = std::thread::Builder::new().name(String::from("signals"));
        thread.spawn(heard).map(drop)
    }
}

fn bar_style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// Starts the threads that read and write in parallel: their library would panic where the system
/// starts none.
fn start_threads() -> Result<(), Failure> {
    let started = rayon::ThreadPoolBuilder::new().build_global();
    // They may run already, which has no source.
    let refused = started.as_ref().err().and_then(|error| error.source());
    refused.map_or(Ok(()), |error| {
        let text = format!("the system starts no further thread: {error}");
        Err(Failure::new(ExitStatus::Storage, text).next_step(RAISE_LIMITS))
    })
}

/// Returns true if the error means that the terminal was closed.
fn is_closed_terminal(error: &io::Error) -> bool {
    rustix::io::Errno::from_io_error(error) == Some(rustix::io::Errno::IO)
}

/// Returns true if standard output is a pipe without a reader.
pub(crate) fn is_stdout_closed() -> bool {
    let out = io::stdout();
    let mut polled = [PollFd::new(&out, PollFlags::empty())];
    let now = Timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    poll(&mut polled, Some(&now)).is_ok() && polled[0].revents().contains(PollFlags::ERR)
}

/// Writes lines to standard output. A reader that has gone away is no error.
///
/// # Errors
///
/// They cannot be written.
pub(crate) fn write_stdout(text: &str, shown: Shown) -> io::Result<()> {
    let text = harmless(text.strip_suffix('\n').unwrap_or(text), shown);
    let mut out = io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe || is_closed_terminal(&error) => {
            Ok(())
        }
        result => result,
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// Reads after Ctrl-C give no result, whatever the work makes of them; finished work gives one.
    #[test]
    fn ctrl_c_ends_reads_and_keeps_a_finished_result() {
        let context = Context {
            global: Global {
                json: false,
                quiet: true,
                verbose: 0,
            },
            interrupt: Interrupt::default(),
        };
        let progress = ReadProgress {
            path: Path::new("recording"),
            position: 0,
            length: 0,
        };
        let finished = context.over_files(|monitor| {
            assert!(monitor.check(&progress).is_ok());
            context.interrupt.request();
            Ok::<_, Failure>(7)
        });
        assert_eq!(finished.unwrap(), 7);
        let ended = context.over_files(|monitor| {
            let left_out = monitor.check(&progress).unwrap_err();
            Ok::<_, Failure>(left_out)
        });
        assert_eq!(ended.unwrap_err().status(), ExitStatus::Interrupted);
    }
}
