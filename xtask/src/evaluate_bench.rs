//! Speed of `smartdepthsync evaluate` on a 1080p30 video, against decoding alone.

use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, ensure};

use crate::process;

/// Seconds of video.
const SECONDS: f64 = 20.0;
/// Speed that the tool must have beyond decoding, in times real time.
const REQUIRED: f64 = 5.0;

/// Renders a video, decodes it with ffmpeg alone, evaluates it, and prints the
/// times.
pub(crate) fn run() -> Result<()> {
    let video = process::target_dir()
        .join("bench")
        .join("strobes-1080p30.mp4");
    if let Some(folder) = video.parent() {
        std::fs::create_dir_all(folder)?;
    }
    process::cargo(["build", "--release", "-p", "smartdepthsync"])?;
    process::run(
        process::command(process::cargo_program())
            .args(["run", "--release", "-p", "hil-sim", "--example"])
            .args(["render_strobes", "--"])
            .arg(&video)
            .arg(SECONDS.to_string()),
    )?;

    let started = Instant::now();
    process::run(
        Command::new("ffmpeg")
            .args(["-v", "error", "-nostdin", "-i"])
            .arg(&video)
            .args(["-vf", "extractplanes=y", "-f", "null", "-"]),
    )?;
    let decoding = started.elapsed().as_secs_f64();

    let program = process::program("smartdepthsync");
    println!("1080p30, {SECONDS:.0} s of video");
    println!("  ffmpeg alone          {decoding:.2} s");
    let mut slowest = f64::INFINITY;
    for what in ["precision", "drift"] {
        let json = process::text(
            Command::new(&program)
                .args(["--json", "evaluate", what])
                .arg(&video)
                .stderr(Stdio::inherit()),
        )?;
        let seconds = |key: &str| -> Result<f64> {
            let (_, rest) = json.split_once(key).context("no such time")?;
            let number = rest.split([',', '\n', '}']).next().unwrap_or_default();
            number
                .trim()
                .parse()
                .with_context(|| format!("{key} {number}"))
        };
        let total = seconds("\"total_s\":")?;
        let own = total - seconds("\"waiting_for_input_s\":")?;
        let speed = SECONDS / own;
        slowest = slowest.min(speed);
        println!(
            "  evaluate {what:<10}   {total:.2} s, {own:.2} s beyond decoding: {speed:.1} times real time"
        );
    }
    ensure!(
        slowest >= REQUIRED,
        "evaluate is only {slowest:.1} times as fast as real time, at least {REQUIRED} are required"
    );
    Ok(())
}
