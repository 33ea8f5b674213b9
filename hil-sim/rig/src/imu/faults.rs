//! Faults of the sensor and its wiring, at stated times.

use stm32f4_sim::time::SimTime;

/// Something that goes wrong, or right again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The supply is cut: nothing answers, the data-ready pin floats, all
    /// registers are lost.
    PowerOff,
    /// The supply is back: power-on reset.
    PowerOn,
    /// WHO_AM_I reads as this from now on.
    Identity(u8),
    /// Byte `byte` of a transaction is not acknowledged: counted from the
    /// start condition with the address byte as 0, repeated starts included.
    /// Happens to the next `times` transactions that get so far.
    Nack {
        /// Number of the byte; only bytes that the sensor acknowledges count and can be hit.
        byte: u32,
        /// Number of times.
        times: u32,
    },
    /// SDA is held low, as by a sensor that lost count of the clock in the
    /// middle of a byte. `Some(n)`: until `n` clock pulses came (9 free any
    /// real one). `None`: until [`Fault::ReleaseSda`] or the supply is cut.
    HoldSda(Option<u32>),
    /// SDA is let go.
    ReleaseSda,
    /// The clock input's wire is cut (true) or whole (false).
    ClockCut(bool),
    /// The next writes, of this number, that select the clock at CLKIN are not
    /// acknowledged, as by a sensor whose clock stopped in the middle of them.
    LostAtExternalClock(u32),
    /// The data-ready pin's wire is cut (true) or whole (false).
    DataReadyCut(bool),
}

/// Faults still to come, in order of time.
#[derive(Clone, Debug, Default)]
pub(super) struct Schedule(std::collections::VecDeque<(SimTime, Fault)>);

impl Schedule {
    /// Adds a fault; those at the same time happen in the order of adding.
    pub(super) fn add(&mut self, at: SimTime, fault: Fault) {
        let place = self.0.partition_point(|(t, _)| *t <= at);
        self.0.insert(place, (at, fault));
    }

    /// Time of the next.
    pub(super) fn next(&self) -> Option<SimTime> {
        self.0.front().map(|(t, _)| *t)
    }

    /// The next, if it is due.
    pub(super) fn pop_due(&mut self, now: SimTime) -> Option<Fault> {
        if self.next()? <= now {
            self.0.pop_front().map(|(_, fault)| fault)
        } else {
            None
        }
    }
}
