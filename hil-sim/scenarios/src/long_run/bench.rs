//! The rig of a long run, the host's end of its link, and what is compared.

use std::fmt::Display;
use std::time::Duration;

use anyhow::{Error, Result, anyhow};
use board::{Conversation, Event, Stream as HostStream};
use protocol::{
    Command, DeviceToHost, Output, Request, SendFiller, StartTrigger, Status, StopTrigger, TICK_HZ,
};

use super::{Growth, Interrupt, Options, Report};
use crate::board_truth::{BoardTruth, Compared, TRAIN, Train};
use rig::depth_camera::{DepthCamera, DepthCameraConfig};
use rig::imu::{SimImu, SimImuConfig};
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::oscillator::{BoardTime, OscillatorConfig};
use rig::random::Stream;
use rig::wiring::{self, BoardKind};
use stm32f4_sim::shared::lock;
use stm32f4_sim::sim::Sim;
use stm32f4_sim::time::{SimDuration, SimTime};

/// Virtual time between two looks at what has come.
const STEP: SimDuration = SimDuration::from_millis(50);
/// Steps in a virtual second.
pub(super) const STEPS_A_SECOND: u64 = 20;

/// Interrupts of the chip that the firmware uses (RM0090 table 62), by position.
const INTERRUPTS: [(usize, &str); 9] = [
    (28, "TIM2: captures"),
    (16, "DMA1 stream 5: end of a trigger pulse"),
    (51, "SPI3: what TIM2 leaves behind"),
    (67, "OTG_FS: USB"),
    (30, "TIM4: the tasks' clock"),
    (31, "I2C1 events"),
    (32, "I2C1 errors"),
    (11, "DMA1 stream 0: I2C in"),
    (17, "DMA1 stream 6: I2C out"),
];

/// First and latest values of what is counted on the wire.
#[derive(Default)]
struct Field {
    first: Option<u64>,
    last: u64,
}

impl Field {
    fn see(&mut self, value: u64) {
        self.first.get_or_insert(value);
        self.last = value;
    }

    fn growth(&self, field: &'static str) -> Growth {
        let bytes = |value: u64| (u64::BITS - (value | 1).leading_zeros()).div_ceil(7);
        Growth {
            field,
            last: self.last,
            from_bytes: bytes(self.first.unwrap_or(0)),
            to_bytes: bytes(self.last),
        }
    }
}

#[derive(Default)]
struct Fields {
    pulse_at: Field,
    pulse_seq: Field,
    pulse_number: Field,
    sample_at: Field,
    sample_seq: Field,
    capture_seq: Field,
    status_seq: Field,
    filler_seq: Field,
}

/// The rig of a run, the host's end of its link, and what is compared.
pub(super) struct Bench {
    rig: Sim,
    conversation: Conversation,
    sensor: stm32f4_sim::shared::Shared<SimImu>,
    camera: stm32f4_sim::shared::Shared<DepthCamera>,
    truth: BoardTruth,
    fields: Fields,
    /// The status before, and the latest.
    statuses: u64,
    status: Option<Status>,
    first_status: Option<Status>,
    fillers: u64,
    worst_load: u16,
    firmware: String,
    answers: Vec<protocol::Answer>,
}

impl Bench {
    pub(super) fn new(options: &Options) -> Result<Self> {
        let seed = options.seed;
        let board = BoardTime::new(OscillatorConfig::default(), seed.stream(Stream::BoardClock));
        let motion = MotionSpec::always(Gesture::Walk).build(seed.stream(Stream::Motion));
        let sensor = SimImu::new(SimImuConfig::typical(seed), motion, board.clone(), seed).shared();
        let config = DepthCameraConfig {
            photodiode: options.strobe,
            ..DepthCameraConfig::default()
        };
        let camera = DepthCamera::new(config, board, seed)?;
        let camera = std::sync::Arc::new(std::sync::Mutex::new(camera));
        let mut rig = wiring::board_of(BoardKind::default(), options.elf.as_deref())
            .seed(seed)
            .model(sensor.clone())
            .i2c_target(sensor.clone())
            .model(camera.clone())
            .build()?;
        for pin in [wiring::TRIGGER, wiring::STROBE] {
            rig.log_pin(pin);
        }
        Ok(Self {
            rig,
            conversation: Conversation::new(1),
            sensor,
            camera,
            truth: BoardTruth::new(),
            fields: Fields::default(),
            statuses: 0,
            status: None,
            first_status: None,
            fillers: 0,
            worst_load: 0,
            firmware: String::new(),
            answers: Vec::new(),
        })
    }

    /// Progress so far.
    pub(super) fn compared(&self) -> Compared {
        self.truth.compared()
    }

    /// Virtual time.
    pub(super) fn now(&self) -> SimTime {
        self.rig.now()
    }

