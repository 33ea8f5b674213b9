//! Start of the program, and its end after a panic.
#![allow(unsafe_code)]

use core::arch::global_asm;
use core::ffi::CStr;

use crate::agent;
use crate::syscalls::exit;

// The kernel starts the program with the stack pointer at argc, which argv follows.
#[cfg(target_arch = "aarch64")]
global_asm!(".globl _start", "_start:", "mov x0, sp", "b {begin}", begin = sym begin);
#[cfg(target_arch = "arm")]
global_asm!(
    ".globl _start",
    "_start:",
    "mov r0, sp",
    "bic sp, sp, #7",
    "b {begin}",
    begin = sym begin
);

/// Returns one of the program's arguments, without its terminating zero.
///
/// # Safety
///
/// `stack` is the stack pointer with which the kernel starts a program, and `index` is less than
/// the number that it points to.
unsafe fn argument(stack: *const usize, index: usize) -> &'static [u8] {
    // SAFETY: argc is followed by as many pointers to strings that are never freed.
    unsafe { CStr::from_ptr(*stack.add(1 + index) as *const _) }.to_bytes()
}

/// Runs the program with the kernel's arguments.
///
/// # Safety
///
/// `stack` is the stack pointer with which the kernel starts a program.
unsafe extern "C" fn begin(stack: *const usize) -> ! {
    // SAFETY: the caller guarantees it.
    let count = unsafe { *stack };
    let code = if count == 3 {
        // SAFETY: all indices are less than the count. The path keeps its terminating zero.
        let [own_file, name, patience] = unsafe { [0, 1, 2].map(|index| argument(stack, index)) };
        agent::run(own_file, name, patience)
    } else {
        2
    };
    exit(code)
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    exit(101)
}
