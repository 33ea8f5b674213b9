//! What an extraction teaches about a rig: the phone's frame period and the rate
//! of its clock against the board's, from a whole recording.
//!
//! A straight line through thousands of frame timestamps knows the period far
//! better than the 59 intervals that the app reports, and minutes of motion know
//! the skew far better than a twist. Both go into the rig profile, for the next
//! recording to start from; the sigmas have the floor of what crystals do from one
//! day to another.

use std::path::{Path, PathBuf};

use super::report::{ClockReport, ExtractReport};
use jiff::Timestamp;
use recording::profile::{Learnt, ProfileError};
use recording::session_file::SessionFile;
use session::learn::{Frames, Origin, into_profile as edited, learnt as taught};

/// Windows of motion that a skew is learnt from: a minute of them.
const MIN_WINDOWS: usize = 6;

/// Why nothing was learnt.
#[derive(Debug, thiserror::Error)]
pub enum LearnError {
    /// There is no frame period.
    #[error(
        "nothing to learn: there is no relation of the phone's clock, or its frame timestamps have no \
         period (expected 300 or more of them, at regular distances)"
    )]
    NoFrames,
    /// The relation is not from the whole recording.
    #[error(
        "the clock relation is not good enough to learn from: expected one from the gyroscopes with at \
         least {MIN_WINDOWS} windows, found {used} (from {source_of_it})"
    )]
    TooLittle {
        /// Windows that were used.
        used: usize,
        /// Where the relation came from.
        source_of_it: &'static str,
    },
    /// The profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// The profile cannot be read or written.
    #[error("the profile {path}: {error}")]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
}

/// What a clock relation teaches; `exposure_us` is that of the phone's frames.
fn learnt(
    clock: Option<&ClockReport>,
    exposure_us: Option<f64>,
    origin: &Origin<'_>,
) -> Result<Learnt, LearnError> {
    let clock = clock.ok_or(LearnError::NoFrames)?;
    if clock.source != "gyroscopes" || clock.used < MIN_WINDOWS {
        return Err(LearnError::TooLittle {
            used: clock.used,
            source_of_it: clock.source,
        });
    }
    let (period_ns, sigma_ns) = clock.frame_period_ns.ok_or(LearnError::NoFrames)?;
    let frames = Frames {
        period_ns,
        sigma_ns,
        jitter_ns: clock.frame_jitter_ns,
        exposure_us,
    };
    let skew = (clock.skew_ppm * 1e-6, clock.skew_sigma_ppm * 1e-6);
    Ok(taught(&frames, Some(skew), origin))
}

