//! `smartdepthsync verify`: is a recording whole.

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use crate::recordings::RecordingArg;
use recording::finding::Severity;
use report::verify::verify;

/// Check a recording: checksums, the board's numbers and counters, the pulses'
/// grid, times that go on. Nothing is written.
///
/// Ends with exit code 0 if the recording is whole, 4 if something is missing or
/// damaged, 13 if it cannot be read at all.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    recording: RecordingArg,
}

/// Runs the command.
///
/// # Errors
///
/// There is no such recording.
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    let report = verify(
        &args.recording.find(context)?,
        &context.interrupt.question(),
    )?;
    context.print_checks(&report, || report.summary().text())?;
    Ok(match report.severity {
        Severity::Good => ExitStatus::Good,
        Severity::Check | Severity::Bad => ExitStatus::Loss,
    })
}
