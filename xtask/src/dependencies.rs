//! What the workspace may depend on: licences, sources, and where `unsafe` stands.
//!
//! The first two are judged from cargo's own tree, which needs no tool and no
//! network; `deny.toml` says the same for `cargo deny`, which is run as well where
//! it is installed.

use std::fs;

use anyhow::{Result, bail};

use crate::process;

/// Licences that fit MIT OR Apache-2.0, as in `deny.toml`.
const LICENCES: &[&str] = &[
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "bzip2-1.0.6",
    "MIT",
    "MPL-2.0",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// Fails on a dependency with another licence or from another place than the
/// registry, and on `unsafe` outside of the modules that argue for theirs.
pub(crate) fn check() -> Result<()> {
    let tree = process::text(
        process::command(process::cargo_program())
            .args(["tree", "--workspace", "--locked", "--prefix", "none"])
            .args(["-e", "normal,build", "-f", "{p}|{l}"]),
    )?;
    let mut wrong = Vec::new();
    let mut count = 0;
    let mut lines: Vec<&str> = tree.lines().collect();
    lines.sort_unstable();
    lines.dedup();
    for line in lines {
        let Some((package, licence)) = line.split_once('|') else {
            continue;
        };
        let licence = licence.trim_end_matches(" (*)");
        let own = package.contains(&process::root().display().to_string());
        count += 1;
        if !own && package.contains('(') && !package.contains("(proc-macro)") {
            wrong.push(format!("{package} is not from the registry"));
        }
        if !own && !is_allowed(licence) {
            wrong.push(format!("{package} has the licence {licence:?}"));
        }
    }
    unsafe_code(&mut wrong)?;
    if !wrong.is_empty() {
        bail!("dependencies and unsafe code:\n  {}", wrong.join("\n  "));
    }
    println!(
        "{count} dependencies: licences and sources are right; unsafe code stands where it may"
    );
    if process::answers("cargo-deny", &["--version"]) {
        process::cargo(["deny", "check", "licenses", "bans", "sources"])?;
    }
    Ok(())
}

/// Whether an SPDX expression can be met with the licences above.
fn is_allowed(expression: &str) -> bool {
    // Old manifests write a slash for OR.
    let expression = expression.replace(" / ", " OR ").replace('/', " OR ");
    expression.split(" AND ").all(|part| {
        part.trim_matches(['(', ')', ' '])
            .split(" OR ")
            .any(|licence| LICENCES.contains(&licence.trim_matches(['(', ')', ' '])))
    })
}

/// Every file with an `unsafe` block must allow it by name and argue each block.
fn unsafe_code(wrong: &mut Vec<String>) -> Result<()> {
    let mut files = Vec::new();
    for folder in ["host", "protocol", "firmware", "hil-sim", "xtask"] {
        files.append(&mut process::files_below(&process::root().join(folder))?);
    }
    for path in files {
        if path.extension().is_none_or(|ending| ending != "rs")
            || path.ends_with("xtask/src/dependencies.rs")
        {
            continue;
        }
        let text = fs::read_to_string(&path)?;
        for (number, line) in text.lines().enumerate() {
            let code = line.split("//").next().unwrap_or_default();
            if !code.contains("unsafe {") && !code.contains("unsafe impl") {
                continue;
            }
            let before = text.lines().take(number + 1).collect::<Vec<_>>();
            let argued = before
                .iter()
                .rev()
                .take(12)
                .any(|line| line.contains("SAFETY:"));
            if !argued {
                wrong.push(format!(
                    "{}:{}: an unsafe block without `SAFETY:` above it",
                    path.display(),
                    number + 1
                ));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expressions_are_met_or_not() {
        for good in [
            "MIT",
            "MIT OR Apache-2.0",
            "MIT/Apache-2.0",
            "MIT OR GPL-3.0-only",
            "(MIT OR Apache-2.0) AND Unicode-3.0",
        ] {
            assert!(is_allowed(good), "{good}");
        }
        for bad in ["", "GPL-3.0-only", "MIT AND GPL-2.0-or-later", "AGPL-3.0"] {
            assert!(!is_allowed(bad), "{bad}");
        }
    }
}
