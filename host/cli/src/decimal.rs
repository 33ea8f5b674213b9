//! Numbers and times of the command line.
//!
//! A double holds a period of 30 frames a second to 4·10⁻¹⁸ s, as the board does.

use std::time::Duration;

use jiff::SignedDuration;
use protocol::{Period, TICK_HZ};

/// Ticks in a microsecond.
const TICKS_PER_US: f64 = TICK_HZ as f64 * 1e-6;

/// Not digits with at most one point.
const NOT_A_NUMBER: &str = "expected a decimal number such as 29.97";

/// Outside of what the board can do.
const PERIOD_OUT_OF_RANGE: &str = "expected a period within 1 ms and 1 s (1 to 1000 fps)";

/// More than 2³² − 1 ticks.
const TOO_LARGE: &str = "expected less than 89 s";

/// No number, or none of the units after it.
const NOT_A_TIME: &str = "expected a time such as 33330.652us, 1.5ms or 10s";

/// Parses a number without sign and exponent.
fn decimal(text: &str) -> Result<f64, &'static str> {
    let is_plain = text
        .bytes()
        .all(|byte| byte.is_ascii_digit() || byte == b'.');
    let number = text.parse().ok().filter(|_| is_plain);
    number.ok_or(NOT_A_NUMBER)
}

/// Converts a number of ticks to a period.
fn period(ticks: f64) -> Result<Period, &'static str> {
    let period = Period::from_ticks_f64(ticks);
    let in_bounds = period.in_bounds();
    in_bounds.then_some(period).ok_or(PERIOD_OUT_OF_RANGE)
}

/// For clap: a period as a time such as `33330.652us`.
///
/// # Errors
///
/// Not a time, or no period that the board takes.
pub(crate) fn parse_period(text: &str) -> Result<Period, &'static str> {
    period(unsigned_micros(text)? * TICKS_PER_US)
}

/// For clap: a period as frames a second.
///
/// # Errors
///
/// Not a number, or no period that the board takes.
pub(crate) fn parse_fps(text: &str) -> Result<Period, &'static str> {
    period(f64::from(TICK_HZ) / decimal(text)?)
}

/// For clap: a time such as `12us` as whole ticks, rounded to nearest.
///
/// # Errors
///
/// Not a time, or too many ticks.
pub(crate) fn parse_ticks(text: &str) -> Result<u32, &'static str> {
    let ticks = (unsigned_micros(text)? * TICKS_PER_US).round();
    if ticks <= f64::from(u32::MAX) {
        Ok(ticks as u32)
    } else {
        Err(TOO_LARGE)
    }
}

fn unsigned_micros(text: &str) -> Result<f64, &'static str> {
    const UNITS: [(&str, f64); 5] = [
        ("ns", 1e3),
        ("us", 1.0),
        ("µs", 1.0),
        ("ms", 1e-3),
        ("s", 1e-6),
    ];
    let known = UNITS.iter();
    let (number, per_us) = known
        .filter_map(|&(unit, per_us)| Some((text.strip_suffix(unit)?, per_us)))
        .find(|(number, _)| number.ends_with(|c: char| c.is_ascii_digit() || c == '.'))
        .ok_or(NOT_A_TIME)?;
    let number = decimal(number).map_err(|_| NOT_A_TIME)?;
    Ok(number / per_us)
}

/// For clap: a time of either sign, such as `-30us` or `1.5ms`, in microseconds.
///
/// # Errors
///
/// Not a time.
pub(crate) fn parse_micros(text: &str) -> Result<f64, &'static str> {
    match text.strip_prefix('-') {
        Some(digits) => unsigned_micros(digits).map(|micros| -micros),
        None => unsigned_micros(text),
    }
}

/// For clap: a time in seconds.
///
/// # Errors
///
/// As [`parse_micros`].
pub(crate) fn parse_seconds(text: &str) -> Result<f64, &'static str> {
    parse_micros(text).map(|micros| micros * 1e-6)
}

/// For clap: a time span such as `90s`, `5m`, `1.5h` or `1h30m` in real time.
///
/// # Errors
///
/// The text is not a time span, or not within 0 and a week.
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

/// For clap: the length of something in whole ticks, more than none.
///
/// # Errors
///
/// As [`parse_duration`], or it is zero.
pub(crate) fn parse_length(text: &str) -> Result<u64, &'static str> {
    let ticks = parse_duration(text)?;
    let is_any = ticks > 0;
    is_any
        .then_some(ticks)
        .ok_or("expected more than 0 s, such as 90s, 5m or 1h")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A period against one in picoseconds, to the resolution of a double.
    fn is_period(found: Period, picos: u64) -> bool {
        let exact = Period::from_picos(picos).unwrap();
        found.0.abs_diff(exact.0) <= 2 + exact.0 / (1 << 52)
    }

    #[test]
    fn a_period_in_microseconds_is_as_fine_as_the_boards() {
        for (text, picos) in [
            ("33330.652us", 33_330_652_000),
            ("33330.652540µs", 33_330_652_540),
            ("33330652.54ns", 33_330_652_540),
            ("33.33065254ms", 33_330_652_540),
            ("0.0333s", 33_300_000_000),
        ] {
            assert!(is_period(parse_period(text).unwrap(), picos), "{text}");
        }
        assert_eq!(parse_period("1000us"), Ok(Period::MIN));
        assert_eq!(parse_period("1000000.us"), Ok(Period::MAX));
        assert_eq!(parse_period("1s"), Ok(Period::MAX));
        assert_eq!(parse_fps("30"), Ok(Period::from_ticks(1_600_000)));
        assert_eq!(parse_fps("5"), Ok(Period::from_ticks(9_600_000)));
    }

    #[test]
    fn what_is_no_number_is_told() {
        for text in ["", ".", "-1", "1e3", "1,5", "1.2.3", " 1", "١"] {
            assert_eq!(parse_fps(text), Err(NOT_A_NUMBER), "{text}");
            let time = format!("{text}us");
            assert_eq!(parse_period(&time), Err(NOT_A_TIME), "{time}");
        }
        for text in ["1000", "us", "1 us", "1min", "1xs", "1mus"] {
            assert_eq!(parse_period(text), Err(NOT_A_TIME), "{text}");
        }
        assert_eq!(parse_fps("0.000"), Err(PERIOD_OUT_OF_RANGE));
        for text in ["999.999us", "1000000.001us", "999999999999999999us"] {
            assert_eq!(parse_period(text), Err(PERIOD_OUT_OF_RANGE));
        }
        for text in ["0.99", "1000.01"] {
            assert_eq!(parse_fps(text), Err(PERIOD_OUT_OF_RANGE));
        }
        assert_eq!(parse_ticks("99999999us"), Err(TOO_LARGE));
        assert_eq!(parse_ticks("12us"), Ok(576));
        assert_eq!(parse_ticks("0s"), Ok(0));
        assert_eq!(parse_ticks("0.0104us"), Ok(0));
        assert_eq!(parse_ticks("0.0105us"), Ok(1));
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
        assert!(parse_duration("0s").is_ok() && parse_length("0s").is_err());
        assert_eq!(parse_length("1s"), Ok(48_000_000));
        for text in ["", "m", "-1s", "90", "1d", "1.2.3", "9999h", "1e3", "5µ"] {
            assert!(parse_duration(text).is_err(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn six_places_agree_with_picoseconds(picos in 1_000_000_000_u64..=1_000_000_000_000) {
            let text = format!("{}.{:06}us", picos / 1_000_000, picos % 1_000_000);
            prop_assert!(is_period(parse_period(&text).unwrap(), picos));
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
