//! Images that are files only until a larger file holds them.
//!
//! They lie below `.parts`, so that an extraction that was stopped goes on. When the larger
//! file is whole they are removed, unless the next run can add to them. One whose images are
//! gone is finished.

use std::fs;
use std::io;
use std::path::Path;

use super::SequenceTables;

/// Makes `whole` of the images by `make`, if they are there, and removes them.
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
    let gone = images.find(|row| !folder.join(&row.path).exists());
    match gone {
        Some(_) if whole.exists() => {}
        Some(_) => {
            return Err(io::Error::other(format!(
                "{} is gone, and so are the images that it was made of; extract again with --overwrite",
                whole.display()
            )));
        }
        None => make()?,
    }
    let parts = folder.join(".parts");
    if parts.exists() && !tables.unfinished {
        fs::remove_dir_all(parts)?;
    }
    Ok(())
}
