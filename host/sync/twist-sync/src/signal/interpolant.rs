//! Interpolation by local polynomials, three channels at once.
//!
//! Between two neighbours runs the polynomial through them and the nearest samples on either
//! side (Lagrange). This is interpolation, not smoothing: noise passes at full height, and the
//! low-pass of [`crate::signal`] deals with it. For raw samples the degree is 5: at 500 Hz it
//! follows motion up to 10 Hz to better than one part in 10⁷. For even, smooth ones the degree
//! is 3: at 2 ms the error is two parts in 10⁷ at 4 Hz, and symmetric in time, so that it does
//! not shift anything.

/// Three components, x, y, z; angular rates in rad/s.
pub type Vec3 = [f64; 3];

/// Samples of a polynomial through uneven samples.
const POINTS: usize = 6;
/// Samples of a polynomial through even, smooth ones.
const EVEN_POINTS: usize = 4;

/// First of the `points` samples whose polynomial runs between sample `left` and the next.
fn window(left: usize, samples: usize, points: usize) -> usize {
    left.saturating_sub(points / 2 - 1).min(samples - points)
}

/// A piecewise polynomial through samples at uneven times.
#[derive(Debug, Clone, Copy)]
pub struct Uneven<'a> {
    t: &'a [f64],
    y: &'a [Vec3],
}

impl<'a> Uneven<'a> {
    /// Interpolates samples `y` at times `t` in seconds. Returns `None` if the times do not
    /// increase strictly, or there are fewer than six samples.
    pub fn new(t: &'a [f64], y: &'a [Vec3]) -> Option<Self> {
        let increases = |w: &[f64]| w[1].partial_cmp(&w[0]) == Some(std::cmp::Ordering::Greater);
        let sound = t.len() == y.len() && t.windows(2).all(increases);
        (sound && t.len() >= POINTS).then_some(Self { t, y })
    }

    /// First and last time.
    pub fn domain(&self) -> (f64, f64) {
        (self.t[0], self.t[self.t.len() - 1])
    }

    /// Value at `t`.
    pub fn value(&self, t: f64) -> Vec3 {
        let after = self.t.partition_point(|&x| x <= t);
        let mut value = [0.0; 3];
        self.swept(after.saturating_sub(1), std::iter::once(t), |v| value = v);
        value
    }

    /// Returns the values at `count` times from the first sample on, `step` seconds apart.
    pub fn on_grid(&self, step: f64, count: usize) -> Vec<Vec3> {
        let mut values = Vec::with_capacity(count);
        let times = (0..count).map(|k| self.t[0] + k as f64 * step);
        self.swept(0, times, |v| values.push(v));
        values
    }

    /// Calls `each` with the values at increasing times, the first of which is not before
    /// sample `left`.
    fn swept(&self, mut left: usize, times: impl Iterator<Item = f64>, mut each: impl FnMut(Vec3)) {
        let samples = self.t.len();
        let first = window(left, samples, POINTS);
        let mut newton = Newton::from(first);
        for t in times {
            while left + 1 < samples && self.t[left + 1] <= t {
                left += 1;
            }
            while newton.next < window(left, samples, POINTS) + POINTS {
                newton.add(first, self.t, self.y);
            }
            each(newton.value(self.t, t));
        }
    }
}

/// The polynomial through the latest samples in Newton's form: the next sample costs one
/// row of the divided differences.
struct Newton {
    next: usize,
    /// Divided differences of the last 1, 2 .. [`POINTS`] samples.
    differences: [Vec3; POINTS],
}

impl Newton {
    const fn from(first: usize) -> Self {
        Self {
            next: first,
            differences: [[0.0; 3]; POINTS],
        }
    }

