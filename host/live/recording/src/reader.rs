//! Reads the messages of a recording as Rust values, front to back, over any damage.

use std::collections::VecDeque;
use std::path::Path;

use protocol::Ticks;
use system::ReadMonitor;

use super::RecordingError;
pub use super::topic::Item;
use super::walk::{Damage, Event, Walk};

/// A message with its time and number.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Board time.
    pub at: Ticks,
    /// Running number on its topic; the board's own where it has one.
    pub sequence: u32,
    /// The message.
    pub item: Item,
}

/// Iterator over the [`Entry`]s of a recording, with an error for each message that is not of its
/// topic's type. Topics that this version does not know are left out.
pub struct Reader {
    walk: Walk,
    entries: VecDeque<Result<Entry, RecordingError>>,
    damage: Vec<Damage>,
    ended: bool,
}

impl Reader {
    /// Opens the recording in a folder, or an MCAP file.
    ///
    /// # Errors
    ///
    /// Returns an error if there is no such file or it cannot be opened.
    pub fn open(folder_or_file: &Path) -> Result<Self, RecordingError> {
        Self::with_monitor(folder_or_file, &ReadMonitor::default())
    }

    /// Opens the recording in a folder, or an MCAP file, to be read under a monitor.
    ///
    /// # Errors
    ///
    /// As [`Reader::open`].
    pub fn with_monitor(
        folder_or_file: &Path,
        monitor: &ReadMonitor,
    ) -> Result<Self, RecordingError> {
        Ok(Self {
            walk: Walk::open(folder_or_file, monitor)?,
            entries: VecDeque::new(),
            damage: Vec::new(),
            ended: false,
        })
    }

    /// Returns the damage so far, including the missing end of a file that was not closed; at most
    /// 1,000 places.
    #[must_use]
    pub fn damage(&self) -> &[Damage] {
        &self.damage
    }

    /// Returns true if there was any damage so far.
    #[must_use]
    pub const fn broken_off(&self) -> bool {
        !self.damage.is_empty()
    }

    fn next_part(&mut self) -> Result<bool, RecordingError> {
        let (entries, damage) = (&mut self.entries, &mut self.damage);
        self.walk.next_part(&mut |event| match event {
            Event::Message(message) => entries.extend(message.item().map(|item| {
                let item = item.map_err(|source| RecordingError::Message {
                    topic: message.channel.described.topic.clone(),
                    source,
                })?;
                Ok(Entry {
                    at: message.at(),
                    sequence: message.header.sequence,
                    item,
                })
            })),
            Event::Damage(found) if damage.len() < MAX_DAMAGE => damage.push(found),
            _ => {}
        })
    }
}

/// Most places of damage that are kept.
const MAX_DAMAGE: usize = 1_000;

impl Iterator for Reader {
    type Item = Result<Entry, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.entries.is_empty() && !self.ended {
            match self.next_part() {
                Ok(more) => self.ended = !more,
                Err(error) => {
                    self.ended = true;
                    return Some(Err(error));
                }
            }
        }
        self.entries.pop_front()
    }
}
