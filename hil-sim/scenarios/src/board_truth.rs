//! What happened at the board's pins, and whether what the board delivered is
//! that.
//!
//! Every edge of the trigger is compared with the arithmetic of the train,
//! whether a message about it reached the host or not. Every message that did
//! reach the host is compared with the pin or the sensor's register that it is
//! about. Messages may be missing; none may be wrong.
//!
//! When tick 0 of the board was is read off the timer's register once, when the board says
//! hello ([`BoardTruth::begin`]), and holds for all edges on all pins.

use std::collections::VecDeque;

use protocol::{
    Capture, DeviceToHost, Edge, ImuFlags, ImuSample, Period, Pulse, TICK_HZ, Ticks, TriggerStart,
};

use rig::imu::SampleRecord;
use rig::wiring::{self, UNITS_PER_TICK};
use stm32f4_sim::pin::{Level, Pin};
use stm32f4_sim::sim::{INPUT_SYNCHRONISER, Sim};
use stm32f4_sim::time::{SimDuration, SimTime};

/// How long after its data-ready edge a sample is read at the latest.
const TRANSFER: SimDuration = SimDuration::from_millis(2);

/// A train: its edge with this number is at `first`, and edge `number + k` at
/// `floor(first + k · period)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Train {
    /// An edge.
    pub first: Ticks,
    /// Its number among the board's pulses.
    pub number: i64,
    /// Distance of edges.
    pub period: Period,
    /// Length of a pulse, in ticks.
    pub width: u32,
}

/// A train as sessions start it, at once: pulses of 12 µs, and the period that a phone reports
/// for 30 frames a second, which is no whole number of ticks.
pub(crate) const TRAIN: TriggerStart = TriggerStart {
    period: match Period::from_picos(33_330_652_540) {
        Some(period) => period,
        None => Period::MAX,
    },
    width: 12 * (TICK_HZ / 1_000_000),
    first_edge: None,
    first_fraction: 0,
};

impl Train {
    /// A train that was started, and its first edge.
    pub(crate) fn of(start: &TriggerStart, first: Ticks) -> Self {
        Self {
            first,
            number: 0,
            period: start.period,
            width: start.width,
        }
    }

    fn edge(&self, number: u64) -> Ticks {
        let number = i64::try_from(number).unwrap_or(i64::MAX);
        self.period
            .edge(self.first, number.saturating_sub(self.number))
    }
}

/// What was compared, and what was not delivered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Compared {
    /// Trigger pulses at the pin, each equal to the arithmetic.
    pub pulses: u64,
    /// Reports of pulses, each equal to the pin.
    pub reports: u64,
    /// Samples of the IMU, each equal to the sensor's registers and its
    /// data-ready edge.
    pub samples: u64,
    /// Samples marked as late, of which only the time was compared.
    pub late_samples: u64,
    /// Samples that differ from the registers, but whose transfer a fault hit.
    pub disturbed: u64,
    /// Edges of data-ready for which no sample was delivered, so far.
    pub samples_missing: u64,
    /// Edges of the strobe, each equal to the pin.
    pub captures: u64,
    /// Edges of the strobe that were not delivered, so far.
    pub captures_missing: u64,
}

/// See the module.
#[derive(Debug, Default)]
pub(crate) struct BoardTruth {
    /// Units of virtual time at tick 0 of this run of the board.
    zero: Option<u64>,
    train: Option<Train>,
    /// A pulse that has not ended.
    rise: Option<SimTime>,
    /// Number of the next pulse of this train at the pin.
    next: u64,
    ready: VecDeque<SampleRecord>,
    strobe: VecDeque<(SimTime, Level)>,
    disturbances: Vec<SimTime>,
    compared: Compared,
}

impl BoardTruth {
    /// Before the board is powered on.
    #[must_use]
    pub(crate) fn new() -> Self {
        Self::default()
    }

    /// The same where tick 0 is known.
    pub(crate) fn at_zero(zero: SimTime) -> Self {
        Self {
            zero: Some(zero.units()),
            ..Self::default()
        }
    }

    /// The train from the pulse with this number on.
    pub(crate) fn started(&mut self, train: Train, number: u64) {
        self.train = Some(train);
        self.next = number;
    }

    /// Counts what is missing from here on.
    pub(crate) fn count_missing_from_here(&mut self) {
        self.compared.samples_missing = 0;
        self.compared.captures_missing = 0;
    }

    /// What was compared so far.
    #[must_use]
    pub(crate) fn compared(&self) -> Compared {
        self.compared
    }

    /// The board has said hello, at its time `now`. To be called within 80 s
    /// of that.
    pub(crate) fn begin(&mut self, rig: &Sim, now: Ticks) {
        if self.zero.is_some() {
            return;
        }
        let (at, count) = rig.timer(wiring::TIMEBASE);
        let ticks = now.0 + u64::from(count.wrapping_sub(now.0 as u32));
        self.zero = at.units().checked_sub(ticks * UNITS_PER_TICK);
    }

    /// Something happened to the I2C bus or the sensor at `at`: the transfer of a
    /// sample under way may be damaged, which nothing on that bus can tell.
    pub(crate) fn disturbed(&mut self, at: SimTime) {
        self.disturbances.push(at);
    }

