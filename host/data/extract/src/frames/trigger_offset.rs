//! Offset of a phone's frames from the grid of the trigger.
//!
//! The trigger follows one phone, whose frames should lie on the grid.
//! Another phone's frames are at a distance that is constant as far as the two phones' frame
//! periods are the same. Both are measured here as depth minus phone, from the extracted
//! times: a straight line is fitted to the distance of each centre of a depth exposure
//! (pulse and constant) from the nearest frame, unwrapped where another
//! frame becomes the nearest.

use crate::depth::depth_clock::fit::straight;
use crate::frames::pairs::nearest;
use crate::time::{BoardNanos, median_step};

/// Fewest pulses for the fit of a line.
const MIN_PULSES: usize = 10;

/// Offset of a phone's frames from the trigger's grid.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct TriggerOffset {
    /// Number of pulses with a frame near them.
    pub pulses: usize,
    /// Depth minus phone at the first pulse, by the fitted line, µs: the centre of the exposure
    /// that the pulse triggers minus the middle of exposure of the phone's middle row.
    pub offset_us: f64,
    /// Change of the offset, µs/min; positive if the depth camera gets later.
    pub drift_us_per_min: f64,
    /// Root mean square of the distances from the line, µs.
    pub residual_us: f64,
}

/// Measures the offset. Frames and centres of exposure are in board time and in order. Returns
/// `None` if there are too few.
pub(crate) fn measure(frames: &[BoardNanos], centres: &[BoardNanos]) -> Option<TriggerOffset> {
    let period = median_step(frames.iter().map(|frame| frame.0))?;
    if period <= 0 {
        return None;
    }
    let mut points: Vec<(f64, f64)> = Vec::new();
    let first = centres.first()?.0;
    for centre in centres {
        let near = nearest(frames, centre.0, |frame| frame.0);
        let distance = near.map(|place| centre.0.saturating_sub(frames[place].0));
        // No frame is near before the first one, after the last one, or where frames are missing.
        let Some(distance) = distance.filter(|distance| distance.abs() <= period / 2 + period / 8)
        else {
            continue;
        };
        let period = period as f64;
        let turns = points
            .last()
            .map_or(0.0, |last| ((last.1 - distance as f64) / period).round());
        let seconds = centre.0.saturating_sub(first) as f64 * 1e-9;
        points.push((seconds, distance as f64 + turns * period));
    }
    if points.len() < MIN_PULSES {
        return None;
    }
    let (offset, slope) = straight(&points)?;
    let squares: f64 = points
        .iter()
        .map(|(x, y)| (y - offset - slope * x).powi(2))
        .sum();
    Some(TriggerOffset {
        pulses: points.len(),
        offset_us: offset * 1e-3,
        drift_us_per_min: slope * 60e-3,
        residual_us: (squares / points.len() as f64).sqrt() * 1e-3,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn train(first: i64, period: f64, count: usize) -> Vec<BoardNanos> {
        (0..count)
            .map(|k| BoardNanos(first + (k as f64 * period).round() as i64))
            .collect()
    }

    #[test]
    fn offset_and_drift_are_measured_across_a_change_of_the_nearest_frame() {
        // 14 ms late and 3 µs a frame slower: after 900 frames another is nearest.
        let centres = train(5_000_000_000, 33_330_000.0, 1_800);
        let frames = train(5_014_000_000 - 66_660_000, 33_333_000.0, 1_900);
        let found = measure(&frames, &centres).unwrap();
        assert_eq!(found.pulses, 1_800);
        assert!((found.offset_us + 14_006.0).abs() < 0.1, "{found:?}");
        let drift = 3.0 / 33.333e-3 * 60.0;
        assert!((found.drift_us_per_min + drift).abs() < 1.0, "{found:?}");
        assert!(found.residual_us < 2.0, "{found:?}");
        // Every sixth frame only, and some frames missing.
        let sixths: Vec<BoardNanos> = centres.iter().copied().step_by(6).collect();
        let mut gappy = frames;
        gappy.drain(500..520);
        let sparse = measure(&gappy, &sixths).unwrap();
        assert!(sparse.pulses < 300 && sparse.pulses > 290, "{sparse:?}");
        assert!((sparse.offset_us + 14_006.0).abs() < 1.0, "{sparse:?}");
    }

    #[test]
    fn too_few_frames_or_centres_have_no_offset() {
        let frames = train(0, 33e6, 50);
        assert_eq!(measure(&frames, &[]), None);
        assert_eq!(measure(&frames[..1], &frames), None);
        assert_eq!(measure(&frames, &train(i64::MAX / 2, 33e6, 50)), None);
        assert_eq!(measure(&[BoardNanos(5); 20], &frames), None);
    }
}
