//! The Python package `twist-sync`: built, installed into the Python environment, tested.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};

use crate::{process, tools};

/// Twists of each scenario whose results must be those of the crate.
const TRIALS: &str = "2";

/// Builds the wheel and gives its path.
fn build(python: &Path) -> Result<PathBuf> {
    let folder = process::fresh_folder("wheels")?;
    process::run(
        process::command(python)
            .args("-m maturin build --release --quiet --out".split(' '))
            .arg(&folder)
            .args(["--manifest-path", "host/twist-sync-python/Cargo.toml"])
            .env("VIRTUAL_ENV", process::target_dir().join("venv")),
    )?;
    let entry = std::fs::read_dir(&folder)?.next();
    match entry {
        Some(entry) => Ok(entry?.path()),
        None => bail!("maturin has left no wheel in {}", folder.display()),
    }
}

/// Builds the wheel and installs it into the Python environment, which has all that it needs.
pub(crate) fn installed() -> Result<PathBuf> {
    let python = tools::ensure_python()?;
    let wheel = build(&python)?;
    tools::pip_install(&python, &["--no-deps", "--force-reinstall"], &wheel)?;
    println!("wheel: {}", wheel.display());
    Ok(python)
}

/// `cargo xtask wheel`.
pub(crate) fn build_and_test() -> Result<()> {
    let python = installed()?;
    let twists = process::target_dir().join("wheel-twists");
    let twists_text = twists.display().to_string();
    process::sync_example(&["--export", &twists_text, "--trials", TRIALS])?;
    process::run(
        process::command(&python)
            .args("-m unittest discover -s host/twist-sync-python/tests".split(' '))
            .env("SYNC_BENCH", &twists),
    )
}
