//! A video reduced to the row profiles of its frames and one picture for the report.

pub(crate) mod frame;
mod input;
pub(crate) mod source;
pub(crate) mod store;
mod trigger;

use std::path::{Path, PathBuf};

pub use self::frame::{GreyView, Region};
use self::frame::{RowProfile, RowReducer};
use self::input::Applied;
use self::source::Video;
pub use self::source::{FrameSource, FrameTimes, SourceInfo, read_timestamps};
use self::store::{DEFAULT_CAPACITY, ProfileStore, StoredFrame};
use self::trigger::Trigger;
use crate::train::search::RowGrid;
use crate::{EvaluateError, Settings};

/// Longest side of the picture kept for the report, pixels.
const PICTURE_SIDE: usize = 960;

/// Least distance of the frames that become the picture: so one of the last 16 frames
/// with flashes, on which a precision is measured, may be it.
const PICTURE_EVERY: usize = 6;

/// Least contrast of the picture's frame, relative to the strongest so far.
const PICTURE_CONTRAST: f64 = 0.7;

/// A frame of reduced size for the report.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Picture {
    /// Number of the frame in its recording, from 0.
    pub index: usize,
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// `width · height` grey levels, row by row.
    pub pixels: Vec<u8>,
    /// Image pixels in one pixel of the picture, along each side.
    pub(crate) reduction: usize,
    /// Largest contrast of any frame so far.
    strongest: f64,
}

/// A recording reduced to row profiles.
#[derive(Debug, Clone)]
pub struct Footage {
    pub(crate) path: PathBuf,
    /// Alignment of the recording, if its session has one.
    pub(crate) applied: Option<Applied>,
    /// The board's pulses, if the recording has them.
    pub(crate) trigger: Option<Trigger>,
    /// Time of the first frame on the phone's clock of frames, ns, if it is known.
    pub(crate) first_ns: Option<i64>,
    /// Layout of the rows in the image.
    pub(crate) reducer: RowReducer,
    /// Number of the sensor's middle row, from 0.
    pub(crate) middle_row: f64,
    /// Used rows relative to the middle row.
    pub(crate) rows: RowGrid,
    /// Retained frames.
    pub(crate) frames: Vec<StoredFrame>,
    /// Frames read in the chosen window.
    pub(crate) read: usize,
    /// One of the last frames with as much contrast between rows as any.
    pub(crate) picture: Picture,
    /// True if the frames went through a video encoder.
    pub(crate) encoded: bool,
    /// Remarks for the user.
    pub(crate) notes: Vec<String>,
}

impl Footage {
    /// Reads the video in a recording's folder, or a video file.
    ///
    /// `expected` is the size (width, height) of earlier recordings, if there are any.
    ///
    /// # Errors
    ///
    /// Fails if the video cannot be read, has another size than expected, has no frames in the
    /// chosen time, or does not contain the region.
    pub fn read(
        path: &Path,
        settings: &Settings,
        expected: Option<(usize, usize)>,
    ) -> Result<Self, EvaluateError> {
        let input = input::resolve(path, &settings.monitor)?;
        let mut source = Video::open(&input.path, &settings.monitor)?;
        let footage = Self::from_source(&mut source, settings, expected)?;
        Ok(Self {
            applied: input.applied,
            trigger: input.trigger,
            ..footage
        })
    }

    /// Reads another part of the same video. Errors are those of [`read`](Self::read).
    pub(crate) fn read_part(&self, settings: &Settings) -> Result<Self, EvaluateError> {
        let mut source = Video::open(&self.path, &settings.monitor)?;
        let footage = Self::from_source(&mut source, settings, None)?;
        Ok(Self {
            applied: self.applied,
            trigger: self.trigger.clone(),
            ..footage
        })
    }

