//! TUM RGB-D: `rgb/` and `depth/` with images named by seconds (ten digits and six),
//! `rgb.txt`, `depth.txt`, `accelerometer.txt`, `associations.txt`; depth in 16
//! bits with 5,000 a metre, 0 for none.
//!
//! The format rounds times to microseconds; `pairs.csv` in the output folder has
//! nanoseconds. It has no place for angular rates and infrared.

use std::borrow::Cow;
use std::fmt::Write;
use std::io;
use std::path::{Path, PathBuf};

use super::{Facts, ImageRow, ImuTable, Layout, SequenceTables, slashed};
use crate::board_data::ImuRow;
use crate::image::{depth_to_tum, write_whole};
use crate::time::{BoardNanos, decimal_seconds, seconds_in_name};

pub(super) struct Tum;

fn accel_row(row: &mut String, sample: &ImuRow) {
    let [x, y, z] = sample.accel;
    // Writing into a String cannot fail.
    let _ = writeln!(row, "{} {x} {y} {z}", decimal_seconds(sample.at.0, 6));
}

fn image(folder: &str, at: BoardNanos) -> PathBuf {
    PathBuf::from(format!("{folder}/{}.png", seconds_in_name(at, 6)))
}

impl Layout for Tum {
    fn color_path(&self, at: BoardNanos) -> PathBuf {
        image("rgb", at)
    }

    fn depth_path(&self, at: BoardNanos) -> PathBuf {
        image("depth", at)
    }

    fn camera_path(&self, _at: BoardNanos) -> Option<PathBuf> {
        None
    }

    fn infrared_path(&self, _at: BoardNanos) -> Option<PathBuf> {
        None
    }

    fn depth_pixels<'a>(&self, millimetres: &'a [u8]) -> (Cow<'a, [u8]>, u64) {
        let (scaled, lost) = depth_to_tum(millimetres);
        (Cow::Owned(scaled), lost)
    }

    fn board_imu(&self) -> ImuTable {
        ImuTable {
            path: "accelerometer.txt",
            header: "# accelerometer data of the board\n# times in seconds of board time\n# timestamp ax ay az\n",
            subtract_delay: true,
            row: accel_row,
        }
    }

    fn phone_imu(&self) -> Option<ImuTable> {
        None
    }

    fn finish(&self, folder: &Path, tables: &SequenceTables<'_>, _facts: &Facts) -> io::Result<()> {
        super::further::write(folder, tables)?;
        list(&folder.join("rgb.txt"), "color images", &tables.color)?;
        list(&folder.join("depth.txt"), "depth maps", &tables.depth)?;
        let mut text = String::new();
        for &(color, depth) in &tables.pairs {
            let (Some(color), Some(depth)) = (tables.color.get(color), tables.depth.get(depth))
            else {
                continue;
            };
            let _ = writeln!(text, "{} {}", line(color), line(depth));
        }
        if text.is_empty() {
            return Ok(());
        }
        write_whole(&folder.join("associations.txt"), text.as_bytes())
    }
}

fn line(row: &ImageRow) -> String {
    format!("{} {}", decimal_seconds(row.at.0, 6), slashed(&row.path))
}

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
