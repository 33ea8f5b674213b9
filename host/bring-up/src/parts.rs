//! What is done on the board, and what of it must hold.

use std::time::Duration;

use board::Board;
use board::imu::{Scale, Spread};
use protocol::{
    Command, Dropped, ImuClock, ImuFlags, ImuSetup, ImuState, MIN_OUTPUT_WIDTH, MIN_PULSE_GAP,
    MIN_PULSE_WIDTH, Output, OutputAction, OutputStart, Period, Pulse, Status, TICK_HZ, TickDelta,
    TrainState, TriggerAlign, TriggerStart,
};
use twist_sync::robust::median;

use crate::bench::{Heard, hear, millis};
use crate::train::{Extent, Grid, Trains};
use crate::{BringUpError, Check, HandsOn, Histogram, Operator, Part, Verdict};

/// 30 a second; not a whole number of ticks.
const PERIOD: Period = period(33_333_333_333);

/// The trains that are measured: period and width in ticks. 400 a second is what the
/// strobe input takes for ever with two edges a pulse.
const TRAINS: [(Period, u32); 3] = [
    (PERIOD, MIN_PULSE_WIDTH),
    (period(2_500_012_345), MIN_PULSE_WIDTH),
    (period(200_000_000_000), TICK_HZ / 200),
];

/// How far pulses move on the way to another phase: 100 µs.
const SLEW: u32 = TICK_HZ / 10_000;

/// The most by which equal delays may differ: a signal that changes just when its
/// input is sampled is seen a tick later.
const TICK_OF_DOUBT: i64 = 1;

/// The longest plausible way from an edge to its capture: 0.5 µs. Two to three clocks
/// of synchroniser and eight of filter are 0.2 µs (RM0090 18.3.5, 18.4.7).
const MAX_DELAY: i64 = (TICK_HZ / 2_000_000) as i64;

/// How long somebody may take to do something at the board.
const HANDS_TIME: TickDelta = millis(120_000);

/// How long samples may be missing before SDA counts as unplugged, and how long the
/// board may take to have them back.
const IMU_BACK: TickDelta = millis(1_000);

/// A session's messages are some 30 kB/s; this leaves room for ten.
const MIN_THROUGHPUT: f64 = 300e3;

/// How long the host does not read.
const STALL: Duration = Duration::from_millis(1_500);

/// How long the clocks are compared.
const CLOCK_TIME: Duration = Duration::from_secs(60);

/// The crystal's 30 ppm and a computer's 70.
const MAX_CLOCK_PPM: f64 = 100.0;

const fn period(picos: u64) -> Period {
    match Period::from_picos(picos) {
        Some(period) => period,
        None => Period::MAX,
    }
}

fn micros(ticks: i64) -> f64 {
    TickDelta(ticks).as_secs_f64() * 1e6
}

/// `7 to 8 ticks`, `7 ticks`, `nothing`.
fn ticks(extent: Extent) -> String {
    match extent.0 {
        None => String::from("nothing"),
        Some((low, high)) if low == high => format!("{low} ticks"),
        Some((low, high)) => format!("{low} to {high} ticks"),
    }
}

/// A board that is being measured.
pub(crate) struct Session<'a> {
    board: &'a mut Board,
    operator: &'a mut dyn Operator,
    part: Part,
    checks: Vec<Check>,
    intervals: Histogram,
    /// From an edge of the trigger to its capture on PA2.
    trigger_delay: Option<i64>,
}

impl<'a> Session<'a> {
    pub(crate) fn new(
        board: &'a mut Board,
        operator: &'a mut dyn Operator,
    ) -> Result<Self, BringUpError> {
        let trigger = board.trigger()?;
        let output = board.output(Output::Two, OutputAction::Query)?;
        if trigger.state != TrainState::Stopped || output.state != TrainState::Stopped {
            return Err(BringUpError::InUse);
        }
        Ok(Self {
            board,
            operator,
            part: Part::Trigger,
            checks: Vec::new(),
            intervals: Histogram::default(),
            trigger_delay: None,
        })
    }

