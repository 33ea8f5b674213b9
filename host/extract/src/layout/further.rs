//! Pulses of the further outputs and of the pulse per second, for the layouts that
//! have no folders of topics.
//!
//! `outputs/NAME.csv` with the board time of each pulse; a lidar's also has the UTC that
//! it was told for the same instant, and is `outputs/gnss.csv` if its name is not known.

use std::fmt::Write;
use std::io;
use std::path::Path;

use super::SequenceTables;
use crate::board_data::{LIDAR_TOPIC, OUTPUT_TOPICS};
use crate::image::write_whole;

/// The sensor's name.
pub(super) fn called_after<'a>(topic: &'a str, lidar: Option<&'a str>) -> Option<&'a str> {
    if topic == LIDAR_TOPIC {
        return Some(lidar.unwrap_or("gnss"));
    }
    topic.strip_prefix(OUTPUT_TOPICS)
}

/// Writes them below `folder`; nothing if there are none.
pub(super) fn write(folder: &Path, tables: &SequenceTables<'_>) -> io::Result<()> {
    for (topic, name) in &tables.names {
        let is_lidar = *topic == LIDAR_TOPIC;
        let mut text = String::from(if is_lidar {
            "#timestamp [ns],utc [ns]\n"
        } else {
            "#timestamp [ns]\n"
        });
        for pair in tables.times.iter().filter(|pair| &*pair.topic == *topic) {
            let _ = if is_lidar {
                writeln!(text, "{},{}", pair.stamp.0, pair.other)
            } else {
                writeln!(text, "{}", pair.stamp.0)
            };
        }
        let path = folder.join("outputs").join(format!("{name}.csv"));
        write_whole(&path, text.as_bytes())?;
    }
    Ok(())
}
