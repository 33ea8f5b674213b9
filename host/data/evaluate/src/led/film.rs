//! A video as the brightness of its rows and columns against board time.

use std::path::Path;

use crate::EvaluateError;
use crate::footage::frame::{GreyView, RowProfile, RowReducer};
use crate::footage::source::Video;
use crate::footage::{FrameSource, Region};
use crate::led::Code;
use crate::stats::median;
use recording::profile::Direction;
use system::ReadMonitor;

/// Most groups of lines into which a picture is divided, along either side.
const GROUPS: usize = 160;

/// Most parts of the picture, along either side, in which the flashes are looked for singly.
const TILES: usize = 16;

/// Frames before and after a frame whose mean is taken off: what changes more slowly than the
/// bands walk over the picture goes.
const NEIGHBOURS: usize = 14;

/// Most frames that are read, ten minutes at 60 fps.
const MOST_FRAMES: usize = 36_000;

/// Side of the picture along which the sensor may read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Axis {
    /// Rows of the picture are rows of the sensor.
    Rows,
    /// Columns of the picture are rows of the sensor.
    Columns,
}

/// Groups of lines along one side.
#[derive(Debug, Clone, Default)]
struct Lines {
    /// Lines of the whole picture.
    count: usize,
    /// Middle of each group, lines from the picture's middle line.
    places: Vec<f64>,
    /// Brightness of each group in each frame less that of the neighbouring frames, frame by
    /// frame.
    light: Vec<f32>,
    /// 1-sigma of a group's brightness.
    sigmas: Vec<f64>,
}

/// One side of the picture.
#[derive(Debug, Clone, Default)]
struct Side {
    /// Lines over the whole picture.
    whole: Lines,
    /// Lines of strips across them; empty if the picture has too few lines.
    strips: Vec<Lines>,
}

/// A video reduced to what the measurement needs.
#[derive(Debug, Clone)]
pub struct Film {
    /// Board time of each frame's timestamp, µs.
    times_us: Vec<f64>,
    sides: [Side; 2],
    /// True if the frames went through a video encoder.
    pub(crate) is_encoded: bool,
}

/// The lines along one side of the picture, or of a strip of it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View<'a> {
    times_us: &'a [f64],
    lines: &'a Lines,
}

impl Film {
    /// Reads a video file; arguments and errors are those of [`read`](Self::read).
    pub fn read_file(
        path: &Path,
        times_us: &[f64],
        region: Option<Region>,
        monitor: &ReadMonitor,
    ) -> Result<Self, EvaluateError> {
        Self::read(&mut Video::open(path, monitor)?, times_us, region)
    }

    /// Reads a video whose frame `n` has its timestamp at `times_us[n]`, µs of board time. Frames
    /// beyond the last timestamp are left out.
    ///
    /// # Errors
    ///
    /// The video cannot be read, or the region is not in its picture.
    pub fn read(
        source: &mut dyn FrameSource,
        times_us: &[f64],
        region: Option<Region>,
    ) -> Result<Self, EvaluateError> {
        let info = source.info().clone();
        let reducer =
            |direction| RowReducer::new(info.width, info.height, direction, region, info.white);
        // A sensor has enough rows along one side at least.
        let reducers = match [reducer(Direction::Down), reducer(Direction::Right)] {
            [Err(error), Err(_)] => return Err(error),
            [Err(error), _] | [_, Err(error)]
                if !matches!(error, EvaluateError::TooFewRows { .. }) =>
            {
                return Err(error);
            }
            reducers => reducers.map(Result::ok),
        };
        let region = region.unwrap_or(Region {
            x: 0,
            y: 0,
            width: info.width,
            height: info.height,
        });
        let across = [region.width, region.height].map(|side| side.min(TILES));
        let mut sides = [Side::default(), Side::default()];
        for ((side, reducer), across) in sides.iter_mut().zip(&reducers).zip(across) {
            if let Some(reducer) = reducer {
                side.whole = Lines::of(reducer, GROUPS);
                side.strips = vec![Lines::of(reducer, TILES); across];
            }
        }
        let mut used = Vec::new();
        let mut profile = RowProfile::default();
        for &time_us in times_us.iter().take(MOST_FRAMES) {
            let Some(frame) = source.next_frame()? else {
                break;
            };
            let [columns, rows] = across;
            let tiles = tiles(&frame, &region, columns, rows);
            for (is_column, (side, reducer)) in [false, true]
                .into_iter()
                .zip(sides.iter_mut().zip(&reducers))
            {
                let Some(reducer) = reducer else { continue };
                reducer.reduce(frame, &mut profile)?;
                side.whole.push(&profile.rows);
                for (place, strip) in side.strips.iter_mut().enumerate() {
                    let (from, count, step) = if is_column {
                        (place * columns, columns, 1)
                    } else {
                        (place, rows, columns)
                    };
                    let along = tiles.iter().skip(from).step_by(step.max(1));
                    strip.light.extend(along.take(count));
                }
            }
            used.push(time_us);
        }
        for side in &mut sides {
            for lines in std::iter::once(&mut side.whole).chain(&mut side.strips) {
                lines.subtract_neighbours(used.len());
            }
        }
        Ok(Self {
            times_us: used,
            sides,
            is_encoded: info.encoded,
        })
    }

    const fn side(&self, axis: Axis) -> &Side {
        match axis {
            Axis::Rows => &self.sides[0],
            Axis::Columns => &self.sides[1],
        }
    }

