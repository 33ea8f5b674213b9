//! Is a recording whole, and do its parts agree with each other?
//!
//! - [`recording::walk`]: bytes. Checksums of every chunk, of the data and of the index;
//!   where the file breaks and where it can be taken up again.
//! - `content`: messages. Each frame of the link is decoded again and compared
//!   with the message that was made of it; the numbers that the board gave are
//!   followed and held against the board's own counters; pulses must be on their
//!   grid, times must go on.
//! - [`crate::repair`]: what can be read, as a new recording.
//!
//! A finding says what kind it is (a stable word), how often, and when first. An
//! error is a contradiction or damage; a warning is something that is missing and
//! known to be; a note is worth knowing. The verdict is that of the worst.
//!
//! Limits: the phone's and the depth recorder's files are only looked for, not
//! read; `smartdepthsync extract` does that.

mod content;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use protocol::Ticks;
use serde::Serialize;

use recording::session_file::{SessionFile, SessionOutcome};
use recording::walk::{Damage, Event, FileReport, Walk};
use recording::{MCAP_FILE, RecordingError, SESSION_FILE, mcap_of};

/// Version of the form of [`Report`].
const FORM: u32 = 1;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Grade {
    /// Worth knowing.
    Note,
    /// Something is missing, and known to be.
    Warning,
    /// Damage, or a contradiction.
    Error,
}

/// Something that was found, once or often.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// A stable word.
    pub kind: &'static str,
    /// How bad.
    pub grade: Grade,
    /// How often.
    pub count: u64,
    /// Board time of the first, s, where it has one.
    pub first_s: Option<f64>,
    /// The first, in words.
    pub text: String,
}

/// What was found, one entry a kind, in order of appearance.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Findings(Vec<Finding>);

impl Findings {
    /// Adds one of a kind; its text and time are kept if it is the first.
    pub(crate) fn add(
        &mut self,
        grade: Grade,
        kind: &'static str,
        at: Option<Ticks>,
        text: impl FnOnce() -> String,
    ) {
        self.add_many(grade, kind, at, 1, text);
    }

    /// As [`Findings::add`], for `count` of them.
    pub(crate) fn add_many(
        &mut self,
        grade: Grade,
        kind: &'static str,
        at: Option<Ticks>,
        count: u64,
        text: impl FnOnce() -> String,
    ) {
        match self.0.iter_mut().find(|finding| finding.kind == kind) {
            Some(known) => known.count = known.count.saturating_add(count),
            None => self.0.push(Finding {
                kind,
                grade,
                count,
                first_s: at.map(Ticks::as_secs_f64),
                text: text(),
            }),
        }
    }

    /// Adds damage of the file.
    fn add_damage(&mut self, damage: &Damage) {
        let grade = match damage {
            Damage::CutOff { .. } | Damage::TopicsAssumed => Grade::Warning,
            _ => Grade::Error,
        };
        self.add(grade, damage.kind(), damage.at(), || damage.to_string());
    }

    fn verdict(&self) -> Verdict {
        match self.0.iter().map(|finding| finding.grade).max() {
            Some(Grade::Error) => Verdict::Damaged,
            Some(Grade::Warning) => Verdict::Incomplete,
            Some(Grade::Note) | None => Verdict::Whole,
        }
    }
}

/// The verdict over a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Every byte and every number is right.
    Whole,
    /// What is there is right; something is missing, and it is known what.
    Incomplete,
    /// Bytes are damaged, or parts contradict each other.
    Damaged,
}

/// A numbered stream of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StreamReport {
    /// Messages in the frames of the link.
    pub received: u64,
    /// Missing by the board's numbers.
    pub missing: u64,
    /// Of these the board says that it dropped them itself.
    pub dropped_by_board: u64,
}

/// A topic of the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TopicReport {
    /// Messages that can be read.
    pub messages: u64,
    /// Missing by their running number in the file.
    pub missing: u64,
}

/// The grid of the pulses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct GridReport {
    /// Pulses that were held against the grid of `session.json`.
    pub checked: u64,
    /// Of these, not on it.
    pub off: u64,
    /// The furthest, in ticks.
    pub worst_ticks: u64,
}

/// The result of a check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// [`FORM`].
    pub form: u32,
    /// The recording as it was named.
    pub recording: String,
    /// The verdict.
    pub verdict: Verdict,
    /// Bytes.
    pub file: FileReport,
    /// First and last board time, s.
    pub board_time_s: Option<[f64; 2]>,
    /// Runs of the board in the recording; more than one if it was reset.
    pub board_runs: u64,
    /// Frames of the link that are no message.
    pub damaged_frames: u64,
    /// The board's streams, by name.
    pub streams: BTreeMap<&'static str, StreamReport>,
    /// The topics, by name.
    pub topics: BTreeMap<String, TopicReport>,
    /// The pulses against their grid; nothing without `session.json`.
    pub grid: Option<GridReport>,
    /// Everything that was found.
    pub findings: Vec<Finding>,
}

/// The session file beside a recording's file, if it is there and can be read.
pub(crate) fn session_of(mcap: &Path, findings: &mut Findings) -> Option<SessionFile> {
    let folder = mcap.parent()?;
    if mcap.file_name()? != MCAP_FILE {
        return None;
    }
    if !folder.join(SESSION_FILE).exists() {
        findings.add(Grade::Warning, "no_session_file", None, || {
            format!("there is no {SESSION_FILE} beside the recording: settings are not known")
        });
        return None;
    }
    match SessionFile::load(folder) {
        Ok(session) => Some(session),
        Err(error) => {
            findings.add(Grade::Error, "session_file_damaged", None, || {
                error.to_string()
            });
            None
        }
    }
}

