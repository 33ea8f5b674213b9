//! What tasks and handlers share: messages on their way out, and what the board knows
//! of itself.

use core::cell::{Cell, RefCell};
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_sync::blocking_mutex::CriticalSectionMutex;
use embassy_sync::once_lock::OnceLock;
use embassy_sync::waitqueue::AtomicWaker;
use firmware::alive::Alive;
use firmware::boards::BOARD;
use firmware::outbox::Outbox;
use heapless::String;
use protocol::{Hello, LinkCounters, MAX_PANIC, PROTOCOL_VERSION, ResetCause, TICK_HZ, Ticks};

/// What does not change while the board runs.
#[derive(Debug)]
pub(crate) struct BoardInfo {
    pub(crate) board_id: [u8; 12],
    pub(crate) epoch: u32,
    pub(crate) reset_cause: ResetCause,
    pub(crate) resets: [u8; ResetCause::COUNT],
    pub(crate) last_panic: Option<String<MAX_PANIC>>,
    pub(crate) panics: u32,
    pub(crate) kept_panic: Option<String<MAX_PANIC>>,
}

/// Set once, by `main`, before any task runs.
pub(crate) static INFO: OnceLock<BoardInfo> = OnceLock::new();

pub(crate) static ALIVE: Alive = Alive::new();

static OUTBOX: CriticalSectionMutex<RefCell<Outbox>> =
    CriticalSectionMutex::new(RefCell::new(Outbox::new()));

/// Woken when there may be something to send.
pub(crate) static TO_SEND: AtomicWaker = AtomicWaker::new();

/// Woken when something was sent: there may be room for answers again.
pub(crate) static ROOM: AtomicWaker = AtomicWaker::new();

/// Woken when a host has come or gone.
pub(crate) static LINK_CHANGED: AtomicWaker = AtomicWaker::new();

/// What came in from the host.
pub(crate) static RECEIVED: CriticalSectionMutex<Cell<LinkCounters>> =
    CriticalSectionMutex::new(Cell::new(LinkCounters {
        frames: 0,
        oversize: 0,
        cobs: 0,
        checksum: 0,
        message: 0,
        lost_bytes: 0,
    }));

/// Filler that the host asked for, in bytes a second.
pub(crate) static FILLER_RATE: AtomicU32 = AtomicU32::new(0);

/// How often a host has connected.
pub(crate) static CONNECTS: AtomicU32 = AtomicU32::new(0);

/// Unix time of tick 0, as the pulse per second was last started with. Its last pulse
/// may come after a stop.
pub(crate) static UTC_AT_ZERO: CriticalSectionMutex<Cell<i64>> =
    CriticalSectionMutex::new(Cell::new(0));

/// Works on the outbox, in a critical section, without waking the sender.
pub(crate) fn with_outbox<R>(work: impl FnOnce(&mut Outbox) -> R) -> R {
    OUTBOX.lock(|outbox| work(&mut outbox.borrow_mut()))
}

/// Works on the outbox and wakes the sender.
pub(crate) fn send(work: impl FnOnce(&mut Outbox)) {
    with_outbox(work);
    TO_SEND.wake();
}

/// A host has come or gone, now.
pub(crate) fn set_linked(linked: bool, now: Ticks) {
    if linked {
        CONNECTS.fetch_add(1, Ordering::Relaxed);
        FILLER_RATE.store(0, Ordering::Relaxed);
    }
    let hello = linked.then(|| hello(now));
    send(|outbox| {
        outbox.set_linked(linked);
        if let Some(hello) = hello {
            outbox.hello(hello);
        }
    });
    ROOM.wake();
    LINK_CHANGED.wake();
}

/// Who the board is, now.
pub(crate) fn hello(now: Ticks) -> Hello {
    let info = INFO.try_get();
    Hello {
        protocol_version: PROTOCOL_VERSION,
        firmware_version: (
            number(env!("CARGO_PKG_VERSION_MAJOR")),
            number(env!("CARGO_PKG_VERSION_MINOR")),
            number(env!("CARGO_PKG_VERSION_PATCH")),
        ),
        git_revision: String::try_from(env!("GIT_REVISION")).unwrap_or_default(),
        git_dirty: env!("GIT_DIRTY").as_bytes() == b"1",
        board_id: info.map_or([0; 12], |info| info.board_id),
        tick_hz: TICK_HZ,
        now,
        epoch: info.map_or(0, |info| info.epoch),
        reset_cause: info.map_or(ResetCause::Unknown, |info| info.reset_cause),
        last_panic: info.and_then(|info| info.last_panic.clone()),
        board: BOARD.model,
        panics: info.map_or(0, |info| info.panics),
        kept_panic: info.and_then(|info| info.kept_panic.clone()),
    }
}

/// A decimal number; digits that do not fit wrap.
const fn number(digits: &str) -> u8 {
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
