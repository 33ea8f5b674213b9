//! `metadata.yaml`: what makes the folder of a recording a rosbag2, for `ros2 bag` and
//! the libraries that open bags by their folder.
//!
//! And a bag of any messages, for data sets.
//!
//! The form is version 5 of `rosbag2_bagfile_information` (ROS 2 Humble), which later
//! versions read too. Times are board time, as in the file.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::io;
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Compression, McapError, Summary, WriteOptions};

use super::messages::RosMessage;
use super::{MCAP_FILE, RecordingError};

/// Bytes of a chunk of a bag of images.
const CHUNK_BYTES: u64 = 4 << 20;

/// Name of the file in the folder.
pub const METADATA_FILE: &str = "metadata.yaml";

/// Key of the quality of service in a channel's metadata.
pub(crate) const QOS_KEY: &str = "offered_qos_profiles";

/// The quality of service of every topic, in the form of rosbag2: keep the last 1,000,
/// reliable, volatile, no deadline and no lifespan. The file and `metadata.yaml` must
/// agree in it.
pub(crate) const QOS: &str = "- history: 1\n  depth: 1000\n  reliability: 1\n  durability: 2\n  \
    deadline:\n    sec: 9223372036\n    nsec: 854775807\n  \
    lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  \
    liveliness: 1\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  \
    avoid_ros_namespace_conventions: false\n";

/// Options of every file that this program writes.
pub fn options() -> WriteOptions {
    WriteOptions::new()
        .profile("ros2")
        .library(concat!("smartdepthsync ", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Lz4))
        // Chunks are closed by time.
        .chunk_size(Some(16 << 20))
        .disable_seeking(true)
}

/// A bag of any messages that is being written, packed by LZ4.
pub struct Bag<'a> {
    pub(crate) mcap: mcap::Writer<NoSeek<Box<dyn io::Write + Send + 'a>>>,
    /// Of each topic its channel, and the running number of its next message.
    topics: Vec<(u16, u32)>,
}

impl<'a> Bag<'a> {
    /// Begins the MCAP file of a bag.
    ///
    /// # Errors
    ///
    /// Writing fails.
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

    /// Adds a topic of messages `M`. Topics are numbered from 0.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub fn add_topic<M: RosMessage>(&mut self, name: &str) -> Result<(), McapError> {
        self.add(name, M::TYPE, &M::schema())
    }

    /// The same, with type and schema of its messages.
    pub(crate) fn add(&mut self, name: &str, kind: &str, schema: &str) -> Result<(), McapError> {
        let metadata = BTreeMap::from([(QOS_KEY.to_owned(), QOS.to_owned())]);
        let schema = self.mcap.add_schema(kind, "ros2msg", schema.as_bytes())?;
        let channel = self.mcap.add_channel(schema, name, "cdr", &metadata)?;
        self.topics.push((channel, 0));
        Ok(())
    }

    /// Adds a message in its CDR form, with its number on the topic if the caller has one, on
    /// which the next follows, at a time in ns. One of a topic that was not added is left out.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub fn put(
        &mut self,
        topic: usize,
        number: Option<u32>,
        nanos: u64,
        cdr: &[u8],
    ) -> Result<(), McapError> {
        let Some((channel_id, next)) = self.topics.get_mut(topic) else {
            return Ok(());
        };
        let number = number.unwrap_or(*next);
        *next = number.wrapping_add(1);
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: number,
            log_time: nanos,
            publish_time: nanos,
        };
        self.mcap.write_to_known_channel(&header, cdr)
    }

    /// Finishes it, and gives the text of `metadata.yaml` for the name of its file.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub fn finish(mut self, file: &str) -> Result<String, McapError> {
        Ok(text(file, &self.mcap.finish()?))
    }
}

/// Writes `metadata.yaml` beside the finished `recording.mcap` in `folder`.
///
/// # Errors
///
/// It cannot be written.
pub fn save(folder: &Path, summary: &Summary) -> Result<(), RecordingError> {
    let path = folder.join(METADATA_FILE);
    system::replace(&path, text(MCAP_FILE, summary).as_bytes())
        .map_err(RecordingError::io("write", &path))
}

/// The content of `metadata.yaml` for a bag of one MCAP file.
fn text(file: &str, summary: &Summary) -> String {
    let stats = summary.stats.as_ref();
    let (start, end, count) = stats.map_or((0, 0, 0), |stats| {
        (
            stats.message_start_time,
            stats.message_end_time,
            stats.message_count,
        )
    });
    let duration = end.saturating_sub(start);
    let mut text = format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  \
         duration:\n    nanoseconds: {duration}\n  \
         starting_time:\n    nanoseconds_since_epoch: {start}\n  \
         message_count: {count}\n  topics_with_message_count:\n"
    );
    let mut channels: Vec<_> = summary.channels.values().collect();
    channels.sort_by_key(|channel| channel.id);
    for channel in channels {
        let messages = stats
            .and_then(|stats| stats.channel_message_counts.get(&channel.id))
            .copied()
            .unwrap_or(0);
        let kind = channel.schema.as_ref().map_or("", |schema| &schema.name);
        let qos = channel.metadata.get(QOS_KEY).map_or("", String::as_str);
        // Writing into a String cannot fail.
        let _ = write!(
            text,
            "    - topic_metadata:\n        name: {}\n        type: {}\n        \
             serialization_format: {}\n        offered_qos_profiles: {}\n      \
             message_count: {messages}\n",
            quoted(&channel.topic),
            quoted(kind),
            quoted(&channel.message_encoding),
            quoted(qos)
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

/// A string of JSON is one of YAML, whatever is in it.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
