//! The registers of the STM32F407 and the wiring of the STM32F4DISCOVERY.
//!
//! Interrupt priorities (smaller goes first):
//!
//! | priority | what | why |
//! |---|---|---|
//! | 0 | TIM2 | the trigger; never masked by a critical section |
//! | 8 | all others | USB, I2C, DMA, time driver, [`events`] |
//! | thread | tasks | |
//!
//! TIM2's handler must therefore touch nothing that a critical section
//! protects: it hands over through [`events`].

pub(crate) mod clocks;
pub(crate) mod critical_section;
pub(crate) mod events;
pub(crate) mod faults;
pub(crate) mod idle;
pub(crate) mod imu_bus;
pub(crate) mod leds;
pub(crate) mod stack;
pub(crate) mod tim2;
