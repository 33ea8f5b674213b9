//! The link and the handlers under its load; the crystal.

use std::ops::RangeInclusive;
use std::time::Duration;

use crate::Received;
use crate::imu::Scale;
use protocol::{
    CORE_HZ, HandlerTime, Handlers, MIN_PULSE_GAP, MIN_PULSE_WIDTH, Output, QueryImu, Status,
    TickDelta,
};
use twist_sync::robust::median;

use super::{BoardTest, PERIOD, millis};
use crate::bring_up::BringUpError;
use crate::bring_up::train::{PulseGrid, Trains};

/// A session's messages are some 30 kB/s; this leaves room for ten.
const MIN_THROUGHPUT: f64 = 300e3;

/// Time for which the host does not read, with the link full, so that its driver's buffers are
/// soon full too.
const STALL: Duration = Duration::from_millis(1_500);

/// Supply that the flash's wait states (RM0090 table 10) and the USB transceiver need, mV.
const SUPPLY_MV: RangeInclusive<u16> = 2_700..=3_600;

/// The crystal's 30 ppm and a computer's 70.
const MAX_CLOCK_PPM: f64 = 100.0;

const UNREAD: &str = "a host that does not read";

/// The firmware masks everything only while no edge of the trigger is due within this time, µs.
const MASKED_US: f64 = 15.0;

/// A tenth of the millisecond in which the queues to the hand-over do not fill, µs.
const MASKED_BELOW_US: f64 = 100.0;

const STILL: &str = "the core's cycle counter stands still: take a debug probe off and reset";

const SLOW: &str = "wait states, or a handler of higher priority that takes too long";

