//! A lidar that takes its time from a GNSS receiver: pulse per second on PE9,
//! sentences on PC12, each through a gate that brings it to the lidar's levels.
//!
//! It reads its inputs as Velodyne's VLP-16 does: a rising edge begins a second; the
//! serial line is low when idle (user manual 63-9243 Rev. D, 7.4.3 and appendix G) and
//! has 9,600 Bd (as published with the lidar connected, see `docs/wiring.md`). The
//! `$GPRMC` that tells which second it is must have ended within 500 ms of the edge:
//! the manual's other case, a sentence that comes later, is not modelled. The
//! sensor decodes the line bit by bit, each in its middle. Both polarities and
//! other rates are settings, for other makes.
//!
//! Its time between two pulses is not modelled: what it would stamp is the second
//! of the last pulse and the time since.

use std::collections::VecDeque;

use jiff::civil::DateTime;
use jiff::tz::TimeZone;

use crate::wiring;
use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Drive, Level, Pin};
use stm32f4_sim::time::{SimDuration, SimTime, UNITS_PER_SECOND};

/// Wiring and settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarConfig {
    /// Rate of the serial line, Bd.
    pub baud: u32,
    /// The line is low when idle.
    pub idle_low: bool,
    /// The gate between PC12 and the lidar inverts, as `docs/wiring.md` wires one whose
    /// line is low when idle. Its input is pulled up.
    pub gate_inverts: bool,
    /// A second begins with a rising edge; otherwise with a falling one.
    pub rising: bool,
    /// Latest end of a sentence after its pulse.
    pub window: SimDuration,
    /// Voltage above which an input of the board's outputs is high: the gates' or, without gates,
    /// the lidar's own.
    pub input_high: f64,
}

impl Default for LidarConfig {
    /// Returns the settings of a VLP-16.
    fn default() -> Self {
        Self {
            baud: 9_600,
            idle_low: true,
            gate_inverts: true,
            rising: true,
            window: SimDuration::from_millis(500),
            input_high: wiring::GATE_HIGH,
        }
    }
}

/// A pulse and its sentences.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LidarSecond {
    /// The leading edge.
    pub pulse: SimTime,
    /// Length of the pulse; `None` while it lasts.
    pub width: Option<SimDuration>,
    /// All sentences after it, with line ends.
    pub text: String,
    /// End of the last sentence.
    pub ended: Option<SimTime>,
    /// The second that it begins, as Unix time, if the sentence came in time.
    pub utc: Option<i64>,
}

/// Errors on the inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct LidarFaults {
    /// Bytes without a stop bit.
    pub framing: u64,
    /// Sentences with a wrong checksum or none.
    pub checksum: u64,
    /// Number of `$GPRMC` that ended too late or came before any pulse.
    pub window: u64,
    /// Number of `$GPRMC` without a time.
    pub content: u64,
}

/// A byte that is being received.
#[derive(Clone, Copy, Debug)]
struct Receiving {
    start: SimTime,
    /// Bits sampled so far, the start bit included.
    bits: u32,
    byte: u8,
}

/// The lidar.
#[derive(Debug)]
pub struct Lidar {
    config: LidarConfig,
    line_high: bool,
    receiving: Option<Receiving>,
    line: Vec<u8>,
    seconds: VecDeque<LidarSecond>,
    faults: LidarFaults,
}

impl Lidar {
    /// Creates a lidar whose inputs are wired to PE9 and PC12.
    #[must_use]
    pub fn new(config: LidarConfig) -> Self {
        Self {
            config,
            line_high: false,
            receiving: None,
            line: Vec::new(),
            seconds: VecDeque::new(),
            faults: LidarFaults::default(),
        }
    }

    /// Removes and returns all complete seconds: all but the last.
    pub fn take_seconds(&mut self) -> Vec<LidarSecond> {
        let over = self.seconds.len().saturating_sub(1);
        self.seconds.drain(..over).collect()
    }

