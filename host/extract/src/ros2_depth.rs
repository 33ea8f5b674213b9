//! Depth images of a ROS 2 bag (MCAP or sqlite3), as the drivers of cameras publish them:
//! `sensor_msgs/msg/Image` on a topic with "depth" in its name.
//!
//! Times are those in the messages' headers, which must be the camera's own. When a message
//! arrived at the computer says nothing about that and is not looked at.
//!
//! Limits: those of [`foreign`]; images are not compressed.

use std::collections::VecDeque;
use std::path::PathBuf;

use recording::foreign::{Message, Messages, Next};
use recording::messages::camera::Image as RosImage;
use recording::messages::{RosMessage as _, from_cdr};

use crate::bag::messages::{Header, Image};
use crate::board_data::{BagImage, Images};
use formats::faults::Faults;

const KIND: &str = RosImage::TYPE;

/// How many faults are kept with their text.
const MAX_FAULTS: usize = 50;

/// Why such a bag cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum Ros2Error {
    /// It cannot be read.
    #[error("reading {path}: {error}")]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
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

/// A bag, as a folder or as a single file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Ros2Bag {
    pub(crate) path: PathBuf,
    /// The topic that is asked for.
    pub(crate) topic: Option<String>,
}

impl Ros2Bag {
    /// Its images from the first on.
    pub(crate) fn open(&self, images: Images) -> Result<Ros2Images, Ros2Error> {
        let messages = Messages::open(&self.path).map_err(|error| Ros2Error::Io {
            path: self.path.clone(),
            error,
        })?;
        Ok(Ros2Images {
            path: self.path.clone(),
            messages,
            taken: Taken {
                asked: self.topic.clone(),
                topics: Vec::new(),
                waiting: VecDeque::new(),
                images,
                faults: Faults::new(MAX_FAULTS),
            },
        })
    }
}

/// Images one after the other.
pub(crate) struct Ros2Images {
    path: PathBuf,
    messages: Messages,
    taken: Taken,
}

/// What was taken of the messages.
struct Taken {
    /// The topic that is asked for.
    asked: Option<String>,
    /// Topics with depth. The images are of the first.
    topics: Vec<String>,
    waiting: VecDeque<BagImage>,
    images: Images,
    faults: Faults,
}

impl Ros2Images {
    /// The next image; `None` behind the last.
    pub(crate) fn next_image(&mut self) -> Result<Option<BagImage>, Ros2Error> {
        loop {
            if let Some(image) = self.taken.waiting.pop_front() {
                return Ok(Some(image));
            }
            let taken = &mut self.taken;
            match self.messages.next_chunk(|message| taken.take(&message)) {
                Next::Given => {}
                Next::Damaged(why) => taken.faults.add(why),
                Next::End if taken.topics.is_empty() => {
                    return Err(Ros2Error::NoImages {
                        path: self.path.clone(),
                        damage: self.damage(),
                    });
                }
                Next::End => return Ok(None),
            }
            if self.taken.topics.len() > 1 {
                return Err(Ros2Error::SeveralTopics {
                    path: self.path.clone(),
                    topics: self.taken.topics.clone(),
                });
            }
        }
    }

    /// What could not be read so far, in words.
    pub(crate) fn damage(&self) -> Vec<String> {
        self.taken.faults.words("faults of the bag")
    }

    /// About as many bytes read so far.
    pub(crate) fn position(&self) -> u64 {
        self.messages.position()
    }
}

impl Taken {
    fn take(&mut self, message: &Message<'_>) {
        let is_asked = match &self.asked {
            Some(asked) => asked == message.topic,
            None => may_be_depth(message.topic),
        };
        if !is_asked || message.kind != KIND || message.encoding != "cdr" {
            return;
        }
        if !self.topics.iter().any(|topic| topic == message.topic) {
            self.topics.push(message.topic.to_owned());
        }
        if self.topics.len() == 1 {
            self.image(message.data);
        }
    }

    fn image(&mut self, data: &[u8]) {
        let Ok(image) = from_cdr::<RosImage>(data) else {
            return self
                .faults
                .add(String::from("a message is no image: it is left out"));
        };
        let stamp = image.header.stamp.nanos();
        let image = Image {
            header: Header { seq: 0, stamp },
            height: image.height,
            width: image.width,
            encoding: &image.encoding,
            big_endian: image.is_bigendian != 0,
            step: image.step,
            data: &image.data,
        };
        let image = BagImage::of(&image, self.images, &mut self.faults);
        self.waiting.push_back(image);
    }
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
    use super::*;

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
