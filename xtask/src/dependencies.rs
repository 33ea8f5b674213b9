//! Licences and sources of all dependencies, checked against `deny.toml` with `cargo tree`, which
//! needs neither another tool nor the network. `cargo deny` reads the same file.

use std::collections::BTreeSet;

use anyhow::{Context, Result, bail};

use crate::process;

/// Fails if a dependency has a licence that `deny.toml` does not list, or does not come from the
/// registry.
pub(crate) fn check() -> Result<()> {
    let allowed = allowed()?;
    let licences: BTreeSet<&str> = allowed.split('"').skip(1).step_by(2).collect();
    let tree = process::text(
        process::command(process::cargo_program())
            .args(["tree", "--workspace", "--locked", "--prefix", "none"])
            .args(["-e", "normal,build", "-f", "{p}|{l}"]),
    )?;
    let root = process::root().display().to_string();
    let mut wrong = Vec::new();
    let others: BTreeSet<&str> = tree.lines().filter(|line| !line.contains(&root)).collect();
    for (package, licence) in others.iter().filter_map(|line| line.split_once('|')) {
        let licence = licence.trim_end_matches(" (*)");
        if package.contains('(') && !package.contains("(proc-macro)") {
            wrong.push(format!("{package} is not from the registry"));
        }
        if !is_allowed(licence, &licences) {
            wrong.push(format!("{package} has the licence {licence:?}"));
        }
    }
    if !wrong.is_empty() {
        bail!("dependencies:\n  {}", wrong.join("\n  "));
    }
    println!("the licences and sources of all dependencies are allowed");
    Ok(())
}

/// Returns the licences that `deny.toml` allows, quoted and separated by commas.
pub(crate) fn allowed() -> Result<String> {
    let deny = process::read(&process::root().join("deny.toml"))?;
    let allowed = deny
        .split_once("allow = [")
        .and_then(|(_, list)| list.split_once(']'));
    let (allowed, _) = allowed.context("deny.toml allows no licences")?;
    Ok(allowed.to_owned())
}

/// Returns true if these licences satisfy an SPDX expression.
fn is_allowed(expression: &str, licences: &BTreeSet<&str>) -> bool {
    // Old manifests separate alternatives by a slash.
    let expression = expression.replace(" / ", " OR ").replace('/', " OR ");
    expression.split(" AND ").all(|part| {
        part.trim_matches(['(', ')', ' '])
            .split(" OR ")
            .any(|licence| licences.contains(licence.trim_matches(['(', ')', ' '])))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expressions_are_met_or_not() {
        let licences = BTreeSet::from(["MIT", "Apache-2.0", "Unicode-3.0"]);
        for good in [
            "MIT",
            "MIT OR Apache-2.0",
            "MIT/Apache-2.0",
            "MIT OR GPL-3.0-only",
            "(MIT OR Apache-2.0) AND Unicode-3.0",
        ] {
            assert!(is_allowed(good, &licences), "{good}");
        }
        for bad in ["", "GPL-3.0-only", "MIT AND GPL-2.0-or-later", "AGPL-3.0"] {
            assert!(!is_allowed(bad, &licences), "{bad}");
        }
    }
}
