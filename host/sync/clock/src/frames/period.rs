//! The period of a phone's frames in its own time, fitted to the timestamps of a recording.
//!
//! `video_start` reports the mean of 59 intervals; a whole recording has
//! thousands of timestamps, and a straight line through them knows the slope
//! with a 1-sigma of `σ·√12 / N^1.5` intervals: 1 µs of jitter over 5 min is
//! 0.004 ns a frame. `profile learn` and `extract` use this fit.

use twist_sync::robust::Line;

use crate::PhoneNanos;

/// Smallest number of frames that a period is fitted to.
const MIN_FRAMES: usize = 300;

/// Largest scatter of timestamps about a straight line, as a part of the period. With more, the
/// distance of the frames is not constant.
const MOST_JITTER: f64 = 0.01;

/// Reason for which timestamps have no frame period.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrainError {
    /// Too few frames.
    #[error("{found} timestamps are too few to learn from, expected {MIN_FRAMES} or more")]
    TooFew {
        /// Number of timestamps.
        found: usize,
    },
    /// The timestamps are not those of frames at a constant rate.
    #[error("the timestamps are not those of frames: {reason}")]
    NoTrain {
        /// First deviation that was found.
        reason: String,
    },
}

/// A frame period with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FramePeriod {
    /// Distance of frames, ns of the phone's time.
    pub period_ns: f64,
    /// 1-sigma of the period within this recording, ns.
    pub sigma_ns: f64,
    /// Standard deviation of the timestamps about the line, ns.
    pub jitter_ns: f64,
    /// Number of frames used.
    pub frames: usize,
    /// Number of frames missing between the first and the last.
    pub missing: u64,
}

/// Fits a straight line through the timestamps of frames. Missing frames are
/// recognised by their distance; single timestamps far off the line and repeated timestamps are
/// left out.
///
/// # Errors
///
/// There are too few timestamps, or their distance is not constant.
pub fn frame_period(times: &[PhoneNanos]) -> Result<FramePeriod, TrainError> {
    let odd = |reason: &str| TrainError::NoTrain {
        reason: reason.to_owned(),
    };
    let mut times = times.to_vec();
    times.dedup();
    if times.len() < MIN_FRAMES {
        return Err(TrainError::TooFew { found: times.len() });
    }
    let first = times.first().copied().unwrap_or_default();
    let relative: Vec<f64> = times
        .iter()
        .map(|time| (i128::from(time.0) - i128::from(first.0)) as f64)
        .collect();
    let mut steps: Vec<f64> = relative.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let rough = steps[steps.len() / 2];
    if !(1e6..=1e9).contains(&rough) {
        return Err(odd("their distance is not within 1 ms and 1 s"));
    }
    if steps.first().is_some_and(|&least| least <= 0.0) {
        return Err(odd("they do not grow"));
    }
    // Number the frames step by step: each step is a whole number of periods.
    let mut points = vec![(0.0, 0.0)];
    let mut number = 0.0;
    for pair in relative.windows(2) {
        let step = (pair[1] - pair[0]) / rough;
        let whole = step.round().max(1.0);
        if (step - whole).abs() > 0.3 {
            return Err(odd(
                "a distance is not a multiple of the frame period (where the frame rate follows \
                 the light: lock the exposure in the app's settings)",
            ));
        }
        number += whole;
        points.push((number, pair[1]));
    }
    let missing = number as u64 + 1 - points.len() as u64;
    let (mut line, mut jitter_ns) = fit(&points);
    for _ in 0..3 {
        let limit = 5.0 * jitter_ns.max(1.0);
        let kept: Vec<(f64, f64)> = points
            .iter()
            .copied()
            .filter(|&(k, t)| (t - line.at(k)).abs() <= limit)
            .collect();
        if kept.len() == points.len() {
            break;
        }
        if kept.len() < MIN_FRAMES {
            return Err(odd("they scatter too much"));
        }
        points = kept;
        (line, jitter_ns) = fit(&points);
    }
    if jitter_ns > MOST_JITTER * line.slope {
        return Err(odd(
            "their distance changes within the recording (a frame rate that follows the light: \
             lock the exposure in the app's settings)",
        ));
    }
    Ok(FramePeriod {
        period_ns: line.slope,
        sigma_ns: jitter_ns / line.squares.sqrt(),
        jitter_ns,
        frames: points.len(),
        missing,
    })
}

