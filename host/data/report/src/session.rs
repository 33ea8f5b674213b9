//! The report of a recording: `report.html` in its folder.
//!
//! The decisions come from `session.json`, the plots from one pass over `recording.mcap`.

mod curves;
mod judgement;
mod measured;
mod sections;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use protocol::Ticks;
use serde_json::json;

use self::curves::Curves;
use crate::REPORT_FILE;
use crate::page::Page;
use crate::summary::{Facts, Summary};
use board::BoardInfo;
use board::finding::{Finding, Severity};
use board::{StreamCount, reset_cause};
use judgement::findings;
pub(crate) use judgement::{ALIGNMENT, rig_of, sentence};
pub use judgement::{files_to_fetch, is_lossy, summary};
use recording::RecordingError;
use recording::session_file::{PhoneRecord, SessionFile, Span};
use recording::verify::{Verification, verify};
pub(crate) use sections::predicted;
use system::ReadMonitor;

/// Most findings and marks that are listed one by one.
const MAX_LISTED: usize = 200;

/// Writes the report of the recording in `folder`, which was checked, and returns its path.
///
/// # Errors
///
/// Fails if the recording cannot be read, or the report cannot be written.
pub fn write(
    folder: &Path,
    session: &SessionFile,
    verification: &Verification,
    monitor: &ReadMonitor,
) -> Result<PathBuf, RecordingError> {
    let curves = Curves::read(folder, session, monitor)?;
    let path = folder.join(REPORT_FILE);
    let verdict = summary(folder, session, Some(verification));
    let html = page(folder, session, &verdict, &curves).html();
    crate::put(&path, &html).map_err(RecordingError::io("write", &path))?;
    Ok(path)
}

/// Writes the report again if it has a link to `page`, the new page of a data set or of an
/// evaluation. Otherwise it changes nothing and returns `None`. Checks the recording unless it was: then
/// all but the content of the phones' files is taken from that check.
///
/// # Errors
///
/// Fails like [`write`].
pub fn link_page(
    folder: &Path,
    page: &Path,
    checked: Option<Verification>,
) -> Result<Option<PathBuf>, RecordingError> {
    let page = page.canonicalize().ok();
    let is_linked = |(_, address): &(String, String)| {
        page.is_some() && folder.join(address).canonicalize().ok() == page
    };
    let session = SessionFile::load(folder).ok();
    let Some(session) = session.filter(|_| pages_of(folder).iter().any(is_linked)) else {
        return Ok(None);
    };
    let monitor = ReadMonitor::default();
    let verification = match checked {
        Some(checked) => checked.with_phones(folder, &monitor)?,
        None => verify(folder, &monitor)?,
    };
    write(folder, &session, &verification, &monitor).map(Some)
}

/// Assembles the page of the report.
fn page(folder: &Path, session: &SessionFile, verdict: &Summary, curves: &Curves) -> Page {
    let mut page = Page::new(verdict);
    page.links(&pages_of(folder));
    if curves.broken_off {
        page.note(
            Severity::Check,
            "The recording is not closed or is damaged; the plots lack what cannot be read. \
             The command verify says more.",
        );
    }
    add_findings(
        &mut page,
        "What went wrong",
        session.problems.iter().collect(),
    );
    add_findings(
        &mut page,
        "What the checks before the recording found",
        findings(session).collect(),
    );
    sections::clocks(&mut page, session, curves);
    sections::alignment(&mut page, session, curves);
    sections::trigger(&mut page, session, curves);
    sections::auxiliary(&mut page, session, curves);
    sections::motion(&mut page, curves);
    sections::losses(&mut page, curves);
    sections::marks(&mut page, session);
    page.settings("Settings: the rig profile", &json!(session.profile));
    if let Some(imu) = &session.imu {
        page.settings("Settings: the IMU", &json!(imu));
    }
    page
}