    /// Reads an opened source to its end. Arguments and errors are those of
    /// [`read`](Self::read).
    pub fn from_source(
        source: &mut dyn FrameSource,
        settings: &Settings,
        expected: Option<(usize, usize)>,
    ) -> Result<Self, EvaluateError> {
        let info = source.info().clone();
        if let Some((width, height)) = expected.filter(|&e| e != (info.width, info.height)) {
            return Err(EvaluateError::FrameSize {
                got_width: info.width,
                got_height: info.height,
                width,
                height,
            });
        }
        let reducer = RowReducer::new(
            info.width,
            info.height,
            settings.readout,
            settings.region,
            info.white,
        )?;
        let middle_row = 0.5 * (reducer.sensor_rows() as f64 - 1.0);
        let rows = RowGrid {
            first: reducer.first_row() as f64 - middle_row,
            step: 1.0,
            len: reducer.used_rows(),
        };
        let mut store = ProfileStore::new(DEFAULT_CAPACITY);
        let mut profile = RowProfile::default();
        let mut picture = Picture::default();
        let (mut read, mut saturated, mut untimed) = (0, 0.0f32, 0usize);
        for index in 0.. {
            let Some(frame) = source.next_frame()? else {
                break;
            };
            let Some(time_s) = info.times.seconds(index) else {
                untimed += 1;
                continue;
            };
            if settings.to_s.is_some_and(|to| time_s >= to) {
                break;
            }
            if settings.from_s.is_some_and(|from| time_s < from) {
                continue;
            }
            reducer.reduce(frame, &mut profile)?;
            read += 1;
            saturated = saturated.max(profile.saturated);
            picture.offer(frame, index, contrast(&profile.rows));
            store.push(index, time_s, &profile);
        }
        let mut notes = source.info().notes.clone();
        notes.extend(remarks(untimed, store.one_in(), saturated));
        if read == 0 {
            return Err(EvaluateError::NoFrames {
                path: info.path,
                from_s: settings.from_s.unwrap_or(0.0),
                to_s: settings
                    .to_s
                    .map_or("the end".to_owned(), |s| format!("{s} s")),
            });
        }
        Ok(Self {
            path: info.path,
            applied: None,
            trigger: None,
            first_ns: info.times.first_ns(),
            reducer,
            middle_row,
            rows,
            frames: store.into_frames(),
            read,
            picture,
            encoded: info.encoded,
            notes,
        })
    }
}

/// Remarks about the reading of the frames.
fn remarks(untimed: usize, one_in: u64, saturated: f32) -> Vec<String> {
    let mut notes = Vec::new();
    if untimed > 0 {
        notes.push(format!(
            "{untimed} frames beyond the end of the timestamp file left out"
        ));
    }
    if one_in > 1 {
        notes.push(format!(
            "long recording: one in {one_in} frames, chosen at random, was used"
        ));
    }
    if saturated > 0.02 {
        notes.push(format!(
            "up to {:.0} % of the pixels are saturated: less light, a shorter exposure or a region without the bright part is better",
            100.0 * saturated
        ));
    }
    notes
}

impl Picture {
    /// Replaces the picture by a frame if that has about as much contrast as any before, and
    /// comes long enough after the current one.
    fn offer(&mut self, frame: GreyView<'_>, index: usize, contrast: f64) {
        let first = self.strongest == 0.0;
        self.strongest = self.strongest.max(contrast);
        let due = first || index >= self.index + PICTURE_EVERY;
        if due && contrast >= PICTURE_CONTRAST * self.strongest {
            *self = Self {
                strongest: self.strongest,
                ..shrink(frame, index)
            };
        }
    }
}

/// Mean square of the differences of rows one flash apart: large with bands, small for
/// smooth pictures.
fn contrast(rows: &[f32]) -> f64 {
    let apart = (rows.len() / 90).max(1);
    let sum: f64 = rows
        .iter()
        .zip(rows.iter().skip(apart))
        .map(|(a, b)| f64::from(a - b).powi(2))
        .sum();
    sum / rows.len().max(1) as f64
}

/// Reduces a frame to every n-th pixel.
fn shrink(frame: GreyView<'_>, index: usize) -> Picture {
    let reduction = frame.width.max(frame.height).div_ceil(PICTURE_SIDE).max(1);
    let lines = frame.pixels.chunks_exact(frame.width).step_by(reduction);
    let pixels: Vec<u8> = lines
        .flat_map(|line| line.iter().step_by(reduction).copied())
        .collect();
    Picture {
        index,
        width: frame.width.div_ceil(reduction),
        height: frame.height.div_ceil(reduction),
        pixels,
        reduction,
        strongest: 0.0,
    }
}