/// Writes what a report teaches into a rig profile; comments and order stay.
/// Returns what was learnt in words, and of which phones nothing could be. `session` is
/// that of the recording: without it, the recording is taken for today's.
///
/// # Errors
///
/// There is too little to learn from of any phone, or the profile cannot be read or
/// written.
pub fn into_profile(
    report: &ExtractReport,
    path: &Path,
    session: Option<&SessionFile>,
) -> Result<String, LearnError> {
    let io = |error| LearnError::Io {
        path: path.to_owned(),
        error,
    };
    let mut text = files::read_text(path, recording::profile::MAX_LENGTH).map_err(io)?;
    let others = report.phones.iter();
    let phones = std::iter::once((report.reference.as_deref(), report.clock.as_ref()))
        .chain(others.map(|other| (Some(other.name.as_str()), other.clock.as_ref())));
    let origin = Origin {
        board_id: report.board.id.as_deref(),
        time: session
            .and_then(SessionFile::began)
            .unwrap_or_else(Timestamp::now),
        board_temperature_c: None,
    };
    let mut lines = Vec::new();
    let mut failures = Vec::new();
    for (name, clock) in phones {
        let shown = name.filter(|_| !report.phones.is_empty());
        let whose = shown.map_or(String::new(), |name| format!(", {name}"));
        let exposure_us = session.and_then(|session| {
            session.exposure_us_of(name.unwrap_or(&session.profile.phone.name))
        });
        let learnt = match learnt(clock, exposure_us, &origin) {
            Ok(learnt) => learnt,
            Err(error) => {
                failures.push((whose, error));
                continue;
            }
        };
        text = edited(&text, path, name, &learnt)?;
        lines.push(format!(
            "learnt into {}{whose}: frame period {:.3} ns ± {:.3}, skew {:+.4} ppm ± {:.4}",
            path.display(),
            learnt.frame_period_ns,
            learnt.frame_period_sigma_ns,
            learnt.skew.unwrap_or(0.0) * 1e6,
            learnt.skew_sigma.unwrap_or(0.0) * 1e6
        ));
    }
    if lines.is_empty() && !failures.is_empty() {
        return Err(failures.remove(0).1);
    }
    for (whose, error) in failures {
        lines.push(format!("nothing learnt{whose}: {error}"));
    }
    files::replace(path, text.as_bytes()).map_err(io)?;
    Ok(lines.join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::Format;
    use crate::report::{BoardReport, Constants, OtherReport};
    use recording::profile::Profile;
    use recording::session_file::Video;

    fn clock(used: usize) -> ClockReport {
        ClockReport {
            source: "gyroscopes",
            windows: used,
            used,
            contradicting: 0,
            offset_s: 36_000.0,
            skew_ppm: 20.0,
            skew_sigma_ppm: 0.01,
            sigma_us: Some([1.0, 2.0]),
            residual_us: Some(1.0),
            frame_period_ns: Some((33_330_650.0, 0.02)),
            frame_jitter_ns: Some(900.0),
            course: Vec::new(),
            tracked: None,
        }
    }

    fn report(first: Option<ClockReport>, other: Option<ClockReport>) -> ExtractReport {
        ExtractReport {
            version: 1,
            recording: String::from("walk"),
            format: Format::Tum,
            board: BoardReport::default(),
            reference: Some(String::from("left")),
            phone: None,
            clock: first,
            depth: None,
            pairs: None,
            grid: None,
            later_grids: Vec::new(),
            phones: vec![OtherReport {
                name: String::from("right"),
                phone: None,
                clock: other,
                pairs: None,
                grid: None,
                later_grids: Vec::new(),
                constants: Constants::default(),
            }],
            sensors: Vec::new(),
            sequences: Vec::new(),
            constants: Constants::default(),
            losses: Vec::new(),
            remarks: Vec::new(),
        }
    }

    #[test]
    fn a_phone_that_teaches_nothing_does_not_keep_the_others_from_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rig.toml");
        let before = "[phone]\nname = \"left\"\n\n[[phones]]\nname = \"right\"\naddress = \"x\"\n";
        let mut session =
            SessionFile::new(String::from("walk"), Profile::parse(before, None).unwrap());
        session.started = String::from("2026-01-31T12:00:00Z");
        session.video = Some(Video {
            phase: timebase::PhoneNanos(0),
            frame_duration_ns: 33e6,
            exposure_ns: Some(2_500_000),
        });
        let of = |report: &ExtractReport| {
            std::fs::write(&path, before).unwrap();
            let said = into_profile(report, &path, Some(&session));
            let text = std::fs::read_to_string(&path).unwrap();
            (said, Profile::parse(&text, None).unwrap())
        };

        let (said, profile) = of(&report(Some(clock(60)), None));
        let said = said.unwrap();
        assert!(
            said.contains(", left: frame period 33330650.000 ns"),
            "{said}"
        );
        assert!(said.contains("nothing learnt, right:"), "{said}");
        let learnt = profile.phone.learnt.unwrap();
        assert_eq!(learnt.frame_jitter_ns, Some(900.0));
        assert_eq!(learnt.exposure_us, Some(2_500.0));
        assert_eq!(learnt.time, session.began());
        assert_eq!(profile.phones[0].learnt, None);

        let (said, profile) = of(&report(Some(clock(2)), Some(clock(60))));
        assert!(said.unwrap().contains("nothing learnt, left:"));
        assert_eq!(profile.phone.learnt, None);
        assert!(profile.phones[0].learnt.is_some());

        let (said, profile) = of(&report(Some(clock(2)), None));
        assert!(matches!(said, Err(LearnError::TooLittle { used: 2, .. })));
        assert_eq!(profile, Profile::parse(before, None).unwrap());
    }
}
