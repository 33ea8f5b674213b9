//! Interpolating splines of odd degree on arbitrary sample times, three
//! channels at once.
//!
//! The spline is the B-spline interpolant with not-a-knot ends (de Boor, *A
//! Practical Guide to Splines*, ch. XIII): its knots are the sample times with
//! `(degree - 1) / 2` left out next to each end, so that it reproduces any
//! polynomial of that degree exactly. The collocation matrix is banded and
//! totally positive, therefore elimination without pivoting is stable. The
//! result is kept as one polynomial per sample interval, which makes value and
//! derivatives cheap to evaluate.
//!
//! Interpolation, not smoothing: noise passes at full height, and the low-pass
//! of [`super::signal`] deals with it. Degree 5 at 500 Hz follows motion up to
//! 10 Hz to better than one part in 10⁹.

/// Three angular rates, x, y, z.
pub(crate) type Vec3 = [f64; 3];

/// The largest degree offered; bounds the stack buffers.
const MAX_DEGREE: usize = 7;

/// A piecewise polynomial through the given samples.
#[derive(Debug, Clone)]
pub(crate) struct Spline {
    degree: usize,
    breaks: Vec<f64>,
    /// 1 / spacing if the breaks are equidistant.
    per_step: Option<f64>,
    /// Per interval `degree + 1` Taylor coefficients about its left end.
    coefficients: Vec<Vec3>,
}

impl Spline {
    /// Interpolates `y` at the strictly increasing times `t`.
    ///
    /// `degree` is 1, 3, 5 or 7. `None` if there are fewer than `degree + 1`
    /// samples, the times do not increase, or the degree is none of these.
    pub(crate) fn interpolate(t: &[f64], y: &[Vec3], degree: usize) -> Option<Self> {
        Self::build(t, y, degree, None)
    }

    /// Interpolates equidistant samples `start + k * step`.
    pub(crate) fn interpolate_uniform(
        start: f64,
        step: f64,
        y: &[Vec3],
        degree: usize,
    ) -> Option<Self> {
        let t: Vec<f64> = (0..y.len()).map(|k| start + k as f64 * step).collect();
        Self::build(&t, y, degree, Some(1.0 / step))
    }

    fn build(t: &[f64], y: &[Vec3], degree: usize, per_step: Option<f64>) -> Option<Self> {
        let n = t.len();
        if !matches!(degree, 1 | 3 | 5 | 7)
            || n != y.len()
            || n < degree + 1
            || t.windows(2)
                .any(|w| w[1].partial_cmp(&w[0]) != Some(std::cmp::Ordering::Greater))
        {
            return None;
        }
        let knots = not_a_knot(t, degree);
        let control = solve_collocation(t, y, &knots, degree)?;
        let coefficients = to_taylor(t, &knots, &control, degree);
        Some(Self {
            degree,
            breaks: t.to_vec(),
            per_step,
            coefficients,
        })
    }

    /// First and last time at which the spline is defined.
    pub(crate) fn domain(&self) -> (f64, f64) {
        (self.breaks[0], self.breaks[self.breaks.len() - 1])
    }

    fn interval(&self, t: f64) -> usize {
        let last = self.breaks.len() - 2;
        match self.per_step {
            Some(per_step) => (((t - self.breaks[0]) * per_step).max(0.0) as usize).min(last),
            None => self
                .breaks
                .partition_point(|&b| b <= t)
                .saturating_sub(1)
                .min(last),
        }
    }

    /// Value at `t`; outside the domain the end polynomial is continued.
    pub(crate) fn value(&self, t: f64) -> Vec3 {
        let i = self.interval(t);
        let dt = t - self.breaks[i];
        let c = &self.coefficients[i * (self.degree + 1)..(i + 1) * (self.degree + 1)];
        let mut v = c[self.degree];
        for row in c[..self.degree].iter().rev() {
            for axis in 0..3 {
                v[axis] = v[axis] * dt + row[axis];
            }
        }
        v
    }

