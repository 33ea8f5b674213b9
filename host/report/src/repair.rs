//! A damaged or unfinished recording as a whole one: everything that can be read,
//! in a new place. The recording itself is never written to.
//!
//! Messages are taken over byte by byte with their times and numbers, chunk by
//! chunk; what is new is the end of the file with its index. What was lost stays
//! lost, and `smartdepthsync verify` of the result says what it is.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::Attachment;
use mcap::records::{Record, SchemaHeader, op};
use mcap::write::NoSeek;
use protocol::Ticks;
use serde::Serialize;

use crate::summary::Summary;
use crate::verify::{Findings, Report, session_of, verify, walk};
use recording::chunks::parse;
use recording::finding::Finding;
use recording::rosbag2::{self, METADATA_FILE, options};
use recording::session_file::{SessionFile, SessionOutcome};
use recording::walk::{Channel, Event, FileReport, Message, Walk};
use recording::writer::attach;
use recording::{MCAP_FILE, RecordingError, SESSION_FILE, Topic, mcap_of};

/// The result of a repair.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Repaired {
    /// The new recording.
    pub out: PathBuf,
    /// The file as it was.
    pub before: FileReport,
    /// Chunks, bytes or a last part had to be left out.
    pub lost: bool,
    /// Files that were copied beside it.
    pub copied: Vec<String>,
    /// The check of the new recording.
    pub after: Report,
}

/// Makes a whole recording of what can be read of another.
///
/// `recording` is a folder or an MCAP file; `out` becomes the same, and must not
/// be there yet.
///
/// # Errors
///
/// The recording cannot be read at all, or the new one cannot be written.
pub fn repair(recording: &Path, out: &Path) -> Result<Repaired, RecordingError> {
    let from = mcap_of(recording);
    let is_folder = recording.is_dir();
    // Before anything is made: is there something to repair.
    Walk::open(&from)?;
    let to = if is_folder {
        std::fs::create_dir(out).map_err(RecordingError::io("make the folder", out))?;
        out.join(MCAP_FILE)
    } else {
        out.to_owned()
    };
    let mut copy = Copy::create(&to)?;
    let before = match walk(&from, &mut |event| copy.take(event)) {
        Ok(report) => report,
        Err(error) => {
            drop(copy);
            // Only what was made here is taken away again.
            let _ = std::fs::remove_file(&to);
            if is_folder {
                let _ = std::fs::remove_dir(out);
            }
            return Err(error);
        }
    };
    let lost = copy.lost;
    let session = repaired_session(&from, &before, copy.last);
    copy.finish(session.as_ref(), is_folder.then_some(out))?;
    let mut copied = Vec::new();
    if is_folder {
        copy_files(recording, out, Path::new(""), &mut copied)?;
        if let Some(session) = session {
            session.save(out)?;
            copied.push(SESSION_FILE.to_owned());
        }
    }
    Ok(Repaired {
        out: out.to_owned(),
        before,
        lost,
        copied,
        after: verify(out)?,
    })
}

struct Copy {
    mcap: mcap::Writer<NoSeek<BufWriter<File>>>,
    file: File,
    path: PathBuf,
    schemas: BTreeSet<u16>,
    channels: BTreeSet<u16>,
    attached: Vec<Attachment<'static>>,
    last: Ticks,
    /// Something of the file was left out.
    lost: bool,
}

impl Repaired {
    /// What was taken over and left out, before the check of the new recording.
    #[must_use]
    pub fn summary(&self) -> Summary {
        let before = &self.before;
        let (messages, chunks, files) = (before.messages, before.chunks, self.copied.len());
        let (chunks_lost, bytes_lost) = (before.bad_chunks, before.skipped_bytes);
        let last = before.cut_off_at.map_or(String::new(), |at| {
            format!(", {} bytes of a last part", before.bytes - at)
        });
        let taken = format!("{messages} messages in {chunks} chunks, {files} files beside it");
        let left = format!("{chunks_lost} damaged chunks, {bytes_lost} damaged bytes{last}");
        let mut summary = self.after.summary();
        let facts = [("taken over", taken), ("left out", left)];
        summary.facts.splice(0..0, facts);
        summary
    }
}

impl Copy {
    fn create(path: &Path) -> Result<Self, RecordingError> {
        let file = File::create_new(path).map_err(RecordingError::io("write", path))?;
        let copy = file
            .try_clone()
            .map_err(RecordingError::io("write", path))?;
        let mcap = options()
            .create(NoSeek::new(BufWriter::with_capacity(1 << 20, file)))
            .map_err(RecordingError::mcap(path))?;
        Ok(Self {
            mcap,
            file: copy,
            path: path.to_owned(),
            schemas: BTreeSet::new(),
            channels: BTreeSet::new(),
            attached: Vec::new(),
            last: Ticks::ZERO,
            lost: false,
        })
    }

    /// Ends the file, with the session attached (without one, with what was attached
    /// before); in a recording's `folder`, with what makes it a rosbag2.
    fn finish(
        mut self,
        session: Option<&SessionFile>,
        folder: Option<&Path>,
    ) -> Result<(), RecordingError> {
        let attached = match session {
            Some(session) => attach(&mut self.mcap, self.last, session),
            None => self
                .attached
                .iter()
                .try_for_each(|old| self.mcap.attach(old)),
        };
        attached.map_err(RecordingError::mcap(&self.path))?;
        let summary = self
            .mcap
            .finish()
            .map_err(RecordingError::mcap(&self.path))?;
        self.file
            .sync_all()
            .map_err(RecordingError::io("write", &self.path))?;
        match folder {
            Some(folder) => rosbag2::save(folder, &summary),
            None => Ok(()),
        }
    }
}

