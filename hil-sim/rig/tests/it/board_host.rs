//! A host for tests: the program's own conversation with the firmware on the simulated board,
//! whose messages are kept by their streams.

use std::ops::{Deref, DerefMut};
use std::time::Duration;

use ::board::{Conversation, Event, Received};
use protocol::*;
use stm32f4_sim::pin::{Level, Pin};
use stm32f4_sim::sim::{Sim, SimBuilder};
use stm32f4_sim::time::{SimDuration, SimTime};

pub(crate) use rig::wiring::UNITS_PER_TICK;

/// The board, and the messages that have come from it.
pub(crate) struct Board {
    pub(crate) rig: Sim,
    conversation: Conversation,
    pub(crate) hellos: Vec<Hello>,
    pub(crate) answers: Vec<Answer>,
    received: Received,
}

impl Deref for Board {
    type Target = Received;

    fn deref(&self) -> &Received {
        &self.received
    }
}

impl DerefMut for Board {
    fn deref_mut(&mut self) -> &mut Received {
        &mut self.received
    }
}

impl Board {
    /// Boots the firmware and opens its serial port.
    pub(crate) fn boot(builder: SimBuilder) -> Self {
        let mut rig = builder.build().unwrap();
        let ready = rig.run_until_usb_ready(SimDuration::from_secs(3)).unwrap();
        assert!(ready, "no USB: {:?}", rig.usb_log());
        rig.usb_open(true);
        let mut board = Self {
            rig,
            conversation: Conversation::new(1),
            hellos: Vec::new(),
            answers: Vec::new(),
            received: Received::default(),
        };
        board.wait(1_000, |board| !board.hellos.is_empty());
        board
    }

    /// The same with a train whose edges are logged.
    pub(crate) fn boot_with_train(builder: SimBuilder, width: u32) -> Self {
        let mut board = Self::boot(builder);
        board.rig.log_pin(Pin::PA5);
        board.start(train(Period::from_picos(33_330_652_540).unwrap(), width));
        board
    }

    /// When tick 0 was, by the first pulse of the train; takes the logged edges.
    pub(crate) fn zero(&mut self) -> u64 {
        let (rise, _) = pulses_of(&self.rig.take_edges(), Pin::PA5)[0];
        rise.units() - self.pulses[0].at.0 * UNITS_PER_TICK
    }

    /// Takes what has come. Nothing may be damaged.
    pub(crate) fn take(&mut self) {
        self.conversation.receive(&self.rig.usb_read());
        while let Some(event) = self.conversation.next_event() {
            match event {
                Event::Message(DeviceToHost::Hello(hello)) => self.hellos.push(hello),
                Event::Answer(answer) => self.answers.push(answer),
                Event::Damaged(_) | Event::OtherVersion { .. } => panic!("{event:?}"),
                event => self.received.add(event),
            }
        }
    }

    /// Runs for some virtual milliseconds and takes the messages that come.
    pub(crate) fn run(&mut self, ms: u64) {
        let mut left = ms;
        while left > 0 {
            let step = left.min(50);
            self.rig.run_for(SimDuration::from_millis(step)).unwrap();
            self.take();
            left -= step;
        }
    }

    /// Runs until `done`, for at most `ms`.
    pub(crate) fn wait(&mut self, ms: u64, mut done: impl FnMut(&Self) -> bool) {
        for _ in 0..ms {
            self.rig.run_for(SimDuration::from_millis(1)).unwrap();
            self.take();
            if done(self) {
                return;
            }
        }
        panic!(
            "nothing within {ms} ms; {} answers, {} pulses, {} samples, last status {:?}",
            self.answers.len(),
            self.pulses.len(),
            self.imu.len(),
            self.statuses.last()
        );
    }

    /// Takes what came before the link broke. Half a frame may have been on the wire.
    pub(crate) fn break_link(&mut self) {
        self.take();
        self.conversation.cut();
    }

    /// Pulls the USB cable for some virtual milliseconds, and opens the port again.
    pub(crate) fn unplug_and_plug(&mut self, ms: u64) {
        self.rig.usb_unplug();
        self.break_link();
        self.run(ms);
        self.rig.usb_plug();
        let ready = self
            .rig
            .run_until_usb_ready(SimDuration::from_secs(3))
            .unwrap();
        assert!(ready, "no USB: {:?}", self.rig.usb_log());
        let hellos = self.hellos.len();
        self.rig.usb_open(true);
        self.wait(1_000, |board| board.hellos.len() > hellos);
    }

    /// Sends a command, without waiting. Returns its id.
    pub(crate) fn send(&mut self, command: impl Into<Command>) -> u32 {
        let id = self
            .conversation
            .send(Duration::ZERO, command, Duration::MAX);
        self.rig.usb_write(&self.conversation.take_outgoing());
        id
    }

