//! The rig's true time as it passes, shared between its threads.
//!
//! The thread that drives the rig [publishes](TrueClock::publish) true time; others
//! read it or wait for a time. True time passes as fast as the rig
//! is run: faster than real time, slower, or in step with it.
//!
//! Publishing costs an atomic store and a load while nobody waits for the time
//! that has come, so it can be done at every step of the board. A waiter is
//! woken at the first published time that is not before the one it waits for:
//! what it then does by itself happens that much later, never earlier.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use crate::clocks::oscillator::{BoardTime, TrueTime};
use stm32f4_sim::model::{PinIo, PinModel};
use stm32f4_sim::pin::Pin;
use stm32f4_sim::shared::lock;
use stm32f4_sim::time::{SimDuration, SimTime};

/// True time has ended: the rig was stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the simulated rig was stopped")]
pub struct RigStopped;

#[derive(Debug, Default)]
struct Shared {
    now: AtomicU64,
    /// The earliest time that anybody waits for; `u64::MAX` for nobody.
    next: AtomicU64,
    waiting: Mutex<Waiting>,
    woken: Condvar,
}

#[derive(Debug, Default)]
struct Waiting {
    times: Vec<u64>,
    stopped: bool,
}

impl Shared {
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        lock(&self.waiting)
    }

    fn note_next(&self, waiting: &Waiting) {
        let next = waiting.times.iter().copied().min().unwrap_or(u64::MAX);
        self.next.store(next, Ordering::SeqCst);
    }
}

/// A handle to the rig's true time. Clones share it.
#[derive(Debug, Clone)]
pub struct TrueClock(Arc<Shared>);

impl Default for TrueClock {
    fn default() -> Self {
        Self::new()
    }
}

impl TrueClock {
    /// A clock at power-on of the rig.
    #[must_use]
    pub fn new() -> Self {
        let shared = Shared::default();
        shared.next.store(u64::MAX, Ordering::SeqCst);
        Self(Arc::new(shared))
    }

    /// Says that true time has come to `now`. Earlier times than before are ignored.
    pub fn publish(&self, now: TrueTime) {
        self.0.now.fetch_max(now.units(), Ordering::SeqCst);
        if self.0.next.load(Ordering::SeqCst) <= now.units() {
            let mut waiting = self.0.waiting();
            waiting.times.retain(|&t| t > now.units());
            self.0.note_next(&waiting);
            self.0.woken.notify_all();
        }
    }

    /// True time now.
    #[must_use]
    pub fn now(&self) -> TrueTime {
        TrueTime::from_units(self.0.now.load(Ordering::SeqCst))
    }

    /// Waits until true time has come to `until`.
    ///
    /// # Errors
    ///
    /// The rig was stopped.
    pub fn wait_until(&self, until: TrueTime) -> Result<(), RigStopped> {
        self.wait_unless(until, &AtomicBool::new(false))
    }

    /// Waits until true time has come to `until`, or `cancelled` is set and the
    /// clock is [woken](TrueClock::wake).
    ///
    /// # Errors
    ///
    /// The rig was stopped, or the wait cancelled.
    pub(crate) fn wait_unless(
        &self,
        until: TrueTime,
        cancelled: &AtomicBool,
    ) -> Result<(), RigStopped> {
        let mut waiting = self.0.waiting();
        waiting.times.push(until.units());
        self.0.note_next(&waiting);
        loop {
            // Looked at after the time was noted, so that a publisher either
            // sees the note or is seen here.
            let reached = self.now() >= until;
            if reached || waiting.stopped || cancelled.load(Ordering::SeqCst) {
                if let Some(at) = waiting.times.iter().position(|&t| t == until.units()) {
                    waiting.times.swap_remove(at);
                }
                self.0.note_next(&waiting);
                return if reached { Ok(()) } else { Err(RigStopped) };
            }
            waiting = self
                .0
                .woken
                .wait(waiting)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Number of waiters for a time that has not come.
    #[must_use]
    pub fn waiters(&self) -> usize {
        self.0.waiting().times.len()
    }

    /// Wakes all waiters, so that those that were cancelled return.
    pub(crate) fn wake(&self) {
        // Taken and given back, so that nobody is between looking and waiting.
        drop(self.0.waiting());
        self.0.woken.notify_all();
    }

    /// Ends true time: everyone who waits, now or later, is woken.
    pub fn stop(&self) {
        self.0.waiting().stopped = true;
        self.0.woken.notify_all();
    }

    /// True if the rig was stopped.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.0.waiting().stopped
    }
}

/// Publishes true time from within the board's run: a part that is wired to
/// nothing and looks at the clock every [`BoardClockwork::STEP`].
#[derive(Debug)]
pub struct BoardClockwork {
    board: BoardTime,
    clock: TrueClock,
    next: SimTime,
}

impl BoardClockwork {
    /// Interval at which true time is published, in board time.
    pub const STEP: SimDuration = SimDuration::from_micros(500);

    /// Publishes to `clock` how far the rig of `board` has come.
    #[must_use]
    pub fn new(board: BoardTime, clock: TrueClock) -> Self {
        Self {
            board,
            clock,
            next: SimTime::ZERO,
        }
    }
}

impl PinModel for BoardClockwork {
    fn name(&self) -> String {
        "true time".to_owned()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        Vec::new()
    }

    fn next_event(&self) -> Option<SimTime> {
        Some(self.next)
    }

    fn advance(&mut self, io: &mut PinIo<'_>) {
        self.clock.publish(self.board.true_at(io.now()));
        self.next = io.now() + Self::STEP;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waiters_are_woken_at_their_time_and_not_before() {
        let clock = TrueClock::new();
        let waiters: Vec<_> = [3u64, 1, 2, 2]
            .into_iter()
            .map(|seconds| {
                let clock = clock.clone();
                std::thread::spawn(move || {
                    let until = TrueTime::from_nanos(seconds * 1_000_000_000);
                    clock.wait_until(until).unwrap();
                    assert!(clock.now() >= until);
                })
            })
            .collect();
        for ms in 0..=3000 {
            clock.publish(TrueTime::from_nanos(ms * 1_000_000));
            if ms % 100 == 0 {
                std::thread::yield_now();
            }
        }
        for waiter in waiters {
            waiter.join().unwrap();
        }
    }

    #[test]
    fn stopping_wakes_everyone() {
        let clock = TrueClock::new();
        let waiter = {
            let clock = clock.clone();
            std::thread::spawn(move || clock.wait_until(TrueTime::NEVER))
        };
        clock.stop();
        assert_eq!(waiter.join().unwrap(), Err(RigStopped));
        assert_eq!(clock.wait_until(TrueTime::from_nanos(1)), Err(RigStopped));
        assert_eq!(clock.wait_until(TrueTime::ZERO), Ok(()));
    }

    #[test]
    fn time_does_not_go_back() {
        let clock = TrueClock::new();
        clock.publish(TrueTime::from_nanos(10));
        clock.publish(TrueTime::from_nanos(5));
        assert_eq!(clock.now(), TrueTime::from_nanos(10));
    }
}
