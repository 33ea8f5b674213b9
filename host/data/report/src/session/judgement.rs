//! The one verdict on a recording, which `record`, `verify`, `extract` and the page state: in the
//! three parts that make a data set, the data of board and phone, the alignment of the exposures, and
//! the depth recording; and in what the check of the files has found.
//!
//! A part is good only if everything about it is known, from the session file and from the
//! files in the folder. Files that were added later count when the report is written again.

use std::cmp::Reverse;
use std::path::{Path, PathBuf};

use board::finding::{EventKind, Finding, Severity};
use clock::PhoneNanos;
use phone::adb::get_files_command;
use phone::video_files::{self, VideoFiles};
use recording::depth_files::{bytes_of, depth_recordings};
use recording::error_budget::micros_text;
use recording::session_file::{
    CHECK_BIAS, CHECK_LEARNT, CHECK_READBACK, SessionFile, SessionOutcome,
};
use recording::verify::Verification;
use system::shell_word;

use super::{facts, seconds};
use crate::summary::{Summary, titled};

/// Name of the part about the phone's and the board's data, of that about the alignment, and of that
/// about the check of the files.
const DATA: &str = "board and phone";
pub(crate) const ALIGNMENT: &str = "alignment";
const CONTENT: &str = "content";

/// Returns true if the recording lacks something that the session was to record, or is damaged: the
/// commands about it end with exit code 4. What is not known of it, and files that are still on the
/// phone, are no loss.
#[must_use]
pub fn is_lossy(session: &SessionFile, verification: Option<&Verification>) -> bool {
    let outcome = session.outcome;
    let is_whole = matches!(
        outcome,
        Some(SessionOutcome::Good | SessionOutcome::Interrupted)
    );
    let mut found = verification
        .into_iter()
        .flat_map(|found| in_span(session, found));
    !is_whole || !session.has_recorded() || found.next().is_some()
}

/// Returns what the check of the files has found and is not good: damage anywhere, and what is missing
/// from the recorded span.
fn in_span<'a>(
    session: &SessionFile,
    verification: &'a Verification,
) -> impl Iterator<Item = &'a Finding> {
    let span = session.recorded;
    verification.findings.iter().filter(move |finding| {
        let is_outside = |at| span.is_some_and(|span| !(span.from..=span.to).contains(&at));
        match finding.severity {
            Severity::Good => false,
            Severity::Check => !finding.at.is_some_and(is_outside),
            Severity::Bad => true,
        }
    })
}

/// Judges the recording in `folder`: parts `board and phone`, `alignment` and `depth`, or a
/// single part if nothing was recorded; and a part `content` if the check of the files has found
/// something.
#[must_use]
pub fn summary(
    folder: &Path,
    session: &SessionFile,
    verification: Option<&Verification>,
) -> Summary {
    let mut parts = if session.has_recorded() {
        vec![
            board_and_phone(folder, session),
            alignment(session),
            depth(folder, session),
        ]
    } else {
        vec![nothing_recorded(session)]
    };
    let found = verification
        .into_iter()
        .flat_map(|found| in_span(session, found));
    // Where nothing was recorded, little can be missing.
    let is_new = |finding: &&Finding| finding.severity == Severity::Bad || session.has_recorded();
    parts.extend(content(found.filter(is_new).collect()));
    let severities = parts.iter().map(|part| part.severity);
    let severity = severities.max().unwrap_or(Severity::Good);
    let open = parts.iter().filter(|part| part.severity != Severity::Good);
    let open: Vec<String> = open.map(|part| part.kind.to_string()).collect();
    let open = open.join(", ");
    let text = match (severity, parts.as_slice()) {
        (_, [only]) => only.text.clone(),
        (Severity::Good, _) => String::from("Complete, and everything about it is known."),
        (Severity::Check, _) => {
            format!("Recorded, but something is missing or unknown: {open}.")
        }
        (Severity::Bad, _) => format!("Not usable in this state: {open}."),
    };
    let promise = session
        .alignment
        .map(|alignment| sentence(&alignment.promise()));
    let text = match promise {
        Some(promise) if severity != Severity::Bad => format!("{promise} {text}"),
        _ => text,
    };
    Summary {
        title: titled(
            format!("Recording {} of {}", session.name, rig_of(session)),
            session.board.as_ref().map(|board| board.id.as_str()),
        ),
        severity,
        text,
        parts,
        facts: facts(session),
    }
}

/// Returns the name of the rig in words.
pub(crate) fn rig_of(session: &SessionFile) -> &str {
    match session.profile.name.as_str() {
        "" => "a rig without a name",
        name => name,
    }
}

