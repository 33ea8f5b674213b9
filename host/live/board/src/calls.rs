//! A board on a link: calls that wait for their answer, and the events between.
//!
//! Everything that arrives while a call waits is kept in order and given out by
//! [`Board::next_event`]. Commands are idempotent, so a call whose answer does
//! not come sends the command again, under a new id, before it gives up.

use std::collections::VecDeque;
use std::time::Duration;

use protocol::{DeviceToHost, Hello, Ping, Refusal, Reply, Request, SayHello, Ticks};

use crate::conversation::{Conversation, Event};
use crate::error::{BoardError, Result};
use crate::transport::serial::SerialLink;
use crate::transport::{Link, LinkError, ports};

/// Longest wait for the answer to one try of a command.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// Number of tries before a command is given up.
const TRIES: u32 = 3;

/// A board that has said hello.
pub struct Board {
    wire: Wire,
    hello: Hello,
}

/// Returns the port to use: the one given, or the only one that looks like the board.
///
/// # Errors
///
/// No port is given and there is not exactly one board.
pub fn choose_port(given: Option<&str>) -> Result<String> {
    if let Some(path) = given {
        return Ok(path.to_owned());
    }
    let mut boards = ports::list()
        .map_err(|error| BoardError::Ports(error.to_string()))?
        .into_iter()
        .filter(|port| port.board)
        .map(|port| port.path);
    match (boards.next(), boards.next()) {
        (None, _) => Err(BoardError::NoBoard),
        (Some(only), None) => Ok(only),
        (Some(first), Some(second)) => Err(BoardError::ManyBoards {
            ports: [first, second].into_iter().chain(boards).collect(),
        }),
    }
}

impl Board {
    /// Opens the port (or the only board there is) and says hello.
    ///
    /// # Errors
    ///
    /// The port cannot be opened, or what is behind it is not this board.
    pub fn open(port: Option<&str>) -> Result<Self> {
        let path = choose_port(port)?;
        Self::connect(Box::new(SerialLink::open(&path)?))
    }

    /// Says hello on a link and checks who answers.
    ///
    /// # Errors
    ///
    /// The answer is not this board's, or of another protocol version.
    pub fn connect(link: Box<dyn Link>) -> Result<Self> {
        Self::connect_from(link, std::process::id() << 12)
    }

    /// As [`Board::connect`], with the id of the first command.
    ///
    /// # Errors
    ///
    /// As [`Board::connect`].
    pub fn connect_from(link: Box<dyn Link>, first_id: u32) -> Result<Self> {
        let mut wire = Wire {
            link,
            conversation: Conversation::new(first_id),
            events: VecDeque::new(),
            buffer: Vec::new(),
        };
        let hello = wire.say_hello()?;
        // Earlier messages lay in some buffer and belong to nobody; the gap after them may have
        // arrived together with the answer.
        wire.events.clear();
        while wire.conversation.next_event().is_some() {}
        wire.conversation.start_counting();
        Ok(Self { wire, hello })
    }

    /// Drops a broken link: a port that still exists can only be opened again once it is closed.
    pub fn hang_up(&mut self) {
        self.wire.conversation.cut();
        let now = self.wire.link.now();
        self.wire.link = Box::new(HungUp { now });
    }

    /// Continues the conversation on a new link, after the old one broke.
    /// Messages that the board dropped meanwhile show as [`Event::Lost`], a reset meanwhile as
    /// [`Event::Restarted`].
    ///
    /// # Errors
    ///
    /// The board does not answer on the new link either; try again later.
    pub fn reconnect(&mut self, link: Box<dyn Link>) -> Result<()> {
        self.wire.conversation.cut();
        self.wire.link = link;
        self.hello = self.wire.say_hello()?;
        Ok(())
    }

    /// Returns the identity of the board.
    #[must_use]
    pub const fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Returns the conversation, with its counters.
    #[must_use]
    pub const fn conversation(&self) -> &Conversation {
        &self.wire.conversation
    }

    /// Returns raw frames as [`Event::Frame`] from now on if `keep`.
    pub const fn keep_frames(&mut self, keep: bool) {
        self.wire.conversation.keep_frames(keep);
    }

    /// Counts the streams afresh from their next message on.
    pub fn start_counting(&mut self) {
        self.wire.conversation.start_counting();
    }

