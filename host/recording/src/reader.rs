//! Reads `recording.mcap`, whole or broken off.
//!
//! Records are read front to back with bounded memory (one chunk). A file whose
//! writer was killed ends in the middle of a record: the whole chunks before are given
//! out, then [`Reader::broken_off`] says that the end is missing.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read};
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::records::{self, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use protocol::Ticks;

use super::messages::{
    BoardRun, Capture, ClockModel, DiagnosticArray, Imu, LinkFrame, Log, Pulse, Temperature,
    TimeReference, from_cdr,
};
use super::scan::{MAX_RECORD, is_intact, split_record, unpack_records};
use super::{MCAP_FILE, RecordingError, topic};

/// A message of a recording.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Item {
    /// `/board/imu`.
    Imu(Box<Imu>),
    /// `/board/imu_temperature`.
    Temperature(Temperature),
    /// `/board/trigger`.
    Trigger(TimeReference),
    /// `/board/trigger_pulse`.
    Pulse(Pulse),
    /// `/board/strobe`.
    Strobe(TimeReference),
    /// `/board/strobe_capture`.
    Capture(Capture),
    /// `/board/status`.
    Status(DiagnosticArray),
    /// `/link/frames`.
    Link(LinkFrame),
    /// `/session/clock_model`.
    Clock(ClockModel),
    /// A clock model of a further phone, whose name is the `frame_id`.
    PhoneClock(ClockModel),
    /// `/session/markers`.
    Marker(TimeReference),
    /// `/session/host_time`.
    HostTime(TimeReference),
    /// `/session/log`.
    Log(Log),
    /// `/board/output_pulse`.
    Output(Pulse),
    /// `/board/gnss`.
    Gnss(TimeReference),
    /// `/session/board_run`.
    Run(BoardRun),
    /// A topic that this version does not know.
    Other {
        /// The topic.
        topic: String,
        /// The bytes.
        data: Vec<u8>,
    },
}

/// A message with its time.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Board time.
    pub at: Ticks,
    /// Running number on its topic.
    pub sequence: u32,
    /// The message.
    pub item: Item,
}

/// A recording that is being read. It is an iterator of [`Entry`].
pub struct Reader {
    reader: LinearReader,
    file: BufReader<File>,
    path: PathBuf,
    topics: BTreeMap<u16, String>,
    chunk: Option<Chunk>,
    broken_off: bool,
    ended: bool,
}

/// A chunk whose records are being given out.
struct Chunk {
    records: Vec<u8>,
    /// Where the next of them begins.
    at: usize,
    /// Whether its checksum is right.
    intact: bool,
}

/// Board time of a `log_time` or stamp, exactly.
#[must_use]
pub fn ticks_of_nanos(nanos: u64) -> Ticks {
    // round(ns · 6 / 125); ticks are 20.83 ns apart, so rounding to nanoseconds
    // and back is exact.
    let ticks = (u128::from(nanos) * 6 + 62) / 125;
    Ticks(u64::try_from(ticks).unwrap_or(u64::MAX))
}

impl Reader {
    /// Opens the recording in a folder, or an MCAP file.
    ///
    /// # Errors
    ///
    /// The file cannot be read.
    pub fn open(folder_or_file: &Path) -> Result<Self, RecordingError> {
        let path = if folder_or_file.is_dir() {
            folder_or_file.join(MCAP_FILE)
        } else {
            folder_or_file.to_owned()
        };
        let unreadable = |source| RecordingError::Io {
            action: "read",
            path: path.clone(),
            source,
        };
        let file = File::open(&path).map_err(unreadable)?;
        let reader = record_reader(&file).map_err(unreadable)?;
        Ok(Self {
            reader,
            file: BufReader::new(file),
            path,
            topics: BTreeMap::new(),
            chunk: None,
            broken_off: false,
            ended: false,
        })
    }

    /// Whether the file ends in the middle: its writer did not come to its end.
    /// Known once the last entry was given out.
    #[must_use]
    pub const fn broken_off(&self) -> bool {
        self.broken_off
    }

    fn step(&mut self) -> Result<Option<Entry>, RecordingError> {
        loop {
            if let Some(entry) = self.step_in_chunk()? {
                return Ok(Some(entry));
            }
            if self.ended {
                return Ok(None);
            }
            let event = match self.reader.next_event() {
                None => {
                    // Without the record that closes the data the writer was cut.
                    self.ended = true;
                    return Ok(None);
                }
                Some(Ok(event)) => event,
                Some(Err(error)) => {
                    self.ended = true;
                    if is_end(&error) {
                        self.broken_off = true;
                        return Ok(None);
                    }
                    return Err(self.error(error));
                }
            };
            match event {
                LinearReadEvent::ReadRequest(need) => {
                    let space = self.reader.insert(need);
                    let count = self.file.read(space).map_err(|source| RecordingError::Io {
                        action: "read",
                        path: self.path.clone(),
                        source,
                    })?;
                    self.reader.notify_read(count);
                }
                LinearReadEvent::Record { data, opcode } if opcode == op::CHUNK => {
                    let chunk = unpack(data);
                    self.chunk = Some(chunk.map_err(|error| self.error(error))?);
                }
                LinearReadEvent::Record { data, opcode } => {
                    if let Some(entry) = take_up(&mut self.topics, &self.path, opcode, data)? {
                        return Ok(Some(entry));
                    }
                }
            }
        }
    }

