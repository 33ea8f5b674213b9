//! Options that several commands have.

use board::Board;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use recording::profile::Profile;

use crate::outcome::Failure;
use crate::rig_profile::ProfileArg;

/// The option of every command that talks to the board.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct PortArg {
    /// Serial port of the board [default: the profile's `port`, or the only board that is found]
    #[arg(long, value_name = "PATH", global = true, hide_short_help = true)]
    pub(crate) port: Option<String>,
}

impl PortArg {
    /// The port that is given, else the profile's.
    pub(crate) fn path(&self, profile: Option<&Profile>) -> Option<String> {
        self.port.clone().or_else(|| profile?.port.clone())
    }

    /// Opens the board of a rig.
    ///
    /// # Errors
    ///
    /// No such port, no permission, busy, not this board, another version, no
    /// answer.
    pub(crate) fn open_of(&self, profile: Option<&Profile>) -> Result<Board, Failure> {
        Board::open(self.path(profile).as_deref()).map_err(Failure::from)
    }

    /// Opens the board of the rig whose profile is in its usual place, if there is one.
    ///
    /// # Errors
    ///
    /// As [`PortArg::open_of`]; or no port is given, and that profile cannot be used.
    pub(crate) fn open(&self) -> Result<Board, Failure> {
        let profile = match self.port {
            Some(_) => None,
            None => Some(ProfileArg::default().load()?.0),
        };
        self.open_of(profile.as_ref())
    }
}

/// For clap: the value of one of these words.
pub(crate) fn one_of<T>(words: &'static [(&'static str, T)]) -> impl TypedValueParser<Value = T>
where
    T: Copy + Send + Sync + 'static,
{
    PossibleValuesParser::new(words.iter().map(|(word, _)| *word)).try_map(|given| {
        let known = words.iter().find(|(word, _)| *word == given);
        known.map(|(_, value)| *value).ok_or("no such word")
    })
}
