//! The rig: a board with its firmware, its USB host and what is wired to it,
//! run on virtual time.
//!
//! A failure of the firmware (panic, HardFault, lock-up, a reset that nobody
//! asked for) ends the run with its log, its message and a symbolised
//! backtrace, unless the rig was told to let it happen. The same seed and the
//! same calls give the same run, to the byte.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use crate::backtrace;
use crate::chip::Soc;
pub use crate::chip::rcc::ResetCause;
use crate::clock::Rate;
use crate::cpu::{Cpu, CpuStats, Event, lock};
use crate::firmware::{Firmware, FirmwareError, Symbol, default_elf};
use crate::i2c::I2cTarget;
use crate::model::RigModel;
use crate::pin::{Drive, Level, Pin};
use crate::random::{RAM_STREAM, Random, Seed};
use crate::rtt::{LogLevel, LogLine, Rtt, Words};
use crate::time::{SimDuration, SimTime};
use crate::usb::{DeviceInfo, UsbState, UsbTraffic};

/// Longest stretch of cycles between two looks at the log.
const SLICE: u64 = 5_000;
/// How often [`Rig::run_until`] asks its predicate.
const PREDICATE_STEP: SimDuration = SimDuration::from_millis(1);
/// Time given to a firmware that panicked, to log its message and reset.
const LAST_WORDS: SimDuration = SimDuration::from_millis(500);
/// The low-speed oscillator's typical rate (DS8626 table 42).
const LSI_HZ: u64 = 32_000;

/// How the firmware failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FailureKind {
    /// It panicked.
    Panic,
    /// It took a HardFault.
    HardFault,
    /// It locked up: a fault within the fault handler.
    LockUp,
    /// It was reset, and not by the rig.
    Reset(ResetCause),
}

/// A failure of the firmware.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// How it failed.
    pub kind: FailureKind,
    /// When, in virtual time.
    pub at: SimTime,
    /// The last lines of its log.
    pub log: Vec<String>,
    /// Its call stack, innermost first.
    pub backtrace: Vec<String>,
    /// Fault registers, if it was a fault.
    pub detail: String,
}

impl core::fmt::Display for Failure {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let what = match self.kind {
            FailureKind::Panic => "the firmware panicked".to_owned(),
            FailureKind::HardFault => "the firmware took a HardFault".to_owned(),
            FailureKind::LockUp => "the firmware locked up".to_owned(),
            FailureKind::Reset(cause) => format!("the firmware was reset ({cause:?})"),
        };
        writeln!(f, "{what} at {} s of virtual time", self.at)?;
        if !self.detail.is_empty() {
            writeln!(f, "{}", self.detail)?;
        }
        if !self.log.is_empty() {
            writeln!(f, "its last log lines:")?;
            for line in &self.log {
                writeln!(f, "  {line}")?;
            }
        }
        if !self.backtrace.is_empty() {
            writeln!(f, "its call stack:")?;
            for line in &self.backtrace {
                writeln!(f, "  {line}")?;
            }
        }
        Ok(())
    }
}

/// Why a run ended early.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The ELF cannot be used.
    #[error(transparent)]
    Firmware(#[from] FirmwareError),
    /// The board cannot be set up.
    #[error("the simulated board cannot be set up: {0}")]
    Setup(String),
    /// The firmware failed.
    #[error("{0}")]
    Failed(Box<Failure>),
}

/// What the rig does with each line of the firmware's log.
type LogSink = Box<dyn FnMut(&LogLine) + Send>;

/// Puts a [`Rig`] together.
pub struct RigBuilder {
    elf: Option<PathBuf>,
    seed: Seed,
    plugged: bool,
    tolerate_failures: bool,
    lsi: Rate,
    uid: [u32; 3],
    models: Vec<Box<dyn RigModel>>,
    targets: Vec<Box<dyn I2cTarget>>,
    on_log: Option<LogSink>,
}

