//! The objects of `--json` against the book: every field that is printed is described
//! in `docs/json.md`, and every field that is described there is printed.
//!
//! A section `` ## `command` `` holds a table; its first column names fields: `a.b` in
//! an object, `a[].b` in the objects of a list, `a.*.b` under any name, `a.…` for all
//! that is below and described elsewhere. A meaning that begins with "only" belongs to a
//! field that may be left out.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::root;

/// A described field.
struct Field {
    path: Vec<String>,
    /// With all below it.
    open: bool,
    may_miss: bool,
}

/// The fields of a command.
fn described(command: &str) -> Vec<Field> {
    let page = std::fs::read_to_string(root().join("docs/json.md")).unwrap();
    let name = format!("`{command}`");
    let section = page
        .split("\n## ")
        .find(|section| section.lines().next().unwrap().contains(&name))
        .unwrap_or_else(|| panic!("docs/json.md has no section of {name}"));
    let mut fields = Vec::new();
    for row in section.lines().filter(|line| line.starts_with("| `")) {
        let mut cells = row.trim_matches('|').split(" | ");
        let (names, meaning) = (cells.next().unwrap(), cells.next().unwrap());
        for name in names.split('`').skip(1).step_by(2) {
            let open = name.ends_with('…');
            fields.push(Field {
                path: split(name.trim_end_matches('…').trim_end_matches('.')),
                open,
                may_miss: meaning.trim().starts_with("only"),
            });
        }
    }
    assert!(!fields.is_empty(), "no fields of {name} in docs/json.md");
    fields
}

fn split(path: &str) -> Vec<String> {
    path.split('.').map(str::to_owned).collect()
}

/// The leaves of an object: path, and whether there is nothing in it.
fn leaves(value: &Value, path: &str, found: &mut BTreeMap<String, bool>) {
    let below = |name: &str| match path {
        "" => name.to_owned(),
        _ => format!("{path}.{name}"),
    };
    match value {
        Value::Object(map) if !map.is_empty() => {
            for (name, value) in map {
                leaves(value, &below(name), found);
            }
        }
        Value::Array(list) if list.iter().any(Value::is_object) => {
            for value in list {
                leaves(value, &format!("{path}[]"), found);
            }
        }
        other => {
            let empty = match other {
                Value::Null => true,
                Value::Array(list) => list.is_empty(),
                Value::Object(map) => map.is_empty(),
                _ => false,
            };
            let entry = found.entry(path.to_owned()).or_insert(true);
            *entry &= empty;
        }
    }
}

/// Whether a path is another, or above it if `above` is wanted.
fn fits(described: &[String], path: &[String], prefix_only: bool) -> bool {
    let same = |a: &String, b: &String| {
        a == "*" || a == b || (prefix_only && a.trim_end_matches("[]") == b)
    };
    let length = described.len() == path.len() || (prefix_only && described.len() > path.len());
    length && described.iter().zip(path).all(|(a, b)| same(a, b))
}

/// Compares what a command printed, in one or more runs, with its description.
pub fn check(command: &str, printed: &[&Value]) {
    let fields = described(command);
    let mut found = BTreeMap::new();
    for value in printed {
        assert!(value.is_object(), "{command} prints no object: {value}");
        leaves(value, "", &mut found);
    }
    let mut wrong = Vec::new();
    for (path, empty) in &found {
        let parts = split(path);
        let known = fields.iter().any(|field| {
            fits(&field.path, &parts, false)
                || (*empty && fits(&field.path, &parts, true))
                || (field.open && {
                    let count = field.path.len().min(parts.len());
                    fits(&field.path, &parts[..count], false)
                        || fits(&field.path, &split(&path.replace("[]", ""))[..count], false)
                })
        });
        if !known {
            wrong.push(format!("printed, not described: {path}"));
        }
    }
    for field in fields.iter().filter(|field| !field.open && !field.may_miss) {
        let seen = found.iter().any(|(path, empty)| {
            let parts = split(path);
            fits(&field.path, &parts, false) || (*empty && fits(&field.path, &parts, true))
        });
        if !seen {
            wrong.push(format!("described, not printed: {}", field.path.join(".")));
        }
    }
    assert!(
        wrong.is_empty(),
        "`{command} --json` and docs/json.md differ:\n{}",
        wrong.join("\n")
    );
}
