//! Exact times of the edges of a trigger train.
//!
//! A train is a position in Q64.32 ticks that goes on by one period for each
//! pulse; an edge is its floor. The sum is exact, so edge `k` is
//! `floor(start + k · period)`: at most one tick of jitter, no drift, for any
//! fraction of a tick.
//!
//! An align moves the position onto the grid `anchor + j · period` the short way
//! round, at most `slew` a pulse. The move is planned in the same exact numbers,
//! so the train arrives on the grid itself and not near it, and is planned from
//! where the train *is*: the same command again finds less (or nothing) left to
//! move and ends at the same pulse.
//!
//! Planning divides 128-bit numbers and runs in a task; `Train::advance`,
//! which the interrupt calls, only adds.

use protocol::{
    AlignPlan, EdgeGrid, EdgeTime, MAX_TIME_AWAY, MIN_OUTPUT_GAP, MIN_OUTPUT_WIDTH, MIN_PULSE_GAP,
    MIN_PULSE_WIDTH, Period, Refusal, TickDelta, Ticks, TriggerAlign, TriggerStart,
};

/// Fraction bits of periods and of what is left to move.
const FRACTION_BITS: u32 = 32;

/// A rising edge that is to be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Edge {
    /// Number in the train, from 0.
    pub(crate) number: u64,
    /// Where exactly it belongs.
    pub(crate) position: EdgeTime,
    /// On the grid (false on the way to another).
    pub(crate) aligned: bool,
    /// The id of the align that this edge completes.
    pub(crate) arrived: Option<u32>,
}

/// The way to another grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Slew {
    /// The id of the align.
    command: u32,
    /// Remaining distance, in Q31.32 ticks; late is positive.
    left: i64,
    /// Most that one pulse may be moved earlier, in Q31.32 ticks.
    most_earlier: i64,
    /// Most that one pulse may be moved later, in Q31.32 ticks.
    most_later: i64,
}

/// A plan that [`Train::align`] made and [`crate::pulser::Pulser::adopt`] puts into force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alignment {
    /// The plan as it is reported to the host.
    pub plan: AlignPlan,
    period: Period,
    slew: Slew,
    /// The edge from which it was planned.
    from: u64,
}

/// Times that the handler of an output needs between two edges, in ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The shortest pulse.
    min_width: u32,
    /// The shortest time from a falling edge to the next rising edge.
    min_gap: u32,
}

impl Limits {
    /// The camera's trigger, whose handler goes before everything else.
    pub const CAMERA: Self = Self {
        min_width: MIN_PULSE_WIDTH,
        min_gap: MIN_PULSE_GAP,
    };

    /// The auxiliary outputs.
    pub const OUTPUT: Self = Self {
        min_width: MIN_OUTPUT_WIDTH,
        min_gap: MIN_OUTPUT_GAP,
    };

    /// The widest pulse at `period`, in ticks.
    fn max_width(self, period: Period) -> u32 {
        period.ticks().saturating_sub(self.min_gap)
    }

    /// The largest slew at `period` for pulses of `width`, in ticks: half a
    /// period, and never so much that two pulses touch.
    fn max_slew(self, period: Period, width: u32) -> u32 {
        (period.ticks() / 2).min(self.max_width(period).saturating_sub(width))
    }

    /// Refuses a period that is out of bounds or leaves `width` no room.
    fn check_period(self, period: Period, width: u32) -> Result<(), Refusal> {
        if !period.in_bounds() {
            return Err(Refusal::PeriodOutOfRange);
        }
        let (min, max) = (self.min_width, self.max_width(period));
        if !(min..=max).contains(&width) {
            return Err(Refusal::WidthOutOfRange { min, max });
        }
        Ok(())
    }
}

/// A running train: the edge that was armed last and how it goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Train {
    /// The command that started it.
    start: TriggerStart,
    limits: Limits,
    period: Period,
    number: u64,
    position: EdgeTime,
    aligned: bool,
    slew: Option<Slew>,
}

/// Refuses a time that is farther from `now` than [`MAX_TIME_AWAY`].
fn check_near(at: Ticks, now: Ticks) -> Result<(), Refusal> {
    if (at - now).unsigned_abs() > MAX_TIME_AWAY {
        return Err(Refusal::TimeOutOfRange { now });
    }
    Ok(())
}

