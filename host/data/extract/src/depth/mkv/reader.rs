//! Forward reader of Matroska segments (RFC 9559) that tolerates damage.
//!
//! [`Mkv::open`] reads everything before the first cluster, and then the elements
//! after the clusters. [`Mkv::next_cluster`]
//! reads one cluster after the other. Where the bytes are invalid, it continues
//! at the next position that looks like a cluster, and adds the loss to
//! [`Mkv::damage`]. A cluster with a CRC-32 element is checked against it.

use std::fmt::Display;
use std::io;

use system::Sparse;

use super::block::{Block, Checksum};
use super::ebml::{self, EbmlError, Head, Source};
use super::header::Header;
use super::id;
use crate::faults::Faults;

/// Largest size of a cluster, bytes (the camera's clusters cover 32 ms, at most 66 MB in its
/// largest colour mode, uncompressed 4K).
pub(crate) const MAX_CLUSTER: u64 = 256 << 20;
/// Largest size of an element outside of the clusters, bytes.
const MAX_HEADER: u64 = 16 << 20;
/// Largest number of frames in one cluster.
const MAX_FRAMES: usize = 100_000;
/// Largest number of described faults.
const MAX_DAMAGE: usize = 1000;

/// IDs of the children of a segment, each of which ends a cluster of unknown size.
const TOP_LEVEL: [u32; 8] = [
    id::SEEK_HEAD,
    id::INFO,
    id::TRACKS,
    id::ATTACHMENTS,
    id::TAGS,
    id::CUES,
    id::CHAPTERS,
    id::CLUSTER,
];

/// Reason why a file cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum MkvError {
    /// Reading failed, or the beginning is invalid.
    #[error(transparent)]
    Ebml(#[from] EbmlError),
    /// The file begins with something else.
    #[error(
        "this is no Matroska file: expected an EBML head with document type \"matroska\", found {found}"
    )]
    NotMatroska {
        /// Description of its beginning.
        found: String,
    },
    /// There is no list of tracks before the first cluster.
    #[error(
        "the file has no list of tracks; it is cut off within its first bytes or not a recording"
    )]
    NoTracks,
}

impl From<io::Error> for MkvError {
    fn from(error: io::Error) -> Self {
        Self::Ebml(error.into())
    }
}

/// Frame of a track.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Frame {
    /// Number of the track.
    pub(crate) track: u64,
    /// Time of its block, in units of the file.
    pub(crate) time: i64,
    /// Size in bytes.
    pub(crate) size: usize,
    /// Content; empty if it was not requested.
    pub(crate) data: Vec<u8>,
}

/// Cluster of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Cluster {
    /// Frames in the order of the file.
    pub(crate) frames: Vec<Frame>,
    /// True if the CRC is right; `None` if there is none, or if the cluster was not read in full.
    pub(crate) crc_ok: Option<bool>,
}

/// Returns true for the number of a track whose content is requested; other frames have only
/// time and size.
pub(crate) type Wanted<'a> = &'a dyn Fn(u64) -> bool;

/// Open Matroska file.
pub(crate) struct Mkv<R> {
    source: Source<R>,
    header: Header,
    end: u64,
    damage: Faults,
    buffer: Vec<u8>,
}

impl<R: Sparse> Mkv<R> {
    /// Opens a file and reads everything outside of its clusters.
    ///
    /// # Errors
    ///
    /// Fails if the content is no Matroska file, or has no tracks.
    pub(crate) fn open(reader: R) -> Result<Self, MkvError> {
        let mut source = Source::new(reader)?;
        check_document(&mut source)?;
        let segment = loop {
            match source.head()? {
                None => return Err(MkvError::NoTracks),
                Some(head) if head.id == id::SEGMENT => break head,
                Some(head) => skip(&mut source, &head)?,
            }
        };
        let length = source.length();
        // The camera's recorder writes the size when it closes the file, and 0 until then.
        let end = segment.end().filter(|&end| end > segment.data);
        let mut mkv = Self {
            end: end.unwrap_or(length).min(length),
            source,
            header: Header {
                has_size: end.is_some_and(|end| end <= length),
                ..Header::default()
            },
            damage: Faults::new(MAX_DAMAGE),
            buffer: Vec::new(),
        };
        mkv.read_header()?;
        Ok(mkv)
    }

    /// Returns the content outside of the clusters.
    pub(crate) fn header(&self) -> &Header {
        &self.header
    }

    /// Returns descriptions of what could not be read so far.
    pub(crate) fn damage(&self) -> &[String] {
        self.damage.first()
    }

