//! The report of a recording: `report.html` in its folder.
//!
//! What was decided comes from `session.json`, the plots from `recording.mcap`,
//! which is read once from front to back.

mod curves;
mod judgement;
mod sections;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use protocol::Ticks;
use serde_json::json;

use self::curves::Curves;
use crate::REPORT_FILE;
use crate::page::Page;
use crate::summary::Facts;
use board::StreamCount;
pub(crate) use judgement::sentence;
pub use judgement::{files_to_fetch, findings, has_recorded, summary};
use recording::RecordingError;
use recording::finding::{Finding, Severity};
use recording::session_file::{PhoneRecord, SessionFile, Span};
use timebase::ClockModel;

/// The most findings and marks that are listed one by one.
const MAX_LISTED: usize = 200;

/// Writes the report of the recording in `folder`.
///
/// # Errors
///
/// The recording cannot be read, or the report cannot be written.
pub fn write(folder: &Path, session: &SessionFile) -> Result<PathBuf, RecordingError> {
    let curves = Curves::read(folder, session)?;
    let path = folder.join(REPORT_FILE);
    let html = page(folder, session, &curves).html();
    crate::put(&path, &html).map_err(RecordingError::io("write", &path))?;
    Ok(path)
}

/// The report as a page.
fn page(folder: &Path, session: &SessionFile, curves: &Curves) -> Page {
    let mut page = Page::new(&summary(folder, session));
    if curves.broken_off {
        page.note(
            Severity::Check,
            "The recording is not closed or is damaged; the plots lack what cannot be read. \
             The command verify says more.",
        );
    }
    findings_of(
        &mut page,
        "What went wrong",
        session.problems.iter().collect(),
    );
    findings_of(
        &mut page,
        "What the checks before the recording found",
        findings(session).collect(),
    );
    sections::clocks(&mut page, session);
    sections::alignment(&mut page, session);
    sections::trigger(&mut page, session, curves);
    sections::auxiliary(&mut page, session, curves);
    sections::motion(&mut page, curves);
    sections::marks(&mut page, session);
    page.settings("Settings: the rig profile", &json!(session.profile));
    if let Some(imu) = &session.imu {
        page.settings("Settings: the IMU", &json!(imu));
    }
    page
}

/// A section of findings, if there are any.
fn findings_of(page: &mut Page, heading: &str, findings: Vec<&Finding>) {
    if findings.is_empty() {
        return;
    }
    page.section(heading);
    let more = findings.len().saturating_sub(MAX_LISTED);
    page.findings(findings.into_iter().take(MAX_LISTED));
    if more > 0 {
        page.text(&format!("And {more} more, in session.json."));
    }
}

/// What matters most of a session, in figures.
fn facts(session: &SessionFile) -> Facts {
    let mut facts = vec![
        ("name", session.name.clone()),
        ("begun", session.started.clone()),
    ];
    if let Some(Span { from, to }) = session.recorded {
        let length = format!("{:.3} s of board time", seconds(from, to));
        facts.push(("length", length));
    }
    if let Some(board) = &session.board {
        let changed = if board.git_dirty { ", changed" } else { "" };
        let (id, firmware, revision) = (&board.id, &board.firmware, &board.git_revision);
        let reset = board.reset_cause;
        let board = format!("{id}, firmware {firmware} ({revision}{changed}), reset by {reset:?}");
        facts.push(("board", board));
    }
    let phones = session.phones.iter();
    facts.extend(phones.map(|phone| ("phone", phone_fact(phone))));
    let counts = &session.counts;
    for (name, count) in [
        ("trigger pulses", counts.pulses),
        ("IMU samples", counts.imu),
        ("strobe edges", counts.captures),
        ("auxiliary pulses", counts.outputs),
        ("seconds of a lidar", counts.pps),
        ("status", counts.status),
    ] {
        if count != StreamCount::default() {
            facts.push((name, count_fact(count)));
        }
    }
    let (damaged, again) = (session.damaged_frames, session.reconnects);
    let link = format!("{damaged} frames damaged; lost and taken up again {again} times");
    facts.push(("link", link));
    if !session.markers.is_empty() {
        facts.push(("marks", session.markers.len().to_string()));
    }
    facts.push(("program", session.program.clone()));
    facts
}

fn count_fact(count: StreamCount) -> String {
    let mut text = format!("{} received, {} lost", count.received, count.lost);
    if count.disordered > 0 {
        let _ = write!(text, ", {} twice or out of order", count.disordered);
    }
    text
}

/// A phone, its clock, and where its frames lie if the trigger follows another.
fn phone_fact(phone: &PhoneRecord) -> String {
    let mut text = format!("{} at {}", phone.name, phone.address);
    if let Some(version) = &phone.version {
        let _ = write!(text, ", app {version}");
    }
    if let Some(clock) = phone.clock {
        let (offset_us, skew_ppm) = sigmas(&clock);
        let (offset, skew) = (clock.offset, clock.skew * 1e6);
        let used = phone.twists.iter().filter(|twist| twist.accepted).count();
        let _ = write!(
            text,
            "; {used} of {} twists used: offset {offset:.6} s ± {offset_us:.2} µs, rate \
             {skew:+.4} ± {skew_ppm:.4} ppm",
            phone.twists.len()
        );
    }
    if let Some(placed) = phone.placement {
        let _ = write!(
            text,
            "; its frames cannot be shifted: {:+.1} ± {:.1} µs after the depth images, moving by \
             {:+.1} ± {:.1} µs/min",
            placed.offset_us,
            placed.offset_sigma_us,
            placed.drift_us_per_min,
            placed.drift_sigma_us_per_min
        );
    }
    text
}

fn title(name: &str) -> String {
    // A name such as "recording" says it already.
    match name.to_lowercase().starts_with("recording") {
        true => name.to_owned(),
        false => format!("Recording {name}"),
    }
}

/// 1-sigma of a relation's offset in µs and of its skew in ppm, at its reference.
fn sigmas(clock: &ClockModel) -> (f64, f64) {
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
