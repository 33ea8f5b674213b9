//! The parts of the test: what each does on the board, and its limits.

mod imu;
mod link;
mod resets;
mod wires;

use crate::{Board, BoardError, Event, Received};
use protocol::pins::pin_of;
use protocol::{
    AlignTrigger, BoardSettings, CORE_HZ, EdgeGrid, MIN_OUTPUT_WIDTH, MIN_PULSE_WIDTH, Output,
    Period, Pulse, QueryBoard, QueryGnss, QueryTrigger, SendFiller, SetBoard, SetPeriod,
    StartTrigger, StopGnss, StopTrigger, TICK_HZ, TickDelta, TrainState, TriggerAlign,
    TriggerStart,
};

use crate::finding::{Finding, FindingKind, Severity};

use crate::bring_up::train::{Extent, MAX_DELAY, PulseGrid, TICK_OF_DOUBT, Trains};
use crate::bring_up::{BringUpError, Check, IntervalHistogram, Operator, Part, Plan, Prompt};

/// 30 a second; not a whole number of ticks.
const PERIOD: Period = period(33_333_333_333);

/// The trains that are measured: period and width in ticks. The strobe input can keep up with 400
/// pulses a second, of two edges each.
const TRAINS: [(Period, u32); 3] = [
    (PERIOD, MIN_PULSE_WIDTH),
    (period(2_500_012_345), MIN_PULSE_WIDTH),
    (period(200_000_000_000), TICK_HZ / 200),
];

/// Most that a pulse moves on the way to another phase: 100 µs.
const SLEW: u32 = TICK_HZ / 10_000;

/// Longest wait for somebody to do something at the board.
const HANDS_TIME: TickDelta = millis(120_000);

/// Reason for leaving out a part that needs hands.
const NOBODY: &str = "nobody there to do it";

const fn period(picos: u64) -> Period {
    match Period::from_picos(picos) {
        Some(period) => period,
        None => Period::MAX,
    }
}

/// Returns a distance in board time.
const fn millis(ms: u32) -> TickDelta {
    TickDelta(ms as i64 * (TICK_HZ / 1_000) as i64)
}

/// Measurements that the board can keep.
#[derive(Debug, Default)]
struct Measured {
    /// From an edge at an input to its capture, in ticks beyond the delay that the board has.
    input_delay: Option<i64>,
    /// Output 2 after the trigger, in ticks.
    output_delay: Option<i64>,
    crystal_ppm: Option<f64>,
}

/// A board that is being measured.
pub(crate) struct BoardTest<'a> {
    pub(crate) board: &'a mut Board,
    pub(crate) operator: Operator<'a>,
    part: Part,
    pub(crate) checks: Vec<Check>,
    pub(crate) intervals: IntervalHistogram,
    /// From an edge of the trigger to its capture on PA2.
    trigger_delay: Extent,
    measured: Measured,
}

impl<'a> BoardTest<'a> {
    pub(crate) fn new(board: &'a mut Board, operator: Operator<'a>) -> Result<Self, BringUpError> {
        let mut running = board.call(QueryTrigger(Output::Camera))?.state != TrainState::Stopped;
        if board.hello().board.has_outputs() {
            for output in Output::AUXILIARY {
                running |= board.call(QueryTrigger(output))?.state != TrainState::Stopped;
            }
            running |= board.call(QueryGnss)?.status.state != TrainState::Stopped;
        }
        if running {
            return Err(BringUpError::InUse);
        }
        Ok(Self {
            board,
            operator,
            part: Part::Trigger,
            checks: Vec::new(),
            intervals: IntervalHistogram::default(),
            trigger_delay: Extent::default(),
            measured: Measured::default(),
        })
    }

    pub(crate) fn measure(&mut self, part: Part, plan: &Plan<'_>) -> Result<(), BringUpError> {
        self.part = part;
        (self.operator.say)(Prompt::Measures(part));
        match part {
            Part::Trigger => self.trigger(),
            Part::Outputs => self.outputs(),
            Part::Imu => self.imu(),
            Part::Link => self.link(),
            Part::Clock => self.clock(plan.clock),
            Part::Lidar => self.lidar(),
            Part::Replug => self.replug(),
            Part::Resets => self.resets(),
            Part::Buffer => self.buffer(),
            Part::Soak => self.soak(plan.soak),
        }
    }

