//! The registers of the chip and the wiring of the board. What differs from board to board is
//! in [`firmware::boards`] and [`resources`]; `missing` stands in for drivers of what a chip does
//! not have.
//!
//! Interrupt priorities (smaller goes first):
//!
//! | priority | what | why |
//! |---|---|---|
//! | 0 | TIM2, DMA1's stream 5 | captures and the trigger; never masked by a critical section |
//! | 1 | TIM1, TIM5 | the auxiliary outputs and their wake-ups; not masked by a critical section either |
//! | 8 | all others | USB, I2C, DMA, UART, time driver, [`handover`] |
//! | thread | tasks | |
//!
//! The handlers of priorities 0 and 1 must therefore touch nothing that a critical
//! section protects: they hand over through the queues of [`events`].
//!
//! The modules form layers, and imports go down: [`events`] and the locks; the drivers;
//! [`handover`]. Of the rest of the binary they see `state` alone.

pub(crate) mod clocks;
pub(crate) mod critical_section;
pub(crate) mod cycles;
pub(crate) mod events;
mod falling_edges;
pub(crate) mod faults;
pub(crate) mod flash;
pub(crate) mod handover;
pub(crate) mod idle;
pub(crate) mod imu_bus;
pub(crate) mod imu_clock;
pub(crate) mod irq_priority;
pub(crate) mod leds;
pub(crate) mod leftovers;
pub(crate) mod masked;
#[cfg(not(feature = "discovery"))]
mod missing;
#[cfg(feature = "discovery")]
pub(crate) mod nmea_port;
pub(crate) mod otg;
pub(crate) mod outputs;
pub(crate) mod resources;
#[cfg(feature = "discovery")]
pub(crate) mod rng;
pub(crate) mod stack;
pub(crate) mod thermometer;
pub(crate) mod tim1;
pub(crate) mod tim2;
pub(crate) mod triggers;

#[cfg(not(feature = "discovery"))]
pub(crate) use missing::{nmea_port, rng};
