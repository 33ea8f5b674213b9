//! Interpolation by local polynomials, three channels at once.
//!
//! Between two neighbours runs the polynomial of odd degree through them and the
//! `(degree − 1) / 2` samples on either side (Lagrange); at the ends the nearest samples
//! that there are. Interpolation, not smoothing: noise passes at full height, and the
//! low-pass of [`crate::signal`] deals with it. Degree 5 at 500 Hz follows motion up to
//! 10 Hz to better than one part in 10⁷.

/// Three angular rates, x, y, z.
pub(crate) type Vec3 = [f64; 3];

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
pub(crate) struct Uneven<'a> {
    t: &'a [f64],
    y: &'a [Vec3],
    degree: usize,
}

impl<'a> Uneven<'a> {
    /// `None` if the times do not increase strictly, there are fewer than `degree + 1`
    /// samples, or the degree is not 1, 3, 5 or 7.
    pub(crate) fn new(t: &'a [f64], y: &'a [Vec3], degree: usize) -> Option<Self> {
        let increases = |w: &[f64]| w[1].partial_cmp(&w[0]) == Some(std::cmp::Ordering::Greater);
        let sound = t.len() == y.len() && t.windows(2).all(increases);
        (sound && is_offered(degree, t.len())).then_some(Self { t, y, degree })
    }

    /// First and last time.
    pub(crate) fn domain(&self) -> (f64, f64) {
        (self.t[0], self.t[self.t.len() - 1])
    }

    /// Value at `t`.
    pub(crate) fn value(&self, t: f64) -> Vec3 {
        let after = self.t.partition_point(|&x| x <= t);
        self.within(after.saturating_sub(1), t)
    }

    /// Values at `count` times from the first on, `step` apart.
    pub(crate) fn on_grid(&self, step: f64, count: usize) -> Vec<Vec3> {
        let mut left = 0;
        (0..count)
            .map(|k| {
                let t = self.t[0] + k as f64 * step;
                while left + 1 < self.t.len() && self.t[left + 1] <= t {
                    left += 1;
                }
                self.within(left, t)
            })
            .collect()
    }

    fn within(&self, left: usize, t: f64) -> Vec3 {
        let from = window(left, self.t.len(), self.degree);
        let (times, values) = (&self.t[from..], &self.y[from..]);
        // The compiler unrolls loops whose length it knows.
        match self.degree {
            1 => lagrange::<2>(times, values, t),
            3 => lagrange::<4>(times, values, t),
            5 => lagrange::<6>(times, values, t),
            _ => lagrange::<8>(times, values, t),
        }
    }
}

/// The polynomial through the first `N` samples, at `t`.
fn lagrange<const N: usize>(times: &[f64], values: &[Vec3], t: f64) -> Vec3 {
    let (near, values) = (&times[..N], &values[..N]);
    let mut value = [0.0; 3];
    for j in 0..N {
        let (mut above, mut below) = (1.0, 1.0);
        for m in (0..N).filter(|&m| m != j) {
            above *= t - near[m];
            below *= near[j] - near[m];
        }
        let weight = above / below;
        for axis in 0..3 {
            value[axis] += weight * values[j][axis];
        }
    }
    value
}

/// A piecewise polynomial through equidistant samples.
#[derive(Debug, Clone)]
pub(crate) struct Uniform {
    degree: usize,
    start: f64,
    step: f64,
    /// Per interval `degree + 1` Taylor coefficients about its left end, in steps.
    coefficients: Vec<Vec3>,
}

impl Uniform {
    /// Through the samples `start + k · step`; `None` if they are fewer than
    /// `degree + 1`, or the degree is not 1, 3, 5 or 7.
    pub(crate) fn new(start: f64, step: f64, y: &[Vec3], degree: usize) -> Option<Self> {
        if !is_offered(degree, y.len()) {
            return None;
        }
        let coefficients = match degree {
            1 => coefficients::<2>(y),
            3 => coefficients::<4>(y),
            5 => coefficients::<6>(y),
            _ => coefficients::<8>(y),
        };
        Some(Self {
            degree,
            start,
            step,
            coefficients,
        })
    }

    /// The coefficients of the interval at `t`, and the place in it in steps.
    fn at(&self, t: f64) -> (&[Vec3], f64) {
        let last = self.coefficients.len() / (self.degree + 1) - 1;
        let place = (t - self.start) / self.step;
        let left = (place.max(0.0) as usize).min(last);
        let from = left * (self.degree + 1);
        (
            &self.coefficients[from..=from + self.degree],
            place - left as f64,
        )
    }

    /// Value at `t`; outside of the samples the end polynomial is continued.
    pub(crate) fn value(&self, t: f64) -> Vec3 {
        let (c, x) = self.at(t);
        let mut v = [0.0; 3];
        for row in c.iter().rev() {
            for axis in 0..3 {
                v[axis] = v[axis] * x + row[axis];
            }
        }
        v
    }

    /// Value and first derivative at `t`.
    pub(crate) fn value_and_rate(&self, t: f64) -> (Vec3, Vec3) {
        let (c, x) = self.at(t);
        let (mut v, mut d) = ([0.0; 3], [0.0; 3]);
        for row in c.iter().rev() {
            for axis in 0..3 {
                d[axis] = d[axis] * x + v[axis];
                v[axis] = v[axis] * x + row[axis];
            }
        }
        (v, d.map(|d| d / self.step))
    }
}

/// Per interval the `N` Taylor coefficients of the polynomial through `N` samples.
fn coefficients<const N: usize>(y: &[Vec3]) -> Vec<Vec3> {
    let bases: Vec<_> = (0..N - 1).map(|place| taylor(N - 1, place)).collect();
    let mut out = Vec::with_capacity((y.len() - 1) * N);
    for left in 0..y.len() - 1 {
        let from = window(left, y.len(), N - 1);
        let (basis, near) = (&bases[left - from][..N], &y[from..from + N]);
        let mut own = [[0.0; 3]; N];
        for j in 0..N {
            for (power, sum) in own.iter_mut().enumerate() {
                for axis in 0..3 {
                    sum[axis] += basis[j][power] * near[j][axis];
                }
            }
        }
        out.extend_from_slice(&own);
    }
    out
}

/// Per sample of a window the coefficients (by rising power) of its Lagrange polynomial
/// about sample `place` of the window.
fn taylor(degree: usize, place: usize) -> Vec<[f64; MOST]> {
    (0..=degree)
        .map(|j| {
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
            polynomial
        })
        .collect()
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
            let uniform = Uniform::new(0.0, 0.01, &even, degree).unwrap();
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
        let s = Uniform::new(0.0, 0.002, &y, 5).unwrap();
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
        assert!(Uniform::new(0.0, 1.0, &y[..5], 5).is_none());
        let mut back = t.clone();
        back[3] = back[4];
        assert!(Uneven::new(&back, &y, 3).is_none());
        back[3] = f64::NAN;
        assert!(Uneven::new(&back, &y, 3).is_none());
    }
}
