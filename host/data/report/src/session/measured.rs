//! Measurements in a recording that check its predictions: both gyroscopes in a twist, and the
//! pulses against the phone's frames.

use std::io::BufReader;
use std::path::Path;

use clock::{BoardToPhone, ClockRelation, PhoneNanos};
use nalgebra::{Matrix4, SMatrix, Vector3, Vector4};
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

/// Board time, s, and a rotation rate, rad/s.
type Rates = Vec<(f64, f64)>;

/// Board time, s, and the rotation rate about each axis, rad/s.
type Vectors = Vec<(f64, [f64; 3])>;

/// Rotation rates in one twist.
#[derive(Debug)]
pub(super) struct TwistRates {
    /// Number of the twist, from 1.
    pub(super) number: usize,
    span: Span,
    /// Delay of the board's gyroscope, s.
    delay_s: f64,
    board: Vectors,
    phone: Vectors,
}

/// Both gyroscopes in one twist, over its seconds.
pub(super) struct TwistCurves {
    /// Magnitude of the rates of board and phone.
    pub(super) magnitudes: [Rates; 2],
    /// Phone minus board about each axis of the phone, after the board's rates were turned, scaled
    /// and freed of bias as fits best.
    pub(super) residual: [Rates; 3],
    /// Root mean square of the residual over all axes, rad/s.
    pub(super) rms: f64,
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
            self.board.push((at_s, imu.angular_velocity));
        }
    }

    /// Returns the curves of the twist; `None` if one of the two has no samples.
    pub(super) fn curves(&self) -> Option<TwistCurves> {
        let both: Vec<Pair> = self.phone.iter().filter_map(|s| self.pair(s)).collect();
        let residual = residual(&both)?;
        let squares: f64 = residual.iter().map(|(_, off)| off.norm_squared()).sum();
        let begin = self.span.from.as_secs_f64();
        let magnitude = |of: &Vectors| thinned(of, |&(at, rates)| (at - begin, norm(rates)));
        Some(TwistCurves {
            magnitudes: [&self.board, &self.phone].map(magnitude),
            residual: [0, 1, 2].map(|axis| thinned(&residual, |(at, off)| (at - begin, off[axis]))),
            rms: (squares / (3 * residual.len()) as f64).sqrt(),
        })
    }

    /// Returns a sample of the phone with the board's rates at its time.
    fn pair(&self, &(at, phone): &(f64, [f64; 3])) -> Option<Pair> {
        let after = self.board.partition_point(|sample| sample.0 < at);
        let (a, low) = self.board.get(after.checked_sub(1)?)?;
        let (b, high) = self.board.get(after)?;
        let (low, high) = (Vector3::from(*low), Vector3::from(*high));
        let board = low + (high - low) * ((at - a) / (b - a));
        Some((at, board.push(1.0), phone.into()))
    }
}

/// Time, the board's rates with a one for the bias, and the phone's rates.
type Pair = (f64, Vector4<f64>, Vector3<f64>);

/// Returns what is left of the phone's rates after the linear function of the board's that fits best,
/// which is rotation, scales and bias in one. Axes about which nothing turned are left alone.
fn residual(both: &[Pair]) -> Option<Vec<(f64, Vector3<f64>)>> {
    let mut normal = Matrix4::zeros();
    let mut mixed = SMatrix::<f64, 4, 3>::zeros();
    for (_, board, phone) in both {
        normal += board * board.transpose();
        mixed += board * phone.transpose();
    }
    let least = 1e-9 * normal.trace().max(f64::MIN_POSITIVE);
    let fit = normal.svd(true, true).solve(&mixed, least).ok()?;
    let off = both
        .iter()
        .map(|(at, board, phone)| (*at, phone - fit.transpose() * board));
    (!both.is_empty()).then(|| off.collect())
}

/// Returns at most [`MAX_POINTS`] points of a curve.
fn thinned<T>(all: &[T], point: impl Fn(&T) -> (f64, f64)) -> Rates {
    let every = all.len().div_ceil(MAX_POINTS).max(1);
    all.iter().step_by(every).map(point).collect()
}

pub(super) fn norm(rates: [f64; 3]) -> f64 {
    rates.iter().map(|rate| rate * rate).sum::<f64>().sqrt()
}

/// Reads the rows of a phone's gyroscope up to the first damaged one; none if there is no file.
fn phone_rates(
    file: &Path,
    clock: &ClockRelation,
    delay_us: f64,
    monitor: &ReadMonitor,
) -> Vectors {
    let Ok(input) = system::open(file, monitor) else {
        return Vec::new();
    };
    let mut rows = Rows::new(BufReader::new(input.skipping_holes()));
    let samples = std::iter::from_fn(|| rows.next_sample().ok().flatten());
    let rates = samples.take(MAX_SAMPLES).map(|sample| {
        let at = clock.to_board(sample.time.seconds());
        (at.0 - delay_us * 1e-6, sample.xyz)
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

    /// Rotation, scale and bias leave nothing; a wrong time leaves a copy of the motion.
    #[test]
    fn what_is_left_of_a_twist_is_noise_unless_the_time_is_wrong() {
        let turned = |t: f64| [(3.0 * t).sin(), (2.0 * t).cos(), (5.0 * t).sin() * 0.5];
        let rms = |late_s: f64| {
            let samples = (0..2_000).map(|n| f64::from(n) * 2e-3);
            let phone = |t: f64| {
                let [x, y, z] = turned(t - late_s);
                (t, [1.02 * y + 0.1, 0.98 * x - 0.05, -z])
            };
            let twist = TwistRates {
                number: 1,
                span: Span::default(),
                delay_s: 0.0,
                board: samples.clone().map(|t| (t, turned(t))).collect(),
                phone: samples.map(phone).collect(),
            };
            twist.curves().unwrap().rms
        };
        assert!(rms(0.0) < 1e-6, "{}", rms(0.0));
        assert!(rms(5e-3) > 5e-3, "{}", rms(5e-3));
    }

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
