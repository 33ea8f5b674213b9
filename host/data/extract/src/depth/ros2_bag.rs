//! Depth images of a ROS 2 bag, as camera drivers publish them:
//! `sensor_msgs/msg/Image` on a topic with "depth" in its name.
//!
//! Times are those in the messages' headers, which must be the camera's own. The time of a
//! message's arrival at the computer is ignored.
//!
//! Limits: the bag is one MCAP file ([`recording::bag`]); images are not compressed.

use std::collections::VecDeque;
use std::path::PathBuf;

use recording::RecordingError;
use recording::messages::camera::Image;
use recording::messages::{RosMessage as _, from_cdr};
use recording::walk::{Event, Message, Walk};
use system::ReadMonitor;

use crate::faults::Faults;

const KIND: &str = Image::TYPE;

/// Largest number of faults that are described.
const MAX_FAULTS: usize = 50;

/// Reason why a bag has no readable depth images.
#[derive(Debug, thiserror::Error)]
pub enum Ros2Error {
    /// The bag cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The bag has no depth images.
    #[error(
        "{path} has no depth images: expected {KIND} on a topic with \"depth\" in its name, or the one that \
         --depth-topic names{}",
        .damage.iter().map(|damage| format!("; damaged: {damage}")).collect::<String>()
    )]
    NoImages {
        /// The bag.
        path: PathBuf,
        /// Descriptions of its unreadable parts.
        damage: Vec<String>,
    },
    /// Several topics have depth images.
    #[error("{path} has depth on {}; choose one with --depth-topic", .topics.join(" and "))]
    SeveralTopics {
        /// The bag.
        path: PathBuf,
        /// Names of the topics.
        topics: Vec<String>,
    },
}

/// Depth image of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DriverImage {
    /// Stamp in the header, ns: the depth camera's clock, as the driver reports it.
    pub(crate) stamp: i64,
    /// Number of columns.
    pub(crate) width: u32,
    /// Number of rows.
    pub(crate) height: u32,
    /// Big-endian 16-bit millimetres; empty if not requested or of an unknown encoding.
    pub(crate) pixels: Vec<u8>,
}

/// Bag, as a folder or as a single file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Ros2Bag {
    pub(crate) path: PathBuf,
    /// Requested topic.
    pub(crate) topic: Option<String>,
}

impl Ros2Bag {
    /// Opens the images at the first one, with or without their pixels.
    pub(crate) fn open(
        &self,
        pixels: bool,
        monitor: &ReadMonitor,
    ) -> Result<Ros2Images, Ros2Error> {
        Ok(Ros2Images {
            path: self.path.clone(),
            walk: Walk::open(&self.path, monitor)?,
            ended: false,
            collector: ImageCollector {
                requested: self.topic.clone(),
                topics: Vec::new(),
                waiting: VecDeque::new(),
                pixels,
                faults: Faults::new(MAX_FAULTS),
            },
        })
    }
}

/// Reader of a bag's depth images.
pub(crate) struct Ros2Images {
    path: PathBuf,
    walk: Walk,
    ended: bool,
    collector: ImageCollector,
}

/// Collects depth images from messages.
struct ImageCollector {
    /// Requested topic.
    requested: Option<String>,
    /// Topics with depth images; those of the first are collected.
    topics: Vec<String>,
    waiting: VecDeque<DriverImage>,
    /// True if pixels are requested.
    pixels: bool,
    faults: Faults,
}

impl Ros2Images {
    /// Reads the next image; `None` after the last.
    pub(crate) fn next_image(&mut self) -> Result<Option<DriverImage>, Ros2Error> {
        loop {
            if let Some(image) = self.collector.waiting.pop_front() {
                return Ok(Some(image));
            }
            if self.ended {
                return Ok(None);
            }
            let collector = &mut self.collector;
            let more = self.walk.next_part(&mut |event| match event {
                Event::Message(message) => collector.add(&message),
                Event::Damage(damage) if damage.is_loss() => {
                    collector.faults.add(damage.to_string());
                }
                _ => {}
            })?;
            self.ended = !more;
            let path = || self.path.clone();
            match self.collector.topics.as_slice() {
                [] if self.ended => {
                    return Err(Ros2Error::NoImages {
                        path: path(),
                        damage: self.damage(),
                    });
                }
                [_, _, ..] => {
                    return Err(Ros2Error::SeveralTopics {
                        path: path(),
                        topics: self.collector.topics.clone(),
                    });
                }
                _ => {}
            }
        }
    }

    /// Returns descriptions of what could not be read so far.
    pub(crate) fn damage(&self) -> Vec<String> {
        self.collector.faults.summary("faults of the bag")
    }
}

impl ImageCollector {
    /// Adds a message if it is a depth image.
    fn add(&mut self, message: &Message<'_>) {
        let described = &message.channel.described;
        let topic = &described.topic;
        let is_wanted = match &self.requested {
            Some(requested) => requested == topic,
            None => may_be_depth(topic),
        };
        if !is_wanted || message.channel.kind != KIND || described.message_encoding != "cdr" {
            return;
        }
        if !self.topics.contains(topic) {
            self.topics.push(topic.clone());
        }
        if self.topics.len() == 1 {
            self.image(message.data);
        }
    }

