//! Is a recording whole, and do its parts agree with each other?
//!
//! - [`recording::walk`]: bytes. Checksums of every chunk, of the data and of the index;
//!   where the file breaks and where it can be taken up again.
//! - `content`: messages. The numbers that the board gave are followed, and what is missing is
//!   shared out by the board's own counters; pulses must be on their grid, times must go on.
//!
//! Bad is a contradiction or damage; check is something that is missing and known to be;
//! good is worth knowing. The verdict is that of the worst.
//!
//! Limits: the phone's and the depth recorder's files are only looked for, not
//! read; `smartdepthsync extract` does that.

mod content;
pub(crate) mod numbers;
mod pulses;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use board::finding::{Finding, Severity};
use protocol::Ticks;
use recording::session_file::{SessionFile, SessionOutcome};
use recording::walk::{Damage, FileReport, Walk};
use recording::{MCAP_FILE, RecordingError, SESSION_FILE, mcap_of};
use serde::Serialize;

use crate::session::{has_recorded, sentence};
use crate::summary::Summary;

/// Version of the form of [`Report`].
const FORM: u32 = 2;

/// What was found, one entry a kind, in order of appearance.
#[derive(Clone, Debug, Default, PartialEq)]
struct Findings(Vec<Finding>);

impl Findings {
    /// Adds `count` of a kind; text and time are those of the first.
    fn add(
        &mut self,
        severity: Severity,
        kind: &'static str,
        (at, count): (Option<Ticks>, u64),
        text: impl FnOnce() -> String,
    ) {
        match self.0.iter_mut().find(|finding| finding.kind == kind) {
            Some(known) => known.count = known.count.saturating_add(count),
            None => self.0.push(Finding {
                at,
                count,
                ..Finding::new(severity, kind, text())
            }),
        }
    }

    /// Adds damage or a contradiction.
    fn bad(&mut self, kind: &'static str, at: Option<Ticks>, text: impl FnOnce() -> String) {
        self.add(Severity::Bad, kind, (at, 1), text);
    }

    /// Adds something that is missing, and known to be.
    fn check(&mut self, kind: &'static str, at: Option<Ticks>, text: impl FnOnce() -> String) {
        self.add(Severity::Check, kind, (at, 1), text);
    }

    fn damage(&mut self, damage: &Damage) {
        let severity = match damage {
            Damage::CutOff { .. } | Damage::TopicsAssumed => Severity::Check,
            _ => Severity::Bad,
        };
        let at = (damage.at(), 1);
        self.add(severity, damage.kind(), at, || damage.to_string());
    }

    /// Adds something worth knowing.
    fn note(&mut self, kind: &'static str, text: impl FnOnce() -> String) {
        self.add(Severity::Good, kind, (None, 1), text);
    }

    fn worst(&self) -> Severity {
        let severities = self.0.iter().map(|finding| finding.severity);
        severities.max().unwrap_or(Severity::Good)
    }
}

/// A numbered stream of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StreamReport {
    /// Messages that can be read.
    pub received: u64,
    /// Missing by the board's numbers.
    pub missing: u64,
    /// Of these the board says that it dropped them itself.
    pub dropped_by_board: u64,
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
    /// Good: every byte and every number is right. Check: what is there is right, something
    /// is missing. Bad: bytes are damaged, or parts contradict each other.
    pub severity: Severity,
    /// Bytes.
    pub file: FileReport,
    /// First and last board time, s.
    pub board_time_s: Option<[f64; 2]>,
    /// Frames that came damaged over the link, by the log.
    pub damaged_frames: u64,
    /// The board's streams, by name.
    pub streams: BTreeMap<&'static str, StreamReport>,
    /// The pulses against their grid; nothing without `session.json`.
    pub grid: Option<GridReport>,
    /// Everything that was found.
    pub findings: Vec<Finding>,
    /// How well the cameras expose together, by the session.
    pub alignment: Option<String>,
    /// The page that was written again; nothing without `session.json`.
    pub report: Option<PathBuf>,
}

/// The session file beside a recording's file, if it is there and can be read.
fn session_of(mcap: &Path, findings: &mut Findings) -> Option<SessionFile> {
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

/// Checks a recording: its folder, or an MCAP file.
///
/// # Errors
///
/// The file cannot be read, or is no MCAP file at all. Damage is no error: it is in the report.
pub fn verify(recording: &Path) -> Result<Report, RecordingError> {
    let path = mcap_of(recording);
    let mut findings = Findings::default();
    let session = session_of(&path, &mut findings);
    let mut content = content::Content::new(session.as_ref());
    let mut walk = Walk::open(&path)?;
    while walk.next_part(&mut |event| content.take(event, &mut findings))? {}
    let file = walk.report().clone();
    if let Some(session) = &session {
        check_session(session, &path, &mut findings);
    }
    Ok(content.finish(recording, file, session.as_ref(), findings))
}

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
    if session.outcome.is_some() && !has_recorded(session) {
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

impl Report {
    /// What was found, and what there is in figures.
    #[must_use]
    pub fn summary(&self) -> Summary {
        let text = match self.severity {
            Severity::Good => "Good: every byte and every number is right.",
            Severity::Check => "Check: what is there is right, something is missing.",
            Severity::Bad => "Bad: parts cannot be read or contradict each other.",
        };
        let alignment = self.alignment.iter();
        let alignment: String = alignment.map(|it| format!(" {}", sentence(it))).collect();
        let text = format!("{text}{alignment}");
        let file = &self.file;
        let mut facts = vec![
            ("recording", self.recording.clone()),
            (
                "file",
                format!(
                    "{} bytes, {} chunks good, {} damaged, {} messages, {}",
                    file.bytes,
                    file.chunks,
                    file.bad_chunks,
                    file.messages,
                    if file.closed { "closed" } else { "not closed" }
                ),
            ),
        ];
        if let Some([from, to]) = self.board_time_s {
            facts.push(("board time", format!("{from:.3} s to {to:.3} s")));
        }
        for (name, stream) in &self.streams {
            let StreamReport {
                received,
                missing,
                dropped_by_board: dropped,
            } = stream;
            let text =
                format!("{received} received, {missing} missing ({dropped} dropped by the board)");
            facts.push((name, text));
        }
        if let Some(grid) = &self.grid {
            let GridReport {
                checked,
                off,
                worst_ticks,
            } = grid;
            let most = match off {
                0 => String::new(),
                _ => format!(", the furthest by {worst_ticks} ticks"),
            };
            let text = format!("{checked} pulses held against it, {off} off{most}");
            facts.push(("grid", text));
        }
        if self.severity != Severity::Good && !(file.closed && file.bad_chunks == 0) {
            let next = "`smartdepthsync extract` reads what is there, after the damage too; for other \
                        programs `mcap recover` makes a whole file of what is before it";
            facts.push(("next", next.to_owned()));
        }
        Summary {
            title: format!("Check of {}", self.recording),
            severity: self.severity,
            text: text.to_owned(),
            parts: self.findings.clone(),
            facts,
        }
    }
}
