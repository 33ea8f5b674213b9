//! What `kalibr_bagcreater --folder` takes: images in `cam0`, `cam1` and the samples in
//! `imu0.csv`, `imu1.csv` beside them, all named and stamped by nanoseconds.
//!
//! | in `kalibr/` | what |
//! |---|---|
//! | `cam0` | the phone's camera |
//! | `cam1` | the depth camera's colour images, as the camera's JPEG files |
//! | `imu0.csv`, `imu1.csv` | the IMUs of board and phone: `timestamp,omega_x,…,alpha_z` |
//! | `imu0.yaml`, `imu1.yaml` | noise, topic and rate, as `--imu` takes them |
//! | `depth0`, `ir0` | depth (mm) and infrared, which Kalibr leaves alone |
//! | `times.yaml` | what was added to board time |
//!
//! The bag creator splits a stamp's text in seconds and its last nine digits: every time
//! has the offset of [`super::offset`].

use std::fmt::Write;
use std::io;
use std::path::Path;

use super::noise::Noise;
use super::offset::{moved, write_offset};
use super::{DataSetInfo, ImageKind, ImuTable, Layout, SequenceTables, number};
use crate::inputs::board_data::ImuRow;
use crate::output::image::write_whole;
use crate::time::{BoardNanos, in_name};

pub(super) struct Kalibr;

const IMU_HEADER: &str = "timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z\n";

fn moved_row(row: &mut String, sample: &ImuRow) {
    let sample = ImuRow {
        at: moved(sample.at),
        ..*sample
    };
    super::imu_row(row, &sample);
}

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
