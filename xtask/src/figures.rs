//! Figures of the book and of the README that are made from simulated runs.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use crate::{firmware, process, tools};

/// Size of the terminal of the live view.
const TERMINAL: (&str, &str) = ("80", "24");

/// How long the live view may take to show a recording.
const PATIENCE: Duration = Duration::from_secs(120);

/// Makes the figures again, into `docs/figures`.
pub(crate) fn make() -> Result<()> {
    tools::ensure_program("ffmpeg", "ffmpeg")?;
    tools::ensure_program("tmux", "tmux")?;
    tools::ensure_program("chromium", "chromium")?;
    let elf = firmware::build_rig()?;
    let python = tools::ensure_python()?;
    let figures = process::root().join("docs/figures");
    fs::create_dir_all(&figures).with_context(|| format!("cannot make {}", figures.display()))?;
    let place = process::fresh_folder("figures-demo")?;
    process::hil_sim(
        &["demo".as_ref(), "--out".as_ref(), place.as_os_str()],
        &elf,
    )?;
    alignment(&place, &python, &figures.join("alignment.svg"))?;
    report(&place, &python, &figures.join("report.png"))?;
    live_view(&elf, &python, &figures.join("live-view.svg"))
}

/// How the trigger moves onto the phone's frames in the demo's second session.
fn alignment(demo: &Path, python: &Path, figure: &Path) -> Result<()> {
    process::run(
        process::command(python)
            .arg(process::root().join("xtask/figures/alignment.py"))
            .arg(demo.join("recording-euroc"))
            .arg(figure),
    )?;
    println!("{}", figure.display());
    Ok(())
}

/// The live view of a recording on the simulated rig.
fn live_view(elf: &Path, python: &Path, figure: &Path) -> Result<()> {
    let place = process::fresh_folder("figures")?;
    let profile = place.join("rig.toml");
    let written = profile.display().to_string();
    let rig = Rig::start(
        elf,
        &["--motion", "twist", "--phone", "0", "--profile", &written],
    )?;
    let begun = Instant::now();
    let mut owner = String::new();
    while !owner.contains("[depth.recorder]") && begun.elapsed() < PATIENCE {
        std::thread::sleep(Duration::from_millis(100));
        owner = fs::read_to_string(&profile).unwrap_or_default();
    }
    // As after `evaluate precision --calibrate`: the profile has the rig's true constants.
    owner += "\n[frame_sync]\nbias_us = 0.0\nbias_sigma_us = 0.1\nbias_measured = \"2026-01-31\"\n";
    fs::write(&profile, owner)?;
    let terminal = Terminal(place.join("tmux"));
    let (width, height) = TERMINAL;
    let program = process::program("smartdepthsync").display().to_string();
    let out = place.join("recordings").display().to_string();
    let record = [
        "record",
        "--yes",
        "--port",
        &rig.port,
        "--profile",
        &written,
        "--out",
        &out,
    ];
    let session = [
        "-f",
        "/dev/null",
        "new-session",
        "-d",
        "-x",
        width,
        "-y",
        height,
    ];
    terminal.run(&[&session[..], &[&program], &record[..]].concat())?;
    let begun = Instant::now();
    let mut seen = String::new();
    while !(seen.contains("RECORDING") && seen.contains("off grid")) {
        if begun.elapsed() > PATIENCE {
            bail!("the live view never showed a recording:\n{seen}");
        }
        std::thread::sleep(Duration::from_millis(500));
        seen = terminal.run(&["capture-pane", "-p"])?;
    }
    // Until its chart is full.
    std::thread::sleep(Duration::from_secs(4));
    let capture = place.join("live-view.txt");
    fs::write(&capture, terminal.run(&["capture-pane", "-p", "-e"])?)?;
    process::run(
        process::command(python)
            .arg(process::root().join("xtask/figures/terminal.py"))
            .arg(&capture)
            .arg(width)
            .arg(figure),
    )?;
    println!("{}", figure.display());
    // A session that still looked for its board would take the next rig's.
    terminal.run(&["send-keys", "q"])?;
    let begun = Instant::now();
    while terminal.run(&["list-sessions"]).is_ok() {
        if begun.elapsed() > PATIENCE {
            bail!("the recording does not end");
        }
        std::thread::sleep(Duration::from_millis(500));
    }
    Ok(())
}

/// The report of the demo's data set, as a browser shows its beginning.
fn report(demo: &Path, python: &Path, figure: &Path) -> Result<()> {
    let shot = demo.join("report.png");
    let mut browser = process::command("chromium");
    browser
        .args("--headless=new --no-sandbox --disable-gpu --hide-scrollbars".split(' '))
        .args("--log-level=3 --window-size=900,1905 --virtual-time-budget=4000".split(' '))
        .arg(format!(
            "--user-data-dir={}",
            demo.join("browser").display()
        ))
        .arg(format!("--screenshot={}", shot.display()))
        .arg(format!(
            "file://{}",
            demo.join("recording-euroc/report.html").display()
        ));
    process::run(&mut browser)?;
    process::run(
        process::command(python)
            .arg(process::root().join("xtask/figures/shrink.py"))
            .arg(&shot)
            .arg(figure),
    )?;
    println!("{}", figure.display());
    Ok(())
}

/// A terminal of a tmux server of its own, by the server's socket.
struct Terminal(PathBuf);

impl Terminal {
    fn run(&self, arguments: &[&str]) -> Result<String> {
        let output = Command::new("tmux")
            .arg("-S")
            .arg(&self.0)
            .args(arguments)
            .output()
            .context("cannot start tmux")?;
        if !output.status.success() {
            bail!("tmux: {}", String::from_utf8_lossy(&output.stderr).trim());
        }
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // The server may have ended with its program.
        let _ = self.run(&["kill-server"]);
    }
}

/// A running `hil-sim serve`, which ends with this value.
struct Rig {
    child: Child,
    port: String,
}

impl Rig {
    fn start(elf: &Path, arguments: &[&str]) -> Result<Self> {
        let mut child = process::command(process::program("hil-sim"))
            .arg("serve")
            .args(arguments)
            .args(["--wait-for-host", "--quiet", "--speed", "4"])
            .env(process::ELF_VARIABLE, elf)
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start hil-sim serve")?;
        let mut line = String::new();
        // The pipe stays open: there are more lines than the first.
        if let Some(output) = &mut child.stdout {
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
