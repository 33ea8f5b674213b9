//! The LEDs, on the pins of [`LEDS`].

use core::sync::atomic::{AtomicBool, Ordering};

use embassy_stm32::pac;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::gpio::vals::Moder;

use crate::hardware::resources::{LEDS, Leds};

/// One of the LEDs; the number is its place in [`LEDS`].
#[derive(Clone, Copy)]
#[repr(u8)]
pub(crate) enum Led {
    /// IMU samples come.
    Imu,
    /// Changes with every pulse of the trigger.
    Pulse,
    /// The IMU has failed, or the last run ended in a panic, fault or watchdog reset.
    Fault,
    /// A host is linked.
    Link,
}

impl Led {
    const ALL: [Self; 4] = [Self::Imu, Self::Pulse, Self::Fault, Self::Link];
}

/// Port and pin of an LED, and true if it is lit while the pin is low.
pub(crate) type LedPin = (Gpio, usize, bool);

/// Makes the pins, those of [`LEDS`], outputs, all dark.
pub(crate) fn init(_: Leds) {
    Led::ALL.into_iter().for_each(make_output);
}

fn make_output(led: Led) {
    drive(led, false);
    let (port, pin, _) = LEDS[led as usize];
    port.moder().modify(|w| w.set_moder(pin, Moder::OUTPUT));
}

/// The last run ended in a panic, fault or watchdog reset.
static RUN_FAILED: AtomicBool = AtomicBool::new(false);

/// Lights the LED of faults for as long as this run lasts, if the last one failed.
pub(crate) fn show_failed_run(failed: bool) {
    RUN_FAILED.store(failed, Ordering::Relaxed);
    show_imu_fault(false);
}

/// Lights the LED of faults while the IMU has failed; it stays on after a failed run.
pub(crate) fn show_imu_fault(on: bool) {
    set(Led::Fault, on || RUN_FAILED.load(Ordering::Relaxed));
}

/// Switches an LED; with the feature `scope` the pins are the handlers'.
pub(crate) fn set(led: Led, on: bool) {
    if !cfg!(feature = "scope") {
        drive(led, on);
    }
}

/// Switches an LED's pin. One write to the bit-set register: safe from any context.
#[inline]
pub(super) fn drive(led: Led, on: bool) {
    let (port, pin, active_low) = LEDS[led as usize];
    port.bsrr().write(|w| {
        if on != active_low {
            w.set_bs(pin, true);
        } else {
            w.set_br(pin, true);
        }
    });
}

/// Lights the LED of faults alone, before anything else is set up.
pub(crate) fn show_fault() {
    pac::RCC.ahb1enr().modify(|w| {
        w.set_gpioben(true);
        w.set_gpiocen(true);
        w.set_gpioden(true);
    });
    let _ = pac::RCC.ahb1enr().read();
    make_output(Led::Fault);
    drive(Led::Fault, true);
}
