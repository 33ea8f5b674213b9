//! Depth images of a ROS 2 bag (MCAP), as the drivers of cameras publish them:
//! `sensor_msgs/msg/Image` on a topic with "depth" in its name.
//!
//! Times are those in the messages' headers, which must be the camera's own. When a message
//! arrived at the computer says nothing about that and is not looked at.
//!
//! Limits: chunks are packed with LZ4, Zstandard or not at all; images are not compressed.

use std::collections::{HashMap, VecDeque};
use std::path::{Path, PathBuf};

use mcap::records::Record;
use recording::chunks::{Chunk, Chunks};
use recording::messages::camera::Image as RosImage;
use recording::messages::from_cdr;
use recording::rosbag2::METADATA_FILE;
use recording::scan::parse;

use crate::bag::messages::{Header, Image};
use crate::board_data::{BagImage, Images, millimetres};
use crate::faults::Faults;

const KIND: &str = "sensor_msgs/msg/Image";

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
            asked: self.topic.clone(),
            topic: None,
            chunks: None,
            channels: HashMap::new(),
            waiting: VecDeque::new(),
            memory: Vec::new(),
            images,
            faults: Faults::new(MAX_FAULTS),
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
    asked: Option<String>,
    /// The topic whose images come.
    topic: Option<String>,
    chunks: Option<(PathBuf, Chunks)>,
    /// Topics that may be depth, by their channel in this file.
    channels: HashMap<u16, String>,
    waiting: VecDeque<BagImage>,
    memory: Vec<u8>,
    images: Images,
    faults: Faults,
    /// Bytes of the files that were read to their end.
    before: u64,
}

impl Ros2Images {
    /// The next image; `None` behind the last.
    pub(crate) fn next_image(&mut self) -> Result<Option<BagImage>, Ros2Error> {
        loop {
            if let Some(image) = self.waiting.pop_front() {
                return Ok(Some(image));
            }
            let Some((path, chunks)) = &mut self.chunks else {
                let Some(path) = self.files.pop_front() else {
                    return match self.topic {
                        Some(_) => Ok(None),
                        None => Err(Ros2Error::NoImages {
                            path: self.path.clone(),
                        }),
                    };
                };
                let chunks = Chunks::open(&path).map_err(|error| Ros2Error::Io {
                    path: path.clone(),
                    error,
                })?;
                self.channels.clear();
                self.chunks = Some((path, chunks));
                continue;
            };
            let next = match chunks.next_packed() {
                Ok(next) => next,
                Err(_) if chunks.data_complete() => None,
                Err(error) => {
                    let at = chunks.position();
                    self.faults
                        .add(format!("{} ends at byte {at}: {error}", path.display()));
                    None
                }
            };
            match next.map(|packed| packed.unpack(std::mem::take(&mut self.memory))) {
                Some(Ok(chunk)) => {
                    let taken = self.take(&chunk);
                    self.memory = chunk.into_memory();
                    taken?;
                }
                Some(Err(why)) => self.faults.add(format!("a chunk is left out: {why}")),
                None => {
                    self.before += chunks.position();
                    self.chunks = None;
                }
            }
        }
    }

    /// What could not be read so far, in words.
    pub(crate) fn damage(&self) -> Vec<String> {
        self.faults.words("faults of the bag")
    }

    /// Bytes read so far.
    pub(crate) fn position(&self) -> u64 {
        let chunks = self.chunks.as_ref();
        self.before + chunks.map_or(0, |(_, chunks)| chunks.position())
    }

    fn take(&mut self, chunk: &Chunk) -> Result<(), Ros2Error> {
        for (opcode, body) in chunk.records() {
            match parse(opcode, body) {
                Some(Record::Channel(channel)) => {
                    let is_it = match &self.asked {
                        Some(asked) => *asked == channel.topic,
                        None => may_be_depth(&channel.topic),
                    };
                    if is_it && channel.message_encoding == "cdr" {
                        self.channels.insert(channel.id, channel.topic);
                    }
                }
                Some(Record::Message { header, data }) => {
                    if let Some(topic) = self.channels.get(&header.channel_id) {
                        match &self.topic {
                            Some(known) if known != topic => {
                                return Err(Ros2Error::SeveralTopics {
                                    path: self.path.clone(),
                                    topics: vec![known.clone(), topic.clone()],
                                });
                            }
                            Some(_) => {}
                            None => self.topic = Some(topic.clone()),
                        }
                        self.message(&data);
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn message(&mut self, data: &[u8]) {
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
