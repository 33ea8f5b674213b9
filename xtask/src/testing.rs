//! All tests, of which those that fail beside the others are run once more by themselves.
//!
//! Simulated boards keep pace with the computer's clock. Where the computer is busy with
//! something else for seconds, a test that waits for one may fail without a fault of the
//! program; a fault of the program fails in both runs.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};

use anyhow::{Context, Result, bail};

use crate::process;

/// More failures than this are not a busy computer's.
const MOST_REPEATED: usize = 3;

/// What the test programs of a run said.
struct Ran {
    cargo: Command,
    status: ExitStatus,
    passed: Vec<String>,
    failed: Vec<String>,
    /// How many failed by the programs' results: another program's output may tear a line.
    counted: usize,
    /// How many programs have no result: they died.
    died: i32,
}

/// Runs all tests of the workspace; fails if one fails, and again by itself.
pub(crate) fn all(elf: &Path) -> Result<()> {
    const ALL: [&str; 4] = ["test", "--release", "--workspace", "--no-fail-fast"];
    let ran = run(&ALL, elf)?;
    if ran.status.success() {
        return Ok(());
    }
    let failed = &ran.failed;
    let are_named = ran.counted == failed.len();
    if ran.died != 0 || !are_named || failed.is_empty() || failed.len() > MOST_REPEATED {
        bail!(
            "{} from {:?}; {} tests failed",
            ran.status,
            ran.cargo,
            ran.counted
        );
    }
    let names = failed.join(", ");
    println!("\nfailed beside the others, now by themselves: {names}");
    let mut args = ALL.to_vec();
    args.extend(["--", "--exact", "--test-threads=1"]);
    args.extend(failed.iter().map(String::as_str));
    let again = run(&args, elf)?;
    // A test that was not found again has not passed.
    if !again.status.success() || failed.iter().any(|name| !again.passed.contains(name)) {
        bail!(
            "not all passed by themselves: {} from {:?}",
            again.status,
            again.cargo
        );
    }
    println!("\nfailed beside the others, and passed by themselves: {names}");
    Ok(())
}

/// Runs cargo, and listens to what it lets be seen.
fn run(args: &[&str], elf: &Path) -> Result<Ran> {
    let mut cargo = process::cargo_with_elf(args, elf);
    let mut child = cargo
        .stdout(Stdio::piped())
        .spawn()
        .context("cannot start cargo")?;
    let output = child.stdout.take().context("no output of cargo")?;
    let (mut passed, mut failed) = (Vec::new(), Vec::new());
    let (mut counted, mut died) = (0, 0);
    for line in BufReader::new(output).lines() {
        let line = line.context("cannot read what cargo says")?;
        println!("{line}");
        let name = |verdict| {
            Some(
                line.strip_prefix("test ")?
                    .strip_suffix(verdict)?
                    .to_owned(),
            )
        };
        passed.extend(name(" ... ok"));
        failed.extend(name(" ... FAILED"));
        died += i32::from(line.starts_with("running "));
        died -= i32::from(line.starts_with("test result: "));
        counted += failures(&line).unwrap_or(0);
    }
    let status = child.wait().context("cannot wait for cargo")?;
    Ok(Ran {
        cargo,
        status,
        passed,
        failed,
        counted,
        died,
    })
}

/// How many tests of a program failed, by the line with its result.
fn failures(line: &str) -> Option<usize> {
    let counts = line.strip_prefix("test result: FAILED. ")?;
    let (_, from_failed) = counts.split_once(" passed; ")?;
    from_failed.split_once(" failed")?.0.parse().ok()
}
