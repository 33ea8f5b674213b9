//! All tests, of which those that fail beside the others are run once more by themselves.
//!
//! Simulated boards keep pace with the computer's clock. Where the computer is busy with
//! something else for seconds, a test that waits for one may fail without a fault of the
//! program; a fault of the program fails in both runs.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::Stdio;

use anyhow::{Context, Result, bail};

use crate::process;

/// More failures than this are not a busy computer's.
const MOST_REPEATED: usize = 3;

/// Runs all tests of the workspace; fails if one fails, and again by itself.
pub(crate) fn all(elf: &Path) -> Result<()> {
    const ALL: [&str; 4] = ["test", "--release", "--workspace", "--no-fail-fast"];
    let mut cargo = process::cargo_with_elf(&ALL, elf);
    let mut child = cargo
        .stdout(Stdio::piped())
        .spawn()
        .context("cannot start cargo")?;
    let (mut failed, mut unended) = (Vec::new(), 0);
    for line in BufReader::new(child.stdout.take().context("no output of cargo")?).lines() {
        let line = line.context("cannot read what cargo says")?;
        println!("{line}");
        failed.extend(failed_test(&line).map(str::to_owned));
        // A program that dies has no result.
        unended += i32::from(line.starts_with("running "));
        unended -= i32::from(line.starts_with("test result: "));
    }
    let status = child.wait().context("cannot wait for cargo")?;
    if status.success() {
        return Ok(());
    }
    if unended != 0 || failed.is_empty() || failed.len() > MOST_REPEATED {
        bail!("{status} from {cargo:?}; {} tests failed", failed.len());
    }
    let names = failed.join(", ");
    println!("\nfailed beside the others, now by themselves: {names}");
    let mut args = ALL.to_vec();
    args.extend(["--", "--exact", "--test-threads=1"]);
    args.extend(failed.iter().map(String::as_str));
    process::run(&mut process::cargo_with_elf(&args, elf))?;
    println!("\nfailed beside the others, and passed by themselves: {names}");
    Ok(())
}

/// The name of a test of which a line of libtest's says that it failed.
fn failed_test(line: &str) -> Option<&str> {
    line.strip_prefix("test ")?.strip_suffix(" ... FAILED")
}
