//! Writes images in parallel: one thread reads the source, the others encode.
//!
//! An image that exists is compared with the one that would be written, and written again if it
//! differs. A finished step keeps a checksum over all its images, by which a later run sees
//! whether they are still there. Memory is limited to a few batches.

use std::borrow::Cow;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;

use phone::video::Video;
use rayon::prelude::*;

use super::png_file::{PngPixels, encode_png};
use super::whole_file::write_whole;
use crate::depth::{CameraImage, DepthImage, DepthInput};
use crate::error::ExtractError;
use crate::geometry::register::Registration;
use crate::layout::Layout;
use system::ReadMonitor;

/// Size of a batch, bytes.
const BATCH_BYTES: usize = 16 << 20;
/// Largest number of images in a batch.
const BATCH_IMAGES: usize = 64;

/// Files of one depth frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct DepthPaths {
    /// File of the depth image; `None` if the frame has no place in the data set.
    pub(crate) depth: Option<PathBuf>,
    /// File of the infrared image, if it is wanted.
    pub(crate) infrared: Option<PathBuf>,
}

/// Files of all images of the depth camera, one entry per frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct CameraPaths {
    /// Files of depth and infrared.
    pub(crate) depth: Vec<DepthPaths>,
    /// Files of colour, in JPEG.
    pub(crate) color: Vec<Option<PathBuf>>,
}

/// View in which depth images are written.
#[derive(Clone, Copy)]
pub(crate) struct DepthImageView<'a> {
    /// Width and height of the depth camera's own images.
    pub(crate) size: (u32, u32),
    /// Registration into the view of another camera, if there is one.
    pub(crate) registration: Option<&'a Registration>,
}

/// Outcome of writing the depth camera's images.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(crate) struct DepthOutcome {
    /// Number of depth images that exist.
    pub(crate) written: u64,
    /// Indices of frames whose infrared image exists.
    pub(crate) infrared: Vec<usize>,
    /// Indices of frames without a whole image.
    pub(crate) broken: Vec<usize>,
    /// Indices of frames in a part of the file whose checksum is wrong.
    pub(crate) damaged: Vec<usize>,
    /// Indices of frames without any depth.
    pub(crate) empty: Vec<usize>,
    /// Number of pixels beyond the format's range.
    pub(crate) out_of_range: u64,
    /// Indices of colour images that exist.
    pub(crate) color: Vec<usize>,
    /// Indices of colour images that are not complete JPEG files.
    pub(crate) color_broken: Vec<usize>,
    /// Checksum over all images.
    pub(crate) images: ImageSum,
}

/// Writes the images of the depth camera.
///
/// # Errors
///
/// Fails if an image cannot be read or written.
pub(crate) fn write_depth(
    input: &DepthInput,
    paths: &CameraPaths,
    view: DepthImageView<'_>,
    layout: &dyn Layout,
    monitor: &ReadMonitor,
) -> Result<DepthOutcome, ExtractError> {
    let mut outcome = DepthOutcome::default();
    let bytes = |image: &CameraImage| match image {
        CameraImage::Depth(image) => {
            image.depth.len() + image.infrared.as_ref().map_or(0, Vec::len)
        }
        CameraImage::Color(_, jpeg) => jpeg.len(),
    };
    let images = input.images(monitor)?.map(|image| Ok(image?));
    in_batches(images, bytes, |batch| {
        let written: Result<Vec<DepthOutcome>, ExtractError> = batch
            .par_iter()
            .map(|image| match image {
                CameraImage::Depth(image) => {
                    let place = paths.depth.get(image.index);
                    write_one(image, place, view, layout)
                }
                CameraImage::Color(index, jpeg) => {
                    let place = paths.color.get(*index).and_then(Option::as_deref);
                    write_jpeg(*index, place, jpeg)
                }
            })
            .collect();
        for one in written? {
            outcome.add(one);
        }
        Ok(())
    })?;
    Ok(outcome)
}

