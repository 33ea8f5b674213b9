//! Rules of the source tree that no compiler knows: the imports between rooms, the size of a room,
//! and the first words of doc comments.
//!
//! The first two are read from the table of rooms in `docs/architecture.md`, so that the page
//! agrees with the manifests.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::{Result, bail};

use crate::process;

const PAGE: &str = "docs/architecture.md";

/// Words with which no doc comment begins: a clause follows them instead of the operation.
const CLAUSES: [&str; 3] = ["What", "How", "Whether"];

/// Largest excess of a stated size over the measured one, as a share of the former.
const LARGEST_MARGIN: f64 = 0.05;

/// Fails if an import, a size or a comment breaks a rule, and lists all that do.
pub(crate) fn check() -> Result<()> {
    let root = process::root();
    let page = process::read(&root.join(PAGE))?;
    let imports = imports(&root)?;
    let sources = sources(&root)?;
    let mut wrong = wrong_imports(&page, &imports);
    wrong.extend(wrong_sizes(&page, &sources));
    wrong.extend(wrong_comments(&sources));
    if !wrong.is_empty() {
        bail!("broken rules of the source tree:\n  {}", wrong.join("\n  "));
    }
    println!("imports, sizes and doc comments follow the rules of the tree");
    Ok(())
}

/// Returns the folder of each crate of the workspace with the folders of the crates that it
/// imports. Imports of tests alone do not count.
fn imports(root: &Path) -> Result<BTreeMap<String, BTreeSet<String>>> {
    let args = "tree --workspace --all-features --target all --edges normal,build --depth 1 \
                --prefix depth --no-dedupe --format {p}";
    let mut cargo = process::command(process::cargo_program());
    let tree = process::text(cargo.args(args.split_whitespace()))?;
    let below_root = format!("({}/", root.display());
    let mut imports = BTreeMap::<_, BTreeSet<_>>::new();
    let mut own = "";
    // Crates of the registry have no folder.
    for line in tree.lines() {
        let Some((_, folder)) = line.split_once(&below_root) else {
            continue;
        };
        let folder = folder.split(')').next().unwrap_or_default();
        if line.starts_with('0') {
            own = folder;
            imports.entry(own.to_owned()).or_default();
        } else if let Some(imported) = imports.get_mut(own) {
            imported.insert(folder.to_owned());
        }
    }
    Ok(imports)
}

/// Returns the Rust files of the workspace by their paths from the root.
fn sources(root: &Path) -> Result<BTreeMap<String, String>> {
    let mut sources = BTreeMap::new();
    for room in ["firmware", "hil-sim", "host", "protocol", "xtask"] {
        for file in process::files_below(&root.join(room), ".rs")? {
            let name = file.strip_prefix(root)?.display().to_string();
            sources.insert(name, process::read(&file)?);
        }
    }
    Ok(sources)
}

/// Row of the table of rooms.
struct Room<'a> {
    folder: &'a str,
    /// Other rooms that its crates import.
    imports: BTreeSet<&'a str>,
    /// Largest number of lines of code.
    size: &'a str,
}

/// Returns the rows that begin with a folder and have four cells.
fn rooms(page: &str) -> Vec<Room<'_>> {
    let row = |line| {
        let cells: Vec<&str> = str::split(line, '|').map(str::trim).collect();
        let ["", folder, _, imports, size, ""] = cells[..] else {
            return None;
        };
        Some(Room {
            folder: folder.strip_prefix('`')?.strip_suffix('`')?,
            imports: imports.split('`').skip(1).step_by(2).collect(),
            size,
        })
    };
    page.lines().filter_map(row).collect()
}

/// Returns the innermost room that contains a path.
fn room_of<'a>(path: &str, rooms: &[Room<'a>]) -> &'a str {
    let holds = |folder: &str| {
        let rest = path.strip_prefix(folder);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    };
    let folders = rooms.iter().map(|room| room.folder);
    let inside = folders.filter(|folder| holds(folder));
    inside.max_by_key(|folder| folder.len()).unwrap_or_default()
}

/// Compares the imports in the table with those in the manifests.
fn wrong_imports(page: &str, crates: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let mut wrong = Vec::new();
    let rooms = rooms(page);
    for room in &rooms {
        let (own, stated) = (room.folder, &room.imports);
        let inside = crates
            .iter()
            .filter(|(path, _)| room_of(path, &rooms) == own);
        let imported = inside
            .flat_map(|(_, imported)| imported)
            .map(|path| room_of(path, &rooms));
        let found: BTreeSet<&str> = imported.filter(|other| *other != own).collect();
        let more = found.difference(stated);
        wrong.extend(
            more.map(|other| format!("{own} imports {other}, which {PAGE} does not allow")),
        );
        let less = stated.difference(&found);
        wrong.extend(
            less.map(|other| format!("{own} does not import {other}, although {PAGE} says so")),
        );
    }
    let homeless = crates
        .keys()
        .filter(|path| room_of(path, &rooms).is_empty());
    wrong.extend(homeless.map(|path| format!("{PAGE} has no room for the crate {path}")));
    wrong
}

