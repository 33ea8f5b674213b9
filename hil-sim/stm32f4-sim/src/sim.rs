//! A board with its firmware, its USB host and what is wired to it, run on virtual
//! time.
//!
//! A failure of the firmware (panic, HardFault, lock-up, a reset that nobody
//! asked for) ends the run with its log, its message and a symbolised
//! backtrace, unless the simulation lets it happen. The touch of a
//! register that is not modelled, or a use of the chip that its manuals forbid, ends it
//! always. The same seed and the same calls
//! give the same run, to the byte.

mod builder;
mod failure;
mod outside;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

pub use builder::{INPUT_SYNCHRONISER, SimBuilder};
pub use failure::{Failure, FailureKind, SimError};

use crate::backtrace;
pub use crate::chip::adc::Die;
pub use crate::chip::part::Part;
pub use crate::chip::rcc::ResetCause;
use crate::chip::{self, Soc};
pub use crate::chip::{ChipConfig, Revision};
use crate::clock::Rate;
use crate::cpu::{Cpu, CpuStats, Event};
use crate::firmware::Firmware;
use crate::random::Random;
use crate::rtt::{LogLine, Rtt, Words};
use crate::shared::lock;
use crate::time::{SimDuration, SimTime};

/// Longest stretch of cycles between two looks at the log.
const SLICE: u64 = 5_000;
/// Interval at which [`Sim::run_until`] asks its predicate.
const PREDICATE_STEP: SimDuration = SimDuration::from_millis(1);

/// Receiver of each line of the firmware's log.
type LogSink = Box<dyn FnMut(&LogLine) + Send>;

/// The registers that are stored and read back without being modelled, with why that
/// suffices. A register that is neither modelled nor among these ends the run when it
/// is touched.
pub fn stored_registers() -> impl Iterator<Item = (&'static str, &'static str)> {
    chip::cells::stored_registers()
}

/// A timer of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Timer {
    /// 16 bits, with break and complementary outputs on silicon.
    Tim1,
    /// 32 bits.
    Tim2,
    /// 16 bits.
    Tim3,
    /// 16 bits.
    Tim4,
    /// 32 bits.
    Tim5,
}

impl Timer {
    fn index(self) -> usize {
        match self {
            Self::Tim1 => chip::TIM1,
            Self::Tim2 => chip::TIM2,
            Self::Tim3 => chip::TIM3,
            Self::Tim4 => chip::TIM4,
            Self::Tim5 => chip::TIM5,
        }
    }
}

/// A running board.
pub struct Sim {
    soc: Arc<Mutex<Soc>>,
    cpu: Cpu,
    firmware: Firmware,
    rtt: Rtt,
    log: Vec<LogLine>,
    on_log: Option<LogSink>,
    tolerate_failures: bool,
    failures: Vec<Failure>,
    /// A failure that the firmware may still log something about, and until when.
    failing: Option<(Failure, SimTime)>,
    panic_at: Option<u32>,
    random: Random,
}

impl core::fmt::Debug for Sim {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Sim({:?} at {})", self.firmware, self.now())
    }
}

impl Words for Soc {
    #[inline]
    fn word(&self, addr: u32) -> Option<u32> {
        self.mem.read32(addr)
    }
    fn set_word(&mut self, addr: u32, value: u32) {
        self.mem.write32(addr, value);
    }
    fn bytes(&self, addr: u32, len: usize) -> Option<&[u8]> {
        self.mem.bytes(addr, len)
    }
}

impl Sim {
    /// The chip with the firmware of an ELF file, and nothing wired to it: no crystal,
    /// no I2C bus, no parts; the USB cable is in.
    #[must_use]
    pub fn builder(elf: impl Into<PathBuf>) -> SimBuilder {
        SimBuilder::new(elf.into())
    }

    // ---- time ---------------------------------------------------------------

    /// Virtual time since power-on.
    #[must_use]
    pub fn now(&self) -> SimTime {
        lock(&self.soc).now()
    }

    /// Runs for a length of virtual time.
    ///
    /// # Errors
    ///
    /// If the firmware fails and that is not tolerated.
    pub fn run_for(&mut self, length: SimDuration) -> Result<(), SimError> {
        let end = self.now() + length;
        self.run_to(end)
    }

    /// Runs until `done` says so, asking it every virtual millisecond, for at
    /// most `limit`. Returns whether it did.
    ///
    /// # Errors
    ///
    /// If the firmware fails and that is not tolerated.
    pub fn run_until(
        &mut self,
        limit: SimDuration,
        mut done: impl FnMut(&mut Sim) -> bool,
    ) -> Result<bool, SimError> {
        let end = self.now() + limit;
        while !done(self) {
            let now = self.now();
            if now >= end {
                return Ok(false);
            }
            self.run_to((now + PREDICATE_STEP).min(end))?;
        }
        Ok(true)
    }

    /// Runs to a point in virtual time.
    ///
    /// # Errors
    ///
    /// If the firmware fails and that is not tolerated.
    pub fn run_to(&mut self, end: SimTime) -> Result<(), SimError> {
        loop {
            let (sleep_to, had_log) = {
                let mut soc = lock(&self.soc);
                soc.at_cycle(self.cpu.cycles);
                if let Some(end) = soc.end.take() {
                    drop(soc);
                    return self.end(&end);
                }
                if let Some(cause) = soc.reset_request.take() {
                    drop(soc);
                    self.firmware_reset(cause)?;
                    continue;
                }
                let now = soc.now();
                if now >= end {
                    return Ok(());
                }
                let last = soc.cycle_at(end.min(soc.due()));
                if self.cpu.asleep && !soc.attention {
                    (Some(last), false)
                } else {
                    soc.set_slice_end(last.min(self.cpu.cycles + SLICE));
                    (None, self.rtt.has_data(&*soc))
                }
            };
            if let Some(cycle) = sleep_to {
                self.cpu.sleep_until(cycle);
                continue;
            }
            if had_log {
                self.poll_log();
            }
            let event = self.cpu.run();
            self.after_run(event)?;
        }
    }

