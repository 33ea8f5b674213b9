//! Decimal numbers of the command line as exact times of the board, and exact times as
//! decimal numbers.
//!
//! `33330.652` µs is 1,599,871.296 ticks, and a period must be exactly that: no
//! number here ever becomes a float.

use std::time::Duration;

use jiff::SignedDuration;
use protocol::{Period, TICK_HZ};

/// The most digits of a number, before and behind the point together.
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
    #[error("expected a decimal number such as 33330.652")]
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
    /// Not a second in whole nanoseconds.
    #[error("expected microseconds with at most three digits after the point, up to 1 s")]
    NotNanos,
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
    /// The number as microseconds, in whole nanoseconds, less any fraction.
    fn whole_nanos(self) -> u128 {
        u128::from(self.digits) * 1_000 / self.scale()
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

/// For clap: a period in microseconds.
///
/// # Errors
///
/// Not a number, or no period that the board takes.
pub(crate) fn parse_period_us(text: &str) -> Result<Period, DecimalError> {
    period(text.parse::<Decimal>()?.micros_in_raw_ticks())
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

/// For clap: microseconds as whole ticks, rounded to nearest.
///
/// # Errors
///
/// Not a number, or too many ticks.
pub(crate) fn parse_us_ticks(text: &str) -> Result<u32, DecimalError> {
    let ticks = (text.parse::<Decimal>()?.micros_in_raw_ticks() + (1 << 31)) >> 32;
    u32::try_from(ticks).map_err(|_| DecimalError::TooLarge)
}

/// For clap: microseconds of either sign as whole nanoseconds.
///
/// # Errors
///
/// Not a number, more than a second, or a part of a nanosecond.
pub(crate) fn parse_us_nanos(text: &str) -> Result<i64, DecimalError> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text),
    };
    let micros = digits.parse::<Decimal>().ok();
    let micros = micros.filter(|micros| micros.places <= 3);
    let nanos = micros.and_then(|micros| i64::try_from(micros.whole_nanos()).ok());
    nanos
        .filter(|&nanos| nanos <= 1_000_000_000)
        .map(|nanos| sign * nanos)
        .ok_or(DecimalError::NotNanos)
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
        assert_eq!(
            parse_period_us("33330.652"),
            Ok(Period::from_picos(33_330_652_000).unwrap())
        );
        assert_eq!(
            parse_period_us("33330.652540"),
            Ok(Period::from_picos(33_330_652_540).unwrap())
        );
        assert_eq!(parse_period_us("1000"), Ok(Period::MIN));
        assert_eq!(parse_period_us("1000000."), Ok(Period::MAX));
        assert_eq!(
            parse_period_us("0200000.0"),
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
            assert_eq!(
                parse_period_us(text),
                Err(DecimalError::NotANumber),
                "{text}"
            );
        }
        assert_eq!(
            parse_period_us("1000.0000000000000000001"),
            Err(DecimalError::TooLong)
        );
        assert_eq!(parse_fps("0.000"), Err(DecimalError::Zero));
        for text in ["999.999", "1000000.001", "999999999999999999"] {
            assert_eq!(parse_period_us(text), Err(DecimalError::PeriodOutOfRange));
        }
        for text in ["0.99", "1000.01"] {
            assert_eq!(parse_fps(text), Err(DecimalError::PeriodOutOfRange));
        }
        assert_eq!(parse_us_ticks("99999999"), Err(DecimalError::TooLarge));
        assert_eq!(parse_us_ticks("12"), Ok(576));
        assert_eq!(parse_us_ticks("0.0104"), Ok(0));
        assert_eq!(parse_us_ticks("0.0105"), Ok(1));
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
    fn microseconds_are_read_without_floats() {
        assert_eq!(parse_us_nanos("6362.5"), Ok(6_362_500));
        assert_eq!(parse_us_nanos("0"), Ok(0));
        assert_eq!(parse_us_nanos("-0.001"), Ok(-1));
        assert_eq!(parse_us_nanos("1000000"), Ok(1_000_000_000));
        for bad in [
            "",
            ".",
            "1e3",
            "1.2345",
            "1000000.001",
            "99999999",
            "x",
            "--1",
            "1.-2",
        ] {
            assert!(parse_us_nanos(bad).is_err(), "{bad}");
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
            let text = format!("{}.{:06}", picos / 1_000_000, picos % 1_000_000);
            prop_assert_eq!(parse_period_us(&text).ok(), Period::from_picos(picos));
        }

        #[test]
        fn no_text_makes_it_panic(text in "[0-9.]{0,24}") {
            let _ = parse_period_us(&text);
            let _ = parse_fps(&text);
            let _ = parse_us_ticks(&text);
            let _ = parse_us_nanos(&text);
        }
    }
}
