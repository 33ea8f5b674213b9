//! Depth images of a ROS 2 bag (MCAP), as the drivers of cameras publish them:
//! `sensor_msgs/msg/Image` on a topic with "depth" in its name.
//!
//! Times are those in the messages' headers, which must be the camera's own. When a message
//! arrived at the computer says nothing about that and is not looked at.
//!
//! Limits: chunks are packed with LZ4, Zstandard or not at all; images are not compressed.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use recording::foreign::{Message, Messages, Next};
use recording::messages::camera::Image as RosImage;
use recording::messages::{RosMessage as _, from_cdr};
use recording::rosbag2::METADATA_FILE;

use crate::bag::messages::{Header, Image};
use crate::board_data::{BagImage, Images, millimetres};
use crate::faults::Faults;

const KIND: &str = RosImage::TYPE;

/// How many faults are kept with their text.
const MAX_FAULTS: usize = 50;

/// Why such a bag cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum Ros2Error {
    /// A file of it cannot be read.
    #[error("reading {path}: {error}")]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A folder without files that are known.
    #[error(
        "{path} is no ROS 2 bag in MCAP files{}",
        if *.sqlite { ": it is in sqlite3; make one with `ros2 bag convert` and storage_id mcap" } else { "" }
    )]
    NoFiles {
        /// Which.
        path: PathBuf,
        /// There is an sqlite3 file in it.
        sqlite: bool,
    },
    /// No image of depth is in it.
    #[error(
        "{path} has no depth images: expected {KIND} on a topic with \"depth\" in its name, or the one that \
         --depth-topic names"
    )]
    NoImages {
        /// Which.
        path: PathBuf,
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
    /// Bytes of its files.
    pub(crate) fn length(&self) -> u64 {
        let files = files_of(&self.path).unwrap_or_default();
        let lengths = files.iter().filter_map(|file| file.metadata().ok());
        lengths.map(|file| file.len()).sum()
    }

    /// Its images from the first on.
    pub(crate) fn open(&self, images: Images) -> Result<Ros2Images, Ros2Error> {
        Ok(Ros2Images {
            path: self.path.clone(),
            files: files_of(&self.path)?.into(),
            open: None,
            taken: Taken {
                asked: self.topic.clone(),
                topics: Vec::new(),
                waiting: VecDeque::new(),
                images,
                faults: Faults::new(MAX_FAULTS),
            },
            before: 0,
        })
    }
}

/// Whether a path may be a bag: a folder with the bag's files, or one of them.
pub(crate) fn is_bag(path: &Path) -> bool {
    match path.is_dir() {
        true => path.join(METADATA_FILE).is_file() && !path.join(recording::MCAP_FILE).is_file(),
        false => path
            .extension()
            .is_some_and(|extension| extension == "mcap"),
    }
}

fn files_of(path: &Path) -> Result<Vec<PathBuf>, Ros2Error> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let fail = |error| Ros2Error::Io {
        path: path.to_owned(),
        error,
    };
    let mut paths = Vec::new();
    let mut sqlite = false;
    for entry in std::fs::read_dir(path).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        let extension = path.extension().unwrap_or_default();
        sqlite |= extension == "db3";
        if extension == "mcap" && path.is_file() {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        return Err(Ros2Error::NoFiles {
            path: path.to_owned(),
            sqlite,
        });
    }
    // rosbag2 numbers them without leading zeros: `depth_0.mcap`, ..., `depth_10.mcap`.
    paths.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    Ok(paths)
}

/// Images one after the other.
pub(crate) struct Ros2Images {
    path: PathBuf,
    files: VecDeque<PathBuf>,
    /// The file that is being read.
    open: Option<(PathBuf, Messages)>,
    taken: Taken,
    /// Bytes of the files that were read to their end.
    before: u64,
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
            let Some((path, messages)) = &mut self.open else {
                let Some(path) = self.files.pop_front() else {
                    return match self.taken.topics.is_empty() {
                        false => Ok(None),
                        true => Err(Ros2Error::NoImages {
                            path: self.path.clone(),
                        }),
                    };
                };
                let messages = Messages::open(&path).map_err(|error| Ros2Error::Io {
                    path: path.clone(),
                    error,
                })?;
                self.open = Some((path, messages));
                continue;
            };
            let taken = &mut self.taken;
            match messages.next_chunk(|message| taken.take(&message)) {
                Ok(Next::Given) if self.taken.topics.len() > 1 => {
                    return Err(Ros2Error::SeveralTopics {
                        path: self.path.clone(),
                        topics: self.taken.topics.clone(),
                    });
                }
                Ok(Next::Given) => {}
                Ok(Next::LeftOut(why)) => {
                    let what = format!("a chunk is left out: {why}");
                    self.taken.faults.add(what);
                }
                ended => {
                    let at = messages.position();
                    if let Err(error) = ended {
                        let what = format!("{} ends at byte {at}: {error}", path.display());
                        self.taken.faults.add(what);
                    }
                    self.before += at;
                    self.open = None;
                }
            }
        }
    }

    /// What could not be read so far, in words.
    pub(crate) fn damage(&self) -> Vec<String> {
        self.taken.faults.words("faults of the bag")
    }

    /// Bytes read so far.
    pub(crate) fn position(&self) -> u64 {
        let open = self.open.as_ref();
        self.before + open.map_or(0, |(_, messages)| messages.position())
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
        let pixels = match self.images {
            Images::Pixels => millimetres(&image).unwrap_or_else(|what| {
                self.faults
                    .add(format!("a depth image at {stamp} ns {what}"));
                Vec::new()
            }),
            Images::Stamps | Images::Skip => Vec::new(),
        };
        self.waiting.push_back(BagImage {
            stamp,
            width: image.width,
            height: image.height,
            pixels,
        });
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