    /// The lines along a side.
    pub(crate) fn view(&self, axis: Axis) -> View<'_> {
        View {
            times_us: &self.times_us,
            lines: &self.side(axis).whole,
        }
    }

    /// The lines of each strip across them.
    pub(crate) fn strips(&self, axis: Axis) -> impl ExactSizeIterator<Item = View<'_>> {
        self.side(axis).strips.iter().map(|lines| View {
            times_us: &self.times_us,
            lines,
        })
    }

    /// Number of frames with flashes next to them.
    pub(crate) fn frames_among(&self, code: &Code) -> usize {
        let times = self.times_us.iter();
        times.filter(|&&at| code.nearest(at).is_some()).count()
    }
}

impl<'a> View<'a> {
    /// Number of lines of the whole picture.
    pub(crate) const fn rows(&self) -> usize {
        self.lines.count
    }

    /// Middle of each group of lines, lines from the picture's middle line.
    pub(crate) fn places(&self) -> &'a [f64] {
        &self.lines.places
    }

    /// 1-sigma of each group's brightness.
    pub(crate) fn sigmas(&self) -> &'a [f64] {
        &self.lines.sigmas
    }

    /// Board time of each frame's timestamp, and the brightness of its groups.
    pub(crate) fn frames(&self) -> impl Iterator<Item = (f64, &'a [f32])> {
        let frames = self.lines.light.chunks_exact(self.places().len().max(1));
        self.times_us.iter().copied().zip(frames)
    }

    /// Board time of each frame's timestamp, µs.
    pub(crate) const fn times_us(&self) -> &'a [f64] {
        self.times_us
    }

    /// Brightness of a group of lines in each frame.
    pub(crate) fn group(&self, group: usize) -> impl Iterator<Item = f64> + use<'a> {
        let light = self.lines.light.iter().skip(group);
        light
            .step_by(self.lines.places.len().max(1))
            .map(|&light| light.into())
    }
}

/// Mean brightness of the tiles of a region, row by row.
fn tiles(frame: &GreyView<'_>, region: &Region, columns: usize, rows: usize) -> Vec<f32> {
    let mut tiles = Vec::with_capacity(columns * rows);
    let mut sums = vec![0_u32; columns];
    for row in 0..rows {
        let (from, to) = group_bounds(row, rows, region.height);
        sums.fill(0);
        let lines = frame.pixels.chunks_exact(frame.width.max(1));
        for line in lines.skip(region.y + from).take(to - from) {
            let line = line.get(region.x..).unwrap_or_default();
            for (column, sum) in sums.iter_mut().enumerate() {
                let (from, to) = group_bounds(column, columns, region.width);
                let part = line.get(from..to).unwrap_or_default();
                *sum += part.iter().map(|&pixel| u32::from(pixel)).sum::<u32>();
            }
        }
        let means = sums.iter().enumerate().map(|(column, &sum)| {
            let (left, right) = group_bounds(column, columns, region.width);
            (f64::from(sum) / ((right - left) * (to - from)).max(1) as f64) as f32
        });
        tiles.extend(means);
    }
    tiles
}

impl Lines {
    fn of(reducer: &RowReducer, most_groups: usize) -> Self {
        let (count, used) = (reducer.sensor_rows(), reducer.used_rows());
        let groups = used.min(most_groups);
        let middle = 0.5 * (count as f64 - 1.0);
        let first = reducer.first_row() as f64;
        let place = |group: usize| {
            let (from, to) = group_bounds(group, groups, used);
            first + 0.5 * (from + to - 1) as f64 - middle
        };
        Self {
            count,
            places: (0..groups).map(place).collect(),
            light: Vec::new(),
            sigmas: Vec::new(),
        }
    }

    fn push(&mut self, rows: &[f32]) {
        let groups = self.places.len();
        self.light.extend((0..groups).map(|group| {
            let (from, to) = group_bounds(group, groups, rows.len());
            let part = rows.get(from..to).unwrap_or_default();
            part.iter().sum::<f32>() / part.len().max(1) as f32
        }));
    }

    /// Takes the mean of the neighbouring frames off each group.
    fn subtract_neighbours(&mut self, frames: usize) {
        let groups = self.places.len();
        let mut column = vec![0.0; frames];
        for group in 0..groups {
            let values = self.light.iter().skip(group).step_by(groups);
            for (to, &from) in column.iter_mut().zip(values) {
                *to = f64::from(from);
            }
            subtract_neighbours(&mut column);
            let lights = self.light.iter_mut().skip(group).step_by(groups);
            for (light, &rest) in lights.zip(&column) {
                *light = rest as f32;
            }
            let sizes: Vec<f64> = column.iter().map(|rest| rest.abs()).collect();
            // Median of the sizes to the 1-sigma of a normal distribution; never below the
            // rounding of 8 bits over a line.
            self.sigmas.push((1.4826 * median(&sizes)).max(0.02));
        }
    }
}

/// Takes the mean of the neighbouring frames off a value of each frame.
pub(crate) fn subtract_neighbours(values: &mut [f64]) {
    let mut total = 0.0;
    let sums: Vec<f64> = std::iter::once(0.0)
        .chain(values.iter().map(|value| {
            total += value;
            total
        }))
        .collect();
    let frames = values.len();
    for (frame, value) in values.iter_mut().enumerate() {
        let from = frame.saturating_sub(NEIGHBOURS);
        let to = (frame + NEIGHBOURS + 1).min(frames);
        let sum = |place: usize| sums.get(place).copied().unwrap_or_default();
        *value -= (sum(to) - sum(from)) / (to - from) as f64;
    }
}

/// First line of a group, and the first after it.
const fn group_bounds(group: usize, groups: usize, lines: usize) -> (usize, usize) {
    (group * lines / groups, (group + 1) * lines / groups)
}
