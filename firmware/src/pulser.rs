//! Makes the edges of a train on one compare channel.
//!
//! The channel makes every edge by itself when the counter reaches the compare
//! value; a handler arms the next one. There are two kinds of channel:
//!
//! - One that makes whole pulses: the hardware loads the falling edge's compare value
//!   at the rising edge. The handler comes after the pulse and has until the next one.
//! - One that makes single edges. The handler of the rising edge arms the falling one,
//!   so a pulse must be longer than that handler can be late
//!   ([`protocol::MIN_OUTPUT_WIDTH`]).
//!
//! A channel reaches only so far ahead. For an edge that is farther, the handler is
//! called on the way to it, [`WAKE_LEAD`] before the edge, and arms it then. So how late
//! a handler comes does not matter to a rising edge, up to that lead. If an edge is armed
//! too late all the same (a debugger stopped the core, say), the compare would only match
//! 89 s later. That is seen at once: a pulse that should be over is ended by force, a
//! rising edge is made some µs later and reported at the time at which it really came, and
//! both are counted.
//!
//! The logic runs against [`CompareOutput`], on the board and in tests.

use protocol::{
    EdgeTime, MIN_START_LEAD, OutputStatus, Period, Readback, Refusal, TickDelta, Ticks,
    TrainState, TriggerStart, TriggerStatus,
};

use crate::config::{LATE_EDGE_DELAY, MAX_ARM_AHEAD, START_LEAD, STOP_MARGIN, WAKE_LEAD};
use crate::timebase::Timebase;
use crate::trigger::{Alignment, Edge, Limits, Train};

/// Effect on the output when the counter reaches the compare value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Nothing; only the handler is called.
    Wake,
    /// The output goes high.
    Rise,
    /// The output goes low.
    Fall,
    /// The output goes high, and low when the counter reaches `fall`.
    Pulse {
        /// The counter's value at the falling edge.
        fall: u32,
    },
}

/// A captured edge of the read-back input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Captured {
    /// The counter's value at the edge.
    pub at: u32,
    /// There was more than one since the last look; this is the last.
    pub more: bool,
}

/// An output compare channel, and the capture channel that reads it back.
pub trait CompareOutput {
    /// Returns true if the channel is armed by [`Action::Pulse`] and its handler called after the
    /// falling edge; otherwise it is armed by [`Action::Rise`] and [`Action::Fall`], with a call
    /// after each.
    fn makes_whole_pulses(&self) -> bool;

    /// Returns the farthest edge that can be armed, in ticks ahead: clearly more than
    /// [`WAKE_LEAD`]. [`Action::Wake`] reaches [`MAX_ARM_AHEAD`].
    fn reach(&self) -> u32;

    /// Returns the value of the counter.
    fn counter(&self) -> u32;

    /// Forgets a former match and arms the next one, at the counter value `at`.
    fn arm(&mut self, at: u32, action: Action);

    /// Returns true once the armed match has occurred; for a pulse, that of its rising edge.
    fn has_matched(&self) -> bool;

    /// Makes the output low, now, and arms nothing.
    fn force_low(&mut self);

    /// Takes the read-back edge captured since the last call.
    fn take_readback(&mut self) -> Option<Captured>;
}

/// A pulse that was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulsed {
    /// Its train.
    pub train: u32,
    /// Its number in the train.
    pub number: u64,
    /// Its rising edge: the compare value that made it.
    pub at: Ticks,
    /// It is on the grid.
    pub aligned: bool,
    /// The id of the align that it completed.
    pub arrived: Option<u32>,
    /// Delay of the read-back, in ticks.
    pub readback: Option<i32>,
}

/// The match that the channel waits for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Stage {
    /// No train.
    #[default]
    Idle,
    /// A point on the way to the rising edge.
    Waypoint(Edge),
    /// The rising edge, at this time.
    Rise(Edge, Ticks),
    /// The end of the pulse that rises at this time.
    Pulse(Edge, Ticks),
    /// A point on the way to the falling edge of the pulse that rose at this time.
    High(Edge, Ticks),
    /// The falling edge of the pulse that rose at this time.
    Fall(Edge, Ticks),
}

