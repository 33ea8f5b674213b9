//! Once a second: feeds the watchdog if every task is alive, and reports.

use core::sync::atomic::Ordering;

use embassy_stm32::peripherals::IWDG;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_time::{Duration, Ticker};
use firmware::config::TRIGGER_OVERDUE;
use protocol::Status;

use crate::board::tim2::{self, Counters};
use crate::board::{idle, outputs, stack};
use crate::state::{self, ALIVE, CONNECTS, INFO, RECEIVED};
use crate::tasks::{commands, gnss, imu};

#[embassy_executor::task]
pub(crate) async fn run(mut watchdog: IndependentWatchdog<'static, IWDG>) {
    let mut ticker = Ticker::every(Duration::from_secs(1));
    let mut seq = 0_u32;
    let mut busy = 0_u32;
    loop {
        ticker.next().await;
        let now = tim2::now();
        let stuck = tim2::with_pulser(|pulser, _, _| pulser.is_overdue(now, TRIGGER_OVERDUE));
        let stuck = stuck || outputs::is_overdue(TRIGGER_OVERDUE);
        if ALIVE.all() && !stuck {
            watchdog.pet();
        }
        let counters = tim2::counters();
        let busy_before = core::mem::replace(&mut busy, counters.busy);
        let status = status(seq, &counters, busy.wrapping_sub(busy_before));
        seq = seq.wrapping_add(1);
        state::send(|outbox| outbox.status(status));
    }
}

fn status(seq: u32, counters: &Counters, trigger_busy: u32) -> Status {
    let mut dropped = state::with_outbox(|outbox| outbox.dropped());
    dropped.pulses = dropped.pulses.saturating_add(counters.lost_pulses);
    dropped.captures = dropped.captures.saturating_add(counters.lost_captures);
    let (lost, output_latency) = outputs::counters();
    dropped.outputs = dropped.outputs.saturating_add(lost);
    let [_, two, three, four] = outputs::summaries();
    Status {
        seq,
        at: tim2::now(),
        epoch: INFO.try_get().map_or(0, |info| info.epoch),
        dropped,
        link: RECEIVED.lock(core::cell::Cell::get),
        connects: CONNECTS.load(Ordering::Relaxed),
        cpu_permille: idle::load_permille(),
        stack_used: stack::used(),
        stack_size: stack::size(),
        trigger: commands::trigger_status(),
        trigger_latency: counters.latency,
        trigger_busy,
        strobe_overcaptures: counters.strobe_overcaptures,
        strobe_floods: counters.strobe_floods,
        imu: imu::status(),
        outputs: [two, three, four],
        output_latency,
        gnss: gnss::status(),
    }
}