    /// Takes the edges and samples that have happened, and compares the pulses.
    /// To be called before messages about them are compared, and at least once
    /// between a start and the next.
    ///
    /// # Errors
    ///
    /// A pulse is not where the arithmetic has it.
    pub(crate) fn take(
        &mut self,
        edges: impl IntoIterator<Item = (Pin, Level, SimTime)>,
        samples: impl IntoIterator<Item = SampleRecord>,
    ) -> Result<(), String> {
        for (pin, level, at) in edges {
            match (pin, level) {
                (wiring::TRIGGER, Level::High) => self.rise(at)?,
                (wiring::TRIGGER, Level::Low) => self.fall(at)?,
                (wiring::STROBE, level) => self.strobe.push_back((at, level)),
                _ => {}
            }
        }
        self.ready
            .extend(samples.into_iter().filter(|sample| sample.edge));
        Ok(())
    }

    fn rise(&mut self, at: SimTime) -> Result<(), String> {
        let (Some(zero), Some(train)) = (self.zero, self.train) else {
            return Err(format!("a pulse at {at} that nobody started"));
        };
        let expected = train.edge(self.next);
        let due = zero + expected.0 * UNITS_PER_TICK;
        if at.units() != due {
            let off = at.units() as i128 - i128::from(due);
            return Err(format!(
                "pulse {} at {at} is {} ticks off the arithmetic",
                self.next,
                off as f64 / UNITS_PER_TICK as f64
            ));
        }
        self.rise = Some(at);
        self.next += 1;
        self.compared.pulses += 1;
        Ok(())
    }

    fn fall(&mut self, at: SimTime) -> Result<(), String> {
        let (Some(rise), Some(train)) = (self.rise.take(), self.train) else {
            return Err(format!("the end of a pulse at {at} that never began"));
        };
        let high = at.since(rise).units();
        let expected = u64::from(train.width) * UNITS_PER_TICK;
        if high != expected {
            return Err(format!(
                "the pulse at {rise} is {high} units long, not {expected}"
            ));
        }
        Ok(())
    }

    /// Compares a message with what happened.
    ///
    /// # Errors
    ///
    /// It is about something that did not happen, or not then, or not so.
    pub(crate) fn message(&mut self, message: &DeviceToHost) -> Result<(), String> {
        match message {
            DeviceToHost::Pulse(pulse) if pulse.output.is_camera() => self.pulse(pulse),
            DeviceToHost::Imu(sample) => self.sample(sample),
            DeviceToHost::Capture(capture) => self.capture(capture),
            _ => Ok(()),
        }
    }

    fn pulse(&mut self, pulse: &Pulse) -> Result<(), String> {
        let Some(train) = self.train else {
            return Err(format!("a pulse without a train: {pulse:?}"));
        };
        let expected = train.edge(pulse.number);
        if pulse.at != expected {
            return Err(format!("{pulse:?} should be at {expected:?}"));
        }
        // Where the edge of this number was at the pin has been compared.
        if pulse.number >= self.next {
            return Err(format!(
                "{pulse:?} has no edge at the pin, whose next one is {}",
                self.next
            ));
        }
        self.compared.reports += 1;
        Ok(())
    }

    fn sample(&mut self, sample: &ImuSample) -> Result<(), String> {
        let Some(zero) = self.zero else {
            return Err(format!("before any hello: {sample:?}"));
        };
        loop {
            let Some(record) = self.ready.pop_front() else {
                return Err(format!("{sample:?} has no data-ready edge"));
            };
            let at = captured(record.at, zero);
            if at != sample.at.0 {
                if at > sample.at.0 {
                    return Err(format!(
                        "{sample:?} has no data-ready edge; the next is at tick {at}"
                    ));
                }
                self.compared.samples_missing += 1;
                continue;
            }
            if sample.flags.has(ImuFlags::LATE) {
                self.compared.late_samples += 1;
                return Ok(());
            }
            let values = record.values;
            let read = (sample.accel, sample.temperature, sample.gyro);
            if read != (values.accel, values.temperature, values.gyro) {
                let until = record.at + TRANSFER;
                let hit = |at: &SimTime| record.at <= *at && *at <= until;
                if self.disturbances.iter().any(hit) {
                    self.compared.disturbed += 1;
                    return Ok(());
                }
                return Err(format!("{sample:?} was {values:?} in the registers"));
            }
            self.compared.samples += 1;
            return Ok(());
        }
    }

    fn capture(&mut self, capture: &Capture) -> Result<(), String> {
        let Some(zero) = self.zero else {
            return Err(format!("before any hello: {capture:?}"));
        };
        loop {
            let Some((at, level)) = self.strobe.pop_front() else {
                return Err(format!("{capture:?} has no edge at the pin"));
            };
            let at = captured(at, zero);
            if at != capture.at.0 {
                if at > capture.at.0 {
                    return Err(format!(
                        "{capture:?} has no edge at the pin; the next is at tick {at}"
                    ));
                }
                self.compared.captures_missing += 1;
                continue;
            }
            let rises = capture.edge == Edge::Rising;
            if rises != level.is_high() && !capture.after_loss {
                return Err(format!("{capture:?} went to {level:?}"));
            }
            self.compared.captures += 1;
            return Ok(());
        }
    }
}

/// The tick that is captured of an edge at `at`, if tick 0 was at `zero` units: behind the
/// input's synchroniser. The firmware takes the filter off.
pub(crate) fn captured(at: SimTime, zero: u64) -> u64 {
    at.units().saturating_sub(zero) / UNITS_PER_TICK + INPUT_SYNCHRONISER
}
