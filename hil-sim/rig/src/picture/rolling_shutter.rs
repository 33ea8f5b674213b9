//! Frames of a rolling-shutter camera that looks at re-transmitted infrared strobes.
//!
//! The light of a time-of-flight camera's flashes reaches the phone as visible
//! light (a photodiode drives an LED strip). Row `r` of a frame is exposed from
//! `frame_start + r · row_time` for `exposure`, so every flash paints a bright
//! band whose place in the image says when the flash came. This module renders
//! such frames from the exact flash times: the ground truth of every test of the
//! evaluation, and the picture that the simulated phone delivers.
//!
//! Brightness of a pixel, in grey levels before quantisation:
//!
//! ```text
//! v(r, c) · [ ambient(r) · texture(r) + amplitude · Σ overlap(row r, flash k) / duration_k ]
//! ```
//!
//! with the lens' light fall-off `v`, room light that may flicker with the
//! mains (its exact mean over the row's exposure), and the share of each flash
//! that falls into the row's exposure. An optional tone curve follows, then
//! Gaussian noise (read noise and shot noise), then rounding to 8 bits. The
//! camera's own linear black level is zero.
//!
//! Limits: the LED switches instantly (no rise time), light falls evenly on the
//! sensor apart from the fall-off, and all columns of a row share one exposure.
//! Times are integer nanoseconds of the camera's own clock; nothing here knows
//! of other clocks.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// One flash of light, in nanoseconds of the camera's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flash {
    /// When the light goes on.
    pub start_ns: i64,
    /// For how long it stays on.
    pub duration_ns: i64,
}

/// The flashes of one exposure of a time-of-flight camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FlashTrain {
    /// Number of flashes.
    pub count: u32,
    /// From the start of one flash to the start of the next.
    pub pitch_ns: i64,
    /// Length of one flash.
    pub duration_ns: i64,
}

impl FlashTrain {
    /// Azure Kinect, NFOV unbinned: 9 flashes of 125 µs, 1,450 µs apart.
    pub const NFOV: Self = Self {
        count: 9,
        pitch_ns: 1_575_000,
        duration_ns: 125_000,
    };

    /// From the start of the first flash to the middle of the middle one: the
    /// centre of the depth camera's exposure.
    pub const fn center_offset_ns(&self) -> i64 {
        ((self.count as i64 - 1) * self.pitch_ns + self.duration_ns) / 2
    }

    /// The flashes of an exposure whose first flash starts at `first_ns`.
    pub(crate) fn starting_at(&self, first_ns: i64) -> impl Iterator<Item = Flash> + use<> {
        let Self {
            count,
            pitch_ns,
            duration_ns,
        } = *self;
        (0..i64::from(count)).map(move |k| Flash {
            start_ns: first_ns + k * pitch_ns,
            duration_ns,
        })
    }

    /// The flashes of an exposure centred at `center_ns`.
    pub fn centered_at(&self, center_ns: i64) -> impl Iterator<Item = Flash> + use<> {
        self.starting_at(center_ns - self.center_offset_ns())
    }
}

/// Room light that follows the mains: `1 + depth · sin(2π · frequency · t + phase)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flicker {
    /// Frequency of the light, twice that of the mains: 100 or 120 Hz.
    pub frequency_hz: f64,
    /// Relative amplitude, 0 to 1.
    pub depth: f64,
    /// Phase at time zero, in radians.
    pub phase_rad: f64,
}

impl Flicker {
    /// Mean of the light's factor over `[start, start + length]`, in seconds.
    fn mean(&self, start_s: f64, length_s: f64) -> f64 {
        let w = std::f64::consts::TAU * self.frequency_hz;
        let half = 0.5 * w * length_s;
        let sinc = if half.abs() < 1e-9 {
            1.0
        } else {
            half.sin() / half
        };
        1.0 + self.depth * sinc * (w * (start_s + 0.5 * length_s) + self.phase_rad).sin()
    }
}

/// Direction of the sensor's rows in the delivered image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Readout {
    /// The first row is the image's top row.
    #[default]
    TopToBottom,
    /// The first row is the image's bottom row.
    BottomToTop,
    /// The first row is the image's left column.
    LeftToRight,
    /// The first row is the image's right column.
    RightToLeft,
}

