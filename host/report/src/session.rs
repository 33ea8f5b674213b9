//! The report of a recording: `report.html` in its folder.
//!
//! What was decided comes from `session.json`, the plots from `recording.mcap`,
//! which is read once from front to back.

mod curves;
mod judgement;
mod sections;

use std::path::{Path, PathBuf};

use protocol::Ticks;
use serde_json::json;

use self::curves::Curves;
use crate::REPORT_FILE;
use crate::page::Page;
use board::StreamCount;
pub use judgement::{Judgement, files_to_fetch, findings, has_recorded};
use recording::RecordingError;
use recording::finding::Severity;
use recording::session_file::{SessionFile, Span};
use timebase::ClockModel;

/// The most problems and marks that are listed one by one.
const MAX_LISTED: usize = 200;

/// Writes the report of the recording in `folder`. `stop` is asked again and again while
/// the recording is read.
///
/// # Errors
///
/// The recording cannot be read, or the report cannot be written; or `stop` says so
/// ([`RecordingError::Stopped`]).
pub fn write(
    folder: &Path,
    session: &SessionFile,
    stop: &dyn Fn() -> bool,
) -> Result<PathBuf, RecordingError> {
    let curves = Curves::read(folder, session, stop)?;
    let path = folder.join(REPORT_FILE);
    let html = page(folder, session, &curves).html();
    crate::put(&path, &html).map_err(RecordingError::io("write", &path))?;
    Ok(path)
}

/// The report as a page.
fn page(folder: &Path, session: &SessionFile, curves: &Curves) -> Page {
    let judged = Judgement::of(folder, session);
    let mut page = Page::new(&title(&session.name), judged.severity, &judged.text);
    for part in &judged.parts {
        page.note(part.severity, &part.line());
    }
    page.facts(&facts(session));
    if curves.broken_off {
        page.note(
            Severity::Check,
            "The recording is not closed or is damaged; the plots lack what cannot be read. \
             The command verify says more.",
        );
    }
    warnings(&mut page, session);
    checks(&mut page, session);
    streams(&mut page, session);
    sections::clocks(&mut page, session);
    sections::alignment(&mut page, session);
    sections::other_phones(&mut page, session);
    sections::trigger(&mut page, session, curves);
    sections::further_sensors(&mut page, session, curves);
    sections::motion(&mut page, curves);
    sections::marks(&mut page, session);
    page.settings("Settings: the rig profile", &json!(session.profile));
    if let Some(imu) = &session.imu {
        page.settings("Settings: the IMU", &json!(imu));
    }
    page
}

fn title(name: &str) -> String {
    // A name such as "recording" says it already.
    match name.to_lowercase().starts_with("recording") {
        true => name.to_owned(),
        false => format!("Recording {name}"),
    }
}

fn facts(session: &SessionFile) -> Vec<(&'static str, String)> {
    let mut facts = vec![
        ("recording", session.name.clone()),
        ("begun", session.started.clone()),
    ];
    if let Some(Span { from, to }) = session.recorded {
        let length = format!("{:.3} s of board time", seconds(from, to));
        facts.push(("length", length));
    }
    if let Some(board) = &session.board {
        facts.push((
            "board",
            format!(
                "{}, firmware {} ({}{}), reset by {:?}",
                board.id,
                board.firmware,
                board.git_revision,
                if board.git_dirty { ", changed" } else { "" },
                board.reset_cause
            ),
        ));
    }
    for phone in &session.phones {
        let name = match session.phones.len() {
            1 => String::new(),
            _ => format!("{}: ", phone.name),
        };
        let version = phone.version.as_ref();
        let app = version.map_or(String::new(), |version| format!(", app {version}"));
        facts.push(("phone", format!("{name}{}{app}", phone.address)));
    }
    facts.push(("program", session.program.clone()));
    facts
}

fn warnings(page: &mut Page, session: &SessionFile) {
    if session.problems.is_empty() {
        return;
    }
    page.section("What went wrong");
    let problems = session.problems.iter().take(MAX_LISTED);
    page.table(
        ["board time, s", "kind", "what"],
        problems.map(|problem| {
            [
                problem.seconds(),
                problem.kind.clone(),
                problem.text.clone(),
            ]
        }),
    );
    if session.problems.len() > MAX_LISTED {
        page.text(&format!(
            "And {} more, in session.json.",
            session.problems.len() - MAX_LISTED
        ));
    }
}

/// What the checks before the recording found, in their own words.
fn checks(page: &mut Page, session: &SessionFile) {
    if findings(session).next().is_none() {
        return;
    }
    page.section("What the checks before the recording found");
    for check in findings(session) {
        page.note(check.severity, &check.line());
    }
}

fn streams(page: &mut Page, session: &SessionFile) {
    page.section("What came from the board");
    let counts = &session.counts;
    let row = |name: &str, count: StreamCount| {
        let [received, lost] = [count.received, count.lost].map(|n| n.to_string());
        [name.to_owned(), received, lost]
    };
    page.table(
        ["stream", "received", "lost"],
        [
            row("trigger pulses", counts.pulses),
            row("IMU samples", counts.imu),
            row("strobe edges", counts.captures),
            row("status", counts.status),
            row("pulses of further outputs", counts.outputs),
            row("seconds of a lidar", counts.pps),
        ],
    );
    page.text(&format!(
        "{} frames of the link were damaged; the link was lost and taken up again {} times.",
        session.damaged_frames, session.reconnects
    ));
}

/// 1-sigma of a relation's offset in µs and of its skew in ppm, at its reference.
#[must_use]
pub fn sigmas(clock: &ClockModel) -> (f64, f64) {
    let sigma = |at: usize| clock.covariance[at][at].max(0.0).sqrt() * 1e6;
    (sigma(0), sigma(1))
}

fn seconds(from: Ticks, to: Ticks) -> f64 {
    to.as_secs_f64() - from.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::title;

    #[test]
    fn a_title_says_recording_once() {
        assert_eq!(title("walk"), "Recording walk");
        assert_eq!(title("Recording-3"), "Recording-3");
        assert_eq!(title("recording"), "recording");
    }
}
