//! The clock estimate: measured on simulated twists, beside the published Python package.

use anyhow::Result;

use crate::process::{self, sync_example as example};
use crate::wheel;

/// Trials that the Python package is given: it is measured, not studied.
const MOST_FILES: u32 = 100;

/// `cargo xtask bench sync`: all scenarios, twists over an hour, then the package
/// beside ours.
pub(crate) fn run(trials: u32) -> Result<()> {
    let trials_text = trials.to_string();
    example(&["--trials", &trials_text])?;
    example(&["--hour", "--trials", &trials_text])?;
    let python = wheel::installed()?;
    let files = trials.min(MOST_FILES).to_string();
    for (scenario, label) in [
        ("base", "Base scenario"),
        ("faulty stream b", "Faulty stream b"),
    ] {
        let folder = process::target_dir()
            .join("sync-bench")
            .join(scenario.replace(' ', "-"));
        let folder_text = folder.display().to_string();
        println!("\n{label} (no skew: the package has none):");
        example(&[
            "--trials",
            &files,
            "--scenario",
            scenario,
            "--no-skew",
            "--export",
            &folder_text,
        ])?;
        process::run(
            process::command(&python)
                .arg("xtask/sync_bench.py")
                .arg(&folder),
        )?;
    }
    Ok(())
}
