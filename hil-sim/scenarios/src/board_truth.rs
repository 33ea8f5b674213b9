//! Compares what the board delivered with what happened at its pins.
//!
//! Every edge of the trigger is compared with the arithmetic of the train,
//! whether a message about it reached the host or not. Every message that did
//! reach the host is compared with the pin or the sensor's register that it is
//! about. Messages may be missing; none may be wrong.
//!
//! Where the host asks for other periods, the board may or may not have understood each of
//! them: all edges must be on the arithmetic of one train whose period changes, at any edges,
//! to some of those that were asked for, in that order.
//!
//! One time of the board's tick 0 holds for all edges on all pins ([`BoardTruth::at_zero`]).

use std::collections::VecDeque;

use protocol::{
    Capture, DeviceToHost, Edge, EdgeGrid, EdgeTime, ImuFlags, ImuSample, Period, Pulse, Ticks,
};

use rig::imu::SampleRecord;
use rig::wiring::{self, UNITS_PER_TICK};
use stm32f4_sim::pin::{Level, Pin};
use stm32f4_sim::sim::INPUT_SYNCHRONISER;
use stm32f4_sim::time::{SimDuration, SimTime};

/// Longest time from its data-ready edge until a sample is read.
const TRANSFER: SimDuration = SimDuration::from_millis(2);

/// A train on a grid. That the firmware's edges are those of the grid is tested by an arithmetic of
/// its own in `rig/tests/it/trigger.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Train {
    /// Its edges.
    pub grid: EdgeGrid,
    /// Number of the grid's anchor among the board's pulses.
    pub number: i64,
    /// Length of a pulse, in ticks.
    pub width: u32,
}

impl Train {
    fn edge(&self, number: u64) -> EdgeTime {
        self.grid.edge((number as i64).saturating_sub(self.number))
    }

    /// The same train with another period from an edge on.
    fn with_period(&self, period: Period, from: u64) -> Self {
        Self {
            grid: EdgeGrid::new(self.edge(from), period),
            number: from as i64,
            width: self.width,
        }
    }
}

/// A course of a train, from its last change of period on.
#[derive(Clone, Copy, Debug)]
struct Course {
    train: Train,
    /// Number of periods that were asked for until the one that it has.
    asked: usize,
    /// Number of its changes of period.
    changes: u64,
}

/// Counts of what was compared, and of what was not delivered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Compared {
    /// Trigger pulses at the pin, each equal to the arithmetic.
    pub pulses: u64,
    /// Reports of pulses, each equal to the pin.
    pub reports: u64,
    /// Samples of the IMU, each equal to the sensor's registers and its
    /// data-ready edge.
    pub samples: u64,
    /// Samples that differ from the registers, but whose transfer a fault hit.
    pub disturbed: u64,
    /// Edges of data-ready for which no sample was delivered, so far.
    pub samples_missing: u64,
    /// Edges of the strobe, each equal to the pin.
    pub captures: u64,
    /// Edges of the strobe that were not delivered, so far.
    pub captures_missing: u64,
    /// Changes of the trigger's period.
    pub period_changes: u64,
}

/// Comparison of a board's messages with its pins, as the module's header describes.
#[derive(Debug, Default)]
pub(crate) struct BoardTruth {
    /// Units of virtual time at tick 0 of this run of the board.
    zero: u64,
    /// The courses of the train that explain all its edges so far.
    courses: Vec<Course>,
    /// Number of the first pulse that is compared.
    first: u64,
    /// Periods that the host has asked for; if there are any, the ticks of all edges.
    asked: Vec<Period>,
    edges: Vec<u64>,
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
    /// Where tick 0 was at `zero`.
    pub(crate) fn at_zero(zero: SimTime) -> Self {
        Self {
            zero: zero.units(),
            ..Self::default()
        }
    }

    /// The train from the pulse with this number on.
    pub(crate) fn started(&mut self, train: Train, number: u64) {
        self.courses = vec![Course {
            train,
            asked: 0,
            changes: 0,
        }];
        self.edges.clear();
        (self.first, self.next) = (number, number);
    }

    /// The host has asked for these periods, in this order.
    pub(crate) fn asked_for(&mut self, periods: Vec<Period>) {
        self.asked = periods;
    }

    /// Counts what is missing from here on.
    pub(crate) fn count_missing_from_here(&mut self) {
        self.compared.samples_missing = 0;
        self.compared.captures_missing = 0;
    }