/// The trigger: at most one train, and the channel that makes it.
#[derive(Clone, Copy, Debug)]
pub struct Pulser {
    limits: Limits,
    stage: Stage,
    train: Option<Train>,
    /// The train ends with the pulse that is being made.
    stopping: bool,
    trains: u32,
    pulses: u64,
    late: u32,
    readback: Readback,
}

impl Default for Pulser {
    fn default() -> Self {
        Self::new(Limits::CAMERA)
    }
}

impl Pulser {
    /// Without a train.
    #[must_use]
    pub const fn new(limits: Limits) -> Self {
        Self {
            limits,
            stage: Stage::Idle,
            train: None,
            stopping: false,
            trains: 0,
            pulses: 0,
            late: 0,
            readback: Readback {
                seen: 0,
                missing: 0,
                stray: 0,
                delay: None,
            },
        }
    }

    /// The train, while it runs.
    #[must_use]
    pub fn running(&self) -> Option<&Train> {
        self.train
            .as_ref()
            .filter(|_| self.stage != Stage::Idle && !self.stopping)
    }

    /// Starts a train. Nothing changes if the one that runs was started by the
    /// same command.
    ///
    /// # Errors
    ///
    /// Values out of bounds; another train runs.
    pub fn start<O: CompareOutput + ?Sized>(
        &mut self,
        output: &mut O,
        time: &Timebase,
        start: TriggerStart,
    ) -> Result<(), Refusal> {
        if self.running().is_some_and(|train| *train.start() == start) {
            return Ok(());
        }
        let now = time.extend(output.counter());
        let (earliest, soonest) = (now + MIN_START_LEAD, now + START_LEAD);
        let train = Train::new(start, self.limits, now, earliest, soonest)?;
        if self.stage != Stage::Idle {
            return Err(Refusal::TriggerRunning);
        }
        self.train = Some(train);
        self.trains = self.trains.wrapping_add(1);
        self.pulses = 0;
        // What came while there was no train is not of this one.
        let _ = output.take_readback();
        self.arm_rise(output, time, train.edge());
        Ok(())
    }

    /// Puts an align into force. False if it must be planned again.
    ///
    /// # Errors
    ///
    /// No train runs.
    pub fn adopt(&mut self, alignment: &Alignment) -> Result<bool, Refusal> {
        self.running().ok_or(Refusal::TriggerStopped)?;
        Ok(self
            .train
            .as_mut()
            .is_some_and(|train| train.adopt(alignment)))
    }

    /// Sets another period.
    ///
    /// # Errors
    ///
    /// No train runs; out of bounds; an align is on its way.
    pub fn set_period(&mut self, period: Period) -> Result<(), Refusal> {
        self.running().ok_or(Refusal::TriggerStopped)?;
        let train = self.train.as_mut().ok_or(Refusal::TriggerStopped)?;
        train.set_period(period)
    }

    /// Stops the train, after the pulse that is being made or about to be.
    pub fn stop<O: CompareOutput + ?Sized>(&mut self, output: &mut O, time: &Timebase) {
        match self.stage {
            Stage::Idle => {}
            Stage::Waypoint(_) => {
                output.force_low();
                self.stage = Stage::Idle;
            }
            Stage::Rise(_, at) | Stage::Pulse(_, at) => {
                let now = time.extend(output.counter());
                if at > now + STOP_MARGIN {
                    output.force_low();
                    self.stage = Stage::Idle;
                } else {
                    self.stopping = true;
                }
            }
            Stage::High(..) | Stage::Fall(..) => self.stopping = true,
        }
    }