/// A rolling-shutter camera and the light it sees.
#[derive(Debug, Clone, PartialEq)]
pub struct RollingShutter {
    /// Pixels in a sensor row.
    pub columns: usize,
    /// Sensor rows, read one after the other.
    pub rows: usize,
    /// From the start of exposure of one row to that of the next, nanoseconds.
    pub row_time_ns: f64,
    /// Exposure of each row, nanoseconds.
    pub exposure_ns: f64,
    /// Grey level of the room light in the middle of the image.
    pub ambient: f64,
    /// Light lost in the image's corners, 0 (none) to 1 (black corners).
    pub vignetting: f64,
    /// Mains flicker of the room light.
    pub flicker: Option<Flicker>,
    /// Grey levels that one flash adds to a row that sees the whole of it.
    pub amplitude: f64,
    /// Relative standard deviation of a fixed row-by-row texture of the scene.
    pub texture: f64,
    /// Read noise of a pixel, standard deviation in grey levels.
    pub read_noise: f64,
    /// Shot noise: variance of a pixel per grey level of light.
    pub shot_noise: f64,
    /// Tone curve: `255 · (x / 255)^(1 / gamma)`. 1 is a linear camera.
    pub gamma: f64,
    /// Direction of the sensor's rows in the image.
    pub readout: Readout,
    /// Seed of the texture and of the noise.
    pub seed: u64,
}

impl Default for RollingShutter {
    /// The published rig's phone: 1,920 × 1,080, 10.2 µs a row, 125 µs of exposure.
    fn default() -> Self {
        Self {
            columns: 1920,
            rows: 1080,
            row_time_ns: 10_200.0,
            exposure_ns: 125_000.0,
            ambient: 30.0,
            vignetting: 0.4,
            flicker: None,
            amplitude: 60.0,
            texture: 0.0,
            read_noise: 1.0,
            shot_noise: 0.02,
            gamma: 1.0,
            readout: Readout::TopToBottom,
            seed: 1,
        }
    }
}

/// An 8-bit grey image, row by row without gaps.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct GreyImage {
    /// Pixels in an image row.
    pub width: usize,
    /// Image rows.
    pub height: usize,
    /// `width · height` grey levels.
    pub pixels: Vec<u8>,
}

impl RollingShutter {
    /// Width and height of the delivered image.
    pub fn image_size(&self) -> (usize, usize) {
        match self.readout {
            Readout::TopToBottom | Readout::BottomToTop => (self.columns, self.rows),
            Readout::LeftToRight | Readout::RightToLeft => (self.rows, self.columns),
        }
    }

    /// From the start of a frame (the start of exposure of its first row) to the
    /// middle of exposure of its middle row, nanoseconds. The middle lies between
    /// the two middle rows when their number is even.
    pub fn middle_offset_ns(&self) -> f64 {
        0.5 * (self.rows as f64 - 1.0) * self.row_time_ns + 0.5 * self.exposure_ns
    }

    /// Light of each sensor row in the middle column: grey levels before fall-off,
    /// tone curve, noise and rounding.
    ///
    /// `flashes` may hold any flashes in any order; those outside the frame add
    /// nothing. Returns (room light, flash light) of every row.
    pub(crate) fn row_light(&self, frame_start_ns: i64, flashes: &[Flash]) -> Vec<(f64, f64)> {
        let texture = self.row_texture();
        // Relative to the frame's start, so that f64 keeps sub-nanosecond steps.
        let relative: Vec<(f64, f64)> = flashes
            .iter()
            .filter(|f| f.duration_ns > 0)
            .map(|f| {
                let start = f.start_ns.saturating_sub(frame_start_ns) as f64;
                (start, start + f.duration_ns as f64)
            })
            .collect();
        (0..self.rows)
            .map(|r| {
                let begin = r as f64 * self.row_time_ns;
                let end = begin + self.exposure_ns;
                let flash: f64 = relative
                    .iter()
                    .map(|&(on, off)| (end.min(off) - begin.max(on)).max(0.0) / (off - on))
                    .sum();
                let flicker = self.flicker.map_or(1.0, |f| {
                    f.mean(
                        (frame_start_ns as f64 + begin) * 1e-9,
                        self.exposure_ns * 1e-9,
                    )
                });
                (
                    self.ambient * flicker * texture.get(r).copied().unwrap_or(1.0),
                    self.amplitude * flash,
                )
            })
            .collect()
    }

    /// Renders one frame.
    ///
    /// `frame_start_ns` is the start of exposure of the first sensor row;
    /// `frame_number` only selects the noise, so that a frame rendered twice is
    /// the same to the byte.
    pub fn render(&self, frame_start_ns: i64, frame_number: u64, flashes: &[Flash]) -> GreyImage {
        let (width, height) = self.image_size();
        let mut pixels = vec![0; width * height];
        let light = self.row_light(frame_start_ns, flashes);
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(frame_number.wrapping_add(1));
        let column_term: Vec<f64> = (0..self.columns)
            .map(|c| centred(c, self.columns).powi(2))
            .collect();
        let noisy = self.read_noise > 0.0 || self.shot_noise > 0.0;
        for (r, &(room, flash)) in light.iter().enumerate() {
            let row_term = centred(r, self.rows).powi(2);
            for (c, column_term) in column_term.iter().enumerate() {
                // Half of the squared distance: 1 in the corners.
                let fall_off = 1.0 - self.vignetting * 0.5 * (row_term + column_term);
                let mut grey = fall_off * (room + flash);
                if noisy {
                    let variance =
                        self.read_noise * self.read_noise + self.shot_noise * grey.max(0.0);
                    let n: f64 = StandardNormal.sample(&mut rng);
                    grey += variance.sqrt() * n;
                }
                if self.gamma != 1.0 {
                    grey = 255.0 * (grey.max(0.0) / 255.0).powf(1.0 / self.gamma);
                }
                let at = match self.readout {
                    Readout::TopToBottom => r * width + c,
                    Readout::BottomToTop => (height - 1 - r) * width + c,
                    Readout::LeftToRight => c * width + r,
                    Readout::RightToLeft => c * width + (width - 1 - r),
                };
                if let Some(pixel) = pixels.get_mut(at) {
                    // `as` saturates: that is the clipping of the sensor.
                    *pixel = grey.round() as u8;
                }
            }
        }
        GreyImage {
            width,
            height,
            pixels,
        }
    }

