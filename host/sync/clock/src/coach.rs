//! Prediction of a twist's accuracy while the twist is made.

/// Noise of both gyroscopes together in one sample of the board, rad/s: the
/// MPU-9150's 0.005 °/s/√Hz over 188 Hz, and the same of the phone's.
const NOISE: f64 = 1.7e-3;

/// Samples that are averaged before the slope of the motion is taken.
const BLOCK: usize = 10;

/// Predictor of a twist's uncertainty, fed with the gyroscope's samples as they arrive.
///
/// For a known motion ω(t) the bound of the offset is `σ² = n² / Σ |ω′|²` over the
/// samples, with `n` the noise of both gyroscopes in one sample (see the book,
/// "Sync math"). The slope is taken between means of ten samples, so that noise
/// adds little to it; the mean contribution of noise is subtracted.
#[derive(Clone, Debug, Default)]
pub struct Coach {
    block: Vec<(f64, [f64; 3])>,
    last: Option<(f64, [f64; 3])>,
    information: f64,
    squares: [f64; 3],
    count: u64,
    first: Option<f64>,
    latest: f64,
}

impl Coach {
    /// Adds a sample: its time in seconds and the angular rate about x, y, z in rad/s.
    pub fn add(&mut self, at: f64, rate: [f64; 3]) {
        self.first.get_or_insert(at);
        self.latest = at;
        self.count += 1;
        for (sum, value) in self.squares.iter_mut().zip(rate) {
            *sum += value * value;
        }
        self.block.push((at, rate));
        if self.block.len() < BLOCK {
            return;
        }
        let n = self.block.len() as f64;
        let mut mean = [0.0; 3];
        let mut time = 0.0;
        for (at, rate) in self.block.drain(..) {
            time += at / n;
            for (mean, value) in mean.iter_mut().zip(rate) {
                *mean += value / n;
            }
        }
        if let Some((before, rates)) = self.last {
            let step = time - before;
            // Blocks that do not follow each other say nothing about the slope.
            if step > 0.0 && step < 0.2 {
                let power: f64 = mean
                    .iter()
                    .zip(rates)
                    .map(|(now, before)| ((now - before) / step).powi(2))
                    .sum();
                let noise = 3.0 * 2.0 * NOISE * NOISE / n / (step * step);
                self.information += (power - noise).max(0.0) * n / (NOISE * NOISE);
            }
        }
        self.last = Some((time, mean));
    }

    /// Returns the expected 1-sigma of the offset from the motion so far, in seconds, or `None`
    /// if there was no motion yet.
    #[must_use]
    pub fn sigma_s(&self) -> Option<f64> {
        // Less information than this (a sigma of a millisecond) is no motion at all.
        (self.information > 1e6).then(|| self.information.sqrt().recip())
    }

    /// Returns the time from the first sample to the last, in seconds.
    #[must_use]
    pub fn elapsed_s(&self) -> f64 {
        self.first.map_or(0.0, |first| self.latest - first)
    }

    /// Returns the root mean square of each axis so far, in rad/s.
    #[must_use]
    pub fn rms(&self) -> [f64; 3] {
        let count = self.count.max(1) as f64;
        self.squares.map(|sum| (sum / count).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hand's twist: a few rad/s about three axes.
    fn twist(seconds: u32, scale: f64) -> Coach {
        let mut coach = Coach::default();
        for k in 0..seconds * 500 {
            let t = f64::from(k) / 500.0;
            let rate = [
                scale * (7.0 * t).sin(),
                scale * 0.7 * (5.0 * t).cos(),
                scale * 0.4 * (9.0 * t).sin(),
            ];
            coach.add(t, rate);
        }
        coach
    }

    #[test]
    fn the_expected_sigma_is_the_bound_and_falls_with_motion() {
        // Mean of |ω′|²: half of the squares of amplitude times frequency.
        let power =
            0.5 * ((3.0 * 7.0_f64).powi(2) + (2.1 * 5.0_f64).powi(2) + (1.2 * 9.0_f64).powi(2));
        let expected = NOISE / (power * 7.0 * 500.0).sqrt();
        let sigma = twist(7, 3.0).sigma_s().unwrap();
        assert!((sigma / expected - 1.0).abs() < 0.05, "{sigma} {expected}");
        // A few µs, as the simulated twists of the sync bench give.
        assert!((1e-6..4e-6).contains(&sigma), "{sigma}");
        assert!(twist(2, 3.0).sigma_s().unwrap() > sigma);
        assert!(twist(7, 0.3).sigma_s().unwrap() > 8.0 * sigma);
    }

    #[test]
    fn rest_is_no_motion() {
        let mut coach = Coach::default();
        for k in 0..5_000 {
            // Noise of the size of the sensor's.
            let noise = if k % 2 == 0 { 1e-3 } else { -1e-3 };
            coach.add(f64::from(k) * 2e-3, [noise, -noise, noise]);
        }
        assert_eq!(coach.sigma_s(), None);
        assert!(coach.rms().iter().all(|rms| *rms < 2e-3));
    }
}
