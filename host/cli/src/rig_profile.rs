//! Which rig profile a command uses: the one that is given, else the first that is there
//! of `./rig.toml`, the environment's and the user's own, else the published rig's.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::outcome::{ExitStatus, Failure};
use recording::profile::{Profile, ProfileError};

/// Name of a profile where none is given.
pub(crate) const FILE: &str = "rig.toml";

/// The environment's variable that names a profile.
pub(crate) const VARIABLE: &str = "SMARTDEPTHSYNC_PROFILE";

/// The option of every command that takes a rig profile.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct ProfileArg {
    /// The rig profile, if not ./rig.toml, else that of $SMARTDEPTHSYNC_PROFILE, else
    /// smartdepthsync/rig.toml in the user's configuration folder
    #[arg(long, value_name = "FILE", hide_short_help = true)]
    pub(crate) profile: Option<PathBuf>,
}

/// Where a profile comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Source {
    /// Given with `--profile`.
    Option,
    /// `./rig.toml`.
    ThisFolder,
    /// Named by the environment.
    Environment,
    /// In the user's configuration folder.
    User,
    /// The published rig's, a part of the program.
    #[default]
    Published,
}

/// The profile that a command uses.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Place {
    /// The file; none for the published rig's.
    pub(crate) path: Option<PathBuf>,
    /// Why it is this one.
    pub(crate) source: Source,
}

impl ProfileArg {
    /// Where the profile is.
    pub(crate) fn place(&self) -> Place {
        if let Some(path) = &self.profile {
            return Place::at(path.clone(), Source::Option);
        }
        let of_environment = std::env::var_os(VARIABLE).filter(|path| !path.is_empty());
        first_of(
            Path::new(FILE),
            of_environment.map(PathBuf::from),
            user_file(),
        )
    }

    /// The profile, and where it is.
    ///
    /// # Errors
    ///
    /// It cannot be read, or is none.
    pub(crate) fn load(&self) -> Result<(Profile, Place), ProfileError> {
        let place = self.place();
        let profile = match &place.path {
            Some(path) => Profile::load(path),
            None => Profile::published(),
        }?;
        Ok((profile, place))
    }
}

impl Place {
    const fn at(path: PathBuf, source: Source) -> Self {
        Self {
            path: Some(path),
            source,
        }
    }

    /// The option that names it again, with a blank before; nothing where it is found by itself.
    pub(crate) fn option(&self) -> String {
        match &self.path {
            Some(path) if self.source == Source::Option && path.as_os_str() != FILE => {
                format!(" --profile {}", files::shell_word(path))
            }
            _ => String::new(),
        }
    }

    /// The file, for what can only be written into one.
    ///
    /// # Errors
    ///
    /// There is none.
    pub(crate) fn file(&self) -> Result<&Path, Failure> {
        self.path.as_deref().ok_or_else(|| {
            Failure::new(ExitStatus::Usage, "there is no rig profile to write into")
                .next_step("make one: `smartdepthsync setup`, or give one with --profile")
        })
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = self.path.as_deref().unwrap_or(Path::new("")).display();
        match self.source {
            Source::Option => write!(f, "{path}, as given"),
            Source::ThisFolder => write!(f, "{path} of this folder"),
            Source::Environment => write!(f, "{path}, from {VARIABLE}"),
            Source::User => write!(f, "{path}, the user's own"),
            Source::Published => f.write_str("the published rig's, as none was found"),
        }
    }
}

/// The first that is there; what the environment names counts as there, so that a wrong
/// name is told.
fn first_of(here: &Path, of_environment: Option<PathBuf>, user: Option<PathBuf>) -> Place {
    if here.is_file() {
        return Place::at(here.to_owned(), Source::ThisFolder);
    }
    if let Some(path) = of_environment {
        return Place::at(path, Source::Environment);
    }
    match user.filter(|path| path.is_file()) {
        Some(path) => Place::at(path, Source::User),
        None => Place::default(),
    }
}

/// The user's own profile, whether it is there or not (XDG base directories).
fn user_file() -> Option<PathBuf> {
    let folder = |name: &str| {
        let value = std::env::var_os(name).map(PathBuf::from);
        value.filter(|path| path.is_absolute())
    };
    let config = folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")))?;
    Some(config.join("smartdepthsync").join(FILE))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_profile_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        let [here, named, user] = ["here", "named", "user"].map(|name| folder.path().join(name));
        let found = || first_of(&here, Some(named.clone()), Some(user.clone())).source;
        let without = || first_of(&here, None, Some(user.clone())).source;
        assert_eq!(without(), Source::Published);
        std::fs::write(&user, "").unwrap();
        assert_eq!(without(), Source::User);
        // A wrong name in the environment is an error later, not a reason to go on.
        assert_eq!(found(), Source::Environment);
        std::fs::write(&here, "").unwrap();
        assert_eq!(found(), Source::ThisFolder);
        assert_eq!(without(), Source::ThisFolder);
    }
}
