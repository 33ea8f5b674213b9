//! A board on a link: calls that wait for their answer, and the events between.
//!
//! Everything that arrives while a call waits is kept in order and given out by
//! [`Board::next_event`]. Commands are idempotent, so a call whose answer does
//! not come sends the command again, under a new id, before it gives up.

use std::collections::VecDeque;
use std::time::Duration;

use protocol::{
    AlignPlan, Command, DeviceToHost, GnssReport, GnssSettings, Hello, ImuConfig, ImuSetup, Output,
    OutputAction, OutputAlign, Period, Refusal, Reply, Ticks, TriggerAlign, TriggerStart,
    TriggerStatus,
};

use crate::conversation::{Conversation, Event};
use crate::error::{BoardError, Result};
use crate::transport::serial::SerialLink;
use crate::transport::{Link, LinkError, ports};

/// How long one try of a command waits for its answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// How often a command is sent before it is given up.
const TRIES: u32 = 3;

/// A board that has said hello.
pub struct Board {
    wire: Wire,
    hello: Hello,
}

/// The port to use: the one given, or the only one that looks like the board.
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
    /// What answers is not this board, or speaks another protocol version.
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
        // What came before lay in some buffer and is nobody's business; the gap
        // behind it may have come together with the answer.
        wire.events.clear();
        while wire.conversation.next_event().is_some() {}
        wire.conversation.start_counting();
        Ok(Self { wire, hello })
    }

    /// Gives the link back, broken as it is: a port that is still there can be
    /// opened again only by who does not hold it any more.
    pub fn hang_up(&mut self) {
        self.wire.conversation.cut();
        let now = self.wire.link.now();
        self.wire.link = Box::new(HungUp { now });
    }

    /// Goes on with the same conversation on a new link, after the old one broke.
    /// What the board dropped meanwhile shows as [`Event::Lost`]; a reset
    /// meanwhile as [`Event::Restarted`].
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

    /// Who the board is.
    #[must_use]
    pub const fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Counters of the conversation.
    #[must_use]
    pub const fn conversation(&self) -> &Conversation {
        &self.wire.conversation
    }

    /// Whether raw frames are given out as [`Event::Frame`].
    pub const fn keep_frames(&mut self, keep: bool) {
        self.wire.conversation.keep_frames(keep);
    }

    /// Counts the streams anew from their next message on.
    pub fn start_counting(&mut self) {
        self.wire.conversation.start_counting();
    }

    /// The link's clock.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.wire.link.now()
    }

    /// The next event that has come already.
    pub fn queued_event(&mut self) -> Option<Event> {
        let wire = &mut self.wire;
        wire.events
            .pop_front()
            .or_else(|| wire.conversation.next_event())
    }

    /// The next event; waits for it at most for `wait`.
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
    pub fn call(&mut self, command: &Command) -> Result<Reply> {
        self.wire.call(command)
    }

    /// State of the trigger.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn trigger(&mut self) -> Result<TriggerStatus> {
        self.call_trigger(&Command::TriggerQuery)
    }

    /// Starts the trigger.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn start_trigger(&mut self, start: TriggerStart) -> Result<TriggerStatus> {
        self.call_trigger(&Command::TriggerStart(start))
    }

    /// Stops the trigger.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn stop_trigger(&mut self) -> Result<TriggerStatus> {
        self.call_trigger(&Command::TriggerStop)
    }

    /// Changes the period from the next edge on.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn set_period(&mut self, period: Period) -> Result<TriggerStatus> {
        self.call_trigger(&Command::TriggerPeriod(period))
    }

    /// Moves the train onto a grid.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn align(&mut self, align: TriggerAlign) -> Result<AlignPlan> {
        self.call_align(&Command::TriggerAlign(align))
    }

    /// A command to one of the further trigger outputs, all but an align.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn output(&mut self, output: Output, action: OutputAction) -> Result<TriggerStatus> {
        self.call_trigger(&Command::Output { output, action })
    }

    /// Moves the train of a further output onto a grid.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn align_output(&mut self, output: Output, to: OutputAlign) -> Result<AlignPlan> {
        let action = OutputAction::Align(to);
        self.call_align(&Command::Output { output, action })
    }

    /// The pulse per second.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn gnss(&mut self) -> Result<GnssReport> {
        self.call_gnss(&Command::GnssQuery)
    }

    /// Starts the pulse per second.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub(crate) fn start_gnss(&mut self, settings: GnssSettings) -> Result<GnssReport> {
        self.call_gnss(&Command::GnssStart(settings))
    }

    /// Stops the pulse per second.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn stop_gnss(&mut self) -> Result<GnssReport> {
        self.call_gnss(&Command::GnssStop)
    }

    /// The IMU's setup and state.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn imu(&mut self) -> Result<ImuSetup> {
        self.call_imu(&Command::ImuQuery)
    }

    /// Sets the IMU up.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn configure_imu(&mut self, config: ImuConfig) -> Result<ImuSetup> {
        self.call_imu(&Command::ImuConfigure(config))
    }

    /// One round trip: the board's time when it took the ping, and how long the
    /// round trip took on the link's clock.
    ///
    /// # Errors
    ///
    /// As [`Board::call`].
    pub fn ping(&mut self) -> Result<(Ticks, Duration)> {
        let before = self.wire.link.now();
        let host_time = u64::try_from(before.as_nanos()).unwrap_or(u64::MAX);
        match self.call(&Command::Ping { host_time })? {
            Reply::Pong {
                host_time: echoed,
                received,
                ..
            } if echoed == host_time => Ok((received, self.wire.link.now().saturating_sub(before))),
            _ => Err(BoardError::OddReply { command: "ping" }),
        }
    }

    /// Asks for the board's time without waiting: the [`Event::Answer`] with this
    /// id brings a [`Reply::Pong`], or [`Event::Expired`] none.
    pub fn ask_time(&mut self) -> u32 {
        let now = self.wire.link.now();
        let host_time = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        let command = Command::Ping { host_time };
        self.wire.conversation.send(now, command, ANSWER_TIMEOUT)
    }

    fn call_trigger(&mut self, command: &Command) -> Result<TriggerStatus> {
        match self.call(command)? {
            Reply::Trigger(status) => Ok(status),
            _ => Err(odd_reply(command)),
        }
    }

    fn call_align(&mut self, command: &Command) -> Result<AlignPlan> {
        match self.call(command)? {
            Reply::Align(plan) => Ok(plan),
            _ => Err(odd_reply(command)),
        }
    }

    fn call_gnss(&mut self, command: &Command) -> Result<GnssReport> {
        match self.call(command)? {
            Reply::Gnss(report) => Ok(report),
            _ => Err(odd_reply(command)),
        }
    }

    fn call_imu(&mut self, command: &Command) -> Result<ImuSetup> {
        match self.call(command)? {
            Reply::Imu(setup) => Ok(setup),
            _ => Err(odd_reply(command)),
        }
    }
}

