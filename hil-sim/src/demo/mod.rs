//! The demonstration: a whole session on the simulated rig, judged by the truth.
//!
//! The rig runs in this process ([`RunningRig`]); the session is the program
//! `smartdepthsync record` as a process of its own, which sees a serial port and
//! a TCP port as on hardware. It is given a profile with the constants that a
//! real rig's owner would have measured (readout, filter delays, the depth
//! camera's centre offset), and nothing that a session finds out by itself.
//!
//! The rig is twisted, walked with and twisted again by the clock, not by what
//! the session asks for; the first twist is long enough for it.

pub mod judge;
pub mod report;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use smartdepthsync::recording::reader::{Item, Reader};
use smartdepthsync::recording::session_file::SessionFile;

use crate::motion::gesture::Gesture;
use crate::motion::{MotionSpec, Step};
use crate::phone::PhoneConfig;
use crate::random::Seed;
use crate::rig::Rig;
use crate::rig_config::RigConfig;
use crate::running_rig::{Pace, RunningRig};
use judge::{Truth, Verdict};
use report::Figures;

/// Seconds of board time that are recorded unless asked otherwise.
pub const DEFAULT_SECONDS: u32 = 60;

/// Longest and shortest recording, seconds.
pub const SECONDS: std::ops::RangeInclusive<u32> = 5..=3600;

/// How long the rig is twisted at first, seconds: the session connects, and
/// then needs 9 s of it.
const FIRST_TWIST_S: f64 = 45.0;

/// How much earlier than the recording's earliest end the walk ends, seconds.
const SECOND_TWIST_EARLIER_S: f64 = 35.0;

/// What to show.
#[derive(Clone, Debug)]
pub struct DemoOptions {
    /// The one seed of all randomness.
    pub seed: u64,
    /// Seconds of board time to record.
    pub seconds: u32,
    /// Folder for the recording, the phone's files and the report.
    pub out: PathBuf,
    /// The firmware's ELF; the one that was built last if not given.
    pub elf: Option<PathBuf>,
    /// The program `smartdepthsync`.
    pub program: PathBuf,
    /// At most so many times real time.
    pub speed: f64,
    /// Arguments for `smartdepthsync record` beside the demo's own.
    pub record_args: Vec<String>,
}

/// What a run has left.
#[derive(Debug)]
pub struct Demo {
    /// The figures.
    pub figures: Figures,
    /// The recording's folder.
    pub recording: PathBuf,
    /// The report.
    pub report: PathBuf,
    /// The whole verdict.
    pub verdict: Verdict,
}

/// Runs the demonstration.
///
/// # Errors
///
/// A part of it cannot be started, the session fails, or what it left cannot be
/// judged.
pub fn run(options: &DemoOptions) -> Result<Demo> {
    let begun = Instant::now();
    let out = &options.out;
    std::fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let seed = Seed(options.seed);
    let config = RigConfig::published(seed).with_motion(motion(options.seconds));
    let mut phone = PhoneConfig::draw(seed);
    phone.storage = Some(out.join("phone"));
    let profile = out.join("rig.toml");
    let mut board = Rig::builder();
    if let Some(elf) = &options.elf {
        board = board.elf(elf);
    }
    let pace = Pace {
        speed: Some(options.speed),
        wait_for_host: true,
    };
    let rig = RunningRig::start(config, board, Some((phone, 0)), pace)?;
    std::fs::write(&profile, rig.profile()?)
        .with_context(|| format!("cannot write {}", profile.display()))?;
    let recording = session(options, &rig, &profile)?;
    let truth = rig.stop().context("the simulated rig")?;
    let virtual_s = truth.end.as_secs_f64();
    let verdict = Truth::of(truth)?.judge(&recording)?;
    let figures = Figures::new(
        &verdict,
        virtual_s,
        begun.elapsed().as_secs_f64(),
        options.seed,
    );
    let twist = twist_plot(options, &profile, &recording)?;
    let report = out.join("report.html");
    std::fs::write(&report, report::page(&figures, &verdict, twist.as_deref())?)
        .with_context(|| format!("cannot write {}", report.display()))?;
    Ok(Demo {
        figures,
        recording,
        report,
        verdict,
    })
}

