//! EuRoC / ASL: folders below `mav0`, images named by nanoseconds (19 digits), `data.csv`
//! and `sensor.yaml` beside them.
//!
//! | folder | what |
//! |---|---|
//! | `cam0` | the phone's camera |
//! | `cam1` | the depth camera's colour images, as the camera's JPEG files |
//! | `imu0` | the board's IMU |
//! | `imu1` | the phone's IMU: accelerations interpolated to the gyroscope's times |
//! | `depth0`, `ir0` | depth (mm) and infrared: an extension of the format |

use std::fmt::Write;
use std::io;
use std::path::{Path, PathBuf};

use super::{Facts, ImageRow, ImuTable, Layout, SequenceTables, push_sample};
use crate::board_data::ImuRow;
use crate::image::write_whole;
use crate::time::{BoardNanos, in_name};

pub(super) struct Euroc;

const IMU_HEADER: &str = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],\
    a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n";

/// Noise of the board's MPU-9150: gyroscope 0.005 °/s/√Hz, accelerometer
/// 400 µg/√Hz (MPU-9150 product specification, 6.1 and 6.2). The random walks are
/// not specified; these are values usual for the part, to be replaced by an Allan
/// variance of the own one.
const MPU_9150_NOISE: Noise = Noise {
    gyro: 8.7e-5,
    gyro_walk: 2.0e-5,
    accel: 3.9e-3,
    accel_walk: 3.0e-3,
    source: "data sheet of the MPU-9150; random walks are usual values, not measured",
};

/// A phone's IMU, usual values.
const PHONE_NOISE: Noise = Noise {
    gyro: 1.7e-4,
    gyro_walk: 2.0e-5,
    accel: 2.0e-3,
    accel_walk: 3.0e-3,
    source: "usual values of phones, not measured",
};

struct Noise {
    gyro: f64,
    gyro_walk: f64,
    accel: f64,
    accel_walk: f64,
    source: &'static str,
}

fn imu_row(row: &mut String, sample: &ImuRow) {
    push_sample(row, sample);
    row.push('\n');
}

fn image(folder: &str, at: BoardNanos) -> PathBuf {
    PathBuf::from(format!("mav0/{folder}/data/{}.png", in_name(at)))
}

impl Layout for Euroc {
    fn color_path(&self, at: BoardNanos) -> PathBuf {
        image("cam0", at)
    }

    fn depth_path(&self, at: BoardNanos) -> PathBuf {
        image("depth0", at)
    }

    fn camera_path(&self, at: BoardNanos) -> Option<PathBuf> {
        Some(PathBuf::from(format!("mav0/cam1/data/{}.jpg", in_name(at))))
    }

    fn infrared_path(&self, at: BoardNanos) -> Option<PathBuf> {
        Some(image("ir0", at))
    }

    fn board_imu(&self) -> ImuTable {
        ImuTable {
            path: "mav0/imu0/data.csv",
            header: IMU_HEADER,
            subtract_delay: true,
            row: imu_row,
        }
    }

    fn phone_imu(&self) -> Option<ImuTable> {
        Some(ImuTable {
            path: "mav0/imu1/data.csv",
            header: IMU_HEADER,
            subtract_delay: true,
            row: imu_row,
        })
    }

    fn finish(&self, folder: &Path, tables: &SequenceTables<'_>, facts: &Facts) -> io::Result<()> {
        let base = folder.join("mav0");
        super::further::write(&base, tables)?;
        let middle = format!(
            "phone camera; times are the middle of exposure of the middle row, {} ns after the phone's \
             frame timestamp; intrinsics and T_BS are not known to the extractor",
            facts.color_middle
        );
        let center = format!(
            "depth in mm, 0 is none; times are the centre of exposure, {} ns after the trigger pulse",
            facts.depth_center
        );
        images(
            &base.join("cam0"),
            &tables.color,
            &middle,
            facts.color_rate,
            facts.color_size,
        )?;
        images(
            &base.join("cam1"),
            &tables.camera,
            "colour of the depth camera; times are the centre of exposure as the camera stamps it; intrinsics \
             and T_BS are not known to the extractor",
            facts.camera_rate,
            facts.camera_size,
        )?;
        images(
            &base.join("depth0"),
            &tables.depth,
            &center,
            facts.depth_rate,
            facts.depth_size,
        )?;
        images(
            &base.join("ir0"),
            &tables.infrared,
            "infrared of the depth camera; times as in depth0",
            facts.depth_rate,
            facts.depth_size,
        )?;
        if let Some(rate) = facts.board_imu_rate {
            let comment = format!(
                "IMU of the board; times are data-ready edges less the low-pass delay of {} ns",
                facts.board_imu_delay
            );
            let text = imu_yaml(&comment, rate, &MPU_9150_NOISE);
            write_whole(&base.join("imu0/sensor.yaml"), text.as_bytes())?;
        }
        if let Some(rate) = facts.phone_imu_rate {
            let comment = format!(
                "IMU of the phone in board time; accelerations interpolated to the gyroscope's times, \
                 low-pass delay of {} ns subtracted",
                facts.phone_imu_delay
            );
            let text = imu_yaml(&comment, rate, &PHONE_NOISE);
            write_whole(&base.join("imu1/sensor.yaml"), text.as_bytes())?;
        }
        write_whole(
            &base.join("body.yaml"),
            b"#Generated by smartdepthsync\ncomment: the body frame is that of the board's IMU (imu0)\n",
        )
    }
}

fn images(
    folder: &Path,
    rows: &[ImageRow],
    comment: &str,
    rate: Option<f64>,
    size: Option<(u32, u32)>,
) -> io::Result<()> {
    if rows.is_empty() {
        return Ok(());
    }
    let mut text = String::from("#timestamp [ns],filename\n");
    for row in rows {
        let name = row.path.file_name().unwrap_or_default();
        let _ = writeln!(text, "{},{}", in_name(row.at), name.display());
    }
    write_whole(&folder.join("data.csv"), text.as_bytes())?;
    let (width, height) = size.unwrap_or((0, 0));
    let yaml = format!(
        "sensor_type: camera\ncomment: {comment}\n{IDENTITY}rate_hz: {}\nresolution: [{width}, {height}]\n",
        number(rate.unwrap_or(0.0))
    );
    write_whole(&folder.join("sensor.yaml"), yaml.as_bytes())
}

/// Where a sensor sits is not known to the extractor.
const IDENTITY: &str = "T_BS:\n  cols: 4\n  rows: 4\n  data: [1.0, 0.0, 0.0, 0.0,\n         \
    0.0, 1.0, 0.0, 0.0,\n         0.0, 0.0, 1.0, 0.0,\n         0.0, 0.0, 0.0, 1.0]\n";

fn imu_yaml(comment: &str, rate: f64, noise: &Noise) -> String {
    format!(
        "sensor_type: imu\ncomment: {comment}\n{IDENTITY}rate_hz: {}\n\
         # noise: {}\n\
         gyroscope_noise_density: {:e}\ngyroscope_random_walk: {:e}\n\
         accelerometer_noise_density: {:e}\naccelerometer_random_walk: {:e}\n",
        number(rate),
        noise.source,
        noise.gyro,
        noise.gyro_walk,
        noise.accel,
        noise.accel_walk
    )
}

/// A rate with six digits and no trailing zeros.
fn number(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
