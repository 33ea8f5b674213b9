//! A fast view of a motion for a sensor that samples it often.
//!
//! A synthetic motion costs a microsecond a look, and a low-pass takes a dozen
//! looks a sample. [`MotionView`] evaluates it once a millisecond, on a fixed
//! grid of true time, and interpolates with a cubic through four points. For a
//! motion below 12 Hz the error is below 2e-7 (rad/s, m/s²), and 1e-5 at
//! the seams where a gesture begins to fade (a test measures it); the finest count is
//! 1.3e-4 rad/s. What is seen at a time does not depend on
//! what was looked at before.

use std::collections::VecDeque;
use std::sync::Arc;

use super::Motion;

/// Spacing of the grid's points, in seconds.
const STEP: f64 = 1e-3;
/// Points kept: half a second, more than the slowest low-pass looks at.
const KEPT: usize = 512;

/// A motion as one sensor sees it.
#[derive(Clone, Debug)]
pub struct MotionView {
    motion: Arc<Motion>,
    rate: SampleWindow,
    force: SampleWindow,
}

impl MotionView {
    /// Creates a view of `motion`.
    #[must_use]
    pub fn new(motion: Arc<Motion>) -> Self {
        Self {
            motion,
            rate: SampleWindow::default(),
            force: SampleWindow::default(),
        }
    }

    /// See [`Motion::angular_rate`].
    pub fn angular_rate(&mut self, t: f64) -> [f64; 3] {
        self.rate.at(t, |t| self.motion.angular_rate(t))
    }

    /// See [`Motion::specific_force`].
    pub fn specific_force(&mut self, t: f64) -> [f64; 3] {
        self.force.at(t, |t| self.motion.specific_force(t))
    }
}

/// Values at consecutive points of the grid.
#[derive(Clone, Debug, Default)]
struct SampleWindow {
    /// Index of the first value kept.
    first: i64,
    values: VecDeque<[f64; 3]>,
}

impl SampleWindow {
    fn at(&mut self, t: f64, signal: impl Fn(f64) -> [f64; 3]) -> [f64; 3] {
        let place = t / STEP;
        let before = place.floor();
        let x = place - before;
        let index = before as i64;
        self.cover(index - 1, index + 2, signal);
        let start = (index - 1 - self.first) as usize;
        let weights = [
            -x * (x - 1.0) * (x - 2.0) / 6.0,
            (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
            -(x + 1.0) * x * (x - 2.0) / 2.0,
            (x + 1.0) * x * (x - 1.0) / 6.0,
        ];
        let mut sum = [0.0; 3];
        for (weight, value) in weights.into_iter().zip(self.values.range(start..start + 4)) {
            for axis in 0..3 {
                sum[axis] += weight * value[axis];
            }
        }
        sum
    }

    /// Evaluates the points `from` to `to` that are missing.
    fn cover(&mut self, from: i64, to: i64, signal: impl Fn(f64) -> [f64; 3]) {
        let end = self.first + self.values.len() as i64;
        let far = KEPT as i64 / 2;
        if self.values.is_empty() || from < self.first - far || to > end + far {
            self.values.clear();
            self.first = from;
        }
        while from < self.first {
            self.first -= 1;
            self.values.push_front(signal(self.first as f64 * STEP));
        }
        while to >= self.first + self.values.len() as i64 {
            let index = self.first + self.values.len() as i64;
            self.values.push_back(signal(index as f64 * STEP));
        }
        while self.values.len() > KEPT && self.first < from {
            self.values.pop_front();
            self.first += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionSpec;
    use crate::motion::gesture::{FADE, Gesture};
    use crate::random::{Seed, Stream};

    #[test]
    fn the_view_is_the_motion() {
        for gesture in [Gesture::Rest, Gesture::Twist, Gesture::Walk] {
            let spec = MotionSpec::always(gesture);
            let motion = spec.build(Seed(3).stream(Stream::Motion));
            let mut view = MotionView::new(Arc::clone(&motion));
            let mut random = Seed(3).stream(Stream::Test);
            for k in 0..20_000 {
                // Mostly forward, with steps back and far jumps.
                let t = match k % 1000 {
                    999 => random.uniform(0.0, 100.0),
                    n => f64::from(n) * 1.7e-3 + random.uniform(-0.1, 0.1),
                };
                let near_a_seam = |seam: f64| (t - seam).abs() < 2.0 * STEP;
                let seam = near_a_seam(0.0) || near_a_seam(FADE);
                let limit = if seam { 1e-5 } else { 2e-7 };
                for (seen, real) in [
                    (view.angular_rate(t), motion.angular_rate(t)),
                    (view.specific_force(t), motion.specific_force(t)),
                ] {
                    for axis in 0..3 {
                        let error = (seen[axis] - real[axis]).abs();
                        assert!(error < limit, "{gesture:?} {t}: {error}");
                    }
                }
                assert!(view.rate.values.len() <= 2 * KEPT);
            }
        }
    }

    #[test]
    fn values_do_not_depend_on_the_order_of_requests() {
        let spec = MotionSpec::always(Gesture::Twist);
        let motion = spec.build(Seed(3).stream(Stream::Motion));
        let mut a = MotionView::new(Arc::clone(&motion));
        let mut b = MotionView::new(motion);
        b.angular_rate(50.0);
        b.angular_rate(2.0003);
        assert_eq!(a.angular_rate(2.0), b.angular_rate(2.0));
    }
}
