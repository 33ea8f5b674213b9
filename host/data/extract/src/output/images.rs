//! Writes images in parallel: one thread reads the source, the others encode.
//!
//! An existing image is not written again (files appear only when they are complete),
//! so that a stopped extraction continues. Memory is limited to a few
//! batches.

use std::borrow::Cow;
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
    write_missing(path, || Ok(jpeg.into()))?;
    one.color.push(index);
    Ok(one)
}

impl DepthOutcome {
    /// Adds the outcome of other images.
    fn add(&mut self, other: Self) {
        self.written += other.written;
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
        write_png(path, size, PngPixels::Gray16(&pixels))?;
        one.written = 1;
    }
    if let (Some(path), Some(pixels)) = (&place.infrared, &image.infrared) {
        write_png(path, view.size, PngPixels::Gray16(pixels))?;
        one.infrared.push(image.index);
    }
    Ok(one)
}

/// Writes a PNG image unless it exists.
fn write_png(path: &Path, size: (u32, u32), pixels: PngPixels<'_>) -> Result<(), ExtractError> {
    write_missing(path, || Ok(encode_png(size.0, size.1, pixels)?.into()))
}

/// Writes an image unless it exists.
fn write_missing<'a>(
    path: &Path,
    image: impl FnOnce() -> io::Result<Cow<'a, [u8]>>,
) -> Result<(), ExtractError> {
    if path.exists() {
        return Ok(());
    }
    image()
        .and_then(|image| write_whole(path, &image))
        .map_err(|error| ExtractError::Write {
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
        let written: Result<Vec<bool>, ExtractError> = batch
            .par_iter()
            .map(|(index, frame)| match places.get(*index) {
                Some(Some(path)) => write_png(path, size, PngPixels::Rgb8(frame)).map(|()| true),
                _ => Ok(false),
            })
            .collect();
        outcome.written += written?.into_iter().filter(|&written| written).count() as u64;
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
    let (sender, receiver) = sync_channel::<Result<Vec<T>, ExtractError>>(1);
    std::thread::scope(|scope| {
        scope.spawn(move || {
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
        });
        // Leaving drops the receiver, which stops a reader that still sends.
        for batch in receiver {
            each(batch?)?;
        }
        Ok(())
    })
}
