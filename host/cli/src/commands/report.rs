//! `smartdepthsync report`: the HTML report of a recording, anew.

use std::path::PathBuf;

use serde::Serialize;

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use crate::recordings::{self, RecordingArg};
use recording::session_file::SessionFile;
use report::session;
use report::summary::Summary;

/// Write the HTML report of a recording (again), into its folder.
///
/// `record` does this at its end by itself; after a repair, or for an older
/// recording, this does.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    recording: RecordingArg,
}

#[derive(Debug, Serialize)]
struct Written {
    report: PathBuf,
    verdict: Summary,
}

/// Runs the command.
///
/// # Errors
///
/// There is no such recording, or its folder cannot be written.
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    let recording = args.recording.find(context)?;
    let folder = recordings::folder_of(&recording);
    let file = SessionFile::load(folder)?;
    let report = session::write(folder, &file, &context.interrupt.question())?;
    let verdict = session::summary(folder, &file);
    let written = Written { report, verdict };
    context.print_checks(&written, || {
        let text = written.verdict.text();
        format!("{text}report {}", written.report.display())
    })?;
    Ok(ExitStatus::Good)
}
