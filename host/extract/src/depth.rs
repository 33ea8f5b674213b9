//! Depth recordings: the camera's own files (MKV) and the images in a bag.
//!
//! A recording is gone over twice: once for the times of its frames
//! ([`DepthInput::index`], no pixels are read), and once for the images
//! ([`DepthInput::images`]). Both give the frames in the same order, so that a
//! frame's number is its identity.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use super::board_data::{BoardError, BoardEvent, BoardInput, BoardStream, Images};
use super::mkv::k4a::{Batch, Content, K4aError, Recording, StartOffset};
use super::time::DeviceNanos;
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
    /// Where the device times begin.
    pub(crate) start_offset: Option<StartOffset>,
    /// The camera's calibration.
    pub(crate) calibration: Option<Vec<u8>>,
    /// `K4A_DEPTH_MODE`.
    pub(crate) mode: Option<String>,
    /// `K4A_DEVICE_SERIAL_NUMBER`.
    pub(crate) serial: Option<String>,
    /// `K4A_WIRED_SYNC_MODE`.
    pub(crate) sync_mode: Option<String>,
    /// Whether there are samples of the camera's IMU.
    pub(crate) has_imu: bool,
    /// What is damaged, in words.
    pub(crate) faults: Vec<String>,
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
        }
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
        }
    }

    /// The images, in batches.
    ///
    /// # Errors
    ///
    /// It cannot be opened.
    pub(crate) fn images(&self) -> Result<DepthImages, DepthError> {
        let source = match self {
            Self::Mkv(path) => Source::Mkv(Box::new(Self::recording(path)?)),
            Self::Bag(path) => Source::Bag(BoardInput::Bag(path.clone()).open(Images::Pixels)?),
        };
        Ok(DepthImages {
            source,
            path: self.path().to_owned(),
            next: 0,
        })
    }

    /// The camera's gyroscope.
    ///
    /// # Errors
    ///
    /// It cannot be opened.
    pub(crate) fn gyro(&self) -> Result<CameraGyro, DepthError> {
        match self {
            Self::Mkv(path) => Ok(CameraGyro {
                recording: Some(Self::recording(path)?),
                path: path.clone(),
                waiting: Vec::new(),
                last: i64::MIN,
            }),
            Self::Bag(path) => Ok(CameraGyro {
                recording: None,
                path: path.clone(),
                waiting: Vec::new(),
                last: i64::MIN,
            }),
        }
    }
}

fn index_mkv(path: &Path, progress: &mut dyn FnMut(u64)) -> Result<DepthIndex, DepthError> {
    let mut recording = DepthInput::recording(path)?;
    let size = recording.image_bytes();
    let text = |name: &str| recording.tag(name).map(str::to_owned);
    let mut index = DepthIndex {
        size: recording.size(),
        start_offset: Some(recording.start_offset()),
        calibration: recording.calibration().map(<[u8]>::to_vec),
        mode: text("K4A_DEPTH_MODE"),
        serial: text("K4A_DEVICE_SERIAL_NUMBER"),
        sync_mode: text("K4A_WIRED_SYNC_MODE"),
        ..DepthIndex::default()
    };
    loop {
        let batch = recording.next_batch(Content::Times);
        let batch = batch.map_err(|error| DepthError::Io {
            path: path.to_owned(),
            error,
        })?;
        let Some(batch) = batch else { break };
        index.has_imu |= !batch.imu.is_empty();
        let stamps = batch.depth.iter().map(|image| DepthStamp {
            at: image.at,
            whole: image.size == size,
        });
        index.frames.extend(stamps);
        progress(recording.position());
    }
    let damage = recording.damage().iter().take(MAX_FAULTS);
    index.faults = damage
        .map(|damage| {
            format!(
                "byte {}, {} bytes: {}",
                damage.at, damage.bytes, damage.what
            )
        })
        .collect();
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
            if index.frames.is_empty() {
                index.size = (image.width, image.height);
            }
            index.frames.push(DepthStamp {
                at: DeviceNanos(image.stamp),
                whole: (image.width, image.height) == index.size,
            });
            progress(stream.position());
        }
    }
    Ok(index)
}

enum Source {
    Mkv(Box<Recording<BufReader<File>>>),
    Bag(Box<dyn BoardStream>),
}

/// Images one batch after the other.
pub(crate) struct DepthImages {
    source: Source,
    path: PathBuf,
    next: usize,
}

impl DepthImages {
    /// The next images (perhaps none); `None` at the end.
    ///
    /// # Errors
    ///
    /// Reading fails.
    pub(crate) fn next_images(&mut self) -> Result<Option<Vec<DepthImage>>, DepthError> {
        match &mut self.source {
            Source::Mkv(recording) => {
                let size = recording.image_bytes();
                let batch = recording.next_batch(Content::Pixels);
                let batch = batch.map_err(|error| DepthError::Io {
                    path: self.path.clone(),
                    error,
                })?;
                Ok(batch.map(|batch| images_of(batch, size, &mut self.next)))
            }
            Source::Bag(stream) => loop {
                match stream.next_event()? {
                    None => return Ok(None),
                    Some(BoardEvent::Image(image)) => {
                        let index = self.next;
                        self.next += 1;
                        return Ok(Some(vec![DepthImage {
                            index,
                            depth: image.pixels,
                            infrared: None,
                            damaged: false,
                        }]));
                    }
                    Some(_) => {}
                }
            },
        }
    }
}

fn images_of(batch: Batch, size: usize, next: &mut usize) -> Vec<DepthImage> {
    let mut infrared = batch.ir;
    let images = batch.depth.into_iter().map(|image| {
        let index = *next;
        *next += 1;
        let partner = infrared
            .iter()
            .position(|ir| ir.at == image.at && ir.bytes.len() == size);
        DepthImage {
            index,
            infrared: partner.map(|place| infrared.swap_remove(place).bytes),
            depth: if image.bytes.len() == size {
                image.bytes
            } else {
                Vec::new()
            },
            damaged: !batch.intact,
        }
    });
    images.collect()
}

/// The camera's gyroscope as a stream.
pub(crate) struct CameraGyro {
    recording: Option<Recording<BufReader<File>>>,
    path: PathBuf,
    waiting: Vec<GyroSample>,
    last: i64,
}

impl Iterator for CameraGyro {
    type Item = Result<GyroSample, DepthError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(sample) = self.waiting.pop() {
                return Some(Ok(sample));
            }
            let batch = match self.recording.as_mut()?.next_batch(Content::Times) {
                Ok(Some(batch)) => batch,
                Ok(None) => {
                    self.recording = None;
                    return None;
                }
                Err(error) => {
                    self.recording = None;
                    return Some(Err(DepthError::Io {
                        path: self.path.clone(),
                        error,
                    }));
                }
            };
            for sample in batch.imu {
                if sample.gyro_at.0 > self.last {
                    self.last = sample.gyro_at.0;
                    self.waiting.push(GyroSample {
                        at: sample.gyro_at.0,
                        rate: sample.gyro.map(f64::from),
                    });
                }
            }
            // Given out from the end.
            self.waiting.reverse();
        }
    }
}