/// Writes a JPEG file unchanged, if it is complete.
fn write_jpeg(
    index: usize,
    place: Option<&Path>,
    jpeg: &[u8],
) -> Result<DepthOutcome, ExtractError> {
    let mut one = DepthOutcome::default();
    let Some(path) = place else {
        return Ok(one);
    };
    // Markers of start and end; padding may follow the end.
    let begins = jpeg.starts_with(&[0xFF, 0xD8]);
    if !begins || !jpeg.windows(2).rev().any(|pair| pair == [0xFF, 0xD9]) {
        one.color_broken.push(index);
        return Ok(one);
    }
    one.images = write_image(path, || Ok(jpeg.into()))?;
    one.color.push(index);
    Ok(one)
}

impl DepthOutcome {
    /// Adds the outcome of other images.
    fn add(&mut self, other: Self) {
        self.written += other.written;
        self.images.add(other.images);
        self.out_of_range += other.out_of_range;
        for (list, others) in [
            (&mut self.infrared, other.infrared),
            (&mut self.broken, other.broken),
            (&mut self.damaged, other.damaged),
            (&mut self.empty, other.empty),
            (&mut self.color, other.color),
            (&mut self.color_broken, other.color_broken),
        ] {
            list.extend(others);
        }
    }
}

/// Writes the depth and infrared image of a frame.
fn write_one(
    image: &DepthImage,
    place: Option<&DepthPaths>,
    view: DepthImageView<'_>,
    layout: &dyn Layout,
) -> Result<DepthOutcome, ExtractError> {
    let index_if = |condition: bool| Vec::from_iter(condition.then_some(image.index));
    let is_broken = image.depth.is_empty();
    let mut one = DepthOutcome {
        broken: index_if(is_broken),
        damaged: index_if(image.damaged),
        empty: index_if(!is_broken && image.depth.iter().all(|&byte| byte == 0)),
        ..DepthOutcome::default()
    };
    let Some(place) = place else {
        return Ok(one);
    };
    if let Some(path) = place.depth.as_ref().filter(|_| !is_broken) {
        let registration = view.registration;
        let seen = registration.map(|registration| registration.apply(&image.depth));
        let (pixels, lost) = layout.depth_pixels(seen.as_deref().unwrap_or(&image.depth));
        one.out_of_range = lost;
        let size = registration.map_or(view.size, |registration| registration.out);
        one.images = write_png(path, size, PngPixels::Gray16(&pixels))?;
        one.written = 1;
    }
    if let (Some(path), Some(pixels)) = (&place.infrared, &image.infrared) {
        one.images
            .add(write_png(path, view.size, PngPixels::Gray16(pixels))?);
        one.infrared.push(image.index);
    }
    Ok(one)
}

/// Checksum over images in any order: the sum of those over name and content of each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(crate) struct ImageSum(u64);

impl ImageSum {
    fn of(path: &Path, image: &[u8]) -> Self {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(path.file_name().unwrap_or_default().as_encoded_bytes());
        hasher.update(image);
        Self(hasher.finalize().into())
    }

    fn add(&mut self, other: Self) {
        self.0 = self.0.wrapping_add(other.0);
    }

    /// Returns the sum over the images that can be read.
    fn of_files(paths: &[&Path]) -> Self {
        let read = |path: &&Path| match fs::read(path) {
            Ok(image) => Self::of(path, &image),
            Err(_) => Self::default(),
        };
        let sums = paths.par_iter().map(read);
        sums.reduce(Self::default, |a, b| Self(a.0.wrapping_add(b.0)))
    }
}

impl DepthOutcome {
    /// Returns true if the images at these places are those that were written.
    pub(crate) fn is_there(&self, paths: &CameraPaths) -> bool {
        let depth = paths.depth.iter();
        let depth = depth.flat_map(|place| [&place.depth, &place.infrared]);
        let all = depth.chain(&paths.color).flatten();
        self.images == ImageSum::of_files(&all.map(PathBuf::as_path).collect::<Vec<_>>())
    }
}

impl VideoOutcome {
    /// Returns true if the images at these places are those that were written.
    pub(crate) fn is_there(&self, places: &[Option<PathBuf>]) -> bool {
        let all = places.iter().flatten().map(PathBuf::as_path);
        self.images == ImageSum::of_files(&all.collect::<Vec<_>>())
    }
}

/// Writes a PNG image.
fn write_png(
    path: &Path,
    size: (u32, u32),
    pixels: PngPixels<'_>,
) -> Result<ImageSum, ExtractError> {
    write_image(path, || Ok(encode_png(size.0, size.1, pixels)?.into()))
}

