//! State that tasks and handlers share: messages on their way out, and facts about the board.

use core::cell::{Cell, RefCell};
use core::future::poll_fn;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use core::task::Poll;

use embassy_sync::blocking_mutex::CriticalSectionMutex;
use embassy_sync::once_lock::OnceLock;
use embassy_sync::waitqueue::AtomicWaker;
use embassy_time::{Duration, with_timeout};
use firmware::alive::Alive;
use firmware::config::CHECK_IN_MS;
use firmware::outbox::Outbox;
use protocol::{DeviceToHost, Hello, LinkCounters, ResetCause, Ticks};

/// Who the board is, but for the time, and its resets since power came on, by cause. Set once, by
/// `main`, before any task runs.
pub(crate) static INFO: OnceLock<(Hello, [u8; ResetCause::COUNT])> = OnceLock::new();

pub(crate) static ALIVE: Alive = Alive::new();

/// Interval at which a waiting task checks in.
pub(crate) const CHECK_IN: Duration = Duration::from_millis(CHECK_IN_MS);

static OUTBOX: CriticalSectionMutex<RefCell<Outbox>> =
    CriticalSectionMutex::new(RefCell::new(Outbox::new()));

/// Woken when there may be something to send.
pub(crate) static TO_SEND: AtomicWaker = AtomicWaker::new();

/// Woken when something was sent: there may be room for answers again.
pub(crate) static ROOM: AtomicWaker = AtomicWaker::new();

/// Woken when a host has come or gone.
pub(crate) static LINK_CHANGED: AtomicWaker = AtomicWaker::new();

/// Counts of frames received from the host.
pub(crate) static RECEIVED: CriticalSectionMutex<Cell<LinkCounters>> =
    CriticalSectionMutex::new(Cell::new(LinkCounters::ZERO));

/// True if the host asked for filler.
pub(crate) static FILLER: AtomicBool = AtomicBool::new(false);

/// Number of times that a host has connected.
pub(crate) static CONNECTS: AtomicU32 = AtomicU32::new(0);

/// Unix time of tick 0, as the pulse per second was last started with. Its last pulse
/// may come after a stop.
pub(crate) static UTC_AT_ZERO: CriticalSectionMutex<Cell<i64>> =
    CriticalSectionMutex::new(Cell::new(0));

/// Works on the outbox, in a critical section, without waking the sender.
pub(crate) fn with_outbox<R>(work: impl FnOnce(&mut Outbox) -> R) -> R {
    OUTBOX.lock(|outbox| work(&mut outbox.borrow_mut()))
}

/// Waits until `is_so` holds of the outbox, or until it is time to check in. `waker` is woken
/// when that may have changed.
pub(crate) async fn wait_for(waker: &AtomicWaker, is_ready: impl Fn(&Outbox) -> bool) {
    let wait = poll_fn(|context| {
        waker.register(context.waker());
        if with_outbox(|outbox| is_ready(outbox)) {
            Poll::Ready(())
        } else {
            Poll::Pending
        }
    });
    let _ = with_timeout(CHECK_IN, wait).await;
}

/// Queues a message and wakes the sender. Inlined as [`Outbox::send`] is.
#[inline(always)]
pub(crate) fn send(message: DeviceToHost) {
    with_outbox(|outbox| outbox.send(message));
    TO_SEND.wake();
}

/// A host has come or gone, now.
pub(crate) fn set_linked(linked: bool, now: Ticks) {
    if linked {
        CONNECTS.fetch_add(1, Ordering::Relaxed);
        FILLER.store(false, Ordering::Relaxed);
    }
    let hello = linked.then(|| hello(now));
    with_outbox(|outbox| {
        outbox.set_linked(linked);
        if let Some(hello) = hello {
            outbox.send(DeviceToHost::Hello(hello));
        }
    });
    TO_SEND.wake();
    ROOM.wake();
    LINK_CHANGED.wake();
}

/// Who the board is, now.
pub(crate) fn hello(now: Ticks) -> Hello {
    let (hello, _) = INFO.try_get().cloned().unwrap_or_default();
    Hello { now, ..hello }
}