    /// The next message of the chunk at hand; `None` if there is none left in it.
    fn step_in_chunk(&mut self) -> Result<Option<Entry>, RecordingError> {
        while let Some(chunk) = &mut self.chunk {
            let rest = chunk.records.get(chunk.at..).unwrap_or_default();
            if rest.is_empty() {
                self.broken_off |= !chunk.intact;
                self.ended |= !chunk.intact;
                self.chunk = None;
                break;
            }
            let Some((opcode, body, after)) = split_record(rest) else {
                return Err(self.error(McapError::UnexpectedEoc));
            };
            chunk.at = chunk.records.len() - after.len();
            if let Some(entry) = take_up(&mut self.topics, &self.path, opcode, body)? {
                return Ok(Some(entry));
            }
        }
        Ok(None)
    }

    fn error(&self, source: McapError) -> RecordingError {
        RecordingError::Mcap {
            path: self.path.clone(),
            source,
        }
    }
}

impl Iterator for Reader {
    type Item = Result<Entry, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let result = self.step();
        if result.is_err() {
            self.ended = true;
        }
        result.transpose()
    }
}

/// A chunk from the body of its record.
fn unpack(body: &[u8]) -> Result<Chunk, McapError> {
    let Record::Chunk { header, data } = mcap::parse_record(op::CHUNK, body)? else {
        return Err(McapError::UnexpectedEoc);
    };
    let unpacked = unpack_records(&header.compression, data, Vec::new());
    match unpacked {
        Ok(records) => Ok(Chunk {
            intact: is_intact(&header, &records),
            records,
            at: 0,
        }),
        Err(error) if error.kind() == ErrorKind::Unsupported => {
            Err(McapError::UnsupportedCompression(header.compression))
        }
        Err(error) => Err(McapError::DecompressionError(error.to_string())),
    }
}

/// Takes up a record: a channel's topic, or a message, which is given out.
fn take_up(
    topics: &mut BTreeMap<u16, String>,
    path: &Path,
    opcode: u8,
    body: &[u8],
) -> Result<Option<Entry>, RecordingError> {
    // Nothing else is of use here, and the parser of attachments takes four bytes for
    // granted.
    if !matches!(opcode, op::CHANNEL | op::MESSAGE) {
        return Ok(None);
    }
    let record = mcap::parse_record(opcode, body).map_err(|source| RecordingError::Mcap {
        path: path.to_owned(),
        source,
    })?;
    match record {
        Record::Channel(channel) => {
            topics.insert(channel.id, channel.topic);
            Ok(None)
        }
        Record::Message { header, data } => {
            let topic = topics.get(&header.channel_id).map_or("", String::as_str);
            entry(&header, topic, &data).map(Some)
        }
        _ => Ok(None),
    }
}

/// A reader of a file's records, which gives chunks as they are and takes no more memory
/// for a record than the file can fill.
///
/// # Errors
///
/// The file's length cannot be told.
pub fn record_reader(file: &File) -> io::Result<LinearReader> {
    let limit = file.metadata()?.len().min(MAX_RECORD);
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_emit_chunks(true)
        .with_record_length_limit(usize::try_from(limit).unwrap_or(usize::MAX));
    Ok(LinearReader::new_with_options(options))
}

/// Whether an error of a [`record_reader`] means that the file ends within a record.
#[must_use]
pub fn is_end(error: &McapError) -> bool {
    match error {
        McapError::UnexpectedEof => true,
        // Longer than the file, then.
        McapError::RecordTooLarge { len, .. } => *len <= MAX_RECORD,
        McapError::Io(error) => error.kind() == ErrorKind::UnexpectedEof,
        _ => false,
    }
}

fn entry(
    header: &records::MessageHeader,
    topic: &str,
    data: &[u8],
) -> Result<Entry, RecordingError> {
    let failed = |source| RecordingError::Message {
        topic: topic.to_owned(),
        source,
    };
    let item = match topic {
        topic::IMU => from_cdr(data).map(|imu| Item::Imu(Box::new(imu))),
        topic::TEMPERATURE => from_cdr(data).map(Item::Temperature),
        topic::TRIGGER => from_cdr(data).map(Item::Trigger),
        topic::PULSE => from_cdr(data).map(Item::Pulse),
        topic::STROBE => from_cdr(data).map(Item::Strobe),
        topic::CAPTURE => from_cdr(data).map(Item::Capture),
        topic::STATUS => from_cdr(data).map(Item::Status),
        topic::LINK => from_cdr(data).map(Item::Link),
        topic::CLOCK => from_cdr(data).map(Item::Clock),
        topic::PHONE_CLOCK => from_cdr(data).map(Item::PhoneClock),
        topic::MARKER => from_cdr(data).map(Item::Marker),
        topic::HOST_TIME => from_cdr(data).map(Item::HostTime),
        topic::LOG => from_cdr(data).map(Item::Log),
        topic::OUTPUT => from_cdr(data).map(Item::Output),
        topic::GNSS => from_cdr(data).map(Item::Gnss),
        topic::RUN => from_cdr(data).map(Item::Run),
        other => Ok(Item::Other {
            topic: other.to_owned(),
            data: data.to_vec(),
        }),
    };
    Ok(Entry {
        at: ticks_of_nanos(header.log_time),
        sequence: header.sequence,
        item: item.map_err(failed)?,
    })
}
