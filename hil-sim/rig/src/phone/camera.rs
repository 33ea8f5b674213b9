//! The phone's camera: when its frames are exposed, and what they show.

use std::path::Path;

use rayon::prelude::*;

use super::config::{CameraConfig, PhoneConfig};
use super::substream;
use crate::ball;
use crate::flash_log::FlashSource;
use crate::oscillator::{Oscillator, TrueTime};
use crate::random::{Random, Stream};
use crate::rolling_shutter::{Flash, GreyImage, RollingShutter};
use crate::video_writer::{Mp4Writer, Quality, VideoError, VideoSettings};

/// Number of the frame (from 0) whose timestamp is the phase.
pub(super) const PHASE_FRAME: usize = 60;

/// Frames rendered in parallel before they go to the encoder, in order.
const BATCH: usize = 64;

/// The frames of one recording: when they truly were, and what the app was told.
#[derive(Clone, Debug)]
pub struct FrameTimes {
    first_ns: i64,
    camera: CameraConfig,
    jitter: Random,
}

impl FrameTimes {
    /// Frames of recording number `recording` of this phone, asked for at
    /// `request_ns` of the boot clock.
    #[must_use]
    pub fn new(config: &PhoneConfig, recording: u32, request_ns: i64) -> Self {
        let number = u64::from(recording);
        let mut random = substream(config.seed, Stream::PhoneCamera, number);
        let (least, most) = config.camera.first_frame_ms;
        let latency_ns = (random.uniform(least, most) * 1e6).max(0.0) as i64;
        Self {
            first_ns: request_ns.saturating_add(latency_ns),
            camera: config.camera.clone(),
            jitter: random,
        }
    }

    /// True start of exposure of the first row of frame `n`, in nanoseconds of
    /// the boot clock, without jitter.
    #[must_use]
    pub fn start_ns(&self, n: usize) -> i64 {
        let since = (n as f64 * self.camera.frame_period_ns).round() as i64;
        self.first_ns.saturating_add(since)
    }

    /// Distance of frames, in nanoseconds of the boot clock.
    #[must_use]
    pub fn period_ns(&self) -> f64 {
        self.camera.frame_period_ns
    }

    /// True middle of exposure of the middle row of frame `n`, in nanoseconds
    /// of the boot clock.
    #[must_use]
    pub fn middle_ns(&self, n: usize) -> i64 {
        let offset = self.camera.middle_offset_ns().round() as i64;
        self.start_ns(n).saturating_add(offset)
    }

    /// When the last row of frame `n` has been exposed and read.
    pub(super) fn end_ns(&self, n: usize) -> i64 {
        let length = self.camera.readout_ns() + self.camera.exposure_ns as f64;
        self.start_ns(n).saturating_add(length.round() as i64)
    }

    /// How many frames were complete at `ns`.
    #[must_use]
    pub fn complete_at(&self, ns: i64) -> usize {
        let since = ns.saturating_sub(self.end_ns(0));
        if since < 0 {
            return 0;
        }
        let mut count = (since as f64 / self.camera.frame_period_ns) as usize;
        // The division rounds: settle the border exactly.
        while self.end_ns(count) <= ns {
            count += 1;
        }
        while count > 0 && self.end_ns(count - 1) > ns {
            count -= 1;
        }
        count
    }

    /// The timestamps of the first `count` frames as the app gets them.
    #[must_use]
    pub fn stamps(&self, count: usize) -> Vec<i64> {
        let mut random = self.jitter.clone();
        (0..count)
            .map(|n| {
                let jitter = self.camera.timestamp_jitter_ns * random.normal();
                self.start_ns(n).saturating_add(jitter.round() as i64)
            })
            .collect()
    }

    /// What `video_start` answers: phase, and mean of the durations before it.
    #[must_use]
    pub fn phase(&self) -> (i64, f64) {
        let stamps = self.stamps(PHASE_FRAME + 1);
        let phase = stamps.get(PHASE_FRAME).copied().unwrap_or_default();
        let first = stamps.first().copied().unwrap_or_default();
        let last = stamps.get(PHASE_FRAME - 1).copied().unwrap_or_default();
        // A sum of integers over their number: as the app's mean of durations.
        (phase, (last - first) as f64 / (PHASE_FRAME - 1) as f64)
    }
}