    /// Adds the next sample; the first one was number `first`.
    fn add(&mut self, first: usize, t: &[f64], y: &[Vec3]) {
        let k = self.next;
        self.next += 1;
        let mut now = y[k];
        for order in 1..=(k - first).min(POINTS - 1) {
            let scale = 1.0 / (t[k] - t[k - order]);
            let before = std::mem::replace(&mut self.differences[order - 1], now);
            for axis in 0..3 {
                now[axis] = (now[axis] - before[axis]) * scale;
            }
        }
        self.differences[(k - first).min(POINTS - 1)] = now;
    }

    fn value(&self, times: &[f64], t: f64) -> Vec3 {
        let times = &times[self.next - POINTS..self.next];
        let mut value = self.differences[POINTS - 1];
        for order in (0..POINTS - 1).rev() {
            let distance = t - times[POINTS - 1 - order];
            for axis in 0..3 {
                value[axis] = value[axis] * distance + self.differences[order][axis];
            }
        }
        value
    }
}

/// A piecewise polynomial through equidistant samples.
#[derive(Debug, Clone)]
pub struct Uniform {
    start: f64,
    step: f64,
    y: Vec<Vec3>,
    /// For each place that an interval may have in its window.
    bases: Vec<Basis>,
}

/// By rising power of the place in the interval, in steps: the coefficients of the
/// samples' Lagrange polynomials.
type Basis = [[f64; EVEN_POINTS]; EVEN_POINTS];

impl Uniform {
    /// Interpolates samples `y` at the times `start + k · step` in seconds. Returns `None` if
    /// there are fewer than four.
    pub fn new(start: f64, step: f64, y: Vec<Vec3>) -> Option<Self> {
        (y.len() >= EVEN_POINTS).then(|| Self {
            start,
            step,
            y,
            bases: (0..EVEN_POINTS - 1).map(basis).collect(),
        })
    }

    /// First and last time.
    pub fn domain(&self) -> (f64, f64) {
        (
            self.start,
            self.start + (self.y.len() - 1) as f64 * self.step,
        )
    }

    /// Returns the value at `t`; outside of the samples the end polynomial is continued.
    pub fn value(&self, t: f64) -> Vec3 {
        self.near(t).value()
    }

    /// Returns the value and its first derivative at `t`.
    pub fn value_and_rate(&self, t: f64) -> (Vec3, Vec3) {
        let (value, rate) = self.near(t).value_and_rate();
        (value, rate.map(|d| d / self.step))
    }

    fn near(&self, t: f64) -> Near<'_> {
        let place = (t - self.start) / self.step;
        let left = (place.max(0.0) as usize).min(self.y.len() - 2);
        let from = window(left, self.y.len(), EVEN_POINTS);
        Near {
            y: &self.y[from..from + EVEN_POINTS],
            basis: &self.bases[left - from],
            x: place - left as f64,
        }
    }
}

/// The samples around a time.
struct Near<'a> {
    y: &'a [Vec3],
    basis: &'a Basis,
    /// Place in the interval, in steps.
    x: f64,
}

impl Near<'_> {
    fn value(&self) -> Vec3 {
        let mut weights = [0.0; EVEN_POINTS];
        for row in self.basis.iter().rev() {
            for j in 0..EVEN_POINTS {
                weights[j] = weights[j] * self.x + row[j];
            }
        }
        self.weighed(&weights)
    }

    fn value_and_rate(&self) -> (Vec3, Vec3) {
        let (mut weights, mut slopes) = ([0.0; EVEN_POINTS], [0.0; EVEN_POINTS]);
        for row in self.basis.iter().rev() {
            for j in 0..EVEN_POINTS {
                slopes[j] = slopes[j] * self.x + weights[j];
                weights[j] = weights[j] * self.x + row[j];
            }
        }
        (self.weighed(&weights), self.weighed(&slopes))
    }

    fn weighed(&self, weights: &[f64; EVEN_POINTS]) -> Vec3 {
        let mut sum = [0.0; 3];
        for (weight, y) in weights.iter().zip(self.y) {
            for axis in 0..3 {
                sum[axis] += weight * y[axis];
            }
        }
        sum
    }
}