/// Writes an image unless it is there.
fn write_image<'a>(
    path: &Path,
    image: impl FnOnce() -> io::Result<Cow<'a, [u8]>>,
) -> Result<ImageSum, ExtractError> {
    let write = || {
        let image = image()?;
        if fs::read(path).ok().as_deref() != Some(&*image) {
            write_whole(path, &image)?;
        }
        Ok(ImageSum::of(path, &image))
    };
    write().map_err(|error| ExtractError::Write {
        path: path.to_owned(),
        error,
    })
}

/// Outcome of writing the phone's images.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(crate) struct VideoOutcome {
    /// Number of decoded frames.
    pub(crate) decoded: u64,
    /// Number of images that exist.
    pub(crate) written: u64,
    /// Checksum over all images.
    pub(crate) images: ImageSum,
    /// Width and height.
    pub(crate) size: Option<(u32, u32)>,
    /// Reason why decoding ended early.
    pub(crate) error: Option<String>,
}

/// Writes the phone's images. `places` has one entry per frame of the video; further frames
/// are only counted.
///
/// # Errors
///
/// Fails if an image cannot be written. Errors of ffmpeg are part of the outcome.
pub(crate) fn write_video(
    video: Video,
    places: &[Option<PathBuf>],
) -> Result<VideoOutcome, ExtractError> {
    let mut video = video;
    let size = (video.info().width, video.info().height);
    let frames = std::iter::from_fn(move || {
        let mut frame = Vec::new();
        let has_frame = video.next_frame(&mut frame);
        has_frame
            .map(|has_frame| has_frame.then_some(frame))
            .transpose()
    });
    let frames = frames.enumerate().map(|(index, frame)| Ok((index, frame?)));
    let mut outcome = VideoOutcome::default();
    let bytes = |(_, frame): &(usize, Vec<u8>)| frame.len();
    let written = in_batches(frames, bytes, |batch| {
        outcome.decoded += batch.len() as u64;
        outcome.size.get_or_insert(size);
        let written: Result<Vec<ImageSum>, ExtractError> = batch
            .par_iter()
            .filter_map(|(index, frame)| Some((places.get(*index)?.as_ref()?, frame)))
            .map(|(path, frame)| write_png(path, size, PngPixels::Rgb8(frame)))
            .collect();
        let written = written?;
        outcome.written += written.len() as u64;
        written.into_iter().for_each(|sum| outcome.images.add(sum));
        Ok(())
    });
    match written {
        Err(ExtractError::Video(error)) => outcome.error = Some(error.to_string()),
        written => written?,
    }
    Ok(outcome)
}

/// Reads `source` in a thread of its own, and passes batches to `each`, also of what was read
/// before an error. `bytes` returns the size of an item.
fn in_batches<T: Send>(
    mut source: impl Iterator<Item = Result<T, ExtractError>> + Send,
    bytes: impl Fn(&T) -> usize + Send,
    mut each: impl FnMut(Vec<T>) -> Result<(), ExtractError>,
) -> Result<(), ExtractError> {
    // One batch is read while another is written, and none waits between.
    let (sender, receiver) = sync_channel::<Result<Vec<T>, ExtractError>>(0);
    std::thread::scope(|scope| {
        let reader = std::thread::Builder::new().name(String::from("images"));
        let read = move || {
            let mut more = true;
            while more {
                let (mut batch, mut size, mut failure) = (Vec::new(), 0, None);
                while more && size < BATCH_BYTES && batch.len() < BATCH_IMAGES {
                    match source.next() {
                        Some(Ok(item)) => {
                            size += bytes(&item);
                            batch.push(item);
                        }
                        Some(Err(error)) => (failure, more) = (Some(error), false),
                        None => more = false,
                    }
                }
                let batch = (!batch.is_empty()).then_some(Ok(batch));
                for message in batch.into_iter().chain(failure.map(Err)) {
                    // The writing side has ended.
                    if sender.send(message).is_err() {
                        return;
                    }
                }
            }
        };
        reader
            .spawn_scoped(scope, read)
            .map_err(ExtractError::Thread)?;
        // Leaving drops the receiver, which stops a reader that still sends.
        for batch in receiver {
            each(batch?)?;
        }
        Ok(())
    })
}
