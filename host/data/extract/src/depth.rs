//! Depth recordings: the camera's own files (MKV), and bags of the camera's ROS 2 driver.
//!
//! A recording is read twice: for the times of its frames
//! ([`DepthInput::index`], without pixels), and for the images
//! ([`DepthInput::images`]). Both return the frames in the same order, so that the index of a
//! frame identifies it.

pub(crate) mod depth_clock;
pub mod k4a;
pub(crate) mod matching;
mod mkv;
pub(crate) mod ros2_bag;

use std::io::BufReader;
use std::path::{Path, PathBuf};

use self::k4a::{Batch, ColorTrack, Content, K4aError, Recording};
use self::ros2_bag::{DriverImage, Ros2Bag, Ros2Error};
use crate::time::{DeviceNanos, SECOND};
use recording::bag::mcap_in;
use system::{Input, ReadMonitor};
use twist_sync::GyroSample;

/// Largest number of faults that are described.
const MAX_FAULTS: usize = 50;

/// Depth recording to read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum DepthInput {
    /// A file of the camera's recorder.
    Mkv(PathBuf),
    /// A bag of the camera's ROS 2 driver.
    Ros2(Ros2Bag),
}

/// Reason why a depth recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum DepthError {
    /// The recorder's file cannot be read.
    #[error("{path}: {error}")]
    Mkv {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        error: K4aError,
    },
    /// The bag of the camera's driver cannot be read.
    #[error(transparent)]
    Ros2(#[from] Ros2Error),
}

/// Time of a depth frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DepthStamp {
    /// Device time.
    pub(crate) at: DeviceNanos,
    /// False if bytes of the image are missing (for bags, whose pixels are not read yet, if its
    /// size differs from that of the first).
    pub(crate) whole: bool,
}

/// Contents of a depth recording, without pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct DepthIndex {
    /// Frames in the order of the file.
    pub(crate) frames: Vec<DepthStamp>,
    /// Width and height of the images.
    pub(crate) size: (u32, u32),
    /// The camera's `calibration.json`.
    pub(crate) calibration: Option<Vec<u8>>,
    /// `K4A_DEPTH_MODE`.
    pub(crate) mode: Option<String>,
    /// `K4A_DEVICE_SERIAL_NUMBER`.
    pub(crate) serial: Option<String>,
    /// `K4A_WIRED_SYNC_MODE`.
    pub(crate) sync: Option<String>,
    /// `K4A_SUBORDINATE_DELAY_NS`: time from the trigger's edge to the exposure of colour (of
    /// depth, without colour).
    pub(crate) subordinate_delay: i64,
    /// `K4A_DEPTH_DELAY_NS`: time from the exposure of colour to that of depth.
    pub(crate) depth_delay: i64,
    /// Colour track, if there is one.
    pub(crate) color: Option<ColorTrack>,
    /// Device times of the colour images.
    pub(crate) color_frames: Vec<DeviceNanos>,
    /// Message about the program that rewrote the file with coarser times, if one did.
    pub(crate) rewritten: Option<String>,
    /// True if there are samples of the camera's IMU.
    pub(crate) has_imu: bool,
    /// Descriptions of damage.
    pub(crate) faults: Vec<String>,
}

/// Image of a depth recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum CameraImage {
    /// Depth image, with infrared if there is any.
    Depth(DepthImage),
    /// Colour image: its index in the recording, and the bytes of a JPEG file.
    Color(usize, Vec<u8>),
}

/// Depth frame with its pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DepthImage {
    /// Index in the recording.
    pub(crate) index: usize,
    /// Big-endian 16-bit millimetres of the whole image; empty if bytes are missing.
    pub(crate) depth: Vec<u8>,
    /// Big-endian 16-bit infrared of the same time, if there is any.
    pub(crate) infrared: Option<Vec<u8>>,
    /// True if the checksum of its part of the file is wrong.
    pub(crate) damaged: bool,
}

impl DepthInput {
    /// Returns the files that are read.
    pub(crate) fn files(&self) -> Vec<PathBuf> {
        match self {
            Self::Mkv(path) => vec![path.clone()],
            // An unreadable folder is reported when it is opened.
            Self::Ros2(bag) => Vec::from_iter(mcap_in(&bag.path).ok()),
        }
    }

    /// Opens a file of the camera's recorder.
    fn recording(
        path: &Path,
        monitor: &ReadMonitor,
    ) -> Result<Recording<BufReader<Input>>, DepthError> {
        Recording::open(path, monitor).map_err(in_file(path))
    }

    /// Reads everything except pixels.
    ///
    /// # Errors
    ///
    /// Fails if it is not a depth recording, or cannot be read.
    pub(crate) fn index(&self, monitor: &ReadMonitor) -> Result<DepthIndex, DepthError> {
        match self {
            Self::Mkv(path) => index_mkv(path, monitor),
            Self::Ros2(bag) => index_ros2(bag, monitor),
        }
    }

