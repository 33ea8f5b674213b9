//! Interpolation by local polynomials, three channels at once.
//!
//! Between two neighbours runs the polynomial of odd degree through them and the
//! `(degree − 1) / 2` samples on either side (Lagrange); at the ends the nearest samples
//! that there are. Interpolation, not smoothing: noise passes at full height, and the
//! low-pass of [`crate::signal`] deals with it. Degree 5 at 500 Hz follows motion up to
//! 10 Hz to better than one part in 10⁷.

/// Three angular rates, x, y, z.
pub type Vec3 = [f64; 3];

/// Most samples of a polynomial: degree 7.
const MOST: usize = 8;

fn is_offered(degree: usize, samples: usize) -> bool {
    matches!(degree, 1 | 3 | 5 | 7) && samples > degree
}

/// First of the samples whose polynomial runs between sample `left` and the next.
fn window(left: usize, samples: usize, degree: usize) -> usize {
    left.saturating_sub((degree - 1) / 2)
        .min(samples - degree - 1)
}

/// Samples at uneven times.
#[derive(Debug, Clone, Copy)]
pub struct Uneven<'a> {
    t: &'a [f64],
    y: &'a [Vec3],
    degree: usize,
}

impl<'a> Uneven<'a> {
    /// `None` if the times do not increase strictly, there are fewer than `degree + 1`
    /// samples, or the degree is not 1, 3, 5 or 7.
    pub fn new(t: &'a [f64], y: &'a [Vec3], degree: usize) -> Option<Self> {
        let increases = |w: &[f64]| w[1].partial_cmp(&w[0]) == Some(std::cmp::Ordering::Greater);
        let sound = t.len() == y.len() && t.windows(2).all(increases);
        (sound && is_offered(degree, t.len())).then_some(Self { t, y, degree })
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

    /// Values at `count` times from the first on, `step` apart.
    pub fn on_grid(&self, step: f64, count: usize) -> Vec<Vec3> {
        let mut values = Vec::with_capacity(count);
        let times = (0..count).map(|k| self.t[0] + k as f64 * step);
        self.swept(0, times, |v| values.push(v));
        values
    }

    /// Values at rising times, of which the first is not before sample `left`.
    fn swept(&self, left: usize, times: impl Iterator<Item = f64>, each: impl FnMut(Vec3)) {
        // The compiler unrolls loops whose length it knows.
        match self.degree {
            1 => self.swept_by::<2>(left, times, each),
            3 => self.swept_by::<4>(left, times, each),
            5 => self.swept_by::<6>(left, times, each),
            _ => self.swept_by::<8>(left, times, each),
        }
    }

    fn swept_by<const N: usize>(
        &self,
        mut left: usize,
        times: impl Iterator<Item = f64>,
        mut each: impl FnMut(Vec3),
    ) {
        let samples = self.t.len();
        let first = window(left, samples, N - 1);
        let mut newton = Newton::<N>::from(first);
        for t in times {
            while left + 1 < samples && self.t[left + 1] <= t {
                left += 1;
            }
            while newton.next < window(left, samples, N - 1) + N {
                newton.take(first, self.t, self.y);
            }
            each(newton.value(self.t, t));
        }
    }
}

/// The polynomial through the last `N` samples that were taken, in Newton's form: the
/// next sample costs one row of the divided differences.
struct Newton<const N: usize> {
    next: usize,
    /// Divided differences of the last 1, 2 .. `N` samples.
    differences: [Vec3; N],
}

impl<const N: usize> Newton<N> {
    const fn from(first: usize) -> Self {
        Self {
            next: first,
            differences: [[0.0; 3]; N],
        }
    }

    /// Takes the next sample; the first one was number `first`.
    fn take(&mut self, first: usize, t: &[f64], y: &[Vec3]) {
        let k = self.next;
        self.next += 1;
        let mut now = y[k];
        for order in 1..=(k - first).min(N - 1) {
            let scale = 1.0 / (t[k] - t[k - order]);
            let before = std::mem::replace(&mut self.differences[order - 1], now);
            for axis in 0..3 {
                now[axis] = (now[axis] - before[axis]) * scale;
            }
        }
        self.differences[(k - first).min(N - 1)] = now;
    }

