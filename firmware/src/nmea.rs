//! The sentences of a GNSS receiver, for a lidar that takes its time from one.
//!
//! The board pretends to stand still at 0° N 0° E with a valid fix: only date
//! and time mean anything. Times are UTC as Unix time gives it: without leap
//! seconds.

use core::fmt::Write as _;

use heapless::String;
use protocol::{
    END_UTC, GnssSettings, MAX_NMEA, MAX_PPS_WIDTH, MIN_OUTPUT_WIDTH, MIN_UTC, NMEA_WINDOW_MS,
    Refusal, Sentences, TICK_HZ, Ticks,
};
use time::UtcDateTime;

/// Time for which settings must remain within the dates that the sentences can express, in
/// seconds: an hour.
const DATE_MARGIN: i64 = 3_600;

/// The second that begins with the pulse at `at`, as Unix time.
#[must_use]
pub const fn utc_of(utc_at_zero: i64, at: Ticks) -> i64 {
    utc_at_zero.saturating_add((at.0 / TICK_HZ as u64) as i64)
}

/// Refuses settings that the board cannot keep.
///
/// # Errors
///
/// Date, length of the pulse, rate or end of the sentences out of bounds.
pub fn check(settings: &GnssSettings, now: Ticks) -> Result<(), Refusal> {
    let utc = utc_of(settings.utc_at_zero, now);
    if !(MIN_UTC..END_UTC - DATE_MARGIN).contains(&utc) {
        return Err(Refusal::GnssDateOutOfRange);
    }
    if !(MIN_OUTPUT_WIDTH..=MAX_PPS_WIDTH).contains(&settings.pulse_width) {
        return Err(Refusal::WidthOutOfRange {
            min: MIN_OUTPUT_WIDTH,
            max: MAX_PPS_WIDTH,
        });
    }
    let ends_us = settings.ends_us();
    if ends_us > NMEA_WINDOW_MS * 1_000 {
        return Err(Refusal::GnssWindowExceeded { ends_us });
    }
    Ok(())
}

/// The sentences for the second `utc` (Unix time), with line ends.
#[must_use]
pub fn text(sentences: Sentences, utc: i64) -> String<MAX_NMEA> {
    // In range: `check`.
    let utc = UtcDateTime::from_unix_timestamp(utc).unwrap_or(UtcDateTime::UNIX_EPOCH);
    let (year, month, day) = (utc.year(), u8::from(utc.month()), utc.day());
    let (hour, minute, second) = utc.as_hms();
    let mut text = String::new();
    sentence(&mut text, |text| {
        write!(
            text,
            "GPRMC,{hour:02}{minute:02}{second:02}.00,A,0000.0000,N,00000.0000,E,0.0,0.0,\
             {day:02}{month:02}{:02},,,A",
            year % 100
        )
    });
    if sentences == Sentences::RmcZda {
        sentence(&mut text, |text| {
            write!(
                text,
                "GPZDA,{hour:02}{minute:02}{second:02}.00,{day:02},{month:02},{year:04},00,00"
            )
        });
    }
    text
}

/// Adds a sentence: `$`, the body, `*` and its checksum (the exclusive or of the
/// body), line end. There is room: [`MAX_NMEA`].
fn sentence(
    text: &mut String<MAX_NMEA>,
    body: impl FnOnce(&mut String<MAX_NMEA>) -> core::fmt::Result,
) {
    let _ = text.push('$');
    let begin = text.len();
    let _ = body(text);
    let bytes = text.as_bytes().get(begin..).unwrap_or_default();
    let checksum = bytes.iter().fold(0, |sum, byte| sum ^ byte);
    let _ = write!(text, "*{checksum:02X}\r\n");
}

#[cfg(test)]
mod tests {
    use protocol::{Baud, NMEA_SLACK_MS};

    use super::*;
    use proptest::prelude::*;

    fn settings() -> GnssSettings {
        GnssSettings {
            utc_at_zero: 1_795_234_567,
            baud: Baud::B9600,
            line_inverted: true,
            sentences: Sentences::Rmc,
            delay_ms: 50,
            pulse_width: TICK_HZ / 50,
            pulse_inverted: false,
        }
    }

