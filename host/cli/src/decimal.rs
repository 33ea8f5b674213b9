//! Decimal numbers of the command line as exact times of the board, and exact times as
//! decimal numbers.
//!
//! `33330.652us` is 1,599,871.296 ticks, and a period must be exactly that: no
//! number here ever becomes a float.

use std::time::Duration;

use jiff::SignedDuration;
use protocol::{Period, TICK_HZ};

/// The most digits of a number, before and after the point together.
const MAX_DIGITS: usize = 18;

/// A non-negative decimal number, exact: `digits · 10^-places`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Decimal {
    digits: u64,
    places: u32,
}

/// Why a text is no number for this use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum DecimalError {
    /// Not digits with at most one point.
    #[error("expected a decimal number such as 29.97")]
    NotANumber,
    /// More digits than are taken.
    #[error("expected at most {MAX_DIGITS} digits")]
    TooLong,
    /// Zero frames a second.
    #[error("expected a number above 0")]
    Zero,
    /// Outside of what the board can do.
    #[error("expected a period within 1 ms and 1 s (1 to 1000 fps)")]
    PeriodOutOfRange,
    /// More than 2³² − 1 ticks.
    #[error("expected less than 89 s")]
    TooLarge,
    /// No number, or none of the units after it.
    #[error("expected a time such as 33330.652us, 1.5ms or 10s")]
    NotATime,
}

impl std::str::FromStr for Decimal {
    type Err = DecimalError;

    fn from_str(text: &str) -> Result<Self, DecimalError> {
        let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
        let digits = || whole.bytes().chain(fraction.bytes());
        if digits().next().is_none() || !digits().all(|byte| byte.is_ascii_digit()) {
            return Err(DecimalError::NotANumber);
        }
        if digits().count() > MAX_DIGITS {
            return Err(DecimalError::TooLong);
        }
        Ok(Self {
            // 18 digits fit into 64 bits.
            digits: digits().fold(0, |sum, byte| sum * 10 + u64::from(byte - b'0')),
            places: u32::try_from(fraction.len()).map_err(|_| DecimalError::TooLong)?,
        })
    }
}

impl Decimal {
    /// The microseconds of a time with its unit.
    fn micros(text: &str) -> Result<Self, DecimalError> {
        const UNITS: [(&str, u32); 5] = [("ns", 0), ("us", 3), ("µs", 3), ("ms", 6), ("s", 9)];
        let known = UNITS.iter();
        let (number, nanos) = known
            .filter_map(|&(unit, zeros)| Some((text.strip_suffix(unit)?, zeros)))
            .find(|(number, _)| number.ends_with(|c: char| c.is_ascii_digit() || c == '.'))
            .ok_or(DecimalError::NotATime)?;
        let Self { digits, places } = match number.parse() {
            Err(DecimalError::NotANumber) => return Err(DecimalError::NotATime),
            number => number?,
        };
        // Three more places make microseconds of nanoseconds.
        let places = places + 3;
        let missing = 10_u64.pow(nanos.saturating_sub(places));
        Ok(Self {
            digits: digits.checked_mul(missing).ok_or(DecimalError::TooLarge)?,
            places: places.saturating_sub(nanos),
        })
    }

    fn scale(self) -> u128 {
        10_u128.pow(self.places)
    }

    /// The number as microseconds, in 2⁻³² ticks, rounded to nearest.
    fn micros_in_raw_ticks(self) -> u128 {
        // 10^18 · 48 · 2^32 < 2^98.
        let raw = (u128::from(self.digits) * u128::from(TICK_HZ / 1_000_000)) << 32;
        (raw + self.scale() / 2) / self.scale()
    }
}

/// A period of so many 2⁻³² ticks.
fn period(raw: u128) -> Result<Period, DecimalError> {
    let period = u64::try_from(raw).ok().map(Period);
    period
        .filter(|period| period.in_bounds())
        .ok_or(DecimalError::PeriodOutOfRange)
}

/// For clap: a period as a time such as `33330.652us`.
///
/// # Errors
///
/// Not a time, or no period that the board takes.
pub(crate) fn parse_period(text: &str) -> Result<Period, DecimalError> {
    period(Decimal::micros(text)?.micros_in_raw_ticks())
}

