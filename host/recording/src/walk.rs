//! Walks an MCAP file over any damage, and gives everything that can be read: the one reader
//! of bytes below the typed [`reader`](super::reader), `verify`, `repair` and `extract`.
//!
//! ```no_run
//! # fn show(path: &std::path::Path) -> Result<(), recording::RecordingError> {
//! use recording::RecordingError;
//! use recording::walk::{Event, Walk};
//! let mut walk = Walk::open(path)?;
//! while walk.next_part(&mut |event| {
//!     match event {
//!         Event::Message(message) => println!("{}", message.channel.described.topic),
//!         Event::Damage(damage) => println!("{damage}"),
//!         _ => {}
//!     }
//!     Ok::<(), RecordingError>(())
//! })? {}
//! # Ok(())
//! # }
//! ```
//!
//! A part is a chunk, a record outside of chunks, or a place where something is damaged. A
//! file whose writer was killed gives its whole chunks, and then [`Damage::CutOff`].

use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};

use mcap::records::{self, MessageHeader, Record, SchemaHeader, op};
use protocol::Ticks;
use serde::Serialize;

use super::chunks::{BadChunk, parse};
use super::messages::CdrError;
use super::scan::{Piece, Scan};
use super::topic::{Item, Topic};
use super::{RecordingError, bag, ticks_of_nanos, writer};

/// The longest name of a topic that is taken, bytes. There may be 65,536 of them.
const NAME: usize = 1_000;

/// A compression of other programs, that no damage makes of one of ours.
const ZSTD: &str = "zstd";

/// Something in the file.
pub enum Event<'a> {
    /// The definition of a type.
    Schema(&'a SchemaHeader, &'a [u8]),
    /// The description of a topic.
    Channel(&'a Channel),
    /// A message.
    Message(Message<'a>),
    /// All messages of a chunk were given.
    EndOfChunk,
    /// The body of the record of an attached file.
    Attachment(&'a [u8]),
    /// Something cannot be read, or contradicts the rest.
    Damage(Damage),
}

/// A topic of the file.
#[derive(Debug)]
pub struct Channel {
    /// As the file describes it.
    pub described: records::Channel,
    /// Name of the type of its messages, e.g. `sensor_msgs/msg/Imu`; empty if the file does
    /// not say.
    pub kind: String,
    /// The topic of that name, if it is one of ours.
    pub known: Option<Topic>,
}

/// A message as it stands in the file.
pub struct Message<'a> {
    /// Its topic.
    pub channel: &'a Channel,
    /// Times and number.
    pub header: MessageHeader,
    /// Its bytes.
    pub data: &'a [u8],
}

impl Message<'_> {
    /// Board time.
    #[must_use]
    pub fn at(&self) -> Ticks {
        ticks_of_nanos(self.header.log_time)
    }

    /// The message of one of our topics; `None` of any other.
    ///
    /// # Errors
    ///
    /// It is not of its topic's type.
    #[must_use]
    pub fn item(&self) -> Option<Result<Item, CdrError>> {
        Some(self.channel.known?.read(self.data))
    }
}

/// The file as bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FileReport {
    /// Length.
    pub bytes: u64,
    /// Chunks whose checksum is right.
    pub chunks: u64,
    /// Chunks that cannot be used.
    pub bad_chunks: u64,
    /// Bytes that are no records.
    pub skipped_bytes: u64,
    /// Whole records end at this byte: the writer did not come to its end.
    pub cut_off_at: Option<u64>,
    /// The record that closes the data is there: only the index may be missing.
    pub data_complete: bool,
    /// The end that a writer makes is there.
    pub closed: bool,
    /// Messages that can be read.
    pub messages: u64,
}

