//! Clock tree, reset cause and interrupt priorities.

#![allow(
    unsafe_code,
    reason = "priorities and reset flags of the bare hardware"
)]

use embassy_stm32::Config;
use embassy_stm32::interrupt::Priority;
use embassy_stm32::pac;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource,
    Sysclk,
};
use embassy_stm32::time::Hertz;
use firmware::config::HSE_HZ;
use protocol::ResetCause;

use crate::board::urgent;

/// Interrupts of the STM32F407 (RM0090 table 61).
const INTERRUPTS: usize = 82;

/// HSE 8 MHz / 4 · 96 = 192 MHz; / 2 = 96 MHz core, / 4 = 48 MHz USB; APB1
/// 24 MHz (timers 48), APB2 48 MHz (timers 96).
pub(crate) fn config() -> Config {
    let mut config = Config::default();
    config.rcc.hsi = false;
    config.rcc.hse = Some(Hse {
        freq: Hertz(HSE_HZ),
        mode: HseMode::Oscillator,
    });
    config.rcc.pll_src = PllSource::HSE;
    config.rcc.pll = Some(Pll {
        prediv: PllPreDiv::DIV4,
        mul: PllMul::MUL96,
        divp: Some(if cfg!(feature = "wrong-pll") {
            PllPDiv::DIV4
        } else {
            PllPDiv::DIV2
        }),
        divq: Some(PllQDiv::DIV4),
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.ahb_pre = AHBPrescaler::DIV1;
    config.rcc.apb1_pre = APBPrescaler::DIV4;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config.dma_interrupt_priority = Priority::P8;
    config
}

/// Switches on the flash accelerator, which the HAL leaves off: at 96 MHz every
/// access to the flash takes three wait states without it (RM0090 3.5.1).
pub(crate) fn enable_flash_accelerator() {
    pac::FLASH.acr().modify(|w| {
        w.set_icen(true);
        w.set_dcen(true);
        w.set_prften(true);
    });
}

/// Why the board last reset (RM0090 7.3.21); clears the flags.
pub(crate) fn take_reset_cause() -> ResetCause {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    // A power-on sets PIN and BOR too, and every cause sets PIN: the most
    // particular one first.
    if flags.wdgrstf() {
        ResetCause::Watchdog
    } else if flags.wwdgrstf() {
        ResetCause::WindowWatchdog
    } else if flags.sftrstf() {
        ResetCause::Software
    } else if flags.lpwrrstf() {
        ResetCause::LowPower
    } else if flags.porrstf() {
        ResetCause::PowerOn
    } else if flags.borrstf() {
        ResetCause::BrownOut
    } else if flags.padrstf() {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}

/// TIM2 at priority 0, the further outputs at 1, everything else at 8. Before any interrupt is enabled:
/// an interrupt left at its reset priority of 0 would break critical sections.
pub(crate) fn set_priorities() {
    // SAFETY: called once, first thing, while no interrupt is enabled.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    for interrupt in 0..INTERRUPTS {
        // SAFETY: any priority is valid; critical sections are not in use yet.
        unsafe { core.NVIC.ipr[interrupt].write(Priority::P8 as u8) };
    }
    // SAFETY: these handlers do not touch what critical sections protect.
    unsafe {
        core.NVIC.set_priority(pac::Interrupt::TIM2, 0);
        for interrupt in [
            pac::Interrupt::TIM1_CC,
            pac::Interrupt::TIM5,
            pac::Interrupt::TIM3,
            pac::Interrupt::UART5,
        ] {
            core.NVIC.set_priority(interrupt, urgent::PRIORITY);
        }
    }
}
