//! Pulses of the further outputs and of the pulse per second, for the layouts that
//! have no folders of topics.
//!
//! `outputs/NAME.csv` with the board time of each pulse; a lidar's also has the UTC that
//! it was told for the same instant, and is `outputs/gnss.csv` if its name is not known.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::io;
use std::path::Path;

use super::{SequenceTables, harmless};
use crate::board_data::{LIDAR_TOPIC, OUTPUT_TOPICS};
use crate::image::write_whole;

/// Writes them below `folder`; nothing if there are none.
pub(super) fn write(folder: &Path, tables: &SequenceTables) -> io::Result<()> {
    let mut topics: Vec<&str> = tables
        .times
        .iter()
        .map(|pair| &*pair.topic)
        .filter(|topic| topic.starts_with(OUTPUT_TOPICS) || *topic == LIDAR_TOPIC)
        .collect();
    topics.sort_unstable();
    topics.dedup();
    let mut taken = BTreeSet::new();
    for topic in topics {
        let (name, header) = match topic.strip_prefix(OUTPUT_TOPICS) {
            Some(name) => (name, "#timestamp [ns]\n"),
            None => (
                tables.lidar.as_deref().unwrap_or("gnss"),
                "#timestamp [ns],utc [ns]\n",
            ),
        };
        let mut text = String::from(header);
        for pair in tables.times.iter().filter(|pair| &*pair.topic == topic) {
            let _ = match topic {
                LIDAR_TOPIC => writeln!(text, "{},{}", pair.stamp.0, pair.other),
                _ => writeln!(text, "{}", pair.stamp.0),
            };
        }
        let mut name = harmless(name);
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        let path = folder.join("outputs").join(format!("{name}.csv"));
        write_whole(&path, text.as_bytes())?;
    }
    Ok(())
}