/// Renders and encodes the first `count` frames into `path`.
///
/// What the camera saw: the scene's even light and the flashes of `light`, each
/// on the rows that were exposed at that moment.
pub(super) fn write_video(
    path: &Path,
    config: &PhoneConfig,
    frames: &FrameTimes,
    count: usize,
    oscillator: &Oscillator,
    light: &dyn FlashSource,
) -> Result<(), VideoError> {
    let camera = &config.camera;
    let shutter = RollingShutter {
        columns: camera.columns,
        rows: camera.rows,
        row_time_ns: camera.row_time_ns,
        exposure_ns: camera.exposure_ns as f64,
        ambient: camera.ambient,
        amplitude: camera.flash_amplitude,
        read_noise: camera.read_noise,
        seed: substream(config.seed, Stream::PhoneCamera, u64::MAX).bits(),
        ..RollingShutter::default()
    };
    let (width, height) = shutter.image_size();
    let settings = VideoSettings {
        width,
        height,
        frame_rate: 1e9 / camera.frame_period_ns,
        quality: Quality::RateFactor(camera.rate_factor),
    };
    let mut writer = Mp4Writer::create(path, settings)?;
    let at = |ns| oscillator.when_nanos(ns).unwrap_or(TrueTime::ZERO);
    let numbers: Vec<usize> = (0..count).collect();
    for batch in numbers.chunks(BATCH) {
        let images: Vec<GreyImage> = batch
            .par_iter()
            .map(|&n| {
                let flashes: Vec<Flash> = light
                    .flashes(at(frames.start_ns(n)), at(frames.end_ns(n)))
                    .into_iter()
                    .map(|flash| {
                        let start_ns = oscillator.nanos_at(flash.start);
                        Flash {
                            start_ns,
                            duration_ns: oscillator.nanos_at(flash.end) - start_ns,
                        }
                    })
                    .collect();
                let mut image = shutter.render(frames.start_ns(n), n as u64, &flashes);
                if camera.ball {
                    let half = 0.5 * camera.exposure_ns as f64;
                    let middle = |row: usize| {
                        let into = row as f64 * camera.row_time_ns + half;
                        at(frames.start_ns(n).saturating_add(into.round() as i64))
                    };
                    ball::into_phone(&mut image.pixels, width, height, middle);
                }
                image
            })
            .collect();
        for image in &images {
            writer.write(image)?;
        }
    }
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Seed;

    fn frames() -> FrameTimes {
        FrameTimes::new(&PhoneConfig::draw(Seed(5)), 0, 4_000_000_000_000)
    }

    #[test]
    fn counts_complete_frames_exactly() {
        let frames = frames();
        assert_eq!(frames.complete_at(frames.end_ns(0) - 1), 0);
        for n in [0, 1, 59, 1000, 54_321] {
            assert_eq!(frames.complete_at(frames.end_ns(n)), n + 1);
            assert_eq!(frames.complete_at(frames.end_ns(n) - 1), n);
        }
    }

    #[test]
    fn the_phase_is_the_stamp_of_frame_sixty() {
        let frames = frames();
        let (phase, duration) = frames.phase();
        let stamps = frames.stamps(2000);
        assert_eq!(phase, stamps[60]);
        let mean: f64 = stamps[..60]
            .windows(2)
            .map(|p| (p[1] - p[0]) as f64)
            .sum::<f64>()
            / 59.0;
        assert!((duration - mean).abs() < 1e-6);
        // Jitter of 1 µs, no drift.
        let errors = (0..2000).map(|n| (stamps[n] - frames.start_ns(n)) as f64);
        let rms = (errors.map(|e| e * e).sum::<f64>() / 2000.0).sqrt();
        assert!((900.0..1100.0).contains(&rms), "{rms}");
    }

    #[test]
    fn recordings_have_phases_of_their_own() {
        let config = PhoneConfig::draw(Seed(5));
        let first = |recording| FrameTimes::new(&config, recording, 0).start_ns(0);
        assert_eq!(first(0), first(0));
        assert_ne!(first(0), first(1));
        assert!((250_000_000..700_000_000).contains(&first(0)));
    }
}
