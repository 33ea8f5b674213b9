//! A profile as the text that its user wrote, to put something into it.

use std::path::Path;

use toml_edit::{DocumentMut, Item, Table, TomlError};

use super::error::syntax;
use super::{Profile, ProfileError};

/// A profile, and its text to be written into: comments and order stay.
///
/// # Errors
///
/// The text is no valid profile.
pub fn open(text: &str, path: &Path) -> Result<(Profile, DocumentMut), ProfileError> {
    let profile = Profile::parse(text, Some(path))?;
    let document = text
        .parse()
        .map_err(|error: TomlError| syntax(Some(path), error.to_string()))?;
    Ok((profile, document))
}

/// The table of the phone of this name; without one, it is `[phone]`.
///
/// # Errors
///
/// It is no table.
pub fn phone_table<'a>(
    document: &'a mut DocumentMut,
    profile: &Profile,
    name: Option<&str>,
    path: &Path,
) -> Result<&'a mut Table, ProfileError> {
    // One phone is meant whatever it was called at the time.
    let name = name.filter(|_| !profile.phones.is_empty());
    let is_it = |table: &Table| table.get("name").and_then(|name| name.as_str()) == name;
    let place = document
        .get("phones")
        .and_then(|phones| phones.as_array_of_tables())
        .filter(|_| name.is_some())
        .and_then(|phones| phones.iter().position(is_it));
    match place {
        Some(place) => document
            .get_mut("phones")
            .and_then(|phones| phones.as_array_of_tables_mut())
            .and_then(|phones| phones.get_mut(place))
            .ok_or_else(|| syntax(Some(path), String::from("`phones` is no list of tables"))),
        None => table(document, "phone", path),
    }
}

/// Sets a key of a table; the comments before and after its old value stay.
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

/// The table of this name, which is added if it is missing.
///
/// # Errors
///
/// It is no table.
pub fn table<'a>(
    document: &'a mut DocumentMut,
    name: &str,
    path: &Path,
) -> Result<&'a mut Table, ProfileError> {
    document
        .entry(name)
        .or_insert(toml_edit::table())
        .as_table_mut()
        .ok_or_else(|| syntax(Some(path), format!("`{name}` is no table")))
}