/// Words as a sentence.
pub(crate) fn sentence(words: &str) -> String {
    let mut letters = words.chars();
    let first = letters.next().into_iter().flat_map(char::to_uppercase);
    first.chain(letters).chain(['.']).collect()
}

/// Describes the worst that the check of the files has found.
fn content(mut found: Vec<&Finding>) -> Option<Finding> {
    found.sort_by_key(|finding| Reverse(finding.severity));
    let (first, others) = found.split_first()?;
    let more = match others.len() {
        0 => String::new(),
        more => format!(", and {more} more (`smartdepthsync verify` lists them)"),
    };
    let next = first.next_step.iter().cloned().collect();
    Some(part(CONTENT, first.severity, first.words() + &more, next))
}

/// Returns the checks before the recording that were not good, except those that are a part of
/// the summary.
pub(super) fn findings(session: &SessionFile) -> impl Iterator<Item = &Finding> {
    let checks = session.preflight.iter();
    checks.filter(|check| {
        let parts = [CHECK_BIAS, CHECK_LEARNT, CHECK_READBACK];
        let is_said = parts.iter().any(|part| check.kind == *part);
        check.severity != Severity::Good && !(is_said && session.has_recorded())
    })
}

fn part(name: &str, severity: Severity, found: String, next: Vec<String>) -> Finding {
    Finding {
        next_step: (!next.is_empty()).then(|| next.join("; ")),
        ..Finding::new(severity, name, found)
    }
}

fn nothing_recorded(session: &SessionFile) -> Finding {
    let found = match session.outcome {
        Some(SessionOutcome::Failed) => {
            let reason = reason(session);
            format!("The session failed before the recording began: {reason}.")
        }
        _ => String::from("The session ended before the recording began: nothing was recorded."),
    };
    let next = String::from("record again; this folder can be deleted");
    part(DATA, Severity::Bad, found, vec![next])
}

fn reason(session: &SessionFile) -> &str {
    let last = session.problems.last();
    last.map_or("for an unknown reason", |problem| &problem.text)
}

/// Judges the data of the board and the files of the phones.
fn board_and_phone(folder: &Path, session: &SessionFile) -> Finding {
    let counts = &session.counts;
    let length = session
        .recorded
        .map_or(0.0, |span| seconds(span.from, span.to));
    let received = format!(
        "{length:.1} s with {} pulses and {} IMU samples",
        counts.pulses.received, counts.imu.received
    );
    let lost = match counts.lost() {
        0 => String::from("no message lost"),
        1 => String::from("1 message lost on the link"),
        lost => format!("{lost} messages lost on the link"),
    };
    let mut next = Vec::new();
    let (mut verdict, mut found) = match session.outcome {
        Some(SessionOutcome::Good) => (Severity::Good, format!("{received}, {lost}")),
        Some(SessionOutcome::Loss) => {
            let problems = match session.problems.as_slice() {
                [] => String::new(),
                [only] => format!("; {}", only.text),
                [first, more @ ..] => format!("; {}, and {} more (below)", first.text, more.len()),
            };
            (Severity::Check, format!("{received}, {lost}{problems}"))
        }
        Some(SessionOutcome::Interrupted) => {
            next.push(String::from("record again if that is too short"));
            (
                Severity::Check,
                format!("interrupted: {received} until then, {lost}"),
            )
        }
        Some(SessionOutcome::Failed) => {
            next.push(format!(
                "`smartdepthsync verify {}` says what there is",
                shell_word(folder)
            ));
            let found = format!(
                "the session failed: {}; {received} until then",
                reason(session)
            );
            (Severity::Bad, found)
        }
        None => {
            next.push(format!(
                "`smartdepthsync extract {}` reads the rest",
                shell_word(folder)
            ));
            let found = "the program was killed before it could close the session";
            (Severity::Bad, found.to_owned())
        }
    };
    for (name, video) in videos(session) {
        let place = place_of(folder, session, name);
        let missing = missing_files(&place);
        if missing.is_empty() {
            continue;
        }
        verdict = verdict.max(Severity::Check);
        found += &format!(
            "; not in the folder yet: the {} of {name}",
            missing.join(", ")
        );
        next.push(format!(
            "`{}` copies them by USB",
            get_files_command(PhoneNanos(video), &place, true)
        ));
    }
    part(DATA, verdict, found, next)
}

