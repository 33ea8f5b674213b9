//! PNG images, and files that are there whole or not at all.
//!
//! Images are compressed fast: a data set is written once and depth compresses
//! little better with effort. The bytes depend on the pixels alone, so that an
//! extraction that is repeated gives the same files.

use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use tempfile::TempPath;

/// An image as it is written.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Pixels<'a> {
    /// 16 bits a pixel, big-endian, as PNG has them.
    Gray16(&'a [u8]),
    /// 8 bits each of red, green and blue.
    Rgb8(&'a [u8]),
}

/// A PNG file in memory.
///
/// # Errors
///
/// The number of bytes is not that of the size.
pub(crate) fn encode_png(width: u32, height: u32, pixels: Pixels<'_>) -> io::Result<Vec<u8>> {
    let (bytes, color, depth) = match pixels {
        Pixels::Gray16(bytes) => (bytes, png::ColorType::Grayscale, png::BitDepth::Sixteen),
        Pixels::Rgb8(bytes) => (bytes, png::ColorType::Rgb, png::BitDepth::Eight),
    };
    let mut out = Vec::with_capacity(bytes.len() / 2);
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(bytes).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)?;
    Ok(out)
}

/// Width, height, and pixels of a PNG file as [`encode_png`] makes them, 16-bit ones with
/// the low byte first.
pub(crate) struct Decoded {
    pub(crate) size: (u32, u32),
    pub(crate) is_rgb: bool,
    pub(crate) pixels: Vec<u8>,
}

/// Reads such a file.
///
/// # Errors
///
/// It cannot be read, or is none.
pub(crate) fn read_png(path: &Path) -> io::Result<Decoded> {
    let file = io::BufReader::new(File::open(path)?);
    let mut reader = png::Decoder::new(file)
        .read_info()
        .map_err(io::Error::other)?;
    let length = reader.output_buffer_size();
    let mut pixels = vec![0; length.ok_or_else(|| io::Error::other("the image is too large"))?];
    let info = reader.next_frame(&mut pixels).map_err(io::Error::other)?;
    let is_rgb = info.color_type == png::ColorType::Rgb;
    if !is_rgb {
        for pixel in pixels.chunks_exact_mut(2) {
            pixel.swap(0, 1);
        }
    }
    Ok(Decoded {
        size: (info.width, info.height),
        is_rgb,
        pixels,
    })
}

/// Depth for TUM RGB-D: millimetres times five, 5,000 a metre. What does not fit
/// into 16 bits (beyond 13.107 m) becomes 0, "none", and is counted.
///
/// `big_endian` holds 16-bit pixels.
pub(crate) fn depth_to_tum(big_endian: &[u8]) -> (Vec<u8>, u64) {
    let mut lost = 0;
    let mut out = Vec::with_capacity(big_endian.len());
    for pixel in big_endian.chunks_exact(2) {
        let millimetres = u16::from_be_bytes([pixel[0], pixel[1]]);
        let scaled = millimetres.checked_mul(5).unwrap_or_else(|| {
            lost += 1;
            0
        });
        out.extend_from_slice(&scaled.to_be_bytes());
    }
    (out, lost)
}

/// Writes a file so that it is there whole or not at all, and creates its folder.
///
/// # Errors
///
/// Writing fails.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = WholeFile::create(path)?;
    file.write_all(bytes)?;
    file.finish()
}

/// A file that takes its name only when it is finished; without that, it is
/// removed.
#[derive(Debug)]
pub(crate) struct WholeFile {
    writer: BufWriter<File>,
    partial: TempPath,
    path: PathBuf,
}

impl WholeFile {
    /// Begins a file, and creates its folder.
    ///
    /// # Errors
    ///
    /// It cannot be created.
    pub(crate) fn create(path: &Path) -> io::Result<Self> {
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".partial");
        let partial = path.with_file_name(name);
        Ok(Self {
            writer: BufWriter::with_capacity(256 * 1024, File::create(&partial)?),
            partial: TempPath::try_from_path(partial)?,
            path: path.to_owned(),
        })
    }

    /// Gives the file its name.
    ///
    /// # Errors
    ///
    /// Writing or renaming fails.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        self.writer.flush()?;
        drop(self.writer);
        Ok(self.partial.persist(self.path)?)
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

impl Seek for WholeFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.writer.seek(to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tum_depth_is_five_a_millimetre() {
        let bytes: Vec<u8> = [0_u16, 1, 1234, 13_107, 13_108, u16::MAX]
            .iter()
            .flat_map(|v| v.to_be_bytes())
            .collect();
        let (scaled, lost) = depth_to_tum(&bytes);
        let values: Vec<u16> = scaled
            .chunks_exact(2)
            .map(|pair| u16::from_be_bytes([pair[0], pair[1]]))
            .collect();
        assert_eq!(values, [0, 5, 6170, 65_535, 0, 0]);
        assert_eq!(lost, 2);
    }

    #[test]
    fn a_file_appears_when_it_is_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b.txt");
        let mut file = WholeFile::create(&path).unwrap();
        file.write_all(b"x").unwrap();
        assert!(!path.exists());
        drop(file);
        assert_eq!(fs::read_dir(folder.path().join("a")).unwrap().count(), 0);
        write_whole(&path, b"y").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"y");
    }
}
