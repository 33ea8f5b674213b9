//! The whole rig in the caller's thread, on virtual time: board, IMU, depth camera and
//! phones, stepped by the caller that waits. There is no wall clock, thread, pseudo-terminal or
//! socket in it, so a seed gives the same bytes on any machine.

use std::cmp::Reverse;
use std::time::Duration;

use anyhow::{Result, anyhow};

use crate::clocks::true_clock::BoardClockwork;
use crate::depth_camera::FrameRecord;
use crate::phone::{AskedPhone, PhoneConfig};
use crate::whole_rig::config::{RigConfig, RigParts};
use crate::whole_rig::ground_truth::{Noted, RunTruth};
use crate::whole_rig::owner_profile::owner_profile;
use stm32f4_sim::sim::{Sim, SimBuilder};
use stm32f4_sim::time::{SimDuration, SimTime};
use stm32f4_sim::usb::UsbState;

/// Virtual time between two looks.
const STEP: SimDuration = SimDuration::from_millis(1);

/// Address of its phones, to which nothing connects.
const ADDRESS: &str = "192.0.2.1:6969";

/// An event on a rig.
pub type Happening = Box<dyn FnOnce(&mut VirtualRig)>;

/// A rig that its caller steps.
pub struct VirtualRig {
    /// The board.
    pub sim: Sim,
    /// Its phones.
    pub phones: Vec<AskedPhone>,
    parts: RigParts,
    noted: Noted,
    /// The connection that the host has open, and the last one.
    open: bool,
    connection: u64,
    pending: Vec<u8>,
    /// Pending events, the next one last.
    agenda: Vec<(SimTime, Happening)>,
    failure: Option<String>,
}

impl VirtualRig {
    /// Builds a rig and boots its board.
    ///
    /// # Errors
    ///
    /// A part cannot be built, or the board's serial port does not come.
    pub fn new(config: RigConfig, board: SimBuilder, phones: Vec<PhoneConfig>) -> Result<Self> {
        let parts = config.build();
        let surroundings = parts.surroundings();
        let phones = phones
            .into_iter()
            .map(|config| AskedPhone::start(config, surroundings.clone()))
            .collect::<Result<_>>()?;
        let mut sim = parts
            .wire(board)
            .model(BoardClockwork::new(parts.board.clone(), surroundings.clock))
            .build()?;
        sim.usb_open(false);
        let noted = Noted::default();
        Ok(Self {
            sim,
            phones,
            parts,
            noted,
            open: false,
            connection: 0,
            pending: Vec::new(),
            agenda: Vec::new(),
            failure: None,
        })
    }

    /// Returns the parts and their clocks.
    #[must_use]
    pub fn parts(&self) -> &RigParts {
        &self.parts
    }

    /// The profile that this rig's owner would have, with its phones by these names, or
    /// with one phone and no names.
    ///
    /// # Errors
    ///
    /// The rig has no phone or no depth camera.
    pub fn profile(&self, names: &[&str]) -> Result<String> {
        let phones = self.phones.iter();
        let phones = phones.map(|phone| (ADDRESS.to_owned(), &phone.app.config));
        owner_profile(&self.parts.config, phones, names)
    }

    /// Returns virtual time.
    #[must_use]
    pub fn now(&self) -> SimTime {
        self.sim.now()
    }

    /// Schedules an event at a time, or at the next step if that has passed.
    pub fn at(&mut self, at: SimTime, what: impl FnOnce(&mut Self) + 'static) {
        self.agenda.push((at, Box::new(what)));
        self.agenda.sort_by_key(|(at, _)| Reverse(*at));
    }

    /// Advances time.
    pub fn pass(&mut self, length: SimDuration) {
        let end = self.sim.now() + length;
        while self.sim.now() < end {
            self.step();
        }
    }

