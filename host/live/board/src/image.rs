//! Images of the firmware: the flash's content with a DFU suffix after it.

use std::path::Path;

use crc::{CRC_32_JAMCRC, Crc};
use protocol::{BoardModel, IMAGE_MARK};

/// The DFU suffix: its last 16 bytes (USB DFU 1.1, appendix B).
const SUFFIX: usize = 16;
/// CRC of the suffix, over all bytes before it: Ethernet's without the final complement.
const CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_JAMCRC);
/// Largest text after the mark.
const MARK_MOST: usize = 64;

/// Address of the start of the flash.
pub const FLASH_START: u32 = 0x0800_0000;

/// A checked image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// The board that it is for.
    pub board: BoardModel,
    /// Version of the firmware.
    pub version: String,
    /// First digits of its git revision, empty if unknown.
    pub revision: String,
    /// Content of the flash from [`FLASH_START`] on.
    pub flash: Vec<u8>,
}

/// Reason for which a file is not an image.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file cannot be read.
    #[error("it cannot be read: {0}")]
    Read(#[from] std::io::Error),
    /// The file's end is no DFU suffix.
    #[error("it has no DFU suffix: it is cut short, or not an image")]
    NoSuffix,
    /// The file is damaged.
    #[error("it is damaged: its CRC is {found:08x}, by its content {expected:08x}")]
    Damaged {
        /// By the suffix.
        found: u32,
        /// By the content.
        expected: u32,
    },
    /// The image is another firmware's.
    #[error("it is not the firmware of a SmartDepthSync board")]
    Foreign,
}

impl Image {
    /// Reads and checks an image.
    ///
    /// # Errors
    ///
    /// The file cannot be read, is damaged, or not an image of this project's firmware.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        Self::parse(std::fs::read(path)?)
    }

    /// Checks the bytes of an image.
    ///
    /// # Errors
    ///
    /// As [`Image::read`].
    pub fn parse(mut bytes: Vec<u8>) -> Result<Self, ImageError> {
        let start = bytes.len().checked_sub(SUFFIX);
        let start = start.ok_or(ImageError::NoSuffix)?;
        let suffix = bytes.split_off(start);
        let (fields, crc) = suffix.split_at(SUFFIX - 4);
        if !fields.ends_with(&[b'U', b'F', b'D', SUFFIX as u8]) {
            return Err(ImageError::NoSuffix);
        }
        let found = crc.try_into().map_or(0, u32::from_le_bytes);
        let mut digest = CRC32.digest();
        digest.update(&bytes);
        digest.update(fields);
        let expected = digest.finalize();
        if found != expected {
            return Err(ImageError::Damaged { found, expected });
        }
        let (board, version, revision) = marked(&bytes).ok_or(ImageError::Foreign)?;
        Ok(Self {
            board,
            version,
            revision,
            flash: bytes,
        })
    }
}

/// Board, version and revision after the mark.
fn marked(flash: &[u8]) -> Option<(BoardModel, String, String)> {
    let mark = IMAGE_MARK.as_bytes();
    let at = flash.windows(mark.len()).position(|bytes| bytes == mark)?;
    let rest = flash.get(at + mark.len()..)?;
    let mut parts = rest.get(..MARK_MOST.min(rest.len()))?.split(|&b| b == b';');
    let mut text = || {
        let part = std::str::from_utf8(parts.next()?).ok()?;
        part.is_ascii().then(|| part.to_owned())
    };
    let (board, version, revision) = (text()?, text()?, text()?);
    Some((BoardModel::from_key(&board)?, version, revision))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(mark: &str) -> Vec<u8> {
        let mut flash = vec![0xA5; 5_000];
        flash.extend(mark.bytes());
        flash.extend([0xFF; 100]);
        test_support::dfu_image(flash)
    }

    const MARK: &str = "SmartDepthSync image;black-pill;0.1.0;0123456789ab;";

    #[test]
    fn an_image_says_whose_it_is_and_any_flipped_bit_or_cut_is_found() {
        let good = image(MARK);
        let read = Image::parse(good.clone()).unwrap();
        assert_eq!(read.board, BoardModel::BlackPill);
        assert_eq!((&*read.version, &*read.revision), ("0.1.0", "0123456789ab"));
        assert_eq!(read.flash, good[..good.len() - SUFFIX]);
        for bit in (0..good.len() * 8).step_by(97) {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(Image::parse(bad).is_err(), "bit {bit}");
        }
        for cut in [0, 1, 15, 16, 200, good.len() - 1] {
            assert!(Image::parse(good[..cut].to_vec()).is_err(), "cut at {cut}");
        }
    }

    #[test]
    fn another_firmware_is_refused() {
        for mark in [
            "",
            "SmartDepthSync image",
            "SmartDepthSync image;nucleo;0.1.0;;",
            "SmartDepthSync image;discovery",
        ] {
            let found = Image::parse(image(mark));
            assert!(
                matches!(found, Err(ImageError::Foreign)),
                "{mark}: {found:?}"
            );
        }
    }
}
