//! A USB host that enumerates a device as an operating system does and opens
//! its CDC-ACM serial port.
//!
//! Attach is debounced for 100 ms, the port is reset twice with the first
//! eight bytes of the device descriptor read in between, then come address,
//! descriptors, strings, configuration, line coding and the control lines.
//! After that the two bulk endpoints are a byte stream.
//!
//! Every transaction takes its time on a full-speed bus (12 Mbit/s, 13 bytes
//! of overhead a transaction, frames of 1 ms): 19 bulk packets of 64 bytes fit
//! a frame. A device that answers NAK is not polled over and over: the host
//! waits until something changes in the core, and then takes one poll
//! interval more.

use std::collections::VecDeque;

use super::descriptors::{self, CdcAcm, DeviceInfo};
use crate::chip::otg::{Handshake, Otg};
use crate::random::{Random, Seed, USB_STREAM};
use crate::time::{SimDuration, SimTime, UNITS_PER_SECOND};

/// A bit at 12 Mbit/s.
const BIT: u64 = UNITS_PER_SECOND / 12_000_000;
/// Protocol overhead of a transaction in bytes (USB 2.0 table 5-9).
const OVERHEAD: u64 = 13;
const FRAME: SimDuration = SimDuration::from_millis(1);
/// No transaction begins so late that it would run into the next frame.
const FRAME_END: SimDuration = SimDuration::from_micros(3);
/// The start-of-frame packet.
const SOF_TIME: SimDuration = SimDuration::from_micros(4);
/// How long after a device got ready the next token reaches it.
const POLL: SimDuration = SimDuration::from_micros(3);
/// Debounce of an attached device (USB 2.0 7.1.7.3).
const DEBOUNCE: SimDuration = SimDuration::from_millis(100);
/// Length of a port reset by a root hub (USB 2.0 7.1.7.5).
const RESET: SimDuration = SimDuration::from_millis(50);
/// Rest after a reset or a new address.
const RECOVERY: SimDuration = SimDuration::from_millis(10);
/// Idle time after which a device takes itself as suspended (USB 2.0 7.1.7.6).
const IDLE: SimDuration = SimDuration::from_millis(3);
/// Time allowed for a control transfer.
const CONTROL_TIMEOUT: SimDuration = SimDuration::from_secs(5);
/// Address given to the device.
const ADDRESS: u8 = 5;
/// Enumerations tried before the host gives up.
const ATTEMPTS: u32 = 3;

/// How far the host has got with the device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UsbState {
    /// The cable is not plugged in.
    Unplugged,
    /// The cable is in, but no device shows its pull-up.
    NoDevice,
    /// Debouncing, resetting, reading descriptors.
    Enumerating,
    /// The serial port is usable.
    Ready,
    /// The device could not be enumerated.
    Failed(String),
}

/// What went over the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UsbTraffic {
    /// Bytes of the serial port from the device.
    pub bytes_in: u64,
    /// Bytes of the serial port to the device.
    pub bytes_out: u64,
    /// Bulk packets from the device.
    pub packets_in: u64,
    /// Bulk packets to the device.
    pub packets_out: u64,
    /// Completed enumerations.
    pub enumerations: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Descriptor8,
    SetAddress,
    Descriptor,
    ConfigHeader,
    Config,
    Language,
    Text(usize),
    SetConfiguration,
    LineCoding,
    ControlLines,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Unplugged,
    NoDevice,
    Debounce {
        until: SimTime,
    },
    /// Time for the device before the second reset.
    Settle {
        until: SimTime,
    },
    Reset {
        until: SimTime,
        then: Step,
    },
    Rest {
        until: SimTime,
        then: Step,
    },
    Control(Step),
    Ready,
    Failed,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Setup,
    DataIn,
    DataOut,
    StatusIn,
    StatusOut,
}

#[derive(Debug)]
struct Control {
    setup: [u8; 8],
    stage: Stage,
    data: Vec<u8>,
    sent: usize,
    deadline: SimTime,
}

#[derive(Debug, Clone)]
enum Transaction {
    Setup,
    ControlIn,
    ControlOut(Vec<u8>),
    BulkIn(u8),
    BulkOut(u8, Vec<u8>),
    Notification(u8),
}

