//! Rendered recordings with a ground truth, for the evaluation.

use std::path::{Path, PathBuf};

use evaluate::footage::Footage;
use evaluate::footage::{FrameSource, FrameTimes, GreyView, SourceInfo};
use evaluate::precision::{RecordingResult, evaluate_recording};
use evaluate::{EvaluateError, Settings};
use rig::picture::rolling_shutter::{Flash, FlashTrain, GreyImage, RollingShutter};
use rig::picture::video_writer::{Mp4Writer, Quality, VideoSettings};

/// A camera on the re-transmitted light of a depth camera, with the ground truth.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    pub(crate) camera: RollingShutter,
    pub(crate) train: FlashTrain,
    /// Bias of the first frame, µs.
    pub(crate) bias_us: f64,
    /// µs/min.
    pub(crate) drift_us_per_min: f64,
    pub(crate) frame_rate: f64,
    pub(crate) frames: u64,
    /// Flashes come on frames from this one on.
    pub(crate) lit_from: u64,
    /// And of those only on every n-th.
    pub(crate) lit_every: u64,
    /// In this number of them at first, only the train's last flash is in the picture, at
    /// its first rows, and wanders in.
    pub(crate) entering: u64,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            // Fewer columns than a phone: the same rows, rendered faster.
            camera: RollingShutter {
                columns: 96,
                ..RollingShutter::default()
            },
            train: FlashTrain::NFOV,
            bias_us: 0.0,
            drift_us_per_min: 0.0,
            frame_rate: 30.0,
            frames: 20,
            lit_from: 4,
            lit_every: 1,
            entering: 0,
        }
    }
}

impl Scene {
    pub(crate) fn start_ns(&self, frame: u64) -> i64 {
        1_000_000_000 + (frame as f64 * 1e9 / self.frame_rate).round() as i64
    }

    /// Bias of a frame, µs.
    pub(crate) fn truth_us(&self, frame: u64) -> f64 {
        let drift = self.drift_us_per_min * frame as f64 / self.frame_rate / 60.0;
        let entered = frame.saturating_sub(self.lit_from);
        if entered < self.entering {
            // Four pitches and half the picture before the middle.
            return -11_700.0 + 20.0 * entered as f64;
        }
        self.bias_us + drift
    }

    /// Bias that frame really gets, in whole nanoseconds, µs.
    pub(crate) fn flashes(&self, frame: u64) -> Vec<Flash> {
        if frame < self.lit_from || !(frame - self.lit_from).is_multiple_of(self.lit_every) {
            return Vec::new();
        }
        let center = self.camera.middle_offset_ns() + 1e3 * self.truth_us(frame);
        self.train
            .centered_at(self.start_ns(frame) + center.round() as i64)
            .collect()
    }

    pub(crate) fn render(&self, frame: u64, image: &mut GreyImage) {
        let camera = &self.camera;
        *image = camera.render(self.start_ns(frame), frame, &self.flashes(frame));
    }

    /// Mean true bias of the last `n` frames with flashes, µs.
    pub(crate) fn truth_of_last_us(&self, n: usize) -> f64 {
        let lit: Vec<u64> = (0..self.frames)
            .filter(|&f| !self.flashes(f).is_empty())
            .collect();
        let last = &lit[lit.len().saturating_sub(n)..];
        last.iter().map(|&f| self.truth_us(f)).sum::<f64>() / last.len() as f64
    }

    pub(crate) fn source(&self) -> SceneSource<'_> {
        let (width, height) = self.camera.image_size();
        SceneSource {
            scene: self,
            info: SourceInfo {
                encoded: false,
                path: PathBuf::from("rendered"),
                width,
                height,
                white: 253,
                frames: Some(self.frames),
                times: FrameTimes::Listed((0..self.frames).map(|f| self.start_ns(f)).collect()),
                notes: Vec::new(),
            },
            next: 0,
            image: GreyImage::default(),
        }
    }

    pub(crate) fn recording(&self, settings: &Settings) -> Result<Footage, EvaluateError> {
        Footage::from_source(&mut self.source(), settings, None)
    }

    pub(crate) fn evaluate(&self, settings: &Settings) -> Result<RecordingResult, EvaluateError> {
        let recording = self.recording(settings)?;
        Ok(evaluate_recording(recording, settings, 16)?.result)
    }

    pub(crate) fn write_mp4(&self, path: &Path, quality: Quality) {
        let (width, height) = self.camera.image_size();
        let mut writer = Mp4Writer::create(
            path,
            VideoSettings {
                width,
                height,
                frame_rate: self.frame_rate,
                quality,
            },
        )
        .expect("encoder");
        let mut image = GreyImage::default();
        for frame in 0..self.frames {
            self.render(frame, &mut image);
            writer.write(&image).expect("frame");
        }
        writer.finish().expect("video");
    }
}

/// Renders frames when they are asked for.
pub(crate) struct SceneSource<'a> {
    scene: &'a Scene,
    info: SourceInfo,
    next: u64,
    image: GreyImage,
}

impl FrameSource for SceneSource<'_> {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Result<Option<GreyView<'_>>, EvaluateError> {
        if self.next == self.scene.frames {
            return Ok(None);
        }
        self.scene.render(self.next, &mut self.image);
        self.next += 1;
        Ok(Some(GreyView {
            width: self.image.width,
            height: self.image.height,
            pixels: &self.image.pixels,
        }))
    }
}
