//! Frame phase: when the phone's frames fall in board time, now and ahead.
//!
//! The phone's frames are a train `start + n · period` in its own clock, known
//! from timestamps with jitter. Carried to board time through [`ClockModel`],
//! the train's phase against the trigger is what has to be aligned. Three things
//! make a prediction uncertain: where the train is (jitter), its period, and the
//! clock relation; their variances add, and the last two grow with the distance.

use serde::{Deserialize, Serialize};

use timebase::{BoardSeconds, PhoneNanos, PhoneSeconds};
use timebase::{ClockModel, WithSigma};
use twist_sync::robust;

/// A regular train of frames in the phone's clock.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameTrain {
    /// Time of the reference frame (the middle of the frames it is learnt from).
    pub start: PhoneSeconds,
    /// Number of the reference frame; frame 0 is the first that was given.
    pub start_frame: f64,
    /// 1-sigma of the start, seconds.
    pub start_sigma_s: f64,
    /// Seconds between frames.
    pub period_s: f64,
    /// 1-sigma of the period, seconds.
    pub period_sigma_s: f64,
}

impl FrameTrain {
    /// Learns the train from frame timestamps; lost frames leave a hole in the
    /// numbering, not an error. `None` with fewer than three frames or without
    /// a regular distance.
    #[must_use]
    pub fn from_timestamps(frames: &[PhoneNanos]) -> Option<Self> {
        let first = frames.first()?.0;
        let t: Vec<f64> = frames
            .iter()
            .map(|f| (i128::from(f.0) - i128::from(first)) as f64 * 1e-9)
            .collect();
        let steps: Vec<f64> = t.windows(2).map(|p| p[1] - p[0]).collect();
        let typical = robust::median(&steps);
        if t.len() < 3 || typical.is_nan() || typical <= 0.0 {
            return None;
        }
        let mut numbers = vec![0.0];
        for step in &steps {
            let before = numbers[numbers.len() - 1];
            numbers.push(before + (step / typical).round().max(1.0));
        }
        let (mean, period_s, centre) = robust::line(&numbers, &t);
        let residuals: Vec<f64> = numbers
            .iter()
            .zip(&t)
            .map(|(n, t)| t - mean - period_s * (n - centre))
            .collect();
        let count = t.len() as f64;
        let variance = residuals.iter().map(|r| r * r).sum::<f64>() / (count - 2.0);
        let spread: f64 = numbers.iter().map(|n| (n - centre).powi(2)).sum();
        Some(Self {
            start: PhoneSeconds(PhoneNanos(first).seconds().0 + mean),
            start_frame: centre,
            start_sigma_s: (variance / count).sqrt(),
            period_s,
            period_sigma_s: (variance / spread).sqrt(),
        })
    }

    /// Board time of a frame's timestamp, with its 1-sigma.
    #[must_use]
    pub fn board_time(&self, frame: f64, clock: &ClockModel) -> (BoardSeconds, WithSigma) {
        let distance = frame - self.start_frame;
        let phone = PhoneSeconds(self.start.0 + distance * self.period_s);
        let board = clock.to_board(phone);
        let relation = clock.offset_at(board).sigma;
        let sigma = self
            .start_sigma_s
            .hypot(distance * self.period_sigma_s)
            .hypot(relation);
        (
            board,
            WithSigma {
                value: board.0,
                sigma,
            },
        )
    }

    /// Phase of the frames against a trigger train with an edge at `edge` and
    /// `trigger_period_s`, at the frame nearest to board time `at`: frame minus
    /// nearest edge, in `-period/2 ..= period/2`, with its 1-sigma. All in board
    /// time; `shift_s` is added to the frame's time (middle of exposure and
    /// readout minus the depth camera's centre).
    #[must_use]
    pub fn phase(
        &self,
        clock: &ClockModel,
        at: BoardSeconds,
        edge: BoardSeconds,
        trigger_period_s: f64,
        shift_s: f64,
    ) -> WithSigma {
        let phone = clock.to_phone(at);
        let frame = (self.start_frame + (phone.0 - self.start.0) / self.period_s).round();
        let (time, with_sigma) = self.board_time(frame, clock);
        let cycles = (time.0 + shift_s - edge.0) / trigger_period_s;
        WithSigma {
            value: (cycles - cycles.round()) * trigger_period_s,
            sigma: with_sigma.sigma,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use timebase::Wander;

    fn clock() -> ClockModel {
        ClockModel {
            reference: BoardSeconds(100.0),
            offset: 5000.0,
            skew: 30e-6,
            covariance: [[4e-12, 0.0], [0.0, 1e-16]],
            wander: Wander::from_ppm(0.01),
        }
    }

    #[test]
    fn the_train_is_learnt_across_lost_frames() {
        let period = 33_330_652;
        let frames: Vec<PhoneNanos> = (0..300_i64)
            .filter(|n| n % 37 != 5)
            .map(|n| PhoneNanos(5_100_000_000_000 + n * period + (n * 7919 % 2001) - 1000))
            .collect();
        let train = FrameTrain::from_timestamps(&frames).unwrap();
        assert!((train.period_s - 0.033_330_652).abs() < 4.0 * train.period_sigma_s + 1e-12);
        assert!(train.period_sigma_s < 1e-9);
        assert!(FrameTrain::from_timestamps(&frames[..2]).is_none());
        assert!(FrameTrain::from_timestamps(&[PhoneNanos(5); 9]).is_none());
    }

    #[test]
    fn phase_is_periodic_and_its_sigma_grows() {
        let train = FrameTrain {
            start: PhoneSeconds(5100.0),
            start_frame: 0.0,
            start_sigma_s: 1e-6,
            period_s: 1.0 / 30.0 * (1.0 + 30e-6),
            period_sigma_s: 1e-9,
        };
        // One period of the frames is one of the trigger in board time.
        let (first, _) = train.board_time(0.0, &clock());
        for seconds in [0.0, 10.0, 100.0] {
            let phase = train.phase(
                &clock(),
                BoardSeconds(100.0 + seconds),
                BoardSeconds(first.0 - 0.004),
                1.0 / 30.0,
                0.001,
            );
            assert!((phase.value - 0.005).abs() < 1e-8, "{phase:?}");
        }
        let sigma = |frame| train.board_time(frame, &clock()).1.sigma;
        assert!(sigma(0.0) < sigma(300.0) && sigma(300.0) < sigma(18_000.0));
    }
}
