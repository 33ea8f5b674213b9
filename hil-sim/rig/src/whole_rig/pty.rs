//! A pseudo-terminal that looks like the board's serial port to other programs.
//!
//! The slave side is set to raw mode once, so that nothing is echoed or
//! translated before a program opens it. Whether a program has it open is seen
//! from the hang-up state of the master, and becomes the port's DTR.

use std::ffi::CString;
use std::os::fd::OwnedFd;
use std::path::PathBuf;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, ioctl_tiocgptpeer, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// The master side.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    path: PathBuf,
}

impl Pty {
    /// Creates a pseudo-terminal.
    ///
    /// # Errors
    ///
    /// If the system has none left.
    pub fn new() -> std::io::Result<Self> {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = openpt(flags)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let name: CString = ptsname(&master, Vec::new())?;
        let path = PathBuf::from(name.to_string_lossy().into_owned());
        {
            // Opened and closed again: the master now knows that nobody is there.
            let slave = ioctl_tiocgptpeer(&master, flags)?;
            let mut settings = tcgetattr(&slave)?;
            settings.make_raw();
            tcsetattr(&slave, OptionalActions::Now, &settings)?;
        }
        rustix::io::ioctl_fionbio(&master, true)?;
        Ok(Self { master, path })
    }

    /// Returns the path that other programs open.
    #[must_use]
    pub fn path(&self) -> &std::path::Path {
        &self.path
    }

    /// True if a program has the port open.
    ///
    /// # Errors
    ///
    /// If the system refuses to tell.
    pub fn is_open(&self) -> std::io::Result<bool> {
        let mut fds = [PollFd::new(&self.master, PollFlags::IN)];
        let now = Timespec {
            tv_sec: 0,
            tv_nsec: 0,
        };
        match poll(&mut fds, Some(&now)) {
            Ok(_) | Err(Errno::INTR) => Ok(!fds[0].revents().contains(PollFlags::HUP)),
            Err(e) => Err(e.into()),
        }
    }

    /// Reads what the program wrote; returns 0 if there is nothing.
    ///
    /// # Errors
    ///
    /// If reading fails.
    pub fn read(&self, buffer: &mut [u8]) -> std::io::Result<usize> {
        match rustix::io::read(&self.master, buffer) {
            Ok(n) => Ok(n),
            // EIO: no program has it open.
            Err(Errno::AGAIN | Errno::INTR | Errno::IO) => Ok(0),
            Err(e) => Err(e.into()),
        }
    }

    /// Writes for the program to read; returns how much was taken.
    ///
    /// # Errors
    ///
    /// If writing fails.
    pub fn write(&self, bytes: &[u8]) -> std::io::Result<usize> {
        match rustix::io::write(&self.master, bytes) {
            Ok(n) => Ok(n),
            Err(Errno::AGAIN | Errno::INTR | Errno::IO) => Ok(0),
            Err(e) => Err(e.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};

    #[test]
    fn bytes_pass_unchanged_and_opening_is_seen() {
        let pty = Pty::new().unwrap();
        assert!(!pty.is_open().unwrap());
        let mut program = std::fs::OpenOptions::new()
            .read(true)
            .write(true)
            .open(pty.path())
            .unwrap();
        assert!(pty.is_open().unwrap());
        let all: Vec<u8> = (0..=255).collect();
        assert_eq!(pty.write(&all).unwrap(), 256);
        let mut got = [0; 256];
        program.read_exact(&mut got).unwrap();
        assert_eq!(got.as_slice(), all);
        program.write_all(&all).unwrap();
        let mut got = [0; 300];
        assert_eq!(pty.read(&mut got).unwrap(), 256);
        assert_eq!(&got[..256], all);
        drop(program);
        assert!(!pty.is_open().unwrap());
        // Raw mode outlasts the program.
        let mut program = std::fs::File::open(pty.path()).unwrap();
        pty.write(b"a\nb").unwrap();
        let mut got = [0; 3];
        program.read_exact(&mut got).unwrap();
        assert_eq!(&got, b"a\nb");
        assert_eq!(pty.read(&mut [0; 8]).unwrap(), 0, "nothing is echoed");
    }
}
