//! Errors of a profile, with file and line.

use std::path::{Path, PathBuf};

/// Reason why a profile cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ProfileError {
    /// The file cannot be read.
    #[error("cannot read the rig profile {path}: {reason}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Message of the operating system.
        reason: String,
    },
    /// The text is not a profile.
    #[error("the rig profile{} is not valid: {reason}", in_file(.path.as_deref()))]
    Syntax {
        /// The file, if the text came from one.
        path: Option<PathBuf>,
        /// Line, key, and expected content.
        reason: String,
    },
    /// A value is out of its range.
    #[error("in the rig profile{}, `{key}` is {found}, expected {expected}", place(.path.as_deref(), *.line))]
    Value {
        /// The file, if the text came from one.
        path: Option<PathBuf>,
        /// Line of the value, from 1, if the text has the value.
        line: Option<usize>,
        /// Key with its tables, for example `phone.rows`.
        key: String,
        /// The value.
        found: String,
        /// Accepted values.
        expected: String,
    },
}

fn place(path: Option<&Path>, line: Option<usize>) -> String {
    let line = line.map_or(String::new(), |line| format!(", line {line}"));
    in_file(path) + &line
}

/// Most characters of a line of the text, or of a value, that an error shows.
const MAX_SHOWN: usize = 200;

pub(super) fn syntax(path: Option<&Path>, reason: &str) -> ProfileError {
    let lines: Vec<String> = reason.lines().map(shortened).collect();
    ProfileError::Syntax {
        path: path.map(Path::to_owned),
        reason: lines.join("\n"),
    }
}

/// Cuts a text that is too long to be read.
pub(super) fn shortened(text: &str) -> String {
    match text.char_indices().nth(MAX_SHOWN) {
        Some((end, _)) => format!("{} ...", text.get(..end).unwrap_or_default()),
        None => text.to_owned(),
    }
}

/// Returns the error of a text that is TOML but not a profile. The defaults are filled in by then,
/// so the line is found by the wrong key.
pub(super) fn in_line(text: &str, path: Option<&Path>, error: &toml::de::Error) -> ProfileError {
    let message = error.to_string();
    let reason = message.trim_end();
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
    syntax(path, &format!("{line}{}", reason.replace('\n', " ")))
}

/// Adds file and line to an error.
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

/// Returns the first line, from 1, that sets a key: its last name in the table of the names before
/// it, in any table if there are none.
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