/// Name of each phone that made a video, and the video's phase in ns.
fn videos(session: &SessionFile) -> impl Iterator<Item = (&str, i64)> {
    let phones = session.phones.iter();
    phones.filter_map(|phone| Some((phone.name.as_str(), phone.video?.phase.0)))
}

/// Returns the folder of a phone's files.
fn place_of(folder: &Path, session: &SessionFile, name: &str) -> PathBuf {
    let own = session.phone_folder(name);
    if own.as_os_str().is_empty() {
        folder.to_owned()
    } else {
        folder.join(own)
    }
}

/// Returns the files of a phone's video that are in the folder.
pub(super) fn phone_files(folder: &Path, session: &SessionFile, name: &str) -> Option<VideoFiles> {
    video_files::find(&place_of(folder, session, name), None)
        .ok()
        .flatten()
}

/// Returns the kinds of a phone's files that are missing in a folder.
fn missing_files(place: &Path) -> Vec<&'static str> {
    match video_files::find(place, None) {
        Ok(Some(files)) => files.missing(),
        Ok(None) | Err(video_files::FilesError::Io { .. }) => VideoFiles::default().missing(),
        // The user who put several videos there names the right one.
        Err(video_files::FilesError::Several { .. }) => Vec::new(),
    }
}

/// Returns the videos whose files are not all in the folder: the phase of each in ns, which is
/// part of the files' names on the phone, and the folder for them.
#[must_use]
pub fn files_to_fetch(folder: &Path, session: &SessionFile) -> Vec<(i64, PathBuf)> {
    videos(session)
        .map(|(name, phase)| (phase, place_of(folder, session, name)))
        .filter(|(_, place)| !missing_files(place).is_empty())
        .collect()
}

/// Judges the alignment of the two exposures.
fn alignment(session: &SessionFile) -> Finding {
    let Some(alignment) = session.alignment else {
        let found = String::from("the trigger was not aligned to the phone's frames");
        return part(
            ALIGNMENT,
            Severity::Bad,
            found,
            vec![String::from("record again")],
        );
    };
    // The summary begins with the largest.
    let start = micros_text(alignment.phase_sigma_us);
    let end = alignment.end_sigma_us.unwrap_or(alignment.phase_sigma_us);
    let mut found = format!(
        "± {start} at the start, ± {} at the end (1-sigma)",
        micros_text(end)
    );
    let mut next = Vec::new();
    let mut verdict = if alignment.is_sure() {
        Severity::Good
    } else {
        Severity::Check
    };
    for name in [CHECK_BIAS, CHECK_LEARNT] {
        let check = session.preflight.iter().find(|check| check.kind == name);
        match check {
            Some(check) if check.severity == Severity::Good => continue,
            Some(check) => {
                found += &format!("; {name}: {}", check.text);
                next.extend(check.next_step.clone());
            }
            None if is_in_profile(session, name) => continue,
            None => found += &format!("; {name}: not in the profile"),
        }
        verdict = Severity::Check;
    }
    part(ALIGNMENT, verdict, found, next)
}

/// Returns true if the profile has what the check of this name asks for.
fn is_in_profile(session: &SessionFile, name: &str) -> bool {
    let profile = &session.profile;
    match name {
        CHECK_BIAS => profile.is_constant_measured(profile.phone.exposure_us),
        _ => profile.phone.learnt.is_some(),
    }
}

/// Forms of depth recordings, in words.
const DEPTH_FILES: &str = ".mkv, or the folder of a ROS 2 bag with its metadata.yaml";

/// Judges the depth recording, and the proof that the pulses left the board.
fn depth(folder: &Path, session: &SessionFile) -> Finding {
    let recorder = session.profile.depth.recorder.command.first();
    let mut next = Vec::new();
    let (mut verdict, mut found) = match (depth_file(folder), recorder) {
        (Some((name, bytes)), _) => (
            Severity::Good,
            format!("{name}, {:.1} MB", bytes as f64 / 1e6),
        ),
        (None, Some(program)) => {
            next.push(String::from(
                "see its output in `depth_recorder.log` in the folder",
            ));
            let found = format!("`{program}` left no recording ({DEPTH_FILES}) in the folder");
            (Severity::Check, found)
        }
        (None, None) => {
            next.push(String::from(
                "put the recording that you made yourself into the folder, or set \
                 `[depth.recorder]` in the profile",
            ));
            let found = format!(
                "no recording ({DEPTH_FILES}) in the folder, and no recorder in the profile"
            );
            (Severity::Check, found)
        }
    };
    let mut problems = session.problems.iter();
    if let Some(problem) = problems.find(|problem| problem.kind == EventKind::DepthRecorderGone) {
        verdict = Severity::Check;
        found += &format!("; {}", problem.text);
    }
    let mut checks = session.preflight.iter();
    if let Some(check) = checks.find(|check| check.kind == CHECK_READBACK)
        && check.severity != Severity::Good
    {
        verdict = Severity::Check;
        found += &format!("; {CHECK_READBACK}: {}", check.text);
        next.extend(check.next_step.clone());
    }
    part("depth", verdict, found, next)
}

