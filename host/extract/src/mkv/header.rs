//! What stands beside the clusters: tracks, tags, attachments.

use super::{ebml, id};

/// Most tracks, tags and attachments that are kept.
const MAX_ITEMS: usize = 4096;

/// One track.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Track {
    /// The number in the blocks.
    pub number: u64,
    /// The number in the tags.
    pub uid: u64,
    /// Its name.
    pub name: String,
    /// Its codec.
    pub codec: String,
    /// Set-up data of the codec.
    pub codec_private: Vec<u8>,
    /// Nominal distance of frames in ns.
    pub frame_duration: Option<u64>,
    /// Width and height in pixels.
    pub pixels: Option<(u64, u64)>,
}

/// What stands beside the clusters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Header {
    /// Nanoseconds in one unit of time; `None` if the segment information is lost.
    pub scale: Option<u64>,
    /// Duration in units, if it was written.
    pub duration: Option<f64>,
    /// The program that wrote it.
    pub writing_app: Option<String>,
    /// The tracks.
    pub tracks: Vec<Track>,
    /// Names and values of the tags.
    pub tags: Vec<(String, String)>,
    /// Names and bytes of the attached files.
    pub attachments: Vec<(String, Vec<u8>)>,
    /// Whether an index was found: it is written last, so a file without one was
    /// not closed.
    pub has_cues: bool,
    /// Whether the segment knows its size: written at closing too.
    pub has_size: bool,
}

impl Header {
    /// The value of a tag.
    #[must_use]
    pub fn tag(&self, name: &str) -> Option<&str> {
        let found = self.tags.iter().find(|(tag, _)| tag == name)?;
        Some(&found.1)
    }
}

pub(super) fn read_info(data: &[u8], header: &mut Header) {
    for (child, data) in ebml::children(data) {
        match child {
            id::TIMESTAMP_SCALE => header.scale = ebml::unsigned(data).filter(|&scale| scale > 0),
            id::DURATION => header.duration = ebml::float(data),
            id::WRITING_APP => header.writing_app = Some(ebml::text(data)),
            _ => {}
        }
    }
    // Present but without a scale: the specification's default of one millisecond.
    header.scale.get_or_insert(1_000_000);
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
                id::DEFAULT_DURATION => track.frame_duration = ebml::unsigned(data),
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
