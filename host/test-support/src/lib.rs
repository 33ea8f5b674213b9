//! Helpers of the tests of several crates: pages of the book, reports in a browser, Python,
//! and processes that are interrupted.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::missing_panics_doc
)]

pub mod browser;
pub mod documents;
pub mod interrupts;
pub mod python;

use std::path::{Path, PathBuf};

/// The workspace's folder.
#[must_use]
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(2)
        .unwrap()
}

/// Cargo's target folder, wherever that is: the test that runs lies in it.
#[must_use]
pub fn target() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    test.ancestors()
        .find(|folder| folder.join("CACHEDIR.TAG").is_file())
        .unwrap()
        .to_owned()
}
