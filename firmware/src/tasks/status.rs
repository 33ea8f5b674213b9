//! Once a second: feeds the watchdog if every task is alive, and reports.

use core::sync::atomic::Ordering;

use embassy_stm32::peripherals::IWDG;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_time::{Duration, Ticker};
use firmware::config::TRIGGER_OVERDUE;
use protocol::{DeviceToHost, Handlers, Hello, Output, Status};

use crate::hardware::thermometer::{Measured, Thermometer};
use crate::hardware::{clocks, cycles, idle, masked, outputs, stack, tim2, triggers};
use crate::state::{self, ALIVE, CONNECTS, INFO, RECEIVED};
use crate::tasks::{gnss, imu, usb};

#[embassy_executor::task]
pub(crate) async fn run(
    mut watchdog: IndependentWatchdog<'static, IWDG>,
    mut thermometer: Thermometer,
) {
    let mut ticker = Ticker::every(Duration::from_secs(1));
    let mut seq = 0_u32;
    loop {
        ticker.next().await;
        cycles::keep_running();
        clocks::follow_debugger();
        if ALIVE.all() && !triggers::is_overdue(TRIGGER_OVERDUE) {
            watchdog.pet();
        }
        let status = status(seq, cycles::take(), thermometer.look());
        seq = seq.wrapping_add(1);
        state::send(DeviceToHost::Status(status));
    }
}

fn status(seq: u32, handlers: Handlers, measured: Measured) -> Status {
    let counters = tim2::counters();
    let mut dropped = state::with_outbox(|outbox| outbox.dropped());
    dropped.pulses = dropped.pulses.saturating_add(counters.lost_pulses);
    dropped.captures = dropped.captures.saturating_add(counters.lost_captures);
    let (lost, output_latency) = outputs::counters();
    dropped.outputs = dropped.outputs.saturating_add(lost);
    let now = tim2::now();
    let stack = stack::fullest(seq);
    let of_run = |(hello, resets): &(Hello, _)| (hello.epoch, *resets);
    let (epoch, resets) = INFO.try_get().map(of_run).unwrap_or_default();
    Status {
        seq,
        at: now,
        epoch,
        dropped,
        link: RECEIVED.lock(core::cell::Cell::get),
        connects: CONNECTS.load(Ordering::Relaxed),
        cpu_permille: idle::load_permille(),
        stack_used: stack.used,
        stack_size: stack.size,
        trigger: triggers::status(Output::Camera),
        trigger_latency: counters.latency,
        handlers,
        masked: masked::longest(),
        die_decidegrees: measured.decidegrees,
        supply_mv: measured.supply_mv,
        usb: usb::counters(),
        resets,
        strobe_overcaptures: counters.strobe_overcaptures,
        strobe_floods: counters.strobe_floods,
        imu: imu::status(),
        outputs: Output::AUXILIARY.map(triggers::summary),
        output_latency,
        gnss: gnss::status(),
    }
}
