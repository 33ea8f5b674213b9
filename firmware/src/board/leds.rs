//! The four LEDs of the STM32F4DISCOVERY, PD12 to PD15.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::vals::Moder;
use embassy_stm32::peripherals::{PD12, PD13, PD14, PD15};

/// One of the LEDs; the number is its pin on port D.
#[derive(Clone, Copy)]
#[repr(u8)]
pub(crate) enum Led {
    /// Green: IMU samples come.
    Imu = 12,
    /// Orange: changes with every pulse of the trigger.
    Pulse = 13,
    /// Red: the IMU has failed, or the last run ended in a panic or watchdog reset.
    Fault = 14,
    /// Blue: a host is linked.
    Link = 15,
}

/// Makes the pins outputs, all dark.
pub(crate) fn init(
    imu: Peri<'static, PD12>,
    pulse: Peri<'static, PD13>,
    fault: Peri<'static, PD14>,
    link: Peri<'static, PD15>,
) {
    core::mem::forget([
        Output::new(imu, Level::Low, Speed::Low),
        Output::new(pulse, Level::Low, Speed::Low),
        Output::new(fault, Level::Low, Speed::Low),
        Output::new(link, Level::Low, Speed::Low),
    ]);
}

/// Switches an LED. One write to the bit-set register: safe from any context.
pub(crate) fn set(led: Led, on: bool) {
    pac::GPIOD.bsrr().write(|w| {
        if on {
            w.set_bs(led as usize, true);
        } else {
            w.set_br(led as usize, true);
        }
    });
}

/// Lights the red LED alone, before anything else is set up.
pub(crate) fn show_fault() {
    pac::RCC.ahb1enr().modify(|w| w.set_gpioden(true));
    let _ = pac::RCC.ahb1enr().read();
    pac::GPIOD
        .moder()
        .modify(|w| w.set_moder(Led::Fault as usize, Moder::OUTPUT));
    set(Led::Fault, true);
}
