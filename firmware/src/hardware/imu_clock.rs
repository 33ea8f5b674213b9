//! The clock of 32 kHz on PB0 (TIM3 channel 3), for an IMU whose clock input takes that.
//! The one of 19.2 MHz on PA8 always runs.

use embassy_stm32::Peri;
use embassy_stm32::gpio::OutputType;
use embassy_stm32::peripherals::{PB0, TIM3};
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm};
use firmware::config::IMU_RTC_HZ;
use protocol::ImuModel;

/// The timer and its pin.
pub(crate) struct ImuClockOutput(SimplePwm<'static, TIM3>);

impl ImuClockOutput {
    /// Low.
    pub(crate) fn new(timer: Peri<'static, TIM3>, pin: Peri<'static, PB0>) -> Self {
        let pin = PwmPin::new(pin, OutputType::PushPull);
        let rate = Hertz(IMU_RTC_HZ);
        let mode = CountingMode::EdgeAlignedUp;
        let mut pwm = SimplePwm::new(timer, None, None, Some(pin), None, rate, mode);
        pwm.ch3().set_duty_cycle_fraction(1, 2);
        Self(pwm)
    }

    /// Runs for a sensor that takes it, and rests for any other.
    pub(crate) fn set(&mut self, model: ImuModel) {
        if model == ImuModel::Icm42688P {
            self.0.ch3().enable();
        } else {
            self.0.ch3().disable();
        }
    }
}