    fn wrong(&self, what: impl Display) -> Error {
        anyhow!("after {} s of virtual time: {what}", self.rig.now())
    }

    /// Boots, waits for the IMU, starts the train.
    pub(super) fn start(&mut self) -> Result<()> {
        for _ in 0..2 * STEPS_A_SECOND {
            self.step()?;
        }
        let (output, start) = (Output::Camera, TRAIN);
        let status = self.ask(StartTrigger { output, start })?;
        self.truth.started(Train::of(&start, status.next_edge), 0);
        // From here on nothing may be lost.
        self.conversation.start_counting();
        self.first_status = None;
        self.statuses = 0;
        Ok(())
    }

    pub(super) fn stop(&mut self) -> Result<()> {
        self.ask(StopTrigger(Output::Camera))?;
        for _ in 0..2 * STEPS_A_SECOND {
            self.step()?;
        }
        Ok(())
    }

    pub(super) fn fill(&mut self, full: bool) -> Result<()> {
        let bytes_per_second = if full { u32::MAX } else { 0 };
        self.ask(SendFiller { bytes_per_second })
    }

    /// Sends a command and runs on until it is answered.
    fn ask<R: Request>(&mut self, command: R) -> Result<R::Reply> {
        let now = Duration::from_nanos(self.rig.now().as_nanos());
        let command: Command = command.into();
        let what = format!("{command:?}");
        let id = self.conversation.send(now, command, Duration::from_secs(2));
        let bytes = self.conversation.take_outgoing();
        self.rig.usb_write(&bytes);
        for _ in 0..2_000 {
            // The first pulse comes a millisecond after its start: nothing is
            // compared before the answer is known.
            self.rig.run_for(SimDuration::from_millis(1))?;
            self.receive()?;
            if let Some(at) = self.answers.iter().position(|answer| answer.id == id) {
                return match self.answers.swap_remove(at).result {
                    Ok(reply) => R::unwrap(reply)
                        .ok_or_else(|| self.wrong(format!("{what} had another's reply"))),
                    Err(refusal) => Err(self.wrong(format!("{what} was refused: {refusal:?}"))),
                };
            }
        }
        Err(self.wrong(format!("{what} was not answered")))
    }

    pub(super) fn step(&mut self) -> Result<()> {
        self.rig.run_for(STEP)?;
        lock(&self.camera).take_frames();
        self.receive()
    }

    /// Takes what the board has sent through the host's side of the conversation.
    fn receive(&mut self) -> Result<()> {
        let bytes = self.rig.usb_read();
        self.conversation.receive(&bytes);
        let now = Duration::from_nanos(self.rig.now().as_nanos());
        self.conversation.tick(now);
        // What a message is about has happened before it was sent.
        let samples = lock(&self.sensor).take_log();
        self.truth
            .take(self.rig.take_edges(), samples)
            .map_err(|wrong| self.wrong(wrong))?;
        while let Some(event) = self.conversation.next_event() {
            match event {
                Event::Message(message) => self.message(message)?,
                Event::Answer(answer) => self.answers.push(answer),
                other => return Err(self.wrong(format!("{other:?}"))),
            }
        }
        Ok(())
    }

    fn message(&mut self, message: DeviceToHost) -> Result<()> {
        if let DeviceToHost::Hello(hello) = &message {
            self.truth.begin(&self.rig, hello.now);
            self.firmware = hello.git_revision.to_string();
        }
        self.truth
            .message(&message)
            .map_err(|wrong| self.wrong(wrong))?;
        let fields = &mut self.fields;
        match message {
            DeviceToHost::Pulse(pulse) if !pulse.output.is_camera() => {
                return Err(self.wrong("an output that was not started"));
            }
            DeviceToHost::Pulse(pulse) => {
                fields.pulse_at.see(pulse.at.0);
                fields.pulse_seq.see(pulse.seq.into());
                fields.pulse_number.see(pulse.number);
            }
            DeviceToHost::Imu(sample) => {
                fields.sample_at.see(sample.at.0);
                fields.sample_seq.see(sample.seq.into());
            }
            DeviceToHost::Capture(capture) => fields.capture_seq.see(capture.seq.into()),
            DeviceToHost::Filler(filler) => {
                fields.filler_seq.see(filler.seq.into());
                self.fillers += 1;
                let first = filler.seq as u8;
                let right = filler
                    .payload
                    .iter()
                    .enumerate()
                    .all(|(n, &byte)| byte == first.wrapping_add(n as u8));
                if !right {
                    return Err(self.wrong(format!("filler {} is damaged", filler.seq)));
                }
            }
            DeviceToHost::Status(status) => {
                fields.status_seq.see(status.seq.into());
                self.status(status)?;
            }
            DeviceToHost::Pps(_) => {
                return Err(self.wrong("an output that was not started"));
            }
            DeviceToHost::Hello(_) | DeviceToHost::Answer(_) | DeviceToHost::Arrived(_) => {}
        }
        Ok(())
    }

