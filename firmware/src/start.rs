//! From reset to the first task.

use defmt_rtt as _;
use embassy_executor::{SpawnError, SpawnToken, Spawner};
#[cfg(feature = "developer")]
use embassy_stm32::pac;
use embassy_stm32::peripherals::IWDG;
use embassy_stm32::uid;
use embassy_stm32::wdg::IndependentWatchdog;
use firmware::boards::BOARD;
use firmware::config;
use heapless::String;
use protocol::{Hello, PROTOCOL_VERSION, ResetCause, TICK_HZ, Ticks};

use crate::hardware::imu_bus::ImuBus;
use crate::hardware::imu_clock::ImuClockOutput;
use crate::hardware::thermometer::Thermometer;
use crate::hardware::{
    clocks, cycles, faults, flash, handover, idle, leds, leftovers, outputs, stack, tim1, tim2,
};
#[cfg(feature = "discovery")]
use crate::hardware::{nmea_port, rng};
use crate::state;
use crate::tasks;

/// Mark by which a host recognises an image of this firmware and its board
/// ([`protocol::IMAGE_MARK`]).
const IMAGE: &str = concat!(
    "SmartDepthSync image;",
    env!("BOARD"),
    ";",
    env!("CARGO_PKG_VERSION"),
    ";",
    env!("GIT_REVISION"),
    ";"
);

#[cortex_m_rt::entry]
fn main() -> ! {
    faults::start_rom_if_asked();
    leftovers::clear();
    clocks::set_priorities();
    faults::init();
    cycles::keep_running();
    let reset_cause = clocks::take_reset_cause();
    let watchdog = start_watchdog();
    clocks::start_crystal();
    // Only now: a run without a crystal is over before it could report what ended the last one.
    let run = faults::begin_run(reset_cause);

    let p = embassy_stm32::init(clocks::config());
    clocks::set_priorities();
    clocks::watch_crystal();
    clocks::enable_flash_accelerator();
    clocks::enable_peripherals();
    #[cfg(feature = "discovery")]
    let random = {
        nmea_port::init(p.UART5, p.PC12);
        rng::number(p.RNG)
    };
    // The number of the first run is what memory held at power-on.
    #[cfg(not(feature = "discovery"))]
    let random = None;
    let epoch = number(&run, random);
    let last_panic = run.last_panic;
    stack::paint();
    // A halted core does not feed the watchdog. Without this one that a tool left halted
    // starts again.
    #[cfg(feature = "developer")]
    pac::DBGMCU.apb1fzr().modify(|w| w.set_iwdg(true));
    let thermometer = Thermometer::new(p.ADC1);
    let (panics, kept_panic) = flash::init(p.FLASH, last_panic.as_deref());
    let (trigger_events, output_events) = handover::init(p.SPI3);
    #[cfg(feature = "discovery")]
    let led_pins = (p.PD12, p.PD13, p.PD14, p.PD15);
    #[cfg(not(feature = "discovery"))]
    let led_pins = (p.PB12, p.PB13, p.PC13, p.PB15);
    let lines = tim1::Owned {
        edges: p.TIM1,
        wakes: p.TIM5,
        #[cfg(feature = "discovery")]
        pps: p.PE9,
        #[cfg(feature = "discovery")]
        second: p.PE11,
        #[cfg(feature = "discovery")]
        third: p.PE13,
        #[cfg(feature = "discovery")]
        fourth: p.PE14,
    };
    outputs::init(lines, output_events);
    let trigger = tim2::Owned {
        timer: p.TIM2,
        trigger: p.PA5,
        data_ready: p.PA1,
        strobe: p.PA2,
        readback: p.PA3,
        _falling_edges: p.DMA1_CH5,
    };
    tim2::init(trigger, trigger_events);
    leds::init(led_pins);

    let failed = last_panic.is_some() || reset_cause == ResetCause::Watchdog;
    leds::show_failed_run(failed);
    let hello = Hello {
        protocol_version: PROTOCOL_VERSION,
        firmware_version: (
            decimal(env!("CARGO_PKG_VERSION_MAJOR")),
            decimal(env!("CARGO_PKG_VERSION_MINOR")),
            decimal(env!("CARGO_PKG_VERSION_PATCH")),
        ),
        git_revision: String::try_from(env!("GIT_REVISION")).unwrap_or_default(),
        git_dirty: env!("GIT_DIRTY").as_bytes() == b"1",
        board_id: uid::uid(),
        tick_hz: TICK_HZ,
        now: Ticks::ZERO,
        epoch,
        reset_cause,
        last_panic,
        board: BOARD.model,
        panics,
        kept_panic,
    };
    defmt::info!(
        "{=str} epoch {=u32:08x}, reset by {}",
        IMAGE,
        epoch,
        reset_cause
    );
    if let Some(panic) = &hello.last_panic {
        defmt::warn!("the last run ended with: {=str}", panic.as_str());
    }
    let board_id = hello.board_id;
    if state::INFO.init((hello, run.kept.resets)).is_err() {
        defmt::unreachable!();
    }

    let usb = tasks::usb::build(p.USB_OTG_FS, (p.PA12, p.PA11, p.PA9), &board_id);

    let imu_bus = ImuBus {
        i2c: p.I2C1,
        scl: p.PB6,
        sda: p.PB7,
        tx: p.DMA1_CH6,
        rx: p.DMA1_CH0,
    };

    let imu_clock = ImuClockOutput::new((p.TIM3, p.PB0), (p.MCO1, p.PA8));
    clocks::check_priorities();
    // Taken before the HAL gave it.
    let _taken = p.IWDG;

    idle::run(move |spawner| {
        spawn(spawner, tasks::usb::run(usb.device));
        spawn(spawner, tasks::usb::watch_terminal(usb.control));
        spawn(spawner, tasks::usb::watch_core());
        spawn(spawner, tasks::receive::run(usb.receiver));
        spawn(spawner, tasks::transmit::run(usb.sender));
        spawn(spawner, tasks::imu::run(imu_bus, imu_clock));
        spawn(spawner, tasks::gnss::run());
        spawn(spawner, tasks::self_test::run());
        spawn(spawner, tasks::unmute::run());
        spawn(spawner, tasks::status::run(watchdog, thermometer));
    })
}

/// Starts the watchdog, before anything that may wait for ever: it needs no clock but its
/// own.
#[allow(unsafe_code, reason = "before the HAL gives the peripheral")]
fn start_watchdog() -> IndependentWatchdog<'static, IWDG> {
    // SAFETY: nobody else takes it.
    let peripheral = unsafe { IWDG::steal() };
    let mut watchdog = IndependentWatchdog::new(peripheral, config::WATCHDOG_US);
    watchdog.unleash();
    watchdog
}

/// The number of this run: random after power-on, then one up with each reset.
fn number(run: &faults::Begun, random: Option<u32>) -> u32 {
    match random {
        Some(random) if run.first => {
            faults::renumber(run, random);
            random
        }
        _ => run.kept.run,
    }
}

/// A decimal number; digits that do not fit wrap.
const fn decimal(digits: &str) -> u8 {
    let mut bytes = digits.as_bytes();
    let mut value = 0_u8;
    while let [digit, rest @ ..] = bytes {
        value = value
            .wrapping_mul(10)
            .wrapping_add(digit.wrapping_sub(b'0'));
        bytes = rest;
    }
    value
}

/// Spawns a task. Each is spawned once, so its one place is free.
fn spawn<S>(spawner: Spawner, task: Result<SpawnToken<S>, SpawnError>) {
    match task {
        Ok(token) => spawner.spawn(token),
        Err(_) => defmt::unreachable!(),
    }
}
