//! CSV tables of pulses, frames and pairs.

use std::io::{self, Write as _};
use std::path::Path;

use recording::profile::Direction;
use serde::Serialize;

use super::whole_file::WholeFile;
use crate::depth::depth_clock::{FrameState, PulseTime};
use crate::frames::pairs::Pair;
use crate::frames::{CameraFrame, ColorFrame, DepthFrame};
use crate::time::BoardNanos;

/// Rolling shutter: time from one row (or column) to the next, ns, and direction of the readout.
pub(crate) type Shutter = (i64, Direction);

/// Writes `camera_frames.csv`. The start of exposure is empty unless `exposure` (ns) is known.
///
/// # Errors
///
/// Fails if the file cannot be written.
pub(crate) fn write_camera(
    path: &Path,
    frames: &[CameraFrame],
    exposure: Option<i64>,
) -> io::Result<()> {
    let header = "#frame,device_timestamp [ns],start_of_exposure [ns],timestamp [ns]\n";
    let row = |(index, frame): (usize, &CameraFrame)| {
        let known = frame.at.zip(exposure);
        let start = known.map(|(at, exposure)| at.0.saturating_sub(exposure / 2));
        (index, frame.device, start, frame.at)
    };
    write_rows(path, header, frames.iter().enumerate().map(row))
}

/// Writes a CSV file: `header`, which includes its line end, and rows of cells.
///
/// # Errors
///
/// Fails if the file cannot be written.
pub(crate) fn write_rows<T: Serialize>(
    path: &Path,
    header: &str,
    rows: impl Iterator<Item = T>,
) -> io::Result<()> {
    let mut file = WholeFile::create(path)?;
    file.write_all(header.as_bytes())?;
    let mut table = csv::WriterBuilder::new()
        .has_headers(false)
        .from_writer(&mut file);
    for row in rows {
        table.serialize(row)?;
    }
    table.flush()?;
    drop(table);
    file.finish()
}

/// 1-sigma of depth − phone, ns, by the time of a pair's phone frame; `None` if unknown.
type PairSigma<'a> = Box<dyn Fn(BoardNanos) -> Option<i64> + 'a>;

/// Rows of the tables of a phone.
pub(crate) struct PhoneTables<'a> {
    /// The phone's frames.
    pub(crate) color: &'a [ColorFrame],
    /// The phone's rolling shutter, if it is known.
    pub(crate) shutter: Option<Shutter>,
    /// Depth frames that the pairs refer to.
    pub(crate) depth: &'a [DepthFrame],
    /// Pairs of both.
    pub(crate) pairs: &'a [Pair],
    /// 1-sigma of the pairs.
    pub(crate) sigma: PairSigma<'a>,
}

impl PhoneTables<'_> {
    /// Writes `phone_frames.csv` and `pairs.csv` in `folder`, unless they have no rows.
    ///
    /// # Errors
    ///
    /// Fails if a file cannot be written.
    pub(crate) fn write(&self, folder: &Path) -> io::Result<()> {
        if !self.color.is_empty() {
            self.write_color(&folder.join("phone_frames.csv"))?;
        }
        if !self.pairs.is_empty() {
            self.write_pairs(&folder.join("pairs.csv"))?;
        }
        Ok(())
    }

    fn write_color(&self, path: &Path) -> io::Result<()> {
        let header = "#frame,phone_timestamp [ns],start_of_exposure [ns],timestamp [ns],video_frame,\
                      row_time [ns],readout\n";
        let (row_time, readout) = self.shutter.unzip();
        let row = |(index, frame): (usize, &ColorFrame)| {
            let times = (frame.phone, frame.start, frame.at);
            (index, times, frame.image, row_time, readout)
        };
        write_rows(path, header, self.color.iter().enumerate().map(row))
    }

    fn write_pairs(&self, path: &Path) -> io::Result<()> {
        let header = "#phone_frame,phone_timestamp [ns],depth_frame,depth_timestamp [ns],\
                      depth_minus_phone [ns],sigma [ns]\n";
        let row = |pair: &Pair| {
            let phone = self.color.get(pair.color).map(|frame| frame.at);
            let centre = self.depth.get(pair.depth).and_then(|frame| frame.at);
            let sigma = phone.and_then(&self.sigma);
            (
                pair.color,
                phone,
                pair.depth,
                centre,
                pair.difference,
                sigma,
            )
        };
        write_rows(path, header, self.pairs.iter().map(row))
    }
}

/// Writes `depth_frames.csv`.
///
/// # Errors
///
/// Fails if the file cannot be written.
pub(crate) fn write_depth(
    path: &Path,
    frames: &[DepthFrame],
    pulses: &[PulseTime],
) -> io::Result<()> {
    let header = "#frame,device_timestamp [ns],timestamp [ns],pulse,train,number,residual [ns],state,whole\n";
    let row = |(index, frame): (usize, &DepthFrame)| {
        let pulse = frame.pulse.and_then(|pulse| pulses.get(pulse));
        (
            (index, frame.device, frame.at, frame.pulse),
            pulse.map(|pulse| pulse.train),
            pulse.map(|pulse| pulse.number),
            frame.residual,
            frame.state.unwrap_or(FrameState::NotMatched),
            u8::from(frame.whole),
        )
    };
    write_rows(path, header, frames.iter().enumerate().map(row))
}

/// Writes `pulses.csv`.
///
/// # Errors
///
/// Fails if the file cannot be written.
pub(crate) fn write_pulses(
    path: &Path,
    pulses: &[PulseTime],
    frames: &[DepthFrame],
) -> io::Result<()> {
    let mut frame_of = vec![None; pulses.len()];
    for (index, frame) in frames.iter().enumerate() {
        let matched = frame.state == Some(FrameState::Matched);
        if let Some(slot) = frame
            .pulse
            .filter(|_| matched)
            .and_then(|pulse| frame_of.get_mut(pulse))
        {
            *slot = Some(index);
        }
    }
    let rows = pulses.iter().zip(frame_of).enumerate();
    let rows =
        rows.map(|(index, (pulse, frame))| (index, pulse.train, pulse.number, pulse.at, frame));
    let header = "#pulse,train,number,timestamp [ns],depth_frame\n";
    write_rows(path, header, rows)
}
