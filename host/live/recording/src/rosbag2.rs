//! Writes ROS 2 bags of MCAP: `metadata.yaml`, which makes the folder of a recording a rosbag2 for
//! `ros2 bag` and the libraries that open bags by their folder, and bags of any messages, for
//! data sets.
//!
//! The form is version 5 of `rosbag2_bagfile_information` (ROS 2 Humble), which later versions
//! read too. Times are board time, as in the file.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::io;
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Compression, McapError, Summary, WriteOptions};

use super::messages::RosMessage;
use super::{MCAP_FILE, RecordingError};

/// Size of a chunk in a bag of images, bytes.
const CHUNK_BYTES: u64 = 4 << 20;

/// Name of the metadata file in the folder.
pub const METADATA_FILE: &str = "metadata.yaml";

/// Key of the quality of service in the metadata of a channel.
pub(crate) const QOS_KEY: &str = "offered_qos_profiles";

/// The quality of service of every topic, in the form of rosbag2: keep the last 1,000,
/// reliable, volatile, no deadline and no lifespan. It must be the same in the file and in
/// `metadata.yaml`.
pub(crate) const QOS: &str = "- history: 1\n  depth: 1000\n  reliability: 1\n  durability: 2\n  \
    deadline:\n    sec: 9223372036\n    nsec: 854775807\n  \
    lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  \
    liveliness: 1\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  \
    avoid_ros_namespace_conventions: false\n";

/// Returns the options of every MCAP file that this program writes.
pub fn options() -> WriteOptions {
    WriteOptions::new()
        .profile("ros2")
        .library(concat!("smartdepthsync ", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Lz4))
        // Chunks are closed by time.
        .chunk_size(Some(16 << 20))
        .disable_seeking(true)
}

/// Writer of a bag of any messages, compressed with LZ4.
pub struct Bag<'a> {
    pub(crate) mcap: mcap::Writer<NoSeek<Box<dyn io::Write + Send + 'a>>>,
    /// Channel of each topic, and running number of its next message.
    topics: Vec<(u16, u32)>,
}

impl<'a> Bag<'a> {
    /// Creates the MCAP file of a bag.
    ///
    /// # Errors
    ///
    /// Returns an error if writing fails.
    pub fn create(to: impl io::Write + Send + 'a) -> Result<Self, McapError> {
        Self::with_options(options().chunk_size(Some(CHUNK_BYTES)), to)
    }

    pub(crate) fn with_options(
        options: WriteOptions,
        to: impl io::Write + Send + 'a,
    ) -> Result<Self, McapError> {
        let to: Box<dyn io::Write + Send + 'a> = Box::new(to);
        Ok(Self {
            mcap: options.create(NoSeek::new(to))?,
            topics: Vec::new(),
        })
    }

    /// Adds a topic with messages of type `M`. Topics are numbered from 0.
    ///
    /// # Errors
    ///
    /// Returns an error if writing fails.
    pub fn add_topic<M: RosMessage>(&mut self, name: &str) -> Result<(), McapError> {
        self.add(name, M::TYPE, &M::schema())
    }

    /// Adds a topic by the name of its type and its schema.
    pub(crate) fn add(&mut self, name: &str, kind: &str, schema: &str) -> Result<(), McapError> {
        let metadata = BTreeMap::from([(QOS_KEY.to_owned(), QOS.to_owned())]);
        let schema = self.mcap.add_schema(kind, "ros2msg", schema.as_bytes())?;
        let channel = self.mcap.add_channel(schema, name, "cdr", &metadata)?;
        self.topics.push((channel, 0));
        Ok(())
    }

