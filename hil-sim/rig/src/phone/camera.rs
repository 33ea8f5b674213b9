//! The phone's camera: the times and the content of its frames.

use std::path::Path;

use rayon::prelude::*;

use super::app::App;
use super::config::{CameraConfig, DARK, DARK_EVERY, EXPOSURE_SWING, PhoneConfig};
use super::substream;
use crate::clocks::oscillator::TrueTime;
use crate::picture::ball;
use crate::picture::rolling_shutter::{Flash, GreyImage, RollingShutter};
use crate::picture::video_writer::{Mp4Writer, Quality, VideoSettings};
use crate::random::{Random, Stream};

/// Number of the frame (from 0), of those that the app gets, whose timestamp is the phase.
const PHASE_FRAME: usize = 60;

/// Frames rendered in parallel before they go to the encoder, in order.
const BATCH: usize = 64;

/// The frames of one recording: their true times, and the times that the app gets. The
/// sensor's frames are a perfect grid, numbered from 0; the app may get some of them not
/// at all and some twice.
#[derive(Clone, Debug)]
pub struct FrameTimes {
    first_ns: i64,
    /// With the exposure and the frame period of this recording.
    camera: CameraConfig,
    jitter: Random,
    /// Frames that are lost and doubled.
    losses: Random,
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
        let mut losses = substream(config.seed, Stream::PhoneFrames, number);
        let mut camera = config.camera.clone();
        let shortest = camera.exposure_ns;
        if camera.longest_exposure_ns > shortest {
            let most = camera.longest_exposure_ns as f64 / shortest.max(1) as f64;
            let longer = shortest as f64 * (losses.uniform(0.0, most.ln())).exp();
            camera.exposure_ns = longer as u64;
        }
        let more = camera.exposure_ns - shortest;
        camera.frame_period_ns += camera.period_of_exposure * more as f64;
        Self {
            first_ns: request_ns.saturating_add(latency_ns),
            camera,
            jitter: random,
            losses,
        }
    }

    /// Exposure of each row in this recording, nanoseconds.
    #[must_use]
    pub fn exposure_ns(&self) -> u64 {
        self.camera.exposure_ns
    }

    /// Returns the endless sequence of frames that the app gets.
    fn delivered(&self) -> impl Iterator<Item = usize> + use<> {
        let (at_once, doubled) = (self.camera.lost_at_once.max(1), self.camera.doubled);
        let lost = self.camera.lost / f64::from(at_once);
        let mut random = self.losses.clone();
        let mut left = 0;
        (0..).flat_map(move |n| {
            let (begins, doubles) = (random.chance(lost), random.chance(doubled));
            if begins && left == 0 {
                left = at_once;
            }
            let is_lost = left > 0;
            left = left.saturating_sub(1);
            let times = match (is_lost, doubles) {
                (true, _) => 0,
                (false, true) => 2,
                (false, false) => 1,
            };
            std::iter::repeat_n(n, times)
        })
    }

    /// Numbers of the frames, of the first `count`, that the app gets, in its order: those of
    /// its timestamps and of its video.
    #[must_use]
    pub fn delivered_of(&self, count: usize) -> Vec<usize> {
        self.delivered().take_while(|&n| n < count).collect()
    }

    /// The frame whose timestamp is the phase.
    pub(super) fn phase_frame(&self) -> usize {
        self.delivered().nth(PHASE_FRAME).unwrap_or_default()
    }

    /// True start of exposure of the first row of frame `n`, in nanoseconds of
    /// the boot clock, without jitter.
    #[must_use]
    pub fn start_ns(&self, n: usize) -> i64 {
        let mut since = n as f64 * self.camera.frame_period_ns;
        if self.camera.dark_period_ns > 0.0 {
            let within = (n % DARK_EVERY).saturating_sub(DARK_EVERY - DARK);
            let dark = n / DARK_EVERY * DARK + within;
            since += dark as f64 * (self.camera.dark_period_ns - self.camera.frame_period_ns);
        }
        self.first_ns.saturating_add(since.round() as i64)
    }

    /// By how much the exposure of frame `n` is longer than that of the first, nanoseconds.
    fn longer_ns(&self, n: usize) -> f64 {
        let swing = self.camera.exposure_swing;
        if swing == 0.0 {
            return 0.0;
        }
        let turns = n as f64 / EXPOSURE_SWING as f64;
        let share = libm::sin(std::f64::consts::TAU * turns);
        self.camera.exposure_ns as f64 * swing * share
    }

    /// Frame period, in nanoseconds of the boot clock.
    #[must_use]
    pub fn period_ns(&self) -> f64 {
        self.camera.frame_period_ns
    }

    /// True middle of exposure of the middle row of frame `n`, in nanoseconds
    /// of the boot clock.
    #[must_use]
    pub fn middle_ns(&self, n: usize) -> i64 {
        let offset = self.camera.middle_offset_ns() + 0.5 * self.longer_ns(n);
        self.start_ns(n).saturating_add(offset.round() as i64)
    }

    /// When the last row of frame `n` has been exposed and read.
    pub(super) fn end_ns(&self, n: usize) -> i64 {
        let exposure_ns = self.camera.exposure_ns as f64 + self.longer_ns(n);
        let length = self.camera.readout_ns() + exposure_ns;
        self.start_ns(n).saturating_add(length.round() as i64)
    }

    /// Number of frames that were complete at `ns`.
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

    /// The timestamps that the app gets of the first `count` frames.
    #[must_use]
    pub fn stamps(&self, count: usize) -> Vec<i64> {
        let mut random = self.jitter.clone();
        let stamps: Vec<i64> = (0..count)
            .map(|n| {
                let jitter = self.camera.timestamp_jitter_ns * random.normal();
                self.start_ns(n).saturating_add(jitter.round() as i64)
            })
            .collect();
        let delivered = self.delivered_of(count).into_iter();
        delivered.map(|n| stamps[n]).collect()
    }

    /// Answer to `video_start`: phase, and mean of the durations before it.
    #[must_use]
    pub fn phase(&self) -> (i64, f64) {
        let stamps = self.stamps(self.phase_frame() + 1);
        let phase = stamps.get(PHASE_FRAME).copied().unwrap_or_default();
        let first = stamps.first().copied().unwrap_or_default();
        let last = stamps.get(PHASE_FRAME - 1).copied().unwrap_or_default();
        // A sum of integers over their number: as the app's mean of durations.
        (phase, (last - first) as f64 / (PHASE_FRAME - 1) as f64)
    }
}

