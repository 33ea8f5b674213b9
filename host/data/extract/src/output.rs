//! The output folder and the files in it that do not depend on the format.

pub mod folder;
pub(crate) mod image;
pub(crate) mod images;
pub(crate) mod imu_tables;
pub(crate) mod sample_pairs;
pub(crate) mod sequences;
pub(crate) mod tables;