    pub(crate) fn results(self) -> (Vec<Check>, Histogram) {
        (self.checks, self.intervals)
    }

    pub(crate) fn measure(&mut self, part: Part) -> Result<(), BringUpError> {
        self.part = part;
        self.operator.begins(part);
        match part {
            Part::Trigger => self.trigger(),
            Part::Outputs => self.outputs(),
            Part::Imu => self.imu(),
            Part::Link => self.link(),
            Part::Clock => self.clock(),
        }
    }

    pub(crate) fn stop_everything(&mut self) -> Result<(), BringUpError> {
        self.board.stop_trigger()?;
        self.board.output(Output::Two, OutputAction::Stop)?;
        self.fill(0)
    }

    fn check(
        &mut self,
        name: &'static str,
        good: bool,
        measured: String,
        limit: impl Into<String>,
        reason: &'static str,
    ) {
        self.checks.push(Check {
            part: self.part,
            name,
            verdict: if good { Verdict::Pass } else { Verdict::Fail },
            measured,
            limit: limit.into(),
            reason,
        });
    }

    fn skip(&mut self, name: &'static str, why: &str, reason: &'static str) {
        self.checks.push(Check {
            part: self.part,
            name,
            verdict: Verdict::Skipped,
            measured: why.to_owned(),
            limit: String::new(),
            reason,
        });
    }

    fn hear(&mut self, length: TickDelta) -> Result<Heard, BringUpError> {
        hear(self.board, self.operator, length, |_| false)
    }

    fn hear_until(
        &mut self,
        length: TickDelta,
        done: impl FnMut(&Heard) -> bool,
    ) -> Result<Heard, BringUpError> {
        hear(self.board, self.operator, length, done)
    }

    /// Starts the trigger and gives the grid on which its pulses must be.
    fn start(&mut self, period: Period, width: u32) -> Result<Grid, BringUpError> {
        let status = self.board.start_trigger(TriggerStart {
            period,
            width,
            first_edge: None,
        })?;
        Ok(Grid::of(&status))
    }

    /// Stops the trigger and hears the rest of its messages.
    fn stop(&mut self) -> Result<Heard, BringUpError> {
        self.board.stop_trigger()?;
        self.hear(millis(300))
    }

    fn trigger(&mut self) -> Result<(), BringUpError> {
        let mut trains = Trains::default();
        for (period, width) in TRAINS {
            let grid = self.start(period, width)?;
            let mut heard = self.hear(millis(2_000))?;
            heard.append(self.stop()?);
            trains.compare(&grid, &heard.pulses);
            trains.find(&heard.pulses, width, &heard.strobe);
        }
        let moved = self.moves(&mut trains)?;
        self.check(
            "edges on their ticks",
            trains.grid_error.within(0, 0),
            format!(
                "{} pulses, {} off",
                trains.on_grid,
                ticks(trains.grid_error)
            ),
            "0 ticks off the exact sum of start and periods",
            "the timer's compare or the firmware's arithmetic",
        );
        self.check(
            "slew",
            moved.within(-1 - i64::from(SLEW), 1 + i64::from(SLEW)),
            format!("periods differ by {} while moving", ticks(moved)),
            format!("{SLEW} ticks, and 1 for the fraction"),
            "the firmware's way to another phase; a camera may lose frames",
        );
        self.check(
            "read-back",
            trains.read_back == trains.pulses && trains.read_back_delay.within(0, MAX_DELAY),
            format!(
                "{} of {} pulses seen on PA3, {} later",
                trains.read_back,
                trains.pulses,
                ticks(trains.read_back_delay)
            ),
            format!("all of them, at most {MAX_DELAY} ticks later"),
            "the wire from PA5 to PA3, or what it passes on its way",
        );
        self.captures("strobe input", &trains, MAX_DELAY);
        self.trigger_delay = trains.delay.0.map(|(low, _)| low);
        Ok(())
    }

