//! What an extraction teaches about a rig: the phone's frame period and the rate
//! of its clock against the board's, from a whole recording.
//!
//! A straight line through thousands of frame timestamps knows the period far
//! better than the 59 intervals that the app reports, and minutes of motion know
//! the skew far better than a twist. Both go into the rig profile, for the next
//! recording to start from; the sigmas have the floor of what crystals do from one
//! day to another.

use std::path::{Path, PathBuf};

use super::image::write_whole;
use super::report::{ClockReport, Report};
use crate::outcome::{ExitStatus, Failure, file_step};
use crate::profile::{Learnt, ProfileError};
use crate::record::learn::{REPEATABILITY, into_profile as edited};

/// Windows of motion that a skew is learnt from: a minute of them.
const MIN_WINDOWS: usize = 6;

/// Why nothing was learnt.
#[derive(Debug, thiserror::Error)]
pub enum LearnError {
    /// There is no frame period.
    #[error(
        "nothing to learn: there are no frame timestamps of the phone, or no relation of its clock"
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

impl From<LearnError> for Failure {
    fn from(error: LearnError) -> Self {
        let status = match error {
            LearnError::Io { .. } => ExitStatus::Storage,
            LearnError::Profile(_) => ExitStatus::Usage,
            _ => ExitStatus::Refused,
        };
        let step = match &error {
            LearnError::NoFrames => {
                "extract the recording with the phone's files beside it, or name them with --phone"
            }
            LearnError::TooLittle { .. } => {
                "learn from a recording in which the rig was moved for a minute or more, with the \
                 phone's gyroscope file"
            }
            LearnError::Profile(_) => {
                "`smartdepthsync profile init rig.toml` writes a profile to start from"
            }
            LearnError::Io { error, .. } => file_step(error.kind()),
        };
        Self::new(status, error.to_string()).next_step(step)
    }
}

/// What a clock relation teaches.
fn learnt(
    clock: Option<&ClockReport>,
    board_id: Option<&str>,
    date: jiff::civil::Date,
) -> Result<Learnt, LearnError> {
    let clock = clock.ok_or(LearnError::NoFrames)?;
    let (period, sigma) = clock.frame_period_ns.ok_or(LearnError::NoFrames)?;
    if clock.source != "gyroscopes" || clock.used < MIN_WINDOWS {
        return Err(LearnError::TooLittle {
            used: clock.used,
            source_of_it: clock.source,
        });
    }
    Ok(Learnt {
        frame_period_ns: period,
        frame_period_sigma_ns: sigma.hypot(REPEATABILITY * period),
        skew: Some(clock.skew_ppm * 1e-6),
        skew_sigma: Some((clock.skew_sigma_ppm * 1e-6).hypot(REPEATABILITY)),
        learnt: date,
        board_id: board_id.map(str::to_owned),
    })
}

/// Writes what a report teaches into a rig profile; comments and order stay.
/// Returns what was learnt in words.
///
/// # Errors
///
/// There is too little to learn from, or the profile cannot be read or written.
pub fn into_profile(report: &Report, path: &Path) -> Result<String, LearnError> {
    let io = |error| LearnError::Io {
        path: path.to_owned(),
        error,
    };
    let mut text = std::fs::read_to_string(path).map_err(io)?;
    let others = report.phones.iter();
    let phones = std::iter::once((report.reference.as_deref(), report.clock.as_ref()))
        .chain(others.map(|other| (Some(other.name.as_str()), other.clock.as_ref())));
    let mut lines = Vec::new();
    for (name, clock) in phones {
        let learnt = learnt(clock, report.board.id.as_deref(), jiff::Zoned::now().date())?;
        text = edited(&text, path, name, &learnt)?;
        lines.push(format!(
            "learnt into {}{}: frame period {:.3} ns ± {:.3}, skew {:+.4} ppm ± {:.4}",
            path.display(),
            match name {
                Some(name) if !report.phones.is_empty() => format!(", {name}"),
                _ => String::new(),
            },
            learnt.frame_period_ns,
            learnt.frame_period_sigma_ns,
            learnt.skew.unwrap_or(0.0) * 1e6,
            learnt.skew_sigma.unwrap_or(0.0) * 1e6
        ));
    }
    write_whole(path, text.as_bytes()).map_err(io)?;
    Ok(lines.join("\n"))
}
