//! Drawing of a frame with the rows of its flashes, as SVG.

use std::fmt::Write as _;
use std::io::Cursor;
use std::ops::Range;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use evaluate::shown::Shown;
use image::ImageResult;

/// Width below which a picture has its labels beside it, pixels.
const LABEL_WIDTH: usize = 300;

/// Draws the frame with lines and numbers at the flashes, and a dashed line along the middle
/// row.
pub(super) fn svg(shown: &Shown) -> ImageResult<String> {
    let mut canvas = Canvas::new(shown)?;
    for &(number, row) in &shown.picture_flashes {
        // Only at the edges, so that the bands stay visible.
        canvas.line(row, 0.0..0.18, "stroke=\"#ff6a3d\"");
        canvas.line(row, 0.82..1.0, "stroke=\"#ff6a3d\"");
        let (at, vertical) = shown.picture_line(row);
        let (x, y) = match (vertical, canvas.beside) {
            (true, _) => (at + 3.0, 14.0),
            (false, true) => (canvas.width + 6.0, at + 0.35 * canvas.letters),
            (false, false) => (4.0, at - 3.0),
        };
        canvas.label(x, y, "#ff6a3d", &format!("flash {number}, row {row:.2}"));
    }
    let middle = shown.middle_row;
    if canvas.beside {
        let x = canvas.width + (LABEL_WIDTH * 2 / 3) as f64;
        let y = shown.picture_line(middle).0 + 0.35 * canvas.letters;
        canvas.label(x, y, "#0072b2", "middle row");
    }
    let dashed = "stroke=\"#39a0ff\" stroke-dasharray=\"6 4\"";
    canvas.line(middle, 0.0..1.0, dashed);
    canvas.svg.push_str("</svg>\n");
    Ok(canvas.svg)
}

/// The picture under construction.
struct Canvas<'a> {
    shown: &'a Shown,
    width: f64,
    height: f64,
    /// True if labels stand beside the picture.
    beside: bool,
    /// Height of the letters, in proportion to the picture, so that they can be read
    /// at any size.
    letters: f64,
    svg: String,
}

impl<'a> Canvas<'a> {
    fn new(shown: &'a Shown) -> ImageResult<Self> {
        let picture = &shown.picture;
        let (w, h) = (picture.width, picture.height);
        let mut png = Cursor::new(Vec::new());
        image::write_buffer_with_format(
            &mut png,
            &picture.pixels,
            w as u32,
            h as u32,
            image::ExtendedColorType::L8,
            image::ImageFormat::Png,
        )?;
        let beside = w < LABEL_WIDTH;
        let whole = if beside { w + LABEL_WIDTH } else { w };
        let letters = if beside {
            0.022 * h as f64
        } else {
            0.03 * w.min(h) as f64
        };
        Ok(Self {
            shown,
            width: w as f64,
            height: h as f64,
            beside,
            letters: letters.max(12.0),
            svg: format!(
                "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {whole} {h}\" width=\"{whole}\" height=\"{h}\">\n<image width=\"{w}\" height=\"{h}\" href=\"data:image/png;base64,{}\"/>\n",
                STANDARD.encode(png.get_ref())
            ),
        })
    }

    /// Draws a line along a part of a sensor row.
    fn line(&mut self, row: f64, part: Range<f64>, style: &str) {
        let (at, upright) = self.shown.picture_line(row);
        let (x1, y1, x2, y2) = if upright {
            (at, part.start * self.height, at, part.end * self.height)
        } else {
            (part.start * self.width, at, part.end * self.width, at)
        };
        let _ = writeln!(
            self.svg,
            "<line x1=\"{x1:.2}\" y1=\"{y1:.2}\" x2=\"{x2:.2}\" y2=\"{y2:.2}\" stroke-width=\"1.2\" {style}/>"
        );
    }

    fn label(&mut self, x: f64, y: f64, colour: &str, words: &str) {
        let _ = writeln!(
            self.svg,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"{colour}\" font-family=\"sans-serif\" font-size=\"{:.0}\">{words}</text>",
            self.letters
        );
    }
}
