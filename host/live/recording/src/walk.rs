//! Walks an MCAP file over any damage and yields everything that can be read: the one reader of
//! bytes for the typed [`reader`](super::reader), [`verify`](super::verify) and `extract`.
//!
//! ```no_run
//! # fn show(path: &std::path::Path) -> Result<(), recording::RecordingError> {
//! use recording::walk::{Event, Walk};
//! use system::ReadMonitor;
//! let mut walk = Walk::open(path, &ReadMonitor::default())?;
//! while walk.next_part(&mut |event| match event {
//!     Event::Message(message) => println!("{}", message.channel.described.topic),
//!     Event::Damage(damage) => println!("{damage}"),
//! })? {}
//! # Ok(())
//! # }
//! ```
//!
//! A part is a chunk, a record outside of chunks, or a damaged place. A file whose writer was
//! killed yields its whole chunks, and then [`Damage::CutOff`].

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use mcap::records::{self, MessageHeader, Record, op};
use protocol::Ticks;
use system::ReadMonitor;

use super::chunks::{BadChunk, parse};
use super::damage::MAX_NAME;
pub use super::damage::{Damage, FileReport};
use super::index::Index;
use super::messages::CdrError;
use super::rosbag2::{self, BagTopic, QOS_KEY};
use super::scan::{Piece, Scan};
use super::topic::{Item, Topic};
use super::{RecordingError, bag, ticks_of_nanos, writer};

/// A compression of other programs, whose name no damage makes from one of ours.
const ZSTD: &str = "zstd";

/// A message or a damage of the file.
pub enum Event<'a> {
    /// A message.
    Message(Message<'a>),
    /// A part cannot be read, or contradicts the rest.
    Damage(Damage),
}

/// A topic of the file.
#[derive(Debug)]
pub struct Channel {
    /// Description in the file.
    pub described: records::Channel,
    /// Name of the type of its messages, for example `sensor_msgs/msg/Imu`; empty if the file
    /// does not state it.
    pub kind: String,
    /// The topic with that name, if this program knows it.
    pub known: Option<Topic>,
}

/// A message as bytes.
pub struct Message<'a> {
    /// Topic.
    pub channel: &'a Channel,
    /// Times (ns) and running number.
    pub header: MessageHeader,
    /// CDR form of the content.
    pub data: &'a [u8],
}

impl Message<'_> {
    /// Returns the board time.
    #[must_use]
    pub fn at(&self) -> Ticks {
        ticks_of_nanos(self.header.log_time)
    }

    /// Decodes a message of one of our topics; returns `None` for any other topic.
    ///
    /// # Errors
    ///
    /// Returns an error if the message is not of its topic's type.
    #[must_use]
    pub fn item(&self) -> Option<Result<Item, CdrError>> {
        Some(self.channel.known?.read(self.data))
    }
}

/// Position in a file that is being walked.
pub struct Walk {
    scan: Scan,
    path: PathBuf,
    /// Path that it was opened by: the file, or its folder.
    given: PathBuf,
    topics: Topics,
    ended: bool,
}

/// Topics and statistics of the file so far.
#[derive(Default)]
struct Topics {
    channels: HashMap<u16, Channel>,
    /// Names of types, by the numbers of their schemas.
    schemas: HashMap<u16, String>,
    /// True if the topics of this program are assumed.
    assumed: bool,
    /// Messages that were read.
    messages: u64,
    /// The file's index, and what it must state.
    index: Index,
}

