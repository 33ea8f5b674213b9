//! Images that are files only until they are part of a larger file.
//!
//! They are below `.parts`, so that a stopped extraction can continue. When the larger
//! file is complete they are removed, unless the next run can add to them. A larger file whose
//! images are gone is finished.

use std::fs;
use std::io;
use std::path::Path;

use super::SequenceTables;

/// Makes the file `whole` from the images by `make`, if they are there, and removes them.
pub(super) fn join(
    folder: &Path,
    whole: &Path,
    tables: &SequenceTables<'_>,
    make: impl FnOnce() -> io::Result<()>,
) -> io::Result<()> {
    let images = [
        &tables.color,
        &tables.camera,
        &tables.depth,
        &tables.infrared,
    ];
    let mut images = images.into_iter().flatten();
    // If the larger file were not whole, the images would have been written again.
    if !whole.exists() || images.all(|row| folder.join(&row.path).exists()) {
        make()?;
    }
    let parts = folder.join(".parts");
    if parts.exists() && !tables.unfinished {
        fs::remove_dir_all(parts)?;
    }
    Ok(())
}
