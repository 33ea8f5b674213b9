//! The board as the GNSS receiver of a lidar: which second its pulses begin.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use protocol::{Baud, GnssReport, GnssSettings, QueryGnss, Sentences, StartGnss, TICK_HZ, Ticks};

use crate::{Board, Result};

/// Default time from the pulse to the sentences, ms. With a pulse of 20 ms
/// they begin 80 ms after its end and have ended 175 ms after its edge, with `$GPZDA`
/// 215 ms: within the limits of every lidar in `docs/wiring.md`.
pub const NMEA_DELAY_MS: u16 = 100;

/// Length of the pulse per second, ticks: 20 ms.
const PPS_WIDTH: u32 = TICK_HZ / 50;

/// Largest distance of a running epoch from this computer's clock at which it is kept, s: the
/// nearest second may be the one before or after.
const SAME_EPOCH_S: u64 = 1;

/// Returns settings for a lidar, with Unix time `utc_at_zero` at tick 0. The line is high when idle
/// if `idle_high`; `$GPZDA` follows `$GPRMC` if `zda`.
#[must_use]
pub const fn settings(utc_at_zero: i64, baud: Baud, idle_high: bool, zda: bool) -> GnssSettings {
    GnssSettings {
        utc_at_zero,
        baud,
        line_inverted: !idle_high,
        sentences: if zda {
            Sentences::RmcZda
        } else {
            Sentences::Rmc
        },
        delay_ms: NMEA_DELAY_MS,
        pulse_width: PPS_WIDTH,
        pulse_inverted: false,
    }
}

/// Parses the rate of a serial line, in Bd.
///
/// # Errors
///
/// There is no such rate; the text lists the rates.
pub fn parse_baud(text: &str) -> std::result::Result<Baud, String> {
    Baud::ALL
        .into_iter()
        .find(|baud| baud.hz().to_string() == text)
        .ok_or_else(|| String::from("expected 9600 or 115200"))
}

/// Returns the Unix time of the board's tick 0 by this computer's clock, to the nearest second, or
/// `None` if that clock is before 1970.
///
/// # Errors
///
/// The board does not answer.
pub fn utc_at_zero(board: &mut Board) -> Result<Option<i64>> {
    utc_at_zero_by(board, SystemTime::now())
}

/// Returns the Unix time of the board's tick 0, as [`utc_at_zero`], with the time of day `now`.
///
/// # Errors
///
/// The board does not answer.
pub fn utc_at_zero_by(board: &mut Board, now: SystemTime) -> Result<Option<i64>> {
    let wall = now.duration_since(UNIX_EPOCH);
    let (ticks, round_trip) = board.ping()?;
    Ok(wall.ok().map(|wall| utc_by(wall, ticks, round_trip)))
}

/// Returns the Unix time of tick 0, from a ping that was sent at `wall` since 1970, took
/// `round_trip` and found the board at `ticks`.
fn utc_by(wall: Duration, ticks: Ticks, round_trip: Duration) -> i64 {
    let utc = wall.as_secs_f64() + round_trip.as_secs_f64() / 2.0;
    (utc - ticks.as_secs_f64()).round() as i64
}

/// Starts pulse and sentences. Changes nothing if they already run with these settings and an epoch
/// at most a second off: a lidar keeps its time.
///
/// # Errors
///
/// The board does not answer or refuses: among others, because it runs with other
/// settings or another epoch.
pub fn start(board: &mut Board, settings: GnssSettings) -> Result<GnssReport> {
    let running = board.call(QueryGnss)?.settings;
    board.call(StartGnss(with_running_epoch(running, settings)))
}

fn with_running_epoch(running: Option<GnssSettings>, settings: GnssSettings) -> GnssSettings {
    running
        .filter(|running| {
            let same_epoch = GnssSettings {
                utc_at_zero: running.utc_at_zero,
                ..settings
            };
            *running == same_epoch
                && running.utc_at_zero.abs_diff(settings.utc_at_zero) <= SAME_EPOCH_S
        })
        .unwrap_or(settings)
}

#[cfg(test)]
mod tests {
    use protocol::Sentences;

    use super::*;

    #[test]
    fn a_running_epoch_is_kept_only_if_it_is_right_to_a_second() {
        let settings = GnssSettings {
            utc_at_zero: 1_700_000_000,
            baud: Baud::ALL[0],
            line_inverted: true,
            sentences: Sentences::Rmc,
            delay_ms: NMEA_DELAY_MS,
            pulse_width: 960_000,
            pulse_inverted: false,
        };
        let running_at = |utc_at_zero| GnssSettings {
            utc_at_zero,
            ..settings
        };
        assert_eq!(with_running_epoch(None, settings), settings);
        for near in [1_699_999_999, 1_700_000_000, 1_700_000_001] {
            let running = running_at(near);
            assert_eq!(with_running_epoch(Some(running), settings), running);
        }
        for far in [1_699_999_998, 1_700_000_002, i64::MIN] {
            let running = running_at(far);
            assert_eq!(with_running_epoch(Some(running), settings), settings);
        }
        let other = GnssSettings {
            delay_ms: 50,
            ..settings
        };
        assert_eq!(with_running_epoch(Some(other), settings), settings);
    }

    #[test]
    fn the_epoch_is_the_nearest_second() {
        let utc = |millis, ticks| {
            let wall = Duration::from_millis(millis);
            utc_by(wall, Ticks(ticks), Duration::from_millis(20))
        };
        assert_eq!(utc(1_700_000_010_000, 480_000_000), 1_700_000_000);
        assert_eq!(utc(1_700_000_010_480, 480_000_000), 1_700_000_000);
        assert_eq!(utc(1_700_000_010_495, 480_000_000), 1_700_000_001);
    }
}
