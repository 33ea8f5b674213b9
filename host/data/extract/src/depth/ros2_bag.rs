//! Depth images of a ROS 2 bag, as the drivers of cameras publish them:
//! `sensor_msgs/msg/Image` on a topic with "depth" in its name.
//!
//! Times are those in the messages' headers, which must be the camera's own. When a message
//! arrived at the computer says nothing about that and is not looked at.
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

/// How many faults are kept with their text.
const MAX_FAULTS: usize = 50;

/// Why such a bag cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum Ros2Error {
    /// It cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// No image of depth is in it.
    #[error(
        "{path} has no depth images: expected {KIND} on a topic with \"depth\" in its name, or the one that \
         --depth-topic names{}",
        .damage.iter().map(|damage| format!("; damaged: {damage}")).collect::<String>()
    )]
    NoImages {
        /// Which.
        path: PathBuf,
        /// What could not be read of it.
        damage: Vec<String>,
    },
    /// Several topics hold depth.
    #[error("{path} has depth on {}; choose one with --depth-topic", .topics.join(" and "))]
    SeveralTopics {
        /// Which.
        path: PathBuf,
        /// Their names.
        topics: Vec<String>,
    },
}

/// A depth image of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DriverImage {
    /// Its stamp: the depth camera's clock, as the driver gives it.
    pub(crate) stamp: i64,
    /// Pixels in a row.
    pub(crate) width: u32,
    /// Rows.
    pub(crate) height: u32,
    /// Big-endian 16-bit pixels in mm; empty if they are not wanted or not of a known form.
    pub(crate) pixels: Vec<u8>,
}

/// A bag, as a folder or as a single file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Ros2Bag {
    pub(crate) path: PathBuf,
    /// The topic that is asked for.
    pub(crate) topic: Option<String>,
}

impl Ros2Bag {
    /// Its images from the first on, with their pixels or with their stamps alone.
    pub(crate) fn open(
        &self,
        pixels: bool,
        monitor: &ReadMonitor,
    ) -> Result<Ros2Images, Ros2Error> {
        Ok(Ros2Images {
            path: self.path.clone(),
            walk: Walk::open(&self.path, monitor)?,
            ended: false,
            taken: Taken {
                asked: self.topic.clone(),
                topics: Vec::new(),
                waiting: VecDeque::new(),
                pixels,
                faults: Faults::new(MAX_FAULTS),
            },
        })
    }
}

/// Images one after the other.
pub(crate) struct Ros2Images {
    path: PathBuf,
    walk: Walk,
    ended: bool,
    taken: Taken,
}

/// What was taken of the messages.
struct Taken {
    /// The topic that is asked for.
    asked: Option<String>,
    /// Topics with depth. The images are of the first.
    topics: Vec<String>,
    waiting: VecDeque<DriverImage>,
    /// Pixels are wanted.
    pixels: bool,
    faults: Faults,
}

impl Ros2Images {
    /// The next image; `None` after the last.
    pub(crate) fn next_image(&mut self) -> Result<Option<DriverImage>, Ros2Error> {
        loop {
            if let Some(image) = self.taken.waiting.pop_front() {
                return Ok(Some(image));
            }
            if self.ended {
                return Ok(None);
            }
            let taken = &mut self.taken;
            let more = self.walk.next_part(&mut |event| match event {
                Event::Message(message) => taken.take(&message),
                Event::Damage(damage) if damage.is_loss() => {
                    taken.faults.add(damage.to_string());
                }
                _ => {}
            })?;
            self.ended = !more;
            let path = || self.path.clone();
            match self.taken.topics.as_slice() {
                [] if self.ended => {
                    return Err(Ros2Error::NoImages {
                        path: path(),
                        damage: self.damage(),
                    });
                }
                [_, _, ..] => {
                    return Err(Ros2Error::SeveralTopics {
                        path: path(),
                        topics: self.taken.topics.clone(),
                    });
                }
                _ => {}
            }
        }
    }

    /// What could not be read so far, in words.
    pub(crate) fn damage(&self) -> Vec<String> {
        self.taken.faults.words("faults of the bag")
    }
}

impl Taken {
    fn take(&mut self, message: &Message<'_>) {
        let described = &message.channel.described;
        let topic = &described.topic;
        let is_asked = match &self.asked {
            Some(asked) => asked == topic,
            None => may_be_depth(topic),
        };
        if !is_asked || message.channel.kind != KIND || described.message_encoding != "cdr" {
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
                .add(String::from("a message is no image: it is left out"));
        };
        let stamp = image.header.stamp.nanos();
        let pixels = match self.pixels {
            true => millimetres(&image).unwrap_or_else(|what| {
                // It still counts as a frame: frames are numbered.
                self.faults
                    .add(format!("a depth image at {stamp} ns {what}"));
                Vec::new()
            }),
            false => Vec::new(),
        };
        self.waiting.push_back(DriverImage {
            stamp,
            width: image.width,
            height: image.height,
            pixels,
        });
    }
}

/// An image's pixels as big-endian millimetres.
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
                    let metres = match is_big {
                        true => f32::from_be_bytes(value),
                        false => f32::from_le_bytes(value),
                    };
                    // Saturates; not-a-number, "no depth", becomes 0.
                    (f64::from(metres) * 1000.0).round() as u16
                }
            };
            pixels.extend_from_slice(&millimetres.to_be_bytes());
        }
    }
    Ok(pixels)
}

/// Whether images of a topic are the depth camera's own, by its name: not those that a
/// driver has laid over colour, and not compressed ones.
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
    fn depth_of_both_encodings_is_millimetres() {
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
    fn topics_of_the_makers_drivers() {
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
