//! Changes the text of a profile and keeps its comments and order.

use std::path::Path;

use toml_edit::{DocumentMut, Item, Table, TomlError};

use super::error::syntax;
use super::{Profile, ProfileError};

/// Parses a profile, and its text as a document that keeps comments and order.
///
/// # Errors
///
/// Returns an error if the text is not a valid profile.
pub fn open(text: &str, path: &Path) -> Result<(Profile, DocumentMut), ProfileError> {
    let profile = Profile::parse(text, Some(path))?;
    let document = text
        .parse()
        .map_err(|error: TomlError| syntax(Some(path), &error.to_string()))?;
    Ok((profile, document))
}

/// Returns the table of the phone with this name; without a name, `[phone]`.
///
/// # Errors
///
/// Returns an error if it is not a table.
pub fn phone_table<'a>(
    document: &'a mut DocumentMut,
    profile: &Profile,
    name: Option<&str>,
    path: &Path,
) -> Result<&'a mut Table, ProfileError> {
    // A single phone is meant whatever its name was at the time.
    let name = name.filter(|_| !profile.phones.is_empty());
    let has_name = |table: &Table| table.get("name").and_then(|name| name.as_str()) == name;
    let place = document
        .get("phones")
        .and_then(|phones| phones.as_array_of_tables())
        .filter(|_| name.is_some())
        .and_then(|phones| phones.iter().position(has_name));
    match place {
        Some(place) => document
            .get_mut("phones")
            .and_then(|phones| phones.as_array_of_tables_mut())
            .and_then(|phones| phones.get_mut(place))
            .ok_or_else(|| syntax(Some(path), "`phones` is not a list of tables")),
        None => table(document, "phone", path),
    }
}

/// Sets a key of a table; the comments around its old value stay.
pub fn set(table: &mut Table, key: &str, mut new: Item) {
    let Some(old) = table.get_mut(key) else {
        table.insert(key, new);
        return;
    };
    if let (Some(old), Some(value)) = (old.as_value(), new.as_value_mut()) {
        *value.decor_mut() = old.decor().clone();
    }
    *old = new;
}

/// Returns the table with this name, which is added if it is missing.
///
/// # Errors
///
/// Returns an error if it is not a table.
pub fn table<'a>(
    document: &'a mut DocumentMut,
    name: &str,
    path: &Path,
) -> Result<&'a mut Table, ProfileError> {
    document
        .entry(name)
        .or_insert(toml_edit::table())
        .as_table_mut()
        .ok_or_else(|| syntax(Some(path), &format!("`{name}` is not a table")))
}