/// Checks a recording: its folder, or an MCAP file. `stop` is asked at every chunk.
///
/// # Errors
///
/// The file cannot be read, or is no MCAP file at all; or `stop` says so
/// ([`RecordingError::Stopped`]). Damage is no error: it is in the report.
pub fn verify(recording: &Path, stop: &dyn Fn() -> bool) -> Result<Report, RecordingError> {
    let path = mcap_of(recording);
    let mut findings = Findings::default();
    let session = session_of(&path, &mut findings);
    let mut content = content::Content::new(session.as_ref());
    let file = walk(&path, stop, &mut |event| {
        content.take(event, &mut findings);
        Ok(())
    })?;
    if let Some(session) = &session {
        check_session(session, &path, &file, &mut findings);
    }
    Ok(content.finish(recording, file, session.as_ref(), findings))
}

/// Gives everything in a file to `each`, until `stop` says so.
pub(crate) fn walk(
    path: &Path,
    stop: &dyn Fn() -> bool,
    each: &mut dyn FnMut(Event<'_>) -> Result<(), RecordingError>,
) -> Result<FileReport, RecordingError> {
    let mut walk = Walk::open(path)?;
    while walk.next_part(each)? {
        if stop() {
            return Err(RecordingError::Stopped);
        }
    }
    Ok(walk.report().clone())
}

fn check_session(session: &SessionFile, path: &Path, file: &FileReport, findings: &mut Findings) {
    match session.outcome {
        None => findings.add(Grade::Warning, "not_finished", None, || {
            String::from("the program was ended before it could close the session")
        }),
        Some(SessionOutcome::Failed) => findings.add(Grade::Note, "failed", None, || {
            session.problems.last().map_or_else(
                || String::from("the session failed"),
                |problem| format!("the session failed: {}", problem.text),
            )
        }),
        Some(SessionOutcome::Interrupted) => findings.add(Grade::Note, "interrupted", None, || {
            String::from("the session was stopped by its user")
        }),
        Some(SessionOutcome::Good | SessionOutcome::Loss) => {}
    }
    if let Some(problem) = session.problems.first() {
        findings.add_many(
            Grade::Note,
            "problems_recorded",
            problem.at,
            session.problems.len() as u64,
            || format!("the session itself noted: {}", problem.text),
        );
    }
    let folder = path.parent().unwrap_or(Path::new("."));
    for name in &session.files {
        if !folder.join(name).exists() {
            findings.add(Grade::Warning, "file_missing", None, || {
                format!("{name}, which the session names, is not in its folder")
            });
        }
    }
    if file.closed && session.outcome.is_none() {
        // The other way round is a kill between the two; this is not.
        findings.add(Grade::Note, "closed_without_outcome", None, || {
            String::from("the recording is closed, but the session file has no outcome")
        });
    }
}

impl Report {
    /// For a terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = format!("recording    {}\n", self.recording);
        let _ = writeln!(
            out,
            "verdict      {}",
            match self.verdict {
                Verdict::Whole => "whole: every byte and every number is right",
                Verdict::Incomplete =>
                    "incomplete: what is there is right, something is missing (see below)",
                Verdict::Damaged =>
                    "DAMAGED: parts cannot be read or contradict each other (see below)",
            }
        );
        let file = &self.file;
        let _ = writeln!(
            out,
            "file         {} bytes, {} chunks good, {} damaged, {} messages, {}",
            file.bytes,
            file.chunks,
            file.bad_chunks,
            file.messages,
            if file.closed { "closed" } else { "not closed" }
        );
        if let Some([from, to]) = self.board_time_s {
            let _ = writeln!(
                out,
                "board time   {from:.3} s to {to:.3} s, {} run{} of the board",
                self.board_runs,
                if self.board_runs == 1 { "" } else { "s" }
            );
        }
        for (name, stream) in &self.streams {
            let _ = writeln!(
                out,
                "{name:<12} {} received, {} missing ({} dropped by the board)",
                stream.received, stream.missing, stream.dropped_by_board
            );
        }
        if let Some(grid) = &self.grid {
            let _ = writeln!(
                out,
                "grid         {} pulses held against it, {} off{}",
                grid.checked,
                grid.off,
                if grid.off > 0 {
                    format!(", the furthest by {} ticks", grid.worst_ticks)
                } else {
                    String::new()
                }
            );
        }
        for finding in &self.findings {
            let grade = match finding.grade {
                Grade::Note => "note",
                Grade::Warning => "warning",
                Grade::Error => "ERROR",
            };
            let _ = write!(out, "{grade:<12} {}", finding.text);
            if finding.count > 1 {
                let _ = write!(out, " (and {} more of this kind)", finding.count - 1);
            }
            if let Some(at) = finding.first_s {
                let _ = write!(out, " [from {at:.3} s]");
            }
            out.push('\n');
        }
        if self.verdict != Verdict::Whole && !(file.closed && file.bad_chunks == 0) {
            out.push_str(
                "next         `smartdepthsync repair RECORDING OUT` makes a whole file of what can be read\n",
            );
        }
        out
    }
}
