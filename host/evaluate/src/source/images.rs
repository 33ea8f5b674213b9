//! A folder of images, one a frame; or a single image.
//!
//! Files are taken in the order of their names, numbers in them compared as
//! numbers (`frame9` before `frame10`). When all names are integers of
//! nanoseconds, as an extracted recording has them, they are the frames' times.

use std::io::BufReader;
use std::path::{Path, PathBuf};

use files::Input;
use image::ImageReader;

use super::{FrameSource, FrameTimes, SourceInfo, check_size, read_timestamps};
use crate::EvaluateError;
use crate::frame::GreyView;

const ENDINGS: [&str; 6] = ["png", "jpg", "jpeg", "pgm", "ppm", "pnm"];
/// Longest file of an image, bytes: decoders hold it in memory.
const MAX_IMAGE: u64 = 256 << 20;
/// Rate taken for images whose names say no time, frames per second.
const DEFAULT_RATE: f64 = 30.0;

pub(super) fn is_image(path: &Path) -> bool {
    path.extension()
        .and_then(|e| e.to_str())
        .is_some_and(|e| ENDINGS.contains(&e.to_ascii_lowercase().as_str()))
}

pub(super) struct ImageFolder {
    info: SourceInfo,
    files: std::vec::IntoIter<PathBuf>,
    pixels: Vec<u8>,
}

impl ImageFolder {
    pub(super) fn open(path: &Path, timestamps: Option<&Path>) -> Result<Self, EvaluateError> {
        let mut files = Vec::new();
        if path.is_dir() {
            let io = EvaluateError::io(path);
            for entry in std::fs::read_dir(path).map_err(io)? {
                let file = entry.map_err(io)?.path();
                if file.is_file() && is_image(&file) {
                    files.push(file);
                }
            }
        } else {
            files.push(path.to_owned());
        }
        files.sort_by_cached_key(|f| natural_key(f));
        let first = files
            .first()
            .ok_or_else(|| EvaluateError::NoImages(path.to_owned()))?;
        let (width, height) = opened(first)?
            .into_dimensions()
            .map_err(|e| not_an_image(first, &e))?;
        let (width, height) = check_size(first, width.into(), height.into())?;

        let mut notes = Vec::new();
        let named: Option<Vec<i64>> = files.iter().map(|f| time_of_name(f)).collect();
        let times = match (timestamps, named) {
            (Some(file), _) => FrameTimes::Listed(read_timestamps(file)?),
            (None, Some(times)) if times.is_sorted_by(|a, b| a < b) => FrameTimes::Listed(times),
            _ => {
                if files.len() > 1 {
                    notes.push(format!(
                        "the images' names say no time: taken as {DEFAULT_RATE} frames per second"
                    ));
                }
                FrameTimes::Rate(DEFAULT_RATE)
            }
        };
        Ok(Self {
            info: SourceInfo {
                encoded: false,
                path: path.to_owned(),
                width,
                height,
                white: 253,
                frames: Some(files.len() as u64),
                times,
                notes,
            },
            files: files.into_iter(),
            pixels: Vec::new(),
        })
    }
}

impl FrameSource for ImageFolder {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Result<Option<GreyView<'_>>, EvaluateError> {
        let Some(file) = self.files.next() else {
            return Ok(None);
        };
        let image = opened(&file)?
            .decode()
            .map_err(|e| not_an_image(&file, &e))?
            .into_luma8();
        let (width, height) = (image.width() as usize, image.height() as usize);
        if (width, height) != (self.info.width, self.info.height) {
            return Err(EvaluateError::NotAnImage {
                path: file,
                message: format!(
                    "{width}x{height} pixels, the images before have {}x{}; a folder must hold the frames of one recording",
                    self.info.width, self.info.height
                ),
            });
        }
        self.pixels = image.into_raw();
        Ok(Some(GreyView {
            width,
            height,
            pixels: &self.pixels,
        }))
    }
}

fn opened(path: &Path) -> Result<ImageReader<BufReader<Input>>, EvaluateError> {
    let file = files::open(path).map_err(|e| not_an_image(path, &e))?;
    if file.length() > MAX_IMAGE {
        let what = format!("it is longer than {MAX_IMAGE} bytes, the most that is read");
        return Err(not_an_image(path, &what));
    }
    ImageReader::new(BufReader::new(file))
        .with_guessed_format()
        .map_err(|e| not_an_image(path, &e))
}

