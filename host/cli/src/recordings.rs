//! The recording that a command is about: the one that is given, else the newest.

use std::path::{Path, PathBuf};

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use crate::rig_profile::Place;
use clock::PhoneNanos;
use phone::adb::get_files_command;
use recording::bag::mcap_in;
use recording::session_file::SessionFile;
use recording::{MCAP_FILE, RecordingError, SESSION_FILE};
use report::session::files_to_fetch;

/// The folder that recordings are made in unless another is given.
pub(crate) const FOLDER: &str = "recordings";

/// The option of every command that reads a recording.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RecordingArg {
    /// Folder of the recording, or its recording.mcap [default: the newest in `recordings`]
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
        Ok(folder_of(given).to_owned())
    }
}

/// Refuses an existing path that is not a recording of any form. The reader reports a path that is
/// missing or damaged.
fn check(path: &Path) -> Result<(), Failure> {
    let path = folder_of(path);
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
    let folder = system::folder_of(recording);
    let is_inside = recording.is_file() && folder.join(MCAP_FILE).is_file();
    if is_inside { folder } else { recording }
}

/// Returns the commands to type next about a recording, ready to be pasted: those that get what is
/// missing of the phones, and the one that makes a data set of it.
pub(crate) fn next_commands(recording: &Path, session: Option<&SessionFile>) -> Vec<String> {
    if session.is_some_and(|session| !session.has_recorded()) {
        return vec![String::from("smartdepthsync record")];
    }
    let mut commands = files_commands(recording, session);
    let shown = system::shell_word(recording);
    commands.push(format!("smartdepthsync extract {shown}"));
    commands
}

/// Returns the command that measures the constant bias from the strobes of recordings, and writes it
/// into the profile if there is one.
pub(crate) fn calibrate_command<P: AsRef<Path>>(recordings: &[P], profile: &Place) -> String {
    let mut command = String::from("smartdepthsync evaluate precision");
    for recording in recordings {
        command += &format!(" {}", system::shell_word(recording.as_ref()));
    }
    if let Some(profile) = &profile.path {
        command += &format!(" --calibrate {}", system::shell_word(profile));
    }
    command
}

/// Returns the commands that copy the files of the phones that are missing in a recording.
pub(crate) fn files_commands(folder: &Path, session: Option<&SessionFile>) -> Vec<String> {
    let missing = session.map_or_else(Vec::new, |session| files_to_fetch(folder, session));
    let copy = |(phase, place): &(i64, PathBuf)| get_files_command(PhoneNanos(*phase), place, true);
    missing.iter().map(copy).collect()
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
