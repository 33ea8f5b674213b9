//! The Cortex-M4F: rsemu's core with a fast interpreter in front of it.
//!
//! rsemu's [`ArmV7m`] is the core: its decoder, its NVIC and system block, its
//! exception model, its floating point. It locks, looks for interrupts,
//! fetches and decodes on every instruction, which makes some 26 million
//! instructions a second. Between two things that need it (an exception, a
//! sleep, the system block, an instruction the fast interpreter does not
//! know), the `exec` module runs the same instructions from predecoded code
//! several times faster, with the same results and the same cycle counts; a
//! test runs both over the same code and compares.
//!
//! The registers live in one of the two at a time and are handed over.
//!
//! Limits: while the core sleeps `DWT_CYCCNT` stands still, as on a chip
//! without a debugger, and so does SysTick (the firmware does not use it);
//! code that runs from RAM is left to rsemu. Flash wait states and bus
//! contention are not modelled.

pub(crate) mod access;
mod alu;
mod code;
mod decode;
mod exec;
mod float;
mod op;
mod state;

#[cfg(test)]
mod tests;

use std::ops::Range;
use std::sync::{Arc, Mutex};

use rsemu::core::device::{Device, ResetKind};
use rsemu::core::error::BusError;
use rsemu::core::space::{AddressSpace, MemAttrs, MemOps, MemResult, Region};
use rsemu::cpu::arm::v7m::{ArmV7m, Config, Regs, sys, xpsr};

use crate::bus::Bus;
use crate::chip::Soc;
use crate::random::{RAM_STREAM, Random, Seed};
use crate::shared::lock;
use code::Code;
use exec::Stop;
use float::Float;
use state::Fast;

/// The upper byte of the SVC instruction.
const SVC: u32 = 0xdf;
/// The WFI instruction.
const WFI: u32 = 0xbf30;
/// Where the ROM's vectors are (RM0090 table 5).
const ROM: u32 = 0x1fff_0000;
/// Top of its stack, which its vectors give.
pub(crate) const ROM_STACK: u32 = 0x2000_2d40;
/// The catch of HardFault in DEMCR.
const VC_HARDERR: u32 = 1 << 10;

/// Interrupt of the USB core.
const OTG_FS: sys::Exception = sys::Exception(16 + 67);

/// Numbers of the exceptions HardFault and BusFault.
const HARD_FAULT: usize = 3;
const BUS_FAULT: usize = 5;

/// Outcome of a run of the core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// Nothing out of the ordinary.
    None,
    /// Reached a breakpoint; the instruction there has not been executed.
    Breakpoint(u32),
    /// Entered the handler of HardFault or BusFault.
    HardFault,
    /// Locked up: a fault that no handler can take.
    LockUp,
    /// The firmware asked for a system reset.
    ResetRequest,
    /// The firmware went on to the ROM, whose program is not modelled.
    Rom,
}

/// Use that the core made of its time.
#[derive(Clone, Copy, Debug)]
pub struct CpuStats {
    /// Core cycles awake.
    pub awake: u64,
    /// Core cycles asleep.
    pub asleep: u64,
}

/// The address space that rsemu's core sees: everything is the [`Soc`]'s.
#[derive(Debug)]
struct SocPort(Arc<Mutex<Soc>>);

impl MemOps for SocPort {
    fn read(&self, offset: u64, dst: &mut [u8], attrs: MemAttrs) -> MemResult {
        lock(&self.0)
            .bus_read(offset as u32, dst, attrs.debug)
            .then_some(())
            .ok_or(BusError::Unassigned)
    }

    fn write(&self, offset: u64, src: &[u8], attrs: MemAttrs) -> MemResult {
        lock(&self.0)
            .bus_write(offset as u32, src, attrs.debug)
            .then_some(())
            .ok_or(BusError::Unassigned)
    }
}

