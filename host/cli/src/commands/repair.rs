//! `smartdepthsync repair`: a whole recording of what can be read of another.

use std::path::PathBuf;

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use report::repair::repair;

/// Write what can be read of a damaged or unfinished recording as a new, whole
/// one. The recording itself is never changed.
///
/// Ends with exit code 0 if nothing had to be left out, 4 if something had to, 13
/// if nothing can be read, or OUT is there already.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The recording: its folder, or a recording.mcap
    #[arg(value_name = "RECORDING")]
    recording: PathBuf,
    /// The new recording, which must not be there yet: a folder for a folder, a file for a file
    #[arg(value_name = "OUT")]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
///
/// There is no such recording, or the new one cannot be written.
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    let result = repair(&args.recording, &args.out, &context.interrupt.question())?;
    context.print_checks(&result, || result.summary().text())?;
    Ok(ExitStatus::of_loss(result.lost))
}