    /// Handles the armed match. Returns the pulse that ends with it.
    pub fn on_match<O: CompareOutput + ?Sized>(
        &mut self,
        output: &mut O,
        time: &Timebase,
    ) -> Option<Pulsed> {
        match self.stage {
            Stage::Idle => None,
            Stage::Waypoint(edge) => {
                self.arm_rise(output, time, edge);
                None
            }
            Stage::Rise(edge, at) => {
                self.pulses = self.pulses.wrapping_add(1);
                self.arm_fall(output, time, edge, at)
            }
            Stage::High(edge, at) => self.arm_fall(output, time, edge, at),
            Stage::Pulse(edge, at) => {
                self.pulses = self.pulses.wrapping_add(1);
                self.end_pulse(output, time, edge, at)
            }
            Stage::Fall(edge, at) => self.end_pulse(output, time, edge, at),
        }
    }

    /// Arms the falling edge of the pulse that rose at `at`, or a point on the way to it.
    /// Returns that pulse if it had to be ended by force.
    fn arm_fall<O: CompareOutput + ?Sized>(
        &mut self,
        output: &mut O,
        time: &Timebase,
        edge: Edge,
        at: Ticks,
    ) -> Option<Pulsed> {
        let fall = at + TickDelta(self.width().into());
        if wakes_before(output, time, fall) {
            self.stage = Stage::High(edge, at);
            return None;
        }
        let fall = fall.0 as u32;
        self.stage = Stage::Fall(edge, at);
        output.arm(fall, Action::Fall);
        if is_past(fall, output.counter()) && !output.has_matched() {
            self.late = self.late.saturating_add(1);
            output.force_low();
            return self.end_pulse(output, time, edge, at);
        }
        None
    }

    fn end_pulse<O: CompareOutput + ?Sized>(
        &mut self,
        output: &mut O,
        time: &Timebase,
        edge: Edge,
        at: Ticks,
    ) -> Option<Pulsed> {
        let readback = self.match_readback(output.take_readback(), at, output.counter());
        let next = match &mut self.train {
            Some(train) if !self.stopping => Some(train.advance()),
            _ => None,
        };
        match next {
            Some(next) => self.arm_rise(output, time, next),
            None => {
                output.force_low();
                self.stage = Stage::Idle;
                self.stopping = false;
            }
        }
        Some(Pulsed {
            train: self.trains,
            number: edge.number,
            at,
            aligned: edge.aligned,
            arrived: edge.arrived,
            readback,
        })
    }

    /// Arms the rising edge, or a point on the way to it.
    fn arm_rise<O: CompareOutput + ?Sized>(&mut self, output: &mut O, time: &Timebase, edge: Edge) {
        let at = edge.position.ticks;
        if wakes_before(output, time, at) {
            self.stage = Stage::Waypoint(edge);
        } else {
            self.arm_rise_at(output, time, edge, at);
        }
    }

    /// Arms the rising edge at `at`, or as soon after it as can be.
    fn arm_rise_at<O: CompareOutput + ?Sized>(
        &mut self,
        output: &mut O,
        time: &Timebase,
        edge: Edge,
        mut at: Ticks,
    ) {
        let whole = output.makes_whole_pulses();
        loop {
            let rise = at.0 as u32;
            let action = if whole {
                let fall = rise.wrapping_add(self.width());
                Action::Pulse { fall }
            } else {
                Action::Rise
            };
            output.arm(rise, action);
            let counter = output.counter();
            if !is_past(rise, counter) || output.has_matched() {
                break;
            }
            self.late = self.late.saturating_add(1);
            at = time.extend(counter) + LATE_EDGE_DELAY;
        }
        self.stage = if whole {
            Stage::Pulse(edge, at)
        } else {
            Stage::Rise(edge, at)
        };
    }

    /// Books what the read-back saw of the pulse that rose at `rise`.
    fn match_readback(&mut self, seen: Option<Captured>, rise: Ticks, now: u32) -> Option<i32> {
        let rise = rise.0 as u32;
        let readback = &mut self.readback;
        let delay = seen.and_then(|captured| {
            let delay = captured.at.wrapping_sub(rise);
            let fits = !captured.more && delay <= now.wrapping_sub(rise);
            if !fits {
                readback.stray = readback.stray.saturating_add(1);
            }
            fits.then_some(delay as i32)
        });
        if delay.is_some() {
            readback.seen = readback.seen.saturating_add(1);
            readback.delay = delay;
        } else if readback.seen > 0 {
            readback.missing = readback.missing.saturating_add(1);
        }
        delay
    }