/// Returns name and size in bytes of the depth recording in a folder, the largest if there are
/// several.
fn depth_file(folder: &Path) -> Option<(String, u64)> {
    let recordings = depth_recordings(folder).ok()?.into_iter();
    let named = recordings.filter_map(|path| {
        let name = path.file_name()?.to_str()?.to_owned();
        let bytes = bytes_of(&path).ok()?;
        (bytes > 0).then_some((name, bytes))
    });
    named.max_by_key(|&(_, bytes)| bytes)
}

#[cfg(test)]
mod tests {
    use protocol::Ticks;

    use super::*;
    use recording::profile::Profile;
    use recording::session_file::Span;

    fn session() -> SessionFile {
        let profile = Profile::published().unwrap();
        let mut session = SessionFile::new(String::from("walk"), profile);
        session.outcome = Some(SessionOutcome::Good);
        session.recorded = Some(Span {
            from: Ticks(48_000_000),
            to: Ticks(48_000_000 * 11),
        });
        session
    }

    fn check(name: &str, severity: Severity) -> Finding {
        part(
            name,
            severity,
            String::from("as found"),
            vec![String::from("as advised")],
        )
    }

    #[test]
    fn nothing_recorded_is_never_good() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = session();
        for span in [
            None,
            session.recorded.map(|span| Span {
                to: span.from,
                ..span
            }),
        ] {
            session.recorded = span;
            for outcome in [
                SessionOutcome::Interrupted,
                SessionOutcome::Good,
                SessionOutcome::Failed,
            ] {
                session.outcome = Some(outcome);
                let judged = summary(folder.path(), &session, None);
                assert!(is_lossy(&session, None));
                assert_eq!(judged.severity, Severity::Bad, "{judged:?}");
                assert!(
                    judged.text.contains("before the recording began"),
                    "{judged:?}"
                );
            }
        }
    }

    #[test]
    fn depth_is_known_by_its_file_and_the_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = session();
        let verdict = |session: &SessionFile| depth(folder.path(), session);
        let without = verdict(&session);
        assert_eq!(without.severity, Severity::Check);
        assert!(without.next_step.unwrap().contains("[depth.recorder]"));
        let bag = folder.path().join("depth");
        std::fs::create_dir(&bag).unwrap();
        std::fs::write(bag.join("depth_0.mcap"), [0; 1000]).unwrap();
        assert_eq!(verdict(&session).severity, Severity::Check);
        std::fs::write(bag.join("metadata.yaml"), "").unwrap();
        assert_eq!(verdict(&session).severity, Severity::Good);
        std::fs::remove_dir_all(&bag).unwrap();
        std::fs::write(folder.path().join("depth.mkv"), [0; 1000]).unwrap();
        assert_eq!(verdict(&session).severity, Severity::Good);
        session
            .preflight
            .push(check(CHECK_READBACK, Severity::Check));
        let unproved = verdict(&session);
        assert_eq!(unproved.severity, Severity::Check);
        assert!(unproved.text.contains("trigger read-back: as found"));
        assert_eq!(unproved.next_step.as_deref(), Some("as advised"));
    }

    #[test]
    fn files_of_the_phone_are_asked_for_where_they_are_missing() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = session();
        session.phones[0].video = Some(recording::session_file::Video {
            phase: clock::PhoneNanos(42),
            frame_duration_ns: 33e6,
            exposure_ns: None,
            boot_minus_frames_ns: 0,
        });
        let judged = board_and_phone(folder.path(), &session);
        assert_eq!(judged.severity, Severity::Check);
        assert!(judged.next_step.unwrap().contains("--phase 42"));
        assert_eq!(files_to_fetch(folder.path(), &session).len(), 1);
        for name in ["V.mp4", "Vgyro.csv", "Vaccel.csv", "V_timestamps.csv"] {
            std::fs::write(folder.path().join(name), "1").unwrap();
        }
        assert_eq!(
            board_and_phone(folder.path(), &session).severity,
            Severity::Good
        );
        assert!(files_to_fetch(folder.path(), &session).is_empty());
    }
}
