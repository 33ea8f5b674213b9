//! Depth recordings: the camera's own files (MKV), the images in the board's bag, and bags
//! of the camera's ROS 2 driver.
//!
//! A recording is gone over twice: once for the times of its frames
//! ([`DepthInput::index`], no pixels are read), and once for the images
//! ([`DepthInput::images`]). Both give the frames in the same order, so that a
//! frame's number is its identity.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use super::board_data::{BagImage, BoardError, BoardEvent, BoardInput, BoardStream, Images};
use super::mkv::k4a::{Batch, ColorTrack, Content, K4aError, Recording};
use super::ros2_depth::{Ros2Bag, Ros2Error, Ros2Images};
use super::time::{DeviceNanos, SECOND};
use recording::foreign;
use twist_sync::GyroSample;

/// How many faults are kept with their text.
const MAX_FAULTS: usize = 50;

/// Where depth comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum DepthInput {
    /// A file of the camera's recorder.
    Mkv(PathBuf),
    /// `/azure/depth/image_raw` of the board's bag.
    Bag(PathBuf),
    /// A bag of the camera's ROS 2 driver.
    Ros2(Ros2Bag),
}

/// Why depth cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum DepthError {
    /// The recorder's file.
    #[error("{path}: {error}")]
    Mkv {
        /// Which.
        path: PathBuf,
        /// Why.
        error: K4aError,
    },
    /// Reading failed on the way.
    #[error("reading {path}: {error}")]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// The bag.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The bag of the camera's driver.
    #[error(transparent)]
    Ros2(#[from] Ros2Error),
}

/// A frame's time and size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DepthStamp {
    /// Device time.
    pub(crate) at: DeviceNanos,
    /// Whether it has the bytes of a whole image (unknown for bags before pixels
    /// are read: true).
    pub(crate) whole: bool,
}

/// What a depth recording holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct DepthIndex {
    /// Frames in the order of the file.
    pub(crate) frames: Vec<DepthStamp>,
    /// Width and height.
    pub(crate) size: (u32, u32),
    /// The camera's calibration.
    pub(crate) calibration: Option<Vec<u8>>,
    /// `K4A_DEPTH_MODE`.
    pub(crate) mode: Option<String>,
    /// `K4A_DEVICE_SERIAL_NUMBER`.
    pub(crate) serial: Option<String>,
    /// `K4A_WIRED_SYNC_MODE`.
    pub(crate) sync: Option<String>,
    /// `K4A_SUBORDINATE_DELAY_NS`: from the trigger's edge to the exposure of colour (of
    /// depth, without colour).
    pub(crate) subordinate_delay: i64,
    /// `K4A_DEPTH_DELAY_NS`: from the exposure of colour to that of depth.
    pub(crate) depth_delay: i64,
    /// The colour track.
    pub(crate) color: Option<ColorTrack>,
    /// Device times of the colour images.
    pub(crate) color_frames: Vec<DeviceNanos>,
    /// Who wrote the file anew with coarser times, in words.
    pub(crate) rewritten: Option<String>,
    /// Whether there are samples of the camera's IMU.
    pub(crate) has_imu: bool,
    /// What is damaged, in words.
    pub(crate) faults: Vec<String>,
}

/// An image of the recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum CameraImage {
    /// Depth, perhaps with infrared.
    Depth(DepthImage),
    /// Colour, by its number in the recording: the bytes of a JPEG file.
    Color(usize, Vec<u8>),
}

/// A frame with its pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DepthImage {
    /// Its number in the recording.
    pub(crate) index: usize,
    /// Big-endian millimetres; a whole image or nothing.
    pub(crate) depth: Vec<u8>,
    /// Big-endian infrared of the same time, if there is any.
    pub(crate) infrared: Option<Vec<u8>>,
    /// The checksum of its part of the file is wrong.
    pub(crate) damaged: bool,
}

impl DepthInput {
    /// The file.
    pub(crate) fn path(&self) -> &Path {
        match self {
            Self::Mkv(path) | Self::Bag(path) => path,
            Self::Ros2(bag) => &bag.path,
        }
    }

    /// The files that are read.
    pub(crate) fn files(&self) -> Vec<PathBuf> {
        match self {
            Self::Mkv(path) | Self::Bag(path) => vec![path.clone()],
            // A folder that cannot be read is met again when it is opened.
            Self::Ros2(bag) => foreign::parts(&bag.path).unwrap_or_default(),
        }
    }

    /// Bytes of it.
    pub(crate) fn length(&self) -> u64 {
        let files = self.files();
        let lengths = files.iter().filter_map(|file| file.metadata().ok());
        lengths.map(|file| file.len()).sum()
    }