    /// Removes and returns all seconds. Data of the last one may be incomplete.
    pub fn take_all_seconds(&mut self) -> Vec<LidarSecond> {
        self.seconds.drain(..).collect()
    }

    /// Returns the errors so far.
    #[must_use]
    pub fn faults(&self) -> LidarFaults {
        self.faults
    }

    fn is_mark(&self) -> bool {
        self.line_high != self.config.idle_low
    }

    /// Returns the middle of bit `n` of a byte that began at `start`.
    fn middle(&self, start: SimTime, n: u32) -> SimTime {
        let halves = u64::from(2 * n + 1);
        let units = halves * UNITS_PER_SECOND / (2 * u64::from(self.config.baud.max(1)));
        start + SimDuration::from_units(units)
    }

    /// Handles the middle of a bit.
    fn sample(&mut self, receiving: Receiving, now: SimTime) {
        let mark = self.is_mark();
        let next = Receiving {
            bits: receiving.bits + 1,
            ..receiving
        };
        self.receiving = match receiving.bits {
            // Too short for a start bit.
            0 => (!mark).then_some(next),
            bit @ 1..=8 => Some(Receiving {
                byte: receiving.byte | u8::from(mark) << (bit - 1),
                ..next
            }),
            _ => {
                if mark {
                    self.byte(receiving.byte, now);
                } else {
                    self.faults.framing += 1;
                }
                None
            }
        };
    }

    fn byte(&mut self, byte: u8, now: SimTime) {
        self.line.push(byte);
        if byte == b'\n' {
            let line = std::mem::take(&mut self.line);
            self.sentence(&String::from_utf8_lossy(&line), now);
        } else if self.line.len() > 200 {
            self.line.clear();
            self.faults.checksum += 1;
        }
    }

    fn sentence(&mut self, line: &str, now: SimTime) {
        if let Some(second) = self.seconds.back_mut() {
            second.text.push_str(line);
            second.ended = Some(now);
        }
        let Some(body) = checked(line) else {
            self.faults.checksum += 1;
            return;
        };
        if !body.starts_with("GPRMC,") {
            return;
        }
        let window = self.config.window;
        let second = self.seconds.back_mut();
        match (second, utc_of(body)) {
            (_, None) => self.faults.content += 1,
            (Some(second), Some(utc)) if now <= second.pulse + window => second.utc = Some(utc),
            _ => self.faults.window += 1,
        }
    }
}

/// Returns the sentence between `$` and `*` if its checksum is right.
fn checked(line: &str) -> Option<&str> {
    let (body, sum) = line.trim_end().strip_prefix('$')?.split_once('*')?;
    let sum = u8::from_str_radix(sum, 16).ok()?;
    (body.bytes().fold(0, |all, byte| all ^ byte) == sum).then_some(body)
}

/// Returns the second of a `$GPRMC` as Unix time; years are of this century.
fn utc_of(body: &str) -> Option<i64> {
    let fields: Vec<&str> = body.split(',').collect();
    let (time, valid, date) = (fields.get(1)?, fields.get(2)?, fields.get(9)?);
    if *valid != "A" {
        return None;
    }
    let (day, month, year) = (date.get(..2)?, date.get(2..4)?, date.get(4..6)?);
    let reported = format!("20{year}{month}{day}{}", time.get(..6)?);
    let reported = DateTime::strptime("%Y%m%d%H%M%S", reported).ok()?;
    Some(
        reported
            .to_zoned(TimeZone::UTC)
            .ok()?
            .timestamp()
            .as_second(),
    )
}

impl PinModel for Lidar {
    fn name(&self) -> String {
        "lidar".to_owned()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        vec![wiring::PPS, wiring::NMEA]
    }

    fn inputs(&self) -> Vec<(Pin, f64)> {
        let high = self.config.input_high;
        vec![(wiring::PPS, high), (wiring::NMEA, high)]
    }

