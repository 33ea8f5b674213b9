//! The rig of a run: it runs while the host waits, faults happen at their virtual
//! times to a millisecond, and what the host is given is compared with the truth.

use std::sync::atomic::AtomicI64;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use board::transport::serial::OpenError;
use protocol::{
    Command, Decoder, DeviceToHost, Hello, HostToDevice, ImuState, StartTrigger, Status, Ticks,
};

use super::happenings::{Flood, Turn};
use super::plan::Plan;
use crate::board_truth::{BoardTruth, Compared, Train};
use rig::depth_camera::{DepthCamera, DepthCameraConfig};
use rig::imu::{SimImu, SimImuConfig};
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::oscillator::{BoardTime, OscillatorConfig};
use rig::random::{Seed, Stream};
use stm32f4_sim::shared::{Shared, lock};
use stm32f4_sim::sim::{FailureKind, ResetCause, Sim, SimBuilder};
use stm32f4_sim::time::{SimDuration, SimTime};
use stm32f4_sim::usb::UsbState;

/// The name under which the port is told.
const PORT: &str = "the simulated board";
/// Virtual time between two looks.
const STEP: SimDuration = SimDuration::from_millis(1);
/// Virtual time that a try to open a port that is not there takes: the host
/// program waits as long between tries.
const TRY: SimDuration = SimDuration::from_millis(500);

/// A message that was handed to the host.
#[derive(Clone, Debug)]
pub(super) struct Delivered {
    /// When.
    pub at: SimTime,
    /// The board's run: 0 is the first.
    pub run: usize,
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
    /// The train that was started first.
    pub first_train: Option<Train>,
    /// The train that was started after a reset.
    pub train: Option<Train>,
    /// When tick 0 of each run was.
    pub zeros: Vec<SimTime>,
    /// Pulses that the board made between the first and the last that the host
    /// was told of, by the pin.
    pub pulses_between: u64,
}

pub(super) struct Scene {
    pub(super) plan: Plan,
    pub(super) rig: Sim,
    pub(super) sensor: Shared<SimImu>,
    pub(super) camera: Shared<DepthCamera>,
    pub(super) flood: Shared<Flood>,
    pub(super) truth: BoardTruth,
    decoder: Decoder<DeviceToHost>,
    /// What the host sends.
    commands: Decoder<HostToDevice>,
    pub(super) turns: Vec<Turn>,
    connection: u64,
    /// The host has the port open.
    open: bool,
    pending: Vec<u8>,
    recording: bool,
    run: usize,
    failures: usize,
    pub(super) expect_watchdog: bool,
    pub(super) report: Report,
    digest: crc32fast::Hasher,
    /// What the host's time of day was set by, s.
    pub(super) clock_step: Arc<AtomicI64>,
    pub(super) on_kill: Box<dyn FnMut() + Send>,
    pulse_numbers: Option<(u64, u64)>,
}

