//! The rig of a run, on a thread of its own, and the host's end of its cable.
//!
//! Virtual time passes only while the host waits for bytes or for the port, so a
//! run does not depend on how fast the machine is. Faults happen at their
//! virtual times, to a millisecond.

use std::sync::mpsc::{Receiver, RecvError, SendError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use protocol::{
    Command, Decoder, DeviceToHost, Failure as SelfTestFailure, Hello, HostToDevice, ImuState,
    MAX_FRAME, SELF_TEST_KEY, Status, Ticks, encode,
};
use smartdepthsync::board::{self, BoardError};
use smartdepthsync::record::Connector;
use smartdepthsync::transport::serial::OpenError;
use smartdepthsync::transport::{Link, LinkError};

use super::plan::{Fault, Plan};
use crate::board_truth::{BoardTruth, Compared, Train};
use crate::depth_camera::{DepthCamera, DepthCameraConfig};
use crate::i2c::{Shared, lock};
use crate::model::{RigIo, RigModel};
use crate::motion::MotionSpec;
use crate::motion::gesture::Gesture;
use crate::mpu9150::{Fault as ImuFault, Mpu9150, Mpu9150Config};
use crate::oscillator::{BoardTime, OscillatorConfig};
use crate::pin::{Drive, Pin};
use crate::random::{Seed, Stream};
use crate::rig::{FailureKind, ResetCause, Rig, RigBuilder};
use crate::time::{SimDuration, SimTime};
use crate::usb::UsbState;

/// Virtual time between two looks.
const STEP: SimDuration = SimDuration::from_millis(1);
/// Virtual time that a try to open a port that is not there takes: the host
/// program waits as long between tries.
const TRY: SimDuration = SimDuration::from_millis(500);
/// Half a period of 100 kHz.
const FLOOD: SimDuration = SimDuration::from_micros(5);

/// The name under which the port is told.
const PORT: &str = "the simulated board";

/// What the host asks of the scene.
enum Request {
    Connect,
    Close(u64),
    Send(u64, Vec<u8>),
    Receive(u64, Duration),
    /// The recording begins, with this train.
    Begin(Train),
    End,
}

/// What the scene answers.
#[derive(Default)]
struct Reply {
    now: Duration,
    bytes: Vec<u8>,
    /// The connection, or none if there is none (any more).
    connection: Option<u64>,
    busy: bool,
    report: Option<Box<Report>>,
}

/// A message that was handed to the host.
#[derive(Clone, Debug)]
pub(super) struct Delivered {
    /// When.
    pub at: SimTime,
    /// The board's run.
    pub epoch: u32,
    /// What.
    pub message: DeviceToHost,
}

/// What was seen by the end.
#[derive(Debug, Default)]
pub(super) struct Report {
    /// The first thing that was not as it should be.
    pub wrong: Option<String>,
    /// What was compared.
    pub compared: Compared,
    /// What the host was given since the recording began.
    pub delivered: Vec<Delivered>,
    /// Runs of the board.
    pub hellos: Vec<Hello>,
    /// The last status of the board.
    pub status: Option<Status>,
    /// When the recording began.
    pub began: SimTime,
    /// When the host was killed, and a copy of its files made.
    pub killed: Option<SimTime>,
    /// The end.
    pub ended: SimTime,
    /// CRC-32 of all bytes that the host was given.
    pub digest: u32,
    /// Pulses that the board made between the first and the last that the host
    /// was told of, by the pin.
    pub pulses_between: u64,
}

/// The host's end of the scene; clones are the same.
#[derive(Clone)]
pub(super) struct Stage(Arc<Mutex<Mail>>);

struct Mail {
    requests: Sender<Request>,
    replies: Receiver<Reply>,
    thread: Option<JoinHandle<()>>,
}

impl Stage {
    /// Boots a board with everything around it.
    pub(super) fn open(
        plan: &Plan,
        builder: RigBuilder,
        on_kill: impl FnMut() + Send + 'static,
    ) -> Result<Self, String> {
        let (requests, inbox) = channel();
        let (outbox, replies) = channel();
        let plan = plan.clone();
        let thread = std::thread::Builder::new()
            .name("scene".to_owned())
            .spawn(move || match Scene::new(plan, builder, Box::new(on_kill)) {
                Ok(mut scene) => {
                    let _ = outbox.send(scene.reply());
                    while let Ok(request) = inbox.recv() {
                        if outbox.send(scene.answer(request)).is_err() {
                            return;
                        }
                    }
                }
                Err(error) => {
                    let report = Report {
                        wrong: Some(error),
                        ..Report::default()
                    };
                    let reply = Reply {
                        report: Some(Box::new(report)),
                        ..Reply::default()
                    };
                    let _ = outbox.send(reply);
                }
            })
            .map_err(|error| error.to_string())?;
        let begun = replies.recv().map_err(|error| error.to_string())?;
        if let Some(report) = begun.report {
            return Err(report.wrong.unwrap_or_default());
        }
        Ok(Self(Arc::new(Mutex::new(Mail {
            requests,
            replies,
            thread: Some(thread),
        }))))
    }

    fn ask(&self, request: Request) -> Result<Reply, LinkError> {
        let mail = lock(&self.0);
        let gone = |reason: String| LinkError::Gone { reason };
        mail.requests
            .send(request)
            .map_err(|error: SendError<_>| gone(error.to_string()))?;
        mail.replies
            .recv()
            .map_err(|error: RecvError| gone(error.to_string()))
    }

    /// The recording begins: faults count from here.
    pub(super) fn begin(&self, train: Train) -> Result<(), LinkError> {
        self.ask(Request::Begin(train)).map(|_| ())
    }

    /// Switches the rig off.
    pub(super) fn end(&self) -> Result<Report, LinkError> {
        let reply = self.ask(Request::End)?;
        let thread = lock(&self.0).thread.take();
        drop(thread);
        reply.report.map(|report| *report).ok_or(LinkError::Stuck)
    }
}

impl Connector for Stage {
    fn connect(&mut self, _: Option<&str>) -> board::Result<Box<dyn Link>> {
        let reply = self.ask(Request::Connect)?;
        match reply.connection {
            Some(connection) => Ok(Box::new(Cable {
                stage: self.clone(),
                connection,
                now: reply.now,
            })),
            None if reply.busy => Err(BoardError::Open(OpenError::Busy {
                path: PORT.to_owned(),
            })),
            None => Err(BoardError::Open(OpenError::NotFound {
                path: PORT.to_owned(),
            })),
        }
    }
}

/// One connection.
struct Cable {
    stage: Stage,
    connection: u64,
    now: Duration,
}

impl Cable {
    fn taken(&mut self, reply: &Reply) -> Result<(), LinkError> {
        self.now = reply.now;
        if reply.connection == Some(self.connection) {
            Ok(())
        } else {
            Err(LinkError::Gone {
                reason: "unplugged".to_owned(),
            })
        }
    }
}

impl Link for Cable {
    fn now(&self) -> Duration {
        self.now
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let reply = self
            .stage
            .ask(Request::Send(self.connection, bytes.to_vec()))?;
        self.taken(&reply)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let reply = self.stage.ask(Request::Receive(self.connection, wait))?;
        if reply.bytes.is_empty() {
            self.taken(&reply)
        } else {
            self.now = reply.now;
            into.extend_from_slice(&reply.bytes);
            Ok(())
        }
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        // The scene may have ended.
        let _ = self.stage.ask(Request::Close(self.connection));
    }
}

/// Drives the strobe input at 100 kHz for a while.
#[derive(Debug, Default)]
struct Flood {
    next: Option<SimTime>,
    until: SimTime,
    high: bool,
}

impl RigModel for Flood {
    fn name(&self) -> String {
        "flood".to_owned()
    }
    fn watched_pins(&self) -> Vec<Pin> {
        Vec::new()
    }
    fn next_event(&self) -> Option<SimTime> {
        self.next
    }
    fn advance(&mut self, io: &mut RigIo<'_>) {
        self.high = !self.high && io.now() < self.until;
        io.drive(Pin::PA2, if self.high { Drive::High } else { Drive::Low });
        self.next = (self.high || io.now() < self.until).then(|| io.now() + FLOOD);
    }
}

/// A fault that begins or ends.
#[derive(Clone, Copy, Debug)]
struct Turn {
    at: SimTime,
    fault: Fault,
    begins: bool,
    ends: SimTime,
}

struct Scene {
    plan: Plan,
    rig: Rig,
    sensor: Shared<Mpu9150>,
    camera: Shared<DepthCamera>,
    flood: Shared<Flood>,
    truth: BoardTruth,
    decoder: Decoder<DeviceToHost>,
    turns: Vec<Turn>,
    connection: u64,
    /// The host has the port open.
    open: bool,
    pending: Vec<u8>,
    recording: bool,
    epoch: u32,
    failures: usize,
    expect_watchdog: bool,
    report: Report,
    digest: crc32fast::Hasher,
    on_kill: Box<dyn FnMut() + Send>,
    pulse_numbers: Option<(u64, u64)>,
}

impl Scene {
    fn new(
        plan: Plan,
        builder: RigBuilder,
        on_kill: Box<dyn FnMut() + Send>,
    ) -> Result<Self, String> {
        let seed = Seed(plan.seed);
        let board = BoardTime::new(OscillatorConfig::default(), seed.stream(Stream::BoardClock));
        let motion = MotionSpec::always(Gesture::Walk)
            .build(seed.stream(Stream::Motion))
            .map_err(|error| error.to_string())?;
        let sensor =
            Mpu9150::new(Mpu9150Config::typical(seed), motion, board.clone(), seed).shared();
        let camera = DepthCamera::new(DepthCameraConfig::default(), board, seed)
            .map_err(|error| error.to_string())?;
        let camera = Arc::new(Mutex::new(camera));
        let flood = Arc::new(Mutex::new(Flood::default()));
        let mut rig = builder
            .seed(seed)
            .tolerate_failures()
            .model(sensor.clone())
            .i2c_target(sensor.clone())
            .model(camera.clone())
            .model(flood.clone())
            .build()
            .map_err(|error| error.to_string())?;
        rig.usb_open(false);
        let truth = BoardTruth::new();
        truth.watch(&mut rig);
        Ok(Self {
            plan,
            rig,
            sensor,
            camera,
            flood,
            truth,
            decoder: Decoder::new(),
            turns: Vec::new(),
            connection: 0,
            open: false,
            pending: Vec::new(),
            recording: false,
            epoch: 0,
            failures: 0,
            expect_watchdog: false,
            report: Report::default(),
            digest: crc32fast::Hasher::new(),
            on_kill,
            pulse_numbers: None,
        })
    }

    fn reply(&self) -> Reply {
        Reply {
            now: Duration::from_nanos(self.rig.now().as_nanos()),
            connection: self.open.then_some(self.connection),
            ..Reply::default()
        }
    }

    fn answer(&mut self, request: Request) -> Reply {
        match request {
            Request::Connect => return self.connect(),
            Request::Close(connection) => {
                if connection == self.connection && self.open {
                    self.open = false;
                    self.rig.usb_open(false);
                    self.step();
                }
            }
            Request::Send(connection, bytes) => {
                if connection == self.connection && self.open {
                    self.rig.usb_write(&bytes);
                }
            }
            Request::Receive(connection, wait) => return self.receive(connection, wait),
            Request::Begin(train) => self.begin(train),
            Request::End => {
                let report = self.end();
                return Reply {
                    report: Some(Box::new(report)),
                    ..self.reply()
                };
            }
        }
        self.reply()
    }

    fn connect(&mut self) -> Reply {
        if self.open {
            // The port has somebody: a second opener is turned away.
            self.run(TRY);
            return Reply {
                busy: true,
                connection: None,
                ..self.reply()
            };
        }
        let tries = TRY.units() / STEP.units();
        for _ in 0..tries {
            if self.rig.usb_state() == UsbState::Ready {
                break;
            }
            self.step();
        }
        if self.rig.usb_state() != UsbState::Ready {
            return self.reply();
        }
        self.connection += 1;
        self.open = true;
        // What lay in the driver's buffer is gone with the former connection.
        self.rig.usb_read();
        self.pending.clear();
        self.decoder = Decoder::new();
        self.rig.usb_open(true);
        self.reply()
    }

    fn receive(&mut self, connection: u64, wait: Duration) -> Reply {
        let mine = |scene: &Self| scene.open && scene.connection == connection;
        let end = self.rig.now()
            + SimDuration::from_nanos(u64::try_from(wait.as_nanos()).unwrap_or(u64::MAX));
        while self.pending.is_empty() && mine(self) && self.rig.now() < end {
            self.step();
        }
        let mut reply = self.reply();
        if self.connection == connection {
            self.judge();
            reply.bytes = std::mem::take(&mut self.pending);
            self.digest.update(&reply.bytes);
        }
        reply
    }

    fn begin(&mut self, train: Train) {
        self.truth.started(train);
        self.recording = true;
        let zero = self.rig.now();
        self.report.began = zero;
        for event in &self.plan.events {
            let ends = event.ends(zero);
            self.turns.push(Turn {
                at: event.begins(zero),
                fault: event.fault,
                begins: true,
                ends,
            });
            if event.for_us > 0 {
                self.turns.push(Turn {
                    at: ends,
                    fault: event.fault,
                    begins: false,
                    ends,
                });
            }
        }
        // Taken from the end.
        self.turns.sort_by_key(|turn| std::cmp::Reverse(turn.at));
    }

    fn run(&mut self, length: SimDuration) {
        for _ in 0..length.units() / STEP.units() {
            self.step();
        }
    }

    fn complain(&mut self, what: String) {
        let at = self.rig.now();
        self.report
            .wrong
            .get_or_insert_with(|| format!("at {at} s of virtual time: {what}"));
    }

    /// One millisecond.
    fn step(&mut self) {
        while let Some(turn) = self.turns.last().copied()
            && turn.at <= self.rig.now()
        {
            self.turns.pop();
            self.turn(&turn);
        }
        if let Err(error) = self.rig.run_for(STEP) {
            self.complain(error.to_string());
        }
        self.failures();
        lock(&self.camera).take_frames();
        if let Err(wrong) = self.truth.take(&mut self.rig, &self.sensor)
            && self.recording
        {
            self.complain(wrong.0);
        }
        if self.open {
            self.pending.extend(self.rig.usb_read());
            if self.rig.usb_state() != UsbState::Ready {
                self.open = false;
                self.rig.usb_open(false);
            }
        }
    }

    /// Resets that the firmware made or did not prevent.
    fn failures(&mut self) {
        let new: Vec<_> = self
            .rig
            .failures()
            .iter()
            .skip(self.failures)
            .cloned()
            .collect();
        self.failures += new.len();
        for failure in new {
            if self.expect_watchdog
                && failure.kind == FailureKind::Reset(ResetCause::IndependentWatchdog)
            {
                self.expect_watchdog = false;
                self.restart(failure.at);
            } else {
                self.complain(failure.to_string());
            }
        }
    }

    /// The board begins a new run.
    fn restart(&mut self, at: SimTime) {
        // What it had sent before, the host is still given.
        if self.open {
            self.pending.extend(self.rig.usb_read());
        }
        self.judge();
        if let Err(wrong) = self.truth.restart(&mut self.rig, &self.sensor, at) {
            self.complain(wrong.0);
        }
    }

    fn turn(&mut self, turn: &Turn) {
        let now = self.rig.now();
        let begins = turn.begins;
        if turn.fault.hits_imu() || turn.fault.is_reset() {
            self.truth.disturbed(now);
        }
        match turn.fault {
            Fault::UsbUnplugged if begins => self.rig.usb_unplug(),
            Fault::UsbUnplugged => self.rig.usb_plug(),
            Fault::HostStalled => self.rig.usb_set_reading(!begins),
            Fault::CorruptedFromBoard | Fault::CorruptedToBoard => self.corrupt(turn),
            Fault::I2cHeld => self.rig.i2c_bus(|bus| bus.hold_sda(begins)),
            Fault::ImuPowerCut if begins => self.imu(ImuFault::PowerOff),
            Fault::ImuPowerCut => self.imu(ImuFault::PowerOn),
            Fault::ImuClockCut => self.imu(ImuFault::ClockCut(begins)),
            Fault::StrobeFlooded if begins => {
                let mut flood = lock(&self.flood);
                flood.next = Some(now + FLOOD);
                flood.until = turn.ends;
                drop(flood);
                self.rig.models_changed();
            }
            Fault::StrobeFlooded => {}
            Fault::HostKilled => {
                self.report.killed = Some(now);
                (self.on_kill)();
            }
            Fault::DepthCameraStopped if begins => {
                lock(&self.camera).stop();
                self.rig.models_changed();
            }
            Fault::DepthCameraStopped => {
                lock(&self.camera).wait_for_pulses();
                self.rig.models_changed();
            }
            Fault::ResetPressed => {
                self.rig.press_reset();
                self.restart(now);
            }
            Fault::WatchdogReset => self.hang(),
            Fault::SupplyReset => {
                self.imu(ImuFault::PowerOff);
                let soon = now + SimDuration::from_micros(500);
                lock(&self.sensor).schedule(soon, ImuFault::PowerOn);
                self.rig.models_changed();
                self.rig.power_cycle();
                self.restart(now);
            }
        }
    }

    fn imu(&mut self, fault: ImuFault) {
        lock(&self.sensor).schedule(self.rig.now(), fault);
        self.rig.models_changed();
    }

    fn corrupt(&mut self, turn: &Turn) {
        let now = self.rig.now();
        let zero = self.report.began;
        let on = |fault: Fault| {
            let active = self
                .plan
                .events
                .iter()
                .any(|e| e.fault == fault && e.begins(zero) <= now && now < e.ends(zero));
            let active = if turn.fault == fault {
                turn.begins
            } else {
                active
            };
            if active { self.plan.corruption_ppm } else { 0 }
        };
        let (from, to) = (on(Fault::CorruptedFromBoard), on(Fault::CorruptedToBoard));
        self.rig.usb_corrupt(from, to);
    }

    /// Lets a task of the board hang.
    fn hang(&mut self) {
        let command = HostToDevice {
            id: u32::MAX,
            command: Command::SelfTest {
                key: SELF_TEST_KEY,
                failure: SelfTestFailure::Stall,
            },
        };
        let mut buffer = [0; MAX_FRAME];
        if let Ok(frame) = encode(&command, &mut buffer) {
            self.rig.usb_write(&[0]);
            self.rig.usb_write(frame);
        }
        self.expect_watchdog = true;
    }

    /// Compares what the host is about to be given.
    fn judge(&mut self) {
        let bytes = std::mem::take(&mut self.pending);
        let mut rest = bytes.as_slice();
        while let Some(item) = self.decoder.next(&mut rest) {
            // A damaged frame is the host's to count.
            if let Ok(message) = item {
                self.message(message);
            }
        }
        self.pending = bytes;
    }

    fn message(&mut self, message: DeviceToHost) {
        match &message {
            DeviceToHost::Hello(hello) => {
                self.truth.begin(&self.rig, hello.now);
                self.epoch = hello.epoch;
                let known = self.report.hellos.last().map(|last| last.epoch);
                if known != Some(hello.epoch) {
                    self.report.hellos.push(hello.clone());
                }
            }
            DeviceToHost::Status(status) => self.status(status),
            DeviceToHost::Pulse(pulse) if self.recording => {
                let (first, _) = self.pulse_numbers.unwrap_or((pulse.number, pulse.number));
                if self.report.hellos.len() <= 1 {
                    self.pulse_numbers = Some((first, pulse.number));
                }
            }
            _ => {}
        }
        if let Err(wrong) = self.truth.message(&message) {
            self.complain(wrong.0);
        }
        if self.recording {
            self.report.delivered.push(Delivered {
                at: self.rig.now(),
                epoch: self.epoch,
                message,
            });
        }
    }

    /// Time goes on, or the run is another one.
    fn status(&mut self, status: &Status) {
        if let Some(last) = &self.report.status
            && last.epoch == status.epoch
            && (status.at <= last.at || status.seq <= last.seq)
        {
            let what = format!("time went from {:?} to {:?}", last.at, status.at);
            self.complain(what);
        }
        if let Some(tick) = self.truth.tick_of(self.rig.now())
            && status.at > tick
        {
            self.complain(format!("a status of the future: {:?}", status.at));
        }
        self.report.status = Some(status.clone());
    }

    fn end(&mut self) -> Report {
        let mut report = std::mem::take(&mut self.report);
        report.compared = self.truth.compared();
        report.ended = self.rig.now();
        report.digest = self.digest.clone().finalize();
        report.pulses_between = self
            .pulse_numbers
            .map_or(0, |(first, last)| last - first + 1);
        report
    }
}

/// Whether the IMU is well by a status.
pub(super) fn imu_is_well(status: &Status) -> bool {
    status.imu.state == ImuState::Running
}

/// Time of a message about an edge or a sample.
pub(super) fn time_of(message: &DeviceToHost) -> Option<Ticks> {
    match message {
        DeviceToHost::Pulse(pulse) => Some(pulse.at),
        DeviceToHost::Imu(sample) => Some(sample.at),
        DeviceToHost::Capture(capture) => Some(capture.at),
        _ => None,
    }
}
