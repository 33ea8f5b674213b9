//! What stands beside the clusters: tracks, tags, attachments.

use super::{ebml, id};

/// Most tracks, tags and attachments that are kept.
const MAX_ITEMS: usize = 4096;

/// One track.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Track {
    /// The number in the blocks.
    pub(crate) number: u64,
    /// The number in the tags.
    pub(crate) uid: u64,
    /// Its name.
    pub(crate) name: String,
    /// Its codec.
    pub(crate) codec: String,
    /// Set-up data of the codec.
    pub(crate) codec_private: Vec<u8>,
    /// Width and height in pixels.
    pub(crate) pixels: Option<(u64, u64)>,
}

/// What stands beside the clusters.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Header {
    /// Nanoseconds in one unit of time; `None` if the segment information is lost.
    pub(crate) scale: Option<u64>,
    /// The program that wrote the file.
    pub(crate) written_by: Option<String>,
    /// The tracks.
    pub(crate) tracks: Vec<Track>,
    /// Names and values of the tags.
    pub(crate) tags: Vec<(String, String)>,
    /// Names and bytes of the attached files.
    pub(crate) attachments: Vec<(String, Vec<u8>)>,
    /// Whether the segment knows its size: it is written last, so a file without it
    /// was not closed.
    pub(crate) has_size: bool,
}

impl Header {
    /// The value of a tag.
    pub(crate) fn tag(&self, name: &str) -> Option<&str> {
        let found = self.tags.iter().find(|(tag, _)| tag == name)?;
        Some(&found.1)
    }
}

pub(super) fn read_info(data: &[u8], header: &mut Header) {
    let find = |wanted| ebml::children(data).find(|(child, _)| *child == wanted);
    header.written_by = find(id::WRITING_APP).map(|(_, data)| ebml::text(data));
    // Present but without a scale: the specification's default of one millisecond.
    header.scale = find(id::TIMESTAMP_SCALE)
        .and_then(|(_, data)| ebml::unsigned(data))
        .filter(|&scale| scale > 0)
        .or(Some(1_000_000));
}

pub(super) fn read_tracks(data: &[u8], tracks: &mut Vec<Track>) {
    for (child, data) in ebml::children(data) {
        if child != id::TRACK_ENTRY || tracks.len() >= MAX_ITEMS {
            continue;
        }
        let mut track = Track::default();
        for (child, data) in ebml::children(data) {
            match child {
                id::TRACK_NUMBER => track.number = ebml::unsigned(data).unwrap_or(0),
                id::TRACK_UID => track.uid = ebml::unsigned(data).unwrap_or(0),
                id::NAME => track.name = ebml::text(data),
                id::CODEC_ID => track.codec = ebml::text(data),
                id::CODEC_PRIVATE => track.codec_private = data.to_vec(),
                id::VIDEO => track.pixels = read_pixels(data),
                _ => {}
            }
        }
        tracks.push(track);
    }
}

fn read_pixels(data: &[u8]) -> Option<(u64, u64)> {
    let value = |wanted| {
        ebml::children(data)
            .find(|(child, _)| *child == wanted)
            .and_then(|(_, data)| ebml::unsigned(data))
    };
    Some((value(id::PIXEL_WIDTH)?, value(id::PIXEL_HEIGHT)?))
}

pub(super) fn read_attachments(data: &[u8], attachments: &mut Vec<(String, Vec<u8>)>) {
    for (child, data) in ebml::children(data) {
        if child != id::ATTACHED_FILE || attachments.len() >= MAX_ITEMS {
            continue;
        }
        let mut file = (String::new(), Vec::new());
        for (child, data) in ebml::children(data) {
            match child {
                id::FILE_NAME => file.0 = ebml::text(data),
                id::FILE_DATA => file.1 = data.to_vec(),
                _ => {}
            }
        }
        attachments.push(file);
    }
}

pub(super) fn read_tags(data: &[u8], tags: &mut Vec<(String, String)>) {
    for (child, data) in ebml::children(data) {
        if child != id::TAG {
            continue;
        }
        for (child, data) in ebml::children(data) {
            if child != id::SIMPLE_TAG || tags.len() >= MAX_ITEMS {
                continue;
            }
            let mut tag = (String::new(), String::new());
            for (child, data) in ebml::children(data) {
                match child {
                    id::TAG_NAME => tag.0 = ebml::text(data),
                    id::TAG_STRING => tag.1 = ebml::text(data),
                    _ => {}
                }
            }
            tags.push(tag);
        }
    }
}
