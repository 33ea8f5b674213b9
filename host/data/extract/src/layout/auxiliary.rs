//! Pulses of the auxiliary outputs and of the pulse per second, for the layouts that
//! have no folders of topics.
//!
//! `outputs/NAME.csv` has the board time of each pulse. A lidar's file also has the UTC that
//! the lidar received for the same instant, and is `outputs/gnss.csv` if its name is unknown.

use std::io;
use std::path::Path;

use super::SequenceTables;
use crate::inputs::board_data::Reference;
use crate::output::tables::write_rows;

/// Writes the files below `folder`; none if there are no pulses.
pub(super) fn write(folder: &Path, tables: &SequenceTables<'_>) -> io::Result<()> {
    for (of, name) in &tables.names {
        let path = folder.join("outputs").join(format!("{name}.csv"));
        let pairs = tables.times.iter().filter(|pair| pair.of == **of);
        if **of == Reference::Lidar {
            let rows = pairs.map(|pair| (pair.stamp, pair.other));
            write_rows(&path, "#timestamp [ns],utc [ns]\n", rows)?;
        } else {
            let rows = pairs.map(|pair| (pair.stamp,));
            write_rows(&path, "#timestamp [ns]\n", rows)?;
        }
    }
    Ok(())
}
