//! A part outside of the microcontroller, as the board sees it.
//!
//! A model lives on the board's virtual time. It hears of the pins it asked
//! for at the exact time of each edge, and is called at the exact time it asks
//! for. What it drives changes the pin at that very time: a timer capture of
//! the microcontroller latches that time, whatever the core is doing.
//!
//! Models are called in the order in which they were added. Two edges at the
//! same time are delivered in the order in which they came about.

use crate::clock::Rate;
use crate::pin::{Drive, Level, Pin};
use crate::time::SimTime;

/// The board as a model sees it while it is being called.
#[derive(Debug)]
pub struct PinIo<'a> {
    now: SimTime,
    levels: &'a [u16; Pin::PORTS],
    drives: &'a mut Vec<(Pin, Drive)>,
}

impl<'a> PinIo<'a> {
    /// A view for one call at `now`. `levels` are the pins' levels, a word a
    /// port; what the model drives is appended to `drives`.
    #[must_use]
    pub fn new(
        now: SimTime,
        levels: &'a [u16; Pin::PORTS],
        drives: &'a mut Vec<(Pin, Drive)>,
    ) -> Self {
        Self {
            now,
            levels,
            drives,
        }
    }

    /// Time of this call.
    #[must_use]
    pub fn now(&self) -> SimTime {
        self.now
    }

    /// Level of a pin when the call began.
    #[must_use]
    pub fn level(&self, pin: Pin) -> Level {
        Level::from(self.levels[pin.port()] & (1 << pin.number()) != 0)
    }

    /// Drives `pin` from now on. What other models drive at the same pin is replaced.
    pub fn drive(&mut self, pin: Pin, drive: Drive) {
        self.drives.push((pin, drive));
    }
}

/// A part wired to pins of the chip.
pub trait PinModel: Send {
    /// Name for logs.
    fn name(&self) -> String;

    /// Pins whose edges and clock changes the model hears of. Asked once.
    fn watched_pins(&self) -> Vec<Pin>;

    /// Its inputs that a pin of the chip drives, and from which voltage on each takes its
    /// input as high, in V.
    fn inputs(&self) -> Vec<(Pin, f64)> {
        Vec::new()
    }

    /// Its outputs whose high level is not the board's supply, and that level, in V.
    fn outputs(&self) -> Vec<(Pin, f64)> {
        Vec::new()
    }

    /// Called once at the board's power-on (time zero), to drive the idle levels.
    fn power_on(&mut self, io: &mut PinIo<'_>) {
        let _ = io;
    }

    /// A watched pin changed to `level`, at `io.now()`.
    fn on_pin_edge(&mut self, pin: Pin, level: Level, io: &mut PinIo<'_>) {
        let _ = (pin, level, io);
    }

    /// A watched pin carries a clock of the given rate from `io.now()` on
    /// (MCO1 on PA8), or stops to. Single edges of such a clock are not delivered.
    fn on_clock(&mut self, pin: Pin, rate: Option<Rate>, io: &mut PinIo<'_>) {
        let _ = (pin, rate, io);
    }

    /// When the model wants to be called next; never, if it has nothing to do
    /// until an edge. Asked again after every call of the model, and after
    /// every I2C event if the model is also an I2C target.
    fn next_event(&self) -> Option<SimTime> {
        None
    }

    /// Called at the time that [`PinModel::next_event`] gave.
    fn advance(&mut self, io: &mut PinIo<'_>) {
        let _ = io;
    }
}
