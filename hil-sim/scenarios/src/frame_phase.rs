//! The phase of the frames of two cameras, by the ground truth.
//!
//! The phase error of a pair is the middle of exposure of the depth frame minus
//! that of the phone's middle row, in true time. A frame of the phone is paired
//! with the depth frame whose middle is nearest, so an error is never more than
//! half a frame.

use serde::Serialize;

use rig::clocks::oscillator::{Oscillator, TrueTime};
use rig::depth_camera::FrameRecord;
use rig::phone::FrameTimes;
use stm32f4_sim::time::UNITS_PER_NANO;

/// The phase error of one frame of the phone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PhaseError {
    /// Number of the phone's frame in its video.
    pub phone_frame: usize,
    /// Number of the depth frame.
    pub depth_frame: u64,
    /// True time of the middle of the phone's frame, seconds.
    pub at_s: f64,
    /// Depth minus phone, microseconds.
    pub error_us: f64,
}

/// Phase errors in one number each.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PhaseSummary {
    /// Pairs that were looked at.
    pub pairs: usize,
    /// Error at the first pair, from the fitted line, microseconds.
    pub start_us: f64,
    /// Change of the error, microseconds a minute (least squares).
    pub drift_us_per_min: f64,
    /// Spread about the line, microseconds RMS.
    pub residual_us: f64,
    /// Largest error of a pair, microseconds.
    pub worst_us: f64,
}

impl PhaseSummary {
    /// 1-sigma of the mean error, by the spread of the pairs, µs. That of the error at the first
    /// pair is twice as large, of a line's ends.
    pub(crate) fn mean_sigma_us(&self) -> f64 {
        self.residual_us / (self.pairs.max(1) as f64).sqrt()
    }
}

/// Phase errors of frames `range` of a video of the phone.
///
/// `depth` are the depth frames in order of time; bad ones and those that the
/// camera made on its own clock count like any other.
#[must_use]
pub(crate) fn phase_errors(
    phone: &FrameTimes,
    range: std::ops::Range<usize>,
    phone_clock: &Oscillator,
    depth: &[FrameRecord],
) -> Vec<PhaseError> {
    range
        .filter_map(|n| {
            let middle = phone_clock.when_nanos(phone.middle_ns(n))?;
            let nearest = nearest(depth, middle)?;
            Some(PhaseError {
                phone_frame: n,
                depth_frame: nearest.number,
                at_s: middle.as_secs_f64(),
                error_us: difference_us(nearest.center_true, middle),
            })
        })
        .collect()
}

/// The frame whose middle is nearest to `at`.
fn nearest(depth: &[FrameRecord], at: TrueTime) -> Option<&FrameRecord> {
    let after = depth.partition_point(|f| f.center_true < at);
    let next = depth.get(after);
    let before = after.checked_sub(1).and_then(|i| depth.get(i));
    [before, next]
        .into_iter()
        .flatten()
        .min_by_key(|f| f.center_true.units().abs_diff(at.units()))
}

/// `a - b` in microseconds.
fn difference_us(a: TrueTime, b: TrueTime) -> f64 {
    let units = i128::from(a.units()) - i128::from(b.units());
    units as f64 / (UNITS_PER_NANO as f64 * 1e3)
}

/// Returns start, drift and spread of phase errors; `None` for fewer than two.
#[must_use]
pub(crate) fn summarise(errors: &[PhaseError]) -> Option<PhaseSummary> {
    let first = errors.first()?;
    let n = errors.len() as f64;
    let x = |e: &PhaseError| e.at_s - first.at_s;
    let (mean_x, mean_y) = (
        errors.iter().map(x).sum::<f64>() / n,
        errors.iter().map(|e| e.error_us).sum::<f64>() / n,
    );
    let sxx: f64 = errors.iter().map(|e| (x(e) - mean_x).powi(2)).sum();
    if sxx <= 0.0 {
        return None;
    }
    let sxy: f64 = errors
        .iter()
        .map(|e| (x(e) - mean_x) * (e.error_us - mean_y))
        .sum();
    let slope = sxy / sxx;
    let start_us = mean_y - slope * mean_x;
    let square: f64 = errors
        .iter()
        .map(|e| (e.error_us - start_us - slope * x(e)).powi(2))
        .sum();
    Some(PhaseSummary {
        pairs: errors.len(),
        start_us,
        drift_us_per_min: slope * 60.0,
        residual_us: (square / n).sqrt(),
        worst_us: errors.iter().map(|e| e.error_us.abs()).fold(0.0, f64::max),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig::depth_camera::Source;
    use rig::phone::PhoneConfig;
    use rig::random::{Seed, Stream};
    use stm32f4_sim::time::SimTime;

    /// A depth camera that is `late_us` off at the start and drifts.
    fn frames(late_us: f64, drift_us_per_min: f64) -> Vec<PhaseError> {
        let config = PhoneConfig::draw(Seed(7));
        let clock = Oscillator::new(config.clock, Seed(7).stream(Stream::PhoneClock));
        let start = config.clock.offset_ns + 5_000_000_000;
        let phone = FrameTimes::new(&config, 0, start);
        let middle = |n| clock.when_nanos(phone.middle_ns(n)).unwrap().as_secs_f64();
        let depth: Vec<FrameRecord> = (0..2000)
            .map(|n| {
                let at = middle(n);
                let error = late_us + drift_us_per_min * (at - middle(0)) / 60.0;
                FrameRecord {
                    number: n as u64,
                    source: Source::FreeRun,
                    first_flash: SimTime::ZERO,
                    center: SimTime::ZERO,
                    center_true: TrueTime::from_nanos((at * 1e9 + error * 1e3) as u64),
                    device_ticks: 0,
                    bad: false,
                    delivered: true,
                }
            })
            .collect();
        phase_errors(&phone, 0..2000, &clock, &depth)
    }

    #[test]
    fn finds_start_and_drift() {
        let errors = frames(-350.0, 20.0);
        assert_eq!(errors.len(), 2000);
        assert!(errors.iter().all(|e| e.depth_frame == e.phone_frame as u64));
        let summary = summarise(&errors).unwrap();
        assert!((summary.start_us + 350.0).abs() < 0.01, "{summary:?}");
        assert!(
            (summary.drift_us_per_min - 20.0).abs() < 0.01,
            "{summary:?}"
        );
        assert!(summary.residual_us < 0.01, "{summary:?}");
        assert!((summary.worst_us - 350.0).abs() < 0.1, "{summary:?}");
    }

    #[test]
    fn pairs_are_the_nearest() {
        // 20 ms late is 13.3 ms early for the next.
        let errors = frames(20_000.0, 0.0);
        for e in &errors[1..] {
            assert_eq!(e.depth_frame + 1, e.phone_frame as u64);
            assert!((e.error_us + 13_330.0).abs() < 10.0, "{}", e.error_us);
        }
    }

    #[test]
    fn too_little_gives_nothing() {
        assert_eq!(summarise(&[]), None);
        assert_eq!(summarise(&frames(0.0, 0.0)[..1]), None);
    }
}
