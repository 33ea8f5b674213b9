//! Handling of panics and faults: the message is logged and kept over the reset for the next
//! [`protocol::Hello`], and the board resets.

#![allow(
    unsafe_code,
    reason = "memory that start-up does not touch, and exceptions"
)]

use core::fmt;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::scb::Exception;
use cortex_m::peripheral::{DCB, SCB};
use cortex_m_rt::{ExceptionFrame, exception};
use embassy_stm32::pac;
use firmware::retained::{Kept, Memory};
use heapless::String;
use protocol::{MAX_PANIC, ResetCause};

use crate::hardware::stack;

#[unsafe(link_section = ".uninit.KEPT")]
static mut KEPT: MaybeUninit<Memory> = MaybeUninit::uninit();

#[unsafe(link_section = ".uninit.TO_ROM")]
static mut TO_ROM: MaybeUninit<[u32; 2]> = MaybeUninit::uninit();

/// Value of [`TO_ROM`] that makes the next start go on to the ROM.
const GO_TO_ROM: [u32; 2] = [0xB007_10AD, !0xB007_10AD];

/// Vectors of the ROM (AN2606; RM0090 table 3).
const ROM: *const u32 = 0x1FFF_0000 as *const u32;

static FAILED: AtomicBool = AtomicBool::new(false);

/// VC_CORERESET and the other catches of DEMCR (ARMv7-M C1.6.5).
const VECTOR_CATCHES: u32 = 0x07F1;

/// Faults of the bus get a handler of their own priority, so that one on the tasks' stack can be
/// taken where that stack has overflowed. Catches that a flashing tool left on would halt the
/// core for ever at the next fault. To be called once, first thing.
pub(crate) fn init() {
    // SAFETY: nobody else runs yet.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.SCB.enable(Exception::BusFault);
    // SAFETY: without the catches the core takes its exceptions itself.
    unsafe { core.DCB.demcr.modify(|demcr| demcr & !VECTOR_CATCHES) };
}

fn load() -> Memory {
    // SAFETY: every bit pattern is a value of `Memory`. The access is volatile,
    // so that what a former run left is really read. Nothing runs in parallel:
    // this is called once at start and once with interrupts off.
    unsafe { (&raw const KEPT).cast::<Memory>().read_volatile() }
}

fn store(kept: &Kept) {
    // SAFETY: as above.
    unsafe {
        (&raw mut KEPT)
            .cast::<Memory>()
            .write_volatile(kept.to_memory());
    }
}

/// The end of the last run and the record of this one.
pub(crate) struct Begun {
    /// Message of the panic that ended the last run.
    pub(crate) last_panic: Option<String<MAX_PANIC>>,
    /// Record of this run.
    pub(crate) kept: Kept,
    /// True for the first run since power-on, whose number is a guess: see [`renumber`].
    pub(crate) first: bool,
}

/// To be called once, before anything that may panic.
pub(crate) fn begin_run(cause: ResetCause) -> Begun {
    let left = load();
    let (last_panic, kept) = Kept::next(&left, cause);
    store(&kept);
    Begun {
        last_panic,
        kept,
        first: Kept::read(&left).is_none(),
    }
}

/// Resets, and goes on to the ROM from there.
pub(crate) fn restart_into_rom() -> ! {
    cortex_m::interrupt::disable();
    // SAFETY: interrupts are off, and nothing else touches it.
    unsafe {
        (&raw mut TO_ROM)
            .cast::<[u32; 2]>()
            .write_volatile(GO_TO_ROM)
    };
    SCB::sys_reset()
}

/// Starts the ROM if that is what the reset was for. To be called first, while the chip is as
/// the ROM expects it: as it comes from a reset.
pub(crate) fn start_rom_if_asked() {
    let to_rom = (&raw mut TO_ROM).cast::<[u32; 2]>();
    // SAFETY: every bit pattern is a value, and nobody else runs yet. Volatile: the compiler knows
    // of nobody that has written it.
    let asked = unsafe {
        let asked = to_rom.read_volatile();
        to_rom.write_volatile([0; 2]);
        asked
    };
    if asked != GO_TO_ROM {
        return;
    }
    pac::RCC.apb2enr().modify(|w| w.set_syscfgen(true));
    let _ = pac::RCC.apb2enr().read();
    // The ROM at address 0, and the vectors from there, as the BOOT0 pin has it (RM0090 9.2.1).
    pac::SYSCFG.memrm().write(|w| w.set_mem_mode(1));
    // SAFETY: the ROM's own stack and program take over; nothing of this one goes on.
    unsafe {
        (*SCB::PTR).vtor.write(0);
        cortex_m::asm::bootload(ROM)
    }
}

/// Gives the first run since power-on its number.
pub(crate) fn renumber(run: &Begun, epoch: u32) {
    store(&Kept {
        run: epoch,
        ..run.kept.clone()
    });
}

/// Keeps and logs the message, and resets. A failure on the way resets at once.
fn fail(message: fmt::Arguments<'_>) -> ! {
    cortex_m::interrupt::disable();
    if !FAILED.swap(true, Ordering::Relaxed) {
        let kept = Kept::read(&load()).unwrap_or_default().panicked(message);
        store(&kept);
        if let Some(text) = &kept.panic {
            defmt::error!("{=str}", text.as_str());
        }
        if DCB::is_debugger_attached() {
            // Time for the debugger to fetch the message: 0.1 s.
            cortex_m::asm::delay(firmware::config::SYSCLK_HZ / 10);
        }
    }
    SCB::sys_reset()
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    match info.location() {
        Some(at) => fail(format_args!(
            "{}:{}: {}",
            at.file(),
            at.line(),
            info.message()
        )),
        None => fail(format_args!("{}", info.message())),
    }
}

/// Faults of the bus come here too (memory/checks.x).
#[exception(trampoline = true)]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    // SAFETY: reading the fault status registers has no effect.
    let (cfsr, hfsr) = unsafe { ((*SCB::PTR).cfsr.read(), (*SCB::PTR).hfsr.read()) };
    let at = core::ptr::from_ref(frame).addr();
    if let Some(which) = stack::overflowed(at) {
        fail(format_args!(
            "stack overflow: the {which} stack ended, sp {at:#010x}, cfsr {cfsr:#010x}"
        ));
    }
    fail(format_args!(
        "HardFault at pc {:#010x}, lr {:#010x}, cfsr {:#010x}, hfsr {:#010x}",
        frame.pc(),
        frame.lr(),
        cfsr,
        hfsr
    ))
}

#[exception]
unsafe fn NonMaskableInt() -> ! {
    fail(format_args!("the crystal has stopped"))
}

#[exception]
unsafe fn DefaultHandler(irqn: i16) -> ! {
    fail(format_args!("interrupt {irqn} has no handler"))
}

/// Calls a handler that overflows its stack, to try out what notices it.
pub(crate) fn overflow_in_handler() {
    SCB::set_pendsv();
}

#[exception]
fn PendSV() {
    stack::overflow(0);
}

/// Fails with an undefined instruction, to try out the HardFault handler.
pub(crate) fn undefined_instruction() -> ! {
    cortex_m::asm::udf()
}
