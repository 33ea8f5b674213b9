//! The bytes of a recording: checksums, and every record that can be read.

use std::collections::BTreeMap;
use std::path::Path;

use mcap::records::{Channel, MessageHeader, Record, SchemaHeader, op};

use super::{FileReport, Findings, Grade};
use recording::RecordingError;
use recording::chunks::parse;
use recording::reader::ticks_of_nanos;
use recording::scan::{Piece, Scan};
use recording::writer::known_topics;

/// The longest name of a topic that is taken, bytes. There may be 65,536 of them.
const NAME: usize = 1_000;

/// What is done with what can be read.
pub(crate) trait Sink {
    /// The definition of a type.
    fn schema(&mut self, _header: &SchemaHeader, _data: &[u8]) -> Result<(), RecordingError> {
        Ok(())
    }

    fn channel(&mut self, _channel: &Channel) -> Result<(), RecordingError> {
        Ok(())
    }

    fn message(
        &mut self,
        topic: &str,
        header: &MessageHeader,
        data: &[u8],
        findings: &mut Findings,
    ) -> Result<(), RecordingError>;

    fn end_of_chunk(&mut self) -> Result<(), RecordingError> {
        Ok(())
    }

    /// The body of the record of an attached file.
    fn attachment(&mut self, _body: &[u8]) {}

    /// Something is missing here.
    fn gap(&mut self) {}
}

struct Walk<'s> {
    sink: &'s mut dyn Sink,
    topics: BTreeMap<u16, String>,
    /// The topics are taken from this program, not from the file.
    assumed: bool,
    /// The file begins as MCAP files do; else its first bytes are skipped.
    has_magic: bool,
    report: FileReport,
    counted: u64,
}

/// Goes through a file and hands everything that can be read to `sink`. An error if the
/// file cannot be read or is no MCAP file at all, if `stop` says so, or of the sink.
pub(crate) fn walk(
    path: &Path,
    findings: &mut Findings,
    sink: &mut dyn Sink,
    stop: &dyn Fn() -> bool,
) -> Result<FileReport, RecordingError> {
    let io = RecordingError::io("read", path);
    let mut scan = Scan::open(path).map_err(&io)?;
    let mut walk = Walk {
        sink,
        topics: BTreeMap::new(),
        assumed: false,
        has_magic: true,
        report: FileReport {
            bytes: scan.length(),
            ..FileReport::default()
        },
        counted: 0,
    };
    while let Some(piece) = scan.next_piece().map_err(&io)? {
        if stop() {
            return Err(RecordingError::Stopped);
        }
        walk.piece(piece, &scan, findings)?;
    }
    if !walk.has_magic && walk.report.chunks == 0 {
        return Err(RecordingError::mcap(path)(mcap::McapError::BadMagic));
    }
    if walk.report.closed && !walk.report.data_complete {
        findings.add(Grade::Error, "no_end_of_data", None, || {
            String::from("the record that closes the data is damaged")
        });
    }
    if walk.report.closed && walk.counted != 0 && walk.counted != walk.report.messages {
        let (found, said) = (walk.report.messages, walk.counted);
        findings.add(Grade::Error, "message_count", None, || {
            format!("{found} messages can be read where the file's statistics say {said}")
        });
    }
    Ok(walk.report)
}