    /// Asks for something to be done at the board. Returns the messages until `is_done` or until the
    /// link ends, and true if it ended; `None`, with a skipped check, if the request was not
    /// followed.
    fn by_hand(
        &mut self,
        (name, reason): (&str, &'static str),
        what: Prompt,
        mut is_done: impl FnMut(&Received) -> bool,
    ) -> Result<Option<(Received, bool)>, BringUpError> {
        if !self.operator.is_there {
            self.skip(name, NOBODY, reason);
            return Ok(None);
        }
        (self.operator.say)(what);
        let skips = self.operator.skips;
        let (mut received, mut done, mut skipped) = (Received::default(), false, false);
        let ended = self.link_ends(&mut received, HANDS_TIME, |received| {
            done = is_done(received);
            skipped = skips();
            done || skipped
        })?;
        if done || ended {
            return Ok(Some((received, ended)));
        }
        let why = if skipped {
            "left out"
        } else {
            "not done within two minutes"
        };
        self.skip(name, why, reason);
        Ok(None)
    }

    /// Receives the board's messages for `length` of board time.
    fn receive_for(&mut self, length: TickDelta) -> Result<Received, BringUpError> {
        self.receive_until(length, |_| false)
    }

    /// Receives the board's messages for `length` of board time, or until `done`.
    fn receive_until(
        &mut self,
        length: TickDelta,
        done: impl FnMut(&Received) -> bool,
    ) -> Result<Received, BringUpError> {
        let mut received = Received::default();
        self.hear_into(&mut received, length, done)?;
        Ok(received)
    }

    /// As [`Self::receive_until`]; `received` also holds the messages before an error.
    fn hear_into(
        &mut self,
        received: &mut Received,
        length: TickDelta,
        mut done: impl FnMut(&Received) -> bool,
    ) -> Result<(), BringUpError> {
        let end = self.board.ping()?.0 + length;
        let stop = self.operator.stop;
        let listened = self.board.listen("any message", stop, |board, event| {
            match event {
                Some(Event::Restarted { .. }) => return Err(BringUpError::Reset),
                Some(Event::OtherVersion { found }) => {
                    return Err(BoardError::OtherVersion { found }.into());
                }
                Some(event) => received.add(event),
                None => {}
            }
            let is_over = board.conversation().latest() >= end || done(received);
            Ok(is_over.then_some(()))
        })?;
        listened.ok_or(BringUpError::Stopped)
    }

    /// Returns the settings that the board keeps; with `keep`, stores the measurements in them.
    pub(crate) fn settings(&mut self, keep: bool) -> Result<BoardSettings, BringUpError> {
        let before = self.board.call(QueryBoard)?;
        if !keep {
            return Ok(before);
        }
        let changed = |setting: u8, by: Option<i64>| {
            let sum = i64::from(setting).saturating_add(by.unwrap_or(0));
            u8::try_from(sum.max(0)).unwrap_or(u8::MAX)
        };
        let clocks = |ticks: i64| ticks.saturating_mul((CORE_HZ / TICK_HZ).into());
        let settings = BoardSettings {
            output_start_delay: changed(
                before.output_start_delay,
                self.measured.output_delay.map(clocks),
            ),
            input_delay: changed(before.input_delay, self.measured.input_delay),
            crystal_ppb: (self.measured.crystal_ppm)
                .map_or(before.crystal_ppb, |ppm| Some((ppm * 1e3).round() as i32)),
        };
        Ok(self.board.call(SetBoard(settings))?)
    }

    pub(crate) fn stop_everything(&mut self) -> Result<(), BringUpError> {
        self.board.call(StopTrigger(Output::Camera))?;
        if self.board.hello().board.has_outputs() {
            for output in Output::AUXILIARY {
                self.board.call(StopTrigger(output))?;
            }
            self.board.call(StopGnss)?;
        }
        self.fill(false)
    }

    fn check(
        &mut self,
        name: impl Into<FindingKind>,
        good: bool,
        measured: String,
        limit: impl Into<String>,
        reason: &'static str,
    ) {
        let severity = if good { Severity::Good } else { Severity::Bad };
        self.checks.push(Check {
            part: self.part,
            finding: Finding::new(severity, name, measured).next_step(reason),
            limit: limit.into(),
        });
    }

    fn skip(&mut self, name: impl Into<FindingKind>, why: &str, reason: &'static str) {
        self.checks.push(Check {
            part: self.part,
            finding: Finding::check(name, why).next_step(reason),
            limit: String::new(),
        });
    }

    /// Starts a train and returns the edges that its pulses must have.
    fn start(
        &mut self,
        output: Output,
        period: Period,
        width: u32,
    ) -> Result<PulseGrid, BringUpError> {
        let start = TriggerStart {
            period,
            width,
            first_edge: None,
        };
        let status = self.board.call(StartTrigger { output, start })?;
        Ok(PulseGrid::from_status(&status))
    }

    /// Stops a train and returns the rest of its messages.
    fn stop(&mut self, output: Output) -> Result<Received, BringUpError> {
        self.board.call(StopTrigger(output))?;
        self.receive_for(millis(300))
    }

    fn trigger(&mut self) -> Result<(), BringUpError> {
        let mut trains = Trains::default();
        for (period, width) in TRAINS {
            let grid = self.start(Output::Camera, period, width)?;
            let mut received = self.receive_for(millis(2_000))?;
            received.append(self.stop(Output::Camera)?);
            trains.compare(&grid, &received.pulses);
            trains.find(&received.pulses, width, &received.strobe);
        }
        let moved = self.moves(&mut trains)?;
        self.check(
            "edges on their ticks",
            trains.grid_error.within(0, 0),
            trains.on_grid_text(),
            "0 ticks off the exact sum of start and periods; the pin follows the timer by a \
             constant of at most 0.1 µs",
            "the timer's compare or the firmware's arithmetic",
        );
        self.check(
            "slew",
            moved.within(-1 - i64::from(SLEW), 1 + i64::from(SLEW)),
            format!("periods differ by {moved} while moving"),
            format!("{SLEW} ticks, and 1 for the fraction"),
            "the firmware's way to another phase; a camera may lose frames",
        );
        let reason = "the wire from PA5 to PA3, or what it passes on its way";
        self.read_back("read-back", &trains, reason);
        self.captures("strobe input", "pulse width", &trains);
        self.trigger_delay = trains.delay;
        self.measured.input_delay = trains.delay.0.map(|(low, _)| low);
        Ok(())
    }

    /// Checks the read-back on PA3.
    fn read_back(&mut self, name: &str, trains: &Trains, reason: &'static str) {
        self.check(
            name,
            trains.is_read_back(),
            format!(
                "{} of {} pulses seen on PA3, {} later",
                trains.read_back, trains.pulses, trains.read_back_delay
            ),
            format!("all of them, after one constant of at most {MAX_DELAY} ticks"),
            reason,
        );
    }

    /// Checks the captures on PA2.
    fn captures(&mut self, name: &str, width: &str, trains: &Trains) {
        let steady = trains.delay.spread().is_some_and(|s| s <= TICK_OF_DOUBT);
        self.check(
            name,
            trains.captured == trains.pulses && steady && trains.delay.within(0, MAX_DELAY),
            format!(
                "{} of {} pulses captured on PA2, {} after their edge",
                trains.captured, trains.pulses, trains.delay
            ),
            format!("all of them, after one constant of at most {MAX_DELAY} ticks"),
            "the wire to PA2; or an edge that is not made by the timer",
        );
        self.check(
            width,
            trains.width_error.within(-TICK_OF_DOUBT, TICK_OF_DOUBT),
            format!("{} from what was asked for", trains.width_error),
            "0 ticks, 1 in doubt",
            "the falling edge was not armed in time",
        );
    }

    /// Jumps, slews and changes the period. Returns the differences of periods while slewing.
    fn moves(&mut self, trains: &mut Trains) -> Result<Extent, BringUpError> {
        let first = self.start(Output::Camera, PERIOD, MIN_PULSE_WIDTH)?;
        let mut received = self.receive_for(millis(500))?;
        trains.compare(&first, &received.pulses);
        let third = TickDelta(i64::from(PERIOD.ticks() / 3));
        let mut anchor = first.grid.anchor.ticks + third;
        let mut slewed = Extent::default();
        for slew in [0, SLEW] {
            let to = TriggerAlign {
                anchor,
                period: PERIOD,
                slew,
            };
            let grid = EdgeGrid::new(anchor, PERIOD);
            let plan = self.board.call(AlignTrigger {
                output: Output::Camera,
                to,
            })?;
            let mut way =
                self.receive_until(millis(10_000), |received| !received.arrived.is_empty())?;
            way.append(self.receive_for(millis(500))?);
            for pulse in &way.pulses {
                if pulse.number >= plan.arrival_pulse {
                    trains.compared(grid.phase_error(pulse.at));
                }
            }
            if slew > 0 {
                for (pulse, next) in way.pulses.iter().zip(way.pulses.iter().skip(1)) {
                    slewed.add((next.at - pulse.at).0 - i64::from(PERIOD.ticks()));
                }
            }
            received.append(way);
            anchor = anchor + millis(1);
        }
        let other = period(33_322_225_925);
        let status = self.board.call(SetPeriod {
            output: Output::Camera,
            period: other,
        })?;
        let grid = PulseGrid::from_status(&status);
        let mut changed = self.receive_for(millis(500))?;
        changed.append(self.stop(Output::Camera)?);
        let after: Vec<Pulse> = (changed.pulses.iter())
            .filter(|pulse| pulse.number >= grid.number)
            .copied()
            .collect();
        trains.compare(&grid, &after);
        received.append(changed);
        trains.find(&received.pulses, MIN_PULSE_WIDTH, &received.strobe);
        Ok(slewed)
    }

    fn outputs(&mut self) -> Result<(), BringUpError> {
        for output in Output::AUXILIARY {
            self.output(output)?;
        }
        Ok(())
    }

    /// Asks to move the wire at PA2 to a pin and waits until the edges there are as many as `made`
    /// counts. Returns false, with a check of this name, if they are not.
    fn wire_moved(
        &mut self,
        (name, reason): (&str, &'static str),
        pin: &'static str,
        made: impl Fn(&Received) -> usize,
    ) -> Result<bool, BringUpError> {
        if !self.operator.is_there {
            self.skip(name, "nobody there to move the wire", reason);
            return Ok(false);
        }
        (self.operator.say)(Prompt::MoveStrobeWire(pin));
        // A wire that is being plugged in bounces: a second without it, in two minutes.
        for _ in 0..HANDS_TIME.0 / millis(1_000).0 {
            let received = self.receive_for(millis(1_000))?;
            let made = made(&received);
            let doubt = (made / 8).min(2);
            if made > 0 && received.strobe.len().abs_diff(made) <= doubt {
                return Ok(true);
            }
            if (self.operator.skips)() {
                self.skip(name, "left out", reason);
                return Ok(false);
            }
        }
        let text = String::from("its edges did not come on PA2 within two minutes");
        self.check(name, false, text, "its edges on PA2", reason);
        Ok(false)
    }

    fn output(&mut self, output: Output) -> Result<(), BringUpError> {
        const REASON: &str = "the wire to PA2; or the start delay between TIM2 and TIM1, which the \
                              board keeps: repeat the test with `--keep`";
        let number = output.number();
        let name = &*format!("output {number} on the strobe input");
        if !self.board.hello().board.has_outputs() {
            self.skip(name, "this board has no such output", REASON);
            return Ok(());
        }
        self.start(output, PERIOD, MIN_OUTPUT_WIDTH)?;
        let pin = pin_of(&format!("trigger {number}"));
        let seen = self.wire_moved((name, REASON), pin, |received| 2 * received.outputs.len())?;
        self.stop(output)?;
        if !seen {
            return Ok(());
        }
        self.start(output, PERIOD, MIN_OUTPUT_WIDTH)?;
        let mut received = self.receive_for(millis(3_000))?;
        received.append(self.stop(output)?);
        let mut trains = Trains::default();
        trains.find(&received.outputs, MIN_OUTPUT_WIDTH, &received.strobe);
        self.captures(name, &format!("pulse width of output {number}"), &trains);
        let beside = format!("output {number} beside the trigger");
        // A signal that changes just when its input is sampled is seen a tick later at times;
        // one that is always a tick off is late.
        match trains.delay.0.zip(self.trigger_delay.0) {
            Some(((low, high), (first, last))) => {
                self.measured.output_delay = Some(low - first);
                self.check(
                    beside,
                    low <= last && first <= high,
                    format!("{:+} ticks", low - first),
                    "0 ticks of the timers, beside what the two pins differ by (at most 0.1 µs)",
                    REASON,
                );
            }
            None => self.skip(beside, "the trigger or the output was not captured", REASON),
        }
        Ok(())
    }

    fn fill(&mut self, full: bool) -> Result<(), BringUpError> {
        Ok(self.board.call(SendFiller(full))?)
    }
}
