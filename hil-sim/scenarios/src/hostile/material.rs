//! A valid recording with everything that a command reads, small and made at once.

use std::fmt::Write as _;
use std::fs;
use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use board::imu::Sample;
use protocol::{ImuFlags, Output, Period, Pulse, TICK_HZ, Ticks};
use recording::MCAP_FILE;
use recording::messages::{Imu, RosMessage as _};
use recording::profile::{DEFAULT, Profile};
use recording::writer::Writer;
use rig::k4a_mkv::{K4aImu, K4aMkvWriter, K4aSettings};
use twist_scenarios::TwistSpec;

use super::bag::{self, Message};

#[path = "../../../../host/cli/tests/support/ros2_imu.rs"]
mod ros2_imu;
#[path = "../../../../host/cli/tests/support/session.rs"]
mod session;
#[path = "../../../../host/cli/tests/support/sqlite_bag.rs"]
mod sqlite_bag;

/// Length of the recording, s.
const SECONDS: u64 = 6;
/// Phone less board, s.
const OFFSET: i64 = 94_000;
const PERIOD: Period = Period(1_600_000 << 32);
const ANCHOR: Ticks = Ticks(48_000_000);
/// The names of the app's files.
const VIDEO: &str = "VID_20260131_140327";

/// A folder to be copied.
pub struct Material(PathBuf);

/// Where things lie in the folder of a run.
pub struct Files {
    /// What the command may touch.
    pub work: PathBuf,
    /// What it may not, beside it.
    pub bait: PathBuf,
    /// The recording's folder.
    pub recording: PathBuf,
    pub(super) mcap: PathBuf,
    /// A bag of the published system.
    pub(super) bag: PathBuf,
    pub(super) session: PathBuf,
    pub(super) profile: PathBuf,
    pub(super) timestamps: PathBuf,
    pub(super) gyro: PathBuf,
    pub(super) video: PathBuf,
    pub(super) depth: PathBuf,
    /// A ROS 2 bag in sqlite3.
    pub(super) sqlite_bag: PathBuf,
    /// The two files of `offset`.
    pub(super) board_csv: PathBuf,
    pub(super) phone_csv: PathBuf,
}

impl Files {
    /// In a run's folder.
    #[must_use]
    pub fn in_folder(root: &Path) -> Self {
        let work = root.join("work");
        let recording = work.join("walk");
        Self {
            bait: root.join("bait"),
            mcap: recording.join(MCAP_FILE),
            bag: work.join("published.bag"),
            session: recording.join(recording::SESSION_FILE),
            profile: work.join("rig.toml"),
            timestamps: recording.join(format!("{VIDEO}_timestamps.csv")),
            gyro: recording.join(format!("{VIDEO}gyro.csv")),
            video: recording.join(format!("{VIDEO}.mp4")),
            depth: recording.join("depth.mkv"),
            sqlite_bag: work.join("driver.db3"),
            board_csv: work.join("board.csv"),
            phone_csv: work.join("phone.csv"),
            recording,
            work,
        }
    }
}

impl Material {
    /// Makes it.
    ///
    /// # Errors
    ///
    /// A file cannot be written, or `ffmpeg` is missing.
    pub fn make(root: &Path) -> Result<Self> {
        let files = Files::in_folder(root);
        fs::create_dir_all(files.recording.join("phones"))?;
        fs::create_dir_all(&files.bait)?;
        fs::write(files.bait.join("precious"), "precious")?;
        let spec = TwistSpec::default();
        let twist = twist_scenarios::twist(&spec, 1);
        let csv = |track: &twist_sync::GyroTrack, clock: f64| {
            let mut text = String::new();
            for (t, w) in track.t.iter().zip(&track.w) {
                let nanos = ((clock + t) * 1e9).round() as i64;
                let _ = writeln!(text, "{},{},{},{nanos}", w[0], w[1], w[2]);
            }
            text
        };
        fs::write(&files.phone_csv, csv(&twist.b, twist.b.epoch_s))?;
        let mut board = String::from("mcu_time,mcu_x,mcu_y,mcu_z\n");
        for (t, w) in twist.a.t.iter().zip(&twist.a.w) {
            let at = twist.a.epoch_s + t;
            let _ = writeln!(board, "{at:.9},{},{},{}", w[0], w[1], w[2]);
        }
        fs::write(&files.board_csv, board)?;
        write_board(&files.recording, &twist.a)?;
        fs::write(&files.gyro, csv(&twist.b, OFFSET as f64 + 1.0))?;
        let stamps: String = (0..SECONDS as i64 * 30)
            .map(|row| format!("{}\n", (OFFSET + 1) * 1_000_000_000 + row * 33_333_333))
            .collect();
        let longer: String = (SECONDS as i64 * 30..400)
            .map(|row| format!("{}\n", (OFFSET + 1) * 1_000_000_000 + row * 33_333_333))
            .collect();
        fs::write(&files.timestamps, stamps + &longer)?;
        fs::write(&files.profile, DEFAULT)?;
        let made = Command::new("ffmpeg")
            .args(["-v", "error", "-f", "lavfi", "-i"])
            .args([
                "testsrc=size=320x240:rate=30",
                "-frames:v",
                "60",
                "-pix_fmt",
                "yuv420p",
            ])
            .arg(&files.video)
            .status()
            .context("running ffmpeg: install it")?;
        ensure!(made.success(), "ffmpeg failed: {made}");
        write_depth(&files.depth)?;
        let messages = published(&twist.a);
        fs::write(&files.bag, bag::bag(&messages, bag::NOT_PACKED, 1))?;
        let samples = twist.a.t.iter().zip(&twist.a.w);
        let messages: Result<Vec<_>> = samples
            .map(|(t, w)| {
                let at = (t * 1e9) as i64;
                Ok((at, ros2_imu::message(at, *w)?))
            })
            .collect();
        sqlite_bag::write(&files.sqlite_bag, ("/imu", Imu::TYPE), messages?)?;
        Ok(Self(root.to_owned()))
    }