    /// What captures on PA2 say of trains.
    fn captures(&mut self, name: &'static str, trains: &Trains, max_delay: i64) {
        let steady = trains.delay.spread().is_some_and(|s| s <= TICK_OF_DOUBT);
        self.check(
            name,
            trains.captured == trains.pulses && steady && trains.delay.within(0, max_delay),
            format!(
                "{} of {} pulses captured on PA2, {} after their edge",
                trains.captured,
                trains.pulses,
                ticks(trains.delay)
            ),
            format!("all of them, after one constant of at most {max_delay} ticks"),
            "the wire to PA2; or an edge that is not made by the timer",
        );
        self.check(
            "pulse width",
            trains.width_error.within(-TICK_OF_DOUBT, TICK_OF_DOUBT),
            format!("{} from what was asked for", ticks(trains.width_error)),
            "0 ticks, 1 in doubt",
            "the falling edge was not armed in time",
        );
    }

    /// Jumps, slews and changes the period; gives by how much periods differed while
    /// slewing.
    fn moves(&mut self, trains: &mut Trains) -> Result<Extent, BringUpError> {
        let first = self.start(PERIOD, MIN_PULSE_WIDTH)?;
        let mut heard = self.hear(millis(500))?;
        trains.compare(&first, &heard.pulses);
        let third = TickDelta(i64::from(PERIOD.ticks() / 3));
        let mut anchor = first.at + third;
        let mut slewed = Extent::default();
        for slew in [0, SLEW] {
            let plan = self.board.align(TriggerAlign {
                anchor,
                period: PERIOD,
                slew,
            })?;
            let way = self.hear_until(millis(10_000), |heard| !heard.arrived.is_empty())?;
            let mut there = self.hear(millis(500))?;
            let mut both = way;
            both.append(std::mem::take(&mut there));
            for pulse in &both.pulses {
                if pulse.number >= plan.arrival_pulse {
                    trains.on_grid += 1;
                    let off = PERIOD.phase_error(anchor, pulse.at);
                    trains.grid_error.add(off.0);
                }
            }
            if slew > 0 {
                slewed_by(&both.pulses, &mut slewed);
            }
            heard.append(both);
            anchor = anchor + millis(1);
        }
        let other = period(33_322_225_925);
        let status = self.board.set_period(other)?;
        let grid = Grid::of(&status);
        let mut changed = self.hear(millis(500))?;
        changed.append(self.stop()?);
        let after: Vec<Pulse> = (changed.pulses.iter())
            .filter(|pulse| pulse.number >= grid.number)
            .copied()
            .collect();
        trains.compare(&grid, &after);
        heard.append(changed);
        trains.find(&heard.pulses, MIN_PULSE_WIDTH, &heard.strobe);
        Ok(slewed)
    }

    fn outputs(&mut self) -> Result<(), BringUpError> {
        const NAME: &str = "output 2 on the strobe input";
        const REASON: &str = "the wire from PE11 to PA2; or the start delay between TIM2 and TIM1, \
                              which the firmware takes from the simulated board";
        if !self.operator.asked(HandsOn::MoveStrobeWire) {
            self.skip(NAME, "nobody there to move the wire", REASON);
            return Ok(());
        }
        self.start_output()?;
        let found = self.hear_until(HANDS_TIME, |heard| !heard.strobe.is_empty())?;
        if found.strobe.is_empty() {
            self.check(
                NAME,
                false,
                String::from("no edge of PE11 on PA2 within two minutes"),
                "the wire moved from PA5 to PE11",
                REASON,
            );
            return Ok(());
        }
        // A wire that is being plugged in bounces.
        self.hear(millis(1_000))?;
        self.stop_output()?;
        self.start_output()?;
        let mut heard = self.hear(millis(3_000))?;
        heard.append(self.stop_output()?);
        let pulses: Vec<Pulse> = heard.outputs.iter().map(|output| output.pulse).collect();
        let mut trains = Trains::default();
        trains.find(&pulses, MIN_OUTPUT_WIDTH, &heard.strobe);
        self.captures(NAME, &trains, MAX_DELAY);
        let measured = trains.delay.0.zip(self.trigger_delay);
        match measured {
            Some(((low, _), trigger)) => self.check(
                "output 2 beside the trigger",
                (low - trigger).abs() <= TICK_OF_DOUBT,
                format!("{:+} ticks", low - trigger),
                "0 ticks, 1 in doubt",
                REASON,
            ),
            None => self.skip(
                "output 2 beside the trigger",
                "the trigger or output 2 was not captured",
                REASON,
            ),
        }
        Ok(())
    }