impl Copy {
    fn take(&mut self, event: Event<'_>) -> Result<(), RecordingError> {
        match event {
            Event::Schema(header, data) => self.schema(header, data),
            Event::Channel(channel) => self.channel(channel),
            Event::Message(message) => return self.message(&message),
            Event::EndOfChunk => {
                let flushed = self.mcap.flush();
                return flushed.map_err(RecordingError::mcap(&self.path));
            }
            Event::Attachment(body) => self.attachment(body),
            Event::Damage(damage) => self.lost |= damage.is_loss(),
        }
        Ok(())
    }

    fn schema(&mut self, header: &SchemaHeader, data: &[u8]) {
        if !self.schemas.insert(header.id) {
            return;
        }
        // A definition that contradicts another is damage of its own; the messages are kept
        // without it.
        let (name, encoding) = (&header.name, &header.encoding);
        let added = self
            .mcap
            .add_schema_with_id(header.id, name, encoding, data);
        if let Err(error) = added {
            tracing::warn!("a type is left out: {error}");
            self.schemas.remove(&header.id);
        }
    }

    fn channel(&mut self, channel: &Channel) {
        let channel = &channel.described;
        if !self.channels.insert(channel.id) {
            return;
        }
        let schema = Some(channel.schema_id).filter(|id| self.schemas.contains(id));
        let added = self.mcap.add_channel_with_id(
            channel.id,
            schema.unwrap_or(0),
            &channel.topic,
            &channel.message_encoding,
            &channel.metadata,
        );
        if let Err(error) = added {
            tracing::warn!("a topic is left out: {error}");
            self.channels.remove(&channel.id);
        }
    }

    fn message(&mut self, message: &Message<'_>) -> Result<(), RecordingError> {
        if !self.channels.contains(&message.header.channel_id) {
            return Ok(());
        }
        if matches!(
            message.channel.known,
            Some(Topic::Imu | Topic::Pulse | Topic::Status)
        ) {
            self.last = self.last.max(message.at());
        }
        let written = self
            .mcap
            .write_to_known_channel(&message.header, message.data);
        written.map_err(RecordingError::mcap(&self.path))
    }

    fn attachment(&mut self, body: &[u8]) {
        match parse(op::ATTACHMENT, body) {
            Some(Record::Attachment { header, data, .. })
                if self.attached.len() < MAX_ATTACHED && body.len() < MAX_ATTACHMENT =>
            {
                self.attached.push(Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name,
                    media_type: header.media_type,
                    data: Cow::Owned(data.into_owned()),
                });
            }
            _ => tracing::warn!("an attached file is damaged and left out"),
        }
    }
}

/// Most attached files that are taken over; this program attaches two.
const MAX_ATTACHED: usize = 4;

/// The largest of them, bytes.
const MAX_ATTACHMENT: usize = 16 << 20;

/// The session, with the end that it could not be given.
fn repaired_session(from: &Path, before: &FileReport, last: Ticks) -> Option<SessionFile> {
    let mut session = session_of(from, &mut Findings::default())?;
    let text = if session.outcome.is_none() {
        if let Some(span) = &mut session.recorded {
            span.to = span.to.max(last);
        }
        // The marks are in both files; those after the last save only in one.
        format!(
            "the program was ended at {:.3} s of board time or up to a second later; the \
             recording was repaired",
            last.as_secs_f64()
        )
    } else if before.bad_chunks > 0 || before.skipped_bytes > 0 || before.cut_off_at.is_some() {
        format!(
            "the recording was repaired: {} damaged chunks and {} damaged bytes were left out",
            before.bad_chunks, before.skipped_bytes
        )
    } else {
        return Some(session);
    };
    session.outcome = Some(SessionOutcome::Loss);
    session
        .problems
        .push(Finding::check("repaired", text).at(last));
    Some(session)
}

/// The other files of a recording's folder; links are not followed.
fn copy_files(
    from: &Path,
    to: &Path,
    below: &Path,
    copied: &mut Vec<String>,
) -> Result<(), RecordingError> {
    let here = from.join(below);
    for entry in std::fs::read_dir(&here).map_err(RecordingError::io("read", &here))? {
        let entry = entry.map_err(RecordingError::io("read", &here))?;
        let name = below.join(entry.file_name());
        let kind = entry
            .file_type()
            .map_err(RecordingError::io("read", &entry.path()))?;
        // Made anew.
        let own = [MCAP_FILE, SESSION_FILE, METADATA_FILE];
        if own.iter().any(|own| name == Path::new(own)) {
            continue;
        }
        let target = to.join(&name);
        if kind.is_dir() {
            // The new recording may lie in the old one's folder.
            if same_file(&entry.path(), to) {
                continue;
            }
            std::fs::create_dir(&target).map_err(RecordingError::io("make the folder", &target))?;
            copy_files(from, to, &name, copied)?;
        } else if kind.is_file() {
            files::copy(&entry.path(), &target).map_err(RecordingError::io("write", &target))?;
            copied.push(name.to_string_lossy().into_owned());
        }
    }
    copied.sort();
    Ok(())
}

fn same_file(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}
