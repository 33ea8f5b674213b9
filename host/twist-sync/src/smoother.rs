//! Whole recordings: offset over time from windows of natural motion.
//!
//! Any motion tells about the offset, not only a twist. The recording is cut
//! into windows; each is estimated by [`super::estimate_offset`] (with all its
//! gates: a window without motion is simply not used) and the estimates are
//! joined by a Kalman filter and a Rauch–Tung–Striebel smoother over the state
//! (offset, skew), where the skew walks at random with the given [`Wander`].
//!
//! Limits: a jump of a clock within the recording is not modelled; windows that
//! contradict the others by more than [`CONTRADICTION`] sigmas are left out and
//! counted.

use nalgebra::{Matrix2, Vector2};

use super::clock::{ClockRelation, Wander};
use super::estimate::{Estimate, Options, Refusal, Report, estimate_offset};
use super::gates::Gate;
use super::track::GyroTrack;

/// Innovation beyond which a window is left out, in sigmas.
pub const CONTRADICTION: f64 = 6.0;

/// How a recording is cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowOptions {
    /// Settings of each window's estimate; its `wander` is the smoother's.
    pub estimate: Options,
    /// Length of a window, seconds.
    pub window_s: f64,
}

impl Default for WindowOptions {
    fn default() -> Self {
        Self {
            estimate: Options {
                sigma_limit_s: 1e-3,
                ..Options::default()
            },
            window_s: 10.0,
        }
    }
}

/// The clock relation over a whole recording.
#[derive(Debug, Clone, PartialEq)]
pub struct ClockCourse {
    /// Filtered (past only) states at the windows, in time order.
    filtered: Vec<ClockRelation>,
    /// Smoothed (all data) states at the same times.
    smoothed: Vec<ClockRelation>,
    /// Windows looked at.
    pub windows: usize,
    /// Windows used.
    pub used: usize,
    /// Windows that were accepted by their gates but contradict the rest.
    pub contradicting: usize,
}

type State = (Vector2<f64>, Matrix2<f64>);

fn transition(dt: f64) -> Matrix2<f64> {
    Matrix2::new(1.0, dt, 0.0, 1.0)
}

fn diffusion(dt: f64, wander: Wander) -> Matrix2<f64> {
    let q = wander.diffusion();
    let dt = dt.abs();
    Matrix2::new(
        q * dt.powi(3) / 3.0,
        q * dt * dt / 2.0,
        q * dt * dt / 2.0,
        q * dt,
    )
}

fn state(model: &ClockRelation, base: f64) -> State {
    let c = &model.covariance;
    (
        Vector2::new(model.offset - base, model.skew),
        Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]),
    )
}

fn model(state: &State, base: f64, reference: f64, wander: Wander) -> ClockRelation {
    let p = 0.5 * (state.1 + state.1.transpose());
    ClockRelation {
        reference: reference,
        offset: base + state.0[0],
        skew: state.0[1],
        covariance: [[p[(0, 0)], p[(0, 1)]], [p[(1, 0)], p[(1, 1)]]],
        wander,
    }
}

fn predicted(from: &State, dt: f64, wander: Wander) -> State {
    let f = transition(dt);
    (
        f * from.0,
        f * from.1 * f.transpose() + diffusion(dt, wander),
    )
}

/// One step of the Rauch–Tung–Striebel smoother: the state at an earlier time,
/// improved by the smoothed state `dt` later.
fn improved(earlier: &State, later: &State, dt: f64, wander: Wander) -> State {
    let forward = predicted(earlier, dt, wander);
    let Some(inverse) = forward.1.try_inverse() else {
        return *earlier;
    };
    let gain = earlier.1 * transition(dt).transpose() * inverse;
    (
        earlier.0 + gain * (later.0 - forward.0),
        earlier.1 + gain * (later.1 - forward.1) * gain.transpose(),
    )
}