    fn recording(path: &Path) -> Result<Recording<BufReader<File>>, DepthError> {
        Recording::open(path).map_err(|error| DepthError::Mkv {
            path: path.to_owned(),
            error,
        })
    }

    /// Reads times and what stands beside the images.
    ///
    /// # Errors
    ///
    /// It is no depth recording, or reading fails.
    pub(crate) fn index(&self, progress: &mut dyn FnMut(u64)) -> Result<DepthIndex, DepthError> {
        match self {
            Self::Mkv(path) => index_mkv(path, progress),
            Self::Bag(path) => index_bag(path, progress),
            Self::Ros2(bag) => index_ros2(bag, progress),
        }
    }

    /// The images.
    ///
    /// # Errors
    ///
    /// It cannot be opened.
    pub(crate) fn images(&self) -> Result<DepthImages, DepthError> {
        let source = match self {
            Self::Mkv(path) => Source::Mkv(Box::new(Self::recording(path)?)),
            Self::Bag(path) => Source::Bag(BoardInput::Bag(path.clone()).open(Images::Pixels)?),
            Self::Ros2(bag) => Source::Ros2(Box::new(bag.open(Images::Pixels)?)),
        };
        Ok(DepthImages {
            source,
            path: self.path().to_owned(),
            next: 0,
            next_color: 0,
            waiting: Vec::new().into_iter(),
        })
    }

    /// The camera's gyroscope, in order of time; of a bag there is none.
    ///
    /// # Errors
    ///
    /// It cannot be opened.
    pub(crate) fn gyro(
        &self,
    ) -> Result<impl Iterator<Item = Result<GyroSample, DepthError>> + use<>, DepthError> {
        let mut recording = match self {
            Self::Mkv(path) => Some(Self::recording(path)?),
            Self::Bag(_) | Self::Ros2(_) => None,
        };
        let path = self.path().to_owned();
        let batches = std::iter::from_fn(move || {
            let batch = recording.as_mut()?.next_batch(Content::Times);
            if !matches!(batch, Ok(Some(_))) {
                recording = None;
            }
            batch.map_err(reading(&path)).transpose()
        });
        let mut last = i64::MIN;
        let samples = batches.flat_map(move |batch| match batch {
            Err(error) => vec![Err(error)],
            Ok(batch) => {
                let mut samples = Vec::with_capacity(batch.imu.len());
                for sample in batch.imu {
                    if sample.gyro_at.0 > last {
                        last = sample.gyro_at.0;
                        samples.push(Ok(GyroSample {
                            at: last,
                            rate: sample.gyro.map(f64::from),
                        }));
                    }
                }
                samples
            }
        });
        Ok(samples)
    }
}

fn reading(path: &Path) -> impl Fn(std::io::Error) -> DepthError + '_ {
    |error| DepthError::Io {
        path: path.to_owned(),
        error,
    }
}

fn index_mkv(path: &Path, progress: &mut dyn FnMut(u64)) -> Result<DepthIndex, DepthError> {
    let mut recording = DepthInput::recording(path)?;
    let size = recording.image_bytes();
    let text = |name: &str| recording.tag(name).map(str::to_owned);
    let mut index = DepthIndex {
        size: recording.size(),
        calibration: recording.calibration().map(<[u8]>::to_vec),
        mode: text("K4A_DEPTH_MODE"),
        serial: text("K4A_DEVICE_SERIAL_NUMBER"),
        sync: text("K4A_WIRED_SYNC_MODE"),
        color: recording.color().cloned(),
        rewritten: recording.rewritten().map(|(by, unit)| {
            let by = if by.is_empty() { "another program" } else { by };
            format!(
                "{by} wrote the file anew and rounded the times of its frames to {} ms (the recorder \
                 writes them to 0.001 ms): give the recorder's own file with --depth",
                unit as f64 * 1e-6
            )
        }),
        ..DepthIndex::default()
    };
    for (name, delay) in [
        ("K4A_SUBORDINATE_DELAY_NS", &mut index.subordinate_delay),
        ("K4A_DEPTH_DELAY_NS", &mut index.depth_delay),
    ] {
        let Some(text) = text(name) else { continue };
        match text.trim().parse::<i64>() {
            // The recorder allows a frame's period.
            Ok(nanos) if nanos.abs() <= SECOND => *delay = nanos,
            _ => {
                let text: String = text.chars().take(32).collect();
                index.faults.push(format!(
                    "the tag {name} is {text:?}, expected nanoseconds up to a second: taken as 0"
                ));
            }
        }
    }
    loop {
        let batch = recording.next_batch(Content::Times);
        let Some(batch) = batch.map_err(reading(path))? else {
            break;
        };
        index.has_imu |= !batch.imu.is_empty();
        let stamps = batch.depth.iter().map(|image| DepthStamp {
            at: image.at,
            whole: image.size == size,
        });
        index.frames.extend(stamps);
        index
            .color_frames
            .extend(batch.color.iter().map(|image| image.at));
        progress(recording.position());
    }
    let damage = recording.damage().iter().take(MAX_FAULTS);
    index.faults.extend(damage.map(ToString::to_string));
    if !recording.was_closed() {
        index.faults.push(
            "the recorder did not close the file: its information, index and last moments are missing".into(),
        );
    }
    Ok(index)
}