    /// Advances time while the host reads nothing from the board.
    pub fn pass_unread(&mut self, length: SimDuration) {
        self.sim.usb_set_buffer_limit(0);
        self.pass(length);
        self.sim.usb_set_buffer_limit(usize::MAX);
    }

    /// Advances time until a condition holds; returns false if `patience` ends before.
    pub fn pass_until(
        &mut self,
        patience: Duration,
        mut is_done: impl FnMut(&mut Self) -> bool,
    ) -> bool {
        let end = self.sim.now() + duration(patience);
        while !is_done(self) {
            if self.sim.now() >= end {
                return false;
            }
            self.step();
        }
        true
    }

    /// One millisecond.
    fn step(&mut self) {
        while let Some((_, what)) = self.agenda.pop_if(|(at, _)| *at <= self.sim.now()) {
            what(self);
        }
        if let Err(error) = self.sim.run_for(STEP) {
            self.failure.get_or_insert_with(|| error.to_string());
        }
        self.noted.take(&self.sim, &self.parts);
        for phone in &mut self.phones {
            phone.advance();
        }
        if self.open {
            self.pending.extend(self.sim.usb_read());
            if self.sim.usb_state() != UsbState::Ready {
                self.open = false;
                self.sim.usb_open(false);
            }
        }
    }

    /// Presses the board's reset button.
    pub fn press_reset(&mut self) {
        self.noted.was_reset();
        self.sim.press_reset();
    }

    /// Switches the board's power off and on.
    pub fn power_cycle(&mut self) {
        self.noted.was_reset();
        self.sim.power_cycle();
    }

    /// Returns true if the board's serial port is there.
    #[must_use]
    pub fn is_plugged(&self) -> bool {
        self.sim.usb_state() == UsbState::Ready
    }

    /// Opens the board's port and returns the number of the connection; `None` if the port is
    /// absent or in use.
    pub fn connect(&mut self) -> Option<u64> {
        if self.open || !self.is_plugged() {
            return None;
        }
        self.connection += 1;
        self.open = true;
        // Bytes in the driver's buffer are lost with the former connection.
        self.sim.usb_read();
        self.pending.clear();
        self.sim.usb_open(true);
        Some(self.connection)
    }

    /// Returns true if a connection is the one that is open.
    #[must_use]
    pub fn has(&self, connection: u64) -> bool {
        self.open && self.connection == connection
    }

    /// Closes a connection.
    pub fn close(&mut self, connection: u64) {
        if self.has(connection) {
            self.open = false;
            self.sim.usb_open(false);
            self.step();
        }
    }

    /// Sends bytes to the board.
    pub fn send(&mut self, connection: u64, bytes: &[u8]) {
        if self.has(connection) {
            self.sim.usb_write(bytes);
        }
    }

    /// Returns the bytes that have arrived for a connection, waiting for some up to a time.
    pub fn receive(&mut self, connection: u64, wait: Duration) -> Vec<u8> {
        let end = self.sim.now() + duration(wait);
        while self.pending.is_empty() && self.has(connection) && self.sim.now() < end {
            self.step();
        }
        if self.connection != connection {
            return Vec::new();
        }
        std::mem::take(&mut self.pending)
    }

    /// Returns the frames of the depth camera so far.
    #[must_use]
    pub fn depth_frames(&self) -> &[FrameRecord] {
        self.noted.depth()
    }

    /// Switches the rig off; gives what really happened.
    ///
    /// # Errors
    ///
    /// The firmware has failed.
    pub fn stop(mut self) -> Result<RunTruth> {
        if let Some(failure) = self.failure.take() {
            return Err(anyhow!("the simulated board: {failure}"));
        }
        let phones = self.phones.iter();
        let phones = phones.map(|phone| (phone.app.oscillator.clone(), phone.app.videos()));
        let phones = phones.collect();
        Ok(self.noted.into_truth(self.parts, phones, self.sim.now()))
    }
}

fn duration(time: Duration) -> SimDuration {
    SimDuration::from_nanos(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX))
}
