//! Which tasks have checked in since the watchdog was last fed.
//!
//! Each task sets its bit at least once a second; the status task feeds the
//! watchdog only when all bits are set, and clears them. A task that waits for
//! the host or for a sensor wakes up now and then to check in, so waiting is
//! never mistaken for hanging.

use core::sync::atomic::{AtomicU32, Ordering};

/// The tasks that are watched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Task {
    /// Reads commands.
    Receive,
    /// Writes messages.
    Transmit,
    /// Samples the IMU.
    Imu,
    /// Sends the sentences of the pulse per second.
    Gnss,
}

/// All of [`Task`].
const ALL: u32 = (1 << Task::Receive as u8)
    | (1 << Task::Transmit as u8)
    | (1 << Task::Imu as u8)
    | (1 << Task::Gnss as u8);

/// The bits.
#[derive(Debug, Default)]
pub struct Alive(AtomicU32);

impl Alive {
    /// No task has checked in.
    #[must_use]
    pub const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// `task` is alive.
    pub fn check_in(&self, task: Task) {
        self.0.fetch_or(1 << task as u8, Ordering::Relaxed);
    }

    /// Returns true if all tasks have checked in since the last call that returned true.
    pub fn all(&self) -> bool {
        self.0
            .compare_exchange(ALL, 0, Ordering::Relaxed, Ordering::Relaxed)
            .is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_silent_task_is_enough_to_starve_the_watchdog() {
        let alive = Alive::new();
        for _ in 0..10 {
            alive.check_in(Task::Receive);
            alive.check_in(Task::Imu);
            alive.check_in(Task::Gnss);
            assert!(!alive.all());
        }
        alive.check_in(Task::Transmit);
        assert!(alive.all());
        assert!(!alive.all());
    }
}
