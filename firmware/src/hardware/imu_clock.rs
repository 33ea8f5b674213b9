//! The clocks for the clock input of an IMU, each for the sensors that take it: 32 kHz on PB0 (TIM3
//! channel 3), 19.2 MHz on PA8 (MCO1).

use embassy_stm32::gpio::OutputType;
use embassy_stm32::pac::gpio::vals::Ospeedr;
use embassy_stm32::peripherals::{MCO1, PA8, TIM3};
use embassy_stm32::rcc::{Mco, Mco1Source, McoConfig, McoPrescaler};
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm};
use embassy_stm32::{Peri, pac};
use firmware::config::IMU_RTC_HZ;
use protocol::ImuModel;

use crate::hardware::resources::ImuClock;

/// The outputs and their pins.
pub(crate) struct ImuClockOutput {
    slow: SimplePwm<'static, TIM3>,
    /// Until it runs.
    fast: Option<(Peri<'static, MCO1>, Peri<'static, PA8>)>,
}

impl ImuClockOutput {
    /// Both rest.
    pub(crate) fn new(clocks: ImuClock) -> Self {
        let pin = PwmPin::new(clocks.slow_pin, OutputType::PushPull);
        let rate = Hertz(IMU_RTC_HZ);
        let mode = CountingMode::EdgeAlignedUp;
        let mut slow = SimplePwm::new(clocks.slow, None, None, Some(pin), None, rate, mode);
        slow.ch3().set_duty_cycle_fraction(1, 2);
        let fast = Some((clocks.fast, clocks.fast_pin));
        Self { slow, fast }
    }

    /// Gives a sensor the clock that it takes. That of 19.2 MHz goes on from then on.
    pub(crate) fn set(&mut self, model: ImuModel) {
        if model == ImuModel::Icm42688P {
            self.slow.ch3().enable();
        } else {
            self.slow.ch3().disable();
        }
        if model == ImuModel::Mpu6050
            && let Some((mco, pin)) = self.fast.take()
        {
            // 96 MHz / 5: what it asks for at CLKSEL = 5.
            let mut config = McoConfig::default();
            config.prescaler = McoPrescaler::DIV5;
            let _running = Mco::new(mco, pin, Mco1Source::PLL, config);
            // The HAL's edges are those for 100 MHz; 25 are enough (DS8626 table 50).
            pac::GPIOA
                .ospeedr()
                .modify(|w| w.set_ospeedr(8, Ospeedr::MEDIUM_SPEED));
        }
    }
}
