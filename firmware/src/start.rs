//! From reset to the first task.

use defmt_rtt as _;
use embassy_executor::{SpawnError, SpawnToken, Spawner};
#[cfg(feature = "developer")]
use embassy_stm32::pac;
use embassy_stm32::peripherals::IWDG;
use embassy_stm32::rcc::{Mco, Mco1Source, McoConfig, McoPrescaler};
use embassy_stm32::uid;
use embassy_stm32::wdg::IndependentWatchdog;
use firmware::config;
use protocol::ResetCause;

use crate::board::imu_bus::ImuBus;
use crate::board::imu_clock::ImuClockOutput;
use crate::board::{
    clocks, cycles, faults, handover, idle, leds, nmea_port, outputs, rng, stack, tim2,
};
use crate::state::{self, BoardInfo};
use crate::tasks;

#[cortex_m_rt::entry]
fn main() -> ! {
    clocks::set_priorities();
    faults::init();
    cycles::keep_running();
    let reset_cause = clocks::take_reset_cause();
    let run = faults::begin_run();
    let watchdog = start_watchdog();
    clocks::start_crystal();

    let p = embassy_stm32::init(clocks::config());
    clocks::raise_trigger();
    clocks::enable_flash_accelerator();
    clocks::enable_peripherals();
    let epoch = number(&run);
    let last_panic = run.last_panic;
    stack::paint();
    // A halted core does not feed the watchdog. Without this one that a tool left halted
    // starts again.
    #[cfg(feature = "developer")]
    pac::DBGMCU.apb1fzr().modify(|w| w.set_iwdg(true));
    let (trigger_events, output_events) = handover::init();
    outputs::init(output_events);
    tim2::init(trigger_events);
    nmea_port::init();
    leds::init();

    // 96 MHz / 5: the 19.2 MHz that the MPU-9150 asks for at CLKSEL = 5.
    let mut clock_out = McoConfig::default();
    clock_out.prescaler = McoPrescaler::DIV5;
    let _imu_clock = Mco::new(p.MCO1, p.PA8, Mco1Source::PLL, clock_out);

    let failed = last_panic.is_some() || reset_cause == ResetCause::Watchdog;
    leds::show_failed_run(failed);
    let info = BoardInfo {
        board_id: uid::uid(),
        epoch,
        reset_cause,
        last_panic,
    };
    defmt::info!(
        "SmartDepthSync {=str} ({=str}), epoch {=u32:08x}, reset by {}",
        env!("CARGO_PKG_VERSION"),
        env!("GIT_REVISION"),
        epoch,
        reset_cause,
    );
    if let Some(panic) = &info.last_panic {
        defmt::warn!("the last run ended with: {=str}", panic.as_str());
    }
    let board_id = info.board_id;
    if state::INFO.init(info).is_err() {
        defmt::unreachable!();
    }

    let usb = tasks::usb::build(p.USB_OTG_FS, p.PA12, p.PA11, &board_id);

    let imu_bus = ImuBus {
        i2c: p.I2C1,
        scl: p.PB6,
        sda: p.PB7,
        tx: p.DMA1_CH6,
        rx: p.DMA1_CH0,
    };

    let imu_clock = ImuClockOutput::new(p.TIM3, p.PB0);

    idle::run(move |spawner| {
        spawn(spawner, tasks::usb::run(usb.device));
        spawn(spawner, tasks::usb::watch_terminal(usb.control));
        spawn(spawner, tasks::usb::watch_transmit());
        spawn(spawner, tasks::receive::run(usb.receiver));
        spawn(spawner, tasks::transmit::run(usb.sender));
        spawn(spawner, tasks::imu::run(imu_bus, imu_clock));
        spawn(spawner, tasks::gnss::run());
        spawn(spawner, tasks::self_test::run());
        spawn(spawner, tasks::unmute::run());
        spawn(spawner, tasks::status::run(watchdog));
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
fn number(run: &faults::Begun) -> u32 {
    match rng::number() {
        Some(random) if run.first => {
            faults::renumber(random);
            random
        }
        _ => run.epoch,
    }
}

/// Spawns a task. Each is spawned once, so its one place is free.
fn spawn<S>(spawner: Spawner, task: Result<SpawnToken<S>, SpawnError>) {
    match task {
        Ok(token) => spawner.spawn(token),
        Err(_) => defmt::unreachable!(),
    }
}