/// Twist, walk, and twist again before a recording of `seconds` can end.
fn motion(seconds: u32) -> MotionSpec {
    let walk = (f64::from(seconds) - SECOND_TWIST_EARLIER_S).max(1.0);
    let step = |gesture, seconds| Step { gesture, seconds };
    MotionSpec::Script(vec![
        step(Gesture::Twist, Some(FIRST_TWIST_S)),
        step(Gesture::Walk, Some(walk)),
        step(Gesture::Twist, None),
    ])
}

/// Runs `smartdepthsync record` and gives the recording's folder.
fn session(options: &DemoOptions, rig: &RunningRig, profile: &Path) -> Result<PathBuf> {
    let name = free_name(&options.out, "recording");
    let mut command = Command::new(&options.program);
    command
        .arg("record")
        .arg("--port")
        .arg(rig.port())
        .arg("--profile")
        .arg(profile)
        .arg("--out")
        .arg(&options.out)
        .args(["--name", &name, "--yes"])
        .args(["--duration", &format!("{}s", options.seconds)])
        .args(["--second-twist", "--fetch-video"])
        .args(&options.record_args)
        .stdin(Stdio::null());
    let mut child = command.spawn().with_context(|| {
        format!(
            "cannot start {}: build it with `cargo build --release -p smartdepthsync`",
            options.program.display()
        )
    })?;
    // A board that has died is the reason for whatever the session says.
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    };
    if !status.success() {
        bail!("the session ended with {status}");
    }
    Ok(options.out.join(name))
}

/// A name in `folder` that is not taken.
fn free_name(folder: &Path, name: &str) -> String {
    let mut free = name.to_owned();
    let mut number = 1u32;
    while folder.join(&free).exists() {
        number += 1;
        free = format!("{name}_{number}");
    }
    free
}

/// Has `smartdepthsync offset` draw the first twist; nothing if there is none.
fn twist_plot(options: &DemoOptions, profile: &Path, recording: &Path) -> Result<Option<String>> {
    let session = SessionFile::load(recording)?;
    let Some(twist) = session.twists.iter().find(|t| t.accepted) else {
        return Ok(None);
    };
    let (Some(phone), Some(imu)) = (&twist.phone_gyro, &session.imu) else {
        return Ok(None);
    };
    let mut csv = String::from("time_s,x,y,z\n");
    for entry in Reader::open(recording)? {
        let entry = entry?;
        if entry.at < twist.span.from || entry.at > twist.span.to {
            continue;
        }
        if let Item::Imu(sample) = entry.item {
            let [x, y, z]: [f64; 3] = sample.angular_velocity.into();
            let _ = writeln!(csv, "{:.9},{x},{y},{z}", entry.at.as_secs_f64());
        }
    }
    let board = options.out.join("twist_board_gyro.csv");
    std::fs::write(&board, csv).with_context(|| format!("cannot write {}", board.display()))?;
    let plot = options.out.join("twist.svg");
    let rig = smartdepthsync::profile::Profile::load(profile)?;
    let output = Command::new(&options.program)
        .arg("offset")
        .arg("--mcu")
        .arg(&board)
        .arg("--phone")
        .arg(recording.join(phone))
        .arg("--plot")
        .arg(&plot)
        .args(["--mcu-delay-us", &imu.scale.gyro_delay_us.to_string()])
        .args(["--phone-delay-us", &rig.phone.gyro_delay_us.to_string()])
        .stdin(Stdio::null())
        .output()
        .with_context(|| format!("cannot start {}", options.program.display()))?;
    if !output.status.success() {
        bail!(
            "the plot of the twist failed: {}",
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    let svg = std::fs::read_to_string(&plot)
        .with_context(|| format!("cannot read {}", plot.display()))?;
    Ok(Some(svg))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_motion_is_a_twist_at_both_ends() {
        assert_eq!(motion(60).to_string(), "twist:45,walk:25,twist");
        assert_eq!(motion(5).to_string(), "twist:45,walk:1,twist");
    }

    #[test]
    fn nothing_is_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(free_name(folder.path(), "recording"), "recording");
        std::fs::create_dir(folder.path().join("recording")).unwrap();
        assert_eq!(free_name(folder.path(), "recording"), "recording_2");
    }
}