/// Counts the lines of code, without blank lines, comments, tests and examples.
fn lines_of_code(path: &str, text: &str) -> usize {
    if path.contains("/tests/") || path.ends_with("tests.rs") || path.contains("/examples/") {
        return 0;
    }
    (text.lines().map(str::trim_start))
        .take_while(|line| !line.starts_with("#[cfg(test)]"))
        .filter(|line| !line.is_empty() && !line.starts_with("//"))
        .count()
}

fn wrong_sizes(page: &str, sources: &BTreeMap<String, String>) -> Vec<String> {
    let mut wrong = Vec::new();
    let rooms = rooms(page);
    for Room { folder, size, .. } in &rooms {
        let Ok(most) = size.replace(',', "").parse::<usize>() else {
            wrong.push(format!(
                "{PAGE}: {folder} has the size {size:?}, expected a number"
            ));
            continue;
        };
        let inside = sources
            .iter()
            .filter(|(path, _)| room_of(path, &rooms) == *folder);
        let lines: usize = inside.map(|(path, text)| lines_of_code(path, text)).sum();
        let least = (most as f64 * (1.0 - LARGEST_MARGIN)) as usize;
        if !(least..=most).contains(&lines) {
            wrong.push(format!(
                "{folder} has {lines} lines of code, {PAGE} says at most {most}"
            ));
        }
    }
    wrong
}

fn wrong_comments(sources: &BTreeMap<String, String>) -> Vec<String> {
    let mut wrong = Vec::new();
    for (path, text) in sources {
        for (number, line) in text.lines().map(str::trim_start).enumerate() {
            let comment = line
                .strip_prefix("/// ")
                .or_else(|| line.strip_prefix("//! "));
            let word = comment.and_then(|text| text.split_whitespace().next());
            if let Some(word) = word.filter(|word| CLAUSES.contains(word)) {
                wrong.push(format!(
                    "{path}:{}: a doc comment begins with {word:?}",
                    number + 1
                ));
            }
        }
    }
    wrong
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLES: &str = "\
        | room | purpose | imports | lines |\n\
        | `low` | numbers | – | 2 |\n\
        | `low/x` | more of them | `low` | 0 |\n\
        | `high` | uses them | `low` | 1,000 |\n";

    fn crates(imports_of_a: &[&str]) -> BTreeMap<String, BTreeSet<String>> {
        let of = |path: &str, list: &[&str]| {
            let imports = list.iter().map(|&path| path.to_owned()).collect();
            (path.to_owned(), imports)
        };
        BTreeMap::from([
            of("low/a", imports_of_a),
            of("low/x/c", &["low/a"]),
            of("high/b", &["low/a"]),
        ])
    }

    #[test]
    fn this_tree_keeps_its_rules() {
        check().unwrap();
    }

    #[test]
    fn an_arrow_against_the_table_is_found() {
        assert_eq!(wrong_imports(TABLES, &crates(&[])), [""; 0]);
        let wrong = wrong_imports(TABLES, &crates(&["high/b", "low/x/c"]));
        assert_eq!(wrong.len(), 2, "{wrong:?}");
        assert!(wrong[0].starts_with("low imports high,"), "{wrong:?}");
        assert!(wrong[1].starts_with("low imports low/x,"), "{wrong:?}");
        let wrong = wrong_imports(&TABLES.replace("`high`", "`higher`"), &crates(&[]));
        let last = wrong.last().unwrap();
        assert!(last.contains("no room for the crate high/b"), "{wrong:?}");
    }

    #[test]
    fn a_room_is_measured_without_comments_and_tests() {
        let text = "//! a\n\nfn a() {}\n    // b\nfn b() {}\n#[cfg(test)]\nmod tests {}\n";
        assert_eq!(lines_of_code("low/a/src/lib.rs", text), 2);
        assert_eq!(lines_of_code("low/a/tests/it.rs", text), 0);
        let sources =
            |text: &str| BTreeMap::from([("low/a/src/lib.rs".to_owned(), text.to_owned())]);
        let wrong = wrong_sizes(TABLES, &sources(text));
        assert_eq!(
            wrong,
            ["high has 0 lines of code, docs/architecture.md says at most 1000"]
        );
        let wrong = wrong_sizes(TABLES, &sources("a\nb\nc\n"));
        assert!(wrong[0].starts_with("low has 3 lines"), "{wrong:?}");
    }

    #[test]
    fn a_comment_that_begins_with_a_clause_is_found() {
        let sources = |text: &str| BTreeMap::from([("a.rs".to_owned(), text.to_owned())]);
        for (text, count) in [
            ("/// Returns the time: what follows is a line of it.", 0),
            ("    /// Whether it runs.", 1),
            ("//! A module.\n//!\n//! How it works.", 1),
            ("// What a plain comment says.", 0),
        ] {
            assert_eq!(wrong_comments(&sources(text)).len(), count, "{text}");
        }
    }
}