    /// A second apart, to a millisecond: sent by a task, not by a timer's edge.
    fn status(&mut self, status: Status) -> Result<()> {
        if let Some(before) = &self.status {
            let apart = status.at.0.saturating_sub(before.at.0);
            if apart.abs_diff(u64::from(TICK_HZ)) > u64::from(TICK_HZ) / 1000 {
                return Err(self.wrong(format!("a status after {apart} ticks")));
            }
        }
        if let Some(first) = &self.first_status
            && status.dropped != first.dropped
        {
            return Err(self.wrong(format!(
                "dropped: {:?}, at the begin {:?}",
                status.dropped, first.dropped
            )));
        }
        self.worst_load = self.worst_load.max(status.cpu_permille);
        self.statuses += 1;
        self.first_status.get_or_insert_with(|| status.clone());
        self.status = Some(status);
        Ok(())
    }

    pub(super) fn stack_used(&self) -> u32 {
        self.status.as_ref().map_or(0, |status| status.stack_used)
    }

    pub(super) fn report(&mut self, mut report: Report) -> Result<Report> {
        let (Some(first), Some(last)) = (self.first_status.clone(), self.status.clone()) else {
            return Err(self.wrong("no status came"));
        };
        let compared = self.truth.compared();
        let counts = self.conversation.counts();
        let mut complaints = Vec::new();
        let mut expect = |right: bool, what: String| {
            if !right {
                complaints.push(what);
            }
        };
        expect(
            last.trigger.pulses == compared.pulses && compared.reports == compared.pulses,
            format!(
                "{} pulses were made by the board's count, {} seen at the pin, {} reported",
                last.trigger.pulses, compared.pulses, compared.reports
            ),
        );
        for stream in [
            HostStream::Pulses,
            HostStream::Imu,
            HostStream::Captures,
            HostStream::Status,
            HostStream::Filler,
        ] {
            let lost = counts.of(stream).lost;
            expect(lost == 0, format!("{lost} {stream} were lost"));
        }
        expect(
            compared.late_samples == 0 && last.imu.late == first.imu.late,
            format!("{} samples were late", compared.late_samples),
        );
        expect(
            last.trigger.late == 0,
            format!("{} edges were late", last.trigger.late),
        );
        expect(
            (last.strobe_overcaptures, last.strobe_floods) == (0, 0),
            format!("{} over-captures", last.strobe_overcaptures),
        );
        expect(last.epoch == first.epoch, "the board was reset".to_owned());
        expect(
            self.conversation.damaged_frames() == 0,
            format!("{} frames were damaged", self.conversation.damaged_frames()),
        );
        if let Some(complaint) = complaints.first() {
            return Err(self.wrong(complaint.clone()));
        }

        let fields = &self.fields;
        report.growth = vec![
            fields.pulse_at.growth("time of a pulse, in ticks"),
            fields.sample_at.growth("time of a sample, in ticks"),
            fields.pulse_seq.growth("number of a pulse message"),
            fields.pulse_number.growth("number of a pulse in its train"),
            fields.sample_seq.growth("number of a sample"),
            fields.capture_seq.growth("number of a capture"),
            fields.status_seq.growth("number of a status"),
            fields.filler_seq.growth("number of a filler message"),
        ];
        report.firmware.clone_from(&self.firmware);
        report.pulses = compared.pulses;
        report.pulses_reported = compared.reports;
        report.samples = compared.samples;
        report.captures = compared.captures;
        report.statuses = self.statuses;
        report.fillers = self.fillers;
        report.link_bytes = self.conversation.bytes();
        report.lost = counts.lost();
        report.wraps = (last.at.0 >> 32) - (first.at.0 >> 32);
        report.stack_used = last.stack_used;
        report.stack_size = last.stack_size;
        report.trigger_latency_us = f64::from(last.trigger_latency) * 1e6 / f64::from(TICK_HZ);
        report.worst_load_percent = f64::from(self.worst_load) / 10.0;
        report.interrupts = self.interrupts();
        Ok(report)
    }

    fn interrupts(&mut self) -> Vec<Interrupt> {
        let stats = self.rig.cpu_stats();
        let us = 1e6 / self.rig.core_rate().hz_rounded() as f64;
        INTERRUPTS
            .iter()
            .filter_map(|&(position, name)| {
                let irq = stats.exceptions.get(16 + position)?;
                (irq.entries > 0).then(|| Interrupt {
                    name,
                    entries: irq.entries,
                    longest_wait_us: (irq.sum_latency > 0).then_some(irq.max_latency as f64 * us),
                    mean_wait_us: (irq.sum_latency > 0)
                        .then(|| irq.sum_latency as f64 / irq.entries as f64 * us),
                    longest_run_us: irq.max_cycles as f64 * us,
                })
            })
            .collect()
    }
}
