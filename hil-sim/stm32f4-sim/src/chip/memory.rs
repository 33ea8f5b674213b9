//! The memories of the STM32F407VG.

use core::ops::Range;

/// Start of the flash.
pub(crate) const FLASH_BASE: u32 = 0x0800_0000;
/// Size of the flash of the VG part.
pub(crate) const FLASH_SIZE: usize = 1024 * 1024;
/// Start of SRAM1, which SRAM2 follows directly.
pub(crate) const SRAM_BASE: u32 = 0x2000_0000;
/// SRAM1 and SRAM2 together.
pub(crate) const SRAM_SIZE: usize = 128 * 1024;
/// Start of the core-coupled memory.
pub(crate) const CCM_BASE: u32 = 0x1000_0000;
/// Size of the core-coupled memory.
pub(crate) const CCM_SIZE: usize = 64 * 1024;

/// True if an address is in the flash, at its own place or where it is mapped to zero.
#[inline(always)]
pub(crate) fn is_flash(addr: u32) -> bool {
    addr < CCM_BASE
}

/// Flash and RAM. The contents of the RAM survive every reset but a power-on
/// (then it is filled with noise, as a real SRAM is).
#[derive(Debug)]
pub(crate) struct Memory {
    pub(crate) flash: Vec<u8>,
    pub(crate) sram: Vec<u8>,
    pub(crate) ccm: Vec<u8>,
    /// RAM that the core's MPU gives to nobody: the interpreter's accesses are left to rsemu.
    pub(crate) guarded: Range<u32>,
}

impl Memory {
    pub(crate) fn new() -> Self {
        Self {
            flash: vec![0xff; FLASH_SIZE],
            sram: vec![0; SRAM_SIZE],
            ccm: vec![0; CCM_SIZE],
            guarded: 0..0,
        }
    }

    /// Creates the memory of a chip with less flash and no core-coupled memory.
    pub(crate) fn without_ccm(flash_size: usize) -> Self {
        Self {
            flash: vec![0xff; flash_size],
            ccm: Vec::new(),
            ..Self::new()
        }
    }

    /// The memory at `addr` and the offset in it, for reading.
    #[inline]
    fn region(&self, addr: u32) -> Option<(&[u8], usize)> {
        match addr >> 24 {
            0x20 => Some((&self.sram, (addr - SRAM_BASE) as usize)),
            0x08 => Some((&self.flash, (addr - FLASH_BASE) as usize)),
            0x10 => Some((&self.ccm, (addr - CCM_BASE) as usize)),
            // The boot alias: BOOT0 is low, flash is mapped at zero.
            0x00 => Some((&self.flash, addr as usize)),
            _ => None,
        }
    }

    /// Reads a word; unaligned is fine.
    #[inline]
    pub(crate) fn read32(&self, addr: u32) -> Option<u32> {
        let (mem, at) = self.region(addr)?;
        let bytes = mem.get(at..)?.first_chunk::<4>()?;
        Some(u32::from_le_bytes(*bytes))
    }

    /// Reads a half-word; unaligned is fine.
    #[inline]
    pub(crate) fn read16(&self, addr: u32) -> Option<u32> {
        let (mem, at) = self.region(addr)?;
        let bytes = mem.get(at..)?.first_chunk::<2>()?;
        Some(u32::from(u16::from_le_bytes(*bytes)))
    }

    /// Reads a byte.
    #[inline]
    pub(crate) fn read8(&self, addr: u32) -> Option<u32> {
        let (mem, at) = self.region(addr)?;
        mem.get(at).map(|b| u32::from(*b))
    }

    /// The RAM at `addr` and the offset in it. Flash is not writable (there is
    /// no model of programming it).
    #[inline]
    fn region_mut(&mut self, addr: u32) -> Option<(&mut [u8], usize)> {
        match addr >> 24 {
            0x20 => Some((&mut self.sram, (addr - SRAM_BASE) as usize)),
            0x10 => Some((&mut self.ccm, (addr - CCM_BASE) as usize)),
            _ => None,
        }
    }

    /// Writes a word to RAM; false if `addr` is not in RAM.
    #[inline]
    pub(crate) fn write32(&mut self, addr: u32, value: u32) -> bool {
        let Some((mem, at)) = self.region_mut(addr) else {
            return false;
        };
        let Some(to) = mem.get_mut(at..).and_then(|m| m.first_chunk_mut::<4>()) else {
            return false;
        };
        *to = value.to_le_bytes();
        true
    }

    /// Writes a half-word to RAM; false if `addr` is not in RAM.
    #[inline]
    pub(crate) fn write16(&mut self, addr: u32, value: u32) -> bool {
        let Some((mem, at)) = self.region_mut(addr) else {
            return false;
        };
        let Some(to) = mem.get_mut(at..).and_then(|m| m.first_chunk_mut::<2>()) else {
            return false;
        };
        *to = (value as u16).to_le_bytes();
        true
    }

    /// Writes a byte to RAM; false if `addr` is not in RAM.
    #[inline]
    pub(crate) fn write8(&mut self, addr: u32, value: u32) -> bool {
        let Some((mem, at)) = self.region_mut(addr) else {
            return false;
        };
        let Some(to) = mem.get_mut(at) else {
            return false;
        };
        *to = value as u8;
        true
    }

    /// True if `addr` to `addr + len` is all in one memory (`write`: in RAM), and not guarded.
    pub(crate) fn holds(&self, addr: u32, len: u32, write: bool) -> bool {
        if self.guards(addr, len) || write && !matches!(addr >> 24, 0x20 | 0x10) {
            return false;
        }
        self.region(addr)
            .is_some_and(|(mem, at)| at.checked_add(len as usize).is_some_and(|e| e <= mem.len()))
    }

    /// True if any byte from `addr` to `addr + len` is guarded.
    #[inline(always)]
    pub(crate) fn guards(&self, addr: u32, len: u32) -> bool {
        let Range { start, end } = self.guarded;
        addr < end && addr.wrapping_add(len) > start
    }

    /// Copies bytes out; nothing if they are not all in one memory.
    pub(crate) fn bytes(&self, addr: u32, len: usize) -> Option<&[u8]> {
        let (mem, at) = self.region(addr)?;
        mem.get(at..at.checked_add(len)?)
    }
}
