//! Views of one real motion: the board's recording of the real twist in the Python package,
//! smoothed, as other gyroscopes would have recorded it, each with its own mounting, samples,
//! noise and clock. The motion is real; the rest is simulated, so that the true offset is known.

use nalgebra::{Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use twist_sync::GyroTrack;
use twist_sync::interpolant::{Uneven, Vec3};

use super::{direction, rotation};

/// The board's recording: seconds, rad/s about x, y, z.
const RECORDED: &str =
    include_str!("../../../sync/twist-sync-python/python/twist_sync/example/mcu_gyro_data.csv");
/// Samples of each of three moving averages: −3 dB at 11 Hz, above the motion of a hand.
const AVERAGED: usize = 15;

/// A real motion: angular rates over time.
#[derive(Debug, Clone)]
pub struct RealMotion {
    t: Vec<f64>,
    w: Vec<Vec3>,
}

impl RealMotion {
    /// Returns the real twist, from its first sample on.
    #[must_use]
    pub fn twist() -> Self {
        let row = |line: &str| -> Option<[f64; 4]> {
            let numbers = line.split(',').map(|x| x.trim().parse().ok());
            numbers.collect::<Option<Vec<f64>>>()?.try_into().ok()
        };
        let rows: Vec<[f64; 4]> = RECORDED.lines().filter_map(row).collect();
        let mut w: Vec<Vec3> = rows.iter().map(|r| [r[1], r[2], r[3]]).collect();
        let mut t: Vec<f64> = rows.iter().map(|r| r[0] - rows[0][0]).collect();
        for _ in 0..3 {
            let mean = |near: &[Vec3]| -> Vec3 {
                std::array::from_fn(|axis| {
                    near.iter().map(|v| v[axis]).sum::<f64>() / AVERAGED as f64
                })
            };
            w = w.windows(AVERAGED).map(mean).collect();
            t = t[AVERAGED / 2..t.len() - AVERAGED / 2].to_vec();
        }
        Self { t, w }
    }

    /// Returns the length of the motion in seconds.
    #[must_use]
    pub fn length_s(&self) -> f64 {
        self.t[self.t.len() - 1] - self.t[0]
    }

    /// Returns the rates at times in seconds from its begin, in order. Times beyond its end are
    /// left out.
    #[must_use]
    pub fn at(&self, times: &[f64]) -> Vec<Vec3> {
        let motion = Uneven::new(&self.t, &self.w);
        let times = times
            .iter()
            .filter(|t| (0.0..=self.length_s()).contains(*t));
        motion.map_or_else(Vec::new, |m| {
            times.map(|t| m.value(self.t[0] + t)).collect()
        })
    }

    /// Simulates the recording of a gyroscope at these times of the motion, with a mounting and
    /// bias of this seed and noise of `noise` rad/s. Its clock is zero at the motion's begin.
    #[must_use]
    pub fn view(&self, seed: u64, times: &[f64], noise: f64) -> GyroTrack {
        let (turn, bias) = mounting(seed);
        let mut rng = Pcg64::seed_from_u64(seed ^ 0x0153);
        let rates = self.at(times).into_iter().map(|rate| {
            let noise: Vector3<f64> = Vector3::from_fn(|_, _| {
                noise * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng)
            });
            (turn * Vector3::from(rate) + bias + noise).into()
        });
        let w: Vec<Vec3> = rates.collect();
        GyroTrack::from_seconds(&times[..w.len()], w)
    }

    /// Returns times of regular sampling over the motion, with a random phase.
    #[must_use]
    pub fn regular(&self, seed: u64, rate_hz: f64) -> Vec<f64> {
        let mut rng = Pcg64::seed_from_u64(seed ^ 0x5a3b);
        let phase = rng.random_range(0.0..1.0);
        let count = (self.length_s() * rate_hz) as usize;
        (0..count).map(|k| (k as f64 + phase) / rate_hz).collect()
    }
}

fn mounting(seed: u64) -> (Rotation3<f64>, Vector3<f64>) {
    let mut rng = Pcg64::seed_from_u64(seed ^ 0x3077);
    (rotation(&mut rng), direction(&mut rng) * 0.01)
}
