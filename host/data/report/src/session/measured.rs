//! Measurements in a recording that check its predictions: both gyroscopes in a twist, and the
//! pulses against the phone's frames.

use std::io::BufReader;
use std::path::Path;

use clock::{BoardToPhone, ClockRelation, PhoneNanos};
use phone::frame_timestamps;
use phone::rows::Rows;
use protocol::Ticks;
use recording::messages::Imu;
use recording::session_file::{SessionFile, Span};
use system::ReadMonitor;

use super::judgement::phone_files;

/// Most twists that are drawn, and most samples of one: a minute at 1 kHz.
const MAX_TWISTS: usize = 5;
const MAX_SAMPLES: usize = 60_000;

/// Most points of a curve.
const MAX_POINTS: usize = 800;

/// Board time, s, and rotation rate, rad/s.
type Rates = Vec<(f64, f64)>;

/// Rotation rates in one twist.
#[derive(Debug)]
pub(super) struct TwistRates {
    /// Number of the twist, from 1.
    pub(super) number: usize,
    span: Span,
    /// Delay of the board's gyroscope, s.
    delay_s: f64,
    board: Rates,
    phone: Rates,
}

impl TwistRates {
    /// Returns the accepted twists of the reference phone, with the phone's samples in board
    /// time.
    pub(super) fn from_session(
        folder: &Path,
        session: &SessionFile,
        monitor: &ReadMonitor,
    ) -> Vec<Self> {
        let Some(phone) = session.reference() else {
            return Vec::new();
        };
        let board_delay_us = session.imu.as_ref().map(|imu| imu.scale.gyro_delay_us);
        let twists = phone.twists.iter().enumerate();
        let curves = twists.filter_map(|(index, twist)| {
            let clock = twist.clock.filter(|_| twist.accepted)?;
            let file = folder.join(twist.phone_gyro.as_ref()?);
            Some(Self {
                number: index + 1,
                span: twist.span,
                delay_s: f64::from(board_delay_us.unwrap_or_default()) * 1e-6,
                board: Vec::new(),
                phone: phone_rates(&file, &clock, session.profile.phone.gyro_delay_us, monitor),
            })
        });
        curves.take(MAX_TWISTS).collect()
    }

    /// Adds a sample of the board, if it is within the twist.
    pub(super) fn add(&mut self, at: Ticks, imu: &Imu) {
        if (self.span.from..=self.span.to).contains(&at) && self.board.len() < MAX_SAMPLES {
            let at_s = at.as_secs_f64() - self.delay_s;
            self.board.push((at_s, norm(imu.angular_velocity)));
        }
    }

    /// Returns the curves of the board, of the phone, and of the phone minus the board, over the
    /// seconds of the twist; `None` if one of the two has no samples.
    pub(super) fn curves(&self) -> Option<[Rates; 3]> {
        let begin = self.span.from.as_secs_f64();
        let residual = self.phone.iter().filter_map(|&(at, rate)| {
            let after = self.board.partition_point(|sample| sample.0 < at);
            let (&(a, low), &(b, high)) = (
                self.board.get(after.checked_sub(1)?)?,
                self.board.get(after)?,
            );
            Some((at, rate - low - (high - low) * (at - a) / (b - a)))
        });
        let residual: Rates = residual.collect();
        let thinned = |rates: &Rates| {
            let every = rates.len().div_ceil(MAX_POINTS).max(1);
            let rates = rates.iter().step_by(every);
            rates.map(|&(at, rate)| (at - begin, rate)).collect()
        };
        (!residual.is_empty()).then(|| [&self.board, &self.phone, &residual].map(thinned))
    }
}

pub(super) fn norm(rates: [f64; 3]) -> f64 {
    rates.iter().map(|rate| rate * rate).sum::<f64>().sqrt()
}

/// Reads the rows of a phone's gyroscope up to the first damaged one; none if there is no file.
fn phone_rates(file: &Path, clock: &ClockRelation, delay_us: f64, monitor: &ReadMonitor) -> Rates {
    let Ok(input) = system::open(file, monitor) else {
        return Vec::new();
    };
    let mut rows = Rows::new(BufReader::new(input.skipping_holes()));
    let samples = std::iter::from_fn(|| rows.next_sample().ok().flatten());
    let rates = samples.take(MAX_SAMPLES).map(|sample| {
        let at = clock.to_board(sample.time.seconds());
        (at.0 - delay_us * 1e-6, norm(sample.xyz))
    });
    rates.collect()
}

/// The phone's frames in board time, for the comparison with pulses.
#[derive(Debug)]
pub(super) struct Frames {
    /// Middles of the synchronised row's exposure, s.
    middles: Vec<f64>,
    /// Index of the first frame that may be near the next pulse.
    next: usize,
    /// Time from a pulse to the middle of the depth exposure, s.
    center_s: f64,
    /// Half a frame period, s: the largest distance of a pulse from its frame.
    half_s: f64,
}

impl Frames {
    /// Returns the frames of the reference phone, if its file of timestamps is in the folder and
    /// its clock is known.
    pub(super) fn from_session(
        folder: &Path,
        session: &SessionFile,
        monitor: &ReadMonitor,
    ) -> Option<Self> {
        let (phone, alignment) = (session.reference()?, session.alignment.as_ref()?);
        let (clock, video) = (phone.clock?, phone.video?);
        let file = phone_files(folder, session, &phone.name)?.frames?;
        let times = frame_timestamps::read(&file, monitor).ok()?;
        let half_us = alignment.middle_row_us + 0.5 * alignment.exposure_us;
        let middles = times.into_iter().map(|time| {
            let time = PhoneNanos(time.0.saturating_add(video.boot_minus_frames_ns));
            clock.to_board(time.seconds()).0 + half_us * 1e-6
        });
        Some(Self {
            middles: middles.collect(),
            next: 0,
            center_s: (alignment.center_offset_us + alignment.bias_us) * 1e-6,
            half_s: alignment.plan.frames.period_ns * 0.5e-9,
        })
    }

    /// Returns depth minus phone at a pulse, µs: the middle of its depth exposure minus that of
    /// the nearest frame, if there is one. Pulses must come in the order of their times.
    pub(super) fn difference_us(&mut self, pulse: Ticks) -> Option<f64> {
        let depth = pulse.as_secs_f64() + self.center_s;
        let off = |index: usize| self.middles.get(index).map(|middle| depth - middle);
        while off(self.next + 1)
            .is_some_and(|after| off(self.next).is_some_and(|before| after.abs() <= before.abs()))
        {
            self.next += 1;
        }
        let nearest = off(self.next).filter(|difference| difference.abs() <= self.half_s);
        nearest.map(|difference| difference * 1e6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_is_held_against_the_nearest_frame() {
        let mut frames = Frames {
            middles: vec![1.0, 1.1, 1.2],
            next: 0,
            center_s: 0.01,
            half_s: 0.05,
        };
        let mut off_us = |at_s: f64| {
            let off = frames.difference_us(Ticks((at_s * 48e6) as u64));
            off.map(|off| off.round())
        };
        for (at_s, off) in [
            (0.99, Some(0.0)),
            (1.03, Some(40_000.0)),
            (1.08, Some(-10_000.0)),
            (1.5, None),
        ] {
            assert_eq!(off_us(at_s), off, "{at_s}");
        }
    }
}
