//! The output folder, and the files in it that are the same in all formats.

pub(crate) mod contents;
pub mod folder;
pub(crate) mod images;
pub(crate) mod imu_tables;
pub(crate) mod png_file;
pub(crate) mod sample_pairs;
pub(crate) mod sequences;
pub(crate) mod tables;
pub(crate) mod whole_file;
