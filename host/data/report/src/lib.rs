//! Reports on recordings, extractions, measurements and board tests, with a verdict, in words
//! and pictures.
//!
//! Other crates return plain results; this one makes self-contained HTML pages and the text of
//! the terminal from them.
//!
//! - [`summary`] is the head of every report: the terminal prints it, and the page begins
//!   with it. [`page`] assembles the page, [`chart`] draws its figures.
//! - [`session`], [`verification`], [`extraction`], [`evaluation`], [`board_test`] make one
//!   report each.
#![forbid(unsafe_code)]

pub mod board_test;
pub mod chart;
pub mod evaluation;
pub mod extraction;
pub mod page;
pub mod session;
pub mod summary;
pub mod verification;

use std::io::{self, Write as _};
use std::path::Path;

/// Name of a report in the folder of a recording or of a data set.
pub const REPORT_FILE: &str = "report.html";

/// Writes a report in one step, so that no partial file remains. A symbolic link of this name,
/// which a foreign folder may contain, is replaced and not followed.
fn put(path: &Path, html: &str) -> io::Result<()> {
    let mut file = system::new_file_in(path.parent().unwrap_or(Path::new(".")))?;
    file.write_all(html.as_bytes())?;
    system::put_in_place(file, path, true)
}
