//! Encoding and decoding of PNG images.
//!
//! Compression is fast rather than strong: depth compresses
//! little better with more effort. The bytes depend on the pixels alone, so that a
//! repeated extraction writes the same files.

use std::fs::File;
use std::io;
use std::path::Path;

/// Pixels of an image to encode, row by row.
#[derive(Clone, Copy, Debug)]
pub(crate) enum PngPixels<'a> {
    /// 16 bits a pixel, big-endian.
    Gray16(&'a [u8]),
    /// 8 bits each for red, green and blue.
    Rgb8(&'a [u8]),
}

/// Encodes an image as a PNG file in memory.
///
/// # Errors
///
/// Fails if the number of bytes does not match width and height.
pub(crate) fn encode_png(width: u32, height: u32, pixels: PngPixels<'_>) -> io::Result<Vec<u8>> {
    let (bytes, color, depth) = match pixels {
        PngPixels::Gray16(bytes) => (bytes, png::ColorType::Grayscale, png::BitDepth::Sixteen),
        PngPixels::Rgb8(bytes) => (bytes, png::ColorType::Rgb, png::BitDepth::Eight),
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

/// Image of a PNG file that [`encode_png`] made.
pub(crate) struct Decoded {
    /// Width and height.
    pub(crate) size: (u32, u32),
    /// True for 8-bit colour, false for 16-bit grey.
    pub(crate) is_rgb: bool,
    /// Pixels row by row; 16-bit ones are little-endian.
    pub(crate) pixels: Vec<u8>,
}

/// Reads a PNG file.
///
/// # Errors
///
/// Fails if the file cannot be read or is no PNG file.
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

/// Converts depth to the unit of TUM RGB-D, 5,000 per metre: millimetres times five.
///
/// `big_endian` holds 16-bit millimetres. Returns pixels in the same form, and the number of
/// pixels beyond 13.107 m, which do not fit and become 0 ("none").
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tum_depth_is_five_per_millimetre() {
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
}