/// The host and its end of the serial port.
#[derive(Debug)]
pub struct UsbHost {
    phase: Phase,
    failure: String,
    control: Option<Control>,
    inflight: Option<(Transaction, SimTime)>,
    bus_free: SimTime,
    next: SimTime,
    origin: SimTime,
    quiet_since: Option<SimTime>,
    attempts: u32,
    info: DeviceInfo,
    ready: bool,
    open: bool,
    lines_sent: Option<bool>,
    out_turn: bool,
    to_device: VecDeque<u8>,
    from_device: VecDeque<u8>,
    reading: bool,
    buffer_limit: usize,
    corrupt_in_ppm: u32,
    corrupt_out_ppm: u32,
    random: Random,
    config_len: u16,
    /// Bytes of a packet of endpoint 0.
    ep0_packet: usize,
    traffic: UsbTraffic,
    log: Vec<(SimTime, String)>,
}

impl UsbHost {
    /// A host with no cable in it.
    pub(crate) fn new(seed: Seed) -> Self {
        Self {
            phase: Phase::Unplugged,
            failure: String::new(),
            control: None,
            inflight: None,
            bus_free: SimTime::ZERO,
            next: SimTime::NEVER,
            origin: SimTime::ZERO,
            quiet_since: None,
            attempts: 0,
            info: DeviceInfo::default(),
            ready: false,
            open: true,
            lines_sent: None,
            out_turn: false,
            to_device: VecDeque::new(),
            from_device: VecDeque::new(),
            reading: true,
            buffer_limit: usize::MAX,
            corrupt_in_ppm: 0,
            corrupt_out_ppm: 0,
            random: seed.stream(USB_STREAM),
            config_len: 9,
            ep0_packet: 64,
            traffic: UsbTraffic::default(),
            log: Vec::new(),
        }
    }

    // ---- what the user sees ---------------------------------

    /// How far the host has got.
    #[must_use]
    pub fn state(&self) -> UsbState {
        match self.phase {
            Phase::Unplugged => UsbState::Unplugged,
            Phase::NoDevice => UsbState::NoDevice,
            Phase::Failed => UsbState::Failed(self.failure.clone()),
            _ if self.ready => UsbState::Ready,
            _ => UsbState::Enumerating,
        }
    }

    /// What the device said about itself in the last enumeration.
    #[must_use]
    pub fn device(&self) -> &DeviceInfo {
        &self.info
    }

    /// What went over the bus.
    #[must_use]
    pub fn traffic(&self) -> UsbTraffic {
        self.traffic
    }

    /// What the host noticed, with its time.
    #[must_use]
    pub fn log(&self) -> &[(SimTime, String)] {
        &self.log
    }

    /// Bytes of the serial port that have arrived and were not taken yet.
    #[must_use]
    pub fn available(&self) -> usize {
        self.from_device.len()
    }

    /// Takes all bytes that have arrived.
    pub(crate) fn take(&mut self) -> Vec<u8> {
        Vec::from(std::mem::take(&mut self.from_device))
    }

    /// Bytes that were written and have not gone over the bus yet.
    #[must_use]
    pub fn unsent(&self) -> usize {
        self.to_device.len()
    }

    pub(crate) fn write(&mut self, bytes: &[u8]) {
        for &b in bytes {
            let b = corrupt(&mut self.random, self.corrupt_out_ppm, b);
            self.to_device.push_back(b);
        }
    }

    /// Whether the host asks for data at all (a host that hangs does not).
    pub(crate) fn set_reading(&mut self, reading: bool) {
        self.reading = reading;
    }

    /// The host stops asking when so many bytes wait to be taken.
    pub(crate) fn set_buffer_limit(&mut self, bytes: usize) {
        self.buffer_limit = bytes;
    }

    /// Opens or closes the port: DTR and RTS.
    pub(crate) fn set_open(&mut self, open: bool) {
        self.open = open;
    }

    pub(crate) fn set_corruption(&mut self, in_ppm: u32, out_ppm: u32) {
        self.corrupt_in_ppm = in_ppm;
        self.corrupt_out_ppm = out_ppm;
    }

    pub(crate) fn is_plugged(&self) -> bool {
        self.phase != Phase::Unplugged
    }

    pub(crate) fn plug(&mut self, now: SimTime, otg: &mut Otg) {
        if self.is_plugged() {
            return;
        }
        self.note(now, "cable plugged in");
        self.phase = Phase::NoDevice;
        self.attempts = 0;
        otg.set_vbus(true);
        self.step(now, otg);
    }

