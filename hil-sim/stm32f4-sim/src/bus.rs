//! The core's side of the chip.

use crate::chip::memory::Memory;

/// Connections of the core.
pub(crate) trait Bus {
    /// Flash and RAM.
    fn memory(&mut self) -> &mut Memory;
    /// Reads a peripheral at the given core cycle; `None` if there is no such peripheral.
    fn io_read(&mut self, addr: u32, bytes: u32, cycle: u64) -> Option<u32>;
    /// Writes a peripheral at the given core cycle; false if there is no such peripheral.
    fn io_write(&mut self, addr: u32, bytes: u32, value: u32, cycle: u64) -> bool;
    /// Cycles that an access to a peripheral takes beyond those of one to memory.
    fn io_waits(&self, addr: u32) -> u64;
    /// Cycles that a line of the flash takes.
    fn flash_waits(&self) -> u64;
    /// Core cycle at which the interpreter has to stop; it may move with every access.
    fn limit(&self) -> u64;
}
