//! TUM RGB-D: `rgb/` and `depth/` with images named by seconds (ten digits and six decimals),
//! `rgb.txt`, `depth.txt`, `accelerometer.txt`, `associations.txt`; depth in 16
//! bits with 5,000 per metre, 0 for none.
//!
//! The format rounds times to microseconds; `pairs.csv` in the output folder has
//! nanoseconds. `associations.txt` is written for registered depth only. The format has no
//! place for angular rates and infrared.

use std::borrow::Cow;
use std::fmt::Write;
use std::io;
use std::path::Path;

use super::{DataSetInfo, ImageKind, ImageRow, ImuRow, ImuTable, Layout, SequenceTables};
use crate::frames::pairs;
use crate::output::png_file::depth_to_tum;
use crate::output::whole_file::write_whole;
use crate::time::{BoardNanos, SECOND, decimal_seconds, seconds_in_name};

/// Largest distance in time of colour and depth of one capture, ns: half a period at 30 Hz.
const NEAR: i64 = SECOND / 60;

/// The TUM layout.
pub(super) struct Tum {
    /// True if `rgb` has the depth camera's colour images, false if it has the phone's.
    of_camera: bool,
}

pub(super) static OF_PHONE: Tum = Tum { of_camera: false };
pub(super) static OF_CAMERA: Tum = Tum { of_camera: true };

/// Appends time and acceleration of a sample as a line.
fn accel_row(row: &mut String, sample: &ImuRow) {
    let [x, y, z] = sample.accel;
    // Writing into a String cannot fail.
    let _ = writeln!(row, "{} {x} {y} {z}", decimal_seconds(sample.at.0, 6));
}

impl Layout for Tum {
    fn folder(&self, kind: ImageKind) -> Option<&'static str> {
        match kind {
            ImageKind::Color => (!self.of_camera).then_some("rgb"),
            ImageKind::Depth => Some("depth"),
            ImageKind::Infrared => None,
            ImageKind::Camera => self.of_camera.then_some("rgb"),
        }
    }

    fn image_name(&self, at: BoardNanos) -> String {
        seconds_in_name(at, 6)
    }

    fn depth_pixels<'a>(&self, millimetres: &'a [u8]) -> (Cow<'a, [u8]>, u64) {
        let (scaled, lost) = depth_to_tum(millimetres);
        (Cow::Owned(scaled), lost)
    }

    fn board_imu(&self) -> ImuTable {
        ImuTable {
            path: "accelerometer.txt",
            header: "# accelerometer data of the board\n# times in seconds of board time\n\
                     # timestamp ax ay az\n",
            subtract_delay: true,
            row: accel_row,
        }
    }

    fn phone_imu(&self) -> Option<ImuTable> {
        None
    }

    fn finish(
        &self,
        folder: &Path,
        tables: &SequenceTables<'_>,
        facts: &DataSetInfo,
    ) -> io::Result<()> {
        super::auxiliary::write(folder, tables)?;
        let (color, size) = if self.of_camera {
            (&tables.camera, facts.camera_size)
        } else {
            (&tables.color, facts.color_size)
        };
        list(&folder.join("rgb.txt"), "color images", color)?;
        list(&folder.join("depth.txt"), "depth maps", &tables.depth)?;
        // Readers of pairs assume that the pixels of both images coincide.
        if size.is_none() || size != facts.depth_size || !facts.registered {
            return Ok(());
        }
        let own = self.of_camera.then(|| camera_pairs(tables));
        let mut text = String::new();
        for &(image, depth) in own.as_ref().unwrap_or(&tables.pairs) {
            let (Some(image), Some(depth)) = (color.get(image), tables.depth.get(depth)) else {
                continue;
            };
            let _ = writeln!(text, "{} {}", line(image), line(depth));
        }
        if text.is_empty() {
            return Ok(());
        }
        write_whole(&folder.join("associations.txt"), text.as_bytes())
    }
}

/// Pairs each depth image with the nearest colour image of the depth camera.
fn camera_pairs(tables: &SequenceTables<'_>) -> Vec<(usize, usize)> {
    let times = |rows: &[ImageRow]| -> Vec<(usize, BoardNanos)> {
        rows.iter().map(|row| row.at).enumerate().collect()
    };
    pairs::find(&times(&tables.camera), &times(&tables.depth), NEAR)
        .iter()
        .map(|pair| (pair.color, pair.depth))
        .collect()
}

/// Formats time and path of an image.
fn line(row: &ImageRow) -> String {
    format!("{} {}", decimal_seconds(row.at.0, 6), row.path.display())
}

/// Writes a list of images, if there are any.
fn list(path: &Path, what: &str, rows: &[ImageRow]) -> io::Result<()> {
    if rows.is_empty() {
        return Ok(());
    }
    let mut text = format!("# {what}\n# times in seconds of board time\n# timestamp filename\n");
    for row in rows {
        let _ = writeln!(text, "{}", line(row));
    }
    write_whole(path, text.as_bytes())
}