/// Renders and encodes the first `count` frames into `path`.
///
/// Renders the video: the scene's even light and the flashes of `light`, each
/// on the rows that were exposed at that moment.
pub(super) fn write_video(
    path: &Path,
    app: &App,
    frames: &FrameTimes,
    count: usize,
) -> anyhow::Result<()> {
    let (config, oscillator, light) = (&app.config, &app.oscillator, &app.light);
    let shows_ball = app.shows_ball();
    let camera = &config.camera;
    let shutter = RollingShutter {
        columns: camera.columns,
        rows: camera.rows,
        row_time_ns: camera.row_time_ns,
        exposure_ns: frames.exposure_ns() as f64,
        seed: substream(config.seed, Stream::PhoneCamera, u64::MAX).bits(),
        ..RollingShutter::default()
    };
    let (width, height) = shutter.image_size();
    let settings = VideoSettings {
        width,
        height,
        frame_rate: 1e9 / frames.period_ns(),
        quality: Quality::RateFactor(18),
    };
    let mut writer = Mp4Writer::create(path, settings)?;
    let at = |ns| oscillator.when_nanos(ns).unwrap_or(TrueTime::ZERO);
    let numbers = frames.delivered_of(count);
    for batch in numbers.chunks(BATCH) {
        let images: Vec<GreyImage> = batch
            .par_iter()
            .map(|&n| {
                let span = (at(frames.start_ns(n)), at(frames.end_ns(n)));
                let flashes: Vec<Flash> = light
                    .iter()
                    .flat_map(|log| log.flashes(span.0, span.1))
                    .map(|flash| {
                        let start_ns = oscillator.nanos_at(flash.start);
                        Flash {
                            start_ns,
                            duration_ns: oscillator.nanos_at(flash.end) - start_ns,
                        }
                    })
                    .collect();
                let exposure_ns = shutter.exposure_ns + frames.longer_ns(n);
                let shutter = RollingShutter {
                    exposure_ns,
                    ..shutter
                };
                let mut image = shutter.render(frames.start_ns(n), n as u64, &flashes);
                if shows_ball {
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
    fn the_app_misses_some_frames_and_gets_some_twice() {
        let mut config = PhoneConfig::draw(Seed(5));
        config.camera.timestamp_jitter_ns = 0.0;
        (config.camera.lost, config.camera.doubled) = (0.02, 0.05);
        let frames = FrameTimes::new(&config, 0, 4_000_000_000_000);
        let stamps = frames.stamps(10_000);
        let numbers: Vec<usize> = frames.delivered().take_while(|&n| n < 10_000).collect();
        let of_grid: Vec<i64> = numbers.iter().map(|&n| frames.start_ns(n)).collect();
        assert_eq!(stamps, of_grid);
        let steps = |wanted| numbers.windows(2).filter(|p| p[1] - p[0] == wanted).count();
        assert!((400..600).contains(&steps(0)), "{}", steps(0));
        assert!((150..250).contains(&steps(2)), "{}", steps(2));
        assert_eq!(frames.phase().0, stamps[60]);
        assert_eq!(frames.phase().0, frames.start_ns(frames.phase_frame()));
    }

    #[test]
    fn exposures_differ_between_recordings_and_frames_may_follow_them() {
        let mut config = PhoneConfig::draw(Seed(5));
        config.camera.longest_exposure_ns = 10_000_000;
        config.camera.period_of_exposure = 1e-4;
        let of = |recording| FrameTimes::new(&config, recording, 0);
        let exposures: Vec<u64> = (0..200).map(|n| of(n).exposure_ns()).collect();
        assert!(exposures.iter().all(|e| (500_000..=10_000_000).contains(e)));
        let long = exposures.iter().filter(|&&e| e > 2_236_068).count();
        assert!(
            (70..130).contains(&long),
            "{long} above the middle of the logarithm"
        );
        for n in 0..3 {
            let more = (of(n).exposure_ns() - 500_000) as f64 * 1e-4;
            let found = of(n).period_ns() - config.camera.frame_period_ns;
            assert!((found - more).abs() < 1e-6);
        }
    }

    #[test]
    fn the_dark_makes_frames_longer_light_moves_their_middle_and_heat_loses_many() {
        let mut config = PhoneConfig::draw(Seed(5));
        let even = FrameTimes::new(&config, 0, 0);
        config.camera.dark_period_ns = 66e6;
        config.camera.exposure_swing = 0.5;
        (config.camera.lost, config.camera.lost_at_once) = (0.01, 20);
        let frames = FrameTimes::new(&config, 0, 0);
        assert_eq!(frames.start_ns(839), even.start_ns(839));
        let later = frames.start_ns(1_800) - even.start_ns(1_800);
        let longer = 66e6 - frames.period_ns();
        assert!((later as f64 - 120.0 * longer).abs() < 2.0, "{later}");
        // A quarter of the way the exposure is half as long again.
        let middle = |frames: &FrameTimes, n| frames.middle_ns(n) - frames.start_ns(n);
        assert_eq!(middle(&frames, 450) - middle(&even, 450), 125_000);
        for n in [0, 839, 845, 900, 30_000] {
            assert_eq!(frames.complete_at(frames.end_ns(n)), n + 1);
        }
        let numbers = frames.delivered_of(30_000);
        let gaps: Vec<usize> = numbers.windows(2).map(|p| p[1] - p[0] - 1).collect();
        assert!(gaps.iter().all(|gap| gap % 20 == 0));
        let lost: usize = gaps.iter().sum();
        assert!((100..600).contains(&lost), "{lost}");
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
