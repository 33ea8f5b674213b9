//! I2C1 on PB6 and PB7, and how it is freed.

use embassy_futures::yield_now;
use embassy_stm32::gpio::{Input, Level, OutputOpenDrain, Pull, Speed};
use embassy_stm32::i2c::{
    Config, Error, ErrorInterruptHandler, EventInterruptHandler, I2c, Master,
};
use embassy_stm32::mode::Async;
use embassy_stm32::peripherals::{DMA1_CH0, DMA1_CH6, I2C1};
use embassy_stm32::time::Hertz;
use embassy_stm32::{bind_interrupts, dma, pac};
use embassy_time::Timer;
use embedded_hal::i2c::{ErrorType, Operation};
use firmware::config::I2C_HZ;

pub(crate) use crate::hardware::resources::ImuBus;

bind_interrupts!(struct Irqs {
    I2C1_EV => EventInterruptHandler<I2C1>;
    I2C1_ER => ErrorInterruptHandler<I2C1>;
    DMA1_STREAM0 => dma::InterruptHandler<DMA1_CH0>;
    DMA1_STREAM6 => dma::InterruptHandler<DMA1_CH6>;
});

/// Clocks after which any device has shifted out the byte that it hangs in,
/// with its acknowledge (I2C specification UM10204, 3.1.16).
const FREEING_CLOCKS: u32 = 9;

/// Half a clock while freeing the bus, in µs. The time driver makes 32 of it.
const HALF_CLOCK_US: u64 = 5;

impl ImuBus {
    /// The bus, freshly reset.
    pub(crate) fn open(&mut self) -> OpenBus<'_> {
        let mut config = Config::default();
        config.frequency = Hertz(I2C_HZ);
        // The sensor's board has its own; these keep the lines of an absent
        // sensor from floating, so that it gives no acknowledge, and at once.
        config.scl_pullup = true;
        config.sda_pullup = true;
        OpenBus(I2c::new(
            self.i2c.reborrow(),
            self.scl.reborrow(),
            self.sda.reborrow(),
            self.tx.reborrow(),
            self.rx.reborrow(),
            Irqs,
            config,
        ))
    }

    /// Frees the bus of a device that hangs in a transfer: up to nine clocks
    /// until it lets go of SDA, then a stop. Returns whether both lines are
    /// free now.
    pub(crate) async fn free(&mut self) -> bool {
        if self.is_idle() {
            return true;
        }
        let mut scl = OutputOpenDrain::new(self.scl.reborrow(), Level::High, Speed::Medium);
        let mut sda = OutputOpenDrain::new(self.sda.reborrow(), Level::High, Speed::Medium);
        for _ in 0..FREEING_CLOCKS {
            Timer::after_micros(HALF_CLOCK_US).await;
            if sda.is_high() {
                break;
            }
            scl.set_low();
            Timer::after_micros(HALF_CLOCK_US).await;
            scl.set_high();
        }
        // A stop: SDA rises while SCL is high.
        scl.set_low();
        Timer::after_micros(HALF_CLOCK_US).await;
        sda.set_low();
        Timer::after_micros(HALF_CLOCK_US).await;
        scl.set_high();
        Timer::after_micros(HALF_CLOCK_US).await;
        sda.set_high();
        Timer::after_micros(HALF_CLOCK_US).await;
        scl.is_high() && sda.is_high()
    }

    /// Returns true if both lines are high. Without a sensor, whose board has the pull-ups, the
    /// pins' own pull-ups hold them high.
    fn is_idle(&mut self) -> bool {
        let scl = Input::new(self.scl.reborrow(), Pull::Up);
        let sda = Input::new(self.sda.reborrow(), Pull::Up);
        // Some µs for the weak pull-ups.
        cortex_m::asm::delay(firmware::config::SYSCLK_HZ / 1_000_000 * 5);
        scl.is_high() && sda.is_high()
    }
}

/// The bus between two faults.
///
/// The HAL returns as soon as it has asked for the stop that ends a transfer, and its
/// next one writes CR1 at once. That is forbidden while the stop is pending (RM0090
/// 27.6.1), and the chip then makes no start at all or two. So each transfer first waits
/// for the last one's stop: some 3 µs.
pub(crate) struct OpenBus<'a>(I2c<'a, Async, Master>);

impl ErrorType for OpenBus<'_> {
    type Error = Error;
}

impl embedded_hal_async::i2c::I2c for OpenBus<'_> {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Error> {
        // On a bus that hangs the stop never comes; the caller gives up then.
        while pac::I2C1.cr1().read().stop() {
            yield_now().await;
        }
        self.0.transaction(address, operations).await
    }
}
