//! The program on the chip.

use embassy_executor::Spawner;
use embassy_stm32::exti::{ExtiInput, InterruptHandler};
use embassy_stm32::gpio::{Input, Level, Output, OutputType, Pull, Speed};
use embassy_stm32::mode::{Async, Blocking};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Pll, PllMul, PllPDiv, PllPreDiv, PllSource, Sysclk,
};
use embassy_stm32::time::{Hertz, khz};
use embassy_stm32::timer::simple_pwm::{PwmPin, SimplePwm};
use embassy_stm32::usart::{self, UartTx};
use embassy_stm32::{Config, bind_interrupts, interrupt};
use embassy_time::{Duration, Ticker, Timer};

bind_interrupts!(struct Irqs {
    EXTI0 => InterruptHandler<interrupt::typelevel::EXTI0>;
});

/// 16 MHz / 8 · 168 / 4 = 84 MHz; the buses at 42 and 84 MHz.
fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hsi = true;
    config.rcc.pll_src = PllSource::HSI;
    config.rcc.pll = Some(Pll {
        prediv: PllPreDiv::DIV8,
        mul: PllMul::MUL168,
        divp: Some(PllPDiv::DIV4),
        divq: None,
        divr: None,
    });
    config.rcc.ahb_pre = AHBPrescaler::DIV1;
    config.rcc.apb1_pre = APBPrescaler::DIV2;
    config.rcc.apb2_pre = APBPrescaler::DIV1;
    config.rcc.sys = Sysclk::PLL1_P;
    config
}

/// Turns the lamp over every 50 ms.
#[embassy_executor::task]
async fn blink(mut lamp: Output<'static>) {
    let mut ticker = Ticker::every(Duration::from_millis(50));
    loop {
        ticker.next().await;
        lamp.toggle();
    }
}

/// Follows the button with a lamp.
#[embassy_executor::task]
async fn follow(mut button: ExtiInput<'static, Async>, mut lamp: Output<'static>) {
    loop {
        button.wait_for_rising_edge().await;
        lamp.set_high();
        button.wait_for_falling_edge().await;
        lamp.set_low();
    }
}

/// Counts aloud, ten times a second.
#[embassy_executor::task]
async fn count(mut uart: UartTx<'static, Blocking>) {
    let mut text = *b"count 0\r\n";
    loop {
        Timer::after_millis(100).await;
        let _ = uart.blocking_write(&text);
        text[6] = if text[6] == b'9' { b'0' } else { text[6] + 1 };
    }
}

/// Reads the data register of the CRC unit, which the simulator does not model.
fn read_checksum() {
    const CRC_DR: *const u32 = 0x4002_3000 as *const u32;
    // SAFETY: a register of this chip, read for nothing but the read itself.
    #[allow(unsafe_code)]
    let _ = unsafe { CRC_DR.read_volatile() };
}

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let p = embassy_stm32::init(clocks());
    if Input::new(p.PB1, Pull::Down).is_high() {
        read_checksum();
    }

    let mut settings = usart::Config::default();
    settings.baudrate = 57_600;
    if let Ok(uart) = UartTx::new_blocking(p.USART2, p.PA2, settings)
        && let Ok(task) = count(uart)
    {
        spawner.spawn(task);
    }
    if let Ok(task) = blink(Output::new(p.PC13, Level::Low, Speed::Low)) {
        spawner.spawn(task);
    }
    let button = ExtiInput::new(p.PA0, p.EXTI0, Pull::Down, Irqs);
    if let Ok(task) = follow(button, Output::new(p.PC14, Level::Low, Speed::Low)) {
        spawner.spawn(task);
    }

    // 1 kHz, a quarter of the time high.
    let pin = PwmPin::new(p.PB4, OutputType::PushPull);
    let frequency: Hertz = khz(1);
    let mut pwm = SimplePwm::new(
        p.TIM3,
        Some(pin),
        None,
        None,
        None,
        frequency,
        Default::default(),
    );
    let mut channel = pwm.ch1();
    channel.set_duty_cycle_fraction(1, 4);
    channel.enable();
    core::future::pending().await
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::asm::udf()
}
