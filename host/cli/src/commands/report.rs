//! `smartdepthsync report`: the HTML report of a recording, anew.

use std::path::PathBuf;

use serde::Serialize;

use crate::cli::Context;
use crate::outcome::{Failure, Outcome};
use recording::session_file::SessionFile;

/// Write the HTML report of a recording (again), into its folder.
///
/// `record` does this at its end by itself; after a repair, or for an older
/// recording, this does.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The folder of the recording
    #[arg(value_name = "RECORDING")]
    recording: PathBuf,
}

#[derive(Debug, Serialize)]
struct Written {
    report: PathBuf,
    verdict: String,
}

/// Runs the command.
///
/// # Errors
///
/// There is no such recording, or its folder cannot be written.
pub(crate) fn run(args: &Args, context: &Context) -> Result<Outcome, Failure> {
    let file = SessionFile::load(&args.recording)?;
    let stop = || context.interrupt.requested();
    let report = session_report::write(&args.recording, &file, &stop)?;
    let (_, verdict) = session_report::verdict(&file);
    let written = Written { report, verdict };
    context.print(&written, || {
        format!(
            "{}\nreport       {}",
            written.verdict,
            written.report.display()
        )
    })?;
    Ok(Outcome::Good)
}