impl core::fmt::Debug for RigBuilder {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "RigBuilder({:?}, seed {:?})", self.elf, self.seed)
    }
}

impl Default for RigBuilder {
    fn default() -> Self {
        Self {
            elf: None,
            seed: Seed(1),
            plugged: true,
            tolerate_failures: false,
            lsi: Rate::hz(LSI_HZ),
            uid: [0x0041_0028, 0x3231_470a, 0x3039_3137],
            models: Vec::new(),
            targets: Vec::new(),
            on_log: None,
        }
    }
}

impl RigBuilder {
    /// The firmware's ELF; without this, [`default_elf`].
    #[must_use]
    pub fn elf(mut self, path: impl Into<PathBuf>) -> Self {
        self.elf = Some(path.into());
        self
    }

    /// The one seed of all randomness.
    #[must_use]
    pub fn seed(mut self, seed: Seed) -> Self {
        self.seed = seed;
        self
    }

    /// Whether the USB cable is in at power-on. It is by default.
    #[must_use]
    pub fn plugged(mut self, plugged: bool) -> Self {
        self.plugged = plugged;
        self
    }

    /// Lets the firmware fail and go on: failures and resets are listed by
    /// [`Rig::failures`] instead of ending the run.
    #[must_use]
    pub fn tolerate_failures(mut self) -> Self {
        self.tolerate_failures = true;
        self
    }

    /// Rate of the low-speed oscillator (17 to 47 kHz; 32 kHz typical).
    #[must_use]
    pub fn low_speed_oscillator(mut self, rate: Rate) -> Self {
        self.lsi = rate;
        self
    }

    /// The chip's unique 96-bit ID, as three words.
    #[must_use]
    pub fn unique_id(mut self, uid: [u32; 3]) -> Self {
        self.uid = uid;
        self
    }

    /// Wires a model to the board's pins.
    #[must_use]
    pub fn model(mut self, model: impl RigModel + 'static) -> Self {
        self.models.push(Box::new(model));
        self
    }

    /// Wires a device to the I2C bus.
    #[must_use]
    pub fn i2c_target(mut self, target: impl I2cTarget + 'static) -> Self {
        self.targets.push(Box::new(target));
        self
    }

    /// Calls `sink` with each line of the firmware's log as it appears.
    #[must_use]
    pub fn on_log(mut self, sink: impl FnMut(&LogLine) + Send + 'static) -> Self {
        self.on_log = Some(Box::new(sink));
        self
    }

    /// Powers the board on.
    ///
    /// # Errors
    ///
    /// If the ELF cannot be used.
    pub fn build(self) -> Result<Rig, RigError> {
        let path = self.elf.unwrap_or_else(default_elf);
        let firmware = Firmware::load(&path)?;
        let mut soc = Soc::new(self.seed, self.lsi, self.uid);
        let mut random = self.seed.stream(RAM_STREAM);
        soc.fill_ram(&mut random);
        for (at, data) in firmware.segments() {
            let offset = at.wrapping_sub(0x0800_0000) as usize;
            match soc.mem.flash.get_mut(offset..offset + data.len()) {
                Some(to) => to.copy_from_slice(data),
                None => {
                    return Err(RigError::Setup(format!(
                        "a segment of {} bytes at {at:#010x} does not fit the flash",
                        data.len()
                    )));
                }
            }
        }
        for target in self.targets {
            soc.i2c_bus.add(target);
        }
        for model in self.models {
            soc.add_model(model);
        }
        if self.plugged {
            soc.plug();
        }
        let code_bytes = firmware.flash_size();
        let soc = Arc::new(Mutex::new(soc));
        let mut cpu = Cpu::new(Arc::clone(&soc), code_bytes).map_err(RigError::Setup)?;
        let mut panic_at = None;
        for name in ["rust_begin_unwind", "__rustc::rust_begin_unwind"] {
            let found = firmware
                .symbol(name)
                .or_else(|| firmware.find_symbol(name))
                .map(|s| s.address);
            if let Some(address) = found {
                cpu.add_breakpoint(address);
                panic_at = Some(address);
                break;
            }
        }
        let rtt = Rtt::new(&firmware);
        Ok(Rig {
            soc,
            cpu,
            firmware,
            rtt,
            log: Vec::new(),
            on_log: self.on_log,
            tolerate_failures: self.tolerate_failures,
            failures: Vec::new(),
            failing: None,
            panic_at,
            random,
        })
    }
}

