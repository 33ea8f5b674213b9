//! The Python packages `twist-sync` and `smartdepthsync-data`: both are built; the first is also
//! installed into the Python environment and tested. The tests of the second need recordings and
//! are among those of `hil-sim`.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, bail};

use crate::{process, tools};

/// Number of twists per scenario on which the package must agree with the crate.
const TRIALS: &str = "2";

/// Builds the wheel of `twist-sync` into a folder.
pub(crate) fn maturin(python: &Path, folder: &Path) -> Command {
    let mut maturin = process::command(python);
    maturin
        .args("-m maturin build --release --quiet --out".split(' '))
        .arg(folder)
        .args(["--manifest-path", "host/sync/twist-sync-python/Cargo.toml"]);
    maturin
}

/// Builds the wheel of `smartdepthsync-data` into a folder, as it would be published.
pub(crate) fn data_package(python: &Path, folder: &Path) -> Command {
    let mut pip = process::command(python);
    pip.args("-m pip wheel --quiet --no-deps --wheel-dir".split(' '))
        .arg(folder)
        .arg("host/data/smartdepthsync-data");
    pip
}

fn only_file(folder: &Path) -> Result<PathBuf> {
    match std::fs::read_dir(folder)?.next() {
        Some(entry) => Ok(entry?.path()),
        None => bail!("there is no wheel in {}", folder.display()),
    }
}

/// Builds the wheel of `smartdepthsync-data`.
fn data(python: &Path) -> Result<()> {
    let folder = process::fresh_folder("data-wheel")?;
    process::run(&mut data_package(python, &folder))?;
    let wheel = only_file(&folder)?;
    // Its manifest cannot take the version from the workspace.
    let version = concat!("-", env!("CARGO_PKG_VERSION"), "-");
    if !wheel.to_string_lossy().contains(version) {
        bail!(
            "{} is not of the workspace's version: change host/data/smartdepthsync-data/pyproject.toml",
            wheel.display()
        );
    }
    println!("wheel: {}", wheel.display());
    Ok(())
}

/// Builds the wheel and installs it into the Python environment, whose program is returned.
pub(crate) fn installed() -> Result<PathBuf> {
    let python = tools::ensure_python()?;
    let folder = process::fresh_folder("wheels")?;
    let mut maturin = maturin(&python, &folder);
    maturin.args(["--features", "built-for-workspace"]);
    process::run(maturin.env("VIRTUAL_ENV", process::target_dir().join("venv")))?;
    let wheel = only_file(&folder)?;
    tools::pip_install(&python, &["--no-deps", "--force-reinstall"], &wheel)?;
    println!("wheel: {}", wheel.display());
    Ok(python)
}

/// `cargo xtask wheel`.
pub(crate) fn build_and_test() -> Result<()> {
    let python = installed()?;
    data(&python)?;
    let twists = process::target_dir().join("wheel-twists");
    // With the features of the whole workspace, as the tests have it.
    process::cargo("build --release --workspace --quiet --example sync_bench".split(' '))?;
    process::run(
        process::command(process::program("examples/sync_bench"))
            .args(["--trials", TRIALS, "--export"])
            .arg(&twists),
    )?;
    process::run(
        process::command(&python)
            .args("-m unittest discover -s host/sync/twist-sync-python/tests".split(' '))
            .env("SYNC_BENCH", &twists)
            .env("WHEELS", process::target_dir().join("wheels")),
    )
}
