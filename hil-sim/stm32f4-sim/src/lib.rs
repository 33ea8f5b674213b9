//! A simulated STM32F407VG that runs a firmware's ELF on virtual time.
//!
//! The firmware is the file that would be flashed: any language, any HAL, no change to
//! it. [`sim::Sim`] runs it from its reset, as fast as it can, and reports the exact time of
//! each edge at the pins. There is a crystal or an I2C bus only if the builder is given one.
//!
//! ```no_run
//! use stm32f4_sim::clock::Rate;
//! use stm32f4_sim::pin::{Drive, Pin};
//! use stm32f4_sim::sim::Sim;
//! use stm32f4_sim::time::SimDuration;
//!
//! fn main() -> Result<(), Box<dyn std::error::Error>> {
//!     let mut sim = Sim::builder("target/thumbv7em-none-eabihf/release/blinky")
//!         .crystal(Rate::hz(25_000_000))
//!         .on_log(|line| println!("{line}"))
//!         .build()?;
//!     sim.log_pin(Pin::PD13);
//!     sim.run_for(SimDuration::from_secs(1))?;
//!     for (pin, level, at) in sim.take_edges() {
//!         println!("{at}: {pin} {level:?}");
//!     }
//!
//!     // Press a button, and talk to its USB serial port.
//!     sim.drive(Pin::PA0, Drive::High);
//!     if sim.run_until_usb_ready(SimDuration::from_secs(3))? {
//!         sim.usb_open(true);
//!         sim.usb_write(b"hello\n");
//!         sim.run_for(SimDuration::from_millis(10))?;
//!         println!("{}", String::from_utf8_lossy(&sim.usb_read()));
//!     }
//!     Ok(())
//! }
//! ```
//!
//! A part that is wired to the chip is a [`model::PinModel`] (pins), an [`i2c::I2cTarget`] (the
//! I2C bus) or both; [`model_bench::ModelBench`] runs one alone, for its tests.
//!
//! A failure of the firmware ends the run with its log and call stack, and so does the
//! touch of a register that is neither modelled nor one of the
//! [`sim::stored_registers`]: the simulator never invents an answer.

#![warn(missing_docs)]

mod backtrace;
mod bus;
mod chip;
pub mod clock;
pub mod cpu;
pub mod firmware;
pub mod i2c;
mod i2c_bus;
pub mod model;
pub mod model_bench;
pub mod pin;
pub mod random;
pub mod rtt;
pub mod shared;
pub mod sim;
pub mod time;
pub mod usb;