    fn start_output(&mut self) -> Result<(), BringUpError> {
        let start = OutputAction::Start(OutputStart {
            period: PERIOD,
            width: MIN_OUTPUT_WIDTH,
            first_edge: None,
            first_fraction: 0,
        });
        self.board.output(Output::Two, start)?;
        Ok(())
    }

    fn stop_output(&mut self) -> Result<Heard, BringUpError> {
        self.board.output(Output::Two, OutputAction::Stop)?;
        self.hear(millis(300))
    }

    fn imu(&mut self) -> Result<(), BringUpError> {
        let setup = self.board.imu()?;
        if setup.status.state != ImuState::Running {
            self.check(
                "data-ready",
                false,
                format!("the IMU is {:?}; {}", setup.status.state, fault(&setup)),
                "samples",
                "the IMU's supply, SCL, SDA with their pull-ups, or INT at PA1",
            );
            return Ok(());
        }
        let heard = self.hear(millis(10_000))?;
        let after = self.board.imu()?;
        self.data_ready(&setup, &after, &heard);
        self.recovery()
    }

    fn data_ready(&mut self, before: &ImuSetup, after: &ImuSetup, heard: &Heard) {
        let intervals: Vec<u64> = (heard.imu.windows(2))
            .filter_map(|pair| {
                let [a, b] = pair else { return None };
                let broken = b.flags.has(ImuFlags::AFTER_LOSS) || b.seq != a.seq.wrapping_add(1);
                (!broken).then(|| (b.at - a.at).unsigned_abs())
            })
            .collect();
        self.intervals = histogram(&intervals);
        let mut spread = Spread::default();
        let mut extent = Extent::default();
        for &interval in &intervals {
            spread.add(interval as f64);
            extent.add(i64::try_from(interval).unwrap_or(i64::MAX));
        }
        let nominal = f64::from(before.interval);
        let off_ppm = spread
            .mean()
            .map_or(f64::NAN, |mean| (mean / nominal - 1.0) * 1e6);
        let external = after.status.clock == ImuClock::External;
        // On PA8's clock the sensor divides the board's own crystal.
        let most_ppm = if external { 10.0 } else { 15_000.0 };
        self.check(
            "sample rate",
            off_ppm.abs() <= most_ppm,
            format!(
                "{off_ppm:+.1} ppm from nominal, {:?} clock; intervals {}",
                after.status.clock,
                ticks(extent)
            ),
            format!("{most_ppm} ppm on this clock"),
            "the wire from PA8 to CLKIN; without it the sensor's own clock is off by up to 1 %",
        );
        let lost = heard.lost
            + u64::from(
                after
                    .status
                    .overcaptures
                    .saturating_sub(before.status.overcaptures),
            )
            + u64::from(after.status.late.saturating_sub(before.status.late));
        let gaps = intervals
            .iter()
            .filter(|&&i| i as f64 > 1.5 * nominal)
            .count();
        self.check(
            "data-ready",
            lost == 0 && gaps == 0 && !intervals.is_empty(),
            format!(
                "{} samples, {lost} lost or late, {gaps} gaps",
                heard.imu.len()
            ),
            "none lost, late or missing",
            "a handler that comes too late, or a loose wire at PA1",
        );
    }