/// The core.
pub(crate) struct Cpu {
    arm: ArmV7m,
    soc: Arc<Mutex<Soc>>,
    fast: Fast,
    code: Code,
    regs: Regs,
    /// The fast interpreter may run (privileged, Thumb, an MPU that only guards memory).
    fast_ok: bool,
    /// True if rsemu runs the next instruction in any case.
    slow_next: bool,
    pub(crate) asleep: bool,
    locked_up: bool,
    /// Core cycles since power-on, those asleep included.
    pub(crate) cycles: u64,
    /// Cycles that rsemu's counters do not know of.
    untold: u64,
    /// Interrupt levels that rsemu knows.
    known_irq: u128,
    breakpoints: Vec<u32>,
    /// A breakpoint to pass over once.
    passing: Option<u32>,
    /// The ROM is about to start the program, and leaves what this number draws.
    by_rom: Option<u64>,
    /// A fault halts the core while DEMCR says so.
    catches_faults: bool,
    /// Core cycles of sleep.
    slept: u64,
}

impl core::fmt::Debug for Cpu {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "Cpu(pc {:#010x}, {} cycles)",
            self.fast.r[15], self.cycles
        )
    }
}

/// The memory that the MPU gives to nobody, where that is all it does; nothing if it does more.
/// The fast interpreter leaves accesses there to rsemu, whose MPU it is.
fn guarded(sys: &sys::Sys) -> Option<Range<u32>> {
    const ENABLE: u32 = 1;
    const PRIVDEFENA: u32 = 1 << 2;
    if sys.mpu_ctrl & ENABLE == 0 {
        return Some(0..0);
    }
    let enabled = |n: &usize| sys.mpu_rasr[*n] & ENABLE != 0;
    let mut regions = (0..sys.mpu_rasr.len()).filter(enabled);
    let (region, next) = (regions.next()?, regions.next());
    let (base, attributes) = (sys.mpu_rbar[region] & !0x1f, sys.mpu_rasr[region]);
    // No access by AP, all subregions.
    let is_guard = attributes & (7 << 24 | 0xff << 8) == 0;
    let size = 2_u32.checked_shl(attributes >> 1 & 0x1f)?;
    (sys.mpu_ctrl == ENABLE | PRIVDEFENA && next.is_none() && is_guard)
        .then(|| base..base.saturating_add(size))
}

impl Cpu {
    /// A core in reset on the given chip. `code_bytes` of flash are cached.
    pub(crate) fn new(soc: Arc<Mutex<Soc>>, code_bytes: usize) -> Result<Self, String> {
        let space = AddressSpace::new("core", 32);
        let port: Arc<dyn MemOps> = Arc::new(SocPort(Arc::clone(&soc)));
        space
            .topology()
            .map(Region::io("soc", 1 << 32, port), 0)
            .map_err(|e| format!("address space: {e}"))?;
        // The STM32F4 has four priority bits (PM0214 4.3.7).
        let arm = ArmV7m::new(Config::CORTEX_M4F.with_priority_bits(4));
        arm.attach_space(Arc::new(space));
        let regs = arm.regs();
        Ok(Self {
            arm,
            soc,
            fast: Fast::new(),
            code: Code::new(code_bytes),
            regs,
            fast_ok: false,
            slow_next: true,
            asleep: false,
            locked_up: false,
            cycles: 0,
            untold: 0,
            known_irq: 0,
            breakpoints: Vec::new(),
            passing: None,
            by_rom: None,
            catches_faults: false,
            slept: 0,
        })
    }

    /// A reset of the core: everything but the cycle count and the statistics.
    pub(crate) fn reset(&mut self) {
        self.arm.reset(ResetKind::Cold);
        if self.catches_faults {
            self.arm.with_sys(|s| s.demcr = VC_HARDERR);
        }
        self.regs = self.arm.regs();
        self.fast = Fast::new();
        self.fast_ok = false;
        self.slow_next = true;
        self.asleep = false;
        self.locked_up = false;
        self.known_irq = 0;
        self.passing = None;
    }

    /// Stops before the instruction at `addr` is executed.
    pub(crate) fn add_breakpoint(&mut self, addr: u32) {
        self.breakpoints.push(addr);
        self.code.plant(addr);
    }

