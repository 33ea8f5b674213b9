//! Times of the extraction: integers of nanoseconds, one type a clock.
//!
//! Design: the clocks are types of their own ([`BoardNanos`], [`DeviceNanos`],
//! [`PhoneNanos`]), and [`PiecewiseMap`] is the only way across. A map is made once
//! from the floats of a fit; from then on a timestamp is converted by integer
//! arithmetic alone, so that no timestamp ever passes through a float (an f64
//! of seconds since 1970 resolves 238 ns only).

pub(crate) use crate::depth::k4a::DeviceNanos;
pub(crate) use clock::PhoneNanos;
use protocol::Ticks;

/// Nanoseconds in a second.
pub(crate) const SECOND: i64 = 1_000_000_000;

/// An instant of board time, in nanoseconds since the board's reset.
///
/// A tick is 125/6 ns, so this is rounded by at most half a nanosecond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub(crate) struct BoardNanos(pub i64);

impl BoardNanos {
    /// Returns the nearest tick.
    pub(crate) fn ticks(self) -> Ticks {
        let ticks = (i128::from(self.0.max(0)) * 6 + 62) / 125;
        Ticks(u64::try_from(ticks).unwrap_or(u64::MAX))
    }
}

impl From<Ticks> for BoardNanos {
    fn from(ticks: Ticks) -> Self {
        Self(i64::try_from(ticks.as_nanos()).unwrap_or(i64::MAX))
    }
}

/// An instant of some clock in whole nanoseconds.
pub(crate) trait ClockNanos: Copy {
    /// From nanoseconds.
    fn from_nanos(nanos: i64) -> Self;
    /// In nanoseconds.
    fn nanos(self) -> i64;
}

macro_rules! clock_nanos {
    ($($clock:ident)+) => {$(
        impl ClockNanos for $clock {
            fn from_nanos(nanos: i64) -> Self {
                Self(nanos)
            }
            fn nanos(self) -> i64 {
                self.0
            }
        }
    )+};
}

clock_nanos!(BoardNanos DeviceNanos PhoneNanos);

/// A relation of two clocks in pieces: straight lines between knots, in integer
/// arithmetic. Outside of the knots the first and the last line go on.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PiecewiseMap<F, T> {
    knots: Vec<(F, T)>,
}

impl<F: ClockNanos, T: ClockNanos> PiecewiseMap<F, T> {
    /// From pairs of the same instant. Pairs that do not lie after the one before
    /// on both clocks are left out.
    pub(crate) fn from_knots(pairs: impl IntoIterator<Item = (F, T)>) -> Self {
        let mut knots: Vec<(F, T)> = Vec::new();
        for (from, to) in pairs {
            let later = knots
                .last()
                .is_none_or(|(f, t)| from.nanos() > f.nanos() && to.nanos() > t.nanos());
            if later {
                knots.push((from, to));
            }
        }
        Self { knots }
    }

    /// The instant on the other clock; `None` without two knots. Saturates at the
    /// ends of 64 bits.
    pub(crate) fn apply(&self, from: F) -> Option<T> {
        if self.knots.len() < 2 {
            return None;
        }
        let after = self
            .knots
            .partition_point(|(f, _)| f.nanos() <= from.nanos());
        let left = after.saturating_sub(1).min(self.knots.len() - 2);
        let ((f0, t0), (f1, t1)) = (self.knots[left], self.knots[left + 1]);
        let distance = i128::from(from.nanos()) - i128::from(f0.nanos());
        let run = i128::from(f1.nanos()) - i128::from(f0.nanos());
        let rise = i128::from(t1.nanos()) - i128::from(t0.nanos());
        // |distance| and rise are below 2⁶⁵ each, and their product below 2¹³⁰ only
        // for times that no clock has: saturate there.
        let scaled = distance.saturating_mul(rise).saturating_add(run / 2);
        let to = i128::from(t0.nanos()) + scaled.div_euclid(run);
        Some(T::from_nanos(saturate(to)))
    }
}

fn saturate(value: i128) -> i64 {
    value.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
}