    /// Returns the number of messages of filler.
    pub(crate) const fn fillers(&self) -> u64 {
        self.conversation.counts().filler.received
    }

    /// Sends a command and waits for its answer.
    pub(crate) fn ask<R: Request>(&mut self, command: R) -> Result<R::Reply, Refusal> {
        let id = self.send(command);
        let find = |board: &Self| board.answers.iter().position(|answer| answer.id == id);
        self.wait(2_000, |board| find(board).is_some());
        let at = find(self).unwrap();
        let reply = self.answers.swap_remove(at).result?;
        Ok(R::unwrap(reply).expect("the reply of this command"))
    }

    /// Starts the camera's train.
    pub(crate) fn start(&mut self, start: TriggerStart) -> TriggerStatus {
        self.try_start(start).unwrap()
    }

    /// Starts the camera's train, or is refused.
    pub(crate) fn try_start(&mut self, start: TriggerStart) -> Result<TriggerStatus, Refusal> {
        let output = Output::Camera;
        self.ask(StartTrigger { output, start })
    }

    /// Stops it.
    pub(crate) fn stop(&mut self) -> TriggerStatus {
        self.ask(StopTrigger(Output::Camera)).unwrap()
    }

    /// Asks for the state of the train.
    pub(crate) fn trigger(&mut self) -> TriggerStatus {
        self.ask(QueryTrigger(Output::Camera)).unwrap()
    }

    /// Asks for the time.
    pub(crate) fn now(&mut self) -> Ticks {
        self.ask(Ping { host_time: 0 }).unwrap().sent
    }

    /// The stacks have memory of their own, with nothing below it: one that overflows faults.
    pub(crate) fn check_stacks(&mut self, ends: [u32; 3]) {
        let [bottom, top, end, guarded] = [
            "_stack_end",
            "_task_stack_start",
            "_stack_start",
            "_handler_stack_end",
        ]
        .map(|name| self.rig.firmware().symbol(name).unwrap().address);
        assert_eq!([bottom, top, end], ends);
        assert!(self.rig.peek(bottom, 4).is_some());
        assert!(self.rig.peek(bottom - 4, 4).is_none());
        // Those of the fuller stack.
        let status = self.next_status();
        assert!([top - bottom, end - guarded].contains(&status.stack_size));
        assert!((512..6_144).contains(&status.stack_used), "{status:?}");
    }

    /// Waits for the next status and returns it.
    pub(crate) fn next_status(&mut self) -> Status {
        let seen = self.statuses.len();
        self.wait(1_100, |board| board.statuses.len() > seen);
        self.statuses.last().unwrap().clone()
    }
}

/// Settings for a Velodyne.
pub(crate) const GNSS: GnssSettings = GnssSettings {
    utc_at_zero: 1_795_234_567,
    baud: Baud::B9600,
    line_inverted: true,
    sentences: Sentences::Rmc,
    delay_ms: 50,
    pulse_width: 20 * (TICK_HZ / 1_000),
    pulse_inverted: false,
};

/// A train from now on.
pub(crate) const fn train(period: Period, width: u32) -> TriggerStart {
    TriggerStart {
        period,
        width,
        first_edge: None,
    }
}

/// Relates the pin's time to the board's: the time at which tick 0 was.
#[derive(Debug, Default)]
pub(crate) struct Epoch(Option<u64>);

impl Epoch {
    /// The tick of an edge at the pin. The first call defines where tick 0 is,
    /// by the time that the board says; every later one is then exact or fails.
    pub(crate) fn tick(&mut self, edge: SimTime, reported: Ticks) -> Ticks {
        let zero = *self
            .0
            .get_or_insert(edge.units() - reported.0 * UNITS_PER_TICK);
        let since = edge.units() - zero;
        assert_eq!(since % UNITS_PER_TICK, 0, "an edge between two ticks");
        Ticks(since / UNITS_PER_TICK)
    }
}

/// Rising and falling edges of `pin` in what [`Sim::take_edges`] gave.
pub(crate) fn pulses_of(edges: &[(Pin, Level, SimTime)], pin: Pin) -> Vec<(SimTime, SimTime)> {
    let mut of_pin = edges.iter().filter(|edge| edge.0 == pin);
    let mut pulses = Vec::new();
    while let Some(rise) = of_pin.next() {
        assert_eq!(rise.1, Level::High, "a pulse begins with a rising edge");
        let fall = of_pin.next().expect("the last pulse has ended");
        assert_eq!(fall.1, Level::Low);
        pulses.push((rise.2, fall.2));
    }
    pulses
}