    /// Value and first derivative at `t`.
    pub(crate) fn value_and_rate(&self, t: f64) -> (Vec3, Vec3) {
        let i = self.interval(t);
        let dt = t - self.breaks[i];
        let c = &self.coefficients[i * (self.degree + 1)..(i + 1) * (self.degree + 1)];
        let mut v = c[self.degree];
        let mut d = [0.0; 3];
        for row in c[..self.degree].iter().rev() {
            for axis in 0..3 {
                d[axis] = d[axis] * dt + v[axis];
                v[axis] = v[axis] * dt + row[axis];
            }
        }
        (v, d)
    }
}

/// Knot vector of the not-a-knot interpolant of odd degree.
fn not_a_knot(t: &[f64], degree: usize) -> Vec<f64> {
    let n = t.len();
    let skip = degree.div_ceil(2);
    let mut knots = Vec::with_capacity(n + degree + 1);
    knots.extend(std::iter::repeat_n(t[0], degree + 1));
    if n > 2 * skip {
        knots.extend_from_slice(&t[skip..n - skip]);
    }
    knots.extend(std::iter::repeat_n(t[n - 1], degree + 1));
    knots
}

/// Index `s` of the knot span with `knots[s] <= x < knots[s + 1]`, at or after `from`.
fn span(knots: &[f64], degree: usize, x: f64, from: usize) -> usize {
    let last = knots.len() - degree - 2;
    let mut s = from.max(degree);
    while s < last && knots[s + 1] <= x {
        s += 1;
    }
    s
}

/// The `degree + 1` basis functions that are not zero in span `s` (Cox-de Boor).
fn basis(knots: &[f64], degree: usize, s: usize, x: f64, out: &mut [f64; MAX_DEGREE + 1]) {
    let mut left = [0.0; MAX_DEGREE + 1];
    let mut right = [0.0; MAX_DEGREE + 1];
    out[0] = 1.0;
    for j in 1..=degree {
        left[j] = x - knots[s + 1 - j];
        right[j] = knots[s + j] - x;
        let mut saved = 0.0;
        for r in 0..j {
            let term = out[r] / (right[r + 1] + left[j - r]);
            out[r] = saved + right[r + 1] * term;
            saved = left[j - r] * term;
        }
        out[j] = saved;
    }
}

/// Solves the banded collocation system for the B-spline coefficients.
fn solve_collocation(t: &[f64], y: &[Vec3], knots: &[f64], degree: usize) -> Option<Vec<Vec3>> {
    let n = t.len();
    let half = degree; // bandwidth on either side, an upper bound
    let width = 2 * half + 1;
    let mut band = vec![0.0; n * width]; // band[i * width + (j + half - i)]
    let mut b = [0.0; MAX_DEGREE + 1];
    let mut s = degree;
    for (i, &x) in t.iter().enumerate() {
        s = span(knots, degree, x, s);
        basis(knots, degree, s, x, &mut b);
        for (k, &value) in b[..=degree].iter().enumerate() {
            let j = s - degree + k;
            if let Some(offset) = (j + half).checked_sub(i)
                && offset < width
            {
                band[i * width + offset] = value;
            }
        }
    }
    let mut rhs = y.to_vec();
    for i in 0..n {
        let pivot = band[i * width + half];
        if pivot.is_nan() || pivot.abs() < 1e-14 {
            return None;
        }
        for row in i + 1..n.min(i + half + 1) {
            let at = row * width + (i + half - row);
            let factor = band[at] / pivot;
            if factor == 0.0 {
                continue;
            }
            for j in i + 1..n.min(i + half + 1) {
                band[row * width + (j + half - row)] -= factor * band[i * width + (j + half - i)];
            }
            for axis in 0..3 {
                rhs[row][axis] -= factor * rhs[i][axis];
            }
        }
    }
    for i in (0..n).rev() {
        for j in i + 1..n.min(i + half + 1) {
            let a = band[i * width + (j + half - i)];
            for axis in 0..3 {
                rhs[i][axis] -= a * rhs[j][axis];
            }
        }
        let pivot = band[i * width + half];
        for value in &mut rhs[i] {
            *value /= pivot;
        }
    }
    Some(rhs)
}

