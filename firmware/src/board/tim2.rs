//! TIM2, the one timebase.

use embassy_stm32::pac;
use firmware::timebase::Timebase;
use protocol::Ticks;

static TIMEBASE: Timebase = Timebase::new();

/// Starts the counter: 32 bit, 48 MHz, free running.
pub(crate) fn init() {
    pac::RCC.apb1enr().modify(|w| w.set_tim2en(true));
    let tim = pac::TIM2;
    tim.psc().write_value(0);
    tim.arr().write_value(u32::MAX);
    tim.egr().write(|w| w.set_ug(true));
    tim.sr().write(|w| w.0 = 0);
    tim.cr1().write(|w| w.set_cen(true));
}

/// The counter.
#[inline]
pub(crate) fn counter() -> u32 {
    pac::TIM2.cnt().read()
}

/// Board time.
pub(crate) fn now() -> Ticks {
    TIMEBASE.refresh(counter())
}
