//! A clean machine, whatever ran before. The ROM's bootloader starts a program without a reset and
//! leaves its clocks, its stack and the interrupts of its USB to it: the program "has to disable
//! all pending USB interrupts" (AN2662, on leaving DFU). A debugger may do the same.

#![allow(unsafe_code, reason = "the machine before anything runs on it")]

use cortex_m::peripheral::SCB;
use embassy_stm32::pac;
use embassy_stm32::pac::rcc::vals::Sw;

core::arch::global_asm!(include_str!("leftovers.s"));

/// Puts the clocks and the flash into their state after a reset (RM0090 7.3, 3.9). To be called
/// before any clock is set up.
pub(crate) fn clear() {
    pac::RCC.cr().modify(|w| w.set_hsion(true));
    while !pac::RCC.cr().read().hsirdy() {}
    pac::RCC.cfgr().modify(|w| w.set_sw(Sw::HSI));
    while pac::RCC.cfgr().read().sws() != Sw::HSI {}
    pac::RCC.cfgr().write(|_| ());
    pac::RCC.cr().modify(|w| {
        w.set_hseon(false);
        w.set_csson(false);
        w.set_pllon(false);
    });
    // Only while the oscillator is off.
    pac::RCC.cr().modify(|w| w.set_hsebyp(false));
    // What the ROM has written to the flash may differ from what the caches hold.
    pac::FLASH.acr().modify(|w| {
        w.set_prften(false);
        w.set_icen(false);
        w.set_dcen(false);
    });
    pac::FLASH.acr().modify(|w| {
        w.set_icrst(true);
        w.set_dcrst(true);
    });
    pac::FLASH.acr().write(|_| ());
    pac::FLASH.cr().modify(|w| w.set_lock(true));
    // SAFETY: nobody else runs yet; faults of an earlier program are not this one's.
    unsafe {
        (*SCB::PTR).shcsr.write(0);
        (*SCB::PTR).cfsr.write(u32::MAX);
        (*SCB::PTR).hfsr.write(u32::MAX);
    }
}
