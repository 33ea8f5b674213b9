//! The recording that a command is about: the one that is given, else the newest.

use std::path::{Path, PathBuf};

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use recording::bag::mcap_in;
use recording::session_file::SessionFile;
use recording::{MCAP_FILE, RecordingError, SESSION_FILE};

/// The folder that recordings are made in unless another is given.
pub(crate) const FOLDER: &str = "recordings";

/// The option of every command that reads a recording.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RecordingArg {
    /// The recording: its folder, or its recording.mcap; else the newest in `recordings`
    #[arg(value_name = "RECORDING")]
    recording: Option<PathBuf>,
}

impl RecordingArg {
    /// The recording; says which if it was not given.
    ///
    /// # Errors
    ///
    /// There is no recording, or the given path is not one.
    pub(crate) fn find(&self, context: &Context) -> Result<PathBuf, Failure> {
        let Some(given) = &self.recording else {
            let newest = newest(Path::new(FOLDER))?;
            context.say(format!("the newest recording: {}", newest.display()));
            return Ok(newest);
        };
        check(given)?;
        Ok(given.clone())
    }
}

/// Refuses an existing path that is not a recording of any form. The reader reports a path that is
/// missing or damaged.
fn check(path: &Path) -> Result<(), Failure> {
    if !path.exists() || path.join(SESSION_FILE).exists() {
        return Ok(());
    }
    let file = mcap_in(path)?;
    if file == path && path.extension().is_none_or(|ending| ending != "mcap") {
        return Err(RecordingError::NoRecording { path: file }.into());
    }
    Ok(())
}

/// The folder of a recording; a file in it stands for it.
pub(crate) fn folder_of(recording: &Path) -> &Path {
    match recording.file_name() {
        Some(name) if name == MCAP_FILE => system::folder_of(recording),
        _ => recording,
    }
}

/// The recordings in a folder, the one that was written to last first.
fn inside(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let mut found: Vec<_> = entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            let written = path.join(MCAP_FILE).metadata().ok()?.modified().ok()?;
            Some((written, path))
        })
        .collect();
    found.sort();
    found.into_iter().rev().map(|(_, path)| path).collect()
}

/// The newest that has ended; one that is being made, or was cut off, must be named.
fn newest(folder: &Path) -> Result<PathBuf, Failure> {
    let has_ended = |recording: &PathBuf| {
        SessionFile::load(recording).map_or(true, |session| session.outcome.is_some())
    };
    inside(folder).into_iter().find(has_ended).ok_or_else(|| {
        let message = format!("which recording? There is none in `{}`", folder.display());
        Failure::new(ExitStatus::Usage, message)
            .next_step("give the folder that `record` made, or make one: `smartdepthsync record`")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_is_the_one_written_last() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path();
        assert_eq!(newest(place).unwrap_err().status(), ExitStatus::Usage);
        for (name, hours) in [("b", 2), ("a", 3), ("c", 1)] {
            std::fs::create_dir(place.join(name)).unwrap();
            let file = std::fs::File::create(place.join(name).join(MCAP_FILE)).unwrap();
            let time = std::time::SystemTime::UNIX_EPOCH;
            let hours = std::time::Duration::from_secs(3600 * hours);
            file.set_modified(time + hours).unwrap();
        }
        std::fs::create_dir(place.join("c-euroc")).unwrap();
        assert_eq!(newest(place).unwrap(), place.join("a"));
        assert!(check(&place.join("b")).is_ok());
        let other = place.join("rig.toml");
        std::fs::write(&other, "").unwrap();
        let other = check(&other).unwrap_err();
        assert_eq!(other.status(), ExitStatus::Usage);
        // Damaged, or not there: reported by those who read it.
        std::fs::write(place.join("x.mcap"), "").unwrap();
        assert!(check(&place.join("x.mcap")).is_ok());
        assert!(check(&place.join("nothing")).is_ok());
    }
}