    /// Copies it into a new folder.
    pub(super) fn copy_to(&self, root: &Path) -> Result<()> {
        copy(&self.0, root).context("copying the material")
    }
}

fn copy(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy(&entry.path(), &target)?;
        } else {
            fs::copy(entry.path(), &target)?;
        }
    }
    Ok(())
}

fn write_board(folder: &Path, track: &twist_sync::GyroTrack) -> Result<()> {
    let mut writer = Writer::create(folder)?;
    for (t, gyro) in track.t.iter().zip(&track.w) {
        let at = Ticks(ANCHOR.0 + (t.max(0.0) * f64::from(TICK_HZ)).round() as u64);
        let sample = Sample {
            at,
            flags: ImuFlags::default(),
            gyro: [gyro[0], gyro[1], gyro[2]],
            accel: [0.0, 0.0, 9.81],
            temperature: 31.0,
        };
        writer.imu(&sample)?;
    }
    for number in 0..SECONDS * 30 {
        let pulse = Pulse {
            output: Output::Camera,
            seq: number as u32,
            train: 1,
            number,
            at: PERIOD.edge(ANCHOR, i64::try_from(number).unwrap_or_default()),
            aligned: true,
            readback: Some(4),
        };
        writer.pulse(&pulse, None)?;
        let left = Pulse {
            output: Output::Two,
            readback: None,
            ..pulse
        };
        writer.output_pulse(&left, &format!("sensor {}", Output::Two.number()))?;
    }
    writer.marker(Ticks(ANCHOR.0 + 2 * u64::from(TICK_HZ)), None, "door")?;
    writer.finish()?;
    let clock = session::clock(4.0, OFFSET as f64, 0.0, 1e-3);
    let (profile, grid) = (Profile::published()?, (ANCHOR, PERIOD));
    let mut session = session::session(profile, clock, grid, 33_333_333.0, SECONDS);
    session.clock = Some(clock);
    session.save(folder)?;
    Ok(())
}

/// What the published system records of the same, with its topics.
fn published(track: &twist_sync::GyroTrack) -> Vec<Message> {
    const FIRST: u64 = 1_000_000_000;
    let mut messages: Vec<Message> = (0..)
        .zip(track.t.iter().zip(&track.w))
        .map(|(seq, (t, w))| bag::imu(seq, FIRST + (t.max(0.0) * 1e9) as u64, [w[0], w[1], w[2]]))
        .collect();
    for number in 0..SECONDS as u32 * 30 {
        let at = FIRST + u64::from(number) * 33_333_333;
        messages.push(bag::time_reference("/mcu_cameras_ts", number, at, at));
        let stamp = 1_600_000_000_000_000_000 + at;
        messages.push(bag::depth_image(number, stamp, (6, 4)));
        if number == 0 {
            let phone = OFFSET as u64 * 1_000_000_000 + at;
            messages.push(bag::time_reference("/mcu_s10_ts", 0, at, phone));
            messages.push(bag::time_reference("/depth_to_mcu_offset", 0, at, stamp));
            messages.push(bag::time_reference("/mcu_lidar_ts", 0, at, at));
            messages.push(bag::time_reference("/sequences_ts", 0, at, at));
        }
    }
    messages
}

fn write_depth(to: &Path) -> Result<()> {
    let settings = K4aSettings {
        imu: true,
        infrared: true,
        ..K4aSettings::small()
    };
    let mut writer = K4aMkvWriter::new(Cursor::new(Vec::new()), settings)?;
    let mut imu_us = 5_000_000_u64;
    for frame in 0..SECONDS * 30 {
        let us = 5_000_000 + frame * 33_333;
        while imu_us < us + 30_000 {
            writer.write_imu(&K4aImu {
                accel_us: imu_us,
                accel: [0.5, -9.75, 0.25],
                gyro_us: imu_us + 33,
                gyro: [(imu_us as f32 * 1e-6).sin(), 0.125, -1.0],
            })?;
            imu_us += 625;
        }
        let image = [900_u16; 32 * 18];
        writer.write_capture(us, &image, Some(&image))?;
    }
    let mut file = fs::File::create(to)?;
    file.write_all(writer.finish()?.get_ref())?;
    Ok(())
}
