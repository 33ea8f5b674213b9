//! Once a second: feeds the watchdog if every task is alive, and reports.

use core::sync::atomic::Ordering;

use embassy_stm32::peripherals::IWDG;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_time::{Duration, Ticker};
use protocol::Status;

use crate::board::{idle, stack, tim2};
use crate::state::{self, ALIVE, CONNECTS, INFO, RECEIVED};

/// Runs for ever.
#[embassy_executor::task]
pub(crate) async fn run(mut watchdog: IndependentWatchdog<'static, IWDG>) {
    watchdog.unleash();
    let mut ticker = Ticker::every(Duration::from_secs(1));
    let mut seq = 0_u32;
    loop {
        ticker.next().await;
        if ALIVE.all() {
            watchdog.pet();
        }
        let status = status(seq);
        seq = seq.wrapping_add(1);
        state::send(|outbox| outbox.status(status));
    }
}

fn status(seq: u32) -> Status {
    Status {
        seq,
        at: tim2::now(),
        epoch: INFO.try_get().map_or(0, |info| info.epoch),
        dropped: state::with_outbox(|outbox| outbox.dropped()),
        link: RECEIVED.lock(core::cell::Cell::get),
        connects: CONNECTS.load(Ordering::Relaxed),
        cpu_permille: idle::load_permille(),
        stack_used: stack::used(),
        stack_size: stack::size(),
        trigger: crate::tasks::commands::tmp_trigger(),
        trigger_latency: 0,
        trigger_busy: 0,
        strobe_overcaptures: 0,
        strobe_floods: 0,
        imu: crate::tasks::commands::tmp_imu(),
    }
}