/// Taylor coefficients about the left end of every sample interval.
fn to_taylor(t: &[f64], knots: &[f64], control: &[Vec3], degree: usize) -> Vec<Vec3> {
    let n = t.len();
    let mut out = vec![[0.0; 3]; (n - 1) * (degree + 1)];
    let mut s = degree;
    let mut b = [0.0; MAX_DEGREE + 1];
    for i in 0..n - 1 {
        let x = t[i];
        s = span(knots, degree, x, s);
        // Differences of the control points give the control points of the
        // derivatives, each of one degree less.
        let mut points = [[0.0; 3]; MAX_DEGREE + 1];
        points[..=degree].copy_from_slice(&control[s - degree..=s]);
        let mut factorial = 1.0;
        for order in 0..=degree {
            let p = degree - order;
            basis(knots, p, s, x, &mut b);
            let mut value = [0.0; 3];
            for (k, &weight) in b[..=p].iter().enumerate() {
                for axis in 0..3 {
                    value[axis] += weight * points[k][axis];
                }
            }
            if order > 0 {
                factorial *= order as f64;
            }
            for axis in 0..3 {
                out[i * (degree + 1) + order][axis] = value[axis] / factorial;
            }
            for k in 0..p {
                let span_width = knots[s + 1 + k] - knots[s + 1 + k - p];
                for axis in 0..3 {
                    points[k][axis] =
                        p as f64 * (points[k + 1][axis] - points[k][axis]) / span_width;
                }
            }
        }
    }
    out
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
        let t = uneven(40);
        for degree in [1, 3, 5, 7] {
            let f = |x: f64| (0..=degree).map(|p| (x - 0.1).powi(p as i32)).sum::<f64>();
            let y: Vec<Vec3> = t.iter().map(|&x| [f(x), -f(x), 2.0]).collect();
            let s = Spline::interpolate(&t, &y, degree).unwrap();
            for k in 0..300 {
                let x = t[0] + (t[39] - t[0]) * k as f64 / 299.0;
                let v = s.value(x);
                assert!((v[0] - f(x)).abs() < 1e-9, "degree {degree} at {x}");
                assert!((v[1] + f(x)).abs() < 1e-9);
                assert!((v[2] - 2.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn follows_a_sine_and_its_slope() {
        let n = 500;
        let y: Vec<Vec3> = (0..n)
            .map(|k| {
                let x = std::f64::consts::TAU * 5.0 * k as f64 * 0.002;
                [x.sin(), x.cos(), 0.0]
            })
            .collect();
        let s = Spline::interpolate_uniform(0.0, 0.002, &y, 5).unwrap();
        for k in 100..800 {
            let t = 0.001 * k as f64 + 0.0003;
            let w = std::f64::consts::TAU * 5.0;
            let (v, d) = s.value_and_rate(t);
            assert!((v[0] - (w * t).sin()).abs() < 1e-9);
            assert!((d[0] - w * (w * t).cos()).abs() < 1e-5);
            assert_eq!(s.value(t), v);
        }
    }

    #[test]
    fn refuses_bad_input() {
        let y = vec![[0.0; 3]; 8];
        let t: Vec<f64> = (0..8).map(f64::from).collect();
        assert!(Spline::interpolate(&t[..5], &y[..5], 5).is_none());
        assert!(Spline::interpolate(&t, &y, 4).is_none());
        let mut back = t.clone();
        back[3] = back[4];
        assert!(Spline::interpolate(&back, &y, 3).is_none());
        back[3] = f64::NAN;
        assert!(Spline::interpolate(&back, &y, 3).is_none());
    }
}
