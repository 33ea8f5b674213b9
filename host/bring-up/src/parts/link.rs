//! The link and the handlers under its load; the crystal.

use std::time::Duration;

use board::imu::Scale;
use protocol::{Dropped, MIN_PULSE_GAP, MIN_PULSE_WIDTH, Status, TICK_HZ, TickDelta};
use twist_sync::robust::median;

use super::{PERIOD, Session};
use crate::BringUpError;
use crate::bench::{Heard, millis};
use crate::train::{Grid, Trains};

/// A session's messages are some 30 kB/s; this leaves room for ten.
const MIN_THROUGHPUT: f64 = 300e3;

/// How long the host does not read.
const STALL: Duration = Duration::from_millis(1_500);

/// How long the clocks are compared.
const CLOCK_TIME: Duration = Duration::from_secs(60);

/// The crystal's 30 ppm and a computer's 70.
const MAX_CLOCK_PPM: f64 = 100.0;

impl Session<'_> {
    pub(super) fn link(&mut self) -> Result<(), BringUpError> {
        let grid = self.start(PERIOD, MIN_PULSE_WIDTH)?;
        self.fill(u32::MAX)?;
        let (from, _) = self.board.ping()?;
        let mut full = self.hear(millis(5_000))?;
        let (to, _) = self.board.ping()?;
        self.fill(0)?;
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
        full.append(self.hear(millis(1_500))?);
        std::thread::sleep(STALL);
        let stalled = self.hear(millis(3_000))?;
        let rest = self.stop()?;
        let before = full.statuses.last().map(|status| dropped(&status.dropped));
        let after = stalled
            .statuses
            .last()
            .map(|status| dropped(&status.dropped));
        let counted = after.zip(before).map(|(a, b)| a.saturating_sub(b));
        self.check(
            "a host that does not read",
            counted == Some(stalled.lost) && stalled.damaged == 0,
            format!(
                "not read for {} s: {} messages lost, the board counted {}",
                STALL.as_secs_f64(),
                stalled.lost,
                counted.map_or_else(|| String::from("nothing"), |count| count.to_string())
            ),
            "each lost message counted by the board",
            "messages are lost where the board does not see it",
        );
        full.append(stalled);
        full.append(rest);
        self.handlers(&grid, &full);
        Ok(())
    }

    /// How the board's handlers and its core fared with the link full.
    fn handlers(&mut self, grid: &Grid, heard: &Heard) {
        let mut trains = Trains::default();
        trains.compare(grid, &heard.pulses);
        let most = |of: fn(&Status) -> u32| heard.statuses.iter().map(of).max().unwrap_or(0);
        let latency = most(|status| status.trigger_latency.max(status.output_latency));
        let late = most(|status| status.trigger.late);
        let busy = most(|status| status.trigger_busy);
        self.check(
            "handlers",
            latency <= MIN_PULSE_GAP && late == 0 && trains.grid_error.within(0, 0),
            format!(
                "slowest {:.1} µs, {:.2} % of the time, {late} edges late",
                micros(latency.into()),
                f64::from(busy) / f64::from(TICK_HZ) * 100.0
            ),
            format!("{:.0} µs, none late", micros(MIN_PULSE_GAP.into())),
            "wait states, or a handler of higher priority that takes too long",
        );
        let load = most(|status| status.cpu_permille.into());
        let stack = |status: &Status| status.stack_used * 100 / status.stack_size.max(1);
        let stack = heard.statuses.iter().map(stack).max().unwrap_or(0);
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

    pub(super) fn clock(&mut self) -> Result<(), BringUpError> {
        let scale = Scale::of(&self.board.imu()?);
        let (mut temperature, mut best) = (None, Vec::new());
        let begun = self.board.now();
        while self.board.now().saturating_sub(begun) < CLOCK_TIME {
            // Of ten exchanges the quickest: it waited least in any queue.
            let mut quickest: Option<(Duration, f64, f64)> = None;
            for _ in 0..10 {
                let heard = self.hear(millis(50))?;
                if let (Some(scale), Some(sample)) = (&scale, heard.imu.last()) {
                    temperature = Some(scale.apply(sample).temperature);
                }
                let (ticks, trip) = self.board.ping()?;
                if quickest.is_none_or(|(least, ..)| trip < least) {
                    let host = (self.board.now().saturating_sub(trip / 2)).as_secs_f64();
                    quickest = Some((trip, host, ticks.as_secs_f64()));
                }
            }
            best.extend(quickest);
        }
        let half = best.len() / 2;
        let slopes: Vec<f64> = (best.iter().zip(best.iter().skip(half)))
            .map(|((_, h0, b0), (_, h1, b1))| (b1 - b0) / (h1 - h0))
            .collect();
        let ppm = median(&slopes).map_or(f64::NAN, |slope| (slope - 1.0) * 1e6);
        let warmth = temperature.map_or_else(
            || String::from("no temperature"),
            |celsius| format!("the IMU at {celsius:.1} °C"),
        );
        self.check(
            "crystal",
            ppm.abs() <= MAX_CLOCK_PPM,
            format!("{ppm:+.1} ppm from this computer's clock, {warmth}"),
            format!("{MAX_CLOCK_PPM} ppm"),
            "the board does not run on its crystal, or the computer's clock is off",
        );
        Ok(())
    }
}

fn micros(ticks: i64) -> f64 {
    TickDelta(ticks).as_secs_f64() * 1e6
}

/// What the board has dropped of the numbered streams.
const fn dropped(all: &Dropped) -> u64 {
    all.total() - all.answers as u64
}