    pub(crate) fn unplug(&mut self, now: SimTime, otg: &mut Otg) {
        if !self.is_plugged() {
            return;
        }
        self.note(now, "cable pulled out");
        self.drop_device();
        self.phase = Phase::Unplugged;
        self.quiet_since = Some(now);
        otg.set_vbus(false);
        self.step(now, otg);
    }

    fn drop_device(&mut self) {
        self.ready = false;
        self.control = None;
        self.inflight = None;
        self.lines_sent = None;
        // What the operating system had queued for the port is gone with it.
        self.to_device.clear();
    }

    fn note(&mut self, now: SimTime, what: impl Into<String>) {
        self.log.push((now, what.into()));
    }

    // ---- time ------------------------------------------------------------

    pub(crate) fn next_event(&self) -> SimTime {
        self.next
    }

    /// Number of the present frame.
    pub(crate) fn frame(&self, now: SimTime) -> u32 {
        ((now - self.origin).units() / FRAME.units()) as u32
    }

    fn frame_start(&self, now: SimTime) -> SimTime {
        let n = (now - self.origin).units() / FRAME.units();
        self.origin + SimDuration::from_units(n * FRAME.units())
    }

    /// When a transaction with `bytes` of data that could begin at `at` ends.
    fn fit(&self, at: SimTime, bytes: usize) -> SimTime {
        let length = SimDuration::from_units((OVERHEAD + bytes as u64) * 8 * BIT);
        let frame = self.frame_start(at);
        let mut begin = at.max(frame + SOF_TIME);
        if begin + length > frame + SimDuration::from_units(FRAME.units() - FRAME_END.units()) {
            begin = frame + FRAME + SOF_TIME;
        }
        begin + length
    }

    /// Does what is due. Called at [`UsbHost::next_event`], and whenever
    /// something changed in the device's core.
    pub(crate) fn step(&mut self, now: SimTime, otg: &mut Otg) {
        otg.changed = false;
        for _ in 0..16 {
            self.next = SimTime::NEVER;
            self.watch_bus(now, otg);
            if !self.step_once(now, otg) {
                break;
            }
        }
        if otg.wants_sof() && self.active() {
            let boundary = self.frame_start(now) + FRAME;
            self.next = self.next.min(boundary);
        }
    }

    /// Whether frames are sent.
    fn active(&self) -> bool {
        matches!(
            self.phase,
            Phase::Settle { .. } | Phase::Rest { .. } | Phase::Control(_) | Phase::Ready
        )
    }

    /// Attach, detach and suspend.
    fn watch_bus(&mut self, now: SimTime, otg: &mut Otg) {
        let attached = otg.attached();
        match self.phase {
            Phase::Unplugged => {}
            Phase::NoDevice if attached => {
                self.phase = Phase::Debounce {
                    until: now + DEBOUNCE,
                };
                self.quiet_since = Some(now);
                self.note(now, "device attached");
            }
            Phase::NoDevice => {}
            _ if !attached => {
                self.note(now, "device detached");
                self.drop_device();
                self.phase = Phase::NoDevice;
                self.quiet_since = None;
                self.attempts = 0;
            }
            _ => {}
        }
        if let Some(since) = self.quiet_since {
            let due = since + IDLE;
            if now >= due {
                self.quiet_since = None;
                otg.suspend();
            } else {
                self.next = self.next.min(due);
            }
        }
        if otg.wants_sof() && self.active() && now == self.frame_start(now) {
            otg.sof(self.frame(now));
        }
    }

    /// One thing; true if there may be another at once.
    fn step_once(&mut self, now: SimTime, otg: &mut Otg) -> bool {
        match self.phase {
            Phase::Unplugged | Phase::NoDevice | Phase::Failed => false,
            Phase::Debounce { until } => {
                if now < until {
                    self.next = self.next.min(until);
                    return false;
                }
                self.reset(now, Step::Descriptor8, otg);
                true
            }
            Phase::Settle { until } => {
                if now < until {
                    self.next = self.next.min(until);
                    return false;
                }
                self.reset(now, Step::SetAddress, otg);
                true
            }
            Phase::Reset { until, then } => {
                if now < until {
                    self.next = self.next.min(until);
                    return false;
                }
                otg.enumerated();
                self.origin = now;
                self.phase = Phase::Rest {
                    until: now + RECOVERY,
                    then,
                };
                true
            }
            Phase::Rest { until, then } => {
                if now < until {
                    self.next = self.next.min(until);
                    return false;
                }
                self.bus_free = self.bus_free.max(now);
                self.begin(then, now);
                true
            }
            Phase::Control(_) | Phase::Ready => self.transact(now, otg),
        }
    }

