//! The extraction: speed and memory on simulated recordings, beside a plain Python
//! reader of the same file.
//!
//! An hour of the board alone, and ten minutes with the depth camera at its full
//! size (13 GB; a tenth with `--depth-minutes 1`). Memory is the child's high-water
//! mark, read from `/proc` while it runs, and measured at two lengths: it must not
//! grow with the recording.

use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use crate::{process, tools};

/// Exit code of the host tool for "finished, with loss": parts are missing here
/// on purpose.
const LOSS: i32 = 4;

struct Measured {
    seconds: f64,
    /// High-water mark in MB, if the system tells.
    memory: Option<f64>,
}

/// `cargo xtask bench extract`.
pub(crate) fn run(depth_minutes: u32) -> Result<()> {
    let python = tools::ensure_python()?;
    let build = "build --release --workspace --example synthetic_recording --bin smartdepthsync";
    process::cargo(build.split(' '))?;
    let place = process::fresh_folder("extract-bench")?;
    let result = board(&place, &python).and_then(|()| depth(&place, depth_minutes));
    // The recordings are large.
    let _ = fs::remove_dir_all(&place);
    result
}

fn make(folder: &Path, seconds: u32, options: &[&str]) -> Result<()> {
    process::run(
        process::command(process::program("examples/synthetic_recording"))
            .arg(folder)
            .arg(seconds.to_string())
            .args(options),
    )
}

fn board(place: &Path, python: &Path) -> Result<()> {
    println!("the board's recording, simulated, with raw link frames:");
    for (name, seconds) in [("six minutes", 360), ("one hour", 3600)] {
        let folder = place.join(format!("board-{seconds}"));
        make(&folder, seconds, &[])?;
        let mcap = folder.join("recording.mcap");
        let size = megabytes(&mcap)?;
        let ours = extract(
            &folder,
            &place.join(format!("out-{seconds}")),
            &["--format", "euroc"],
        )?;
        println!("  {name} ({size:.0} MB): extract {}", ours.text(size));
        if seconds == 3600 {
            let theirs = measure(
                process::command(python)
                    .arg("xtask/extract_bench.py")
                    .arg(&mcap)
                    .arg(place.join("python.csv"))
                    .stdout(Stdio::null())
                    .spawn()?,
                &[0],
            )?;
            println!("  {name} ({size:.0} MB): Python  {}", theirs.text(size));
            println!("  ratio {:.1} (aim: 20)", theirs.seconds / ours.seconds);
        }
    }
    Ok(())
}

fn depth(place: &Path, minutes: u32) -> Result<()> {
    println!("board, phone and depth of 640 × 576, simulated:");
    let mut lengths = vec![minutes.max(1) * 60];
    if minutes > 1 {
        lengths.insert(0, 60);
    }
    for seconds in lengths {
        let folder = place.join(format!("depth-{seconds}"));
        make(&folder, seconds, &["--depth", "640x576", "--phone"])?;
        let size =
            megabytes(&folder.join("depth.mkv"))? + megabytes(&folder.join("recording.mcap"))?;
        let out = place.join(format!("out-depth-{seconds}"));
        let ours = extract(&folder, &out, &["--format", "tum"])?;
        println!("  {seconds} s ({size:.0} MB): extract {}", ours.text(size));
        fs::remove_dir_all(&folder)?;
        fs::remove_dir_all(&out)?;
    }
    Ok(())
}

fn extract(recording: &Path, out: &Path, options: &[&str]) -> Result<Measured> {
    let child = process::command(process::program("smartdepthsync"))
        .arg("extract")
        .arg(recording)
        .arg("--out")
        .arg(out)
        .args(options)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .context("cannot start smartdepthsync")?;
    measure(child, &[0, LOSS])
}

/// Waits for a child and watches its memory.
fn measure(mut child: Child, good: &[i32]) -> Result<Measured> {
    let begin = Instant::now();
    let mut memory = None;
    let status = loop {
        memory = high_water(child.id()).or(memory);
        if let Some(status) = child.try_wait()? {
            break status;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    if !status.code().is_some_and(|code| good.contains(&code)) {
        bail!("the measured program ended with {status}");
    }
    Ok(Measured {
        seconds: begin.elapsed().as_secs_f64(),
        memory,
    })
}

/// Most memory that a process ever held, in MB (Linux).
fn high_water(process: u32) -> Option<f64> {
    let text = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = text.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kilobytes: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes / 1024.0)
}

fn megabytes(path: &Path) -> Result<f64> {
    let meta = fs::metadata(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(meta.len() as f64 / 1e6)
}

impl Measured {
    fn text(&self, megabytes: f64) -> String {
        let memory = self.memory.map_or_else(
            || "memory not known".into(),
            |memory| format!("at most {memory:.0} MB of memory"),
        );
        format!(
            "{:.2} s, {:.0} MB/s, {memory}",
            self.seconds,
            megabytes / self.seconds
        )
    }
}