/// Receives what is read.
type Each<'e> = &'e mut dyn FnMut(Event<'_>);

impl Walk {
    /// Opens the recording or bag in a folder, or an MCAP file.
    ///
    /// # Errors
    ///
    /// Returns an error if there is none ([`bag::mcap_in`]) or if the file cannot be opened.
    pub fn open(folder_or_file: &Path, monitor: &ReadMonitor) -> Result<Self, RecordingError> {
        let path = bag::mcap_in(folder_or_file)?;
        let scan = Scan::open(&path, monitor).map_err(RecordingError::io("read", &path))?;
        Ok(Self {
            scan,
            path,
            given: folder_or_file.to_owned(),
            topics: Topics::default(),
            ended: false,
        })
    }

    /// Passes the messages and damages of the next part of the file to `each`; returns false
    /// after the last part.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read, is no MCAP file at all, or is compressed with
    /// Zstandard. Damage is not an error.
    pub fn next_part(&mut self, each: Each<'_>) -> Result<bool, RecordingError> {
        if self.ended {
            return Ok(false);
        }
        let piece = self.scan.next_piece();
        let piece = piece.map_err(RecordingError::io("read", &self.path))?;
        match piece {
            Some(Piece::Damage(Damage::Chunk {
                why: BadChunk::Compression(name),
                ..
            })) if name == ZSTD => {
                return Err(bag::foreign(&self.given, "packed with Zstandard"));
            }
            Some(piece) => self.piece(piece, each),
            None => {
                self.ended = true;
                self.end(each)?;
            }
        }
        self.scan.report.messages = self.topics.messages;
        Ok(!self.ended)
    }

    /// Returns the state of the file as bytes, as far as it was read.
    #[must_use]
    pub const fn report(&self) -> &FileReport {
        &self.scan.report
    }

    /// Iterates over the topics described so far, with or without messages.
    pub fn topics(&self) -> impl Iterator<Item = &Channel> {
        self.topics.channels.values()
    }

    /// Returns `metadata.yaml` as a bag of these topics and messages has it.
    pub(crate) fn metadata(&self, file: &str) -> String {
        let mut channels: Vec<&Channel> = self.topics().collect();
        channels.sort_by_key(|channel| channel.described.id);
        let topics = channels.into_iter().map(|channel| {
            let described = &channel.described;
            BagTopic {
                name: &described.topic,
                kind: &channel.kind,
                encoding: &described.message_encoding,
                qos: described.metadata.get(QOS_KEY).map_or("", String::as_str),
                messages: self.topics.index.messages_of(described.id),
            }
        });
        let times = self.topics.index.times().unwrap_or_default();
        rosbag2::text(file, times, self.topics.messages, topics)
    }

    fn end(&mut self, each: Each<'_>) -> Result<(), RecordingError> {
        let report = &self.scan.report;
        if !self.scan.has_magic() && report.chunks == 0 {
            return Err(RecordingError::mcap(&self.path)(mcap::McapError::BadMagic));
        }
        if report.closed && !report.data_complete {
            each(Event::Damage(Damage::NoEndOfData));
        }
        let found = self.topics.messages;
        let index = &mut self.topics.index;
        let expected = index.counted().unwrap_or(found);
        if report.closed && expected != found {
            each(Event::Damage(Damage::MessageCount { found, expected }));
        } else if report.closed && report.bad_chunks == 0 && report.skipped_bytes == 0 {
            index
                .compare()
                .unwrap_or_else(|damage| each(Event::Damage(damage)));
        }
        Ok(())
    }

    fn piece(&mut self, piece: Piece, each: Each<'_>) {
        match piece {
            Piece::Chunk(chunk, place) => {
                for (opcode, body) in chunk.records() {
                    self.topics.record(opcode, body, each);
                }
                let bytes = chunk.cut_off();
                self.scan.reuse(chunk);
                let times = self.topics.index.chunk(place);
                if bytes > 0 {
                    each(Event::Damage(Damage::ChunkEnd { bytes }));
                } else if let Err(damage) = times {
                    each(Event::Damage(damage));
                }
            }
            // A writer of chunks puts every message into one: a message outside, without a
            // checksum, is most likely another record that was damaged.
            Piece::Record(op::MESSAGE, _) if self.scan.report.chunks > 0 => {
                each(Event::Damage(Damage::OutsideChunk));
            }
            Piece::Record(opcode, body) => self.topics.record(opcode, &body, each),
            Piece::Damage(damage) => each(Event::Damage(damage)),
            Piece::End => {}
        }
    }
}

impl Topics {
    fn record(&mut self, opcode: u8, body: &[u8], each: Each<'_>) {
        match parse(opcode, body) {
            Some(Record::Schema { header, .. }) => {
                self.schemas.insert(header.id, header.name);
            }
            Some(Record::Channel(described)) if described.topic.len() > MAX_NAME => {
                let bytes = described.topic.len();
                each(Event::Damage(Damage::TopicName { bytes }));
            }
            Some(Record::Channel(described)) => {
                let schema = self.schemas.get(&described.schema_id);
                let channel = Channel {
                    kind: schema.cloned().unwrap_or_default(),
                    known: Topic::from_name(&described.topic),
                    described,
                };
                self.channels.insert(channel.described.id, channel);
            }
            Some(Record::Message { header, data }) => self.message(header, &data, each),
            Some(Record::Statistics(statistics)) => {
                self.index.statistics(statistics);
            }
            Some(Record::ChunkIndex(entry)) => self.index.listed(&entry),
            None if matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) => {
                each(Event::Damage(Damage::Record));
            }
            _ => {}
        }
    }

    fn message(&mut self, header: MessageHeader, data: &[u8], each: Each<'_>) {
        self.index.message(&header);
        if self.channels.is_empty() && !self.assumed {
            self.assume(each);
        }
        let Some(channel) = self.channels.get(&header.channel_id) else {
            let channel = header.channel_id;
            return each(Event::Damage(Damage::UnknownTopic { channel }));
        };
        self.messages += 1;
        each(Event::Message(Message {
            channel,
            header,
            data,
        }));
    }

    /// Assumes the topics of this program, which are always the same in the same order, because
    /// the chunk that describes those of the file is damaged.
    fn assume(&mut self, each: Each<'_>) {
        self.assumed = true;
        let Ok(known) = writer::known_topics() else {
            return;
        };
        each(Event::Damage(Damage::TopicsAssumed));
        for (opcode, body) in known.records() {
            if matches!(opcode, op::SCHEMA | op::CHANNEL) {
                self.record(opcode, body, each);
            }
        }
    }
}
