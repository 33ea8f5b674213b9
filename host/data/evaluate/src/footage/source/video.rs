//! Videos, of which only the luma is read as it was coded: without a conversion of its
//! range, and in the sensor's orientation.

use std::path::Path;

use phone::video::{Pixels, VideoError};
use system::ReadMonitor;

use super::timestamps::beside;
use super::{FrameSource, FrameTimes, SourceInfo, read_timestamps};
use crate::EvaluateError;
use crate::footage::frame::GreyView;

/// Frame rate if the file does not state one, frames per second.
const DEFAULT_RATE: f64 = 30.0;

pub(crate) struct Video {
    info: SourceInfo,
    decoder: phone::video::Video,
    frame: Vec<u8>,
    read: u64,
}

impl Video {
    pub(crate) fn open(path: &Path, monitor: &ReadMonitor) -> Result<Self, EvaluateError> {
        let decoder = phone::video::Video::open(path, Pixels::Luma, monitor)
            .map_err(|error| EvaluateError::from_video(path, error))?;
        let stated = decoder.info();
        let mut notes = Vec::new();
        let times = match beside(path) {
            Some(file) => {
                let times = read_timestamps(&file, monitor)?;
                if let Some(n) = stated.frames.filter(|&n| n != times.len() as u64) {
                    notes.push(format!(
                        "{}: {} timestamps for a video of {n} frames; frames without a timestamp are left out",
                        file.display(),
                        times.len()
                    ));
                }
                FrameTimes::Listed(times)
            }
            None => FrameTimes::Rate(stated.rate.unwrap_or_else(|| {
                notes.push(format!(
                    "the video does not say its frame rate: taken as {DEFAULT_RATE} frames per second"
                ));
                DEFAULT_RATE
            })),
        };
        Ok(Self {
            info: SourceInfo {
                encoded: true,
                path: path.to_owned(),
                width: stated.width as usize,
                height: stated.height as usize,
                white: if stated.full_range { 253 } else { 234 },
                frames: stated.frames,
                times,
                notes,
            },
            decoder,
            frame: Vec::new(),
            read: 0,
        })
    }
}

impl FrameSource for Video {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Result<Option<GreyView<'_>>, EvaluateError> {
        let more = match self.decoder.next_frame(&mut self.frame) {
            Ok(more) => more,
            Err(error @ VideoError::Decode(_)) if self.read > 0 => {
                self.info.notes.push(format!("damaged video: {error}"));
                false
            }
            Err(error) => return Err(EvaluateError::from_video(&self.info.path, error)),
        };
        if more {
            self.read += 1;
            return Ok(Some(GreyView {
                width: self.info.width,
                height: self.info.height,
                pixels: &self.frame,
            }));
        }
        if self.read == 0 {
            return Err(EvaluateError::from_video(
                &self.info.path,
                VideoError::Decode("nothing".to_owned()),
            ));
        }
        if let Some(n) = self.info.frames.filter(|&n| self.read < n) {
            self.info.notes.push(format!(
                "truncated: {} of {n} frames could be read",
                self.read
            ));
        }
        Ok(None)
    }
}
