//! Which rig profile a command uses: the one that is given, else `./rig.toml`, else the
//! published rig's.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::outcome::{ExitStatus, Failure};
use recording::profile::{Profile, ProfileError};

/// Name of a profile where none is given.
pub(crate) const FILE: &str = "rig.toml";

/// The option of every command that takes a rig profile.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct ProfileArg {
    /// Rig profile [default: ./rig.toml]
    #[arg(long, value_name = "FILE", hide_short_help = true)]
    pub(crate) profile: Option<PathBuf>,
}

/// The profile that a command uses.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Place {
    /// The file; none for the published rig's, which is a part of the program.
    pub(crate) path: Option<PathBuf>,
}

impl ProfileArg {
    /// Where the profile is.
    pub(crate) fn place(&self) -> Place {
        let here = || Path::new(FILE).is_file().then(|| PathBuf::from(FILE));
        Place {
            path: self.profile.clone().or_else(here),
        }
    }

    /// The profile, and where it is.
    ///
    /// # Errors
    ///
    /// The file cannot be read or is not a profile.
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
    /// The option that names it again, with a blank before; nothing where it is found by itself.
    pub(crate) fn option(&self) -> String {
        match &self.path {
            Some(path) if path.as_os_str() != FILE => {
                format!(" --profile {}", system::shell_word(path))
            }
            _ => String::new(),
        }
    }

    /// The file, for what can only be written into one.
    ///
    /// # Errors
    ///
    /// There is no profile.
    pub(crate) fn file(&self) -> Result<&Path, Failure> {
        self.path.as_deref().ok_or_else(|| {
            Failure::new(ExitStatus::Usage, "there is no rig profile to write into")
                .next_step("make one: `smartdepthsync setup`, or give one with --profile")
        })
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.path {
            Some(path) => path.display().fmt(f),
            None => f.write_str("the published rig's, as none was found"),
        }
    }
}
