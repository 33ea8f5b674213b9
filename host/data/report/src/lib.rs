//! Reports: what was recorded, extracted or measured, in words and pictures, and how good
//! it is.
//!
//! The crates below return plain results; here they become self-contained HTML pages and
//! the text of the terminal.
//!
//! - [`summary`] is the head of every report: what the terminal prints, and the page begins
//!   with. [`page`] is the frame of the rest, [`chart`] draws into it.
//! - [`session`], [`verification`], [`extraction`], [`evaluation`], [`board_test`]: a report each.
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

/// Writes a report whole or not at all. The folder may come from anywhere: a link of this
/// name is replaced, not followed.
fn put(path: &Path, html: &str) -> io::Result<()> {
    let mut file = system::new_file_in(path.parent().unwrap_or(Path::new(".")))?;
    file.write_all(html.as_bytes())?;
    system::put_in_place(file, path, true)
}