    /// Opens the images.
    ///
    /// # Errors
    ///
    /// Fails if it cannot be opened.
    pub(crate) fn images(&self, monitor: &ReadMonitor) -> Result<CameraImages, DepthError> {
        Ok(match self {
            Self::Mkv(path) => {
                let recording = Self::recording(path, monitor)?;
                let size = recording.image_bytes();
                let (mut next, mut next_color) = (0, 0);
                let batches = batches(Some((recording, path.clone())), Content::Pixels);
                Box::new(batches.flat_map(move |batch| match batch {
                    Ok(batch) => images_of(batch, size, &mut next, &mut next_color),
                    Err(error) => vec![Err(error)],
                }))
            }
            Self::Ros2(bag) => {
                let mut images = bag.open(true, monitor)?;
                let images = std::iter::from_fn(move || images.next_image().transpose());
                Box::new(numbered(images.map(|image| Ok(image?))))
            }
        })
    }

    /// Opens the camera's gyroscope, in order of time; a bag has no samples.
    ///
    /// # Errors
    ///
    /// Fails if the recording cannot be opened.
    pub(crate) fn gyro(
        &self,
        monitor: &ReadMonitor,
    ) -> Result<impl Iterator<Item = Result<GyroSample, DepthError>> + use<>, DepthError> {
        let opened = match self {
            Self::Mkv(path) => Some((Self::recording(path, monitor)?, path.clone())),
            Self::Ros2(_) => None,
        };
        let mut last = i64::MIN;
        let batches = batches(opened, Content::Times);
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

/// Returns the contents of a file, cluster by cluster, up to the first that cannot be read.
fn batches(
    mut opened: Option<(Recording<BufReader<Input>>, PathBuf)>,
    content: Content,
) -> impl Iterator<Item = Result<Batch, DepthError>> {
    std::iter::from_fn(move || {
        let (recording, path) = opened.as_mut()?;
        let batch = recording.next_batch(content).map_err(in_file(path));
        if !matches!(batch, Ok(Some(_))) {
            opened = None;
        }
        batch.transpose()
    })
}

/// Adds the file to an error.
fn in_file(path: &Path) -> impl Fn(K4aError) -> DepthError + '_ {
    |error| DepthError::Mkv {
        path: path.to_owned(),
        error,
    }
}

/// Reads the index of a recorder's file.
fn index_mkv(path: &Path, monitor: &ReadMonitor) -> Result<DepthIndex, DepthError> {
    let mut recording = DepthInput::recording(path, monitor)?;
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
                "{by} rewrote the file and rounded the times of its frames to {} ms (the recorder \
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
        let Some(batch) = batch.map_err(in_file(path))? else {
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
    }
    let damage = recording.damage().iter().take(MAX_FAULTS);
    index.faults.extend(damage.cloned());
    if !recording.was_closed() {
        index.faults.push(
            "the recorder did not close the file: its information, index and last moments are missing".into(),
        );
    }
    Ok(index)
}

/// Reads the index of a bag.
fn index_ros2(bag: &Ros2Bag, monitor: &ReadMonitor) -> Result<DepthIndex, DepthError> {
    let mut images = bag.open(false, monitor)?;
    let mut index = DepthIndex::default();
    while let Some(image) = images.next_image()? {
        index.add(&image);
    }
    index.faults = images.damage();
    Ok(index)
}

impl DepthIndex {
    /// Adds a frame of a bag; the first one sets the size.
    fn add(&mut self, image: &DriverImage) {
        if self.frames.is_empty() {
            self.size = (image.width, image.height);
        }
        self.frames.push(DepthStamp {
            at: DeviceNanos(image.stamp),
            whole: (image.width, image.height) == self.size,
        });
    }
}

/// Images in the order of the recording.
type CameraImages = Box<dyn Iterator<Item = Result<CameraImage, DepthError>> + Send>;

/// Numbers the images of a bag.
fn numbered(
    images: impl Iterator<Item = Result<DriverImage, DepthError>>,
) -> impl Iterator<Item = Result<CameraImage, DepthError>> {
    images.enumerate().map(|(index, image)| {
        Ok(CameraImage::Depth(DepthImage {
            index,
            depth: image?.pixels,
            infrared: None,
            damaged: false,
        }))
    })
}

/// Returns the images of a cluster, numbered from `next` and `next_color` on; `size` is the
/// number of bytes of a whole depth image.
fn images_of(
    batch: Batch,
    size: usize,
    next: &mut usize,
    next_color: &mut usize,
) -> Vec<Result<CameraImage, DepthError>> {
    let mut images = Vec::new();
    for image in batch.color {
        images.push(Ok(CameraImage::Color(*next_color, image.bytes)));
        *next_color += 1;
    }
    let mut infrared = batch.ir;
    for image in batch.depth {
        let partner = infrared
            .iter()
            .position(|ir| ir.at == image.at && ir.bytes.len() == size);
        let is_whole = image.bytes.len() == size;
        images.push(Ok(CameraImage::Depth(DepthImage {
            index: *next,
            infrared: partner.map(|place| infrared.swap_remove(place).bytes),
            depth: if is_whole { image.bytes } else { Vec::new() },
            damaged: !batch.intact,
        })));
        *next += 1;
    }
    images
}