impl ClockCourse {
    /// Joins estimates of one pair of clocks (windows, or a few twists).
    ///
    /// `None` if there are none.
    #[must_use]
    pub fn from_estimates(estimates: &[ClockRelation], wander: Wander) -> Option<Self> {
        let mut sorted = estimates.to_vec();
        sorted.sort_by(|a, b| a.reference.total_cmp(&b.reference));
        let base = sorted.first()?.offset;
        let mut filtered: Vec<(f64, State)> = Vec::new();
        let mut contradicting = 0;
        for estimate in &sorted {
            let at = estimate.reference;
            let measured = state(estimate, base);
            let next = match filtered.last() {
                None => measured,
                Some((before, last)) => {
                    let forward = predicted(last, at - before, wander);
                    let sum = forward.1 + measured.1;
                    let Some(inverse) = sum.try_inverse() else {
                        continue;
                    };
                    let innovation = measured.0 - forward.0;
                    let square = (innovation.transpose() * inverse * innovation)[0];
                    if square.is_nan() || square > CONTRADICTION * CONTRADICTION {
                        contradicting += 1;
                        continue;
                    }
                    let gain = forward.1 * inverse;
                    let keep = Matrix2::identity() - gain;
                    (
                        forward.0 + gain * innovation,
                        // Joseph form: stays positive.
                        keep * forward.1 * keep.transpose() + gain * measured.1 * gain.transpose(),
                    )
                }
            };
            filtered.push((at, next));
        }
        let mut smoothed = filtered.clone();
        for i in (0..filtered.len().saturating_sub(1)).rev() {
            let dt = filtered[i + 1].0 - filtered[i].0;
            smoothed[i].1 = improved(&filtered[i].1, &smoothed[i + 1].1, dt, wander);
        }
        let models = |states: &[(f64, State)]| {
            states
                .iter()
                .map(|(at, s)| model(s, base, *at, wander))
                .collect()
        };
        Some(Self {
            filtered: models(&filtered),
            smoothed: models(&smoothed),
            windows: sorted.len(),
            used: filtered.len(),
            contradicting,
        })
    }

    /// The relation at a board time, from all data: between the windows the
    /// bridge of the two nearest, outside a prediction.
    #[must_use]
    pub fn at(&self, at: f64) -> ClockRelation {
        let after = self.smoothed.partition_point(|m| m.reference <= at);
        match (after.checked_sub(1), self.smoothed.get(after)) {
            (None, _) => self.smoothed[0].referenced_at(at),
            (Some(last), None) => self.smoothed[last].referenced_at(at),
            (Some(before), Some(next)) => {
                let base = next.offset;
                let wander = next.wander;
                let from = self.filtered[before].referenced_at(at);
                let bridged = improved(
                    &state(&from, base),
                    &state(next, base),
                    next.reference - at,
                    wander,
                );
                model(&bridged, base, at, wander)
            }
        }
    }

    /// The state to predict from: the last window.
    #[must_use]
    pub fn latest(&self) -> ClockRelation {
        self.smoothed[self.smoothed.len() - 1]
    }

    /// First and last board time with data.
    #[must_use]
    pub fn span(&self) -> (f64, f64) {
        (
            self.smoothed[0].reference,
            self.smoothed[self.smoothed.len() - 1].reference,
        )
    }
}

/// Estimates the clock relation over a whole recording.
///
/// # Errors
///
/// No window of the board's recording can be related to the phone's.
pub fn estimate_course(
    mcu: &GyroTrack,
    phone: &GyroTrack,
    options: &WindowOptions,
) -> Result<ClockCourse, Refusal> {
    let windows = windows_of(mcu, options.window_s);
    // The strongest motion first, against the whole of the phone's recording.
    let mut order: Vec<usize> = (0..windows.len()).collect();
    order.sort_by(|&a, &b| windows[b].1.total_cmp(&windows[a].1));
    let mut first: Option<Estimate> = None;
    let mut refusal = None;
    for &i in order.iter().take(5) {
        match estimate_offset(&windows[i].0, phone, &options.estimate) {
            Ok(estimate) => {
                first = Some(estimate);
                break;
            }
            Err(error) => refusal = refusal.or(Some(error)),
        }
    }
    let Some(first) = first else {
        return Err(refusal.unwrap_or_else(no_windows));
    };
    // All windows, each against what the first says.
    let mut estimates = Vec::new();
    for (window, _) in &windows {
        let middle = window.epoch_s + 0.5 * (window.t[0] + window.t[window.len() - 1]);
        let expected = first.clock.offset_at(middle);
        let from = window.epoch_s + window.t[0] + expected.value;
        let to = window.epoch_s + window.t[window.len() - 1] + expected.value;
        let margin = 0.1 + (6.0 * expected.sigma).min(5.0);
        let part = phone.between(from - margin, to + margin);
        let settings = Options {
            search: Some((expected.value, margin)),
            ..options.estimate
        };
        if let Ok(estimate) = estimate_offset(window, &part, &settings) {
            estimates.push(estimate.clock);
        }
    }
    let mut course =
        ClockCourse::from_estimates(&estimates, options.estimate.wander).ok_or_else(no_windows)?;
    course.windows = windows.len();
    Ok(course)
}

