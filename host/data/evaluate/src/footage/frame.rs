//! Reduction of a frame to the mean brightness of its sensor rows.
//!
//! A frame is reduced as soon as it arrives and then dropped: a minute of 4K
//! video needs as little memory as a second of it, apart from the profiles.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use recording::profile::Direction;

use crate::EvaluateError;

/// An 8-bit grey image, row by row without gaps.
#[derive(Debug, Clone, Copy)]
pub struct GreyView<'a> {
    /// Pixels in an image row.
    pub width: usize,
    /// Number of image rows.
    pub height: usize,
    /// `width · height` grey levels.
    pub pixels: &'a [u8],
}

/// A rectangle of the image, in image pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Region {
    /// Left edge.
    pub x: usize,
    /// Upper edge.
    pub y: usize,
    /// Width.
    pub width: usize,
    /// Height.
    pub height: usize,
}

impl fmt::Display for Region {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{},{}", self.x, self.y, self.width, self.height)
    }
}

impl FromStr for Region {
    type Err = EvaluateError;

    fn from_str(s: &str) -> Result<Self, Self::Err> {
        let wrong = || {
            EvaluateError::Setting(format!(
                "`{s}` is not a region: give X,Y,WIDTH,HEIGHT in pixels of the image"
            ))
        };
        let numbers: Vec<usize> = s
            .split(',')
            .map(|p| p.trim().parse().map_err(|_| wrong()))
            .collect::<Result<_, _>>()?;
        match numbers.as_slice() {
            &[x, y, width, height] if width > 0 && height > 0 => Ok(Self {
                x,
                y,
                width,
                height,
            }),
            _ => Err(wrong()),
        }
    }
}

/// Least number of rows: fewer do not contain two flashes of any sensor.
pub(crate) const MIN_ROWS: usize = 64;
/// Longest side of an image, so that a damaged header does not allocate gigabytes.
pub(crate) const MAX_SIDE: usize = phone::video::MAX_SIDE as usize;

/// Mean brightness of the used rows of one frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct RowProfile {
    /// Grey levels, in read-out order, one for each used sensor row.
    pub(crate) rows: Vec<f32>,
    /// Share of used pixels at the white end of the scale.
    pub(crate) saturated: f32,
}

/// Reducer of frames of one size to row profiles.
#[derive(Debug, Clone)]
pub(crate) struct RowReducer {
    pub(crate) width: usize,
    pub(crate) height: usize,
    readout: Direction,
    region: Region,
    white: u8,
}

impl RowReducer {
    /// Creates a reducer for frames of `width` × `height` pixels; `region` is in image pixels,
    /// and grey levels of `white` and above count as saturated.
    pub(crate) fn new(
        width: usize,
        height: usize,
        readout: Direction,
        region: Option<Region>,
        white: u8,
    ) -> Result<Self, EvaluateError> {
        let region = region.unwrap_or(Region {
            x: 0,
            y: 0,
            width,
            height,
        });
        let inside = |start: usize, length: usize, side: usize| {
            start.checked_add(length).is_some_and(|end| end <= side)
        };
        if !inside(region.x, region.width, width) || !inside(region.y, region.height, height) {
            return Err(EvaluateError::RegionOutside {
                region,
                width,
                height,
            });
        }
        let reducer = Self {
            width,
            height,
            readout,
            region,
            white,
        };
        let rows = reducer.used_rows();
        if rows < MIN_ROWS {
            return Err(EvaluateError::TooFewRows { rows });
        }
        Ok(reducer)
    }

    fn rows_are_columns(&self) -> bool {
        matches!(self.readout, Direction::Left | Direction::Right)
    }

    fn reversed(&self) -> bool {
        matches!(self.readout, Direction::Left | Direction::Up)
    }

    /// Returns the number of rows of the whole sensor.
    pub(crate) fn sensor_rows(&self) -> usize {
        if self.rows_are_columns() {
            self.width
        } else {
            self.height
        }
    }

    /// Returns the number of rows inside the region.
    pub(crate) fn used_rows(&self) -> usize {
        if self.rows_are_columns() {
            self.region.width
        } else {
            self.region.height
        }
    }

    /// Returns the number, in read-out order, of the first used row.
    pub(crate) fn first_row(&self) -> usize {
        let (start, length) = if self.rows_are_columns() {
            (self.region.x, self.region.width)
        } else {
            (self.region.y, self.region.height)
        };
        if self.reversed() {
            self.sensor_rows() - start - length
        } else {
            start
        }
    }

    /// Returns the line of a sensor row in the image, and true if rows are image columns.
    pub(crate) fn image_line(&self, sensor_row: f64) -> (f64, bool) {
        let line = if self.reversed() {
            self.sensor_rows() as f64 - 1.0 - sensor_row
        } else {
            sensor_row
        };
        (line, self.rows_are_columns())
    }