    fn reset(&mut self, now: SimTime, then: Step, otg: &mut Otg) {
        if then == Step::Descriptor8 {
            self.ep0_packet = 64;
        }
        self.quiet_since = None;
        self.inflight = None;
        self.control = None;
        otg.bus_reset();
        self.phase = Phase::Reset {
            until: now + RESET,
            then,
        };
    }

    /// Begins a step of the enumeration.
    fn begin(&mut self, step: Step, now: SimTime) {
        let get = |kind: u8, index: u8, language: u16, len: u16| {
            let [l0, l1] = len.to_le_bytes();
            let [g0, g1] = language.to_le_bytes();
            [0x80, 6, index, kind, g0, g1, l0, l1]
        };
        let interface = self.info.cdc.map_or(0, |c| c.control_interface);
        let mut data = Vec::new();
        let setup = match step {
            Step::Descriptor8 => get(1, 0, 0, 8),
            Step::SetAddress => [0x00, 5, ADDRESS, 0, 0, 0, 0, 0],
            Step::Descriptor => get(1, 0, 0, 18),
            Step::ConfigHeader => get(2, 0, 0, 9),
            Step::Config => get(2, 0, 0, self.config_len),
            Step::Language => get(3, 0, 0, 255),
            Step::Text(n) => get(3, self.info.string_indices[n], 0x0409, 255),
            Step::SetConfiguration => [0x00, 9, self.info.configuration, 0, 0, 0, 0, 0],
            Step::LineCoding => {
                // 115,200 baud, one stop bit, no parity, eight bits.
                data = vec![0x00, 0xc2, 0x01, 0x00, 0, 0, 8];
                [0x21, 0x20, 0, 0, interface, 0, 7, 0]
            }
            Step::ControlLines => {
                let lines = if self.open { 3 } else { 0 };
                self.lines_sent = Some(self.open);
                [0x21, 0x22, lines, 0, interface, 0, 0, 0]
            }
        };
        self.control = Some(Control {
            setup,
            stage: Stage::Setup,
            data,
            sent: 0,
            deadline: now + CONTROL_TIMEOUT,
        });
        self.phase = Phase::Control(step);
    }

    /// Goes on after a control transfer that worked.
    fn finished(
        &mut self,
        step: Step,
        data: &[u8],
        now: SimTime,
        otg: &mut Otg,
    ) -> Result<(), String> {
        match step {
            Step::Descriptor8 => {
                if data.len() < 8 || data[1] != 1 {
                    return Err(format!("first bytes of the device descriptor: {data:02x?}"));
                }
                self.ep0_packet = usize::from(data[7]);
                self.phase = Phase::Settle {
                    until: now + RECOVERY,
                };
            }
            Step::SetAddress => {
                if otg.address() != ADDRESS {
                    return Err(format!(
                        "device took address {} instead of {ADDRESS}",
                        otg.address()
                    ));
                }
                self.phase = Phase::Rest {
                    until: now + RECOVERY,
                    then: Step::Descriptor,
                };
            }
            Step::Descriptor => {
                self.info = DeviceInfo::default();
                descriptors::device(data, &mut self.info)?;
                self.begin(Step::ConfigHeader, now);
            }
            Step::ConfigHeader => {
                if data.len() < 9 {
                    return Err(format!("configuration descriptor of {} bytes", data.len()));
                }
                self.config_len = u16::from_le_bytes([data[2], data[3]]);
                self.begin(Step::Config, now);
            }
            Step::Config => {
                descriptors::configuration(data, &mut self.info)?;
                self.begin(Step::Language, now);
            }
            Step::Language => self.next_text(0, now),
            Step::Text(n) => {
                let text = descriptors::string(data)?;
                match n {
                    0 => self.info.manufacturer = text,
                    1 => self.info.product_name = text,
                    _ => self.info.serial = text,
                }
                self.next_text(n + 1, now);
            }
            Step::SetConfiguration => {
                if self.info.cdc.is_none() {
                    return Err("the device has no CDC-ACM function".into());
                }
                self.begin(Step::LineCoding, now);
            }
            Step::LineCoding => self.begin(Step::ControlLines, now),
            Step::ControlLines => {
                if !self.ready {
                    self.ready = true;
                    self.traffic.enumerations += 1;
                    self.note(now, "serial port ready");
                }
                self.phase = Phase::Ready;
            }
        }
        Ok(())
    }