    /// Counts so far.
    #[must_use]
    pub(crate) fn compared(&self) -> Compared {
        self.compared
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
        let Some(course) = self.courses.first() else {
            return Err(format!("a pulse at {at} that nobody started"));
        };
        let zero = self.zero;
        let number = self.next;
        let due = zero + course.train.edge(number).ticks.0 * UNITS_PER_TICK;
        let ticks = at.units().saturating_sub(zero) / UNITS_PER_TICK;
        if !self.asked.is_empty() {
            self.edges.push(ticks);
        }
        let mut courses = Vec::new();
        // An edge between two ticks is nobody's.
        if at.units() == zero + ticks * UNITS_PER_TICK {
            for course in &self.courses {
                if course.train.edge(number).ticks.0 == ticks {
                    courses.push(*course)
                } else {
                    courses.extend(self.changed(course))
                }
            }
        }
        let place = |course: &Course| (course.train.edge(number), course.train.grid.period);
        courses.sort_by_key(place);
        courses.dedup_by_key(|course| place(course));
        let Some(course) = courses.first() else {
            let off = at.units() as i128 - i128::from(due);
            return Err(format!(
                "pulse {number} at {at} is {} ticks off the arithmetic",
                off as f64 / UNITS_PER_TICK as f64
            ));
        };
        self.compared.period_changes = course.changes;
        self.courses = courses;
        self.rise = Some(at);
        self.next += 1;
        self.compared.pulses += 1;
        Ok(())
    }

    /// Returns the courses that explain all edges with a later period, beginning at an edge before
    /// the one at which the last course fails. Two changes may be so near to each other that no
    /// edge shows the first alone: after lost answers one period follows another at once.
    fn changed(&self, course: &Course) -> Vec<Course> {
        let failed = (self.first + self.edges.len() as u64).saturating_sub(1);
        let mut explain = Vec::new();
        for once in self.with_change(course, failed) {
            match self.fails_at(&once) {
                None => explain.push(once),
                Some(failed) if failed as i64 > once.train.number => {
                    let twice = self.with_change(&once, failed);
                    explain.extend(twice.filter(|twice| self.fails_at(twice).is_none()));
                }
                Some(_) => {}
            }
        }
        explain
    }

    /// The course with each period that was asked for later, from each of its edges before
    /// `until` on.
    fn with_change(&self, course: &Course, until: u64) -> impl Iterator<Item = Course> {
        let begin = u64::try_from(course.train.number).unwrap_or(0);
        let course = *course;
        (begin.max(self.first)..until).flat_map(move |from| {
            let asked = self.asked.iter().enumerate().skip(course.asked);
            asked.map(move |(place, &period)| Course {
                train: course.train.with_period(period, from),
                asked: place + 1,
                changes: course.changes + 1,
            })
        })
    }

    /// The first edge since its last change that is not where the course has it.
    fn fails_at(&self, course: &Course) -> Option<u64> {
        let begin =
            u64::try_from(course.train.number).map_or(self.first, |number| number.max(self.first));
        let edges = self.edges.get((begin - self.first) as usize..);
        let mut since = (begin..).zip(edges.unwrap_or_default());
        let off = since.find(|&(number, &ticks)| course.train.edge(number).ticks.0 != ticks);
        off.map(|(number, _)| number)
    }

    fn fall(&mut self, at: SimTime) -> Result<(), String> {
        let (Some(rise), Some(course)) = (self.rise.take(), self.courses.first()) else {
            return Err(format!("the end of a pulse at {at} that never began"));
        };
        let high = at.since(rise).units();
        let expected = u64::from(course.train.width) * UNITS_PER_TICK;
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
    /// It does not agree with what happened at the pin.
    pub(crate) fn message(&mut self, message: &DeviceToHost) -> Result<(), String> {
        match message {
            DeviceToHost::Pulse(pulse) if pulse.output.is_camera() => self.pulse(pulse),
            DeviceToHost::Imu(sample) => self.sample(sample),
            DeviceToHost::Capture(capture) => self.capture(capture),
            _ => Ok(()),
        }
    }

    fn pulse(&mut self, pulse: &Pulse) -> Result<(), String> {
        let Some(course) = self.courses.first() else {
            return Err(format!("a pulse without a train: {pulse:?}"));
        };
        let place = pulse.number.checked_sub(self.first);
        let at_pin = place.and_then(|place| self.edges.get(place as usize));
        let expected =
            at_pin.map_or_else(|| course.train.edge(pulse.number).ticks, |&at| Ticks(at));
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
        loop {
            let Some(record) = self.ready.pop_front() else {
                return Err(format!("{sample:?} has no data-ready edge"));
            };
            let at = captured(record.at, self.zero);
            if at != sample.at.0 {
                if at > sample.at.0 {
                    return Err(format!(
                        "{sample:?} has no data-ready edge; the next is at tick {at}"
                    ));
                }
                self.compared.samples_missing += 1;
                continue;
            }
            // Only the time of a sample marked as late is compared.
            if sample.flags.has(ImuFlags::LATE) {
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
        loop {
            let Some((at, level)) = self.strobe.pop_front() else {
                return Err(format!("{capture:?} has no edge at the pin"));
            };
            let at = captured(at, self.zero);
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

/// The tick that is captured of an edge at `at`, if tick 0 was at `zero` units: after the
/// input's synchroniser. The firmware takes the filter off.
pub(crate) fn captured(at: SimTime, zero: u64) -> u64 {
    at.units().saturating_sub(zero) / UNITS_PER_TICK + INPUT_SYNCHRONISER
}
