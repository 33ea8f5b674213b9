//! PC12: the serial line of the sentences.
//!
//! With the usual polarity (high when idle) UART5 sends. The STM32F407's UARTs
//! cannot invert their output, so with the other polarity (low when idle, as
//! behind an RS-232 driver) TIM3's interrupt puts out bit after bit. It runs at
//! priority 1, so a bit may come as late as the handlers of the triggers take:
//! some 20 µs at a coincidence of all, against half a bit of 26 µs at 19,200 Bd,
//! the highest rate for this polarity.

use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use embassy_stm32::interrupt;
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::vals::{Moder, Pupdr};
use embassy_stm32::pac::timer::regs::SrGp16;
use firmware::config;
use heapless::Vec;
use protocol::{Baud, MAX_NMEA};

use crate::board::urgent::UrgentMutex;

const PIN: usize = 12;
/// UART5 (data sheet, table 9).
const ALTERNATE_FUNCTION: u8 = 8;

const UART: pac::usart::Usart = pac::UART5;
const TIM: pac::timer::TimGp16 = pac::TIM3;

/// Who sends.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    Closed,
    Uart,
    Inverted,
}

struct Port {
    mode: Mode,
    bytes: Vec<u8, MAX_NMEA>,
    next: usize,
    /// Bits of the present byte still to come, the next one lowest; start and
    /// stop bits too.
    shift: u16,
    bits: u8,
}

static PORT: UrgentMutex<RefCell<Port>> = UrgentMutex::new(RefCell::new(Port {
    mode: Mode::Closed,
    bytes: Vec::new(),
    next: 0,
    shift: 0,
    bits: 0,
}));

/// Gives the timer its clock and unmasks the handlers.
#[allow(unsafe_code, reason = "unmasks the interrupts")]
pub(crate) fn init() {
    pac::RCC.apb1enr().modify(|w| {
        w.set_uart5en(true);
        w.set_tim3en(true);
    });
    // SAFETY: what the handlers touch is set up.
    unsafe {
        NVIC::unmask(pac::Interrupt::UART5);
        NVIC::unmask(pac::Interrupt::TIM3);
    }
}

/// Opens the line, idle.
pub(crate) fn open(baud: Baud, inverted: bool) {
    PORT.lock(|port| {
        let port = &mut *port.borrow_mut();
        port.bytes.clear();
        port.next = 0;
        port.bits = 0;
        if inverted {
            port.mode = Mode::Inverted;
            TIM.psc().write_value(0);
            let clocks = config::TIM2_HZ.div_ceil(baud.hz());
            TIM.arr().write(|w| w.set_arr((clocks - 1) as u16));
            TIM.egr().write(|w| w.set_ug(true));
            TIM.sr().write_value(SrGp16(0));
            TIM.dier().modify(|w| w.set_uie(true));
            set_line(true, true);
            pac::GPIOC
                .moder()
                .modify(|w| w.set_moder(PIN, Moder::OUTPUT));
        } else {
            port.mode = Mode::Uart;
            let divider = (config::PCLK1_HZ + baud.hz() / 2) / baud.hz();
            UART.brr().write_value(pac::usart::regs::Brr(divider));
            UART.cr1().write(|w| {
                w.set_ue(true);
                w.set_te(true);
            });
            pac::GPIOC
                .afr(PIN / 8)
                .modify(|w| w.set_afr(PIN % 8, ALTERNATE_FUNCTION));
            pac::GPIOC
                .moder()
                .modify(|w| w.set_moder(PIN, Moder::ALTERNATE));
        }
    });
}

/// Closes the line: an input without a pull. What was not sent is not.
pub(crate) fn close() {
    PORT.lock(|port| {
        let port = &mut *port.borrow_mut();
        port.mode = Mode::Closed;
        port.bytes.clear();
        port.next = 0;
        TIM.cr1().modify(|w| w.set_cen(false));
        UART.cr1().write(|_| {});
        pac::GPIOC
            .pupdr()
            .modify(|w| w.set_pupdr(PIN, Pupdr::FLOATING));
        pac::GPIOC
            .moder()
            .modify(|w| w.set_moder(PIN, Moder::INPUT));
    });
}

/// Whether all bytes have left, to the last stop bit.
pub(crate) fn is_idle() -> bool {
    PORT.lock(|port| port.borrow().is_idle())
}

/// Sends `text`. False, and nothing is done, if the last text is not out yet or
/// the line is closed.
pub(crate) fn send(text: &str) -> bool {
    PORT.lock(|port| {
        let port = &mut *port.borrow_mut();
        if port.mode == Mode::Closed || !port.is_idle() {
            return false;
        }
        port.bytes.clear();
        port.next = 0;
        if port.bytes.extend_from_slice(text.as_bytes()).is_err() {
            return false;
        }
        match port.mode {
            Mode::Closed => {}
            Mode::Uart => UART.cr1().modify(|w| w.set_txeie(true)),
            Mode::Inverted => {
                TIM.cnt().write(|w| w.set_cnt(0));
                TIM.sr().write_value(SrGp16(0));
                TIM.cr1().modify(|w| w.set_cen(true));
            }
        }
        true
    })
}

/// The line at logical `one`.
fn set_line(one: bool, inverted: bool) {
    pac::GPIOC.bsrr().write(|w| {
        if one != inverted {
            w.set_bs(PIN, true);
        } else {
            w.set_br(PIN, true);
        }
    });
}

#[interrupt]
fn UART5() {
    PORT.lock(|port| {
        let port = &mut *port.borrow_mut();
        if !UART.sr().read().txe() {
            return;
        }
        match port.next_byte() {
            Some(byte) => UART.dr().write(|w| w.set_dr(byte.into())),
            None => UART.cr1().modify(|w| w.set_txeie(false)),
        }
    });
}

#[interrupt]
fn TIM3() {
    TIM.sr().write_value(SrGp16(0));
    PORT.lock(|port| port.borrow_mut().next_bit());
}

impl Port {
    fn is_idle(&self) -> bool {
        let sent = self.next >= self.bytes.len();
        match self.mode {
            Mode::Closed => true,
            Mode::Uart => sent && UART.sr().read().tc(),
            Mode::Inverted => sent && !TIM.cr1().read().cen(),
        }
    }

    fn next_byte(&mut self) -> Option<u8> {
        let byte = self.bytes.get(self.next).copied()?;
        self.next += 1;
        Some(byte)
    }

    /// Begins the next bit; after the last one the timer stops.
    fn next_bit(&mut self) {
        if self.bits == 0 {
            match self.next_byte() {
                Some(byte) => {
                    // Start bit 0, eight bits, stop bit 1.
                    self.shift = u16::from(byte) << 1 | 1 << 9;
                    self.bits = 10;
                }
                None => {
                    TIM.cr1().modify(|w| w.set_cen(false));
                    return;
                }
            }
        }
        set_line(self.shift & 1 != 0, true);
        self.shift >>= 1;
        self.bits -= 1;
    }
}