    fn next_text(&mut self, from: usize, now: SimTime) {
        match (from..3).find(|n| self.info.string_indices[*n] != 0) {
            Some(n) => self.begin(Step::Text(n), now),
            None => self.begin(Step::SetConfiguration, now),
        }
    }

    /// A step did not work: try the whole enumeration again, or give up.
    fn broken(&mut self, why: String, now: SimTime, otg: &mut Otg) {
        self.attempts += 1;
        self.note(now, format!("enumeration failed: {why}"));
        self.drop_device();
        if self.attempts < ATTEMPTS {
            self.reset(now, Step::Descriptor8, otg);
        } else {
            self.failure = why;
            self.phase = Phase::Failed;
        }
    }

    // ---- transactions ------------------------------------------------------

    fn transact(&mut self, now: SimTime, otg: &mut Otg) -> bool {
        if let Some((transaction, end)) = self.inflight.take() {
            if now < end {
                self.next = self.next.min(end);
                self.inflight = Some((transaction, end));
                return false;
            }
            self.bus_free = end;
            self.complete(transaction, now, otg);
            return true;
        }
        if let Some(control) = &self.control {
            if now >= control.deadline {
                let step = self.phase;
                self.broken(format!("no answer within 5 s in {step:?}"), now, otg);
                return true;
            }
            self.next = self.next.min(control.deadline);
        } else if self.phase == Phase::Ready && self.lines_sent != Some(self.open) {
            self.begin(Step::ControlLines, now);
            return true;
        }
        let Some((transaction, bytes)) = self.choose(otg) else {
            return false;
        };
        let begin = self.bus_free.max(now + POLL);
        let end = self.fit(begin, bytes);
        self.next = self.next.min(end);
        self.inflight = Some((transaction, end));
        false
    }

    /// The next transaction that the device would not answer with NAK.
    fn choose(&mut self, otg: &Otg) -> Option<(Transaction, usize)> {
        if let Some(control) = &self.control {
            return match control.stage {
                Stage::Setup => Some((Transaction::Setup, 8)),
                Stage::DataIn | Stage::StatusIn => otg
                    .in_ready(0)
                    .map(|_| (Transaction::ControlIn, otg.in_len(0))),
                Stage::DataOut => {
                    let end = (control.sent + self.ep0_packet.max(8)).min(control.data.len());
                    let chunk = control.data[control.sent..end].to_vec();
                    otg.out_ready(0, chunk.len()).map(|_| {
                        let n = chunk.len();
                        (Transaction::ControlOut(chunk), n)
                    })
                }
                Stage::StatusOut => otg
                    .out_ready(0, 0)
                    .map(|_| (Transaction::ControlOut(Vec::new()), 0)),
            };
        }
        let cdc = self.info.cdc?;
        if let Some(ep) = cdc.notification
            && otg.in_ready(usize::from(ep)).is_some()
        {
            return Some((Transaction::Notification(ep), otg.in_len(usize::from(ep))));
        }
        // IN and OUT take turns when both have something.
        self.out_turn = !self.out_turn;
        if self.out_turn {
            self.choose_out(otg, cdc)
                .or_else(|| self.choose_in(otg, cdc))
        } else {
            self.choose_in(otg, cdc)
                .or_else(|| self.choose_out(otg, cdc))
        }
    }

    fn choose_in(&self, otg: &Otg, cdc: CdcAcm) -> Option<(Transaction, usize)> {
        if !self.reading || !self.open || self.from_device.len() >= self.buffer_limit {
            return None;
        }
        let ep = usize::from(cdc.data_in);
        otg.in_ready(ep)
            .map(|_| (Transaction::BulkIn(cdc.data_in), otg.in_len(ep)))
    }