    /// SDA is unplugged and plugged in again, while the trigger runs.
    fn recovery(&mut self) -> Result<(), BringUpError> {
        const NAME: &str = "recovery of the IMU";
        const REASON: &str = "the I2C bus is not freed, or the sensor is not set up again";
        let grid = self.start(PERIOD, MIN_PULSE_WIDTH)?;
        if !self.operator.asked(HandsOn::UnplugSda) {
            self.stop()?;
            self.skip(NAME, "nobody there to unplug SDA", REASON);
            return Ok(());
        }
        let failed = |status: &Status| status.imu.state != ImuState::Running;
        let mut heard = self.hear_until(HANDS_TIME, |h| h.statuses.last().is_some_and(failed))?;
        if !heard.statuses.last().is_some_and(failed) {
            self.stop()?;
            self.skip(NAME, "SDA was not unplugged within two minutes", REASON);
            return Ok(());
        }
        self.operator.asked(HandsOn::PlugSda);
        heard.append(self.hear_until(HANDS_TIME, |h| h.imu.len() > 1)?);
        let back = self.hear(IMU_BACK)?;
        let runs = back.statuses.last().is_some_and(|status| !failed(status));
        let enough = back.imu.len() > 400;
        heard.append(back);
        heard.append(self.stop()?);
        self.check(
            NAME,
            runs && enough,
            String::from(if runs && enough {
                "samples came again by themselves"
            } else {
                "the samples did not come again steadily"
            }),
            "samples again within a second of the plug",
            REASON,
        );
        let mut trains = Trains::default();
        trains.compare(&grid, &heard.pulses);
        self.check(
            "trigger beside a failed IMU",
            trains.grid_error.within(0, 0),
            format!(
                "{} pulses, {} off",
                trains.on_grid,
                ticks(trains.grid_error)
            ),
            "0 ticks off",
            "the recovery of the bus keeps the trigger's handler from running",
        );
        Ok(())
    }

    fn fill(&mut self, bytes_per_second: u32) -> Result<(), BringUpError> {
        self.board.call(&Command::Filler { bytes_per_second })?;
        Ok(())
    }

    fn link(&mut self) -> Result<(), BringUpError> {
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

    fn clock(&mut self) -> Result<(), BringUpError> {
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

fn slewed_by(pulses: &[Pulse], slewed: &mut Extent) {
    for pair in pulses.windows(2) {
        if let [a, b] = pair {
            let distance = (b.at - a.at).0;
            slewed.add(distance - i64::from(PERIOD.ticks()));
        }
    }
}

fn fault(setup: &ImuSetup) -> String {
    setup.status.last_fault.map_or_else(
        || String::from("no fault is noted"),
        |fault| format!("last fault: {fault:?}"),
    )
}

/// What the board has dropped of the numbered streams.
const fn dropped(all: &Dropped) -> u64 {
    all.total() - all.answers as u64
}

/// At most 60 bins.
fn histogram(intervals: &[u64]) -> Histogram {
    let (Some(&first), Some(&last)) = (intervals.iter().min(), intervals.iter().max()) else {
        return Histogram::default();
    };
    let bin = (last - first) / 60 + 1;
    let mut counts = vec![0; ((last - first) / bin + 1) as usize];
    for interval in intervals {
        if let Some(count) = counts.get_mut(((interval - first) / bin) as usize) {
            *count += 1;
        }
    }
    Histogram { first, bin, counts }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_interval_is_in_one_of_few_bins() {
        let all: Vec<u64> = (96_000..97_000).chain([200_000]).collect();
        let histogram = histogram(&all);
        assert!(histogram.counts.len() <= 61);
        assert_eq!(histogram.counts.iter().sum::<u64>(), all.len() as u64);
        assert_eq!(histogram.first, 96_000);
        assert_eq!(super::histogram(&[5, 5]).counts, [2]);
        assert_eq!(super::histogram(&[]), Histogram::default());
    }
}
