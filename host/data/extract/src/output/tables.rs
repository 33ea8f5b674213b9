//! The frames of both cameras as tables, with their times in board time.

use std::io::{self, Write as _};
use std::path::Path;

use recording::profile::Direction;
use serde::Serialize;

use crate::depth::DepthIndex;
use crate::depth::depth_clock::{DepthMatch, FrameState, PulseTime};
use crate::frames::pairs::{Pair, nearest};
use crate::output::image::WholeFile;
use crate::time::{BoardNanos, DeviceNanos, PhoneNanos, PiecewiseMap, SECOND};

/// A frame of the phone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ColorFrame {
    /// Its timestamp: start of exposure of the first row.
    pub(crate) phone: PhoneNanos,
    /// The same instant on the board.
    pub(crate) start: BoardNanos,
    /// Middle of exposure of the middle row on the board: the image's time.
    pub(crate) at: BoardNanos,
    /// Frame of the video, if there is one.
    pub(crate) image: Option<usize>,
}

/// A frame of the depth camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DepthFrame {
    /// Its timestamp on its own clock.
    pub(crate) device: DeviceNanos,
    /// Centre of exposure on the board; `None` if frames and pulses were not
    /// matched.
    pub(crate) at: Option<BoardNanos>,
    /// What it is; `None` if not matched.
    pub(crate) state: Option<FrameState>,
    /// Index of its pulse.
    pub(crate) pulse: Option<usize>,
    /// Frame − pulse on the fitted clock, ns.
    pub(crate) residual: i64,
    /// Whether it has the bytes of a whole image.
    pub(crate) whole: bool,
}

/// Time from one row (or column) to the next, ns, and where the readout goes.
pub(crate) type Shutter = (i64, Direction);

/// A colour image of the depth camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CameraFrame {
    /// Its timestamp on the camera's clock: the centre of exposure.
    pub(crate) device: DeviceNanos,
    /// The same on the board; `None` where the depth frame next to it has no time.
    pub(crate) at: Option<BoardNanos>,
}

impl DepthFrame {
    /// Whether it has a place in the data set.
    pub(crate) fn is_used(&self) -> bool {
        self.at.is_some() && self.whole && self.state != Some(FrameState::Doubled)
    }
}

/// The phone's frames in board time, each `to_middle` (ns) after its timestamp. Frames that
/// the clock does not map are left out (none, with a clock).
pub(crate) fn color_frames(
    stamps: &[PhoneNanos],
    images: &[Option<usize>],
    clock: &PiecewiseMap<PhoneNanos, BoardNanos>,
    to_middle: i64,
) -> Vec<ColorFrame> {
    let frame = |(row, &phone): (usize, &PhoneNanos)| {
        // Half of the exposure and the way to the row pass on the phone's clock.
        let middle = PhoneNanos(phone.0.saturating_add(to_middle));
        Some(ColorFrame {
            phone,
            start: clock.apply(phone)?,
            at: clock.apply(middle)?,
            image: images.get(row).copied().flatten(),
        })
    };
    stamps.iter().enumerate().filter_map(frame).collect()
}

/// The depth frames in board time.
pub(crate) fn depth_frames(
    index: &DepthIndex,
    found: Option<&DepthMatch>,
    pulses: &[PulseTime],
    center: i64,
) -> Vec<DepthFrame> {
    let frames = index.frames.iter().enumerate();
    frames
        .map(|(number, stamp)| {
            let assigned = found.and_then(|found| found.frames.get(number));
            let pulse = assigned.and_then(|assigned| assigned.pulse);
            // The pulse itself is exact; without one, the fitted clock has to do.
            let edge = match pulse.and_then(|pulse| pulses.get(pulse)) {
                Some(pulse) => Some(pulse.at),
                None => found.and_then(|found| found.clock.apply(stamp.at)),
            };
            DepthFrame {
                device: stamp.at,
                at: edge.map(|edge| BoardNanos(edge.0.saturating_add(center))),
                state: assigned.map(|assigned| assigned.state),
                pulse,
                residual: assigned.map_or(0, |assigned| assigned.residual),
                whole: stamp.whole,
            }
        })
        .collect()
}