    fn image(&mut self, data: &[u8]) {
        let Ok(image) = from_cdr::<Image>(data) else {
            return self
                .faults
                .add(String::from("a message is not an image: it is left out"));
        };
        let stamp = image.header.stamp.nanos();
        let pixels = if self.pixels {
            millimetres(&image).unwrap_or_else(|fault| {
                // It still counts as a frame: frames are numbered.
                self.faults
                    .add(format!("a depth image at {stamp} ns {fault}"));
                Vec::new()
            })
        } else {
            Vec::new()
        };
        self.waiting.push_back(DriverImage {
            stamp,
            width: image.width,
            height: image.height,
            pixels,
        });
    }
}

/// Converts an image's pixels to big-endian 16-bit millimetres.
fn millimetres(image: &Image) -> Result<Vec<u8>, &'static str> {
    let is_big = image.is_bigendian != 0;
    let bytes = match image.encoding.as_str() {
        "16UC1" | "mono16" => 2,
        "32FC1" => 4,
        _ => return Err("has an encoding other than 16UC1 (mm) and 32FC1 (m)"),
    };
    let row = (image.width as usize)
        .checked_mul(bytes)
        .ok_or("is too wide")?;
    let step = image.step as usize;
    if row == 0 || step < row || image.data.len() / step.max(1) < image.height as usize {
        return Err("holds less than its size says");
    }
    let mut pixels = Vec::with_capacity(row / bytes * 2 * image.height as usize);
    for line in image.data.chunks_exact(step).take(image.height as usize) {
        for value in line[..row].chunks_exact(bytes) {
            let millimetres = match *value {
                [a, b] if is_big => u16::from_be_bytes([a, b]),
                [a, b] => u16::from_le_bytes([a, b]),
                _ => {
                    let value: [u8; 4] = value.try_into().map_err(|_| "has odd pixels")?;
                    let metres = if is_big {
                        f32::from_be_bytes(value)
                    } else {
                        f32::from_le_bytes(value)
                    };
                    // Saturates; not-a-number ("no depth") becomes 0.
                    (f64::from(metres) * 1000.0).round() as u16
                }
            };
            pixels.extend_from_slice(&millimetres.to_be_bytes());
        }
    }
    Ok(pixels)
}

/// Returns true if a topic's name is that of the depth camera's own images: neither those that a
/// driver registered to colour, nor compressed ones.
fn may_be_depth(topic: &str) -> bool {
    topic.contains("depth")
        && !topic.contains("aligned_depth")
        && topic.rsplit('/').next().is_some_and(|last| {
            last.starts_with("image") && !last.contains("compressed") || last == "depth"
        })
}

#[cfg(test)]
mod tests {
    use recording::messages::Header;

    use super::*;

    #[test]
    fn both_encodings_become_millimetres() {
        let floats: Vec<u8> = [1.234_f32, f32::NAN, 0.0, 70.0]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        let image = Image {
            header: Header::default(),
            height: 2,
            width: 2,
            encoding: String::from("32FC1"),
            is_bigendian: 0,
            step: 8,
            data: floats,
        };
        let values = |bytes: Vec<u8>| -> Vec<u16> {
            let (pairs, _) = bytes.as_chunks::<2>();
            pairs.iter().map(|&pair| u16::from_be_bytes(pair)).collect()
        };
        assert_eq!(values(millimetres(&image).unwrap()), [1234, 0, 0, u16::MAX]);
        // Rows with padding.
        let image = Image {
            width: 1,
            encoding: String::from("16UC1"),
            step: 4,
            data: vec![1, 2, 9, 9, 3, 4, 9, 9],
            ..image
        };
        assert_eq!(values(millimetres(&image).unwrap()), [0x0201, 0x0403]);
        let wrong = |change: fn(&mut Image)| {
            let mut image = image.clone();
            change(&mut image);
            millimetres(&image).is_err()
        };
        assert!(wrong(|image| image.height = 3));
        assert!(wrong(|image| image.step = 1));
        assert!(wrong(|image| image.encoding = String::from("rgb8")));
    }

    #[test]
    fn depth_topics_of_drivers_are_recognised() {
        // Names by the drivers' documentation, with their default settings.
        for topic in [
            "/camera/depth/image_raw",
            "/camera/camera/depth/image_rect_raw",
            "/oak/stereo/depth",
            "/depth/image_raw",
        ] {
            assert!(may_be_depth(topic), "{topic}");
        }
        for topic in [
            "/camera/color/image_raw",
            "/camera/depth/camera_info",
            "/camera/depth/points",
            "/camera/depth/metadata",
            "/camera/aligned_depth_to_color/image_raw",
            "/camera/depth/image_raw/compressedDepth",
        ] {
            assert!(!may_be_depth(topic), "{topic}");
        }
    }
}
