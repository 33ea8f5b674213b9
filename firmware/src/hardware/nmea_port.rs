//! PC12: the serial line of the sentences, by UART5 and DMA1's stream 7.
//!
//! It is high when idle, as the chip's UARTs are; they cannot invert. A lidar that wants
//! it low when idle is wired through an inverting gate, which it needs for its levels
//! anyway (`docs/wiring.md`).

use embassy_stm32::mode::Async;
use embassy_stm32::peripherals::DMA1_CH7;
use embassy_stm32::usart::{Config, UartTx};
use embassy_stm32::{bind_interrupts, dma};
use embassy_time::Timer;
use protocol::Baud;

use crate::hardware::resources::Sentences;

bind_interrupts!(struct Irqs {
    DMA1_STREAM7 => dma::InterruptHandler<DMA1_CH7>;
});

/// Bits of the characters that the UART still has when its DMA is done.
const LAST_BITS: u64 = 20;

/// The line, idle between two texts. Dropped, it is neither driven nor pulled.
pub(crate) struct Port<'a> {
    /// None if the UART has no such rate.
    uart: Option<UartTx<'a, Async>>,
    baud: Baud,
}

pub(crate) fn open(sentences: &mut Sentences, baud: Baud) -> Port<'_> {
    let mut config = Config::default();
    config.baudrate = baud.hz();
    let (uart, pin) = (sentences.uart.reborrow(), sentences.pin.reborrow());
    let uart = UartTx::new(uart, pin, sentences.dma.reborrow(), Irqs, config).ok();
    Port { uart, baud }
}

impl Port<'_> {
    /// Sends a text, to the last stop bit. (The HAL's own wait for that needs an interrupt that
    /// its transmitter leaves off.) Returns false if nothing was sent.
    pub(crate) async fn send(&mut self, text: &str) -> bool {
        let Some(uart) = &mut self.uart else {
            return false;
        };
        let sent = uart.write(text.as_bytes()).await.is_ok();
        Timer::after_micros(LAST_BITS * 1_000_000 / u64::from(self.baud.hz()) + 1).await;
        sent
    }
}
