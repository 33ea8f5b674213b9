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

mod enumeration;
mod transactions;

use std::collections::VecDeque;

use crate::chip::otg::{Handshake, Otg};
use crate::random::{Random, Seed, USB_STREAM};
use crate::time::{SimDuration, SimTime, UNITS_PER_SECOND};
use transactions::corrupt;

use crate::usb::descriptors::{self, CdcAcm, DeviceInfo};

/// A bit at 12 Mbit/s.
const BIT: u64 = UNITS_PER_SECOND / 12_000_000;
/// Protocol overhead of a transaction in bytes (USB 2.0 table 5-9).
const OVERHEAD: u64 = 13;
const FRAME: SimDuration = SimDuration::from_millis(1);
/// No transaction begins so late that it would run into the next frame.
const FRAME_END: SimDuration = SimDuration::from_micros(3);
/// The start-of-frame packet.
const SOF_TIME: SimDuration = SimDuration::from_micros(4);
/// Time after a device got ready at which the next token reaches it.
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

/// Progress of the host with the device.
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
    /// CLEAR_FEATURE(HALT) of the bulk IN endpoint, or of the other one.
    ClearHalt {
        is_in: bool,
    },
    ControlLines,
}

/// End of a control transfer that the host does not finish.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UsbCut {
    /// The cable is pulled.
    Unplug,
    /// The host resets the bus and enumerates the device again.
    Reset,
    /// The host gives the transfer up and begins it again.
    Retry,
}