    /// Adds a message in its CDR form at a time in ns. Without a `number`, it gets the one after
    /// the last on its topic. Returns the header that was written, or `None` for a topic that was
    /// not added, whose message is left out.
    ///
    /// # Errors
    ///
    /// Returns an error if writing fails.
    pub fn put(
        &mut self,
        topic: usize,
        number: Option<u32>,
        nanos: u64,
        cdr: &[u8],
    ) -> Result<Option<MessageHeader>, McapError> {
        let Some((channel_id, next)) = self.topics.get_mut(topic) else {
            return Ok(None);
        };
        let number = number.unwrap_or(*next);
        *next = number.wrapping_add(1);
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: number,
            log_time: nanos,
            publish_time: nanos,
        };
        self.mcap.write_to_known_channel(&header, cdr)?;
        Ok(Some(header))
    }

    /// Closes the file, and returns the text of `metadata.yaml` for the name of the file.
    ///
    /// # Errors
    ///
    /// Returns an error if writing fails.
    pub fn finish(mut self, file: &str) -> Result<String, McapError> {
        Ok(text_of(file, &self.mcap.finish()?))
    }
}

/// Writes `metadata.yaml` beside the finished `recording.mcap` in `folder`.
///
/// # Errors
///
/// Returns an error if it cannot be written.
pub(crate) fn save(folder: &Path, summary: &Summary) -> Result<(), RecordingError> {
    let path = folder.join(METADATA_FILE);
    system::replace(&path, text_of(MCAP_FILE, summary).as_bytes())
        .map_err(RecordingError::io("write", &path))
}

/// Returns the content of `metadata.yaml` for a bag of one MCAP file with this summary.
fn text_of(file: &str, summary: &Summary) -> String {
    let stats = summary.stats.as_ref();
    let (times, count) = stats.map_or(([0; 2], 0), |stats| {
        (
            [stats.message_start_time, stats.message_end_time],
            stats.message_count,
        )
    });
    let mut channels: Vec<_> = summary.channels.values().collect();
    channels.sort_by_key(|channel| channel.id);
    let topics = channels.iter().map(|channel| BagTopic {
        name: &channel.topic,
        kind: channel.schema.as_ref().map_or("", |schema| &schema.name),
        encoding: &channel.message_encoding,
        qos: channel.metadata.get(QOS_KEY).map_or("", String::as_str),
        messages: stats
            .and_then(|stats| stats.channel_message_counts.get(&channel.id))
            .copied()
            .unwrap_or(0),
    });
    text(file, times, count, topics)
}

/// A topic in `metadata.yaml`.
pub(crate) struct BagTopic<'a> {
    pub(crate) name: &'a str,
    pub(crate) kind: &'a str,
    pub(crate) encoding: &'a str,
    pub(crate) qos: &'a str,
    pub(crate) messages: u64,
}

/// Returns the content of `metadata.yaml` for a bag of one MCAP file: times of its first and last
/// message (ns), number of messages, and its topics in their order in the file.
pub(crate) fn text<'a>(
    file: &str,
    [start, end]: [u64; 2],
    count: u64,
    topics: impl Iterator<Item = BagTopic<'a>>,
) -> String {
    let duration = end.saturating_sub(start);
    let mut text = format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  \
         duration:\n    nanoseconds: {duration}\n  \
         starting_time:\n    nanoseconds_since_epoch: {start}\n  \
         message_count: {count}\n  topics_with_message_count:\n"
    );
    for topic in topics {
        // Writing into a String cannot fail.
        let _ = write!(
            text,
            "    - topic_metadata:\n        name: {}\n        type: {}\n        \
             serialization_format: {}\n        offered_qos_profiles: {}\n      \
             message_count: {}\n",
            quoted(topic.name),
            quoted(topic.kind),
            quoted(topic.encoding),
            quoted(topic.qos),
            topic.messages
        );
    }
    let _ = write!(
        text,
        "  compression_format: \"\"\n  compression_mode: \"\"\n  \
         relative_file_paths:\n    - {file}\n  files:\n    - path: {file}\n      \
         starting_time:\n        nanoseconds_since_epoch: {start}\n      \
         duration:\n        nanoseconds: {duration}\n      message_count: {count}\n"
    );
    text
}

/// Quotes a string: the form of JSON is valid YAML, whatever the string holds.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
