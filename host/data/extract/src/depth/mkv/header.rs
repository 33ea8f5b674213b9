//! Content outside of the clusters: tracks, tags, attachments.

use super::{ebml, id};

/// Largest number of tracks, of tags, and of attachments that are kept.
const MAX_ITEMS: usize = 4096;

/// Track of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Track {
    /// Number that blocks refer to.
    pub(crate) number: u64,
    /// Number that tags refer to.
    pub(crate) uid: u64,
    /// Name of the track.
    pub(crate) name: String,
    /// ID of the codec.
    pub(crate) codec: String,
    /// Set-up data of the codec.
    pub(crate) codec_private: Vec<u8>,
    /// Width and height in pixels.
    pub(crate) pixels: Option<(u64, u64)>,
}

/// Content of a file outside of its clusters.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Header {
    /// Unit of time, ns; `None` if the segment information is lost.
    pub(crate) scale: Option<u64>,
    /// Program that wrote the file.
    pub(crate) written_by: Option<String>,
    /// The tracks.
    pub(crate) tracks: Vec<Track>,
    /// Names and values of the tags.
    pub(crate) tags: Vec<(String, String)>,
    /// Names and bytes of the attached files.
    pub(crate) attachments: Vec<(String, Vec<u8>)>,
    /// True if the segment states its size, which is written last: a file without it
    /// was not closed.
    pub(crate) has_size: bool,
}

impl Header {
    /// Returns the value of a tag.
    pub(crate) fn tag(&self, name: &str) -> Option<&str> {
        let found = self.tags.iter().find(|(tag, _)| tag == name)?;
        Some(&found.1)
    }

    /// Returns true if elements with this ID belong to the header.
    pub(super) fn includes(id: u32) -> bool {
        matches!(id, id::INFO | id::TRACKS | id::ATTACHMENTS | id::TAGS)
    }

    /// Adds the content of an element.
    pub(super) fn add(&mut self, id: u32, data: &[u8]) {
        match id {
            id::INFO => read_info(data, self),
            id::TRACKS => extend(&mut self.tracks, read_tracks(data)),
            id::ATTACHMENTS => extend(&mut self.attachments, read_attachments(data)),
            id::TAGS => extend(&mut self.tags, read_tags(data)),
            _ => {}
        }
    }
}

/// Adds items up to [`MAX_ITEMS`].
fn extend<T>(kept: &mut Vec<T>, items: impl Iterator<Item = T>) {
    let room = MAX_ITEMS.saturating_sub(kept.len());
    kept.extend(items.take(room));
}

fn unsigned(data: &[u8], id: u32) -> Option<u64> {
    ebml::unsigned(ebml::child(data, id)?)
}

fn text(data: &[u8], id: u32) -> Option<String> {
    ebml::child(data, id).map(ebml::text)
}

fn bytes(data: &[u8], id: u32) -> Vec<u8> {
    ebml::child(data, id).unwrap_or_default().to_vec()
}

fn read_info(data: &[u8], header: &mut Header) {
    header.written_by = text(data, id::WRITING_APP);
    // Present but without a scale: the specification's default of one millisecond.
    header.scale = unsigned(data, id::TIMESTAMP_SCALE)
        .filter(|&scale| scale > 0)
        .or(Some(1_000_000));
}

fn read_tracks(data: &[u8]) -> impl Iterator<Item = Track> {
    ebml::all(data, id::TRACK_ENTRY).map(|track| Track {
        number: unsigned(track, id::TRACK_NUMBER).unwrap_or(0),
        uid: unsigned(track, id::TRACK_UID).unwrap_or(0),
        name: text(track, id::NAME).unwrap_or_default(),
        codec: text(track, id::CODEC_ID).unwrap_or_default(),
        codec_private: bytes(track, id::CODEC_PRIVATE),
        pixels: ebml::child(track, id::VIDEO).and_then(read_pixels),
    })
}

fn read_pixels(video: &[u8]) -> Option<(u64, u64)> {
    let width = unsigned(video, id::PIXEL_WIDTH)?;
    Some((width, unsigned(video, id::PIXEL_HEIGHT)?))
}

fn read_attachments(data: &[u8]) -> impl Iterator<Item = (String, Vec<u8>)> {
    ebml::all(data, id::ATTACHED_FILE).map(|file| {
        let name = text(file, id::FILE_NAME).unwrap_or_default();
        (name, bytes(file, id::FILE_DATA))
    })
}

fn read_tags(data: &[u8]) -> impl Iterator<Item = (String, String)> {
    let tags = ebml::all(data, id::TAG).flat_map(|tag| ebml::all(tag, id::SIMPLE_TAG));
    tags.map(|tag| {
        let name = text(tag, id::TAG_NAME).unwrap_or_default();
        (name, text(tag, id::TAG_STRING).unwrap_or_default())
    })
}
