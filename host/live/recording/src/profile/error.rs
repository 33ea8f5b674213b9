//! Why a profile cannot be used, with the file and the line.

use std::path::{Path, PathBuf};

/// Why a profile cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ProfileError {
    /// The file cannot be read.
    #[error("cannot read the rig profile {path}: {reason}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// It is no profile.
    #[error("the rig profile{} is not valid: {reason}", in_file(.path.as_deref()))]
    Syntax {
        /// The file, if it came from one.
        path: Option<PathBuf>,
        /// Line, key, and what was expected.
        reason: String,
    },
    /// A value is out of its range.
    #[error("in the rig profile{}, `{key}` is {found}, expected {expected}", place(.path.as_deref(), *.line))]
    Value {
        /// The file, if it came from one.
        path: Option<PathBuf>,
        /// Its line, counted from 1, if the value is written there.
        line: Option<usize>,
        /// The key with its tables.
        key: String,
        /// The value.
        found: String,
        /// What is accepted.
        expected: String,
    },
}

fn place(path: Option<&Path>, line: Option<usize>) -> String {
    let line = line.map_or(String::new(), |line| format!(", line {line}"));
    in_file(path) + &line
}

pub(super) fn syntax(path: Option<&Path>, reason: String) -> ProfileError {
    ProfileError::Syntax {
        path: path.map(Path::to_owned),
        reason,
    }
}

/// A text that has the form of TOML but not that of a profile. What was left out has been
/// filled in by then, so the line is looked for by the key that is wrong.
pub(super) fn in_line(text: &str, path: Option<&Path>, error: &toml::de::Error) -> ProfileError {
    let said = error.to_string();
    let reason = said.trim_end();
    // "unknown field `rosw`, expected ...", or "... in `phone.rows`".
    let named = |start: &str| Some(reason.split_once(start)?.1.split_once('`')?.0);
    let key = match (named("in `"), named("unknown field `")) {
        (Some(table), Some(name)) if table.rsplit('.').next() != Some(name) => {
            Some(format!("{table}.{name}"))
        }
        (table, name) => table.or(name).map(str::to_owned),
    };
    let line = key.and_then(|key| line_of(text, &key));
    let line = line.map_or(String::new(), |line| format!("line {line}: "));
    // The parser puts the table on a line of its own.
    syntax(path, format!("{line}{}", reason.replace('\n', " ")))
}

/// An error with the file and the line that it is in.
pub(super) fn located(mut error: ProfileError, text: &str, file: Option<&Path>) -> ProfileError {
    if let ProfileError::Value {
        path, line, key, ..
    } = &mut error
    {
        *path = file.map(Path::to_owned);
        *line = line_of(text, key);
    }
    error
}

/// The first line, counted from 1, that sets a key: its last name in the table that the
/// names before it make, in any table if there are none.
fn line_of(text: &str, key: &str) -> Option<usize> {
    let (table, name) = key.rsplit_once('.').unwrap_or(("", key));
    let mut inside = String::new();
    text.lines()
        .position(|line| {
            let line = line.trim();
            if let Some(header) = line.strip_prefix('[') {
                let names = header.trim_start_matches('[').split(']').next();
                inside = names.unwrap_or_default().trim().to_owned();
                return inside == key || inside.ends_with(&format!(".{key}"));
            }
            let set = line.split_once('=').map(|(name, _)| name.trim());
            (table.is_empty() || table == inside) && set == Some(name)
        })
        .map(|index| index + 1)
}

fn in_file(path: Option<&Path>) -> String {
    path.map_or(String::new(), |path| format!(" {}", path.display()))
}
