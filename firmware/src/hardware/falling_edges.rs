//! DMA1's stream 5 on channel 3: the request of TIM2's channel 1 (RM0090 table 42). It
//! makes the trigger's falling edge without any software.
//!
//! The channel turns its pin over at each match and asks for a transfer. At the rising
//! edge the stream loads the compare value of the falling one; the register has no
//! preload, so that value holds at once (18.4.7, OC1PE = 0). At the falling edge the
//! stream loads a value that has passed, only so that no request is left over: one that
//! nobody acknowledged would be served as soon as the stream is enabled again (10.3.2),
//! before the next pulse. That second transfer ends the stream, which calls the handler.
//!
//! The first value waits in the stream's FIFO before it is asked for (10.3.12), so the
//! load takes one access of APB1. The IMU's streams have the same priority (the HAL's), and of
//! those the one with the lower number goes first (10.3.6): the load may come after the core's
//! access and one of the IMU's, in less than 1 µs. [`protocol::MIN_PULSE_WIDTH`] is ten times
//! that.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::pac;
use embassy_stm32::pac::dma::regs::Cr;
use embassy_stm32::pac::dma::vals::{Dir, Pl, Size};

pub(super) const INTERRUPT: pac::Interrupt = pac::Interrupt::DMA1_STREAM5;

const DMA: pac::dma::Dma = pac::DMA1;
const STREAM: usize = 5;
const CHANNEL: u8 = 3;

/// Values that the stream loads: the falling edge, then a value that has passed. They lie in
/// SRAM, where the stream can read them.
static VALUES: [AtomicU32; 2] = [AtomicU32::new(0), AtomicU32::new(0)];

/// Directs the stream from [`VALUES`] to the compare register. The controller has its
/// clock from the HAL.
pub(super) fn init(compare: *mut u32) {
    disarm();
    let stream = DMA.st(STREAM);
    stream.par().write_value(compare as u32);
    stream.m0ar().write_value(VALUES.as_ptr() as u32);
}

/// The next match at `rise` loads `fall`.
pub(super) fn arm(rise: u32, fall: u32) {
    let [first, second] = &VALUES;
    first.store(fall, Ordering::Relaxed);
    second.store(rise, Ordering::Relaxed);
    // In memory before the stream reads them.
    cortex_m::asm::dmb();
    let stream = DMA.st(STREAM);
    stream.ndtr().write(|w| w.set_ndt(VALUES.len() as u16));
    // The stream is set up while it is off, and then switched on (RM0090 10.3.17).
    let mut set_up = Cr(0);
    set_up.set_chsel(CHANNEL);
    set_up.set_pl(Pl::VERY_HIGH);
    set_up.set_msize(Size::BITS32);
    set_up.set_psize(Size::BITS32);
    set_up.set_minc(true);
    set_up.set_dir(Dir::MEMORY_TO_PERIPHERAL);
    set_up.set_tcie(true);
    stream.cr().write_value(set_up);
    set_up.set_en(true);
    stream.cr().write_value(set_up);
}

/// Reads of the stream's state until it must be off: a transfer under way is finished first, which
/// takes less than 1 µs, or some ten reads.
const MAX_READS: usize = 1_000;

/// Switches the stream off, wherever it stands, and clears what it flagged.
pub(super) fn disarm() {
    let stream = DMA.st(STREAM);
    stream.cr().write(|_| {});
    if stream.cr().read().en() {
        wait_until_off();
    }
    clear_flags();
}

#[cold]
fn wait_until_off() {
    let is_off = |_| !DMA.st(STREAM).cr().read().en();
    if !(0..MAX_READS).any(is_off) {
        defmt::panic!("the stream of the falling edges does not stop");
    }
}

/// If both values were loaded: the falling edge.
pub(super) fn take_end() -> Option<u32> {
    let ended = DMA.isr(STREAM / 4).read().tcif(STREAM % 4);
    ended.then(|| {
        clear_flags();
        let [fall, _] = &VALUES;
        fall.load(Ordering::Relaxed)
    })
}

fn clear_flags() {
    DMA.ifcr(STREAM / 4).write(|w| {
        w.set_tcif(STREAM % 4, true);
        w.set_htif(STREAM % 4, true);
        w.set_teif(STREAM % 4, true);
        w.set_dmeif(STREAM % 4, true);
        w.set_feif(STREAM % 4, true);
    });
}