/// For clap: a period as frames a second, `48·10⁶ · 2³² / fps`.
///
/// # Errors
///
/// Not a number, or no period that the board takes.
pub(crate) fn parse_fps(text: &str) -> Result<Period, DecimalError> {
    let fps: Decimal = text.parse()?;
    let digits = u128::from(fps.digits);
    if digits == 0 {
        return Err(DecimalError::Zero);
    }
    // 48·10^6 · 2^32 · 10^18 < 2^118.
    period(((u128::from(TICK_HZ) << 32) * fps.scale() + digits / 2) / digits)
}

/// For clap: a time such as `12us` as whole ticks, rounded to nearest.
///
/// # Errors
///
/// Not a time, or too many ticks.
pub(crate) fn parse_ticks(text: &str) -> Result<u32, DecimalError> {
    let ticks = (Decimal::micros(text)?.micros_in_raw_ticks() + (1 << 31)) >> 32;
    u32::try_from(ticks).map_err(|_| DecimalError::TooLarge)
}

/// For clap: a time of either sign, such as `-30us` or `1.5ms`, in microseconds.
///
/// # Errors
///
/// Not a time.
pub(crate) fn parse_micros(text: &str) -> Result<f64, DecimalError> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1.0, digits),
        None => (1.0, text),
    };
    let micros = Decimal::micros(digits)?;
    Ok(sign * micros.digits as f64 / micros.scale() as f64)
}

/// For clap: a time in seconds.
///
/// # Errors
///
/// As [`parse_micros`].
pub(crate) fn parse_seconds(text: &str) -> Result<f64, DecimalError> {
    parse_micros(text).map(|micros| micros * 1e-6)
}

/// For clap: a time span such as `90s`, `5m`, `1.5h` or `1h30m` in real time.
///
/// # Errors
///
/// It is none, or not within 0 and a week.
pub(crate) fn parse_real_time(text: &str) -> Result<Duration, &'static str> {
    let span = text.parse::<SignedDuration>().ok();
    span.and_then(|span| Duration::try_from(span).ok())
        .filter(|&span| span <= Duration::from_secs(7 * 24 * 3_600))
        .ok_or("expected a duration such as 90s, 5m or 1h, at most a week")
}

/// For clap: the same as whole ticks.
///
/// # Errors
///
/// As [`parse_real_time`].
pub(crate) fn parse_duration(text: &str) -> Result<u64, &'static str> {
    let ticks = parse_real_time(text)?.as_nanos() * u128::from(TICK_HZ) / 1_000_000_000;
    // A week has fewer than 2^45.
    Ok(ticks as u64)
}

