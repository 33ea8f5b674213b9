//! Robust fit of a slow function of time.
//!
//! The wander of a crystal is slow: within [`KNOT_SPACING`] it is a straight
//! line to far below a microsecond. The difference of two clocks is therefore modelled
//! as a line plus a piecewise linear function with a knot each 30 s, where
//! neighbouring knots are tied together weakly (20 µs, 0.7 ppm). The normal
//! equations are tridiagonal and are solved in one sweep, so that a fit costs as
//! much as reading the data. Outliers (beyond 4 robust sigmas) are removed by iteration.

use crate::time::{BoardNanos, DeviceNanos, PiecewiseMap};
use twist_sync::robust::Line;

/// Distance of the knots, ns.
pub(crate) const KNOT_SPACING: f64 = 30e9;
/// 1-sigma of the difference of neighbouring knots, ns.
const KNOT_TIE: f64 = 20e3;
/// Number of iterations of a robust fit.
const ITERATIONS: usize = 4;

/// Result of a fit `y ≈ a + b·x + knots(x)`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Smooth {
    /// Value at x = 0.
    pub(crate) a: f64,
    /// Slope.
    pub(crate) b: f64,
    knots: Vec<f64>,
}

impl Smooth {
    /// Returns the value at `x`.
    pub(crate) fn at(&self, x: f64) -> f64 {
        self.a + self.b * x + self.knot_value(x)
    }

    fn knot_value(&self, x: f64) -> f64 {
        let Some((left, weight)) = knot(x, self.knots.len()) else {
            return 0.0;
        };
        let right = self.knots.get(left + 1).copied().unwrap_or(0.0);
        self.knots[left] * (1.0 - weight) + right * weight
    }
}

/// Returns the knot to the left of `x` and the weight of the one to the right.
fn knot(x: f64, count: usize) -> Option<(usize, f64)> {
    if count < 2 {
        return None;
    }
    let place = (x / KNOT_SPACING).clamp(0.0, (count - 1) as f64);
    let left = (place as usize).min(count - 2);
    Some((left, place - left as f64))
}

/// Fits points (x ≥ 0 in ns, y in ns) whose noise is about `sigma`. Returns `None` for
/// fewer than three points.
pub(crate) fn smooth(points: &[(f64, f64)], sigma: f64) -> Option<Smooth> {
    if points.len() < 3 {
        return None;
    }
    let end = points.iter().fold(0.0_f64, |end, point| end.max(point.0));
    let count = (end / KNOT_SPACING).ceil() as usize + 1;
    let mut fit = Smooth {
        a: median(points.iter().map(|point| point.1).collect()),
        b: 0.0,
        knots: vec![0.0; count],
    };
    let mut used = points.to_vec();
    let mut distances = Vec::with_capacity(points.len());
    for _ in 0..ITERATIONS {
        (fit.a, fit.b) = line(&used);
        fit.knots = tied_knots(&used, fit.a, fit.b, sigma, count);
        distances.clear();
        distances.extend(points.iter().map(|&(x, y)| (y - fit.at(x)).abs()));
        let limit = 4.0 * (1.4826 * median(distances.clone())).max(sigma);
        let before = used.len();
        used.clear();
        let inside = points
            .iter()
            .zip(&distances)
            .filter(|(_, distance)| **distance <= limit);
        used.extend(inside.map(|(point, _)| *point));
        if used.len() < 3 || used.len() == before {
            break;
        }
    }
    Some(fit)
}

/// Returns the value at x = 0 and the slope of the least squares line.
fn line(points: &[(f64, f64)]) -> (f64, f64) {
    let line = Line::through(points);
    (line.at(0.0), line.slope)
}

/// Returns (a, b) of the least squares line `a + b·x`; `None` for fewer than three points.
pub(crate) fn straight(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    (points.len() >= 3).then(|| line(points))
}

/// Returns the slope of a line, with points beyond 4 robust sigmas removed by iteration.
pub(super) fn robust_line(points: &[(f64, f64)]) -> Option<f64> {
    let mut used = points.to_vec();
    let mut slope = None;
    for _ in 0..ITERATIONS {
        if used.len() < 3 {
            break;
        }
        let (a, b) = line(&used);
        slope = Some(b);
        let distance = |&(x, y): &(f64, f64)| (y - a - b * x).abs();
        let limit = 4.0 * 1.4826 * median(used.iter().map(distance).collect());
        used.retain(|point| distance(point) <= limit);
    }
    slope
}

