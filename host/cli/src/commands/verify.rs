//! `smartdepthsync verify`: checks that a recording is whole, and writes its report again.

use std::path::{Path, PathBuf};

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use crate::recordings::{self, RecordingArg};
use board::finding::Severity;
use recording::RecordingError;
use recording::verify::{Verification, verify};
use report::session::write_again;
use report::verification;
use serde::Serialize;
use system::ReadMonitor;

/// Check a recording: every message and file against what it held when it was closed, and
/// checksums, numbers, times, grid and clocks against each other. Its report is written again,
/// into its folder.
///
/// Ends with exit code 0 if nothing is missing or changed, 4 if something is missing,
/// damaged or cannot be compared, 13 if it cannot be read at all.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync verify recordings/walk")]
pub(crate) struct VerifyArgs {
    #[command(flatten)]
    recording: RecordingArg,
}

#[derive(Serialize)]
struct Verified {
    #[serde(flatten)]
    verification: Verification,
    /// The page that was written again; nothing without `session.json`.
    report: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
///
/// There is no such recording.
pub(crate) fn run(args: &VerifyArgs, context: &Context) -> Result<ExitStatus, Failure> {
    let recording = args.recording.find(context)?;
    let verified = context.over_files(|monitor| {
        let verification = verify(&recording, monitor)?;
        let report = write_report(recordings::folder_of(&recording), context, monitor);
        Ok::<_, RecordingError>(Verified {
            verification,
            report,
        })
    })?;
    context.print_checks(&verified, || {
        let report = verified.report.iter();
        let report = report.map(|path| format!("report {}\n", path.display()));
        verification::summary(&verified.verification).text() + &report.collect::<String>()
    })?;
    Ok(match verified.verification.severity {
        Severity::Good => ExitStatus::Good,
        Severity::Check | Severity::Bad => ExitStatus::Loss,
    })
}

/// Writes the report of a recording that has a session, and warns if it cannot be written.
fn write_report(folder: &Path, context: &Context, monitor: &ReadMonitor) -> Option<PathBuf> {
    let written = write_again(folder, monitor);
    if let Err(error) = &written
        && !context.interrupt.requested()
    {
        context.say(format!("warning: cannot write the report: {error}"));
    }
    written.ok().flatten()
}