const fn odd_reply(command: &Command) -> BoardError {
    BoardError::OddReply {
        command: command_name(command),
    }
}

/// In place of a link that was given back.
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
}

/// A conversation on its link.
struct Wire {
    link: Box<dyn Link>,
    conversation: Conversation,
    /// What came while a call waited.
    events: VecDeque<Event>,
    buffer: Vec<u8>,
}

impl Wire {
    fn call(&mut self, command: &Command) -> Result<Reply> {
        let name = command_name(command);
        for _ in 0..TRIES {
            let id = self
                .conversation
                .send(self.link.now(), command.clone(), ANSWER_TIMEOUT);
            if let Some(result) = self.wait_for(id)? {
                return result.map_err(|refusal| BoardError::Refused {
                    command: name,
                    refusal,
                });
            }
            tracing::debug!(command = name, "no answer, sending it again");
        }
        Err(BoardError::NoAnswer { command: name })
    }

    /// Sends what is to be sent, takes what has come, lets commands expire.
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

    /// The hello that is answered last before the answer is the current one:
    /// what lay in the system's buffers from before comes earlier.
    fn say_hello(&mut self) -> Result<Hello> {
        let before = self.conversation.bytes();
        match self.call(&Command::Hello) {
            Ok(_) => {}
            Err(BoardError::NoAnswer { .. }) => {
                let bytes = self.conversation.bytes() - before;
                return Err(if bytes == 0 {
                    BoardError::Silent
                } else if self.conversation.frames() == 0 {
                    BoardError::NotThisBoard { bytes }
                } else {
                    BoardError::NoAnswer { command: "hello" }
                });
            }
            Err(error) => return Err(error),
        }
        let hello = self.events.iter().rev().find_map(|event| match event {
            Event::Message(DeviceToHost::Hello(hello)) => Some(hello.clone()),
            _ => None,
        });
        hello.ok_or(BoardError::OddReply { command: "hello" })
    }
}

const fn command_name(command: &Command) -> &'static str {
    match command {
        Command::Hello => "hello",
        Command::Ping { .. } => "ping",
        Command::TriggerStart(_) => "trigger start",
        Command::TriggerAlign(_) => "trigger align",
        Command::TriggerPeriod(_) => "trigger period",
        Command::TriggerStop => "trigger stop",
        Command::TriggerQuery => "trigger status",
        Command::ImuConfigure(_) => "imu configure",
        Command::ImuQuery => "imu status",
        Command::Filler { .. } => "filler",
        Command::SelfTest { .. } => "self test",
        Command::Output { .. } => "trigger output",
        Command::GnssStart(_) => "gnss start",
        Command::GnssStop => "gnss stop",
        Command::GnssQuery => "gnss status",
    }
}

#[cfg(test)]
mod tests;