    fn value(&self, times: &[f64], t: f64) -> Vec3 {
        let times = &times[self.next - N..self.next];
        let mut value = self.differences[N - 1];
        for order in (0..N - 1).rev() {
            let distance = t - times[N - 1 - order];
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
    degree: usize,
    start: f64,
    step: f64,
    y: Vec<Vec3>,
    /// For each place that an interval may have in its window.
    bases: Vec<Basis>,
}

/// By rising power of the place in the interval, in steps: the coefficients of the
/// samples' Lagrange polynomials.
type Basis = [[f64; MOST]; MOST];

impl Uniform {
    /// Through the samples `start + k · step`; `None` if they are fewer than
    /// `degree + 1`, or the degree is not 1, 3, 5 or 7.
    pub fn new(start: f64, step: f64, y: Vec<Vec3>, degree: usize) -> Option<Self> {
        is_offered(degree, y.len()).then(|| Self {
            degree,
            start,
            step,
            y,
            bases: (0..degree).map(|place| basis(degree, place)).collect(),
        })
    }

    /// First and last time.
    pub fn domain(&self) -> (f64, f64) {
        (
            self.start,
            self.start + (self.y.len() - 1) as f64 * self.step,
        )
    }

    /// Value at `t`; outside of the samples the end polynomial is continued.
    pub fn value(&self, t: f64) -> Vec3 {
        match self.degree {
            1 => self.near::<2>(t).value(),
            3 => self.near::<4>(t).value(),
            5 => self.near::<6>(t).value(),
            _ => self.near::<8>(t).value(),
        }
    }

    /// Value and first derivative at `t`.
    pub fn value_and_rate(&self, t: f64) -> (Vec3, Vec3) {
        let (value, rate) = match self.degree {
            1 => self.near::<2>(t).value_and_rate(),
            3 => self.near::<4>(t).value_and_rate(),
            5 => self.near::<6>(t).value_and_rate(),
            _ => self.near::<8>(t).value_and_rate(),
        };
        (value, rate.map(|d| d / self.step))
    }

    fn near<const N: usize>(&self, t: f64) -> Near<'_, N> {
        let place = (t - self.start) / self.step;
        let left = (place.max(0.0) as usize).min(self.y.len() - 2);
        let from = window(left, self.y.len(), N - 1);
        Near {
            y: &self.y[from..from + N],
            basis: &self.bases[left - from],
            x: place - left as f64,
        }
    }
}

/// The samples around a time.
struct Near<'a, const N: usize> {
    y: &'a [Vec3],
    basis: &'a Basis,
    /// Place in the interval, in steps.
    x: f64,
}

impl<const N: usize> Near<'_, N> {
    fn value(&self) -> Vec3 {
        let mut weights = [0.0; N];
        for row in self.basis[..N].iter().rev() {
            for j in 0..N {
                weights[j] = weights[j] * self.x + row[j];
            }
        }
        self.weighed(&weights)
    }

    fn value_and_rate(&self) -> (Vec3, Vec3) {
        let (mut weights, mut slopes) = ([0.0; N], [0.0; N]);
        for row in self.basis[..N].iter().rev() {
            for j in 0..N {
                slopes[j] = slopes[j] * self.x + weights[j];
                weights[j] = weights[j] * self.x + row[j];
            }
        }
        (self.weighed(&weights), self.weighed(&slopes))
    }

    fn weighed(&self, weights: &[f64; N]) -> Vec3 {
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
fn basis(degree: usize, place: usize) -> Basis {
    let mut basis = [[0.0; MOST]; MOST];
    for j in 0..=degree {
        let mut polynomial = [0.0; MOST];
        polynomial[0] = 1.0;
        for m in (0..=degree).filter(|&m| m != j) {
            // Times (x − (m − place)) / (j − m).
            let (root, scale) = (m as f64 - place as f64, j as f64 - m as f64);
            for power in (0..MOST).rev() {
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
        for degree in [1, 3, 5, 7] {
            let f = |x: f64| (0..=degree).map(|p| (x - 0.1).powi(p as i32)).sum::<f64>();
            let all = |x: f64| [f(x), -f(x), 2.0];
            let t = uneven(40);
            let y: Vec<Vec3> = t.iter().map(|&x| all(x)).collect();
            let uneven = Uneven::new(&t, &y, degree).unwrap();
            let even: Vec<Vec3> = (0..40).map(|k| all(0.01 * f64::from(k))).collect();
            let uniform = Uniform::new(0.0, 0.01, even, degree).unwrap();
            for k in 0..300 {
                let x = t[0] + (t[39] - t[0]) * f64::from(k) / 299.0;
                for v in [uneven.value(x), uniform.value(x)] {
                    for (value, expected) in v.iter().zip(all(x)) {
                        assert!((value - expected).abs() < 1e-9, "degree {degree} at {x}");
                    }
                }
            }
            let grid = uneven.on_grid(0.007, 50);
            assert!(
                grid.iter()
                    .enumerate()
                    .all(|(k, v)| { *v == uneven.value(t[0] + 0.007 * k as f64) })
            );
        }
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
        let s = Uniform::new(0.0, 0.002, y, 5).unwrap();
        for k in 100..800 {
            let t = 0.001 * f64::from(k) + 0.0003;
            let (v, d) = s.value_and_rate(t);
            assert!((v[0] - (w * t).sin()).abs() < 1e-8);
            assert!((d[0] - w * (w * t).cos()).abs() < 1e-5);
            assert_eq!(s.value(t), v);
        }
    }

    #[test]
    fn refuses_bad_input() {
        let y = vec![[0.0; 3]; 8];
        let t: Vec<f64> = (0..8).map(f64::from).collect();
        assert!(Uneven::new(&t[..5], &y[..5], 5).is_none());
        assert!(Uneven::new(&t, &y, 4).is_none());
        assert!(Uniform::new(0.0, 1.0, y[..5].to_vec(), 5).is_none());
        let mut back = t.clone();
        back[3] = back[4];
        assert!(Uneven::new(&back, &y, 3).is_none());
        back[3] = f64::NAN;
        assert!(Uneven::new(&back, &y, 3).is_none());
    }
}
