//! The cable between the simulated depth camera and its recorder, a program of its own as
//! the maker's is: `hil-sim record-depth`.
//!
//! The camera's side ([`Cable`]) listens on a Unix socket. A recorder that connects opens
//! the camera, which then waits for its first pulse; each frame that reaches the computer
//! goes over the socket as a line of JSON, and the camera is switched off when the recorder
//! leaves. The recorder ([`record`]) writes the file of the Azure Kinect's recorder, with
//! pictures of the [`ball`](crate::picture::ball), until it is interrupted.

use std::fs::File;
use std::io::{BufRead as _, BufReader, BufWriter, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use anyhow::{Context, Result};

use crate::depth_camera::k4a_mkv::{K4aMkvWriter, K4aSettings};
use crate::depth_camera::{DepthCamera, FrameRecord};
use crate::interrupt;
use crate::picture::ball;
use stm32f4_sim::shared::{Shared, lock};

/// Interval at which either side checks for its end.
const POLL: Duration = Duration::from_millis(50);

/// The camera's end. The file of the socket is removed with it.
#[derive(Debug)]
pub struct Cable {
    path: PathBuf,
}

impl Cable {
    /// Listens at `path` for one recorder at a time.
    ///
    /// # Errors
    ///
    /// No socket can be made there.
    pub fn new(camera: &Shared<DepthCamera>, path: &Path) -> Result<Self> {
        let listener =
            UnixListener::bind(path).with_context(|| format!("cannot make {}", path.display()))?;
        let (sender, frames) = channel();
        lock(camera).record_into(sender);
        let camera = Arc::clone(camera);
        // The thread ends with the process.
        std::thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                lock(&camera).wait_for_pulses();
                // Earlier frames have no recorder.
                frames.try_iter().for_each(drop);
                deliver(stream, &frames);
                lock(&camera).stop();
            }
        });
        Ok(Self {
            path: path.to_owned(),
        })
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        // It lies in a folder that goes too, or is somebody's to look at.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Sends frames until the recorder leaves. An empty line checks that it is still connected.
fn deliver(mut stream: UnixStream, frames: &Receiver<FrameRecord>) {
    loop {
        let line = match frames.recv_timeout(POLL) {
            Ok(frame) => serde_json::to_string(&frame).unwrap_or_default(),
            Err(RecvTimeoutError::Timeout) => String::new(),
            Err(RecvTimeoutError::Disconnected) => return,
        };
        if writeln!(stream, "{line}").is_err() {
            return;
        }
    }
}

/// Options of `record-depth`.
#[derive(clap::Args)]
pub struct RecordDepthArgs {
    /// The socket of the camera, as `serve` has it in the profile that it writes.
    #[arg(long, value_name = "SOCKET")]
    camera: PathBuf,
    /// Frames a second, for the file's head.
    #[arg(long, default_value_t = 30)]
    fps: u32,
    /// The recording to write.
    out: PathBuf,
}

/// Records until it is interrupted, or the camera is gone.
///
/// # Errors
///
/// There is no camera, or the file cannot be written.
pub fn record(args: &RecordDepthArgs) -> Result<()> {
    let stopped = interrupt::watch()?;
    let camera = UnixStream::connect(&args.camera)
        .with_context(|| format!("no camera at {}", args.camera.display()))?;
    let file =
        File::create(&args.out).with_context(|| format!("cannot write {}", args.out.display()))?;
    let mut writer = K4aMkvWriter::new(BufWriter::new(file), K4aSettings::of_ball(args.fps))?;
    for line in BufReader::new(camera).lines() {
        if stopped.load(Ordering::Relaxed) {
            break;
        }
        // A camera that was switched off ends the recording, not the file.
        let Ok(line) = line else { break };
        if line.is_empty() {
            continue;
        }
        let frame: FrameRecord = serde_json::from_str(&line).context("what came is not a frame")?;
        writer.write_frame(&frame, ball::depth_picture)?;
    }
    writer.finish()?.flush()?;
    Ok(())
}
