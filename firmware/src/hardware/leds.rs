//! The LEDs, on the pins of [`BOARD`].

use core::sync::atomic::{AtomicBool, Ordering};

use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::gpio::vals::Moder;
use embassy_stm32::{Peri, pac, peripherals};
use firmware::boards::{BOARD, LedPort};

/// One of the LEDs; the number is its place in [`BOARD`].
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

/// The registers of a port.
const fn registers(port: LedPort) -> Gpio {
    match port {
        LedPort::B => pac::GPIOB,
        LedPort::C => pac::GPIOC,
        LedPort::D => pac::GPIOD,
    }
}

/// The pins of [`BOARD`], which are this driver's alone.
#[cfg(feature = "discovery")]
pub(crate) type Owned = (
    Peri<'static, peripherals::PD12>,
    Peri<'static, peripherals::PD13>,
    Peri<'static, peripherals::PD14>,
    Peri<'static, peripherals::PD15>,
);
#[cfg(not(feature = "discovery"))]
pub(crate) type Owned = (
    Peri<'static, peripherals::PB12>,
    Peri<'static, peripherals::PB13>,
    Peri<'static, peripherals::PC13>,
    Peri<'static, peripherals::PB15>,
);

/// Makes the pins outputs, all dark.
pub(crate) fn init(_: Owned) {
    for led in Led::ALL {
        make_output(led);
    }
}

fn make_output(led: Led) {
    let pin = BOARD.leds[led as usize];
    drive(led, false);
    registers(pin.port)
        .moder()
        .modify(|w| w.set_moder(pin.pin.into(), Moder::OUTPUT));
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
    let pin = BOARD.leds[led as usize];
    registers(pin.port).bsrr().write(|w| {
        if on != pin.active_low {
            w.set_bs(pin.pin.into(), true);
        } else {
            w.set_br(pin.pin.into(), true);
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