impl Train {
    /// A train whose first edge, number 0, is to be armed now: at
    /// `start.first_edge`, or `soonest` if that is none.
    ///
    /// # Errors
    ///
    /// Values out of bounds; a first edge before `earliest`.
    pub(crate) fn new(
        start: TriggerStart,
        limits: Limits,
        now: Ticks,
        earliest: Ticks,
        soonest: Ticks,
    ) -> Result<Self, Refusal> {
        limits.check_period(start.period, start.width)?;
        let first = start.first_edge.unwrap_or(soonest.into());
        check_near(first.ticks, now)?;
        if first.ticks < earliest {
            return Err(Refusal::TimeOutOfRange { now });
        }
        Ok(Self {
            start,
            limits,
            period: start.period,
            number: 0,
            position: first,
            aligned: true,
            slew: None,
        })
    }

    /// The command that started it.
    pub(crate) const fn start(&self) -> &TriggerStart {
        &self.start
    }

    pub(crate) const fn period(&self) -> Period {
        self.period
    }

    /// Length of a pulse, in ticks.
    pub(crate) const fn width(&self) -> u32 {
        self.start.width
    }

    /// Returns true if the train is on the way to another grid.
    pub(crate) const fn is_slewing(&self) -> bool {
        self.slew.is_some()
    }

    /// The edge that was armed last.
    pub(crate) const fn edge(&self) -> Edge {
        Edge {
            number: self.number,
            position: self.position,
            aligned: self.aligned,
            arrived: None,
        }
    }

    /// Advances to the next edge, which is to be armed now.
    pub(crate) fn advance(&mut self) -> Edge {
        self.number = self.number.wrapping_add(1);
        self.position = self.position + self.period;
        let mut arrived = None;
        if let Some(slew) = &mut self.slew {
            let step = slew.left.clamp(-slew.most_earlier, slew.most_later);
            slew.left -= step;
            self.position = EdgeTime::from_raw(self.position.raw() + i128::from(step));
            self.aligned = slew.left == 0;
            if self.aligned {
                arrived = Some(slew.command);
                self.slew = None;
            }
        }
        Edge {
            arrived,
            ..self.edge()
        }
    }

    /// Plans the way to another grid.
    ///
    /// # Errors
    ///
    /// Values out of bounds for this train.
    pub fn align(&self, command: u32, to: &TriggerAlign, now: Ticks) -> Result<Alignment, Refusal> {
        self.limits.check_period(to.period, self.width())?;
        check_near(to.anchor, now)?;
        let max = self.limits.max_slew(to.period, self.width());
        if to.slew > max {
            return Err(Refusal::SlewOutOfRange { max });
        }

        let period = i128::from(to.period.0);
        let grid = EdgeGrid::new(to.anchor, to.period);
        let beyond = i128::from(grid.since_edge(self.position).unwrap_or(0));
        let shift = if beyond * 2 <= period {
            -beyond
        } else {
            period - beyond
        };

        let fixed = |ticks: u32| i64::from(ticks) << FRACTION_BITS;
        let (most_earlier, most_later) = match to.slew {
            0 => (fixed(max), i64::MAX),
            slew => (fixed(slew), fixed(slew)),
        };
        let most = if shift < 0 { most_earlier } else { most_later };
        let frames = shift.unsigned_abs().div_ceil(most.unsigned_abs().into());
        let pulses = frames.max(1);
        // At least 0 even so: the train is at least half a period past zero.
        let arrival = self.position.raw() + shift + pulses as i128 * period;
        Ok(Alignment {
            plan: AlignPlan {
                shift: TickDelta((shift >> FRACTION_BITS) as i64),
                frames: u32::try_from(frames).unwrap_or(u32::MAX),
                arrival_pulse: self.number.wrapping_add(pulses as u64),
                arrival: EdgeTime::from_raw(arrival).ticks,
            },
            period: to.period,
            slew: Slew {
                command,
                left: shift as i64,
                most_earlier,
                most_later,
            },
            from: self.number,
        })
    }

    /// Puts a plan into force. Returns false if an edge was armed since the plan was made: it must
    /// be made again.
    pub(crate) fn adopt(&mut self, alignment: &Alignment) -> bool {
        if alignment.from != self.number {
            return false;
        }
        self.period = alignment.period;
        self.slew = Some(alignment.slew);
        true
    }

    /// Sets another period from the next edge on.
    ///
    /// # Errors
    ///
    /// Out of bounds, or an align is on its way.
    pub(crate) fn set_period(&mut self, period: Period) -> Result<(), Refusal> {
        self.limits.check_period(period, self.width())?;
        if self.is_slewing() {
            return Err(Refusal::AlignInProgress);
        }
        self.period = period;
        Ok(())
    }
}

#[cfg(test)]
mod tests;
