//! The LED that the board flashes at a phone's lens: lit by the edges of its pin.
//!
//! It lights up and goes out late. Light that rises and decays exponentially has the same mean
//! time as light that steps a time constant late, so it is modelled as that: of a white LED the
//! driver's and the chip's rise, and the persistence of its phosphor.

use crate::clocks::oscillator::{BoardTime, TrueTime};
use crate::depth_camera::flash_log::{FlashLog, TrueFlash};
use crate::wiring::{self, BoardKind};
use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::{Level, Pin};
use stm32f4_sim::time::SimDuration;

/// Properties of an LED.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LedConfig {
    /// The pin that it is on.
    pub pin: Pin,
    /// Time constant with which its light comes.
    pub rise: SimDuration,
    /// Time constant with which it goes.
    pub persistence: SimDuration,
}

impl LedConfig {
    /// Returns the LED of the model ranges' nominal values on the output of a board that a
    /// calibration flashes: the last one, on a Black Pill the camera's.
    #[must_use]
    pub const fn nominal(board: BoardKind) -> Self {
        Self {
            pin: match board {
                BoardKind::Discovery => wiring::OUTPUTS[wiring::OUTPUTS.len() - 1],
                BoardKind::BlackPill => wiring::TRIGGER,
            },
            rise: SimDuration::from_nanos(100),
            persistence: SimDuration::from_nanos(100),
        }
    }
}

/// An LED.
#[derive(Debug)]
pub(crate) struct Led {
    config: LedConfig,
    board: BoardTime,
    log: FlashLog,
    lit: Option<TrueTime>,
}

impl Led {
    /// Its flashes go into the log as they end.
    pub(crate) fn new(config: LedConfig, board: BoardTime, log: FlashLog) -> Self {
        Self {
            config,
            board,
            log,
            lit: None,
        }
    }
}

impl PinModel for Led {
    fn name(&self) -> String {
        "LED".to_owned()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        vec![self.config.pin]
    }

    fn on_pin_edge(&mut self, _: Pin, level: Level, io: &mut PinIo<'_>) {
        if level.is_high() {
            self.lit = Some(self.board.true_at(io.now() + self.config.rise));
        } else if let Some(start) = self.lit.take() {
            let end = self.board.true_at(io.now() + self.config.persistence);
            self.log.push(TrueFlash { start, end });
        }
    }
}
