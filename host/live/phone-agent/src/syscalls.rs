//! Linux' system calls.
//!
//! The numbers are those of `include/uapi/asm-generic/unistd.h` (aarch64) and
//! `arch/arm/tools/syscall.tbl` (ARM EABI) of Linux; the constants those of its
//! `socket.h`, `fcntl.h`, `poll.h` and `time.h`, which are the same on both.
#![allow(unsafe_code)]

use core::arch::asm;

#[cfg(target_arch = "aarch64")]
mod number {
    pub(super) const UNLINKAT: usize = 35;
    pub(super) const CLOSE: usize = 57;
    pub(super) const READ: usize = 63;
    pub(super) const PPOLL: usize = 73;
    pub(super) const EXIT_GROUP: usize = 94;
    pub(super) const CLOCK_GETTIME: usize = 113;
    pub(super) const SOCKET: usize = 198;
    pub(super) const BIND: usize = 200;
    pub(super) const LISTEN: usize = 201;
    pub(super) const SENDTO: usize = 206;
    pub(super) const ACCEPT4: usize = 242;
}

#[cfg(target_arch = "arm")]
mod number {
    pub(super) const READ: usize = 3;
    pub(super) const CLOSE: usize = 6;
    pub(super) const EXIT_GROUP: usize = 248;
    pub(super) const CLOCK_GETTIME: usize = 263;
    pub(super) const SOCKET: usize = 281;
    pub(super) const BIND: usize = 282;
    pub(super) const LISTEN: usize = 284;
    pub(super) const SENDTO: usize = 290;
    pub(super) const UNLINKAT: usize = 328;
    pub(super) const PPOLL: usize = 336;
    pub(super) const ACCEPT4: usize = 366;
}

/// Makes a system call with up to six arguments. An error is a small negative number.
fn call(number: usize, arguments: [usize; 6]) -> isize {
    let [a, b, c, d, e, f] = arguments;
    let result: isize;
    #[cfg(target_arch = "aarch64")]
    // SAFETY: the kernel reads and writes only what the arguments point to, which the
    // functions below own or borrow for the call; it keeps all other registers.
    unsafe {
        asm!(
            "svc #0",
            in("x8") number,
            inlateout("x0") a => result,
            in("x1") b, in("x2") c, in("x3") d, in("x4") e, in("x5") f,
            options(nostack),
        );
    }
    #[cfg(target_arch = "arm")]
    // SAFETY: as above.
    unsafe {
        asm!(
            "svc #0",
            in("r7") number,
            inlateout("r0") a => result,
            in("r1") b, in("r2") c, in("r3") d, in("r4") e, in("r5") f,
            options(nostack),
        );
    }
    result
}

/// `AT_FDCWD`: relative paths start at the current folder.
const HERE: usize = -100_isize as usize;

const AF_UNIX: u16 = 1;
const SOCK_STREAM: usize = 1;
const SOCK_CLOEXEC: usize = 0o2_000_000;
const MSG_NOSIGNAL: usize = 0x4000;
const POLLIN: i16 = 1;

/// `struct timespec`. The kernel's `time_t` and `long` have the size of a register on both.
#[repr(C)]
struct TimeSpec {
    seconds: isize,
    nanos: isize,
}

#[repr(C)]
struct PollFd {
    file: i32,
    events: i16,
    found: i16,
}

/// `struct sockaddr_un`.
#[repr(C)]
struct Address {
    family: u16,
    path: [u8; 108],
}

/// A clock of the kernel.
#[derive(Clone, Copy)]
pub(crate) enum Clock {
    /// `CLOCK_MONOTONIC`, which stops while the phone sleeps.
    Monotonic = 1,
    /// `CLOCK_BOOTTIME`, which does not.
    Boot = 7,
}

/// Returns the reading of a clock in nanoseconds.
pub(crate) fn now(clock: Clock) -> i64 {
    let mut time = TimeSpec {
        seconds: 0,
        nanos: 0,
    };
    let place = &raw mut time as usize;
    call(number::CLOCK_GETTIME, [clock as usize, place, 0, 0, 0, 0]);
    time.seconds as i64 * 1_000_000_000 + time.nanos as i64
}

/// Removes the file at a path that ends with a zero. Returns true on success.
pub(crate) fn remove(path: &[u8]) -> bool {
    call(number::UNLINKAT, [HERE, path.as_ptr() as usize, 0, 0, 0, 0]) == 0
}

/// An open file, which is closed when it is dropped.
pub(crate) struct File(i32);

impl File {
    fn from_result(result: isize) -> Option<Self> {
        i32::try_from(result)
            .ok()
            .filter(|&file| file >= 0)
            .map(Self)
    }

    /// Listens on an abstract socket.
    pub(crate) fn listen(name: &[u8]) -> Option<Self> {
        let kind = SOCK_STREAM | SOCK_CLOEXEC;
        let socket = Self::from_result(call(number::SOCKET, [AF_UNIX.into(), kind, 0, 0, 0, 0]))?;
        // A path that begins with a zero names an abstract socket, which is not a file.
        let mut address = Address {
            family: AF_UNIX,
            path: [0; 108],
        };
        address.path.get_mut(1..=name.len())?.copy_from_slice(name);
        let place = &raw const address as usize;
        let length = size_of::<u16>() + 1 + name.len();
        let bound = call(number::BIND, [socket.0 as usize, place, length, 0, 0, 0]);
        let listens = call(number::LISTEN, [socket.0 as usize, 1, 0, 0, 0, 0]);
        (bound == 0 && listens == 0).then_some(socket)
    }

    /// Accepts the next connection.
    pub(crate) fn accept(&self) -> Option<Self> {
        Self::from_result(call(
            number::ACCEPT4,
            [self.0 as usize, 0, 0, SOCK_CLOEXEC, 0, 0],
        ))
    }

    /// Waits until there is something to read. Returns false if there is nothing within `seconds`.
    pub(crate) fn is_ready(&self, seconds: u32) -> bool {
        let mut asked = PollFd {
            file: self.0,
            events: POLLIN,
            found: 0,
        };
        let mut patience = TimeSpec {
            seconds: seconds as isize,
            nanos: 0,
        };
        let asked = &raw mut asked as usize;
        let patience = &raw mut patience as usize;
        call(number::PPOLL, [asked, 1, patience, 0, 0, 0]) > 0
    }

    /// Reads some bytes and returns their number, which is 0 at the end of a connection.
    pub(crate) fn read(&self, to: &mut [u8]) -> Option<usize> {
        let place = to.as_mut_ptr() as usize;
        let got = call(number::READ, [self.0 as usize, place, to.len(), 0, 0, 0]);
        usize::try_from(got).ok()
    }

    /// Sends bytes. Returns true if all were sent.
    pub(crate) fn send(&self, bytes: &[u8]) -> bool {
        let place = bytes.as_ptr() as usize;
        let arguments = [self.0 as usize, place, bytes.len(), MSG_NOSIGNAL, 0, 0];
        usize::try_from(call(number::SENDTO, arguments)) == Ok(bytes.len())
    }
}

impl Drop for File {
    fn drop(&mut self) {
        call(number::CLOSE, [self.0 as usize, 0, 0, 0, 0, 0]);
    }
}

/// Ends the program with an exit code.
pub(crate) fn exit(code: i32) -> ! {
    loop {
        call(number::EXIT_GROUP, [code as usize, 0, 0, 0, 0, 0]);
    }
}