/// The polynomials of a window about its sample `place`.
fn basis(place: usize) -> Basis {
    let mut basis = [[0.0; EVEN_POINTS]; EVEN_POINTS];
    for j in 0..EVEN_POINTS {
        let mut polynomial = [0.0; EVEN_POINTS];
        polynomial[0] = 1.0;
        for m in (0..EVEN_POINTS).filter(|&m| m != j) {
            // Times (x − (m − place)) / (j − m).
            let (root, scale) = (m as f64 - place as f64, j as f64 - m as f64);
            for power in (0..EVEN_POINTS).rev() {
                let below = power.checked_sub(1).map_or(0.0, |p| polynomial[p]);
                polynomial[power] = (below - root * polynomial[power]) / scale;
            }
        }
        for (row, coefficient) in basis.iter_mut().zip(polynomial) {
            row[j] = coefficient;
        }
    }
    basis
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uneven(n: usize) -> Vec<f64> {
        (0..n)
            .map(|k| 0.01 * k as f64 + 0.003 * (k as f64 * 1.7).sin())
            .collect()
    }

    #[test]
    fn reproduces_polynomials_of_its_degree() {
        let f = |x: f64, degree| (0..=degree).map(|p| (x - 0.1).powi(p)).sum::<f64>();
        let all = |x: f64, degree| [f(x, degree), -f(x, degree), 2.0];
        let t = uneven(40);
        let y: Vec<Vec3> = t.iter().map(|&x| all(x, 5)).collect();
        let uneven = Uneven::new(&t, &y).unwrap();
        let even: Vec<Vec3> = (0..40).map(|k| all(0.01 * f64::from(k), 3)).collect();
        let uniform = Uniform::new(0.0, 0.01, even).unwrap();
        for k in 0..300 {
            let x = t[0] + (t[39] - t[0]) * f64::from(k) / 299.0;
            for (v, degree) in [(uneven.value(x), 5), (uniform.value(x), 3)] {
                for (value, expected) in v.iter().zip(all(x, degree)) {
                    assert!((value - expected).abs() < 1e-9, "at {x}");
                }
            }
        }
        let grid = uneven.on_grid(0.007, 50);
        let same = |(k, v): (usize, &Vec3)| *v == uneven.value(t[0] + 0.007 * k as f64);
        assert!(grid.iter().enumerate().all(same));
    }

    #[test]
    fn follows_a_sine_and_its_slope() {
        let w = std::f64::consts::TAU * 5.0;
        let y: Vec<Vec3> = (0..500)
            .map(|k| {
                let x = w * f64::from(k) * 0.002;
                [x.sin(), x.cos(), 0.0]
            })
            .collect();
        let s = Uniform::new(0.0, 0.002, y).unwrap();
        for k in 100..800 {
            let t = 0.001 * f64::from(k) + 0.0003;
            let (v, d) = s.value_and_rate(t);
            // Worked out: at most 3/128 of (w · step)⁴; of the slope 1/12 of w · (w · step)³.
            assert!((v[0] - (w * t).sin()).abs() < 4e-7);
            assert!((d[0] - w * (w * t).cos()).abs() < 6.6e-4);
            assert_eq!(s.value(t), v);
        }
    }

    #[test]
    fn refuses_bad_input() {
        let y = vec![[0.0; 3]; 8];
        let t: Vec<f64> = (0..8).map(f64::from).collect();
        assert!(Uneven::new(&t[..5], &y[..5]).is_none());
        assert!(Uniform::new(0.0, 1.0, y[..3].to_vec()).is_none());
        let mut back = t.clone();
        back[3] = back[4];
        assert!(Uneven::new(&back, &y).is_none());
        back[3] = f64::NAN;
        assert!(Uneven::new(&back, &y).is_none());
    }
}
