//! The protocol over the rig's serial port, for measurements that work on the firmware
//! without the host tool.

use anyhow::{Context, Result, anyhow};
use protocol::{Answer, Decoder, DeviceToHost, HostToDevice, MAX_FRAME, Request, Status, encode};
use stm32f4_sim::sim::Sim;
use stm32f4_sim::time::SimDuration;

/// Virtual time allowed for an answer.
const ANSWER_LIMIT: SimDuration = SimDuration::from_secs(2);

/// Virtual time allowed from power-on to the first hello.
const HELLO_LIMIT: SimDuration = SimDuration::from_secs(5);

/// One end of the link, with everything that came in and was not taken.
pub(super) struct BoardLink {
    decoder: Decoder<DeviceToHost>,
    messages: Vec<DeviceToHost>,
    next_id: u32,
}

impl BoardLink {
    /// Runs a board until it says hello.
    pub(super) fn open(rig: &mut Sim) -> Result<Self> {
        let mut link = Self {
            decoder: Decoder::new(),
            messages: Vec::new(),
            next_id: 1,
        };
        link.wait(rig, HELLO_LIMIT, |message| match message {
            DeviceToHost::Hello(_) => Some(()),
            _ => None,
        })
        .context("the board never said hello")?;
        Ok(link)
    }

    fn receive(&mut self, rig: &mut Sim) {
        let bytes = rig.usb_read();
        let mut rest = bytes.as_slice();
        while let Some(item) = self.decoder.next(&mut rest) {
            self.messages.extend(item);
        }
    }

    /// The statuses that have come since they were taken last; all else is forgotten.
    pub(super) fn take_statuses(&mut self, rig: &mut Sim) -> impl Iterator<Item = Status> {
        self.receive(rig);
        let messages = std::mem::take(&mut self.messages).into_iter();
        messages.filter_map(|message| match message {
            DeviceToHost::Status(status) => Some(status),
            _ => None,
        })
    }

    /// Runs until a message comes for which `pick` gives something, and removes that message.
    fn wait<T>(
        &mut self,
        rig: &mut Sim,
        limit: SimDuration,
        pick: impl Fn(&DeviceToHost) -> Option<T>,
    ) -> Result<T> {
        let mut found = None;
        rig.run_until(limit, |rig| {
            self.receive(rig);
            let mut messages = self.messages.iter().enumerate();
            found = messages.find_map(|(place, message)| Some((place, pick(message)?)));
            found.is_some()
        })?;
        let (place, picked) =
            found.with_context(|| format!("nothing came within {limit:?} of virtual time"))?;
        self.messages.remove(place);
        Ok(picked)
    }

    /// Sends a command and runs until its answer is there.
    pub(super) fn request<R: Request>(&mut self, rig: &mut Sim, command: R) -> Result<R::Reply> {
        let id = self.next_id;
        self.next_id = id.wrapping_add(1);
        let mut buffer = [0; MAX_FRAME];
        let command = command.into();
        let frame = encode(&HostToDevice { id, command }, &mut buffer)
            .map_err(|error| anyhow!("the command cannot be encoded: {error}"))?;
        rig.usb_write(frame);
        let answered = self.wait(rig, ANSWER_LIMIT, |message| match message {
            DeviceToHost::Answer(Answer { id: of, result }) if *of == id => Some(result.clone()),
            _ => None,
        });
        let reply = answered
            .with_context(|| format!("no answer to {}", R::NAME))?
            .map_err(|refusal| anyhow!("the board refused {}: {refusal:?}", R::NAME))?;
        R::unwrap(reply).with_context(|| format!("the board answered {} with another's", R::NAME))
    }
}
