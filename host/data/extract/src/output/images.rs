//! Writes images in parallel: one thread reads the source, the others encode.
//!
//! An image that is there already is not written again (files appear whole or not
//! at all), so that an extraction that was stopped goes on. Memory is a few
//! batches of limited size.

use std::borrow::Cow;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;

use phone::video::Video;
use rayon::prelude::*;

use crate::depth::{CameraImage, DepthImage, DepthInput};
use crate::error::ExtractError;
use crate::geometry::register::Registration;
use crate::layout::Layout;
use crate::output::image::{Pixels, encode_png, write_whole};
use system::ReadMonitor;

/// Bytes in a batch.
const BATCH_BYTES: usize = 16 << 20;
/// Images in a batch at most.
const BATCH_IMAGES: usize = 64;

/// Files of one depth frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct DepthPaths {
    /// Depth; `None` if the frame has no place in the data set.
    pub(crate) depth: Option<PathBuf>,
    /// Infrared.
    pub(crate) infrared: Option<PathBuf>,
}

/// Files of the images of the depth camera: one entry a frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct CameraPaths {
    /// Depth and infrared.
    pub(crate) depth: Vec<DepthPaths>,
    /// Colour, as JPEG files.
    pub(crate) color: Vec<Option<PathBuf>>,
}

/// How depth images are written.
#[derive(Clone, Copy)]
pub(crate) struct DepthImageView<'a> {
    /// Width and height of the depth camera's own images.
    pub(crate) size: (u32, u32),
    /// Into the view of another camera.
    pub(crate) registration: Option<&'a Registration>,
}

/// What the depth images were like.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(crate) struct DepthOutcome {
    /// Images with a place that are there.
    pub(crate) written: u64,
    /// Infrared images that are there, by frame.
    pub(crate) infrared: Vec<usize>,
    /// Frames without a whole image.
    pub(crate) broken: Vec<usize>,
    /// Frames in a part of the file whose checksum is wrong.
    pub(crate) damaged: Vec<usize>,
    /// Frames without any depth in them.
    pub(crate) empty: Vec<usize>,
    /// Pixels too far away for the format.
    pub(crate) out_of_range: u64,
    /// Colour images of the camera that are there, by frame.
    pub(crate) color: Vec<usize>,
    /// Colour images with a place that are no JPEG files.
    pub(crate) color_broken: Vec<usize>,
}

/// Writes the images of the depth camera.
///
/// # Errors
///
/// Reading or writing fails.
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
            outcome.take(one);
        }
        Ok(())
    })?;
    Ok(outcome)
}

/// Writes a JPEG file as it came, unless it is none.
fn write_jpeg(
    index: usize,
    place: Option<&Path>,
    jpeg: &[u8],
) -> Result<DepthOutcome, ExtractError> {
    let mut one = DepthOutcome::default();
    let Some(path) = place else {
        return Ok(one);
    };
    // Start of image, and the end of it further on: the camera fills up its frames.
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
    /// Takes that of other images.
    fn take(&mut self, other: Self) {
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

fn write_one(
    image: &DepthImage,
    place: Option<&DepthPaths>,
    view: DepthImageView<'_>,
    layout: &dyn Layout,
) -> Result<DepthOutcome, ExtractError> {
    let its = |is_so: bool| Vec::from_iter(is_so.then_some(image.index));
    let is_broken = image.depth.is_empty();
    let mut one = DepthOutcome {
        broken: its(is_broken),
        damaged: its(image.damaged),
        empty: its(!is_broken && image.depth.iter().all(|&byte| byte == 0)),
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
        write_png(path, size, Pixels::Gray16(&pixels))?;
        one.written = 1;
    }
    if let (Some(path), Some(pixels)) = (&place.infrared, &image.infrared) {
        write_png(path, view.size, Pixels::Gray16(pixels))?;
        one.infrared.push(image.index);
    }
    Ok(one)
}

fn write_png(path: &Path, size: (u32, u32), pixels: Pixels<'_>) -> Result<(), ExtractError> {
    write_missing(path, || Ok(encode_png(size.0, size.1, pixels)?.into()))
}

/// Writes an image unless it is there.
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

/// What the video was like.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(crate) struct VideoOutcome {
    /// Frames that were decoded.
    pub(crate) decoded: u64,
    /// Images that are there.
    pub(crate) written: u64,
    /// Width and height.
    pub(crate) size: Option<(u32, u32)>,
    /// Why decoding did not come to its end.
    pub(crate) error: Option<String>,
}

/// Writes the phone's images. `places` has one entry a frame of the video; frames
/// beyond are counted only.
///
/// # Errors
///
/// Writing fails. What ffmpeg says is in the outcome.
pub(crate) fn write_video(
    video: Video,
    places: &[Option<PathBuf>],
) -> Result<VideoOutcome, ExtractError> {
    let mut video = video;
    let size = (video.info().width, video.info().height);
    let frames = std::iter::from_fn(move || {
        let mut frame = Vec::new();
        let there = video.next_frame(&mut frame);
        there.map(|there| there.then_some(frame)).transpose()
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
                Some(Some(path)) => write_png(path, size, Pixels::Rgb8(frame)).map(|()| true),
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

/// Reads in a thread of its own, and gives what it reads to `each` in batches, whose
/// size is that of `bytes`. What was read before an error is given too.
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
                    // Nobody listens any more: the writing side has ended.
                    if sender.send(message).is_err() {
                        return;
                    }
                }
            }
        });
        // The receiver is dropped on leaving, so that a reader that still sends stops.
        for batch in receiver {
            each(batch?)?;
        }
        Ok(())
    })
}