    /// Length of a pulse, in ticks.
    fn width(&self) -> u32 {
        self.train.map_or(0, |train| train.width())
    }

    /// When the next edge needs the handler.
    fn due(&self) -> Option<Ticks> {
        match self.stage {
            Stage::Idle => None,
            Stage::Waypoint(edge) => Some(edge.position.ticks),
            Stage::Rise(_, at) => Some(at),
            Stage::Pulse(_, at) | Stage::High(_, at) | Stage::Fall(_, at) => {
                Some(at + TickDelta(self.width().into()))
            }
        }
    }

    /// Returns true if the handler is needed within the next `margin`, or already: no time to mask
    /// it.
    #[must_use]
    pub fn is_busy(&self, now: Ticks, margin: TickDelta) -> bool {
        self.due().is_some_and(|due| due < now + margin)
    }

    /// Returns true if the handler is overdue by more than `by`: it does not run.
    #[must_use]
    pub fn is_overdue(&self, now: Ticks, by: TickDelta) -> bool {
        self.due().is_some_and(|due| now > due + by)
    }

    /// Returns true if the pulse that is armed as a whole has risen by `now`.
    fn has_risen(&self, now: Ticks) -> bool {
        matches!(self.stage, Stage::Pulse(_, at) if at <= now)
    }

    /// Rising edges made by `now`.
    fn pulses(&self, now: Ticks) -> u64 {
        self.pulses.wrapping_add(self.has_risen(now).into())
    }

    fn state(&self, now: Ticks) -> TrainState {
        match self.stage {
            Stage::Idle => TrainState::Stopped,
            Stage::Waypoint(_) | Stage::Rise(..) | Stage::Pulse(..) if self.pulses(now) == 0 => {
                TrainState::Waiting
            }
            _ if self.train.is_some_and(|train| train.is_slewing()) => TrainState::Slewing,
            _ => TrainState::Running,
        }
    }

    /// An output as the status reports it.
    #[must_use]
    pub fn summary(&self, now: Ticks) -> OutputStatus {
        OutputStatus {
            state: self.state(now),
            train: self.trains,
            pulses: self.pulses(now),
            late: self.late,
        }
    }

    /// Where the edge after the armed one belongs.
    fn next_position(&self) -> EdgeTime {
        let train = self.train;
        train.map_or(EdgeTime::default(), |mut train| train.advance().position)
    }

    /// The state of the train and where it goes on, as it is reported to the host.
    #[must_use]
    pub fn status(&self, now: Ticks) -> TriggerStatus {
        let next = match self.stage {
            Stage::Idle => EdgeTime::default(),
            Stage::Pulse(..) if self.has_risen(now) => self.next_position(),
            Stage::Waypoint(edge) | Stage::Rise(edge, _) | Stage::Pulse(edge, _) => edge.position,
            Stage::High(..) | Stage::Fall(..) => self.next_position(),
        };
        TriggerStatus {
            state: self.state(now),
            train: self.trains,
            period: self.train.map_or(Period(0), |train| train.period()),
            width: self.width(),
            pulses: self.pulses(now),
            next_edge: next,
            late: self.late,
            readback: self.readback,
        }
    }
}

/// Arms a call on the way to `at` if the output does not reach that far.
fn wakes_before<O: CompareOutput + ?Sized>(output: &mut O, time: &Timebase, at: Ticks) -> bool {
    let now = time.extend(output.counter());
    if at.0 <= now.0 + u64::from(output.reach()) {
        return false;
    }
    let farthest = now + TickDelta(MAX_ARM_AHEAD.into());
    let wake = farthest.min(at - WAKE_LEAD);
    output.arm(wake.0 as u32, Action::Wake);
    true
}

/// Returns true if the counter value `at` is reached or past, not ahead.
const fn is_past(at: u32, counter: u32) -> bool {
    counter.wrapping_sub(at) < 1 << 31
}

#[cfg(test)]
mod tests;