/// Handlers, their names, and their longest run times, in µs: for the trigger's the gap between two
/// pulses, for the outputs' the shortest pulse, whose end they arm. The two below wait for those
/// and for each other; within a millisecond the queues before them do not fill (`EVENTS`,
/// `OUTPUT_EVENTS` in the firmware).
type Handler = (&'static str, fn(&Handlers) -> HandlerTime, f64);
const HANDLERS: [Handler; 4] = [
    ("handler of the trigger", |all| all.trigger, 20.0),
    ("handler of the outputs", |all| all.outputs, 50.0),
    ("handler of the hand-over", |all| all.handover, 1_000.0),
    ("handler of USB", |all| all.usb, 1_000.0),
];

impl BoardTest<'_> {
    pub(super) fn link(&mut self) -> Result<(), BringUpError> {
        let grid = self.start(Output::Camera, PERIOD, MIN_PULSE_WIDTH)?;
        self.fill(true)?;
        let (from, _) = self.board.ping()?;
        let mut full = self.receive_for(millis(5_000))?;
        let (to, _) = self.board.ping()?;
        self.fill(false)?;
        let rate = full.filler as f64 / (to - from).as_secs_f64();
        self.check(
            "throughput",
            rate >= MIN_THROUGHPUT && full.damaged == 0,
            format!(
                "{:.0} kB/s beside everything else, {} frames damaged",
                rate / 1e3,
                full.damaged
            ),
            format!("{:.0} kB/s, none damaged", MIN_THROUGHPUT / 1e3),
            "the cable, a hub, or a computer that is busy",
        );
        full.append(self.receive_for(millis(1_500))?);
        self.fill(true)?;
        self.board.pause(STALL);
        self.fill(false)?;
        let stalled = self.receive_for(millis(3_000))?;
        let rest = self.stop(Output::Camera)?;
        let counted = stalled.dropped().zip(full.dropped());
        let lost = stalled.lost + stalled.lost_filler;
        let counted = counted.map(|(after, before)| after.saturating_sub(before));
        let unread = format!(
            "not read for {} s: {} messages lost, the board counted {}",
            STALL.as_secs_f64(),
            lost,
            counted.map_or_else(|| String::from("nothing"), |count| count.to_string())
        );
        match (lost, counted) {
            (0, Some(0)) => self.skip(
                UNREAD,
                &unread,
                "a computer that reads ahead of its programs",
            ),
            (lost, counted) => self.check(
                UNREAD,
                counted == Some(lost) && stalled.damaged == 0,
                unread,
                "each lost message counted by the board",
                "messages are lost where the board does not see it",
            ),
        }
        full.append(stalled);
        full.append(rest);
        self.handlers(&grid, &full);
        Ok(())
    }

    /// Checks the board's handlers and its core with the link full.
    fn handlers(&mut self, grid: &PulseGrid, received: &Received) {
        let mut trains = Trains::default();
        trains.compare(grid, &received.pulses);
        let most = |of: fn(&Status) -> u32| received.statuses.iter().map(of).max().unwrap_or(0);
        let latency = most(|status| status.trigger_latency.max(status.output_latency));
        let late = most(|status| status.trigger.late);
        self.check(
            "handlers",
            latency <= MIN_PULSE_GAP && late == 0 && trains.grid_error.within(0, 0),
            format!(
                "slowest {:.1} µs after its edge, {late} edges late",
                micros(latency.into())
            ),
            format!("{:.0} µs, none late", micros(MIN_PULSE_GAP.into())),
            SLOW,
        );
        let handlers: Vec<Handlers> = received.statuses.iter().map(|s| s.handlers).collect();
        for (name, of, limit_us) in HANDLERS {
            let times = || handlers.iter().map(of);
            let worst = cycles_us(times().map(|time| time.worst).max().unwrap_or(0));
            let mean = cycles_us(times().map(|time| time.mean()).max().unwrap_or(0));
            let busy = times().map(|time| time.cycles).max().unwrap_or(0);
            let unmetered = times().any(|time| time.calls > 0 && time.cycles == 0);
            self.check(
                name,
                worst <= limit_us && !unmetered,
                format!(
                    "worst {worst:.1} µs, mean {mean:.1} µs, {:.2} % of the time",
                    f64::from(busy) / f64::from(CORE_HZ) * 100.0
                ),
                format!("{limit_us:.0} µs"),
                if unmetered { STILL } else { SLOW },
            );
        }
        let all = cycles_us(most(|status| status.masked.all));
        let below = cycles_us(most(|status| status.masked.below_trigger));
        self.check(
            "masked interrupts",
            all <= MASKED_US && below <= MASKED_BELOW_US,
            format!("all for {all:.1} µs at most, those below the trigger for {below:.1} µs"),
            format!("{MASKED_US:.0} µs, {MASKED_BELOW_US:.0} µs"),
            SLOW,
        );
        let load = most(|status| status.cpu_permille.into());
        let stack = |status: &Status| status.stack_used * 100 / status.stack_size.max(1);
        let stack = received.statuses.iter().map(stack).max().unwrap_or(0);
        self.check(
            "core and stack",
            load <= 900 && stack <= 80,
            format!(
                "core busy for {:.1} % with the link full, {stack} % of the stack used",
                f64::from(load) / 10.0
            ),
            "90 % of the core, 80 % of the stack",
            "more work than the chip has time or room for",
        );
    }

    pub(super) fn clock(&mut self, length: Duration) -> Result<(), BringUpError> {
        const REASON: &str =
            "the board does not run on its crystal, or the computer's clock is off";
        let scale = Scale::from_setup(&self.board.call(QueryImu)?);
        let (mut temperature, mut die, mut supply, mut best) = (None, None, None, Vec::new());
        let begun = self.board.now();
        while self.board.now().saturating_sub(begun) < length {
            // The quickest of ten exchanges waited least in any queue.
            let mut quickest: Option<(Duration, f64, f64)> = None;
            for _ in 0..10 {
                let received = self.receive_for(millis(50))?;
                if let Some(status) = received.statuses.last() {
                    die = status.die_decidegrees;
                    supply = status.supply_mv;
                }
                if let (Some(scale), Some(sample)) = (&scale, received.imu.last()) {
                    temperature = Some(scale.apply(sample).temperature);
                }
                let (ticks, trip) = self.board.ping()?;
                if quickest.is_none_or(|(least, ..)| trip < least) {
                    let host = (self.board.steady().saturating_sub(trip / 2)).as_secs_f64();
                    quickest = Some((trip, host, ticks.as_secs_f64()));
                }
            }
            best.extend(quickest);
        }
        if let Some(millivolts) = supply {
            self.check(
                "supply",
                SUPPLY_MV.contains(&millivolts),
                format!("{:.2} V", f64::from(millivolts) / 1e3),
                format!(
                    "{:.1} to {:.1} V",
                    f64::from(*SUPPLY_MV.start()) / 1e3,
                    f64::from(*SUPPLY_MV.end()) / 1e3
                ),
                "the chip's supply (VDD) is out of its range: measure the 3V pin, and look for a short",
            );
        }
        let half = best.len() / 2;
        let slopes: Vec<f64> = (best.iter().zip(best.iter().skip(half)))
            .map(|((_, h0, b0), (_, h1, b1))| (b1 - b0) / (h1 - h0))
            .collect();
        let Some(slope) = median(&slopes) else {
            self.skip("crystal", "too short a time to compare clocks", REASON);
            return Ok(());
        };
        let ppm = (slope - 1.0) * 1e6;
        self.measured.crystal_ppm = Some(ppm);
        let warmth = |celsius: Option<f64>| {
            celsius.map_or_else(
                || String::from("of unknown temperature"),
                |celsius| format!("at {celsius:.1} °C"),
            )
        };
        let warmth = format!(
            "the chip {}, the IMU {}",
            warmth(die.map(|tenths| f64::from(tenths) / 10.0)),
            warmth(temperature)
        );
        self.check(
            "crystal",
            ppm.abs() <= MAX_CLOCK_PPM,
            format!("{ppm:+.1} ppm from this computer's clock, {warmth}"),
            format!("{MAX_CLOCK_PPM} ppm"),
            REASON,
        );
        Ok(())
    }
}

fn cycles_us(cycles: u32) -> f64 {
    f64::from(cycles) * 1e6 / f64::from(CORE_HZ)
}

fn micros(ticks: i64) -> f64 {
    TickDelta(ticks).as_secs_f64() * 1e6
}
