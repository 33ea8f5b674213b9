//! Checks that a recording is complete, and that its parts agree with each other.
//!
//! - [`walk`](crate::walk): bytes. Checksums of every chunk, of the data and of the index;
//!   where the file breaks and where reading can resume.
//! - `content`: messages. The numbers that the board gave are followed, and missing messages are
//!   attributed by the board's own counters (`numbers`); pulses must lie on their grid
//!   (`pulses`), times must increase.
//!
//! Damage and contradictions are [`Severity::Bad`], known losses [`Severity::Check`], remarks
//! [`Severity::Good`]. The verdict is that of the worst finding.
//!
//! Limits: the files of the phone and of the depth recorder must exist but are not read;
//! `smartdepthsync extract` reads them.

mod content;
mod findings;
mod numbers;
mod pulses;

use std::collections::BTreeMap;
use std::path::Path;

use board::finding::{Finding, Severity};
use serde::Serialize;
use system::ReadMonitor;

use self::content::Content;
use self::findings::Findings;
use super::session_file::{SessionFile, SessionOutcome};
use super::walk::{FileReport, Walk};
use super::{MCAP_FILE, RecordingError, SESSION_FILE, mcap_of};

/// Version of the JSON form of [`Verification`].
const FORM: u32 = 2;

/// Counts of one numbered stream of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StreamCheck {
    /// Messages that can be read.
    pub received: u64,
    /// Missing messages, by gaps in the board's numbers.
    pub missing: u64,
    /// Part of `missing` that the board counted as dropped by itself.
    pub dropped_by_board: u64,
}

/// Comparison of the trigger pulses with the grid of the alignment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct GridCheck {
    /// Pulses that were compared with the grid of `session.json`.
    pub checked: u64,
    /// Pulses among them that are not on it.
    pub off: u64,
    /// Distance of the furthest pulse from its grid point, ticks.
    pub worst_ticks: u64,
}

/// Result of [`verify`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verification {
    /// Version of this form.
    pub form: u32,
    /// The recording as it was named.
    pub recording: String,
    /// Good: every byte and every number is right. Check: what is there is right, something
    /// is missing. Bad: bytes are damaged, or parts contradict each other.
    pub severity: Severity,
    /// State of the file as bytes.
    pub file: FileReport,
    /// First and last board time, s.
    pub board_time_s: Option<[f64; 2]>,
    /// Frames that arrived damaged over the link, by the log.
    pub damaged_frames: u64,
    /// The board's streams, by name.
    pub streams: BTreeMap<&'static str, StreamCheck>,
    /// The pulses against their grid; `None` without `session.json`.
    pub grid: Option<GridCheck>,
    /// Everything that was found.
    pub findings: Vec<Finding>,
    /// The session's statement of how well the cameras expose together.
    pub alignment: Option<String>,
}

/// Checks a recording, given by its folder or its MCAP file.
///
/// # Errors
///
/// Returns an error if the file cannot be read or is no MCAP file at all. Damage is not an
/// error: it is among the findings.
pub fn verify(recording: &Path, monitor: &ReadMonitor) -> Result<Verification, RecordingError> {
    let path = mcap_of(recording);
    let mut findings = Findings::default();
    let session = load_session(&path, &mut findings);
    let mut content = Content::new(session.as_ref());
    let mut walk = Walk::open(&path, monitor)?;
    while walk.next_part(&mut |event| content.check(event, &mut findings))? {}
    let file = walk.report().clone();
    if let Some(session) = &session {
        check_session(session, &path, &mut findings);
    }
    let damaged_frames = content.numbers.damaged_frames();
    let streams = content.numbers.finish(&mut findings);
    let alignment = session.as_ref().and_then(|session| session.alignment);
    Ok(Verification {
        form: FORM,
        recording: recording.display().to_string(),
        severity: findings.worst(),
        file,
        board_time_s: content.span.map(|span| span.map(|at| at.as_secs_f64())),
        damaged_frames,
        streams,
        grid: content.pulses.report(),
        findings: findings.into_vec(),
        alignment: alignment.map(|alignment| alignment.promise()),
    })
}

/// Loads the session file beside a recording's MCAP file, if it exists and can be read.
fn load_session(mcap: &Path, findings: &mut Findings) -> Option<SessionFile> {
    let folder = mcap.parent()?;
    if mcap.file_name()? != MCAP_FILE {
        return None;
    }
    if !folder.join(SESSION_FILE).exists() {
        findings.check("no_session_file", None, || {
            format!("there is no {SESSION_FILE} beside the recording: settings are not known")
        });
        return None;
    }
    match SessionFile::load(folder) {
        Ok(session) => Some(session),
        Err(error) => {
            findings.bad("session_file_damaged", None, || error.to_string());
            None
        }
    }
}

/// Checks the outcome of a session, and that the files that it names exist.
fn check_session(session: &SessionFile, path: &Path, findings: &mut Findings) {
    match session.outcome {
        None => findings.check("not_finished", None, || {
            String::from("the program was ended before it could close the session")
        }),
        Some(SessionOutcome::Failed) => findings.check("failed", None, || {
            let why = session.problems.last();
            let why = why.map_or(String::new(), |problem| format!(": {}", problem.text));
            format!("the session failed{why}")
        }),
        Some(SessionOutcome::Interrupted) => findings.note("interrupted", || {
            String::from("the session was stopped by its user")
        }),
        Some(SessionOutcome::Good | SessionOutcome::Loss) => {}
    }
    if session.outcome.is_some() && !session.has_recorded() {
        findings.check("nothing_recorded", None, || {
            String::from("nothing was recorded between begin and end")
        });
    }
    if let Some(problem) = session.problems.first() {
        let many = (problem.at, session.problems.len() as u64);
        findings.add(Severity::Good, "problems_recorded", many, || {
            format!("the session itself noted: {}", problem.text)
        });
    }
    let folder = path.parent().unwrap_or(Path::new("."));
    for name in &session.files {
        if !folder.join(name).exists() {
            findings.check("file_missing", None, || {
                format!("{name}, which the session names, is not in its folder")
            });
        }
    }
}