/// A running board.
pub struct Rig {
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

impl core::fmt::Debug for Rig {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Rig({:?} at {})", self.firmware, self.now())
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

impl Rig {
    /// A rig with the default firmware and nothing wired to it.
    #[must_use]
    pub fn builder() -> RigBuilder {
        RigBuilder::default()
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
    /// If the firmware fails and the rig does not tolerate that.
    pub fn run_for(&mut self, length: SimDuration) -> Result<(), RigError> {
        let end = self.now() + length;
        self.run_to(end)
    }

    /// Runs until `done` says so, asking it every virtual millisecond, for at
    /// most `limit`. Returns whether it did.
    ///
    /// # Errors
    ///
    /// If the firmware fails and the rig does not tolerate that.
    pub fn run_until(
        &mut self,
        limit: SimDuration,
        mut done: impl FnMut(&mut Rig) -> bool,
    ) -> Result<bool, RigError> {
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
    /// If the firmware fails and the rig does not tolerate that.
    pub fn run_to(&mut self, end: SimTime) -> Result<(), RigError> {
        loop {
            let (sleep_to, had_log) = {
                let mut soc = lock(&self.soc);
                soc.at_cycle(self.cpu.cycles);
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

    fn after_run(&mut self, event: Event) -> Result<(), RigError> {
        if self.cpu.asleep || event != Event::None {
            self.poll_log();
        }
        if let Some((_, until)) = &self.failing
            && self.now() >= *until
        {
            return self.fail_now();
        }
        match event {
            Event::None => Ok(()),
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

    // ---- failures --------------------------------------------------------------

    fn begin_failure(&mut self, kind: FailureKind) {
        if self.failing.is_some() {
            return;
        }
        let failure = self.describe_failure(kind);
        let until = failure.at + LAST_WORDS;
        self.failing = Some((failure, until));
    }

    fn describe_failure(&mut self, kind: FailureKind) -> Failure {
        let (mut regs, _) = self.cpu.registers();
        let soc = lock(&self.soc);
        let read = |addr: u32| soc.mem.read32(addr);
        let mut detail = String::new();
        if kind == FailureKind::HardFault {
            let [cfsr, hfsr, mmfar, bfar] = self.cpu.fault_status();
            detail = format!(
                "CFSR {cfsr:#010x}, HFSR {hfsr:#010x}, MMFAR {mmfar:#010x}, BFAR {bfar:#010x}"
            );
            if let Some(faulting) = backtrace::exception_frame(regs, &read) {
                regs = faulting;
            }
        }
        let stack = backtrace::unwind(&self.firmware, regs, read);
        let at = soc.now();
        drop(soc);
        Failure {
            kind,
            at,
            log: Vec::new(),
            backtrace: backtrace::describe(&self.firmware, &stack),
            detail,
        }
    }

    /// Ends the run with the failure that was begun, or notes it.
    fn fail_now(&mut self) -> Result<(), RigError> {
        let Some((mut failure, _)) = self.failing.take() else {
            return Ok(());
        };
        let from = self.log.len().saturating_sub(10);
        failure.log = self.log[from..].iter().map(LogLine::to_string).collect();
        self.failures.push(failure.clone());
        if self.tolerate_failures {
            Ok(())
        } else {
            Err(RigError::Failed(Box::new(failure)))
        }
    }

    /// A reset that the firmware made or did not prevent.
    fn firmware_reset(&mut self, cause: ResetCause) -> Result<(), RigError> {
        self.poll_log();
        if self.failing.is_none() {
            let mut failure = self.describe_failure(FailureKind::Reset(cause));
            if cause == ResetCause::IndependentWatchdog {
                failure.detail = "the watchdog was not fed; the stack is where the core was".into();
            }
            self.failing = Some((failure, SimTime::NEVER));
        }
        self.reset(cause);
        self.fail_now()
    }

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

    /// Switches the board's power off and on.
    pub fn power_cycle(&mut self) {
        self.reset(ResetCause::PowerOn);
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

    /// Lines of the log of at least this level.
    pub fn log_from(&self, level: LogLevel) -> impl Iterator<Item = &LogLine> {
        self.log
            .iter()
            .filter(move |l| l.level >= level && l.level != LogLevel::Print)
    }

    // ---- USB ------------------------------------------------------------------------

    fn usb<T>(&self, f: impl FnOnce(&mut Soc) -> T) -> T {
        let mut soc = lock(&self.soc);
        f(&mut soc)
    }

    /// How far the USB host has got.
    #[must_use]
    pub fn usb_state(&self) -> UsbState {
        self.usb(|s| s.usb.state())
    }

    /// What the device said about itself.
    #[must_use]
    pub fn usb_device(&self) -> DeviceInfo {
        self.usb(|s| s.usb.device().clone())
    }

    /// What went over the bus.
    #[must_use]
    pub fn usb_traffic(&self) -> UsbTraffic {
        self.usb(|s| s.usb.traffic())
    }

    /// What the USB host noticed, with its time.
    #[must_use]
    pub fn usb_log(&self) -> Vec<(SimTime, String)> {
        self.usb(|s| s.usb.log().to_vec())
    }

    /// Runs until the serial port can be used, for at most `limit`. Returns whether it can.
    ///
    /// # Errors
    ///
    /// If the firmware fails and the rig does not tolerate that.
    pub fn run_until_usb_ready(&mut self, limit: SimDuration) -> Result<bool, RigError> {
        self.run_until(limit, |rig| rig.usb_state() == UsbState::Ready)
    }

    /// Queues bytes for the serial port.
    pub fn usb_write(&mut self, bytes: &[u8]) {
        self.usb(|s| s.usb_write(bytes));
    }

    /// Bytes queued that have not gone over the bus.
    #[must_use]
    pub fn usb_unsent(&self) -> usize {
        self.usb(|s| s.usb.unsent())
    }

    /// Takes the bytes that have come from the serial port.
    pub fn usb_read(&mut self) -> Vec<u8> {
        self.usb(Soc::usb_read)
    }

    /// Bytes that wait to be taken.
    #[must_use]
    pub fn usb_available(&self) -> usize {
        self.usb(|s| s.usb.available())
    }

    /// Pulls the USB cable out. The board stays powered.
    pub fn usb_unplug(&mut self) {
        self.usb(Soc::unplug);
    }

    /// Plugs the USB cable in.
    pub fn usb_plug(&mut self) {
        self.usb(Soc::plug);
    }

    /// Opens or closes the port at the host (DTR and RTS).
    pub fn usb_open(&mut self, open: bool) {
        self.usb(|s| s.usb_configure(|u| u.set_open(open)));
    }

    /// Lets the host ask for data, or hang.
    pub fn usb_set_reading(&mut self, reading: bool) {
        self.usb(|s| s.usb_configure(|u| u.set_reading(reading)));
    }

    /// The host stops asking for data while this many bytes wait to be taken.
    pub fn usb_set_buffer_limit(&mut self, bytes: usize) {
        self.usb(|s| s.usb_configure(|u| u.set_buffer_limit(bytes)));
    }

    /// Flips a bit in so many of a million bytes on their way (0 for none).
    pub fn usb_corrupt(&mut self, from_device_ppm: u32, to_device_ppm: u32) {
        self.usb(|s| s.usb_configure(|u| u.set_corruption(from_device_ppm, to_device_ppm)));
    }

    // ---- the I2C bus -----------------------------------------------------------------

    /// Works on the I2C bus: holds SDA, cuts the wires, withholds an acknowledge.
    pub fn i2c_bus<T>(&mut self, f: impl FnOnce(&mut crate::i2c_bus::I2cBus) -> T) -> T {
        self.usb(|s| {
            let result = f(&mut s.i2c_bus);
            s.i2c_bus_changed();
            result
        })
    }

    // ---- pins --------------------------------------------------------------------------

    /// Drives a pin from outside.
    pub fn drive(&mut self, pin: Pin, drive: Drive) {
        self.usb(|s| s.drive(pin, drive));
    }

    /// Level of a pin.
    #[must_use]
    pub fn level(&self, pin: Pin) -> Level {
        Level::from(self.usb(|s| s.gpio.level(pin)))
    }

    /// Logs the edges of a pin from now on, for [`Rig::take_edges`].
    pub fn log_pin(&mut self, pin: Pin) {
        self.usb(|s| s.log_pin(pin));
    }

    /// Takes the edges of the logged pins in the order of their time.
    pub fn take_edges(&mut self) -> Vec<(Pin, Level, SimTime)> {
        self.usb(|s| std::mem::take(&mut s.edge_log))
    }

    /// Edges that a pin has made since power-on.
    #[must_use]
    pub fn edge_count(&self, pin: Pin) -> u64 {
        self.usb(|s| s.edge_counts[pin.index()])
    }

    /// Rate of the clock on PA8 (MCO1), if it carries one.
    #[must_use]
    pub fn clock_output(&self) -> Option<Rate> {
        self.usb(|s| s.mco1())
    }

    /// Models that changed when they want to be called outside of their own
    /// calls (a test that works on one) have to be asked again.
    pub fn models_changed(&mut self) {
        self.usb(Soc::reschedule_models);
    }

    // ---- the core ------------------------------------------------------------------------

    /// What the core did with its time.
    pub fn cpu_stats(&mut self) -> CpuStats {
        self.cpu.stats()
    }

    /// Present rate of the core clock.
    #[must_use]
    pub fn core_rate(&self) -> Rate {
        self.usb(|s| s.core_rate())
    }

    /// Counter of TIM2, as the firmware would read it now.
    #[must_use]
    pub fn tim2_count(&self) -> u32 {
        self.usb(|s| s.tim2_count())
    }

    /// The present value of TIM2's counter, and the virtual time at which it
    /// took it. TIM2 runs without a prescaler, so from this one pair follows
    /// the tick at which its hardware latches any other time.
    #[must_use]
    pub fn tim2_tick(&self) -> (SimTime, u32) {
        self.usb(|s| s.tim2_tick())
    }

    /// The firmware's image and symbols.
    #[must_use]
    pub fn firmware(&self) -> &Firmware {
        &self.firmware
    }

    /// Reads RAM or flash.
    #[must_use]
    pub fn peek(&self, address: u32, len: usize) -> Option<Vec<u8>> {
        self.usb(|s| s.peek(address, len))
    }

    /// Reads a static of the firmware by the end of its path.
    #[must_use]
    pub fn peek_symbol(&self, path: &str) -> Option<Vec<u8>> {
        let Symbol { address, size } = self
            .firmware
            .symbol(path)
            .or_else(|| self.firmware.find_symbol(path))?;
        self.peek(address, size as usize)
    }

    /// The core's call stack as it is now.
    #[must_use]
    pub fn backtrace(&self) -> Vec<String> {
        let (regs, _) = self.cpu.registers();
        let soc = lock(&self.soc);
        let stack = backtrace::unwind(&self.firmware, regs, |a| soc.mem.read32(a));
        drop(soc);
        backtrace::describe(&self.firmware, &stack)
    }

    /// Path of the firmware's ELF.
    #[must_use]
    pub fn elf(&self) -> &Path {
        self.firmware.path()
    }
}