    /// Returns the time on the link's clock.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.wire.link.now()
    }

    /// Returns the time on the link's clock without the system's steering ([`Link::steady`]).
    #[must_use]
    pub fn steady(&self) -> Duration {
        self.wire.link.steady()
    }

    /// Stops reading from the board for `time`.
    pub fn pause(&mut self, time: Duration) {
        self.wire.link.pause(time);
    }

    /// Returns the next event that has already arrived.
    pub fn queued_event(&mut self) -> Option<Event> {
        let wire = &mut self.wire;
        wire.events
            .pop_front()
            .or_else(|| wire.conversation.next_event())
    }

    /// Returns the next event, waiting up to `wait` if there is none.
    ///
    /// # Errors
    ///
    /// The link is gone. All events that came before are given out first.
    pub fn next_event(&mut self, wait: Duration) -> Result<Option<Event>> {
        if let Some(event) = self.queued_event() {
            return Ok(Some(event));
        }
        self.wire.pump(wait)?;
        Ok(self.wire.conversation.next_event())
    }

    /// Sends a command and waits for its answer. Up to three tries.
    ///
    /// # Errors
    ///
    /// The link is gone, no answer came, or the board refused.
    pub fn call<R: Request>(&mut self, command: R) -> Result<R::Reply> {
        self.wire.call(command)
    }

    /// Makes one round trip. Returns the board's time when it received the ping, and the duration
    /// of the round trip on the link's clock.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn ping(&mut self) -> Result<(Ticks, Duration)> {
        let before = self.wire.link.now();
        let host_time = u64::try_from(before.as_nanos()).unwrap_or(u64::MAX);
        let pong = self.call(Ping { host_time })?;
        if pong.host_time != host_time {
            return Err(BoardError::OddReply {
                command: Ping::NAME,
            });
        }
        let round_trip = self.wire.link.now().saturating_sub(before);
        Ok((pong.received, round_trip))
    }

    /// Asks for the board's time without waiting: the [`Event::Answer`] with this
    /// id brings a [`Reply::Ping`], or [`Event::Expired`] none.
    pub fn ask_time(&mut self) -> u32 {
        let now = self.wire.link.now();
        let host_time = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        let ping = Ping { host_time };
        self.wire.conversation.send(now, ping, ANSWER_TIMEOUT)
    }
}

/// Stand-in for a link that was dropped.
struct HungUp {
    now: Duration,
}

impl HungUp {
    fn gone() -> LinkError {
        LinkError::Gone {
            reason: String::from("hung up"),
        }
    }
}

impl Link for HungUp {
    fn now(&self) -> Duration {
        self.now
    }
    fn send(&mut self, _: &[u8]) -> std::result::Result<(), LinkError> {
        Err(Self::gone())
    }
    fn receive(&mut self, _: &mut Vec<u8>, _: Duration) -> std::result::Result<(), LinkError> {
        Err(Self::gone())
    }
    fn pause(&mut self, _: Duration) {}
}

/// A conversation on its link.
struct Wire {
    link: Box<dyn Link>,
    conversation: Conversation,
    /// Events that arrived while a call waited.
    events: VecDeque<Event>,
    buffer: Vec<u8>,
}

impl Wire {
    fn call<R: Request>(&mut self, command: R) -> Result<R::Reply> {
        let name = R::NAME;
        for _ in 0..TRIES {
            let now = self.link.now();
            let id = self.conversation.send(now, command.clone(), ANSWER_TIMEOUT);
            if let Some(result) = self.wait_for(id)? {
                let reply = result.map_err(|refusal| BoardError::Refused {
                    command: name,
                    refusal,
                })?;
                return R::unwrap(reply).ok_or(BoardError::OddReply { command: name });
            }
            tracing::debug!(command = name, "no answer, sending it again");
        }
        Err(BoardError::NoAnswer { command: name })
    }

    /// Sends queued commands, receives pending bytes, lets commands expire.
    fn pump(&mut self, wait: Duration) -> Result<()> {
        let outgoing = self.conversation.take_outgoing();
        if !outgoing.is_empty() {
            self.link.send(&outgoing)?;
        }
        self.buffer.clear();
        let result = self.link.receive(&mut self.buffer, wait);
        self.conversation.receive(&self.buffer);
        self.conversation.tick(self.link.now());
        Ok(result?)
    }

    /// Waits for one answer; `None` if it expired.
    fn wait_for(&mut self, id: u32) -> Result<Option<std::result::Result<Reply, Refusal>>> {
        loop {
            while let Some(event) = self.conversation.next_event() {
                match event {
                    Event::Answer(answer) if answer.id == id => return Ok(Some(answer.result)),
                    Event::Expired { id: expired } if expired == id => return Ok(None),
                    Event::OtherVersion { found } => {
                        return Err(BoardError::OtherVersion { found });
                    }
                    other => self.events.push_back(other),
                }
            }
            self.pump(Duration::from_millis(100))?;
        }
    }

    /// Asks for a hello. The last one before the answer is the current one: any that lay in the
    /// system's buffers come earlier.
    fn say_hello(&mut self) -> Result<Hello> {
        let before = self.conversation.bytes();
        match self.call(SayHello) {
            Ok(()) => {}
            Err(BoardError::NoAnswer { .. }) => {
                let bytes = self.conversation.bytes() - before;
                return Err(if bytes == 0 {
                    BoardError::Silent
                } else if self.conversation.frames() == 0 {
                    BoardError::NotThisBoard { bytes }
                } else {
                    BoardError::NoAnswer {
                        command: SayHello::NAME,
                    }
                });
            }
            Err(error) => return Err(error),
        }
        let hello = self.events.iter().rev().find_map(|event| match event {
            Event::Message(DeviceToHost::Hello(hello)) => Some(hello.clone()),
            _ => None,
        });
        hello.ok_or(BoardError::OddReply {
            command: SayHello::NAME,
        })
    }
}

#[cfg(test)]
mod tests;