/// Something that is damaged.
#[derive(Debug)]
pub enum Damage {
    /// A chunk cannot be used.
    Chunk {
        /// Byte at which it begins.
        at: u64,
        /// Board time of its first message, as its head says.
        from: Ticks,
        /// What is wrong with it.
        why: BadChunk,
    },
    /// A chunk ends within a record.
    ChunkEnd {
        /// Bytes behind its last whole record.
        bytes: usize,
    },
    /// Bytes are no records.
    Bytes {
        /// From this byte.
        from: u64,
        /// Up to this one.
        to: u64,
    },
    /// The file ends within a record, or without the records that close it.
    CutOff {
        /// Whole records end here.
        at: u64,
        /// Length of the file.
        length: u64,
        /// The data are complete: only the index is missing.
        complete: bool,
    },
    /// A record is not of its kind.
    Record,
    /// A message stands outside of a chunk, where this program puts none.
    OutsideChunk,
    /// A topic's name is longer than any.
    TopicName {
        /// Its bytes.
        bytes: usize,
    },
    /// A message's topic is not described.
    UnknownTopic {
        /// Number of its channel.
        channel: u16,
    },
    /// No topic is described: those of this program are taken.
    TopicsAssumed,
    /// The checksum over all data is wrong.
    DataChecksum,
    /// The checksum over the index is wrong.
    IndexChecksum,
    /// The record that closes the data is damaged.
    NoEndOfData,
    /// The file's statistics tell another number of messages.
    MessageCount {
        /// Messages that can be read.
        found: u64,
        /// As the statistics say.
        expected: u64,
    },
}

impl Damage {
    /// A stable word for its kind.
    #[must_use]
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Chunk { .. } => "chunk_damaged",
            Self::ChunkEnd { .. } => "chunk_cut_off",
            Self::Bytes { .. } => "bytes_damaged",
            Self::CutOff { .. } => "cut_off",
            Self::Record => "record_damaged",
            Self::OutsideChunk => "message_outside_chunk",
            Self::TopicName { .. } => "topic_name",
            Self::UnknownTopic { .. } => "unknown_topic",
            Self::TopicsAssumed => "topics_assumed",
            Self::DataChecksum => "data_checksum",
            Self::IndexChecksum => "index_checksum",
            Self::NoEndOfData => "no_end_of_data",
            Self::MessageCount { .. } => "message_count",
        }
    }

    /// Whether messages are missing here.
    #[must_use]
    pub const fn is_gap(&self) -> bool {
        matches!(
            self,
            Self::Chunk { .. }
                | Self::ChunkEnd { .. }
                | Self::Bytes { .. }
                | Self::CutOff { .. }
                | Self::Record
                | Self::OutsideChunk
        )
    }

    /// Whether something was left out that the file once held.
    #[must_use]
    pub const fn is_loss(&self) -> bool {
        match self {
            Self::TopicName { .. } | Self::UnknownTopic { .. } => true,
            Self::CutOff { complete, .. } => !*complete,
            _ => self.is_gap(),
        }
    }

    /// Board time of it, where that is known.
    #[must_use]
    pub const fn at(&self) -> Option<Ticks> {
        match self {
            Self::Chunk { from, .. } => Some(*from),
            _ => None,
        }
    }
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Chunk { at, from, why } => {
                let seconds = from.as_secs_f64();
                write!(
                    f,
                    "the chunk at byte {at}, from {seconds:.1} s of board time on, cannot be used: {why}"
                )
            }
            Self::ChunkEnd { bytes } => write!(
                f,
                "a chunk ends within a record: its last {bytes} bytes cannot be read"
            ),
            Self::Bytes { from, to } => {
                write!(f, "{} bytes from byte {from} on are no records", to - from)
            }
            Self::CutOff { at, length, .. } => write!(
                f,
                "the file was not closed: its last whole record ends at byte {at} of {length}"
            ),
            Self::Record => f.write_str("a record is not of its kind"),
            Self::OutsideChunk => {
                f.write_str("a message stands outside of a chunk and is left out")
            }
            Self::TopicName { bytes } => {
                write!(f, "a topic's name has {bytes} bytes; up to {NAME} are read")
            }
            Self::UnknownTopic { channel } => write!(
                f,
                "a message belongs to channel {channel}, which is not described"
            ),
            Self::TopicsAssumed => f.write_str(
                "the part that describes the topics is damaged; those of this program are taken",
            ),
            Self::DataChecksum => f.write_str("the checksum over all data is wrong"),
            Self::IndexChecksum => f.write_str("the checksum over the index at the end is wrong"),
            Self::NoEndOfData => f.write_str("the record that closes the data is damaged"),
            Self::MessageCount { found, expected } => write!(
                f,
                "{found} messages can be read where the file's statistics say {expected}"
            ),
        }
    }
}

