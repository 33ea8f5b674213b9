//! Who may run beside whom.
//!
//! Sessions keep pace with the wall clock. Most of them, and what only computes, may
//! run beside each other; what is compared with that clock wants the whole machine.

use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

static TURN: RwLock<()> = RwLock::new(());

/// The whole machine, for as long as the guard lives.
pub(crate) fn alone() -> RwLockWriteGuard<'static, ()> {
    TURN.write().unwrap_or_else(PoisonError::into_inner)
}

/// A place beside the others, for as long as the guard lives.
pub(crate) fn beside_others() -> RwLockReadGuard<'static, ()> {
    TURN.read().unwrap_or_else(PoisonError::into_inner)
}
