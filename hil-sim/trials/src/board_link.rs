//! The protocol over the rig's serial port, for tests and measurements that
//! work on the firmware without the host tool.

use protocol::{
    Answer, Command, Decoder, DeviceToHost, FrameError, Hello, HostToDevice, MAX_FRAME, Refusal,
    Request, Status, encode,
};

use stm32f4_sim::sim::{Sim, SimError};
use stm32f4_sim::time::SimDuration;

/// Time allowed for an answer.
const ANSWER_LIMIT: SimDuration = SimDuration::from_secs(2);

/// One end of the link, with everything that came in and was not taken.
pub struct BoardLink {
    decoder: Decoder<DeviceToHost>,
    messages: Vec<DeviceToHost>,
    errors: Vec<FrameError>,
    next_id: u32,
}

impl core::fmt::Debug for BoardLink {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "BoardLink({} messages wait)", self.messages.len())
    }
}

/// A command had no answer.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The run ended.
    #[error(transparent)]
    Rig(#[from] SimError),
    /// Nothing came in time.
    #[error("no {what} within {limit:?} of virtual time")]
    Timeout {
        /// What was awaited.
        what: &'static str,
        /// How long.
        limit: SimDuration,
    },
    /// The command was refused.
    #[error("the board refused: {0:?}")]
    Refused(Refusal),
    /// The answer is the reply to another command.
    #[error("the board answered `{command}` with something else")]
    OddReply {
        /// The command.
        command: &'static str,
    },
    /// The command does not fit a frame.
    #[error("the command cannot be encoded: {0}")]
    Encode(postcard::Error),
}

impl Default for BoardLink {
    fn default() -> Self {
        Self::new()
    }
}

impl BoardLink {
    /// A link with nothing in it.
    #[must_use]
    pub fn new() -> Self {
        Self {
            decoder: Decoder::new(),
            messages: Vec::new(),
            errors: Vec::new(),
            next_id: 1,
        }
    }

    /// Takes what has come from the board.
    pub fn receive(&mut self, rig: &mut Sim) {
        let bytes = rig.usb_read();
        let mut rest = bytes.as_slice();
        while let Some(item) = self.decoder.next(&mut rest) {
            match item {
                Ok(message) => self.messages.push(message),
                Err(error) => self.errors.push(error),
            }
        }
    }

    /// Everything received and not taken yet, in order.
    pub fn take(&mut self) -> Vec<DeviceToHost> {
        std::mem::take(&mut self.messages)
    }

    /// Damaged frames so far.
    #[must_use]
    pub fn errors(&self) -> &[FrameError] {
        &self.errors
    }

    /// Queues a command and returns its id.
    ///
    /// # Errors
    ///
    /// If it does not fit a frame.
    pub fn send(&mut self, rig: &mut Sim, command: impl Into<Command>) -> Result<u32, LinkError> {
        let command = command.into();
        let id = self.next_id;
        self.next_id = id.wrapping_add(1);
        let mut buffer = [0; MAX_FRAME];
        let frame =
            encode(&HostToDevice { id, command }, &mut buffer).map_err(LinkError::Encode)?;
        rig.usb_write(frame);
        Ok(id)
    }

    /// Runs until a message comes for which `pick` gives something, and
    /// removes that message.
    ///
    /// # Errors
    ///
    /// If it does not come in time, or the firmware fails.
    pub fn wait<T>(
        &mut self,
        rig: &mut Sim,
        what: &'static str,
        limit: SimDuration,
        mut pick: impl FnMut(&DeviceToHost) -> Option<T>,
    ) -> Result<T, LinkError> {
        let mut found = None;
        rig.run_until(limit, |rig| {
            self.receive(rig);
            let hit = self
                .messages
                .iter()
                .enumerate()
                .find_map(|(n, m)| pick(m).map(|t| (n, t)));
            if let Some((n, t)) = hit {
                self.messages.remove(n);
                found = Some(t);
            }
            found.is_some()
        })?;
        found.ok_or(LinkError::Timeout { what, limit })
    }

    /// Sends a command and runs until its answer is there.
    ///
    /// # Errors
    ///
    /// If it is refused or not answered within two seconds, or the firmware fails.
    pub fn request<R: Request>(
        &mut self,
        rig: &mut Sim,
        command: R,
    ) -> Result<R::Reply, LinkError> {
        let id = self.send(rig, command)?;
        let result = self.wait(rig, "answer", ANSWER_LIMIT, |m| match m {
            DeviceToHost::Answer(Answer { id: of, result }) if *of == id => Some(result.clone()),
            _ => None,
        })?;
        let reply = result.map_err(LinkError::Refused)?;
        R::unwrap(reply).ok_or(LinkError::OddReply { command: R::NAME })
    }

    /// Runs until a `Hello` comes.
    ///
    /// # Errors
    ///
    /// If none comes in time, or the firmware fails.
    pub fn hello(&mut self, rig: &mut Sim, limit: SimDuration) -> Result<Hello, LinkError> {
        self.wait(rig, "hello", limit, |m| match m {
            DeviceToHost::Hello(hello) => Some(hello.clone()),
            _ => None,
        })
    }

    /// Runs until a `Status` comes.
    ///
    /// # Errors
    ///
    /// If none comes in time, or the firmware fails.
    pub fn status(&mut self, rig: &mut Sim, limit: SimDuration) -> Result<Status, LinkError> {
        self.wait(rig, "status", limit, |m| match m {
            DeviceToHost::Status(status) => Some(status.clone()),
            _ => None,
        })
    }
}