fn tied_knots(points: &[(f64, f64)], a: f64, b: f64, sigma: f64, count: usize) -> Vec<f64> {
    if count < 3 {
        return vec![0.0; count];
    }
    let weight = 1.0 / (sigma * sigma);
    let tie = 1.0 / (KNOT_TIE * KNOT_TIE);
    // Tridiagonal: diagonal, upper diagonal, right-hand side.
    let mut diagonal = vec![0.0; count];
    let mut upper = vec![0.0; count];
    let mut right = vec![0.0; count];
    for &(x, y) in points {
        let Some((left, w)) = knot(x, count) else {
            continue;
        };
        let y = y - a - b * x;
        let v = 1.0 - w;
        diagonal[left] += weight * v * v;
        diagonal[left + 1] += weight * w * w;
        upper[left] += weight * v * w;
        right[left] += weight * v * y;
        right[left + 1] += weight * w * y;
    }
    for left in 0..count - 1 {
        diagonal[left] += tie;
        diagonal[left + 1] += tie;
        upper[left] -= tie;
    }
    // Thomas's algorithm; with at least one point the matrix is positive definite.
    for i in 1..count {
        let factor = upper[i - 1] / diagonal[i - 1];
        diagonal[i] -= factor * upper[i - 1];
        right[i] -= factor * right[i - 1];
    }
    let mut knots = vec![0.0; count];
    for i in (0..count).rev() {
        let next = knots.get(i + 1).copied().unwrap_or(0.0);
        knots[i] = (right[i] - upper[i] * next) / diagonal[i];
    }
    if knots.iter().any(|knot| !knot.is_finite()) {
        return vec![0.0; count];
    }
    knots
}

/// Returns the upper median, or 0 without values. It is one of the values, so that whole
/// periods stay whole; [`twist_sync::robust::median`] takes the mean of two.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    let (_, value, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    *value
}

/// Returns a map from device to board time with a knot each [`KNOT_SPACING`]. `to_board(x)`
/// is the board's distance from `board_zero` at the device's distance `x` from `device_zero`.
pub(super) fn knots(
    device_zero: DeviceNanos,
    board_zero: BoardNanos,
    end: f64,
    to_board: impl Fn(f64) -> f64,
) -> PiecewiseMap<DeviceNanos, BoardNanos> {
    let count = (end / KNOT_SPACING).ceil().max(1.0) as usize + 1;
    PiecewiseMap::from_knots((0..count).map(|knot| {
        let device = knot as f64 * KNOT_SPACING;
        let board = to_board(device).round();
        (
            DeviceNanos(device_zero.0.saturating_add(device as i64)),
            BoardNanos(board_zero.0.saturating_add(board as i64)),
        )
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wander_is_followed_and_outliers_are_not() {
        // Ten minutes at 30 Hz, 300 ppm, a wander of ±60 µs over some minutes,
        // one point in seven off by 3 ms.
        let true_value = |x: f64| 5e6 + 300e-6 * x + 60e3 * (x / 150e9).sin();
        let points: Vec<(f64, f64)> = (0..18_000)
            .map(|i| {
                let x = f64::from(i) * 33.33e6;
                let off = if i % 7 == 3 { 3e6 } else { 0.0 };
                let noise = f64::from(i * 7919 % 11_111) - 5_555.0;
                (x, true_value(x) + off + noise)
            })
            .collect();
        let fit = smooth(&points, 3.2e3).unwrap();
        for i in 0..600 {
            let x = f64::from(i) * 1e9;
            let error = fit.at(x) - true_value(x);
            assert!(error.abs() < 1.5e3, "{i}: {error}");
        }
    }

    #[test]
    fn a_fit_needs_three_points() {
        assert!(smooth(&[(0.0, 1.0), (1.0, 2.0)], 1.0).is_none());
        let fit = smooth(&[(0.0, 5.0), (1e12, 5.0), (2e12, 5.0)], 1.0).unwrap();
        assert!((fit.at(1.5e12) - 5.0).abs() < 1e-6);
    }
}