fn index_bag(path: &Path, progress: &mut dyn FnMut(u64)) -> Result<DepthIndex, DepthError> {
    let mut stream = BoardInput::Bag(path.to_owned()).open(Images::Stamps)?;
    let mut index = DepthIndex::default();
    while let Some(event) = stream.next_event()? {
        if let BoardEvent::Image(image) = event {
            index.add(&image);
            progress(stream.position());
        }
    }
    Ok(index)
}

fn index_ros2(bag: &Ros2Bag, progress: &mut dyn FnMut(u64)) -> Result<DepthIndex, DepthError> {
    let mut images = bag.open(Images::Stamps)?;
    let mut index = DepthIndex::default();
    while let Some(image) = images.next_image()? {
        index.add(&image);
        progress(images.position());
    }
    index.faults = images.damage();
    Ok(index)
}

impl DepthIndex {
    /// A frame of a bag; the first says how large they are.
    fn add(&mut self, image: &BagImage) {
        if self.frames.is_empty() {
            self.size = (image.width, image.height);
        }
        self.frames.push(DepthStamp {
            at: DeviceNanos(image.stamp),
            whole: (image.width, image.height) == self.size,
        });
    }
}

enum Source {
    Mkv(Box<Recording<BufReader<File>>>),
    Bag(Box<dyn BoardStream>),
    Ros2(Box<Ros2Images>),
}

/// Images one after the other.
pub(crate) struct DepthImages {
    source: Source,
    path: PathBuf,
    next: usize,
    next_color: usize,
    waiting: std::vec::IntoIter<CameraImage>,
}

impl DepthImages {
    /// The next images (perhaps none); `None` at the end.
    fn read(&mut self) -> Result<Option<Vec<CameraImage>>, DepthError> {
        match &mut self.source {
            Source::Mkv(recording) => {
                let size = recording.image_bytes();
                let batch = recording.next_batch(Content::Pixels);
                let batch = batch.map_err(reading(&self.path))?;
                Ok(batch.map(|mut batch| {
                    let mut images = Vec::new();
                    for image in std::mem::take(&mut batch.color) {
                        images.push(CameraImage::Color(self.next_color, image.bytes));
                        self.next_color += 1;
                    }
                    images.extend(images_of(batch, size, &mut self.next));
                    images
                }))
            }
            Source::Bag(stream) => {
                let Some(event) = stream.next_event()? else {
                    return Ok(None);
                };
                let BoardEvent::Image(image) = event else {
                    return Ok(Some(Vec::new()));
                };
                Ok(Some(vec![self.of_bag(image)]))
            }
            Source::Ros2(images) => {
                let image = images.next_image()?;
                Ok(image.map(|image| vec![self.of_bag(image)]))
            }
        }
    }

    fn of_bag(&mut self, image: BagImage) -> CameraImage {
        let index = self.next;
        self.next += 1;
        CameraImage::Depth(DepthImage {
            index,
            depth: image.pixels,
            infrared: None,
            damaged: false,
        })
    }
}

impl Iterator for DepthImages {
    type Item = Result<CameraImage, DepthError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(image) = self.waiting.next() {
                return Some(Ok(image));
            }
            match self.read().transpose()? {
                Ok(images) => self.waiting = images.into_iter(),
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

fn images_of(batch: Batch, size: usize, next: &mut usize) -> Vec<CameraImage> {
    let mut infrared = batch.ir;
    let images = batch.depth.into_iter().map(|image| {
        let index = *next;
        *next += 1;
        let partner = infrared
            .iter()
            .position(|ir| ir.at == image.at && ir.bytes.len() == size);
        CameraImage::Depth(DepthImage {
            index,
            infrared: partner.map(|place| infrared.swap_remove(place).bytes),
            depth: if image.bytes.len() == size {
                image.bytes
            } else {
                Vec::new()
            },
            damaged: !batch.intact,
        })
    });
    images.collect()
}
