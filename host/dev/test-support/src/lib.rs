//! Helpers of the tests of several crates: pages of the book, reports in a browser, Python,
//! images of firmware, messages of a board, calibrations, folders, processes and their kills.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::missing_panics_doc
)]

pub mod board;
pub mod browser;
pub mod calibrations;
pub mod documents;
pub mod kills;
pub mod processes;
pub mod python;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

/// A temporary folder. If its test fails, the folder stays and its path is printed.
pub struct TestFolder(TempDir);

impl TestFolder {
    /// Makes a folder where the system keeps temporary files.
    #[must_use]
    pub fn new() -> Self {
        Self::from(tempfile::tempdir().unwrap())
    }

    /// Its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Default for TestFolder {
    fn default() -> Self {
        Self::new()
    }
}

impl From<TempDir> for TestFolder {
    fn from(folder: TempDir) -> Self {
        Self(folder)
    }
}

impl Drop for TestFolder {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.disable_cleanup(true);
            println!("files of the test: {}", self.path().display());
        }
    }
}

/// An image of firmware for `dfu-util`: what goes into the flash, and the suffix by its document
/// (USB DFU 1.1, appendix B), its CRC bit by bit.
#[must_use]
pub fn dfu_image(flash: Vec<u8>) -> Vec<u8> {
    let mut bytes = flash;
    bytes.extend(b"\xFF\xFF\x11\xDF\x83\x04\x00\x01UFD\x10");
    let mut crc = u32::MAX;
    for byte in &bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = (crc >> 1) ^ (if crc & 1 == 1 { 0xEDB8_8320 } else { 0 });
        }
    }
    bytes.extend(crc.to_le_bytes());
    bytes
}

/// All files and folders below a folder, in order.
#[must_use]
pub fn below(folder: &Path) -> Vec<PathBuf> {
    let mut all = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap() {
            let entry = entry.unwrap();
            if entry.file_type().unwrap().is_dir() {
                folders.push(entry.path());
            }
            all.push(entry.path());
        }
    }
    all.sort();
    all
}

/// The bytes of all files below a folder, by their path in it.
#[must_use]
pub fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let files = below(folder).into_iter().filter(|path| path.is_file());
    let name = |path: &Path| path.strip_prefix(folder).unwrap().to_owned();
    let named = files.map(|path| (name(&path), std::fs::read(path).unwrap()));
    named.collect()
}

/// The workspace's folder.
#[must_use]
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(3)
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