fn no_windows() -> Refusal {
    Refusal {
        report: Report {
            gates: vec![Gate::at_least(
                "windows",
                0.0,
                1.0,
                "windows",
                "no part of the recording has enough motion to relate the clocks",
            )],
            ..Report::default()
        },
    }
}

/// Windows of at least half the length, each with its motion's power.
fn windows_of(track: &GyroTrack, window_s: f64) -> Vec<(GyroTrack, f64)> {
    let mut out: Vec<(GyroTrack, f64)> = Vec::new();
    let mut at = 0;
    while at < track.t.len() {
        let start = track.t[at];
        let length = track.t[at..]
            .iter()
            .position(|&t| t > start + window_s)
            .unwrap_or(track.t.len() - at)
            .max(1);
        let to = at + length;
        let window = GyroTrack {
            epoch_s: track.epoch_s,
            t: track.t[at..to].to_vec(),
            w: track.w[at..to].to_vec(),
        };
        if window.t[window.len() - 1] - start > 0.5 * window_s {
            let power: f64 = window
                .w
                .iter()
                .map(|w| w.iter().map(|x| x * x).sum::<f64>())
                .sum();
            out.push((window, power));
        }
        at = to;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(at: f64, offset: f64, sigma: f64) -> ClockRelation {
        ClockRelation {
            reference: at,
            offset,
            skew: 0.0,
            covariance: [[sigma * sigma, 0.0], [0.0, 1e-10]],
            wander: Wander::from_ppm(0.02),
        }
    }

    #[test]
    fn a_straight_line_is_found_and_the_end_is_predicted() {
        let wander = Wander::from_ppm(0.01);
        let truth = |t: f64| 1e5 + 20e-6 * t;
        let estimates: Vec<ClockRelation> = (0..30)
            .map(|k| estimate(10.0 * f64::from(k), truth(10.0 * f64::from(k)), 10e-6))
            .collect();
        let course = ClockCourse::from_estimates(&estimates, wander).unwrap();
        assert_eq!((course.used, course.contradicting), (30, 0));
        let middle = course.at(155.0);
        assert!((middle.offset - truth(155.0)).abs() < 3e-6);
        let (inside, outside) = (
            middle.covariance[0][0].sqrt(),
            course.at(600.0).covariance[0][0].sqrt(),
        );
        assert!(
            inside < 5e-6 && outside > 2.0 * inside,
            "{inside} {outside}"
        );
    }

    #[test]
    fn a_window_that_contradicts_is_left_out() {
        let mut estimates: Vec<ClockRelation> = (0..20)
            .map(|k| estimate(10.0 * f64::from(k), 5.0, 5e-6))
            .collect();
        estimates[11].offset += 1e-3;
        let course = ClockCourse::from_estimates(&estimates, Wander::from_ppm(0.02)).unwrap();
        assert_eq!((course.used, course.contradicting), (19, 1));
        assert!((course.at(110.0).offset - 5.0).abs() < 5e-6);
    }

    #[test]
    fn the_bridge_is_continuous() {
        let estimates: Vec<ClockRelation> = (0..5)
            .map(|k| estimate(20.0 * f64::from(k), 3e-6 * f64::from(k * k), 5e-6))
            .collect();
        let course = ClockCourse::from_estimates(&estimates, Wander::from_ppm(0.05)).unwrap();
        for k in 1..4 {
            let t = 20.0 * f64::from(k);
            let (below, above) = (course.at(t - 1e-6), course.at(t + 1e-6));
            assert!((below.offset - above.offset).abs() < 1e-9);
            assert!((below.covariance[0][0] - above.covariance[0][0]).abs() < 1e-13);
        }
    }
}