    fn read_header(&mut self) -> Result<(), MkvError> {
        // A damaged element before the tracks must not hide them.
        let first_cluster = loop {
            let head = match self.source.head() {
                Ok(None) => break None,
                Ok(Some(head)) => head,
                Err(EbmlError::Io(error)) => return Err(error.into()),
                Err(error) => {
                    let at = self.source.position();
                    let found = self.source.find(id::CLUSTER, at)?;
                    self.note(at, self.source.position() - at, error);
                    if found {
                        continue;
                    }
                    break None;
                }
            };
            if head.id == id::CLUSTER {
                break Some(head.at);
            }
            self.read_top_level(&head)?;
        };
        if self.header.tracks.is_empty() {
            return Err(MkvError::NoTracks);
        }
        let Some(first_cluster) = first_cluster else {
            return Ok(());
        };
        // Remuxed files have tags at the end. Skipping clusters reads only
        // their heads.
        self.source.seek(first_cluster)?;
        while let Ok(Some(head)) = self.source.head() {
            if head.id == id::CLUSTER {
                if head.end().is_none_or(|end| end > self.end) {
                    break;
                }
                skip(&mut self.source, &head)?;
            } else if self.read_top_level(&head).is_err() {
                break;
            }
        }
        self.source.seek(first_cluster)?;
        Ok(())
    }

    fn read_top_level(&mut self, head: &Head) -> Result<(), MkvError> {
        let Some(size) = head.size else {
            // Only segments and clusters may lack a size, so this one cannot be skipped.
            self.note(head.at, 0, format!("element {:X} has no size", head.id));
            return Ok(());
        };
        if Header::includes(head.id) {
            let mut data = Vec::new();
            match self.source.read_into(size, MAX_HEADER, &mut data) {
                Ok(()) => self.header.add(head.id, &data),
                Err(EbmlError::Io(error)) => return Err(error.into()),
                Err(error) => self.note(head.at, size.min(self.source.remaining()), error),
            }
        }
        self.source.seek(head.data.saturating_add(size))?;
        Ok(())
    }

    /// Reads the next cluster; `None` at the end of the file.
    ///
    /// # Errors
    ///
    /// Fails if the file cannot be read (damage is no error).
    pub(crate) fn next_cluster(&mut self, wanted: Wanted<'_>) -> io::Result<Option<Cluster>> {
        loop {
            let at = self.source.position();
            let result = match self.source.head() {
                Ok(None) => return Ok(None),
                Ok(Some(head)) if head.at >= self.end && head.id != id::CLUSTER => return Ok(None),
                Ok(Some(head)) if head.id == id::CLUSTER => self.read_cluster(&head, wanted),
                Ok(Some(head)) => match head.end() {
                    Some(end) if end <= self.source.length() && is_known(head.id) => {
                        self.source.seek(end)?;
                        continue;
                    }
                    _ => Err(EbmlError::Invalid {
                        at,
                        what: "no cluster where one should begin",
                    }),
                },
                Err(error) => Err(error),
            };
            match result {
                Ok(cluster) => return Ok(Some(cluster)),
                Err(EbmlError::Io(error)) => return Err(error),
                Err(error) => {
                    let found = self.source.find(id::CLUSTER, at + 1)?;
                    self.note(at, self.source.position() - at, error);
                    if !found {
                        return Ok(None);
                    }
                }
            }
        }
    }

    /// Reads the children of a cluster. The readable part of a damaged cluster is
    /// returned, and the rest noted as damage.
    fn read_cluster(&mut self, cluster: &Head, wanted: Wanted<'_>) -> Result<Cluster, EbmlError> {
        let length = self.source.length();
        let end = cluster.end().unwrap_or(length);
        let limit = cluster.data.saturating_add(MAX_CLUSTER).min(length);
        let mut out = Cluster::default();
        let mut crc = Checksum::default();
        let mut time: i64 = 0;
        loop {
            let at = self.source.position();
            if at >= end {
                break;
            }
            let head = match self.source.head() {
                Ok(None) => break self.cut_off(at, cluster),
                Ok(Some(head)) => head,
                Err(EbmlError::Truncated { .. }) => break self.cut_off(at, cluster),
                Err(EbmlError::Io(error)) => return Err(error.into()),
                Err(error) => break self.skip_rest(cluster.at, at, &error)?,
            };
            if TOP_LEVEL.contains(&head.id) {
                // The end of a cluster of unknown size, or a cluster whose size
                // is wrong. The next call begins here.
                if cluster.size.is_some() {
                    let what = "a cluster is shorter than its size says";
                    self.note(cluster.at, 0, what);
                    crc = Checksum::default();
                }
                self.source.seek(at)?;
                break;
            }
            let Some(child_end) = head.end().filter(|&child| child <= end) else {
                let error = EbmlError::Invalid {
                    at,
                    what: "an element is larger than its cluster",
                };
                break self.skip_rest(cluster.at, at, &error)?;
            };
            if child_end > length {
                break self.cut_off(at, cluster);
            }
            if child_end > limit || out.frames.len() >= MAX_FRAMES {
                let error = EbmlError::TooLarge {
                    at: cluster.at,
                    size: child_end - cluster.data,
                    limit: MAX_CLUSTER,
                };
                break self.skip_rest(cluster.at, at, &error)?;
            }
            let size = child_end - head.data;
            match head.id {
                id::TIMESTAMP | id::CRC32 => {
                    let mut data = Vec::new();
                    self.source.read_into(size, 8, &mut data)?;
                    if head.id == id::CRC32 && crc.is_unused() {
                        crc.expect(&data);
                    } else {
                        crc.add(&head, &data);
                        time = ebml::unsigned(&data)
                            .and_then(|time| i64::try_from(time).ok())
                            .unwrap_or(0);
                    }
                }
                id::SIMPLE_BLOCK | id::BLOCK_GROUP => {
                    let whole = self.read_block(&head, size, time, wanted, &mut out)?;
                    if whole {
                        crc.add(&head, &self.buffer);
                    } else {
                        crc.skip();
                    }
                }
                _ => {
                    self.source.read_into(size, MAX_CLUSTER, &mut self.buffer)?;
                    crc.add(&head, &self.buffer);
                }
            }
        }
        out.crc_ok = crc.matches();
        Ok(out)
    }