    fn power_on(&mut self, io: &mut PinIo<'_>) {
        self.line_high = !self.config.gate_inverts;
        io.drive(wiring::NMEA, Drive::PullUp);
    }

    fn on_pin_edge(&mut self, pin: Pin, level: Level, io: &mut PinIo<'_>) {
        if pin == wiring::NMEA {
            self.line_high = level.is_high() != self.config.gate_inverts;
            if self.receiving.is_none() && !self.is_mark() {
                self.receiving = Some(Receiving {
                    start: io.now(),
                    bits: 0,
                    byte: 0,
                });
            }
        } else if level.is_high() == self.config.rising {
            self.seconds.push_back(LidarSecond {
                pulse: io.now(),
                width: None,
                text: String::new(),
                ended: None,
                utc: None,
            });
        } else if let Some(second) = self.seconds.back_mut() {
            second.width.get_or_insert(io.now() - second.pulse);
        }
    }

    fn next_event(&self) -> Option<SimTime> {
        self.receiving
            .map(|receiving| self.middle(receiving.start, receiving.bits))
    }

    fn advance(&mut self, io: &mut PinIo<'_>) {
        let now = io.now();
        if let Some(receiving) = self.receiving
            && self.middle(receiving.start, receiving.bits) <= now
        {
            self.sample(receiving, now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stm32f4_sim::model_bench::ModelBench;

    /// Sends bytes on PC12 from `from` on, high when idle, as a UART does.
    fn send(bench: &mut ModelBench<Lidar>, from: SimTime, text: &str) {
        let bit = |n: u64| SimDuration::from_units(n * UNITS_PER_SECOND / 9_600);
        let mut bits = 0;
        for byte in text.bytes() {
            let frame = u16::from(byte) << 1 | 1 << 9;
            for n in 0..10 {
                bench.run_until(from + bit(bits));
                bench.set_pin(wiring::NMEA, Level::from(frame >> n & 1 == 1));
                bits += 1;
            }
        }
        bench.run_until(from + bit(bits));
        bench.set_pin(wiring::NMEA, Level::High);
    }

    fn ms(ms: u64) -> SimTime {
        SimTime::from_nanos(ms * 1_000_000)
    }

    fn pulse(bench: &mut ModelBench<Lidar>, at: SimTime) {
        bench.run_until(at);
        bench.set_pin(wiring::PPS, Level::High);
        bench.run_until(at + SimDuration::from_millis(20));
        bench.set_pin(wiring::PPS, Level::Low);
    }

    // From the NMEA literature: 1994-03-23, of this century here.
    const RMC: &str = "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n";

    #[test]
    fn it_takes_the_second_of_a_sentence_that_comes_in_time() {
        let mut bench = ModelBench::new(Lidar::new(LidarConfig::default()));
        pulse(&mut bench, ms(1_000));
        send(&mut bench, ms(1_050), RMC);
        pulse(&mut bench, ms(2_000));
        // 69 bytes take 72 ms.
        send(&mut bench, ms(2_430), RMC);
        pulse(&mut bench, ms(3_000));
        send(&mut bench, ms(3_050), &RMC.replace("*6A", "*6B"));
        pulse(&mut bench, ms(4_000));
        send(
            &mut bench,
            ms(4_050),
            "$GPRMC,123519,V,,,,,,,230394,,*33\r\n",
        );
        pulse(&mut bench, ms(5_000));
        let seconds = bench.model.take_seconds();
        assert_eq!(seconds.len(), 4);
        // `date -u -d 2094-03-23T12:35:19 +%s`
        assert_eq!(seconds[0].utc, Some(3_920_186_119));
        assert_eq!(seconds[0].text, RMC);
        assert_eq!(seconds[0].width, Some(SimDuration::from_millis(20)));
        assert!(seconds[1..].iter().all(|second| second.utc.is_none()));
        let faults = bench.model.faults();
        assert_eq!(faults.window, 1);
        assert_eq!(faults.checksum + faults.content, 2);
        assert_eq!(faults.framing, 0);
    }
}
