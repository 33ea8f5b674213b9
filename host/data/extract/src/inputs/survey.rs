//! The first pass over the board's recording: everything but the samples.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use crate::clocks::streams::each_event;
use crate::depth::depth_clock::PulseTime;
use crate::error::ExtractError;
use crate::inputs::board_data::{BoardEvent, Reference, TimePair};
use crate::time::{BoardNanos, SECOND, median_step};
use clock::ClockRelation;
use system::ReadMonitor;
use twist_sync::tracker::{Asked, Exchange};

/// Pulses, pairs of times and exchanges that are kept of any recording; 12 hours of a
/// camera's pulses are 1.3 million.
const EVENTS: u64 = 3_000_000;
/// Bytes of a longer recording to one more.
const BYTES_AN_EVENT: u64 = 64;
/// The most marks and names of sensors or phones that are read, and the longest name in
/// bytes.
const MARKS: usize = 1_000;
const NAMES: usize = 100;
const NAME_LENGTH: usize = 400;

/// Relations of phones' clocks to the board's, by the names of the phones.
pub(crate) type PhoneClocks = BTreeMap<Option<String>, ClockRelation>;

/// What the board recorded, in short.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Survey {
    /// Pulses in order of time, each once.
    pub(crate) pulses: Vec<PulseTime>,
    /// Marks.
    pub(crate) marks: Vec<BoardNanos>,
    /// Pairs of times.
    pub(crate) times: Vec<TimePair>,
    /// The last relation that was recorded of each phone; without a name, of the one
    /// that the trigger was aligned to.
    pub(crate) clocks: PhoneClocks,
    /// The IMU's samples.
    pub(crate) imu: ImuSpan,
    /// Exchanges with the clocks of the board and of the phone that was followed.
    pub(crate) exchanges: Vec<(Asked, Exchange)>,
    /// The recording is a bag of the published system.
    pub(crate) published: bool,
    /// What could not be read, in words.
    pub(crate) damage: Vec<String>,
}

/// The samples of an IMU in short.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ImuSpan {
    /// How many.
    pub samples: u64,
    /// Time of the first, ns.
    pub first_ns: i64,
    /// Time of the last, ns.
    pub last_ns: i64,
    /// Samples whose time is not after the one before.
    pub disordered: u64,
    /// Samples that the board has marked as late or at the end of their range.
    pub marked: u64,
}

impl ImuSpan {
    /// Takes a sample's time.
    pub(crate) fn add(&mut self, at: i64) {
        if self.samples == 0 {
            self.first_ns = at;
            self.last_ns = at;
        } else if at <= self.last_ns {
            self.disordered += 1;
        } else {
            self.last_ns = at;
        }
        self.samples += 1;
    }

    /// Samples a second; `None` with fewer than two.
    pub(crate) fn rate(&self) -> Option<f64> {
        let span = self.last_ns.saturating_sub(self.first_ns);
        (self.samples > 1 && span > 0)
            .then(|| (self.samples - 1) as f64 * SECOND as f64 / span as f64)
    }
}

impl Survey {
    /// Median distance of pulses, ns.
    pub(crate) fn pulse_period(&self) -> Option<i64> {
        median_step(self.pulses.iter().map(|pulse| pulse.at.0))
    }

    /// Pulses that are missing within a train: (train, first number, how many).
    pub(crate) fn missing_pulses(&self) -> impl Iterator<Item = (u32, u64, u64)> {
        let step = |pair: &[PulseTime]| {
            let same = pair[0].train == pair[1].train;
            let gap = pair[1].number.checked_sub(pair[0].number)?;
            (same && gap > 1).then(|| (pair[0].train, pair[0].number + 1, gap - 1))
        };
        self.pulses.windows(2).filter_map(step)
    }
}

/// What is kept of a recording of a given length, so that no file costs more memory than
/// a multiple of its own length.
struct Keeper {
    out: Survey,
    /// Pulses and pairs that are still taken.
    room: u64,
    /// Names of the sensors on auxiliary outputs.
    outputs: BTreeSet<Arc<str>>,
    left_out: BTreeMap<&'static str, u64>,
}

impl Keeper {
    fn new(length: u64) -> Self {
        Self {
            out: Survey::default(),
            room: EVENTS.max(length / BYTES_AN_EVENT),
            outputs: BTreeSet::new(),
            left_out: BTreeMap::new(),
        }
    }

    fn take(&mut self, event: BoardEvent) {
        let out = &mut self.out;
        match event {
            BoardEvent::Imu(row) => out.imu.add(row.at.0),
            BoardEvent::Marked(_) => out.imu.marked += 1,
            BoardEvent::Published => out.published = true,
            BoardEvent::Pulse(_) | BoardEvent::Times(_) | BoardEvent::Exchange(..)
                if self.room == 0 =>
            {
                self.leave_out(
                    "pulses, pairs of times and exchanges are more than a recording of its length holds",
                );
            }
            BoardEvent::Exchange(asked, exchange) => {
                self.room -= 1;
                out.exchanges.push((asked, exchange));
            }
            BoardEvent::Pulse(pulse) => {
                self.room -= 1;
                out.pulses.push(pulse);
            }
            BoardEvent::Times(pair) => match self.known(&pair.of) {
                Some(of) => {
                    self.room -= 1;
                    self.out.times.push(TimePair { of, ..pair });
                }
                None => self.leave_out("pulses are of an output beyond the 100 that are read"),
            },
            BoardEvent::Mark(at) if out.marks.len() < MARKS => out.marks.push(at),
            BoardEvent::Mark(_) => self.leave_out("marks are beyond the 1000 that are read"),
            BoardEvent::Clock(phone, model) => {
                let name = phone.as_deref().unwrap_or_default();
                let is_known = out.clocks.contains_key(&phone);
                if is_known || out.clocks.len() < NAMES && name.len() <= NAME_LENGTH {
                    out.clocks.insert(phone, model);
                } else {
                    self.leave_out("clock models are of a phone beyond the 100 that are read");
                }
            }
        }
    }

    /// The same, with the one copy of an output's name that all its pairs share.
    fn known(&mut self, of: &Reference) -> Option<Reference> {
        let Reference::Output(name) = of else {
            return Some(of.clone());
        };
        if let Some(known) = self.outputs.get(name) {
            return Some(Reference::Output(Arc::clone(known)));
        }
        let has_room = self.outputs.len() < NAMES && name.len() <= NAME_LENGTH;
        has_room.then(|| {
            self.outputs.insert(Arc::clone(name));
            of.clone()
        })
    }

    fn leave_out(&mut self, what: &'static str) {
        *self.left_out.entry(what).or_default() += 1;
    }
}

/// Reads the recording once.
///
/// # Errors
///
/// The recording cannot be read.
pub(crate) fn survey(board: &Path, monitor: &ReadMonitor) -> Result<Survey, ExtractError> {
    let length = std::fs::metadata(board).map_or(0, |meta| meta.len());
    let mut keeper = Keeper::new(length);
    let mut damage = each_event(board, monitor, |event| {
        keeper.take(event);
        Ok(())
    })?;
    let left_out = keeper.left_out.iter();
    damage.extend(left_out.map(|(what, count)| format!("left out: {count} {what}")));
    let mut out = keeper.out;
    out.damage = damage;
    out.pulses.sort_by_key(|pulse| (pulse.at, pulse.number));
    out.pulses.dedup_by_key(|pulse| (pulse.train, pulse.number));
    Ok(out)
}