    /// The next instruction is the first after the ROM's bootloader, which leaves its vectors and
    /// its stack, SysTick, a fault's status, and some of all interrupts enabled and pending, and
    /// all masked: what was not masked the ROM would have served.
    pub(crate) fn start_by_rom(&mut self, random: &mut Random) {
        self.by_rom = Some(random.bits());
    }

    /// The state of the core after the ROM, once it has its program counter.
    fn leave_as_rom(&mut self, drawn: u64) {
        let mut random = Seed(drawn).stream(RAM_STREAM);
        let mut regs = self.arm.regs();
        regs.msp = ROM_STACK - 8 * (drawn as u32 % 32);
        regs.r[13] = regs.msp;
        regs.primask = true;
        self.arm.set_regs(regs);
        self.arm.with_sys(|s| {
            s.vtor = ROM;
            for words in [&mut s.enable, &mut s.pending] {
                for word in words.iter_mut() {
                    *word |= random.bits() as u32 & random.bits() as u32;
                }
                // Exceptions of the core itself are not the NVIC's.
                words[0] &= !0xffff;
            }
            s.set_enable(OTG_FS, true);
            s.set_pending(OTG_FS, true);
            (s.syst_rvr, s.syst_csr) = (60_000, 7);
            // A region of all memory for nobody, with the MPU off.
            s.mpu_rasr[7] = 31 << 1 | 1;
            s.cfsr = 1 << 25;
        });
    }

    /// True if the program has gone on to the ROM.
    pub(crate) fn is_in_rom(&self) -> bool {
        self.fast.r[15] >> 16 == ROM >> 16
    }

    /// A flashing tool has gone and left debugging on, with a catch: from the next reset on, a
    /// fault halts the core (ARMv7-M C1.6.5), unless the program takes the catch back.
    pub(crate) fn leave_fault_catch(&mut self) {
        self.catches_faults = true;
    }

    /// A debug probe has gone: probe-rs clears DEMCR when it detaches.
    pub(crate) fn detach_probe(&mut self) {
        self.arm.with_sys(|s| s.demcr = 0);
        self.fast.cycle_counter = None;
    }

    /// R0 to R15 (R15 is the address of the next instruction) and xPSR.
    pub(crate) fn registers(&self) -> ([u32; 16], u32) {
        (self.fast.r, self.fast.xpsr())
    }

    /// The process stack pointer, while a handler runs.
    pub(crate) fn process_stack(&self) -> u32 {
        self.regs.psp
    }

    /// The main stack pointer, while tasks run on the other.
    pub(crate) fn main_stack(&self) -> u32 {
        self.regs.msp
    }

    /// Fault status: CFSR, HFSR, MMFAR, BFAR.
    pub(crate) fn fault_status(&self) -> [u32; 4] {
        self.arm.with_sys(|s| [s.cfsr, s.hfsr, s.mmfar, s.bfar])
    }

    /// Statistics up to now.
    pub(crate) const fn stats(&self) -> CpuStats {
        CpuStats {
            awake: self.cycles - self.slept,
            asleep: self.slept,
        }
    }

    /// Sleeps until `cycle`.
    pub(crate) fn sleep_until(&mut self, cycle: u64) {
        let idle = cycle.saturating_sub(self.cycles);
        self.cycles += idle;
        self.slept += idle;
    }

    /// Runs until the chip's cycle limit or until something out of the
    /// ordinary happens. The chip must not be locked by the caller.
    pub(crate) fn run(&mut self) -> Event {
        loop {
            if self.fast_ok && !self.slow_next {
                let soc = Arc::clone(&self.soc);
                let mut guard = lock(&soc);
                if !guard.attention {
                    if self.cycles >= guard.limit() {
                        return Event::None;
                    }
                    let before = self.cycles;
                    let stop = exec::run(
                        &mut self.fast,
                        &mut self.code,
                        &mut *guard,
                        &mut self.cycles,
                    );
                    self.untold += self.cycles - before;
                    match stop {
                        Stop::Limit if !guard.attention => return Event::None,
                        Stop::Limit | Stop::Slow => {}
                        // rsemu looks for the interrupt, unless time is up first.
                        Stop::Unmasked => {
                            self.slow_next = true;
                            continue;
                        }
                    }
                }
            } else if self.cycles >= lock(&self.soc).slice_limit() {
                return Event::None;
            }
            let pc = self.fast.r[15];
            if self.is_in_rom() {
                self.asleep = true;
                lock(&self.soc).attention = false;
                return Event::Rom;
            }
            if !self.breakpoints.is_empty() && self.breakpoints.contains(&pc) {
                if self.passing == Some(pc) {
                    self.passing = None;
                } else {
                    self.passing = Some(pc);
                    return Event::Breakpoint(pc);
                }
            }
            let event = self.slow_step();
            if event != Event::None || self.asleep {
                return event;
            }
        }
    }