/// Nanoseconds as seconds with all their digits.
pub(crate) fn seconds(nanos: impl Into<i128>) -> String {
    let nanos: i128 = nanos.into();
    let sign = if nanos < 0 { "-" } else { "" };
    let nanos = nanos.unsigned_abs();
    format!(
        "{sign}{}.{:09}",
        nanos / 1_000_000_000,
        nanos % 1_000_000_000
    )
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use protocol::Ticks;

    use super::*;

    #[test]
    fn a_period_in_microseconds_is_exact() {
        for (text, picos) in [
            ("33330.652us", 33_330_652_000),
            ("33330.652540µs", 33_330_652_540),
            ("33330652.54ns", 33_330_652_540),
            ("33.33065254ms", 33_330_652_540),
            ("0.0333s", 33_300_000_000),
        ] {
            assert_eq!(parse_period(text).ok(), Period::from_picos(picos), "{text}");
        }
        assert_eq!(parse_period("1000us"), Ok(Period::MIN));
        assert_eq!(parse_period("1000000.us"), Ok(Period::MAX));
        assert_eq!(parse_period("1s"), Ok(Period::MAX));
        assert_eq!(
            parse_period("0200000.0us"),
            Ok(Period::from_ticks(9_600_000))
        );
    }

    #[test]
    fn frames_a_second_are_exact() {
        assert_eq!(parse_fps("30"), Ok(Period::from_ticks(1_600_000)));
        assert_eq!(parse_fps("15.0"), Ok(Period::from_ticks(3_200_000)));
        assert_eq!(parse_fps("5"), Ok(Period::from_ticks(9_600_000)));
        // 48·10⁶ / 29.97 = 1,601,601 + 601,599/1,000,999 … ticks, to 2⁻³³.
        let ntsc = parse_fps("29.97").unwrap();
        let exact = 48e6 / 29.97 * 4_294_967_296.0;
        assert!((ntsc.0 as f64 - exact).abs() < 2.0, "{}", ntsc.0);
    }

    #[test]
    fn what_is_no_number_is_told() {
        for text in ["", ".", "-1", "1e3", "1,5", "1.2.3", " 1", "١"] {
            assert_eq!(parse_fps(text), Err(DecimalError::NotANumber), "{text}");
            let time = format!("{text}us");
            assert_eq!(parse_period(&time), Err(DecimalError::NotATime), "{time}");
        }
        for text in ["1000", "us", "1 us", "1min", "1xs", "1mus"] {
            assert_eq!(parse_period(text), Err(DecimalError::NotATime), "{text}");
        }
        assert_eq!(
            parse_period("1000.0000000000000000001us"),
            Err(DecimalError::TooLong)
        );
        assert_eq!(parse_fps("0.000"), Err(DecimalError::Zero));
        for text in ["999.999us", "1000000.001us", "999999999999999999us"] {
            assert_eq!(parse_period(text), Err(DecimalError::PeriodOutOfRange));
        }
        for text in ["0.99", "1000.01"] {
            assert_eq!(parse_fps(text), Err(DecimalError::PeriodOutOfRange));
        }
        assert_eq!(parse_ticks("99999999us"), Err(DecimalError::TooLarge));
        assert_eq!(
            parse_ticks("999999999999999999s"),
            Err(DecimalError::TooLarge)
        );
        assert_eq!(parse_ticks("12us"), Ok(576));
        assert_eq!(parse_ticks("0s"), Ok(0));
        assert_eq!(parse_ticks("0.0104us"), Ok(0));
        assert_eq!(parse_ticks("0.0105us"), Ok(1));
    }

    #[test]
    fn nanoseconds_keep_all_digits() {
        assert_eq!(seconds(-1_000_000_001_i64), "-1.000000001");
        assert_eq!(
            seconds(1_403_636_579_758_555_392_i64),
            "1403636579.758555392"
        );
    }

    #[test]
    fn board_time_in_seconds_keeps_every_tick() {
        let of = |ticks| seconds(Ticks(ticks).as_nanos());
        assert_eq!(of(48_000_000 * 90), "90.000000000");
        assert_eq!(of(1), "0.000000021");
        assert_ne!(of(1 << 50), of((1 << 50) + 1));
    }

    #[test]
    fn times_of_either_sign_are_microseconds() {
        for (text, micros) in [
            ("6362.5us", 6_362.5),
            ("-30us", -30.0),
            ("1.5ms", 1_500.0),
            ("-2s", -2e6),
            ("1ns", 1e-3),
        ] {
            assert_eq!(parse_micros(text), Ok(micros), "{text}");
        }
        assert_eq!(parse_seconds("1500ms"), Ok(1.5));
        for bad in ["", ".", "30", "nanus", "--1us", "1.-2us"] {
            assert!(parse_micros(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn durations_are_exact_ticks() {
        assert_eq!(parse_duration("5m"), Ok(300 * 48_000_000));
        assert_eq!(parse_duration("90s"), Ok(90 * 48_000_000));
        assert_eq!(parse_duration("1.5h"), Ok(5_400 * 48_000_000));
        assert_eq!(parse_duration("0.5s"), Ok(24_000_000));
        for text in ["", "m", "-1s", "90", "1d", "1.2.3", "9999h", "1e3", "5µ"] {
            assert!(parse_duration(text).is_err(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn six_places_agree_with_picoseconds(picos in 1_000_000_000_u64..=1_000_000_000_000) {
            let text = format!("{}.{:06}us", picos / 1_000_000, picos % 1_000_000);
            prop_assert_eq!(parse_period(&text).ok(), Period::from_picos(picos));
        }

        #[test]
        fn no_text_makes_it_panic(text in "-?[0-9.]{0,24}([nuµm]?s)?") {
            let _ = parse_period(&text);
            let _ = parse_fps(&text);
            let _ = parse_ticks(&text);
            let _ = parse_micros(&text);
        }
    }
}
