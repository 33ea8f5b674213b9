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
use protocol::{Hello, PROTOCOL_VERSION, ResetCause, TICK_HZ};

use crate::hardware::imu_clock::ImuClockOutput;
use crate::hardware::thermometer::Thermometer;
use crate::hardware::{
    clocks, cycles, faults, flash, handover, idle, leds, leftovers, outputs, resources, rng, stack,
    tim2,
};
use crate::{state, tasks};

/// Mark by which a host recognises an image of this firmware and its board
/// ([`protocol::IMAGE_MARK`]).
const IMAGE: &str = env!("IMAGE");

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

    let mine = resources::split(embassy_stm32::init(clocks::config()));
    clocks::set_priorities();
    clocks::watch_crystal();
    clocks::enable_flash_accelerator();
    stack::paint();
    stack::guard();
    let epoch = number(&run, rng::number(mine.random));
    let thermometer = Thermometer::new(mine.chip.adc);
    let (panics, kept_panic) = flash::init(mine.chip.flash, run.last_panic.as_deref());
    let (trigger_events, output_events) = handover::init(mine.chip.handover);
    outputs::init(mine.outputs, output_events);
    tim2::init(mine.trigger, trigger_events);
    leds::init(mine.leds);
    leds::show_failed_run(run.last_panic.is_some() || reset_cause == ResetCause::Watchdog);
    let hello = Hello {
        epoch,
        reset_cause,
        panics,
        kept_panic,
        last_panic: run.last_panic,
        ..this_board()
    };
    introduce(hello, run.kept.resets);
    let usb = tasks::usb::build(mine.usb, &uid::uid());
    let imu_clock = ImuClockOutput::new(mine.imu_clock);
    clocks::check_priorities();

    idle::run(move |spawner| {
        spawn(spawner, tasks::usb::run(usb.device));
        spawn(spawner, tasks::usb::watch_terminal(usb.control));
        spawn(spawner, tasks::usb::watch_core());
        spawn(spawner, tasks::receive::run(usb.receiver));
        spawn(spawner, tasks::transmit::run(usb.sender));
        spawn(spawner, tasks::imu::run(mine.imu_bus, imu_clock));
        spawn(spawner, tasks::gnss::run(mine.sentences));
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
    // A halted core does not feed it. Without this one that a tool left halted starts again.
    #[cfg(feature = "developer")]
    pac::DBGMCU.apb1fzr().modify(|w| w.set_iwdg(true));
    watchdog
}

/// The board, its firmware, and nothing of this run.
fn this_board() -> Hello {
    Hello {
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
        board: BOARD.model,
        ..Hello::default()
    }
}

/// Logs who the board is, and keeps it for the tasks.
fn introduce(hello: Hello, resets: [u8; ResetCause::COUNT]) {
    defmt::info!(
        "{=str} epoch {=u32:08x}, reset by {}",
        IMAGE,
        hello.epoch,
        hello.reset_cause
    );
    if let Some(panic) = &hello.last_panic {
        defmt::warn!("the last run ended with: {=str}", panic.as_str());
    }
    if state::INFO.init((hello, resets)).is_err() {
        defmt::unreachable!();
    }
}

/// The number of this run: random after power-on, then one up with each reset.
fn number(run: &faults::Begun, random: Option<u32>) -> u32 {
    let random = random.filter(|_| run.first);
    if let Some(random) = random {
        faults::renumber(run, random);
    }
    random.unwrap_or(run.kept.run)
}

/// A decimal number, of cargo's.
const fn decimal(digits: &str) -> u8 {
    match u8::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => 0,
    }
}

/// Spawns a task. Each is spawned once, so its one place is free.
fn spawn<S>(spawner: Spawner, task: Result<SpawnToken<S>, SpawnError>) {
    match task {
        Ok(token) => spawner.spawn(token),
        Err(_) => defmt::unreachable!(),
    }
}