/// Median distance of neighbouring times, ns; `None` with fewer than two.
pub(crate) fn median_step(times: impl Iterator<Item = i64> + Clone) -> Option<i64> {
    let pairs = times.clone().zip(times.skip(1));
    let mut steps: Vec<i64> = pairs.map(|(one, next)| next.saturating_sub(one)).collect();
    let middle = steps.len() / 2;
    (!steps.is_empty()).then(|| *steps.select_nth_unstable(middle).1)
}

/// Nanoseconds as decimal seconds with `digits` digits after the point (at most
/// 9), rounded to nearest, by integer arithmetic: `1264.250903`.
pub(crate) fn decimal_seconds(nanos: i64, digits: u32) -> String {
    padded_seconds(nanos, 1, digits)
}

/// The same with at least `whole` digits before the point.
fn padded_seconds(nanos: i64, whole: usize, digits: u32) -> String {
    let digits = digits.min(9);
    let step = 10_i128.pow(9 - digits);
    let units = (i128::from(nanos) + step / 2).div_euclid(step);
    let scale = 10_i128.pow(digits);
    let sign = if units < 0 { "-" } else { "" };
    let units = units.abs();
    if digits == 0 {
        return format!("{sign}{units:0whole$}");
    }
    format!(
        "{sign}{:0whole$}.{:0width$}",
        units / scale,
        units % scale,
        width = digits as usize
    )
}

/// A time in the name of a file: nanoseconds with 19 digits, as many as the largest has,
/// so that names sort by time.
pub(crate) fn in_name(at: BoardNanos) -> String {
    format!("{:019}", at.0)
}

/// The same in seconds, with `digits` digits after the point.
pub(crate) fn seconds_in_name(at: BoardNanos, digits: u32) -> String {
    padded_seconds(at.0, 10, digits)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn pieces_join_and_go_on_outside() {
        let map = PiecewiseMap::from_knots([
            (PhoneNanos(1_000), BoardNanos(0)),
            (PhoneNanos(2_000), BoardNanos(1_001)),
            (PhoneNanos(1_500), BoardNanos(5_000)),
            (PhoneNanos(3_000), BoardNanos(2_000)),
        ]);
        let at = |phone| map.apply(PhoneNanos(phone)).unwrap().0;
        assert_eq!(
            [at(1_000), at(1_500), at(2_000), at(3_000)],
            [0, 501, 1_001, 2_000]
        );
        assert_eq!([at(0), at(4_000)], [-1_001, 2_999]);
        let empty = PiecewiseMap::<PhoneNanos, BoardNanos>::from_knots([]);
        assert_eq!(empty.apply(PhoneNanos(1)), None);
    }

    #[test]
    fn seconds_are_written_without_floats() {
        assert_eq!(decimal_seconds(1_264_250_902_773, 6), "1264.250903");
        assert_eq!(decimal_seconds(999_999_500, 6), "1.000000");
        assert_eq!(decimal_seconds(-1, 9), "-0.000000001");
        assert_eq!(decimal_seconds(-1, 6), "0.000000");
        assert_eq!(decimal_seconds(1_500_000_000, 0), "2");
        assert_eq!(decimal_seconds(i64::MAX, 9), "9223372036.854775807");
    }

    #[test]
    fn names_sort_by_time() {
        let times = [0, 999_999_999, 12_021_807_055, 100_020_673_025, i64::MAX].map(BoardNanos);
        let names = times.map(in_name);
        assert_eq!(names[2], "0000000012021807055");
        assert!(names.is_sorted() && names.iter().all(|name| name.len() == 19));
        let names = times.map(|at| seconds_in_name(at, 6));
        assert_eq!(names[2], "0000000012.021807");
        assert!(names.is_sorted() && names.iter().all(|name| name.len() == 17));
    }

    proptest! {
        #[test]
        fn no_time_panics(from: i64, to: i64, t: i64) {
            let _ = decimal_seconds(t, 6);
            let pieces = PiecewiseMap::from_knots([
                (PhoneNanos(from), BoardNanos(to)),
                (PhoneNanos(t), BoardNanos(i64::MAX)),
            ]);
            let _ = pieces.apply(PhoneNanos(to));
        }
    }
}
