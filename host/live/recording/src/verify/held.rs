//! Compares a recording with what it held when it was closed: messages by topic, files, and
//! `metadata.yaml`.

use std::collections::BTreeMap;
use std::path::Path;

use phone::coverage::{self, AssumedFrames};
use phone::video_files;
use system::ReadMonitor;

use super::fault::Fault;
use super::findings::Findings;
use crate::contents::{Contents, FileContents, FileSums, TopicContents};
use crate::rosbag2::METADATA_FILE;
use crate::session_file::{PhoneRecord, SessionFile};
use crate::{MCAP_FILE, RecordingError};

/// Longest `metadata.yaml` that is read, bytes. One of this program has a few thousand.
const MAX_METADATA: u64 = 1 << 20;

/// Compares the messages of each topic. Returns a sentence on what was compared.
pub(super) fn topics(
    contents: &Contents,
    found: &BTreeMap<String, TopicContents>,
    findings: &mut Findings,
) -> String {
    let names = contents.topics.keys().chain(found.keys());
    let mut names: Vec<&String> = names.collect();
    names.sort();
    names.dedup();
    for name in names {
        let of = |topics: &BTreeMap<String, TopicContents>| {
            topics.get(name).copied().unwrap_or_default()
        };
        let (held, found) = (of(&contents.topics), of(found));
        if held != found {
            let topic = name.clone();
            findings.add(&Fault::TopicDiffers { topic, held, found }, None);
        }
    }
    let messages: u64 = contents.topics.values().map(|topic| topic.messages).sum();
    format!(
        "{messages} messages of {} topics with what was written: count, first and last number and time, \
         checksum",
        contents.topics.len()
    )
}

/// Compares `metadata.yaml` with what the file holds. Returns a sentence on what was compared.
pub(super) fn metadata(folder: &Path, expected: &str, findings: &mut Findings) -> Option<String> {
    match system::read_text(&folder.join(METADATA_FILE), MAX_METADATA) {
        Ok(found) if found == expected => {
            return Some(format!("{METADATA_FILE} with {MCAP_FILE}"));
        }
        Ok(_) => findings.add(&Fault::MetadataDiffers, None),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            findings.add(&Fault::NoMetadata, None);
        }
        Err(_) => findings.add(&Fault::MetadataDiffers, None),
    }
    None
}

/// Compares the files beside `recording.mcap` with those at the end of the session. Returns a
/// sentence on what was compared.
///
/// # Errors
///
/// Returns an error if reads are cancelled.
pub(super) fn files(
    session: &SessionFile,
    folder: &Path,
    sums: &mut FileSums,
    monitor: &ReadMonitor,
    findings: &mut Findings,
) -> Result<Option<String>, RecordingError> {
    let contents = session.contents.as_ref();
    let held = contents.and_then(|contents| contents.files.as_ref());
    for name in &session.files {
        let is_held = held.is_some_and(|held| held.contains_key(name));
        if !is_held && !folder.join(name).exists() {
            findings.add(&Fault::FileMissing(name.clone()), None);
        }
    }
    let Some(held) = held else {
        if contents.is_some() {
            findings.add(&Fault::FilesNotCompared, None);
        }
        return Ok(None);
    };
    let mut bytes = 0;
    for (name, held) in held {
        let path = folder.join(name);
        let found = match path.metadata() {
            // A file of another length is not read.
            Ok(meta) if meta.is_file() && meta.len() != held.bytes => Ok(FileContents {
                bytes: meta.len(),
                checksum: 0,
            }),
            Ok(_) => sums.of(&path, monitor),
            Err(error) => Err(error),
        };
        let name = name.clone();
        match found {
            Ok(found) if found == *held => bytes += held.bytes,
            Ok(found) => {
                let held = *held;
                findings.add(&Fault::FileDiffers { name, held, found }, None);
            }
            Err(error) if system::is_cancelled(&error) => {
                return Err(RecordingError::io("read", &path)(error));
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                findings.add(&Fault::FileMissing(name), None);
            }
            Err(error) => {
                let reason = error.to_string();
                findings.add(&Fault::FileUnreadable { name, reason }, None);
            }
        }
    }
    let count = held.len();
    Ok((count > 0)
        .then(|| format!("{count} files, {bytes} bytes, with size and checksum at the end")))
}

/// Compares the files of each phone's video with each other and with the alignment. Returns a
/// sentence on what was compared.
///
/// # Errors
///
/// Returns an error if reads are cancelled.
pub(super) fn phones(
    session: &SessionFile,
    folder: &Path,
    monitor: &ReadMonitor,
    findings: &mut Findings,
) -> Result<Option<String>, RecordingError> {
    let mut compared = 0;
    for phone in &session.phones {
        let own = folder.join(session.phone_folder(&phone.name));
        // Several videos in one folder are reported by whoever has to choose one.
        let Ok(Some(files)) = video_files::find(&own, None) else {
            continue;
        };
        let assumed = assumed_frames(session, phone);
        match coverage::check(&files, assumed.as_ref(), monitor) {
            Ok(faults) => {
                compared += usize::from(files.frames.is_some());
                for fault in faults {
                    findings.add(&Fault::Phone(fault), None);
                }
            }
            Err(error) if system::is_cancelled(&error) => {
                return Err(RecordingError::io("read", &own)(error));
            }
            Err(error) => {
                let (name, reason) = (files.name, error.to_string());
                findings.add(&Fault::FileUnreadable { name, reason }, None);
            }
        }
    }
    Ok((compared > 0).then(|| {
        String::from(
            "the phone's gyroscope and accelerometer with the span of its frames, and its frames with \
             the period and phase that the trigger was set for",
        )
    }))
}

/// Returns a phone's frames as the trigger was aligned to them; of another phone as it reported them.
#[must_use]
pub fn assumed_frames(session: &SessionFile, phone: &PhoneRecord) -> Option<AssumedFrames> {
    let video = phone.video?;
    let is_reference = session
        .reference()
        .is_some_and(|known| known.name == phone.name);
    let alignment = session.alignment.filter(|_| is_reference);
    let frames = alignment.map(|alignment| alignment.plan.frames);
    Some(AssumedFrames {
        phase: video.phase,
        period_ns: frames.map_or(video.frame_duration_ns, |frames| frames.period_ns),
        sigma_ns: frames.and_then(|frames| frames.sigma_ns),
        boot_minus_frames_ns: video.boot_minus_frames_ns,
    })
}