    /// Tells rsemu of the interrupts that came or went since its last step.
    fn tell_interrupts(&mut self) {
        let now_irq;
        {
            let mut soc = lock(&self.soc);
            soc.at_cycle(self.cycles);
            now_irq = soc.irq;
            soc.attention = false;
            if std::mem::take(&mut soc.nmi) {
                self.arm
                    .with_sys(|s| s.set_pending(sys::Exception::NMI, true));
            }
        }
        let mut changed = now_irq ^ self.known_irq;
        while changed != 0 {
            let n = changed.trailing_zeros();
            changed &= changed - 1;
            self.arm.set_irq(n as u16, now_irq & (1 << n) != 0);
        }
        self.known_irq = now_irq;
    }

    /// Hands the registers and the time that passed over to rsemu.
    fn hand_over(&mut self, uses_psp: bool) {
        self.regs.r = self.fast.r;
        self.regs.xpsr = self.fast.xpsr();
        self.regs.primask = self.fast.primask;
        self.regs.basepri = self.fast.basepri;
        if uses_psp {
            self.regs.psp = self.regs.r[13];
        } else {
            self.regs.msp = self.regs.r[13];
        }
        self.arm.set_regs(self.regs);
        let untold = std::mem::take(&mut self.untold);
        if untold > 0 {
            self.arm.with_sys(|s| {
                s.tick_cyccnt(untold);
                if s.tick_systick(untold) && s.syst_csr & 2 != 0 {
                    s.set_pending(sys::Exception::SYSTICK, true);
                }
            });
        }
    }