impl Walk<'_> {
    fn piece(
        &mut self,
        piece: Piece,
        scan: &Scan,
        findings: &mut Findings,
    ) -> Result<(), RecordingError> {
        match piece {
            Piece::Chunk(chunk) => {
                self.report.chunks += 1;
                for (opcode, body) in chunk.records() {
                    self.record(opcode, body, findings)?;
                }
                if chunk.cut_off() > 0 {
                    let bytes = chunk.cut_off();
                    findings.add(Grade::Error, "chunk_cut_off", None, || {
                        format!(
                            "a chunk ends within a record: its last {bytes} bytes cannot be read"
                        )
                    });
                    self.sink.gap();
                }
                self.sink.end_of_chunk()?;
            }
            Piece::BadChunk { at, what, times } => {
                self.report.bad_chunks += 1;
                findings.add(
                    Grade::Error,
                    "chunk_damaged",
                    Some(ticks_of_nanos(times.0)),
                    || format!("the chunk at byte {at} cannot be used: {what}"),
                );
                self.sink.gap();
            }
            Piece::Record(op::DATA_END, body) => {
                self.report.data_complete = true;
                if let Some(Record::DataEnd(end)) = parse(op::DATA_END, &body)
                    && let Some(crc) = scan.data_crc()
                    && end.data_section_crc != 0
                    && end.data_section_crc != crc
                {
                    findings.add(Grade::Error, "data_checksum", None, || {
                        String::from("the checksum over all data is wrong")
                    });
                }
            }
            Piece::Record(op::FOOTER, body) => {
                if let Some(Record::Footer(footer)) = parse(op::FOOTER, &body)
                    && let Some(crc) = scan.summary_crc()
                    && footer.summary_crc != 0
                    && footer.summary_crc != crc
                {
                    findings.add(Grade::Error, "index_checksum", None, || {
                        String::from("the checksum over the index at the end is wrong")
                    });
                }
            }
            // This program packs every message into a chunk: one outside of them,
            // without a checksum, is most likely another record that was damaged.
            Piece::Record(op::MESSAGE, _) if self.report.chunks > 0 => {
                findings.add(Grade::Error, "message_outside_chunk", None, || {
                    String::from("a message stands outside of a chunk and is left out")
                });
                self.sink.gap();
            }
            Piece::Record(op::ATTACHMENT, body) => self.sink.attachment(&body),
            Piece::Record(opcode, body) => self.record(opcode, &body, findings)?,
            Piece::Skipped { from, to } => {
                let bytes = to - from;
                self.has_magic &= from > 0;
                self.report.skipped_bytes += bytes;
                findings.add(Grade::Error, "bytes_damaged", None, || {
                    format!("{bytes} bytes from byte {from} on are no records")
                });
                self.sink.gap();
            }
            Piece::CutOff { at } => {
                self.report.cut_off_at = Some(at);
                findings.add(Grade::Warning, "cut_off", None, || {
                    format!(
                        "the file was not closed: its last whole record ends at byte {at} of {}",
                        self.report.bytes
                    )
                });
                self.sink.gap();
            }
            Piece::End => self.report.closed = true,
        }
        Ok(())
    }

    fn record(
        &mut self,
        opcode: u8,
        body: &[u8],
        findings: &mut Findings,
    ) -> Result<(), RecordingError> {
        match parse(opcode, body) {
            Some(Record::Schema { header, data }) => self.sink.schema(&header, &data),
            Some(Record::Channel(channel)) if channel.topic.len() > NAME => {
                findings.add(Grade::Error, "topic_name", None, || {
                    format!(
                        "a topic's name has {} bytes; up to {NAME} are read",
                        channel.topic.len()
                    )
                });
                Ok(())
            }
            Some(Record::Channel(channel)) => {
                self.sink.channel(&channel)?;
                self.topics.insert(channel.id, channel.topic);
                Ok(())
            }
            Some(Record::Message { header, data }) => self.message(&header, &data, findings),
            Some(Record::Statistics(statistics)) => {
                self.counted = statistics.message_count;
                Ok(())
            }
            None if matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) => {
                findings.add(Grade::Error, "record_damaged", None, || {
                    String::from("a record is not of its kind")
                });
                self.sink.gap();
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn message(
        &mut self,
        header: &MessageHeader,
        data: &[u8],
        findings: &mut Findings,
    ) -> Result<(), RecordingError> {
        if self.topics.is_empty() && !self.assumed {
            self.assume(findings)?;
        }
        let Some(topic) = self.topics.get(&header.channel_id) else {
            findings.add(Grade::Error, "unknown_topic", None, || {
                format!(
                    "a message belongs to channel {}, which is not described",
                    header.channel_id
                )
            });
            return Ok(());
        };
        self.report.messages += 1;
        self.sink.message(topic, header, data, findings)
    }

    /// The chunk that describes the topics is damaged. This program always
    /// describes the same ones in the same order.
    fn assume(&mut self, findings: &mut Findings) -> Result<(), RecordingError> {
        self.assumed = true;
        let Ok(known) = known_topics() else {
            return Ok(());
        };
        findings.add(Grade::Warning, "topics_assumed", None, || {
            String::from(
                "the part that describes the topics is damaged; those of this program are taken",
            )
        });
        for (opcode, body) in known.records() {
            if matches!(opcode, op::SCHEMA | op::CHANNEL) {
                self.record(opcode, body, findings)?;
            }
        }
        Ok(())
    }
}
