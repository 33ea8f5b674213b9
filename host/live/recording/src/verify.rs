//! Checks that a recording is complete, and that its parts agree with each other.
//!
//! - [`walk`](crate::walk): bytes. Checksums of every chunk, of the data and of the index;
//!   where the file breaks and where reading can resume; the index against the messages.
//! - `content`: messages. The numbers that the board gave are followed, and missing messages are
//!   attributed by the board's own counters (`numbers`); pulses must lie on their grid
//!   (`pulses`), times must increase, be in step, and be those that the messages state.
//! - `held`: the closed recording's [`contents`](crate::contents), its files, and `metadata.yaml`.
//! - `stated`: clocks, markers, spans and counts of `session.json` against the messages.
//!
//! Damage and contradictions are [`Severity::Bad`]; known losses, and what cannot be compared,
//! [`Severity::Check`]; remarks [`Severity::Good`]. The verdict is that of the worst finding, and
//! [`Verification::compared`] lists what it rests on. `fault` is the table of everything that is
//! found.
//!
//! Limits: videos and depth recordings are compared by their bytes with those at the end of the
//! session; what is in them is read by `smartdepthsync extract`. A file that was added since is
//! compared with nothing.

mod content;
mod fault;
mod findings;
mod held;
mod numbers;
mod pulses;
mod stated;

use std::collections::BTreeMap;
use std::path::Path;

use board::Stream;
use board::finding::{Finding, Severity};
use serde::Serialize;
use system::ReadMonitor;

use self::content::Content;
use self::fault::Fault;
use self::findings::Findings;
pub use self::held::assumed_frames;
use super::contents::FileSums;
use super::session_file::{SessionFile, SessionOutcome};
use super::walk::{FileReport, Walk};
use super::{MCAP_FILE, RecordingError, SESSION_FILE, mcap_of};

/// Version of the JSON form of [`Verification`].
const FORM: u32 = 3;

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
    /// Good: everything in [`Self::compared`] is as it was written. Check: something is missing, or
    /// cannot be compared. Bad: bytes are damaged, or parts contradict each other.
    pub severity: Severity,
    /// True without a readable `session.json`: the file can be compared with itself alone.
    pub is_bare: bool,
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
    /// Comparisons that were made, in words.
    pub compared: Vec<String>,
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
    verify_without_phones(recording, &mut FileSums::default(), monitor)?
        .with_phones(recording, monitor)
}

/// Checks a recording as [`verify`] does, but for the content of the phones' files
/// ([`Verification::with_phones`]); with checksums of files that were read already.
///
/// # Errors
///
/// As [`verify`].
pub fn verify_without_phones(
    recording: &Path,
    sums: &mut FileSums,
    monitor: &ReadMonitor,
) -> Result<Verification, RecordingError> {
    let path = mcap_of(recording);
    let folder = system::folder_of(&path);
    let is_in_folder = path.file_name().is_some_and(|name| name == MCAP_FILE);
    let mut findings = Findings::default();
    let has_session = is_in_folder && folder.join(SESSION_FILE).exists();
    let loaded = has_session.then(|| SessionFile::load(folder)).transpose();
    let session = loaded.unwrap_or_else(|error| {
        findings.add(&Fault::SessionDamaged(error), None);
        None
    });
    let mut content = Content::new(session.as_ref());
    let mut walk = Walk::open(&path, monitor)?;
    while walk.next_part(&mut |event| content.check(event, &mut findings))? {}
    let file = walk.report().clone();
    let is_whole = file.closed && !content.is_damaged;
    let mut compared = Vec::new();
    if is_whole {
        compared.push(format!(
            "{} chunks, the data and the index with their checksums; the index with {} messages",
            file.chunks, file.messages
        ));
    }
    if !has_session && (is_in_folder || content.is_own) {
        findings.add(&Fault::NoSession, None);
    }
    let topics = content.tally.topics();
    if content.is_own {
        compared.push(format!(
            "{} stamps of messages with their times; numbers and times of each topic with each other",
            content.stamps
        ));
    }
    if is_in_folder && is_whole {
        let expected = walk.metadata(MCAP_FILE);
        compared.extend(held::metadata(folder, &expected, &mut findings));
    }
    let damaged_frames = content.numbers.damaged_frames();
    let streams = content.numbers.finish(&mut findings);
    if let Some(session) = &session {
        check_outcome(session, &mut findings);
        match &session.contents {
            Some(contents) => compared.push(held::topics(contents, &topics, &mut findings)),
            None if is_whole && session.outcome.is_some() => {
                findings.add(&Fault::NoContents, None);
            }
            None => {}
        }
        if is_whole {
            let missing = streams.get(Stream::Pulses.name());
            let missing = missing.map_or(0, |stream| stream.missing);
            let stated = content.stated;
            compared.extend(stated.finish(&topics, content.span, missing, &mut findings));
        }
        compared.extend(held::files(session, folder, sums, monitor, &mut findings)?);
    }
    let grid = content.pulses.report();
    compared
        .extend(grid.map(|grid| format!("{} pulses with the grid of the alignment", grid.checked)));
    let alignment = session.as_ref().and_then(|session| session.alignment);
    Ok(Verification {
        form: FORM,
        recording: recording.display().to_string(),
        severity: findings.worst(),
        is_bare: session.is_none(),
        file,
        board_time_s: content.span.map(|span| span.map(|at| at.as_secs_f64())),
        damaged_frames,
        streams,
        grid,
        compared,
        findings: findings.into_vec(),
        alignment: alignment.map(|alignment| alignment.promise()),
    })
}

impl Verification {
    /// Adds the comparison of the content of the phones' files, with the session as it is on the disk.
    ///
    /// # Errors
    ///
    /// Returns an error if reads are cancelled.
    pub fn with_phones(
        mut self,
        recording: &Path,
        monitor: &ReadMonitor,
    ) -> Result<Self, RecordingError> {
        let path = mcap_of(recording);
        let folder = system::folder_of(&path);
        // One that cannot be read is among the findings.
        let session = SessionFile::load(folder).ok().filter(|_| !self.is_bare);
        let mut findings = Findings::default();
        if let Some(session) = session {
            let compared = held::phones(&session, folder, monitor, &mut findings)?;
            self.compared.extend(compared);
        }
        self.severity = self.severity.max(findings.worst());
        self.findings.extend(findings.into_vec());
        Ok(self)
    }
}

/// Checks the outcome of a session.
fn check_outcome(session: &SessionFile, findings: &mut Findings) {
    match session.outcome {
        None => findings.add(&Fault::NotFinished, None),
        Some(SessionOutcome::Failed) => {
            let why = session.problems.last();
            let why = why.map_or(String::new(), |problem| format!(": {}", problem.text));
            findings.add(&Fault::Failed(why), None);
        }
        Some(SessionOutcome::Interrupted) => findings.note(Finding::good(
            "interrupted",
            "the session was stopped by its user",
        )),
        Some(SessionOutcome::Good | SessionOutcome::Loss) => {}
    }
    if session.outcome.is_some() && !session.has_recorded() {
        findings.add(&Fault::NothingRecorded, None);
    }
    if let Some(problem) = session.problems.first() {
        let text = format!("the session itself noted: {}", problem.text);
        findings.note(Finding {
            at: problem.at,
            count: session.problems.len() as u64,
            ..Finding::good("problems_recorded", text)
        });
    }
}