    fn after_run(&mut self, event: Event) -> Result<(), SimError> {
        if self.cpu.asleep || event != Event::None {
            self.poll_log();
        }
        if let Some((_, until)) = &self.failing
            && self.now() >= *until
        {
            return self.fail_now();
        }
        match event {
            Event::None | Event::Rom => Ok(()),
            Event::Breakpoint(at) => {
                if Some(at) == self.panic_at {
                    self.begin_failure(FailureKind::Panic);
                }
                Ok(())
            }
            Event::HardFault => {
                self.begin_failure(FailureKind::HardFault);
                Ok(())
            }
            Event::LockUp => {
                self.begin_failure(FailureKind::LockUp);
                self.fail_now()
            }
            Event::ResetRequest => self.firmware_reset(ResetCause::Software),
        }
    }

    // ---- resets ----------------------------------------------------------------

    fn reset(&mut self, cause: ResetCause) {
        {
            let mut soc = lock(&self.soc);
            soc.at_cycle(self.cpu.cycles);
            soc.reset_request = None;
            if cause == ResetCause::PowerOn {
                soc.fill_ram(&mut self.random);
            }
            soc.reset(cause);
        }
        self.cpu.reset();
        self.rtt.restart();
    }

    /// Failures that were tolerated, and the one that ended the run.
    #[must_use]
    pub fn failures(&self) -> &[Failure] {
        &self.failures
    }

    /// Presses the board's reset button.
    pub fn press_reset(&mut self) {
        self.reset(ResetCause::Pin);
    }

    /// True while the core is in the ROM's bootloader. That program is not modelled: it stays
    /// there, off the USB, until [`Sim::leave_rom`] or a reset.
    #[must_use]
    pub fn is_in_rom(&self) -> bool {
        self.cpu.is_in_rom()
    }

    /// Has the bootloader start the program, as it does after a download. ST publishes neither its
    /// program nor what it leaves: that is drawn from all that it may use.
    pub fn leave_rom(&mut self) {
        self.cpu.reset();
        lock(&self.soc).leave_as_rom();
        self.cpu.start_by_rom(&mut self.random);
        self.rtt.restart();
    }

    /// Switches the board's power off and on.
    pub fn power_cycle(&mut self) {
        self.reset(ResetCause::PowerOn);
    }

    /// Lets the supply dip.
    pub fn brown_out(&mut self) {
        self.reset(ResetCause::BrownOut);
    }

    // ---- the log -----------------------------------------------------------------

    fn poll_log(&mut self) {
        let from = self.log.len();
        {
            let mut soc = lock(&self.soc);
            let now = soc.now();
            self.rtt.poll(&mut *soc, now, &mut self.log);
        }
        if let Some(sink) = &mut self.on_log {
            for line in self.log.iter().skip(from) {
                sink(line);
            }
        }
    }

    /// The firmware's log so far.
    #[must_use]
    pub fn log(&self) -> &[LogLine] {
        &self.log
    }

    fn with_chip<T>(&self, f: impl FnOnce(&mut Soc) -> T) -> T {
        let mut soc = lock(&self.soc);
        f(&mut soc)
    }

    // ---- the core ------------------------------------------------------------------------

    /// Use that the core made of its time.
    pub const fn cpu_stats(&self) -> CpuStats {
        self.cpu.stats()
    }

    /// The main stack pointer, while tasks run on the other.
    #[must_use]
    pub fn handler_stack(&self) -> u32 {
        self.cpu.main_stack()
    }

    /// Present rate of the core clock.
    #[must_use]
    pub fn core_rate(&self) -> Rate {
        self.with_chip(|s| s.core_rate())
    }

    /// The time of the last edge of the clock that a timer counts, and its counter as
    /// the firmware would read it now. Of a timer without a prescaler this one pair
    /// gives the tick at which its hardware latches any other time.
    #[must_use]
    pub fn timer(&self, timer: Timer) -> (SimTime, u32) {
        self.with_chip(|s| s.timer(timer.index()))
    }

    /// The firmware's image and symbols.
    #[must_use]
    pub fn firmware(&self) -> &Firmware {
        &self.firmware
    }

    /// Reads RAM or flash.
    #[must_use]
    pub fn peek(&self, address: u32, len: usize) -> Option<Vec<u8>> {
        self.with_chip(|s| s.peek(address, len))
    }

    /// The core's call stack as it is now.
    #[must_use]
    pub fn backtrace(&self) -> Vec<String> {
        let (regs, _) = self.cpu.registers();
        let soc = lock(&self.soc);
        let psp = self.cpu.process_stack();
        let stack = backtrace::unwind(&self.firmware, regs, psp, |a| soc.mem.read32(a));
        drop(soc);
        backtrace::describe(&self.firmware, &stack)
    }

    /// Path of the firmware's ELF.
    #[must_use]
    pub fn elf(&self) -> &Path {
        self.firmware.path()
    }
}