impl Scene {
    pub(super) fn new(
        plan: Plan,
        builder: SimBuilder,
        clock_step: Arc<AtomicI64>,
        on_kill: Box<dyn FnMut() + Send>,
    ) -> Result<Self, String> {
        let seed = Seed(plan.seed);
        let board = BoardTime::new(OscillatorConfig::default(), seed.stream(Stream::BoardClock));
        let motion = MotionSpec::always(Gesture::Walk)
            .build(seed.stream(Stream::Motion))
            .map_err(|error| error.to_string())?;
        let sensor = SimImu::new(SimImuConfig::typical(seed), motion, board.clone(), seed).shared();
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
            commands: Decoder::new(),
            turns: Vec::new(),
            connection: 0,
            open: false,
            pending: Vec::new(),
            recording: false,
            run: 0,
            failures: 0,
            expect_watchdog: false,
            report: Report::default(),
            digest: crc32fast::Hasher::new(),
            clock_step,
            on_kill,
            pulse_numbers: None,
        })
    }

    /// Virtual time.
    pub(super) fn now(&self) -> Duration {
        Duration::from_nanos(self.rig.now().as_nanos())
    }

    /// Whether the host has this connection.
    pub(super) fn has(&self, connection: u64) -> bool {
        self.open && self.connection == connection
    }

    pub(super) fn close(&mut self, connection: u64) {
        if self.has(connection) {
            self.open = false;
            self.rig.usb_open(false);
            self.step();
        }
    }

    pub(super) fn send(&mut self, connection: u64, bytes: &[u8]) {
        if self.has(connection) {
            self.listen(bytes);
            self.rig.usb_write(bytes);
        }
    }

    /// After a reset the host starts the train itself, on an edge that it names.
    fn listen(&mut self, mut bytes: &[u8]) {
        while let Some(item) = self.commands.next(&mut bytes) {
            if let Ok(HostToDevice {
                command: Command::StartTrigger(StartTrigger { output, start }),
                ..
            }) = item
                && let Some(first) = start.first_edge
                && output.is_camera()
                && self.recording
            {
                let train = Train::of(&start, first);
                self.truth.started(train);
                self.report.train = Some(train);
            }
        }
    }

    /// Opens the port; gives the number of the connection.
    pub(super) fn connect(&mut self) -> Result<u64, OpenError> {
        let path = PORT.to_owned();
        if self.open {
            // The port has somebody: a second opener is turned away.
            self.run(TRY);
            return Err(OpenError::Busy { path });
        }
        let tries = TRY.units() / STEP.units();
        for _ in 0..tries {
            if self.rig.usb_state() == UsbState::Ready {
                break;
            }
            self.step();
        }
        if self.rig.usb_state() != UsbState::Ready {
            return Err(OpenError::NotFound { path });
        }
        self.connection += 1;
        self.open = true;
        // What lay in the driver's buffer is gone with the former connection.
        self.rig.usb_read();
        self.pending.clear();
        self.decoder = Decoder::new();
        self.rig.usb_open(true);
        Ok(self.connection)
    }

    /// What has come for a connection; waits at most so long for it.
    pub(super) fn receive(&mut self, connection: u64, wait: Duration) -> Vec<u8> {
        let end = self.rig.now()
            + SimDuration::from_nanos(u64::try_from(wait.as_nanos()).unwrap_or(u64::MAX));
        while self.pending.is_empty() && self.has(connection) && self.rig.now() < end {
            self.step();
        }
        if self.connection != connection {
            return Vec::new();
        }
        self.judge();
        let bytes = std::mem::take(&mut self.pending);
        self.digest.update(&bytes);
        bytes
    }

    pub(super) fn begin(&mut self, train: Train) {
        self.truth.started(train);
        self.report.first_train = Some(train);
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
            self.complain(wrong);
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
    pub(super) fn restart(&mut self, at: SimTime) {
        // What it had sent before, the host is still given.
        if self.open {
            self.pending.extend(self.rig.usb_read());
        }
        self.judge();
        self.run += 1;
        if let Err(wrong) = self.truth.restart(&mut self.rig, &self.sensor, at) {
            self.complain(wrong);
        }
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
                let known = self.report.hellos.last().map(|last| last.epoch);
                if known != Some(hello.epoch) {
                    self.report.hellos.push(hello.clone());
                    self.report.zeros.extend(self.truth.zero());
                }
            }
            DeviceToHost::Status(status) => self.status(status),
            DeviceToHost::Pulse(pulse) if self.recording => {
                let (first, _) = self.pulse_numbers.unwrap_or((pulse.number, pulse.number));
                if self.run == 0 {
                    self.pulse_numbers = Some((first, pulse.number));
                }
            }
            _ => {}
        }
        if let Err(wrong) = self.truth.message(&message) {
            self.complain(wrong);
        }
        if self.recording {
            self.report.delivered.push(Delivered {
                at: self.rig.now(),
                run: self.run,
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

    pub(super) fn end(&mut self) -> Report {
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
