//! Input of `kalibr_bagcreater --folder`: images in `cam0`, `cam1`, and samples in
//! `imu0.csv`, `imu1.csv` beside them, all named and stamped in nanoseconds.
//!
//! | in `kalibr/` | content |
//! |---|---|
//! | `cam0` | the phone's camera |
//! | `cam1` | the depth camera's colour images, as the camera's JPEG files |
//! | `imu0.csv`, `imu1.csv` | the IMUs of board and phone: `timestamp,omega_x,…,alpha_z` |
//! | `imu0.yaml`, `imu1.yaml` | noise, topic and rate, for `--imu` |
//! | `depth0`, `ir0` | depth (mm) and infrared, which Kalibr ignores |
//! | `times.yaml` | the offset from board time |
//!
//! The bag creator splits the text of a stamp before its last nine digits, so every time
//! has the offset of [`super::offset`], which makes it long enough.

use std::fmt::Write;
use std::io;
use std::path::Path;

use super::noise::Noise;
use super::offset::{moved, write_offset};
use super::{DataSetInfo, ImageKind, ImuRow, ImuTable, Layout, SequenceTables, number};
use crate::output::whole_file::write_whole;
use crate::time::{BoardNanos, in_name};

/// The layout for Kalibr.
pub(super) struct Kalibr;

const IMU_HEADER: &str = "timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z\n";

/// Appends a sample as a line, with the offset of times.
fn moved_row(row: &mut String, sample: &ImuRow) {
    let sample = ImuRow {
        at: moved(sample.at),
        ..*sample
    };
    super::imu_row(row, &sample);
}

/// Returns the table of an IMU.
const fn imu(path: &'static str) -> ImuTable {
    ImuTable {
        row: moved_row,
        ..ImuTable::plain(path, IMU_HEADER)
    }
}

impl Layout for Kalibr {
    fn folder(&self, kind: ImageKind) -> Option<&'static str> {
        Some(match kind {
            ImageKind::Color => "kalibr/cam0",
            ImageKind::Depth => "kalibr/depth0",
            ImageKind::Infrared => "kalibr/ir0",
            ImageKind::Camera => "kalibr/cam1",
        })
    }

    fn image_name(&self, at: BoardNanos) -> String {
        in_name(moved(at))
    }

    fn board_imu(&self) -> ImuTable {
        imu("kalibr/imu0.csv")
    }

    fn phone_imu(&self) -> Option<ImuTable> {
        Some(imu("kalibr/imu1.csv"))
    }

    fn finish(
        &self,
        folder: &Path,
        tables: &SequenceTables<'_>,
        facts: &DataSetInfo,
    ) -> io::Result<()> {
        let base = folder.join("kalibr");
        super::auxiliary::write(folder, tables)?;
        for (name, rate, noise) in facts.imus() {
            if let Some(rate) = rate {
                let text = imu_yaml(name, rate, &noise);
                write_whole(&base.join(format!("{name}.yaml")), text.as_bytes())?;
            }
        }
        write_offset(&base)
    }
}

/// Describes an IMU with its topic, rate (Hz) and noise.
fn imu_yaml(topic: &str, rate: f64, noise: &Noise) -> String {
    let mut text = noise.yaml();
    // Writing into a String cannot fail.
    let _ = write!(
        text,
        "rostopic: /{topic}\nupdate_rate: {}\n",
        number(rate, 6)
    );
    text
}
