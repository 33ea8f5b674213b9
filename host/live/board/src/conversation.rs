//! The conversation with a board, without I/O: bytes in, events out; commands
//! in, bytes out.
//!
//! A conversation numbers commands, remembers until when each must be answered,
//! checks the protocol version, follows the sequence number of every stream and
//! reports losses. It survives its link: after a reconnect the same conversation
//! goes on, so messages that the board dropped meanwhile show as loss, and a
//! board that was reset meanwhile shows by its epoch. What comes over a new link
//! before the board has said which run it is in is held back until it has: a
//! sample of the new run is never taken for one of the old.
//!
//! Time is whatever the caller says it is ([`Link::now`](crate::transport::Link::now)).
//! Damage before the first good frame is not counted: a stream that is joined in
//! its middle begins with half a frame.

use std::collections::VecDeque;
use std::time::Duration;

use crate::streams::{Stream, StreamCounts, follow};
use protocol::{
    Answer, Command, Decoder, DeviceToHost, FrameError, HostToDevice, LinkCounters, MAX_FRAME,
    PROTOCOL_VERSION, Ticks, encode, hello_version,
};

/// The most messages that are held back until the run is known: over a minute of
/// the IMU. Beyond it the oldest go, and show as lost.
const MAX_HELD: usize = 32_768;

/// An event of a conversation.
#[derive(Clone, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "events live in one queue and are taken one by one"
)]
pub enum Event {
    /// A frame as it came, without its delimiter; before the events that come of
    /// it. Only if [`Conversation::keep_frames`] is on.
    Frame(Vec<u8>),
    /// A message other than an answer.
    Message(DeviceToHost),
    /// The answer to a command of this conversation.
    Answer(Answer),
    /// No answer came in time.
    Expired {
        /// The command.
        id: u32,
    },
    /// Messages of a stream are missing, directly before the next message.
    Lost {
        /// Which stream.
        stream: Stream,
        /// Number of missing messages.
        count: u32,
    },
    /// The number of the next message came before, or lies so far ahead that it is unknown how
    /// many are missing.
    Disordered {
        /// Which stream.
        stream: Stream,
    },
    /// A frame that could not be taken; what it carried shows as
    /// [`Event::Lost`] once the next message of its stream comes.
    Damaged(FrameError),
    /// The board has been reset since the last message: its time starts again.
    Restarted {
        /// Its last known time before.
        last: Ticks,
        /// The counts of the streams up to then.
        counts: StreamCounts,
    },
    /// The board speaks another protocol version; nothing else it says is
    /// understood.
    OtherVersion {
        /// The board's.
        found: u16,
    },
}

/// The state of a conversation. See the module.
#[derive(Default)]
pub struct Conversation {
    decoder: Decoder<DeviceToHost>,
    /// Bytes of the frame that is being received; at most one frame.
    raw: Vec<u8>,
    keep_frames: bool,
    /// A good frame has been seen.
    in_step: bool,
    /// Damage before the first good frame, to be left out of the counters.
    before_step: LinkCounters,
    bytes: u64,
    next_id: u32,
    waiting: Vec<(u32, Duration)>,
    expected: [Option<u32>; Stream::ALL.len()],
    counts: StreamCounts,
    epoch: Option<u32>,
    /// The line was cut, and the run not reported since.
    unsure: bool,
    /// Messages that arrived meanwhile.
    held: VecDeque<(Vec<u8>, DeviceToHost)>,
    /// Number of these that came before the line was last cut.
    held_before: usize,
    latest: Ticks,
    events: VecDeque<Event>,
    outgoing: Vec<u8>,
}

impl Conversation {
    /// Creates a conversation. `first_id` is the id of the first
    /// command; let it differ between runs of a program, so that a late answer
    /// to an earlier run is not mistaken.
    #[must_use]
    pub fn new(first_id: u32) -> Self {
        Self {
            next_id: first_id,
            ..Self::default()
        }
    }

    /// Returns raw frames as [`Event::Frame`] from now on if `keep`.
    pub const fn keep_frames(&mut self, keep: bool) {
        self.keep_frames = keep;
    }

