//! `smartdepthsync verify`: checks that a recording is whole, and writes its report again.

use std::path::PathBuf;

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure, next_text};
use crate::recordings::{self, RecordingArg};
use board::finding::Severity;
use recording::RecordingError;
use recording::session_file::SessionFile;
use recording::verify::{Verification, verify};
use report::session::summary;
use report::summary::Summary;
use report::verification;
use serde::Serialize;

/// Check a recording: every message and file against its contents when it was closed, and
/// checksums, numbers, times, grid and clocks against each other. Rewrites the report in its
/// folder.
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
    /// The one on the recording, as its page states it; nothing without `session.json`.
    verdict: Option<Summary>,
    /// The page that was written again; nothing without `session.json`.
    report: Option<PathBuf>,
    /// Commands to type next.
    next: Vec<String>,
}

/// Runs the command.
///
/// # Errors
///
/// There is no such recording.
pub(crate) fn run(args: &VerifyArgs, context: &Context) -> Result<ExitStatus, Failure> {
    let recording = args.recording.find(context)?;
    let session = SessionFile::load(&recording).ok();
    let mut is_lossy = false;
    let verified = context.over_files(|monitor| {
        let mut verification = verify(&recording, monitor)?;
        is_lossy = match &session {
            Some(session) => report::session::is_lossy(session, Some(&verification)),
            None => verification.severity != Severity::Good,
        };
        let judged = |session| summary(&recording, session, Some(&verification));
        let verdict = session.as_ref().map(judged);
        let report = session.as_ref().and_then(|session| {
            let written = report::session::write(&recording, session, &verification, monitor);
            if let Err(error) = &written
                && !context.interrupt.requested()
            {
                context.say(format!("warning: cannot write the report: {error}"));
            }
            written.ok()
        });
        if let Some(verdict) = &verdict {
            verification.severity = verdict.severity;
        }
        Ok::<_, RecordingError>(Verified {
            verification,
            verdict,
            report,
            next: recordings::next_commands(&recording, session.as_ref()),
        })
    })?;
    let Verified {
        verification,
        verdict,
        report,
        next,
    } = &verified;
    context.print_checks(&verified, || {
        let report = report.iter();
        let report = report.map(|path| format!("report {}\n", path.display()));
        verification::summary(verification, verdict.as_ref()).text()
            + &report.collect::<String>()
            + &next_text(next)
    })?;
    Ok(ExitStatus::of_loss(is_lossy))
}
