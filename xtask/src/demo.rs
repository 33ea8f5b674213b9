//! The demo: the firmware's ELF on the simulated board, and the host tool that
//! talks to it through a pseudo-terminal as it would to a real one.

use std::env;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Stdio};

use anyhow::{Context, Result, bail};

use crate::process;

/// Seconds of board time for which status messages are shown.
const WATCH_SECONDS: &str = "10";

/// The simulated board, ended with the demo however that ends.
struct Board(Child);

impl Drop for Board {
    fn drop(&mut self) {
        // It may have ended by itself; then there is nothing left to do.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Boots the board, says hello, shows its status for ten seconds of board time.
pub(crate) fn run(elf: &Path) -> Result<()> {
    let bin = process::target_dir().join("release");
    let program = |name: &str| bin.join(format!("{name}{}", env::consts::EXE_SUFFIX));
    let mut child = process::command(program("hil-sim"))
        .arg("serve")
        .arg("--elf")
        .arg(elf)
        .stdout(Stdio::piped())
        .spawn()
        .context("cannot start the simulator")?;
    let output = child.stdout.take();
    let board = Board(child);
    let output = output.context("the simulator has no output")?;
    let mut line = String::new();
    BufReader::new(output)
        .read_line(&mut line)
        .context("cannot read from the simulator")?;
    let Some(port) = line.trim().strip_prefix("port: ") else {
        bail!("the simulator did not name its port; it said {line:?}");
    };
    println!("the simulated board is at {port}");
    process::run(process::command(program("smartdepthsync")).args([
        "info",
        "--port",
        port,
        "--watch",
        WATCH_SECONDS,
    ]))?;
    drop(board);
    Ok(())
}