    /// One step by rsemu: an exception entry or one instruction.
    pub(crate) fn slow_step(&mut self) -> Event {
        self.tell_interrupts();
        let in_it = self.fast.in_it();
        let uses_psp = !self.regs.in_handler() && self.regs.control & sys::control::SPSEL != 0;
        self.hand_over(uses_psp);

        let before = usize::from(self.regs.exception().0);
        let pc = self.regs.r[15];
        let executed = self.fast.executes();
        let word = self.instruction(pc);
        let float = {
            let soc = &mut *lock(&self.soc);
            soc.instruction = pc;
            soc.waited = 0;
            let instruction = (pc, word, executed);
            Float::before(&self.arm, &mut soc.mem, instruction, self.regs.control)
        };
        self.cycles += self.arm.step();
        let waits = self.waits(pc);
        self.cycles += waits;
        self.untold += waits;
        if executed && word >> 16 == WFI {
            lock(&self.soc).require_safe_sleep(pc);
        }
        if let Some(drawn) = self.by_rom.take() {
            self.leave_as_rom(drawn);
        }

        self.regs = self.arm.regs();
        self.fast.r = self.regs.r;
        let running = usize::from(self.regs.exception().0);
        let taken = running != 0 && self.is_entry(running);
        float.after(&self.arm, &mut lock(&self.soc).mem, taken);
        if in_it && running != before {
            let frame = if uses_psp {
                self.regs.psp
            } else {
                self.regs.msp
            };
            let called = executed && word >> 24 == SVC;
            self.stack_it_block(frame, pc, called);
        }
        self.fast.set_xpsr(self.regs.xpsr);
        self.fast.primask = self.regs.primask;
        self.fast.basepri = self.regs.basepri;
        self.fast.clear_exclusive();

        let mut event = Event::None;
        // Entered, not returned to: the handler is at its first instruction.
        if running != before && taken && matches!(running, HARD_FAULT | BUS_FAULT) {
            self.locked_up =
                self.catches_faults && self.arm.with_sys(|s| s.demcr & VC_HARDERR != 0);
            event = if self.locked_up {
                Event::LockUp
            } else {
                Event::HardFault
            };
        }
        if self.regs.r[15] == 0xffff_fffe && pc != 0xffff_fffe && self.arm.is_locked_up() {
            self.locked_up = true;
            event = Event::LockUp;
        }

        // Is there anything that rsemu has to look at before the next instruction?
        let ahead = self.untold.wrapping_sub(self.cycles) as u32;
        let (pending, guarded, reset) = self.arm.with_sys(|s| {
            let guarded = guarded(s).filter(|_| s.ccr & sys::ccr::UNALIGN_TRP == 0);
            self.fast.cycle_counter = s.cyccnt_enabled().then(|| s.dwt_cyccnt.wrapping_add(ahead));
            (s.highest_pending(), guarded, s.reset_requested)
        });
        let plain = guarded.is_some();
        lock(&self.soc).mem.guarded = guarded.unwrap_or(0..0);
        if reset {
            self.arm.clear_reset_request();
            event = Event::ResetRequest;
        }
        let takeable = match pending {
            Some((_, priority)) => priority < self.arm.execution_priority(),
            None => false,
        };
        self.fast.pending_masked = pending.is_some();
        // An interrupt that is pending already, masked or not, lets WFI fall
        // through (ARM DDI 0403, B1.5.17). rsemu sleeps first and sees it in
        // its next step, which a sleeping core would not get.
        let falls_through = self.arm.is_asleep() && pending.is_some();
        self.asleep = self.arm.is_asleep() && !falls_through;
        let privileged = self.regs.in_handler() || self.regs.control & sys::control::NPRIV == 0;
        self.fast_ok =
            plain && privileged && self.regs.xpsr & xpsr::T != 0 && !self.locked_up && !self.asleep;
        self.slow_next = takeable || falls_through || !self.fast_ok;
        event
    }

    /// Cycles for which rsemu's step with the instruction at `pc` waited.
    fn waits(&mut self, pc: u32) -> u64 {
        let soc = lock(&self.soc);
        let mut waits = soc.waited;
        if pc >> 4 != self.fast.line {
            self.fast.line = pc >> 4;
            waits += soc.flash_waits();
        }
        waits
    }

    /// An exception inside of an IT block stacks the block's state with xPSR,
    /// and its return goes on with it (DDI 0403 B1.5.6). This rsemu leaves those
    /// bits out of what it stacks: the rest of the block would run without its
    /// condition. A frame that was not just made for `pc` (tail-chaining makes
    /// none) is left alone. An SVC that was `called` returns after itself.
    fn stack_it_block(&self, frame: u32, pc: u32, called: bool) {
        const RETURN_ADDRESS: u32 = 24;
        const XPSR: u32 = 28;
        let (back, it) = if called {
            (pc.wrapping_add(2), Fast::it_next(self.fast.it))
        } else {
            (pc, self.fast.it)
        };
        let mut soc = lock(&self.soc);
        let at = frame.wrapping_add(XPSR);
        if soc.mem.read32(frame.wrapping_add(RETURN_ADDRESS)) == Some(back)
            && let Some(stacked) = soc.mem.read32(at)
        {
            soc.mem.write32(at, stacked | Fast::it_bits(it));
        }
    }

    /// The two half-words at an address.
    fn instruction(&self, pc: u32) -> u32 {
        let soc = lock(&self.soc);
        let half = |at| soc.mem.read16(at).unwrap_or(0);
        half(pc) << 16 | half(pc.wrapping_add(2))
    }

    fn is_entry(&self, exception: usize) -> bool {
        let vector = self.arm.vtor().wrapping_add(exception as u32 * 4);
        let handler = lock(&self.soc).mem.read32(vector).unwrap_or(0) & !1;
        handler == self.fast.r[15]
    }
}