    fn choose_out(&self, otg: &Otg, cdc: CdcAcm) -> Option<(Transaction, usize)> {
        if self.to_device.is_empty() || !self.open {
            return None;
        }
        let len = self.to_device.len().min(cdc.out_packet);
        otg.out_ready(usize::from(cdc.data_out), len)?;
        let data: Vec<u8> = self.to_device.iter().take(len).copied().collect();
        Some((Transaction::BulkOut(cdc.data_out, data), len))
    }

    fn complete(&mut self, transaction: Transaction, now: SimTime, otg: &mut Otg) {
        match transaction {
            Transaction::Setup | Transaction::ControlIn | Transaction::ControlOut(_) => {
                self.complete_control(transaction, now, otg);
            }
            Transaction::Notification(ep) => {
                otg.take_in(usize::from(ep));
            }
            Transaction::BulkIn(ep) => match otg.take_in(usize::from(ep)) {
                Handshake::Ack(data) => {
                    self.traffic.packets_in += 1;
                    self.traffic.bytes_in += data.len() as u64;
                    for b in data {
                        let b = corrupt(&mut self.random, self.corrupt_in_ppm, b);
                        self.from_device.push_back(b);
                    }
                }
                Handshake::Nak => {}
                Handshake::Stall => {
                    self.note(now, "bulk IN stalled");
                    self.broken("bulk IN stalled".into(), now, otg);
                }
            },
            Transaction::BulkOut(ep, data) => match otg.out(usize::from(ep), &data) {
                Handshake::Ack(_) => {
                    self.traffic.packets_out += 1;
                    self.traffic.bytes_out += data.len() as u64;
                    self.to_device.drain(..data.len().min(self.to_device.len()));
                }
                Handshake::Nak => {}
                Handshake::Stall => self.broken("bulk OUT stalled".into(), now, otg),
            },
        }
    }

    fn complete_control(&mut self, transaction: Transaction, now: SimTime, otg: &mut Otg) {
        let Phase::Control(step) = self.phase else {
            return;
        };
        let Some(mut control) = self.control.take() else {
            return;
        };
        let reads = control.setup[0] & 0x80 != 0;
        let wanted = usize::from(u16::from_le_bytes([control.setup[6], control.setup[7]]));
        let answer = match &transaction {
            Transaction::Setup => otg.setup(control.setup),
            Transaction::ControlIn => otg.take_in(0),
            Transaction::ControlOut(data) => otg.out(0, data),
            _ => return,
        };
        let got = match answer {
            Handshake::Ack(data) => data,
            Handshake::Nak => {
                self.control = Some(control);
                return;
            }
            Handshake::Stall => {
                let why = format!("{step:?} was refused (STALL)");
                // Optional things may be refused.
                match step {
                    Step::Text(n) => self.next_text(n + 1, now),
                    Step::Language => self.next_text(3, now),
                    Step::LineCoding => self.begin(Step::ControlLines, now),
                    _ => self.broken(why, now, otg),
                }
                return;
            }
        };
        let mut done = false;
        match control.stage {
            Stage::Setup => {
                control.stage = match (reads, wanted) {
                    (_, 0) => Stage::StatusIn,
                    (true, _) => Stage::DataIn,
                    (false, _) => Stage::DataOut,
                };
            }
            Stage::DataIn => {
                let short = got.len() < self.ep0_packet;
                control.data.extend_from_slice(&got);
                if short || control.data.len() >= wanted {
                    control.stage = Stage::StatusOut;
                }
            }
            Stage::DataOut => {
                control.sent = (control.sent + self.ep0_packet.max(8)).min(control.data.len());
                if control.sent == control.data.len() {
                    control.stage = Stage::StatusIn;
                }
            }
            Stage::StatusIn | Stage::StatusOut => done = true,
        }
        if !done {
            self.control = Some(control);
            return;
        }
        let data = if reads { control.data } else { Vec::new() };
        if let Err(why) = self.finished(step, &data, now, otg) {
            self.broken(why, now, otg);
        }
    }
}

/// Damages a byte with a chance of `ppm` in a million.
fn corrupt(random: &mut Random, ppm: u32, byte: u8) -> u8 {
    if ppm > 0 && random.bits() % 1_000_000 < u64::from(ppm) {
        byte ^ (1 << (random.bits() % 8))
    } else {
        byte
    }
}