/// A file that is being walked.
pub struct Walk {
    scan: Scan,
    path: PathBuf,
    /// What it was opened by: the file, or its folder.
    given: PathBuf,
    topics: Topics,
    /// The file begins as MCAP files do; else its first bytes are skipped.
    has_magic: bool,
    report: FileReport,
    ended: bool,
}

/// What the file has said about its topics, and of its messages.
#[derive(Default)]
struct Topics {
    channels: HashMap<u16, Channel>,
    /// Names of types.
    schemas: HashMap<u16, String>,
    /// The topics are taken from this program, not from the file.
    assumed: bool,
    /// Messages that were read, and by the file's statistics.
    messages: u64,
    counted: u64,
}

/// Takes what is read.
type Each<'e, E> = &'e mut dyn FnMut(Event<'_>) -> Result<(), E>;

impl Walk {
    /// Begins at the front of the recording or bag in a folder, or of an MCAP file.
    ///
    /// # Errors
    ///
    /// There is none ([`bag::mcap_in`]), or the file cannot be opened.
    pub fn open(folder_or_file: &Path) -> Result<Self, RecordingError> {
        let path = bag::mcap_in(folder_or_file)?;
        let scan = Scan::open(&path).map_err(RecordingError::io("read", &path))?;
        Ok(Self {
            report: FileReport {
                bytes: scan.length(),
                ..FileReport::default()
            },
            scan,
            path,
            given: folder_or_file.to_owned(),
            topics: Topics::default(),
            has_magic: true,
            ended: false,
        })
    }

    /// Gives the next part of the file to `each`, in pieces; false behind the last.
    ///
    /// # Errors
    ///
    /// The file cannot be read, or is no MCAP file at all; or those of `each`. Damage is no
    /// error.
    pub fn next_part<E: From<RecordingError>>(&mut self, each: Each<'_, E>) -> Result<bool, E> {
        if self.ended {
            return Ok(false);
        }
        let piece = self.scan.next_piece();
        let piece = piece.map_err(RecordingError::io("read", &self.path))?;
        match piece {
            Some(Piece::BadChunk {
                why: BadChunk::Compression(name),
                ..
            }) if name == ZSTD => {
                return Err(bag::foreign(&self.given, "packed with Zstandard").into());
            }
            Some(piece) => self.piece(piece, each)?,
            None => {
                self.ended = true;
                self.end(each)?;
            }
        }
        self.report.messages = self.topics.messages;
        Ok(!self.ended)
    }

    /// The file as bytes, as far as it was read.
    #[must_use]
    pub const fn report(&self) -> &FileReport {
        &self.report
    }

    /// Bytes read so far.
    #[must_use]
    pub const fn position(&self) -> u64 {
        self.scan.position()
    }

    /// The topics so far, with messages or without.
    pub fn topics(&self) -> impl Iterator<Item = &Channel> {
        self.topics.channels.values()
    }

    fn end<E: From<RecordingError>>(&self, each: Each<'_, E>) -> Result<(), E> {
        let (report, expected) = (&self.report, self.topics.counted);
        if !self.has_magic && report.chunks == 0 {
            return Err(RecordingError::mcap(&self.path)(mcap::McapError::BadMagic).into());
        }
        if report.closed && !report.data_complete {
            each(Event::Damage(Damage::NoEndOfData))?;
        }
        let found = self.topics.messages;
        if report.closed && expected != 0 && expected != found {
            each(Event::Damage(Damage::MessageCount { found, expected }))?;
        }
        Ok(())
    }

    fn piece<E>(&mut self, piece: Piece, each: Each<'_, E>) -> Result<(), E> {
        let damage = match piece {
            Piece::Chunk(chunk) => {
                self.report.chunks += 1;
                for (opcode, body) in chunk.records() {
                    self.topics.record(opcode, body, each)?;
                }
                let bytes = chunk.cut_off();
                self.scan.reuse(chunk);
                if bytes > 0 {
                    each(Event::Damage(Damage::ChunkEnd { bytes }))?;
                }
                return each(Event::EndOfChunk);
            }
            Piece::BadChunk { at, why, from } => {
                self.report.bad_chunks += 1;
                let from = ticks_of_nanos(from);
                Damage::Chunk { at, from, why }
            }
            Piece::Record(op::DATA_END, body) => {
                self.report.data_complete = true;
                match (parse(op::DATA_END, &body), self.scan.data_crc()) {
                    (Some(Record::DataEnd(end)), Some(crc))
                        if ![0, crc].contains(&end.data_section_crc) =>
                    {
                        Damage::DataChecksum
                    }
                    _ => return Ok(()),
                }
            }
            Piece::Record(op::FOOTER, body) => {
                match (parse(op::FOOTER, &body), self.scan.summary_crc()) {
                    (Some(Record::Footer(footer)), Some(crc))
                        if ![0, crc].contains(&footer.summary_crc) =>
                    {
                        Damage::IndexChecksum
                    }
                    _ => return Ok(()),
                }
            }
            // Whoever makes chunks packs every message into one: a message outside of them,
            // without a checksum, is most likely another record that was damaged.
            Piece::Record(op::MESSAGE, _) if self.report.chunks > 0 => Damage::OutsideChunk,
            Piece::Record(op::ATTACHMENT, body) => return each(Event::Attachment(&body)),
            Piece::Record(opcode, body) => return self.topics.record(opcode, &body, each),
            Piece::Skipped { from, to } => {
                self.has_magic &= from > 0;
                self.report.skipped_bytes += to - from;
                Damage::Bytes { from, to }
            }
            Piece::CutOff { at } => {
                self.report.cut_off_at = Some(at);
                Damage::CutOff {
                    at,
                    length: self.report.bytes,
                    complete: self.report.data_complete,
                }
            }
            Piece::End => {
                self.report.closed = true;
                return Ok(());
            }
        };
        each(Event::Damage(damage))
    }
}

impl Topics {
    fn record<E>(&mut self, opcode: u8, body: &[u8], each: Each<'_, E>) -> Result<(), E> {
        match parse(opcode, body) {
            Some(Record::Schema { header, data }) => {
                each(Event::Schema(&header, &data))?;
                self.schemas.insert(header.id, header.name);
                Ok(())
            }
            Some(Record::Channel(described)) if described.topic.len() > NAME => {
                let bytes = described.topic.len();
                each(Event::Damage(Damage::TopicName { bytes }))
            }
            Some(Record::Channel(described)) => {
                let schema = self.schemas.get(&described.schema_id);
                let channel = Channel {
                    kind: schema.cloned().unwrap_or_default(),
                    known: Topic::of(&described.topic),
                    described,
                };
                each(Event::Channel(&channel))?;
                self.channels.insert(channel.described.id, channel);
                Ok(())
            }
            Some(Record::Message { header, data }) => self.message(header, &data, each),
            Some(Record::Statistics(statistics)) => {
                self.counted = statistics.message_count;
                Ok(())
            }
            None if matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) => {
                each(Event::Damage(Damage::Record))
            }
            _ => Ok(()),
        }
    }

    fn message<E>(
        &mut self,
        header: MessageHeader,
        data: &[u8],
        each: Each<'_, E>,
    ) -> Result<(), E> {
        if self.channels.is_empty() && !self.assumed {
            self.assume(each)?;
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
        }))
    }

    /// Takes the topics that this program describes, always the same ones in the same order:
    /// the chunk that describes those of the file is damaged.
    fn assume<E>(&mut self, each: Each<'_, E>) -> Result<(), E> {
        self.assumed = true;
        let Ok(known) = writer::known_topics() else {
            return Ok(());
        };
        each(Event::Damage(Damage::TopicsAssumed))?;
        for (opcode, body) in known.records() {
            if matches!(opcode, op::SCHEMA | op::CHANNEL) {
                self.record(opcode, body, each)?;
            }
        }
        Ok(())
    }
}