fn not_an_image(path: &Path, error: &dyn std::fmt::Display) -> EvaluateError {
    EvaluateError::NotAnImage {
        path: path.to_owned(),
        message: error.to_string(),
    }
}

/// A name of at least 12 digits is a time in nanoseconds; fewer are a number.
fn time_of_name(path: &Path) -> Option<i64> {
    let stem = path.file_stem()?.to_str()?;
    (stem.len() >= 12).then(|| stem.parse().ok()).flatten()
}

/// Text and numbers of a file name in turn, so that 9 sorts before 10.
fn natural_key(path: &Path) -> Vec<(u8, u128, String)> {
    let name = path
        .file_name()
        .map(|n| n.to_string_lossy().into_owned())
        .unwrap_or_default();
    let mut key = Vec::new();
    let mut rest = name.as_str();
    while let Some(c) = rest.chars().next() {
        let digits = c.is_ascii_digit();
        let end = rest
            .find(|c: char| c.is_ascii_digit() != digits)
            .unwrap_or(rest.len());
        let (part, tail) = rest.split_at(end);
        key.push(match part.parse::<u128>() {
            Ok(n) if digits => (0, n, String::new()),
            _ => (1, 0, part.to_owned()),
        });
        rest = tail;
    }
    key
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use crate::footage::Footage;

    fn write(path: &Path, width: u32, height: u32, value: u8) {
        image::GrayImage::from_pixel(width, height, image::Luma([value]))
            .save(path)
            .unwrap();
    }

    #[test]
    fn numbers_sort_as_numbers_and_other_files_are_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        for (name, value) in [("f10.png", 10), ("f9.png", 9), ("f100.pgm", 100)] {
            write(&dir.path().join(name), 8, 4, value);
        }
        std::fs::write(dir.path().join("notes.txt"), "x").unwrap();
        let mut source = ImageFolder::open(dir.path(), None).unwrap();
        assert_eq!((source.info().width, source.info().height), (8, 4));
        let mut seen = Vec::new();
        while let Some(frame) = source.next_frame().unwrap() {
            seen.push(frame.pixels[0]);
        }
        assert_eq!(seen, [9, 10, 100]);
    }

    #[test]
    fn a_rate_that_was_assumed_is_said() {
        let dir = tempfile::tempdir().unwrap();
        for number in 0..2 {
            write(&dir.path().join(format!("{number}.png")), 64, 240, 9);
        }
        let notes = Footage::read(dir.path(), &Settings::default(), None)
            .unwrap()
            .notes;
        assert!(notes[0].contains("say no time"), "{notes:?}");
    }

    #[test]
    fn names_of_nanoseconds_are_times() {
        let dir = tempfile::tempdir().unwrap();
        for t in [1_000_000_000_000i64, 1_000_033_000_000] {
            write(&dir.path().join(format!("{t}.png")), 8, 4, 1);
        }
        let source = ImageFolder::open(dir.path(), None).unwrap();
        assert_eq!(source.info().times.seconds(1), Some(0.033));
    }

    #[test]
    fn damaged_and_mixed_images_are_named() {
        let dir = tempfile::tempdir().unwrap();
        assert!(
            ImageFolder::open(dir.path(), None)
                .err()
                .unwrap()
                .to_string()
                .contains("no images")
        );
        write(&dir.path().join("1.png"), 8, 4, 1);
        write(&dir.path().join("2.png"), 8, 5, 1);
        let mut source = ImageFolder::open(dir.path(), None).unwrap();
        source.next_frame().unwrap();
        let e = source.next_frame().err().unwrap().to_string();
        assert!(e.contains("2.png") && e.contains("8x5"), "{e}");

        let bytes = std::fs::read(dir.path().join("1.png")).unwrap();
        std::fs::write(dir.path().join("0.png"), &bytes[..bytes.len() / 2]).unwrap();
        // The header is whole, the picture is not.
        let mut source = ImageFolder::open(dir.path(), None).unwrap();
        let e = source.next_frame().err().unwrap().to_string();
        assert!(e.contains("0.png"), "{e}");
    }
}
