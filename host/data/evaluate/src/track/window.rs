//! The part of a recording in which the train moves by its drift alone.
//!
//! A recording begins while the trigger is still being aligned to the phone's frames, and
//! may end with a depth camera that continues by its own clock: both move the
//! train by tens of µs a second and more. The drift is measured between them. Blocks
//! of a second are compared with their neighbours; the longest run without such a motion
//! is the window.

use std::ops::Range;

use crate::stats::median;
use crate::track::FramePoint;

/// Length of a block, seconds.
const BLOCK_S: f64 = 1.0;

/// Speed above which a train is being aligned, or runs free, µs/s. Two crystals without sync
/// differ by some 20 ppm (= µs/s) and more; the published rig drifts by 0.3 µs/s.
const STILL_US_PER_S: f64 = 10.0;

/// Largest step between blocks that may be noise, in uncertainties of one frame.
const NOISE: f64 = 6.0;

/// Length of the shortest window, seconds.
const SHORTEST_S: f64 = 5.0;

/// Returns the indices of the points within the window, or `None` if that is the whole
/// recording, or no part is long enough.
#[must_use]
pub(crate) fn still(points: &[FramePoint]) -> Option<Range<usize>> {
    let sigmas: Vec<f64> = points.iter().map(|p| p.sigma_us).collect();
    let noise = NOISE * median(&sigmas);
    let blocks = blocks(points);
    let mut runs: Vec<Range<usize>> = Vec::new();
    let mut before: Option<(f64, f64)> = None;
    for block in blocks {
        let part = points.get(block.clone())?;
        let time = median(&part.iter().map(|p| p.time_s).collect::<Vec<_>>());
        let place = median(&part.iter().map(|p| p.bias_us).collect::<Vec<_>>());
        let stays =
            before.is_some_and(|(t, p)| (place - p).abs() <= STILL_US_PER_S * (time - t) + noise);
        match runs.last_mut() {
            Some(run) if stays => run.end = block.end,
            _ => runs.push(block),
        }
        before = Some((time, place));
    }
    let length = |run: &Range<usize>| {
        let time = |at: usize| points.get(at).map_or(0.0, |p| p.time_s);
        time(run.end.saturating_sub(1)) - time(run.start)
    };
    let longest = runs
        .into_iter()
        .max_by(|a, b| length(a).total_cmp(&length(b)))?;
    (longest.len() < points.len() && length(&longest) >= SHORTEST_S).then_some(longest)
}

/// Points of the same second.
fn blocks(points: &[FramePoint]) -> Vec<Range<usize>> {
    let mut blocks: Vec<Range<usize>> = Vec::new();
    let mut begun = f64::NEG_INFINITY;
    for (index, point) in points.iter().enumerate() {
        match blocks.last_mut() {
            Some(block) if point.time_s - begun < BLOCK_S => block.end = index + 1,
            _ => {
                begun = point.time_s;
                blocks.push(index..index + 1);
            }
        }
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames at 30 a second, with noise of ±0.3 µs.
    fn points(seconds: f64, place: impl Fn(f64) -> f64) -> Vec<FramePoint> {
        (0..(seconds * 30.0) as usize)
            .map(|index| {
                let time_s = index as f64 / 30.0;
                let noise = 0.3 * ((index * 7) % 5) as f64 / 2.0 - 0.3;
                FramePoint {
                    index,
                    time_s,
                    bias_us: place(time_s) + noise,
                    sigma_us: 0.3,
                    amplitude: 20.0,
                }
            })
            .collect()
    }

    #[test]
    fn alignment_and_free_run_are_left_out() {
        // 11 ms in steps of 100 µs a frame, 20 s of 40 µs/min, then 200 ppm.
        let place = |t: f64| match t {
            t if t < 3.6 => 11_000.0 - 3_000.0 * t,
            t if t < 23.6 => 200.0 + 40.0 / 60.0 * (t - 3.6),
            t => 213.3 + 200.0 * (t - 23.6),
        };
        let points = points(30.0, place);
        let window = still(&points).unwrap();
        let (from, to) = (points[window.start].time_s, points[window.end - 1].time_s);
        assert!((2.9..5.1).contains(&from), "{from}");
        assert!((22.4..24.6).contains(&to), "{to}");
        // The alignment may be longer than what follows it.
        let points = self::points(40.0, |t| if t < 30.0 { 600.0 * t } else { 18_000.0 });
        let window = still(&points).unwrap();
        assert!(points[window.start].time_s > 28.9);
        assert_eq!(window.end, points.len());
    }

    #[test]
    fn a_train_that_stands_still_needs_no_window() {
        assert_eq!(still(&points(60.0, |t| 5.0 + t)), None);
        assert_eq!(still(&points(2.0, |t| 3_000.0 * t)), None);
        assert_eq!(still(&points(60.0, |t| 200.0 * t)), None);
        assert_eq!(still(&[]), None);
        // One frame a few seconds, each known to 30 µs only.
        let coarse: Vec<FramePoint> = points(30.0, |t| 0.1 * t)
            .into_iter()
            .enumerate()
            .map(|(k, p)| FramePoint {
                time_s: 3.0 * k as f64,
                bias_us: p.bias_us * 50.0,
                sigma_us: 30.0,
                ..p
            })
            .collect();
        assert_eq!(still(&coarse), None);
    }
}