    fn row_texture(&self) -> Vec<f64> {
        if self.texture <= 0.0 {
            return Vec::new();
        }
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        (0..self.rows)
            .map(|_| {
                let n: f64 = StandardNormal.sample(&mut rng);
                (1.0 + self.texture * n).max(0.0)
            })
            .collect()
    }
}

/// Place of an index in `-1..=1` over `n` samples.
fn centred(index: usize, n: usize) -> f64 {
    let half = 0.5 * (n as f64 - 1.0);
    if half > 0.0 {
        (index as f64 - half) / half
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clean() -> RollingShutter {
        RollingShutter {
            columns: 8,
            vignetting: 0.0,
            read_noise: 0.0,
            shot_noise: 0.0,
            ..RollingShutter::default()
        }
    }

    /// The light that a flash leaves in all rows together does not depend on when
    /// the flash comes: amplitude · exposure / row time.
    #[test]
    fn light_of_a_flash_is_conserved() {
        let camera = clean();
        let whole = camera.amplitude * camera.exposure_ns / camera.row_time_ns;
        for start_ns in [1_000_000, 1_003_333, 5_007_777] {
            let flash = Flash {
                start_ns,
                duration_ns: 125_000,
            };
            let sum: f64 = camera.row_light(0, &[flash]).iter().map(|l| l.1).sum();
            // The sum over rows approximates an integral: a ramp's end falls
            // between two rows.
            assert!(
                (sum - whole).abs() < 1e-2 * whole,
                "{sum} grey levels instead of {whole}"
            );
        }
    }

    #[test]
    fn a_centred_train_is_symmetric_about_the_middle_row() {
        let camera = clean();
        let center = 7_000_000_000 + camera.middle_offset_ns() as i64;
        let flashes: Vec<Flash> = FlashTrain::NFOV.centered_at(center).collect();
        let light = camera.row_light(7_000_000_000, &flashes);
        for r in 0..camera.rows {
            let (a, b) = (light[r].1, light[camera.rows - 1 - r].1);
            assert!((a - b).abs() < 1e-2, "row {r}: {a} and {b}");
        }
        let brightest = light.iter().map(|l| l.1).fold(0.0, f64::max);
        // The two middle rows are half a row off the flash.
        let expected = camera.amplitude * (1.0 - 0.5 * 10.2 / 125.0);
        assert!((light[539].1 - expected).abs() < 0.01);
        assert!(brightest <= camera.amplitude);
    }

    #[test]
    fn noise_is_repeatable_and_differs_between_frames() {
        let camera = RollingShutter {
            columns: 32,
            rows: 64,
            ..RollingShutter::default()
        };
        let a = camera.render(0, 3, &[]);
        assert_eq!(a, camera.render(0, 3, &[]));
        assert_ne!(a, camera.render(0, 4, &[]));
    }

    #[test]
    fn noise_has_the_stated_variance() {
        let camera = RollingShutter {
            columns: 200,
            rows: 200,
            ambient: 100.0,
            vignetting: 0.0,
            read_noise: 2.0,
            shot_noise: 0.05,
            ..RollingShutter::default()
        };
        let image = camera.render(0, 0, &[]);
        let n = image.pixels.len() as f64;
        let mean = image.pixels.iter().map(|&p| f64::from(p)).sum::<f64>() / n;
        let variance = image
            .pixels
            .iter()
            .map(|&p| (f64::from(p) - mean).powi(2))
            .sum::<f64>()
            / n;
        // Read 4, shot 5, rounding 1/12.
        assert!((mean - 100.0).abs() < 0.1, "mean {mean}");
        assert!((variance - 9.083).abs() < 0.3, "variance {variance}");
    }

    #[test]
    fn flicker_averages_to_one_over_a_period() {
        let flicker = Flicker {
            frequency_hz: 100.0,
            depth: 0.5,
            phase_rad: 0.3,
        };
        assert!((flicker.mean(0.123, 0.01) - 1.0).abs() < 1e-12);
        assert!((flicker.mean(0.0, 1e-6) - (1.0 + 0.5 * 0.3f64.sin())).abs() < 1e-3);
    }
}
