//! Figures of the book that are made from simulated runs.

use std::env;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use anyhow::{Context, Result, bail};

use crate::{firmware, process, tools};

/// What the plots are drawn with, beyond the packages of the tests.
const PLOTTING: &str = "matplotlib==3.11.2";

/// Makes the book's figures anew, into `docs/figures`.
pub(crate) fn make() -> Result<()> {
    let elf = firmware::build_rig()?;
    let python = tools::ensure_python()?;
    process::run(process::command(&python).args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        PLOTTING,
    ]))?;
    let figures = process::root().join("docs/figures");
    fs::create_dir_all(&figures).with_context(|| format!("cannot make {}", figures.display()))?;
    imu_twist(&elf, &python, &figures.join("imu-twist.svg"))
}

/// A hand twist on the simulated rig, recorded by the host tool.
fn imu_twist(elf: &Path, python: &Path, figure: &Path) -> Result<()> {
    let csv = process::target_dir().join("imu-twist.csv");
    let rig = Rig::start(elf, &["--motion", "rest:3.5,twist:8,rest"])?;
    process::run(
        process::command(program("smartdepthsync"))
            .args(["imu", "--port", &rig.port, "--seconds", "12", "--csv"])
            .arg(&csv),
    )?;
    drop(rig);
    process::run(
        process::command(python)
            .arg(process::root().join("xtask/figures/imu_twist.py"))
            .arg(&csv)
            .arg(figure),
    )?;
    println!("{}", figure.display());
    Ok(())
}

/// A program that cargo has built in the release profile.
fn program(name: &str) -> PathBuf {
    process::target_dir()
        .join("release")
        .join(format!("{name}{}", env::consts::EXE_SUFFIX))
}

/// A running `hil-sim serve`, which ends with this value.
struct Rig {
    child: Child,
    port: String,
}

impl Rig {
    fn start(elf: &Path, arguments: &[&str]) -> Result<Self> {
        let mut child = process::command(program("hil-sim"))
            .arg("serve")
            .args(arguments)
            .args(["--wait-for-host", "--quiet", "--speed", "4"])
            .env(process::ELF_VARIABLE, elf)
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start hil-sim serve")?;
        let mut line = String::new();
        if let Some(output) = child.stdout.take() {
            BufReader::new(output).read_line(&mut line)?;
        }
        let mut rig = Self {
            child,
            port: String::new(),
        };
        match line.trim().strip_prefix("port: ") {
            Some(port) => port.clone_into(&mut rig.port),
            None => bail!("hil-sim serve says {line:?} instead of its port"),
        }
        Ok(rig)
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
