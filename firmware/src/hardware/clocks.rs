//! Clock tree, reset cause and interrupt priorities.

#![allow(
    unsafe_code,
    reason = "priorities and reset flags of the bare hardware"
)]

use cortex_m::peripheral::DCB;
use embassy_stm32::Config;
use embassy_stm32::interrupt::Priority;
use embassy_stm32::pac;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource,
    Sysclk,
};
use embassy_stm32::time::Hertz;
use firmware::boards::BOARD;
use protocol::ResetCause;

use crate::hardware::{falling_edges, irq_priority, leds};

/// Looks at the crystal, 1 µs and more apart, until it is given up: 50 times the 2 ms in
/// which it typically starts (data sheet, table 39).
const CRYSTAL_LOOKS: u32 = 100_000;

/// The crystal's PLL at 192 MHz; / 2 = 96 MHz core, / 4 = 48 MHz USB; APB1
/// 24 MHz (timers 48), APB2 48 MHz (timers 96).
pub(crate) fn config() -> Config {
    let mut config = Config::default();
    config.rcc.hsi = false;
    config.rcc.hse = Some(Hse {
        freq: Hertz(BOARD.crystal_hz),
        mode: HseMode::Oscillator,
    });
    config.rcc.pll_src = PllSource::HSE;
    config.rcc.pll = Some(Pll {
        prediv: PllPreDiv::from_bits(BOARD.pll_divider),
        mul: PllMul::from_bits(BOARD.pll_factor),
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV4),
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.ahb_pre = AHBPrescaler::DIV1;
    config.rcc.apb1_pre = APBPrescaler::DIV4;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config.dma_interrupt_priority = Priority::P8;
    // Followed later by `follow_debugger`.
    config.enable_debug_during_sleep = DCB::is_debugger_attached();
    config
}

/// Starts the crystal, for which the HAL would wait for ever. If it does not come, lights
/// the LED of faults and waits for the watchdog, which must run: the next run tries again.
pub(crate) fn start_crystal() {
    pac::RCC.cr().modify(|w| w.set_hseon(true));
    for _ in 0..CRYSTAL_LOOKS {
        if pac::RCC.cr().read().hserdy() {
            return;
        }
        // The core runs on its own 16 MHz here.
        cortex_m::asm::delay(16);
    }
    leds::show_fault();
    loop {
        cortex_m::asm::nop();
    }
}

/// Has a crystal that stops end the run: a timebase from anything else would go on unnoticed. The
/// chip's clock security raises the NMI (RM0090 7.2.7). To be called once the HAL runs on it.
pub(crate) fn watch_crystal() {
    pac::RCC.cr().modify(|w| w.set_csson(true));
}

/// Lets the core be debugged in sleep while a debugger is there. Without one it costs power, and a
/// condition of ES0182 2.1.3: see `idle`.
pub(crate) fn follow_debugger() {
    pac::DBGMCU
        .cr()
        .modify(|w| w.set_dbg_sleep(DCB::is_debugger_attached()));
}

/// Switches on the flash accelerator, which the HAL leaves off: at 96 MHz every
/// access to the flash takes three wait states without it (RM0090 3.5.1). The first
/// revision of some chips cannot prefetch, and gives another device ID.
pub(crate) fn enable_flash_accelerator() {
    let id = pac::DBGMCU.idcode().read();
    let prefetches = BOARD
        .cannot_prefetch
        .is_none_or(|(later, first)| id.dev_id() == later && id.rev_id() != first);
    pac::FLASH.acr().modify(|w| {
        w.set_icen(true);
        w.set_dcen(true);
        w.set_prften(prefetches);
    });
}

/// Why the board last reset (RM0090 7.3.21); clears the flags.
pub(crate) fn take_reset_cause() -> ResetCause {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    // A power-on sets PIN and BOR too, and every cause sets PIN: the most
    // particular one first.
    let causes = [
        (flags.wdgrstf(), ResetCause::Watchdog),
        (flags.sftrstf(), ResetCause::Software),
        (flags.porrstf(), ResetCause::PowerOn),
        (flags.borrstf(), ResetCause::BrownOut),
        (flags.padrstf(), ResetCause::Pin),
    ];
    let found = causes.into_iter().find(|(is_set, _)| *is_set);
    found.map_or(ResetCause::Unknown, |(_, cause)| cause)
}

/// The priority of an interrupt: the trigger's 0, the auxiliary outputs' 1, everything else's 8.
fn priority_of(interrupt: usize) -> u8 {
    const TIM2: usize = pac::Interrupt::TIM2 as usize;
    const FALLING_EDGES: usize = falling_edges::INTERRUPT as usize;
    const TIM1: usize = pac::Interrupt::TIM1_CC as usize;
    const TIM5: usize = pac::Interrupt::TIM5 as usize;
    match interrupt {
        TIM2 | FALLING_EDGES => 0,
        TIM1 | TIM5 => irq_priority::PRIORITY,
        _ => Priority::P8 as u8,
    }
}

/// Gives each interrupt its priority. To be called before any is enabled, as one that is left at
/// its reset priority of 0 would break critical sections, and again after the HAL has started,
/// which gives all DMA streams one priority.
pub(crate) fn set_priorities() {
    // SAFETY: called by `main`, before it enables an interrupt of its own.
    let core = unsafe { cortex_m::Peripherals::steal() };
    for interrupt in 0..BOARD.interrupts {
        // SAFETY: any priority is valid; what runs at 0 and 1 touches nothing that critical
        // sections protect.
        unsafe { core.NVIC.ipr[interrupt].write(priority_of(interrupt)) };
    }
}

/// Panics if a driver has given an interrupt another priority. To be called once everything is
/// set up.
pub(crate) fn check_priorities() {
    // SAFETY: reading priorities has no effect.
    let core = unsafe { cortex_m::Peripherals::steal() };
    for interrupt in 0..BOARD.interrupts {
        let found = core.NVIC.ipr[interrupt].read();
        assert_eq!(
            found,
            priority_of(interrupt),
            "priority of interrupt {interrupt}"
        );
    }
}
