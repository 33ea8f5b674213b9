//! Layout of the published extractor: one folder per topic, with `/` replaced by `_`.
//!
//! | folder | content |
//! |---|---|
//! | `_mcu_imu/imu.csv` | `timestamp,ox,oy,oz,ax,ay,az,temperature`, no header |
//! | `_mcu_cameras_ts`, `_mcu_lidar_ts`, `_mcu_s10_ts`, `_depth_to_mcu_offset`, `_sequences_ts` | `time_ref.csv`: `seq,timestamp,time_ref` |
//! | `_azure_depth_image_raw`, `_azure_ir_image_raw` | PNG, 16 bits, mm, named by ns (19 digits) |
//! | `_azure_rgb_image_raw` | the depth camera's JPEG files, named by ns (an addition) |
//! | `smartphone_video_frames` | PNG, named by ns |
//! | `_smartphone_imu/imu.csv` | as `_mcu_imu`, without the temperature (an addition) |
//!
//! As with that extractor, image folders have a `transformation_metainf.csv` with the stamp
//! of each image on its camera's own clock, and the IMU's stamps are the data-ready
//! edges with no delay subtracted. Unlike there, depth is PNG and not NumPy.

use std::fmt::Write;
use std::io;
use std::path::Path;

use super::{
    DataSetInfo, ImageKind, ImageRow, ImuRow, ImuTable, Layout, SequenceTables, push_sample,
};
use crate::inputs::board_data::Reference;
use crate::output::tables::write_rows;

/// The layout of the published extractor.
pub(super) struct Topics;

/// Appends a sample of the board with its temperature.
fn board_row(row: &mut String, sample: &ImuRow) {
    push_sample(row, sample);
    row.push(',');
    if let Some(temperature) = sample.temperature {
        let _ = write!(row, "{temperature}");
    }
    row.push('\n');
}

impl Layout for Topics {
    fn folder(&self, kind: ImageKind) -> Option<&'static str> {
        Some(match kind {
            ImageKind::Color => "smartphone_video_frames",
            ImageKind::Depth => "_azure_depth_image_raw",
            ImageKind::Infrared => "_azure_ir_image_raw",
            ImageKind::Camera => "_azure_rgb_image_raw",
        })
    }

    fn board_imu(&self) -> ImuTable {
        ImuTable {
            path: "_mcu_imu/imu.csv",
            header: "",
            subtract_delay: false,
            row: board_row,
        }
    }

    fn phone_imu(&self) -> Option<ImuTable> {
        Some(ImuTable {
            subtract_delay: false,
            ..ImuTable::plain("_smartphone_imu/imu.csv", "")
        })
    }

    fn times_name(&self, of: &Reference, _lidar: Option<&str>) -> Option<String> {
        Some(match of {
            Reference::DepthOffset => String::from("/depth_to_mcu_offset"),
            Reference::Lidar => String::from("/mcu_lidar_ts"),
            Reference::Phone => String::from("/mcu_s10_ts"),
            Reference::Sequences => String::from("/sequences_ts"),
            Reference::Output(name) => format!("/output/{name}"),
        })
    }

    fn finish(
        &self,
        folder: &Path,
        tables: &SequenceTables<'_>,
        _facts: &DataSetInfo,
    ) -> io::Result<()> {
        transformation(folder, &tables.color)?;
        transformation(folder, &tables.depth)?;
        transformation(folder, &tables.infrared)?;
        transformation(folder, &tables.camera)?;
        if !tables.pulses.is_empty() {
            let rows = tables.pulses.iter();
            let rows = rows.map(|(seq, pulse)| (*seq, pulse.at, pulse.phone));
            let path = folder.join("_mcu_cameras_ts").join("time_ref.csv");
            write_rows(&path, "", rows)?;
        }
        for (of, name) in &tables.names {
            let pairs = tables.times.iter().filter(|pair| pair.of == **of);
            let rows = pairs.map(|pair| (pair.seq, pair.stamp, pair.other));
            write_rows(&folder.join(name).join("time_ref.csv"), "", rows)?;
        }
        Ok(())
    }
}

/// Writes the stamps of images into their folder.
fn transformation(folder: &Path, rows: &[ImageRow]) -> io::Result<()> {
    let Some(first) = rows.first() else {
        return Ok(());
    };
    let path = first.path.with_file_name("transformation_metainf.csv");
    let rows = rows.iter().enumerate();
    let rows = rows.map(|(seq, row)| (seq, row.own, row.at));
    write_rows(&folder.join(path), "seq,old_stamp,new_stamp\n", rows)
}

#[cfg(test)]
mod tests {
    use super::super::safe_name;

    #[test]
    fn topic_names_are_safe_folder_names() {
        assert_eq!(safe_name("/mcu_cameras_ts"), "_mcu_cameras_ts");
        assert_eq!(safe_name("/../../etc/passwd"), "_______etc_passwd");
    }
}