/// Returns the pages about a recording, each as a text and an address: those of data sets beside
/// it that bear its name, and others in its folder, which evaluations write.
fn pages_of(folder: &Path) -> Vec<(String, String)> {
    let named = |place: PathBuf| -> Vec<String> {
        let entries = std::fs::read_dir(place).into_iter().flatten();
        let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        let mut names: Vec<String> = names.filter(|name| is_plain(name)).collect();
        names.sort();
        names
    };
    let own = folder.canonicalize().ok();
    let own = own.as_deref().and_then(Path::file_name);
    let prefix = own.map_or(String::from("-"), |own| {
        format!("{}-", own.to_string_lossy())
    });
    let beside = named(folder.join("..")).into_iter();
    let data_sets = beside.filter_map(|name| {
        let place = format!("../{name}/{REPORT_FILE}");
        (name.starts_with(&prefix) && folder.join(&place).is_file())
            .then(|| (format!("Data set {name}"), place))
    });
    let inside = named(folder.to_owned()).into_iter();
    let inside = inside.filter(|name| name.ends_with(".html") && name != REPORT_FILE);
    let inside = inside.map(|name| (format!("Evaluation {name}"), name));
    data_sets.chain(inside).collect()
}

/// Returns true if a name needs no escape in an address.
fn is_plain(name: &str) -> bool {
    name.chars()
        .all(|c| c.is_ascii_alphanumeric() || "._-".contains(c))
}

/// Returns the link (text and address) to the report of the recording in `folder`, from a page
/// in the folder `from`, if there is a report.
pub(crate) fn link_to(folder: &Path, from: &Path) -> Option<(String, String)> {
    let (folder, from) = (folder.canonicalize().ok()?, from.canonicalize().ok()?);
    folder.join(REPORT_FILE).is_file().then_some(())?;
    let both = folder.components().zip(from.components());
    let common = both.take_while(|(a, b)| a == b).count();
    let mut steps = vec![".."; from.components().count() - common];
    for part in folder.components().skip(common) {
        steps.push(part.as_os_str().to_str().filter(|name| is_plain(name))?);
    }
    steps.push(REPORT_FILE);
    let name = folder.file_name()?.to_string_lossy();
    Some((format!("Recording {name}"), steps.join("/")))
}

/// Adds a section of findings, if there are any.
fn add_findings(page: &mut Page, heading: &str, findings: Vec<&Finding>) {
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

/// Describes the board, its firmware, and the cause of its last reset.
pub(crate) fn board_fact(board: &BoardInfo) -> String {
    let (id, firmware) = (&board.id, &board.firmware);
    let revision = board.git_revision.as_deref().unwrap_or("unknown revision");
    let changed = if board.git_dirty { ", changed" } else { "" };
    let reset = reset_cause(board.reset_cause);
    format!("{id}, firmware {firmware} ({revision}{changed}), last reset: {reset}")
}

/// Returns the most important figures of a session.
fn facts(session: &SessionFile) -> Facts {
    let mut facts = vec![("begun", session.started.clone())];
    if let Some(Span { from, to }) = session.recorded {
        let length = format!("{:.3} s of board time", seconds(from, to));
        facts.push(("length", length));
    }
    if let Some(board) = &session.board {
        facts.push(("board", board_fact(board)));
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

/// Describes a phone, its clock, and the offset of its frames if the trigger follows another
/// phone.
fn phone_fact(phone: &PhoneRecord) -> String {
    let mut text = format!("{} at {}", phone.name, phone.address);
    if let Some(version) = &phone.version {
        let _ = write!(text, ", app {version}");
    }
    if let Some(clock) = phone.clock {
        let offset_us = clock.offset_at(clock.reference).sigma * 1e6;
        let skew_ppm = clock.skew_sigma_at(clock.reference) * 1e6;
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
        let _ = write!(text, "; {placed}");
    }
    text
}

fn seconds(from: Ticks, to: Ticks) -> f64 {
    to.as_secs_f64() - from.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_its_data_sets_and_its_evaluations_link_to_each_other() {
        let parent = tempfile::tempdir().unwrap();
        let [walk, data] = ["walk", "walk-euroc"].map(|name| parent.path().join(name));
        for folder in [&walk, &data] {
            std::fs::create_dir(folder).unwrap();
            std::fs::write(folder.join(REPORT_FILE), "").unwrap();
        }
        std::fs::write(walk.join("drift.html"), "").unwrap();
        let link = |text: &str, address: &str| (text.to_owned(), address.to_owned());
        let there = [
            link("Data set walk-euroc", "../walk-euroc/report.html"),
            link("Evaluation drift.html", "drift.html"),
        ];
        assert_eq!(pages_of(&walk), there);
        let back = |address| Some(link("Recording walk", address));
        assert_eq!(link_to(&walk, &data), back("../walk/report.html"));
        assert_eq!(link_to(&walk, &walk), back("report.html"));
    }
}
