//! PC12: the serial line of the sentences, by UART5.
//!
//! It is high when idle, as the chip's UARTs are; they cannot invert. A lidar that wants
//! it low when idle is wired through an inverting gate, which it needs for its levels
//! anyway (`docs/wiring.md`).

use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use embassy_stm32::pac::gpio::vals::{Moder, Pupdr};
use embassy_stm32::{Peri, interrupt, pac, peripherals};
use embassy_sync::blocking_mutex::CriticalSectionMutex;
use firmware::config;
use heapless::Vec;
use protocol::{Baud, MAX_NMEA};

const PIN: usize = 12;
/// UART5 (data sheet, table 9).
const ALTERNATE_FUNCTION: u8 = 8;

const UART: pac::usart::Usart = pac::UART5;

struct Port {
    open: bool,
    bytes: Vec<u8, MAX_NMEA>,
    next: usize,
}

static PORT: CriticalSectionMutex<RefCell<Port>> = CriticalSectionMutex::new(RefCell::new(Port {
    open: false,
    bytes: Vec::new(),
    next: 0,
}));

/// Unmasks the handler; line and pin are this driver's alone.
#[allow(unsafe_code, reason = "unmasks the interrupt")]
pub(crate) fn init(_: Peri<'static, peripherals::UART5>, _: Peri<'static, peripherals::PC12>) {
    // SAFETY: what the handler touches is set up.
    unsafe { NVIC::unmask(pac::Interrupt::UART5) };
}

/// Opens the line, idle.
pub(crate) fn open(baud: Baud) {
    PORT.lock(|port| {
        port.borrow_mut().open = true;
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
    });
}

/// Closes the line: an input without a pull. What was not sent is not.
pub(crate) fn close() {
    PORT.lock(|port| {
        let port = &mut *port.borrow_mut();
        port.open = false;
        port.bytes.clear();
        port.next = 0;
        UART.cr1().write(|_| {});
        pac::GPIOC
            .pupdr()
            .modify(|w| w.set_pupdr(PIN, Pupdr::FLOATING));
        pac::GPIOC
            .moder()
            .modify(|w| w.set_moder(PIN, Moder::INPUT));
    });
}

/// Returns true if all bytes have been sent, to the last stop bit.
pub(crate) fn is_idle() -> bool {
    PORT.lock(|port| port.borrow().is_idle())
}

/// Sends `text`. False, and nothing is done, if the last text is not out yet or
/// the line is closed.
pub(crate) fn send(text: &str) -> bool {
    PORT.lock(|port| {
        let port = &mut *port.borrow_mut();
        if !port.open || !port.is_idle() {
            return false;
        }
        port.bytes.clear();
        port.next = 0;
        if port.bytes.extend_from_slice(text.as_bytes()).is_err() {
            return false;
        }
        UART.cr1().modify(|w| w.set_txeie(true));
        true
    })
}

#[interrupt]
fn UART5() {
    PORT.lock(|port| {
        let port = &mut *port.borrow_mut();
        if !UART.sr().read().txe() {
            return;
        }
        match port.bytes.get(port.next) {
            Some(&byte) => {
                port.next += 1;
                UART.dr().write(|w| w.set_dr(byte.into()));
            }
            None => UART.cr1().modify(|w| w.set_txeie(false)),
        }
    });
}

impl Port {
    fn is_idle(&self) -> bool {
        !self.open || (self.next >= self.bytes.len() && UART.sr().read().tc())
    }
}