    /// Reads the frames of a block. Returns true if all its bytes are in `self.buffer`.
    fn read_block(
        &mut self,
        head: &Head,
        size: u64,
        time: i64,
        wanted: Wanted<'_>,
        out: &mut Cluster,
    ) -> Result<bool, EbmlError> {
        // Peek at the track first, to skip blocks that are not requested.
        let peek = size.min(16);
        if head.id == id::SIMPLE_BLOCK {
            self.source.read_into(peek, 16, &mut self.buffer)?;
            if let Some(block) = Block::parse(&self.buffer)
                && !wanted(block.track)
                && block.lacing == 0
            {
                let header = peek - block.payload.len() as u64;
                out.frames.push(Frame {
                    track: block.track,
                    time: time.saturating_add(block.time.into()),
                    size: usize::try_from(size - header).unwrap_or(usize::MAX),
                    data: Vec::new(),
                });
                self.source.seek(head.data.saturating_add(size))?;
                return Ok(false);
            }
            self.source.seek(head.data)?;
        }
        self.source.read_into(size, MAX_CLUSTER, &mut self.buffer)?;
        let block = if head.id == id::SIMPLE_BLOCK {
            Some(self.buffer.as_slice())
        } else {
            ebml::child(&self.buffer, id::BLOCK)
        };
        let frames = block.and_then(Block::parse).and_then(|block| {
            let sizes = block.frames()?;
            Some((block.track, block.time, sizes))
        });
        let Some((track, relative, parts)) = frames else {
            let what = "a block whose head or lacing makes no sense";
            self.note(head.at, size, what);
            return Ok(true);
        };
        let is_wanted = wanted(track);
        let time = time.saturating_add(relative.into());
        for part in parts {
            out.frames.push(Frame {
                track,
                time,
                size: part.len(),
                data: if is_wanted { part.to_vec() } else { Vec::new() },
            });
        }
        Ok(true)
    }

    /// Notes that the file ends within a cluster, and moves to its end.
    fn cut_off(&mut self, at: u64, cluster: &Head) {
        let length = self.source.length();
        // A cluster of unknown size may end with the file.
        if cluster.size.is_some() || at < length {
            let rest = length - at.min(length);
            self.note(at, rest, "the file ends within a cluster");
        }
        // If seeking to the end of a readable file fails, the next read fails too.
        let _ = self.source.seek(length);
    }

    /// Notes that a cluster cannot be read to its end, and moves to the next one.
    fn skip_rest(&mut self, cluster: u64, at: u64, error: &EbmlError) -> io::Result<()> {
        let _ = self.source.find(id::CLUSTER, at.max(cluster + 4))?;
        let next = self.source.position();
        self.note(at, next - at, error);
        Ok(())
    }

    /// Notes bytes that are left out, with the reason.
    fn note(&mut self, at: u64, bytes: u64, what: impl Display) {
        let what = format!("byte {at}, {bytes} bytes: {what}");
        self.damage.add(what);
    }
}

fn is_known(head: u32) -> bool {
    TOP_LEVEL.contains(&head) || head == id::VOID || head == id::CRC32
}

/// Moves to the end of an element.
fn skip<R: Sparse>(source: &mut Source<R>, head: &Head) -> Result<(), EbmlError> {
    let Some(end) = head.end() else {
        return Err(EbmlError::Invalid {
            at: head.at,
            what: "an element without a size where one is needed",
        });
    };
    source.seek(end)?;
    Ok(())
}

/// Checks that the EBML head has a Matroska document type.
fn check_document<R: Sparse>(source: &mut Source<R>) -> Result<(), MkvError> {
    let not = |found: &str| MkvError::NotMatroska {
        found: found.to_owned(),
    };
    let head = match source.head() {
        Ok(Some(head)) if head.id == id::EBML => head,
        Ok(None) => return Err(not("an empty file")),
        Err(EbmlError::Io(error)) => return Err(error.into()),
        _ => return Err(not("something else")),
    };
    let Some(size) = head.size else {
        return Err(not("an EBML head without a size"));
    };
    let mut data = Vec::new();
    source.read_into(size, 4096, &mut data)?;
    let kind = ebml::child(&data, id::DOC_TYPE).map(ebml::text);
    match kind.as_deref() {
        Some("matroska" | "webm") => Ok(()),
        Some(other) => Err(not(&format!("document type {:?}", clip(other)))),
        None => Err(not("an EBML head without a document type")),
    }
}

fn clip(text: &str) -> String {
    text.chars().take(32).collect()
}