    #[test]
    fn sentences_are_as_in_the_standard() {
        // 2026-11-21 03:04:05 UTC.
        let utc = 1_795_230_245;
        assert_eq!(
            text(Sentences::RmcZda, utc).as_str(),
            "$GPRMC,030405.00,A,0000.0000,N,00000.0000,E,0.0,0.0,211126,,,A*5B\r\n\
             $GPZDA,030405.00,21,11,2026,00,00*61\r\n"
        );
    }

    /// The length that the window is worked out from is the length of the text.
    #[test]
    fn the_longest_text_is_told_right() {
        for sentences in [Sentences::Rmc, Sentences::RmcZda] {
            let settings = GnssSettings {
                sentences,
                ..settings()
            };
            let len = text(sentences, END_UTC - 1).len();
            assert!(len <= MAX_NMEA);
            let line_ms = (len as u32 * 10 * 1_000).div_ceil(settings.baud.hz());
            let ends_ms = u32::from(settings.delay_ms) + NMEA_SLACK_MS + line_ms;
            assert_eq!(settings.ends_us(), ends_ms * 1_000);
        }
    }

    #[test]
    fn what_cannot_be_kept_is_refused() {
        let check = |settings| check(&settings, Ticks(10 * u64::from(TICK_HZ)));
        assert_eq!(check(settings()), Ok(()));
        for utc_at_zero in [i64::MIN, MIN_UTC - 11, END_UTC - DATE_MARGIN - 10, i64::MAX] {
            let refused = check(GnssSettings {
                utc_at_zero,
                ..settings()
            });
            assert_eq!(refused, Err(Refusal::GnssDateOutOfRange));
        }
        for pulse_width in [0, MIN_OUTPUT_WIDTH - 1, MAX_PPS_WIDTH + 1, u32::MAX] {
            let refused = check(GnssSettings {
                pulse_width,
                ..settings()
            });
            assert!(matches!(refused, Err(Refusal::WidthOutOfRange { .. })));
        }
        // Any rate on either line: the gate inverts, not the board.
        let fastest = GnssSettings {
            baud: Baud::B115200,
            line_inverted: true,
            ..settings()
        };
        assert_eq!(check(fastest), Ok(()));
        for delay_ms in [426, u16::MAX] {
            let refused = check(GnssSettings {
                delay_ms,
                ..settings()
            });
            assert!(matches!(refused, Err(Refusal::GnssWindowExceeded { .. })));
        }
        let slow = GnssSettings {
            sentences: Sentences::RmcZda,
            delay_ms: 385,
            ..settings()
        };
        assert_eq!(check(slow), Ok(()));
    }

    proptest! {
        /// A parser that others wrote reads back the very second.
        #[test]
        fn a_public_parser_reads_the_time_back(utc in MIN_UTC..END_UTC) {
            let text = text(Sentences::RmcZda, utc);
            for line in text.as_str().lines() {
                let sentence = nmea::parse_nmea_sentence(line).unwrap();
                prop_assert_eq!(sentence.checksum, sentence.calc_checksum());
                match nmea::parse_str(line).unwrap() {
                    nmea::ParseResult::RMC(rmc) => {
                        prop_assert_eq!(rmc.status_of_fix, nmea::sentences::rmc::RmcStatusOfFix::Autonomous);
                        let time = rmc.fix_date.unwrap().and_time(rmc.fix_time.unwrap());
                        // Two digits of the year: the parser takes 83 to 99 for the last century.
                        let year = UtcDateTime::from_unix_timestamp(utc).unwrap().year();
                        if year < 2083 {
                            prop_assert_eq!(time.and_utc().timestamp(), utc);
                        }
                    }
                    nmea::ParseResult::ZDA(zda) => {
                        let date = zda.utc_date().unwrap();
                        prop_assert_eq!(date.and_time(zda.utc_time.unwrap()).and_utc().timestamp(), utc);
                    }
                    other => panic!("{other:?}"),
                }
            }
        }
    }
}
