//! The recorder of the depth camera, as the maker's: what the camera delivers from its
//! start until it is stopped becomes `depth.mkv`.

use std::cell::Cell;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use ::session::devices::{DepthRecorder, RecorderEnd, RecorderError};
use recording::profile::Depth;
use rig::depth_camera::FrameRecord;
use rig::depth_camera::k4a_mkv::{self, K4aSettings};
use rig::picture::ball;

use super::SharedRig;

/// Fate of a recorder.
#[derive(Debug, Default)]
pub struct RecorderFate {
    ends: Cell<bool>,
    hangs: Cell<bool>,
}

impl RecorderFate {
    /// It ends by itself.
    pub fn end(&self) {
        self.ends.set(true);
    }

    /// The recorder no longer listens.
    pub fn hang(&self) {
        self.hangs.set(true);
    }
}

/// The recorder.
pub(super) struct VirtualRecorder {
    rig: SharedRig,
    fate: Rc<RecorderFate>,
    shows_ball: bool,
    /// The file that it writes, and the first frame that is its own.
    recording: Option<(PathBuf, usize)>,
    frames: Vec<FrameRecord>,
    end: Option<RecorderEnd>,
}

impl VirtualRecorder {
    pub(super) const fn new(rig: SharedRig, fate: Rc<RecorderFate>, shows_ball: bool) -> Self {
        Self {
            rig,
            fate,
            shows_ball,
            recording: None,
            frames: Vec::new(),
            end: None,
        }
    }

    /// The frames that it has written.
    pub(super) fn into_frames(self) -> Vec<FrameRecord> {
        self.frames
    }

    fn write(&mut self) -> std::io::Result<()> {
        let Some((path, first)) = self.recording.take() else {
            return Ok(());
        };
        let frames = self.rig.with(|rig| rig.depth_frames()[first..].to_vec());
        self.frames = frames;
        if self.shows_ball {
            write_ball(&path, &self.frames)
        } else {
            write_frames(&path, &self.frames)
        }
    }
}

/// Writes images of the ball where it is.
fn write_ball(path: &Path, frames: &[FrameRecord]) -> std::io::Result<()> {
    let file = BufWriter::new(File::create(path)?);
    k4a_mkv::write_frames(file, K4aSettings::of_ball(30), frames, ball::depth_picture)?;
    Ok(())
}

/// Writes small images that name their frame.
pub(crate) fn write_frames(path: &Path, frames: &[FrameRecord]) -> std::io::Result<()> {
    let file = BufWriter::new(File::create(path)?);
    k4a_mkv::write_frames(file, K4aSettings::small(), frames, |frame, pixels| {
        for (index, pixel) in (0_u64..).zip(pixels) {
            *pixel = naming_pixel(frame, index);
        }
    })?;
    Ok(())
}

/// A pixel of an image that names its frame, mm.
pub(crate) fn naming_pixel(frame: &FrameRecord, index: u64) -> u16 {
    (500 + (frame.number * 131 + index * 7) % 12_000) as u16
}

impl DepthRecorder for VirtualRecorder {
    fn start(&mut self, _: &Depth, folder: &Path) -> Result<bool, RecorderError> {
        let first = self.rig.with(|rig| rig.depth_frames().len());
        self.recording = Some((folder.join("depth.mkv"), first));
        self.end = None;
        Ok(true)
    }

    fn poll(&mut self) -> Option<RecorderEnd> {
        if self.fate.ends.take() {
            return Some(RecorderEnd {
                program: String::from("the simulated recorder"),
                status: String::from("3"),
                is_as_asked: false,
            });
        }
        self.end.take()
    }

    fn ask_to_stop(&mut self) {
        if self.fate.hangs.take() {
            return;
        }
        let written = self.write();
        self.end = Some(RecorderEnd {
            program: String::from("the simulated recorder"),
            is_as_asked: written.is_ok(),
            status: written.map_or_else(|error| error.to_string(), |()| String::from("0")),
        });
    }

    fn kill(&mut self) {
        self.recording = None;
    }
}