    /// Reduces one frame.
    pub(crate) fn reduce(
        &self,
        frame: GreyView<'_>,
        out: &mut RowProfile,
    ) -> Result<(), EvaluateError> {
        let expected = self.width * self.height;
        if (frame.width, frame.height) != (self.width, self.height)
            || frame.pixels.len() != expected
        {
            return Err(EvaluateError::FrameSize {
                got_width: frame.width,
                got_height: frame.height,
                width: self.width,
                height: self.height,
            });
        }
        let Region {
            x,
            y,
            width,
            height,
        } = self.region;
        let mut saturated = 0u64;
        let lines = frame
            .pixels
            .chunks_exact(self.width)
            .skip(y)
            .take(height)
            .filter_map(|line| line.get(x..x + width));
        out.rows.clear();
        if self.rows_are_columns() {
            let mut sums = vec![0u32; width];
            for line in lines {
                for (sum, &p) in sums.iter_mut().zip(line) {
                    *sum += u32::from(p);
                }
                saturated += count_white(line, self.white);
            }
            out.rows
                .extend(sums.iter().map(|&s| (f64::from(s) / height as f64) as f32));
        } else {
            for line in lines {
                let sum: u64 = line
                    .chunks(4096)
                    .map(|c| u64::from(c.iter().map(|&p| u32::from(p)).sum::<u32>()))
                    .sum();
                out.rows.push((sum as f64 / width as f64) as f32);
                saturated += count_white(line, self.white);
            }
        }
        if self.reversed() {
            out.rows.reverse();
        }
        out.saturated = saturated as f32 / (width * height) as f32;
        Ok(())
    }
}

fn count_white(line: &[u8], white: u8) -> u64 {
    line.chunks(255)
        .map(|c| {
            let n: u8 = c
                .iter()
                .fold(0, |n, &p| n.wrapping_add(u8::from(p >= white)));
            u64::from(n)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sensor picture whose row r is r everywhere, read out that way in the image.
    fn picture(readout: Direction, rows: usize, columns: usize) -> (usize, usize, Vec<u8>) {
        let (w, h) = match readout {
            Direction::Down | Direction::Up => (columns, rows),
            _ => (rows, columns),
        };
        let mut pixels = vec![0; w * h];
        for (i, p) in pixels.iter_mut().enumerate() {
            let (x, y) = (i % w, i / w);
            let row = match readout {
                Direction::Down => y,
                Direction::Left => w - 1 - x,
                Direction::Up => h - 1 - y,
                Direction::Right => x,
            };
            *p = row as u8;
        }
        (w, h, pixels)
    }

    #[test]
    fn every_direction_gives_rows_in_read_out_order() {
        for readout in [
            Direction::Down,
            Direction::Left,
            Direction::Up,
            Direction::Right,
        ] {
            let (width, height, pixels) = picture(readout, 100, 33);
            let reducer = RowReducer::new(width, height, readout, None, 98).unwrap();
            let mut out = RowProfile::default();
            let view = GreyView {
                width,
                height,
                pixels: &pixels,
            };
            reducer.reduce(view, &mut out).unwrap();
            let expected: Vec<f32> = (0..100).map(|r| r as f32).collect();
            assert_eq!(out.rows, expected, "{readout:?}");
            assert!((out.saturated - 0.02).abs() < 1e-6);
        }
    }

    #[test]
    fn a_region_keeps_the_row_numbers() {
        for (readout, region, first) in [
            (Direction::Down, "3,10,20,70", 10),
            (Direction::Up, "3,10,20,70", 20),
            (Direction::Right, "5,1,70,20", 5),
            (Direction::Left, "5,1,70,20", 25),
        ] {
            let (width, height, pixels) = picture(readout, 100, 33);
            let region = Some(region.parse().unwrap());
            let reducer = RowReducer::new(width, height, readout, region, 255).unwrap();
            let mut out = RowProfile::default();
            let view = GreyView {
                width,
                height,
                pixels: &pixels,
            };
            reducer.reduce(view, &mut out).unwrap();
            assert_eq!(reducer.first_row(), first, "{readout:?}");
            assert_eq!(out.rows.first(), Some(&(first as f32)));
            assert_eq!(out.rows.len(), 70);
            let (line, vertical) = reducer.image_line(first as f64);
            let at = if vertical {
                pixels[line as usize]
            } else {
                pixels[line as usize * width]
            };
            assert_eq!(usize::from(at), first);
        }
    }

    #[test]
    fn wrong_sizes_and_regions_are_refused() {
        let new = |w, h, region: &str| {
            let region = region.parse().ok();
            RowReducer::new(w, h, Direction::Down, region, 255)
        };
        let e = new(100, 100, "50,0,51,100").unwrap_err().to_string();
        assert!(e.contains("100x100"), "{e}");
        assert!(new(100, 100, &format!("{},0,2,100", usize::MAX)).is_err());
        assert!(new(100, 40, "").is_err());
        assert!("1,2,3".parse::<Region>().is_err());
        assert!("1,2,0,4".parse::<Region>().is_err());

        let reducer = new(100, 100, "").unwrap();
        let view = GreyView {
            width: 50,
            height: 100,
            pixels: &[0; 5000],
        };
        let e = reducer
            .reduce(view, &mut RowProfile::default())
            .unwrap_err()
            .to_string();
        assert!(e.contains("50x100") && e.contains("100x100"), "{e}");
    }
}