#[derive(Clone, Copy, Debug)]
enum Cutting {
    /// After this number of further transactions of control transfers, and then a time.
    After(u32, SimDuration),
    At(SimTime),
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
    /// Another host has the bus.
    Away,
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
pub(crate) struct UsbHost {
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
    clears_halts: bool,
    configures: bool,
    cut: Option<(UsbCut, Cutting)>,
    /// Time without its pull-up before which a device that comes back is not seen.
    pub(crate) shortest_detach: SimDuration,
    left_at: Option<SimTime>,
    came_back_early: bool,
    /// Data toggles of the two bulk endpoints.
    toggle_in: bool,
    toggle_out: bool,
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
            clears_halts: false,
            configures: false,
            cut: None,
            shortest_detach: SimDuration::ZERO,
            left_at: None,
            came_back_early: false,
            toggle_in: false,
            toggle_out: false,
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
            log: Vec::new(),
        }
    }

    // ---- what the user sees ---------------------------------

    /// Progress of the host.
    #[must_use]
    pub(crate) fn state(&self) -> UsbState {
        match self.phase {
            Phase::Unplugged => UsbState::Unplugged,
            Phase::NoDevice => UsbState::NoDevice,
            Phase::Failed => UsbState::Failed(self.failure.clone()),
            _ if self.ready => UsbState::Ready,
            _ => UsbState::Enumerating,
        }
    }

    /// Description that the device gave of itself in the last enumeration.
    #[must_use]
    pub(crate) fn device(&self) -> &DeviceInfo {
        &self.info
    }

    /// Observations of the host, with their times.
    #[must_use]
    pub(crate) fn log(&self) -> &[(SimTime, String)] {
        &self.log
    }

    /// Takes all bytes that have arrived.
    pub(crate) fn take(&mut self) -> Vec<u8> {
        Vec::from(std::mem::take(&mut self.from_device))
    }

    /// Bytes that were written and have not gone over the bus yet.
    #[must_use]
    pub(crate) fn unsent(&self) -> usize {
        self.to_device.len()
    }

    pub(crate) fn write(&mut self, bytes: &[u8]) {
        for &b in bytes {
            let b = corrupt(&mut self.random, self.corrupt_out_ppm, b);
            self.to_device.push_back(b);
        }
    }

    /// True if the host asks for data at all (a host that hangs does not).
    pub(crate) fn set_reading(&mut self, reading: bool) {
        self.reading = reading;
    }

    /// Number of bytes waiting to be taken at which the host stops asking.
    pub(crate) fn set_buffer_limit(&mut self, bytes: usize) {
        self.buffer_limit = bytes;
    }

    /// Opens or closes the port: DTR and RTS.
    pub(crate) fn set_open(&mut self, open: bool) {
        self.open = open;
    }

    /// Clears the halts of the bulk endpoints when it opens the port, as FreeBSD does.
    pub(crate) fn set_clears_halts(&mut self, on: bool) {
        self.clears_halts = on;
    }

    /// Sets the configuration again.
    pub(crate) fn configure_again(&mut self) {
        self.configures = true;
    }

    /// Ends a control transfer after this number of further transactions, and then a time.
    pub(crate) fn cut(&mut self, what: UsbCut, transactions: u32, delay: SimDuration) {
        self.cut = Some((what, Cutting::After(transactions, delay)));
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
        self.left_at = None;
        self.came_back_early = false;
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

    /// Resets the bus at once, and enumerates the device again.
    pub(crate) fn reset_bus(&mut self, now: SimTime, otg: &mut Otg) {
        if matches!(self.phase, Phase::Unplugged | Phase::NoDevice) {
            return;
        }
        self.note(now, "bus reset");
        self.drop_device();
        self.attempts = 0;
        self.reset(now, Step::Descriptor8, otg);
        self.step(now, otg);
    }

    /// Stops all traffic, as before a computer's sleep, and resets the bus after `length`.
    pub(crate) fn suspend(&mut self, now: SimTime, length: SimDuration, otg: &mut Otg) {
        if matches!(self.phase, Phase::Unplugged | Phase::NoDevice) {
            return;
        }
        self.note(now, "bus suspended");
        self.drop_device();
        self.attempts = 0;
        self.phase = Phase::Debounce {
            until: now + length,
        };
        self.quiet_since = Some(now);
        self.step(now, otg);
    }

    /// Leaves the bus to another host.
    pub(crate) fn leave(&mut self) {
        self.drop_device();
        self.phase = Phase::Away;
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
            self.cut_transfer(now, otg);
            if !self.step_once(now, otg) {
                break;
            }
        }
        if otg.wants_sof() && self.active() {
            let boundary = self.frame_start(now) + FRAME;
            self.next = self.next.min(boundary);
        }
    }

    /// True if frames are sent.
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
            Phase::Unplugged | Phase::Away => {}
            Phase::NoDevice if attached && self.came_back_early => {}
            Phase::NoDevice
                if attached && (self.left_at).is_some_and(|at| now < at + self.shortest_detach) =>
            {
                self.came_back_early = true;
                self.note(now, "the device came back too soon: it is not seen");
            }
            Phase::NoDevice if attached => {
                self.phase = Phase::Debounce {
                    until: now + DEBOUNCE,
                };
                self.quiet_since = Some(now);
                self.note(now, "device attached");
            }
            Phase::NoDevice if self.came_back_early => {
                self.came_back_early = false;
                self.left_at = Some(now);
            }
            Phase::NoDevice => {}
            _ if !attached => {
                self.note(now, "device detached");
                self.drop_device();
                self.phase = Phase::NoDevice;
                self.left_at = Some(now);
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

    /// Ends a control transfer, if that was asked for and is due.
    fn cut_transfer(&mut self, now: SimTime, otg: &mut Otg) {
        match self.cut {
            Some((what, Cutting::At(at))) if at <= now => {
                self.cut = None;
                match what {
                    UsbCut::Unplug => self.unplug(now, otg),
                    UsbCut::Reset => self.reset_bus(now, otg),
                    UsbCut::Retry => {
                        if let Phase::Control(step) = self.phase {
                            self.inflight = None;
                            self.begin(step, now);
                        }
                    }
                }
            }
            Some((_, Cutting::At(at))) => self.next = self.next.min(at),
            _ => {}
        }
    }

    /// One thing; true if there may be another at once.
    fn step_once(&mut self, now: SimTime, otg: &mut Otg) -> bool {
        match self.phase {
            Phase::Unplugged | Phase::NoDevice | Phase::Failed | Phase::Away => false,
            Phase::Debounce { until }
            | Phase::Settle { until }
            | Phase::Reset { until, .. }
            | Phase::Rest { until, .. }
                if now < until =>
            {
                self.next = self.next.min(until);
                false
            }
            Phase::Debounce { .. } => {
                self.reset(now, Step::Descriptor8, otg);
                true
            }
            Phase::Settle { .. } => {
                self.reset(now, Step::SetAddress, otg);
                true
            }
            Phase::Reset { then, .. } => {
                otg.enumerated();
                self.origin = now;
                self.phase = Phase::Rest {
                    until: now + RECOVERY,
                    then,
                };
                true
            }
            Phase::Rest { then, .. } => {
                self.bus_free = self.bus_free.max(now);
                self.begin(then, now);
                true
            }
            Phase::Control(_) | Phase::Ready => self.transact(now, otg),
        }
    }
}
