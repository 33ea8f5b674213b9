//! A simulated STM32F407 that runs any firmware's ELF on virtual time.
//!
//! What is wired to the chip is [`model::PinModel`] (pins) and
//! [`i2c::I2cTarget`] (the I2C bus), both on the virtual time of the board,
//! [`time::SimTime`].

mod backtrace;
mod chip;
pub mod clock;
pub mod cpu;
pub mod firmware;
pub mod i2c;
pub mod i2c_bus;
pub mod model;
pub mod model_bench;
pub mod pin;
pub mod random;
pub mod rtt;
pub mod sim;
pub mod time;
pub mod usb;
pub mod vcd_trace;
