//! The published pipeline, for comparison on the same frames.
//!
//! Mean brightness of each row, averaged over the frames, smoothed with a Gaussian
//! of 7 rows, position of the peak nearest to the middle row; row time from the
//! distance between neighbouring peaks. Perfect sync is the peak on the middle
//! row. No sub-row detection, no reference, no uncertainty: that is the method.

use serde::Serialize;

use super::search::RowGrid;
use super::stats::mean;
use super::train::TrainGeometry;

/// Rows of the smoothing kernel.
const KERNEL: usize = 7;
/// Standard deviation of a 7-row kernel, by the usual rule 0.3·((n-1)/2 - 1) + 0.8.
const KERNEL_SIGMA: f64 = 1.4;

/// What the published pipeline finds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PaperResult {
    /// Rows of the peaks, counted from the sensor's first row.
    pub peak_rows: Vec<f64>,
    /// Row time from the peaks' distances, µs; none with fewer than two peaks.
    pub row_time_us: Option<f64>,
    /// The chosen peak after the middle row, µs.
    pub bias_us: Option<f64>,
}

/// Averages, smooths, picks the peak.
///
/// `middle_row` is that of the sensor; `row_time_us` is used when there is only
/// one peak.
pub(crate) fn evaluate(
    profile: &[f64],
    rows: RowGrid,
    middle_row: f64,
    train: &TrainGeometry,
    near_us: f64,
    row_time_us: Option<f64>,
) -> PaperResult {
    let peaks: Vec<f64> = find_peaks(&smooth(profile))
        .into_iter()
        .map(|i| rows.position(i))
        .collect();
    let gaps: Vec<f64> = peaks
        .iter()
        .zip(peaks.iter().skip(1))
        .map(|(a, b)| b - a)
        .collect();
    let own = (!gaps.is_empty()).then(|| train.pitch_us / mean(&gaps));
    let row_time = own.or(row_time_us);
    let bias_us = row_time.and_then(|t| {
        peaks
            .iter()
            .map(|p| p * t)
            .min_by(|a, b| (a - near_us).abs().total_cmp(&(b - near_us).abs()))
    });
    PaperResult {
        peak_rows: peaks.iter().map(|p| p + middle_row).collect(),
        row_time_us: own,
        bias_us,
    }
}

/// Gaussian smoothing; the ends are continued with the last value.
fn smooth(profile: &[f64]) -> Vec<f64> {
    let half = (KERNEL / 2) as isize;
    let weights: Vec<f64> = (-half..=half)
        .map(|k| (-0.5 * (k as f64 / KERNEL_SIGMA).powi(2)).exp())
        .collect();
    let total: f64 = weights.iter().sum();
    let last = profile.len().saturating_sub(1) as isize;
    (0..profile.len() as isize)
        .map(|i| {
            weights
                .iter()
                .zip(-half..=half)
                .filter_map(|(w, k)| Some(w * profile.get((i + k).clamp(0, last) as usize)?))
                .sum::<f64>()
                / total
        })
        .collect()
}

/// Local maxima whose prominence (height over the higher of the two valleys beside
/// them) is at least 40 % of the largest one's. Maxima cut by the picture's edge do
/// not count.
fn find_peaks(profile: &[f64]) -> Vec<usize> {
    let mut found: Vec<(usize, f64)> = Vec::new();
    for i in 1..profile.len().saturating_sub(1) {
        let (Some(&before), Some(&v), Some(&after)) =
            (profile.get(i - 1), profile.get(i), profile.get(i + 1))
        else {
            continue;
        };
        if v <= before || v < after {
            continue;
        }
        let valley = |side: &mut dyn Iterator<Item = &f64>| -> Option<f64> {
            let mut lowest = v;
            let mut higher = false;
            for &w in side {
                if w > v {
                    higher = true;
                    break;
                }
                lowest = lowest.min(w);
            }
            (higher || lowest < v).then_some(lowest)
        };
        let left = valley(&mut profile.iter().take(i).rev());
        let right = valley(&mut profile.iter().skip(i + 1));
        if let (Some(left), Some(right)) = (left, right) {
            found.push((i, v - left.max(right)));
        }
    }
    let largest = found.iter().map(|f| f.1).fold(0.0, f64::max);
    found
        .into_iter()
        .filter(|f| f.1 >= 0.4 * largest && f.1 > 0.0)
        .map(|f| f.0)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::train::{Shape, row_light};
    use super::*;

    #[test]
    fn clean_triangles_are_found_to_half_a_row() {
        let rows = RowGrid {
            first: -539.5,
            step: 1.0,
            len: 1080,
        };
        let shape = Shape {
            bias_us: 44.0,
            row_time_us: 10.2,
            exposure_us: 125.0,
        };
        let profile: Vec<f64> = (0..1080)
            .map(|i| 5.0 + 9.0 * row_light(&TrainGeometry::NFOV, &shape, rows.position(i)).value)
            .collect();
        let result = evaluate(&profile, rows, 539.5, &TrainGeometry::NFOV, 0.0, None);
        assert_eq!(result.peak_rows.len(), 7);
        assert!(
            (result.row_time_us.unwrap() - 10.2).abs() < 0.03,
            "{result:?}"
        );
        assert!((result.bias_us.unwrap() - 44.0).abs() < 6.0, "{result:?}");
    }

    #[test]
    fn a_flat_profile_has_no_peaks() {
        let rows = RowGrid {
            first: 0.0,
            step: 1.0,
            len: 100,
        };
        let result = evaluate(
            &[3.0; 100],
            rows,
            0.0,
            &TrainGeometry::NFOV,
            0.0,
            Some(10.0),
        );
        assert_eq!(result.bias_us, None);
    }
}
