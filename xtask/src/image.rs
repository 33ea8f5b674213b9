//! Images of the firmware, made from its ELF.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};
use crc::{CRC_32_JAMCRC, Crc};
use object::read::elf::{FileHeader as _, ProgramHeader as _};

/// First address of the firmware's flash.
pub(crate) const FLASH: u64 = 0x0800_0000;

/// The fields of the DFU suffix before its CRC (USB DFU 1.1, appendix B): no version, the loader
/// 0483:df11 of the chip's ROM, DFU 1.0, as a raw image has it.
const SUFFIX: [u8; 12] = [
    0xFF, 0xFF, 0x11, 0xDF, 0x83, 0x04, 0x00, 0x01, b'U', b'F', b'D', 16,
];

/// Returns the contents of the flash from its first address: the loaded segments at their
/// physical addresses, and 0xFF between them.
pub(crate) fn raw_image(elf: &Path) -> Result<Vec<u8>> {
    let elf = fs::read(elf).with_context(|| format!("cannot read {}", elf.display()))?;
    let elf = elf.as_slice();
    let header = object::elf::FileHeader32::<object::Endianness>::parse(elf)
        .context("the firmware is not a 32-bit ELF")?;
    let endian = header.endian()?;
    let mut image = Vec::new();
    for segment in header.program_headers(endian, elf)? {
        let size = u64::from(segment.p_filesz(endian));
        if segment.p_type(endian) != object::elf::PT_LOAD || size == 0 {
            continue;
        }
        let at = u64::from(segment.p_paddr(endian))
            .checked_sub(FLASH)
            .context("a segment of the firmware lies outside the flash")?;
        let data = segment
            .data(endian, elf)
            .ok()
            .context("the firmware's ELF is truncated")?;
        let at = usize::try_from(at)?;
        if at + data.len() > 1 << 20 {
            bail!("the firmware is larger than the flash");
        }
        if image.len() < at + data.len() {
            image.resize(at + data.len(), 0xFF);
        }
        if let Some(place) = image.get_mut(at..at + data.len()) {
            place.copy_from_slice(data);
        }
    }
    if image.is_empty() {
        bail!("the firmware's ELF has no segment to load");
    }
    Ok(image)
}

/// Returns the raw image followed by a DFU suffix.
pub(crate) fn dfu_image(elf: &Path) -> Result<Vec<u8>> {
    Ok(with_suffix(raw_image(elf)?))
}

fn with_suffix(mut image: Vec<u8>) -> Vec<u8> {
    image.extend(SUFFIX);
    let crc = Crc::<u32>::new(&CRC_32_JAMCRC).checksum(&image);
    image.extend(crc.to_le_bytes());
    image
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By `dfu-suffix --add FILE --vid 0483 --pid df11` of dfu-util 0.11.
    #[test]
    fn the_suffix_is_the_one_that_dfu_suffix_makes() {
        let image = with_suffix(vec![0x5A; 32]);
        let suffix = *b"\xFF\xFF\x11\xDF\x83\x04\x00\x01UFD\x10\x80\x65\x51\x56";
        assert_eq!(image[32..], suffix);
    }
}