/// The colour images of the depth camera in board time: as far from the depth frame next
/// to each as the camera's clock has it.
pub(crate) fn camera_frames(
    stamps: &[DeviceNanos],
    depth: &[DepthFrame],
    found: Option<&DepthMatch>,
) -> Vec<CameraFrame> {
    let mut near: Vec<(DeviceNanos, BoardNanos)> = depth
        .iter()
        .filter(|frame| frame.state != Some(FrameState::Doubled))
        .filter_map(|frame| Some((frame.device, frame.at?)))
        .collect();
    near.sort_by_key(|frame| frame.0);
    let time_of = |stamp: DeviceNanos| -> Option<BoardNanos> {
        let next = near[nearest(&near, stamp.0, |frame| frame.0.0)?];
        let clock = &found?.clock;
        let way = clock.apply(stamp)?.0.checked_sub(clock.apply(next.0)?.0)?;
        // A frame that has no depth frame near it is of a part without times.
        (way.abs() <= SECOND).then(|| BoardNanos(next.1.0.saturating_add(way)))
    };
    stamps
        .iter()
        .map(|&device| CameraFrame {
            device,
            at: time_of(device),
        })
        .collect()
}

/// Writes `camera_frames.csv`: the start of exposure only where the exposure is known.
///
/// # Errors
///
/// Writing fails.
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

/// Writes rows of cells after a header, which has its line end.
///
/// # Errors
///
/// Writing fails.
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

/// 1-sigma of depth − phone, ns, of a pair by the time of its phone frame, where it is known.
pub(crate) type PairSigma<'a> = Box<dyn Fn(BoardNanos) -> Option<i64> + 'a>;

/// Writes the tables of a phone that have rows: its frames, and their pairs.
///
/// # Errors
///
/// Writing fails.
pub(crate) fn write_phone(
    folder: &Path,
    (color, shutter): (&[ColorFrame], Option<Shutter>),
    (pairs, sigma): (&[Pair], &PairSigma<'_>),
    depth: &[DepthFrame],
) -> io::Result<()> {
    if !color.is_empty() {
        write_color(&folder.join("phone_frames.csv"), color, shutter)?;
    }
    if !pairs.is_empty() {
        write_pairs(&folder.join("pairs.csv"), (pairs, sigma), color, depth)?;
    }
    Ok(())
}

/// Writes `phone_frames.csv`.
///
/// # Errors
///
/// Writing fails.
fn write_color(path: &Path, frames: &[ColorFrame], shutter: Option<Shutter>) -> io::Result<()> {
    let header = "#frame,phone_timestamp [ns],start_of_exposure [ns],timestamp [ns],video_frame,\
                  row_time [ns],readout\n";
    let (row_time, readout) = shutter.unzip();
    let row = |(index, frame): (usize, &ColorFrame)| {
        let times = (frame.phone, frame.start, frame.at);
        (index, times, frame.image, row_time, readout)
    };
    write_rows(path, header, frames.iter().enumerate().map(row))
}

/// Writes `depth_frames.csv`.
///
/// # Errors
///
/// Writing fails.
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
/// Writing fails.
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

/// Writes `pairs.csv`. Indices are those of the frame tables.
///
/// # Errors
///
/// Writing fails.
fn write_pairs(
    path: &Path,
    (pairs, sigma): (&[Pair], &PairSigma<'_>),
    color: &[ColorFrame],
    depth: &[DepthFrame],
) -> io::Result<()> {
    let header = "#phone_frame,phone_timestamp [ns],depth_frame,depth_timestamp [ns],\
                  depth_minus_phone [ns],sigma [ns]\n";
    let row = |pair: &Pair| {
        let phone = color.get(pair.color).map(|frame| frame.at);
        let centre = depth.get(pair.depth).and_then(|frame| frame.at);
        let sigma = phone.and_then(sigma);
        (
            pair.color,
            phone,
            pair.depth,
            centre,
            pair.difference,
            sigma,
        )
    };
    write_rows(path, header, pairs.iter().map(row))
}
