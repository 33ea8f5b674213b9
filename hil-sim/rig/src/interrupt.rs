//! Signals that end a program of the rig.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Result};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// Becomes true when the program is asked to end: Ctrl-C, a closed terminal, `kill`.
pub(crate) fn watch() -> Result<Arc<AtomicBool>> {
    let stopped = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&stopped))
            .context("cannot watch for Ctrl-C")?;
    }
    Ok(stopped)
}
