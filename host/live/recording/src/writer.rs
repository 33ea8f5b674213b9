//! Writes `recording.mcap` so that a kill loses at most a second.
//!
//! A chunk is closed and handed to the operating system whenever half a second of board time or
//! of the host's time has passed since the last one, whichever comes first (the caller passes
//! the latter: on a simulated rig it is virtual). Chunks are built in memory and written in one
//! call, so a kill leaves whole chunks, and perhaps the beginning of one. Once a second the file
//! is also synchronised with the disk (`fdatasync`), against power loss; the link has a thread
//! of its own, so a slow disk does not stall the board.
//!
//! `log_time` and `publish_time` are board time in nanoseconds. Ticks of 20.83 ns round to
//! different nanoseconds, so `round(ns · 6 / 125)` restores them exactly.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use protocol::{TICK_HZ, Ticks};

use super::chunks::Chunk;
use super::contents::{Tally, TopicContents};
use super::rosbag2::{self, Bag, options};
use super::topic::Topic;
use super::{MCAP_FILE, RecordingError};

/// Longest span of board time in one chunk, ticks.
const CHUNK_TICKS: u64 = TICK_HZ as u64 / 2;

/// Longest time on the host's clock before a chunk is closed that receives no more messages.
const CHUNK_TIME: Duration = Duration::from_millis(500);

/// Interval at which the file is synchronised with the disk.
const SYNC_TIME: Duration = Duration::from_secs(1);

/// Writes a recording's file.
pub struct Writer {
    /// Has all topics, in the order of [`Topic::ALL`].
    bag: Bag<'static>,
    file: File,
    path: PathBuf,
    chunk_from: Option<Ticks>,
    waits_since: Option<Duration>,
    synced: Instant,
    dirty: bool,
    written: Tally,
    pub(crate) wall: WallClock,
}

/// Returns the time of day.
pub type WallClock = Box<dyn Fn() -> SystemTime + Send>;

impl Writer {
    /// Creates the file in a recording's folder.
    ///
    /// # Errors
    ///
    /// Returns an error if the file exists already or cannot be written.
    pub fn create(folder: &Path) -> Result<Self, RecordingError> {
        let path = folder.join(MCAP_FILE);
        let io = RecordingError::io("write", &path);
        let file = File::create_new(&path).map_err(&io)?;
        let copy = file.try_clone().map_err(io)?;
        let bag = bag_of_topics(BufWriter::with_capacity(1 << 20, file));
        let mut writer = Self {
            bag: bag.map_err(RecordingError::mcap(&path))?,
            file: copy,
            path,
            chunk_from: None,
            waits_since: None,
            synced: Instant::now(),
            dirty: true,
            written: Tally::default(),
            wall: Box::new(SystemTime::now),
        };
        writer.flush()?;
        Ok(writer)
    }

    /// Replaces the system's clock as the source of the time of day, which is recorded once a
    /// second for information.
    pub fn set_wall_clock(&mut self, wall: WallClock) {
        self.wall = wall;
    }

    /// Closes the chunk if half a second has passed since the first call with something in it.
    /// `now` is a reading of any steady clock. To be called often, also without new messages.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn tick(&mut self, now: Duration) -> Result<(), RecordingError> {
        if !self.dirty {
            return Ok(());
        }
        let since = *self.waits_since.get_or_insert(now);
        if now.saturating_sub(since) >= CHUNK_TIME {
            self.flush()?;
        }
        Ok(())
    }

    /// Closes the chunk and hands it to the operating system.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        let flushed = self.bag.mcap.flush();
        flushed.map_err(RecordingError::mcap(&self.path))?;
        self.chunk_from = None;
        self.waits_since = None;
        self.dirty = false;
        if self.synced.elapsed() >= SYNC_TIME {
            self.sync()?;
        }
        Ok(())
    }

    fn sync(&mut self) -> Result<(), RecordingError> {
        self.synced = Instant::now();
        let synced = self.file.sync_data();
        synced.map_err(RecordingError::io("write", &self.path))
    }

    /// Writes the CDR form of a message, with its number on the topic if the caller has one.
    pub(crate) fn put_cdr(
        &mut self,
        topic: Topic,
        at: Ticks,
        number: Option<u32>,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let put = self.bag.put(topic as usize, number, at.as_nanos(), data);
        if let Some(header) = put.map_err(RecordingError::mcap(&self.path))? {
            self.written.add(topic.name(), &header, data);
        }
        self.dirty = true;
        let from = *self.chunk_from.get_or_insert(at);
        if at.0.abs_diff(from.0) >= CHUNK_TICKS {
            self.flush()?;
        }
        Ok(())
    }

    /// Writes index and end of the file, synchronises it with the disk, and writes
    /// `metadata.yaml` beside it. Returns what was written, by topic.
    ///
    /// # Errors
    ///
    /// As [`Writer::imu`].
    pub fn finish(mut self) -> Result<BTreeMap<String, TopicContents>, RecordingError> {
        let summary = self.bag.mcap.finish();
        let summary = summary.map_err(RecordingError::mcap(&self.path))?;
        self.sync()?;
        rosbag2::save(system::folder_of(&self.path), &summary)?;
        Ok(self.written.topics())
    }
}

/// Returns the records that describe the topics of every recording, among others.
///
/// # Errors
///
/// No error is known: the records are written into memory.
pub(crate) fn known_topics() -> Result<Chunk, mcap::McapError> {
    let mut bytes = Vec::new();
    bag_of_topics(&mut bytes)?.mcap.finish()?;
    Ok(Chunk(bytes.split_off(mcap::MAGIC.len())))
}

pub(crate) fn bag_of_topics<'a>(to: impl Write + Send + 'a) -> Result<Bag<'a>, mcap::McapError> {
    let mut bag = Bag::with_options(options(), to)?;
    for topic in Topic::ALL {
        bag.add(topic.name(), topic.message_type(), &topic.schema())?;
    }
    Ok(bag)
}