/// Returns a line through points, and their standard deviation about it.
fn fit(points: &[(f64, f64)]) -> (Line, f64) {
    let line = Line::through(points);
    let squares: f64 = points.iter().map(|p| (p.1 - line.at(p.0)).powi(2)).sum();
    (line, (squares / (points.len() as f64 - 2.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64;

    use super::*;

    /// Frames of 33,330,652.54 ns with a jitter of about 1 µs.
    fn frames(count: usize) -> Vec<PhoneNanos> {
        let mut random = Pcg64::seed_from_u64(1);
        (0..count)
            .map(|k| {
                // Sum of four uniforms: nearly normal, sigma 1.15 · 0.866 µs.
                let jitter: f64 = (0..4).map(|_| random.random::<f64>() - 0.5).sum();
                let time = 900_000e9 + k as f64 * 33_330_652.54 + jitter * 1_732.0;
                PhoneNanos(time.round() as i64)
            })
            .collect()
    }

    #[test]
    fn five_minutes_know_the_period_to_a_hundredth_of_a_nanosecond() {
        let learnt = frame_period(&frames(9_000)).unwrap();
        let error = learnt.period_ns - 33_330_652.54;
        assert!(learnt.sigma_ns < 0.006, "{learnt:?}");
        assert!(error.abs() < 4.0 * learnt.sigma_ns, "{error} {learnt:?}");
        assert!((learnt.jitter_ns - 1_000.0).abs() < 50.0, "{learnt:?}");
    }

    #[test]
    fn missing_frames_and_single_wrong_timestamps_do_no_harm() {
        let mut times = frames(3_000);
        times[700].0 += 4_000_000;
        times.drain(1_000..1_007);
        times.remove(2_000);
        let learnt = frame_period(&times).unwrap();
        assert_eq!(learnt.missing, 8);
        assert_eq!(learnt.frames, times.len() - 1);
        assert!(
            (learnt.period_ns - 33_330_652.54).abs() < 0.15,
            "{learnt:?}"
        );
    }

    #[test]
    fn timestamps_without_a_constant_distance_are_refused() {
        assert_eq!(
            frame_period(&frames(10)),
            Err(TrainError::TooFew { found: 10 })
        );
        let mut backwards = frames(400);
        backwards.reverse();
        assert!(matches!(
            frame_period(&backwards),
            Err(TrainError::NoTrain { .. })
        ));
        assert!(frame_period(&[PhoneNanos(5); 400]).is_err());
        let mut shifted = frames(400);
        for time in &mut shifted[200..] {
            time.0 += 15_000_000;
        }
        assert!(matches!(
            frame_period(&shifted),
            Err(TrainError::NoTrain { .. })
        ));
    }

    #[test]
    fn frames_that_get_longer_in_the_dark_have_no_period() {
        // Two seconds in each half minute, as an automatic rate does; by a quarter, and by a
        // hundredth, which no single distance shows.
        for longer_ns in [8_300_000, 333_000] {
            let mut times = frames(9_000);
            let mut later = 0;
            for (n, time) in times.iter_mut().enumerate() {
                later += if n % 900 >= 840 { longer_ns } else { 0 };
                time.0 += later;
            }
            let found = frame_period(&times);
            assert!(
                matches!(&found, Err(TrainError::NoTrain { reason }) if reason.contains("lock")),
                "{found:?}"
            );
        }
    }
}
