//! The data set of the demonstration: extracted by the tool, and every time in it judged by
//! the ground truth.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use crate::judge::Truth;
use crate::programs::{Programs, ask};
use crate::whole_chain::Recorded;
use crate::whole_chain::extraction::{self, ExtractionFigures, table};
use rig::depth_camera::k4a_mkv::device_us;

/// A data set with its errors.
#[derive(Debug)]
pub struct DataSet {
    /// Its folder.
    pub folder: PathBuf,
    /// Its errors, by the ground truth.
    pub figures: ExtractionFigures,
    /// Pairs of pictures, as SVG.
    pub strip: String,
}

/// Extracts the recording in `folder`, whose phone's files lie beside it, and judges it.
///
/// # Errors
///
/// The extraction fails, or a frame, a pulse or a pair is not the true one.
pub fn make(
    mut truth: Truth,
    folder: &Path,
    phone: PathBuf,
    programs: &Programs,
) -> Result<DataSet> {
    ask(programs, &["verify"], &[folder])?;
    let report = ask(programs, &["extract", "--overwrite"], &[folder])?;
    let name = folder.file_name().context("the recording has no name")?;
    let data = folder.with_file_name(format!("{}-euroc", name.to_string_lossy()));

    // The frames that the camera made while its recorder ran.
    let delivered: HashSet<i64> = table(&data.join("depth_frames.csv"), &[1])?
        .iter()
        .filter_map(|row| row.first().copied().flatten())
        .collect();
    let device_ns = |ticks| i64::try_from(device_us(ticks) * 1_000).unwrap_or(i64::MAX);
    truth
        .depth
        .retain(|frame| delivered.contains(&device_ns(frame.device_ticks)));
    ensure!(
        truth.depth.len() == delivered.len(),
        "{} depth frames are in the data set, of which the camera made {}",
        delivered.len(),
        truth.depth.len()
    );
    let recorded = Recorded::new(folder.to_owned(), phone, PathBuf::new(), truth)?;
    let figures = extraction::judge(&recorded, &data, &report)?;
    let strip = data.join("sample_pairs.svg");
    let strip = std::fs::read_to_string(&strip)
        .with_context(|| format!("cannot read {}", strip.display()))?;
    Ok(DataSet {
        folder: data,
        figures,
        strip,
    })
}
