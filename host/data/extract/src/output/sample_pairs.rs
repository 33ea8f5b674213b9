//! Strip of sample pairs for the report: the phone's image above, the depth image of the
//! same instant below it.

use std::fmt::Write as _;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::imageops::{FilterType, resize};
use image::{GrayImage, ImageFormat, ImageResult, Luma};

use crate::layout::SequenceTables;

/// File of the strip in the output folder.
pub const FILE: &str = "sample_pairs.svg";

/// Number of pairs in the strip.
const SHOWN: usize = 6;
/// Distance of shown pairs, so that a motion is visible from one to the next.
const STEP: usize = 4;
/// Width of an image in the strip, pixels.
const WIDTH: u32 = 160;
/// Largest height of an image in the strip, pixels.
const MOST_HEIGHT: u32 = 320;
/// Distance of images in the strip, pixels.
const GAP: u32 = 6;

/// Returns the image files (phone, depth) of pairs from the middle of a sequence in `folder`.
pub(crate) fn samples(folder: &Path, tables: &SequenceTables<'_>) -> Vec<(PathBuf, PathBuf)> {
    let pairs = &tables.pairs;
    let from = (pairs.len() / 2).saturating_sub(SHOWN * STEP / 2);
    let shown = pairs.iter().skip(from).step_by(STEP).take(SHOWN);
    shown
        .filter_map(|&(color, depth)| {
            let color = tables.color.get(color)?;
            let depth = tables.depth.get(depth)?;
            Some((folder.join(&color.path), folder.join(&depth.path)))
        })
        .collect()
}

/// Draws pairs as SVG. The nearest depth is white, the farthest dark, and none black.
///
/// # Errors
///
/// Fails if an image cannot be read.
pub(crate) fn draw(pairs: &[(PathBuf, PathBuf)]) -> ImageResult<String> {
    let mut phone = Vec::new();
    let mut depth = Vec::new();
    for (color, depth_image) in pairs {
        phone.push(small(&image::open(color)?.to_luma8()));
        depth.push(image::open(depth_image)?.to_luma16());
    }
    let mut known: Vec<u16> = depth
        .iter()
        .flat_map(|image| image.pixels().step_by(7).map(|pixel| pixel.0[0]))
        .filter(|&depth| depth > 0)
        .collect();
    known.sort_unstable();
    // Small objects count, single wrong pixels do not.
    let at = |share: usize| known.get(known.len() * share / 1000).copied();
    let (near, far) = (at(2).unwrap_or(0), at(998).unwrap_or(1));
    let range = f64::from(far.saturating_sub(near).max(1));
    let shade = |depth: u16| match depth {
        0 => 0,
        depth => {
            let share = (f64::from(depth) - f64::from(near)) / range;
            (255.0 - 215.0 * share.clamp(0.0, 1.0)) as u8
        }
    };
    let depth: Vec<GrayImage> = depth
        .iter()
        .map(|image| {
            small(&GrayImage::from_fn(
                image.width(),
                image.height(),
                |x, y| Luma([shade(image.get_pixel(x, y).0[0])]),
            ))
        })
        .collect();
    let highest = |images: &[GrayImage]| images.iter().map(GrayImage::height).max().unwrap_or(0);
    let below = highest(&phone) + GAP;
    let height = below + highest(&depth);
    let width = (pairs.len() as u32 * (WIDTH + GAP)).saturating_sub(GAP);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\">\n"
    );
    for (index, pair) in phone.iter().zip(&depth).enumerate() {
        let x = index as u32 * (WIDTH + GAP);
        for (y, image) in [(0, pair.0), (below, pair.1)] {
            let mut png = Cursor::new(Vec::new());
            image.write_to(&mut png, ImageFormat::Png)?;
            // Writing into a String cannot fail.
            let _ = writeln!(
                svg,
                "<image x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{}\" href=\"data:image/png;base64,{}\"/>",
                image.width(),
                image.height(),
                STANDARD.encode(png.get_ref())
            );
        }
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

/// Scales an image for the strip.
fn small(image: &GrayImage) -> GrayImage {
    let height = u64::from(image.height()) * u64::from(WIDTH) / u64::from(image.width().max(1));
    let height = height.clamp(1, MOST_HEIGHT.into()) as u32;
    resize(image, WIDTH, height, FilterType::Triangle)
}

#[cfg(test)]
mod tests {
    use image::ImageBuffer;

    use super::*;

    #[test]
    fn near_is_light_and_phone_is_above_depth() {
        let folder = tempfile::tempdir().unwrap();
        let pair = (
            folder.path().join("phone.png"),
            folder.path().join("depth.png"),
        );
        let phone: GrayImage = ImageBuffer::from_pixel(320, 240, Luma([100]));
        phone.save(&pair.0).unwrap();
        // Near on the left, far in the middle, nothing on the right.
        let depth = ImageBuffer::from_fn(300, 150, |x, _| {
            Luma([[500_u16, 3_000, 0][x as usize / 100]])
        });
        depth.save(&pair.1).unwrap();
        let svg = draw(&[pair.clone(), pair]).unwrap();
        let images: Vec<GrayImage> = svg
            .split("base64,")
            .skip(1)
            .map(|part| {
                let text = part.split('"').next().unwrap();
                let png = STANDARD.decode(text).unwrap();
                image::load_from_memory(&png).unwrap().to_luma8()
            })
            .collect();
        assert_eq!(images.len(), 4);
        assert_eq!(images[0].dimensions(), (160, 120));
        assert_eq!(images[1].dimensions(), (160, 80));
        assert_eq!(images[0].get_pixel(80, 60).0, [100]);
        let shades = [10, 80, 150].map(|x| images[1].get_pixel(x, 40).0[0]);
        assert_eq!(shades, [255, 40, 0]);
        // A small near object is distinguished from the wall beyond it.
        let wall = ImageBuffer::from_fn(160, 90, |x, y| {
            Luma([if x < 15 && y < 12 { 900_u16 } else { 2_400 }])
        });
        let path = folder.path().join("wall.png");
        wall.save(&path).unwrap();
        let seen = draw(&[(folder.path().join("phone.png"), path)]).unwrap();
        let png = seen.rsplit("base64,").next().unwrap();
        let png = STANDARD.decode(png.split('"').next().unwrap()).unwrap();
        let seen = image::load_from_memory(&png).unwrap().to_luma8();
        assert_eq!([5, 80].map(|x| seen.get_pixel(x, 5).0[0]), [255, 40]);
        assert!(svg.contains("viewBox=\"0 0 326 206\""), "{svg}");
        assert!(svg.contains("x=\"166\" y=\"126\""), "{svg}");
        assert!(draw(&[(folder.path().join("gone.png"), folder.path().join("gone"))]).is_err());
    }
}