    /// Numbers a command, queues its frame, and expects its answer until
    /// `now + within`. Returns its id.
    pub fn send(&mut self, now: Duration, command: impl Into<Command>, within: Duration) -> u32 {
        let command = command.into();
        let id = self.next_id;
        self.next_id = self.next_id.wrapping_add(1);
        let mut buffer = [0; MAX_FRAME];
        // A delimiter first ends whatever garbage the board may hold.
        self.outgoing.push(0);
        match encode(&HostToDevice { id, command }, &mut buffer) {
            Ok(frame) => self.outgoing.extend_from_slice(frame),
            // Cannot happen: MAX_FRAME holds every command. It would expire.
            Err(error) => tracing::error!("a command cannot be encoded: {error}"),
        }
        self.waiting.push((id, now.saturating_add(within)));
        id
    }

    /// Takes the bytes that are to be sent at once.
    #[must_use]
    pub fn take_outgoing(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.outgoing)
    }

    /// Receives bytes of the link, split in any way.
    pub fn receive(&mut self, mut bytes: &[u8]) {
        self.bytes = self.bytes.saturating_add(bytes.len() as u64);
        while !bytes.is_empty() {
            let end = bytes.iter().position(|&byte| byte == 0);
            let (mut part, rest) = bytes.split_at(end.map_or(bytes.len(), |end| end + 1));
            bytes = rest;
            let body = part.get(..end.unwrap_or(part.len())).unwrap_or_default();
            // The decoder knows when a frame is too long; keep no more of it.
            let room = MAX_FRAME.saturating_sub(self.raw.len()).min(body.len());
            self.raw
                .extend_from_slice(body.get(..room).unwrap_or_default());
            let result = self.decoder.next(&mut part);
            if end.is_some() {
                let raw = std::mem::take(&mut self.raw);
                if let Some(result) = result {
                    self.frame(raw, result);
                }
            }
        }
    }

    /// Lets commands expire whose answer did not come by `now`.
    pub fn tick(&mut self, now: Duration) {
        let events = &mut self.events;
        self.waiting.retain(|&(id, deadline)| {
            let waits = now < deadline;
            if !waits {
                events.push_back(Event::Expired { id });
            }
            waits
        });
    }

    /// Takes the next event.
    pub fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Ends the line: forgets half a frame and lets waiting commands expire. The expected numbers
    /// of the streams stay, so that the loss shows.
    pub fn cut(&mut self) {
        self.decoder.reset();
        self.unsure = self.epoch.is_some();
        self.held_before = self.held.len();
        self.raw.clear();
        self.outgoing.clear();
        for (id, _) in self.waiting.drain(..) {
            self.events.push_back(Event::Expired { id });
        }
    }

    /// Counts the streams afresh from their next message on, and damage from
    /// zero.
    pub fn start_counting(&mut self) {
        self.expected = Default::default();
        self.counts = StreamCounts::default();
        self.before_step = self.decoder.counters();
    }

    /// Returns the counts of messages received and lost on each stream.
    #[must_use]
    pub const fn counts(&self) -> StreamCounts {
        self.counts
    }

    /// Returns the number of frames that were damaged on the line, since it was in step.
    #[must_use]
    pub const fn damaged_frames(&self) -> u32 {
        self.decoder
            .counters()
            .lost_frames
            .saturating_sub(self.before_step.lost_frames)
    }

    /// Returns the number of bytes received.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns the number of undamaged frames received.
    #[must_use]
    pub const fn frames(&self) -> u32 {
        self.decoder.counters().frames
    }

    /// Returns the latest time in any message: the board's time is at least this.
    #[must_use]
    pub const fn latest(&self) -> Ticks {
        self.latest
    }

    fn frame(&mut self, raw: Vec<u8>, result: Result<DeviceToHost, FrameError>) {
        let other_version = match &result {
            Err(FrameError) => hello_version(&raw),
            Ok(_) => None,
        };
        let result = match result {
            Ok(message) if self.unsure => match Self::run_of(&message) {
                Some(epoch) => {
                    self.settle(epoch);
                    Ok(message)
                }
                None if matches!(message, DeviceToHost::Answer(_) | DeviceToHost::Hello(_)) => {
                    Ok(message)
                }
                None => {
                    if self.held.len() >= MAX_HELD {
                        self.held.pop_front();
                        self.held_before = self.held_before.saturating_sub(1);
                    }
                    self.held.push_back((raw, message));
                    return;
                }
            },
            other => other,
        };
        match result {
            Ok(message) => self.whole(raw, message),
            Err(error) => {
                if self.keep_frames {
                    self.events.push_back(Event::Frame(raw));
                }
                if let Some(found) = other_version {
                    self.events.push_back(Event::OtherVersion { found });
                } else if self.in_step {
                    self.events.push_back(Event::Damaged(error));
                } else {
                    self.before_step = self.decoder.counters();
                }
            }
        }
    }

    /// Returns the run that a message names.
    fn run_of(message: &DeviceToHost) -> Option<u32> {
        match message {
            DeviceToHost::Hello(hello) if hello.protocol_version == PROTOCOL_VERSION => {
                Some(hello.epoch)
            }
            DeviceToHost::Status(status) => Some(status.epoch),
            _ => None,
        }
    }

    /// Passes on the messages held back, now that the run is known again.
    fn settle(&mut self, epoch: u32) {
        self.unsure = false;
        let mut held = std::mem::take(&mut self.held);
        let before = std::mem::take(&mut self.held_before);
        if before > 0 && self.epoch != Some(epoch) {
            // The board was reset before or after these: that cannot be decided.
            tracing::warn!("{before} messages of an unknown run are left out");
            held.drain(..before.min(held.len()));
        }
        self.run(epoch);
        for (raw, message) in held {
            self.whole(raw, message);
        }
    }

    fn whole(&mut self, raw: Vec<u8>, message: DeviceToHost) {
        if self.keep_frames {
            self.events.push_back(Event::Frame(raw));
        }
        self.in_step = true;
        self.message(message);
    }

    fn message(&mut self, message: DeviceToHost) {
        match message {
            DeviceToHost::Hello(ref hello) => {
                if hello.protocol_version != PROTOCOL_VERSION {
                    let found = hello.protocol_version;
                    self.events.push_back(Event::OtherVersion { found });
                    return;
                }
                self.run(hello.epoch);
                self.time(hello.now);
            }
            DeviceToHost::Answer(answer) => {
                match self.waiting.iter().position(|&(id, _)| id == answer.id) {
                    Some(index) => {
                        self.waiting.swap_remove(index);
                        self.events.push_back(Event::Answer(answer));
                    }
                    None => tracing::debug!(id = answer.id, "an answer that nobody waits for"),
                }
                return;
            }
            DeviceToHost::Status(ref status) => self.run(status.epoch),
            DeviceToHost::Arrived(ref arrived) => self.time(arrived.at),
            _ => {}
        }
        if let Some((stream, number, at)) = Stream::from_message(&message) {
            self.number(stream, number);
            self.time(at);
        }
        self.events.push_back(Event::Message(message));
    }

    /// Notices that this is another run of the board.
    fn run(&mut self, epoch: u32) {
        if self.epoch.is_some_and(|known| known != epoch) {
            self.events.push_back(Event::Restarted {
                last: self.latest,
                counts: self.counts,
            });
            self.latest = Ticks::ZERO;
            self.expected = Default::default();
        }
        self.epoch = Some(epoch);
    }

    /// Compares a message's number with the one expected.
    fn number(&mut self, stream: Stream, seq: u32) {
        let Some(expected) = self.expected.get_mut(stream as usize) else {
            return;
        };
        let gap = follow(expected, seq);
        let count = self.counts.get_mut(stream);
        count.received += 1;
        match gap {
            None => {
                count.disordered += 1;
                self.events.push_back(Event::Disordered { stream });
            }
            Some(0) => {}
            Some(gap) => {
                count.lost += u64::from(gap);
                self.events.push_back(Event::Lost { stream, count: gap });
            }
        }
    }

    fn time(&mut self, at: Ticks) {
        self.latest = self.latest.max(at);
    }
}

#[cfg(test)]
pub(crate) mod tests;
