//! First pass over the board's recording: everything except the samples.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use crate::clocks::streams::each_event;
use crate::depth::depth_clock::PulseTime;
use crate::error::ExtractError;
use crate::inputs::board_data::{BoardEvent, Reference, TimePair};
use crate::time::{BoardNanos, SECOND, median_step};
use clock::ClockRelation;
use clock::tracker::{Asked, Exchange};
use recording::strobes::{ExposureFinder, SeenExposure, SeenExposures, StrobeTrain};
use system::ReadMonitor;

/// Number of pulses, pairs of times and exchanges that are kept of any recording; 12 hours of
/// pulses at 30 Hz are 1.3 million.
const EVENTS: u64 = 3_000_000;
/// Bytes of a longer recording for each additional one.
const BYTES_AN_EVENT: u64 = 64;
/// Largest number of marks.
const MARKS: usize = 1_000;
/// Largest number of names of sensors, and of phones.
const NAMES: usize = 100;
/// Longest name, bytes.
const NAME_LENGTH: usize = 400;

/// Relations of phones' clocks to the board's, by the names of the phones.
pub(crate) type PhoneClocks = BTreeMap<Option<String>, ClockRelation>;

/// Everything that the board recorded, with a summary of its samples.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Survey {
    /// Pulses in order of time, each once.
    pub(crate) pulses: Vec<PulseTime>,
    /// Exposures that a photodiode saw, with their statistics; `None` if it saw none.
    pub(crate) exposures: Option<(SeenExposures, Vec<SeenExposure>)>,
    /// Times of the marks.
    pub(crate) marks: Vec<BoardNanos>,
    /// Pairs of times.
    pub(crate) times: Vec<TimePair>,
    /// Last recorded relation of each phone's clock; without a name, that of the phone
    /// that the trigger was aligned to.
    pub(crate) clocks: PhoneClocks,
    /// Summary of the IMU's samples.
    pub(crate) imu: ImuSpan,
    /// Exchanges with the clocks of the board and of the phone that the trigger follows.
    pub(crate) exchanges: Vec<(Asked, Exchange)>,
    /// True if the recording is a bag of the published system.
    pub(crate) published: bool,
    /// Descriptions of messages that were left out.
    pub(crate) left_out: Vec<String>,
}

/// Summary of an IMU's samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ImuSpan {
    /// Number of samples.
    pub samples: u64,
    /// Time of the first, ns.
    pub first_ns: i64,
    /// Time of the last, ns.
    pub last_ns: i64,
    /// Number of samples that are not later than the one before.
    pub disordered: u64,
    /// Number of samples that the board marked as late or at the end of their range.
    pub marked: u64,
}

impl ImuSpan {
    /// Adds a sample by its time, ns.
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

    /// Returns the mean rate, Hz; `None` for fewer than two samples.
    pub(crate) fn rate(&self) -> Option<f64> {
        let span = self.last_ns.saturating_sub(self.first_ns);
        (self.samples > 1 && span > 0)
            .then(|| (self.samples - 1) as f64 * SECOND as f64 / span as f64)
    }
}

impl Survey {
    /// Returns the median distance of pulses, ns.
    pub(crate) fn pulse_period(&self) -> Option<i64> {
        median_step(self.pulses.iter().map(|pulse| pulse.at.0))
    }

    /// Returns the gaps within trains: (train, first missing number, count).
    pub(crate) fn missing_pulses(&self) -> impl Iterator<Item = (u32, u64, u64)> {
        let step = |pair: &[PulseTime]| {
            let same = pair[0].train == pair[1].train;
            let gap = pair[1].number.checked_sub(pair[0].number)?;
            (same && gap > 1).then(|| (pair[0].train, pair[0].number + 1, gap - 1))
        };
        self.pulses.windows(2).filter_map(step)
    }
}

/// Collects a survey within limits, so that no file takes more memory than
/// a multiple of its length.
struct Collector {
    out: Survey,
    finder: ExposureFinder,
    /// Number of pulses, pairs and exchanges that may still be added.
    room: u64,
    /// Names of the sensors on auxiliary outputs.
    outputs: BTreeSet<Arc<str>>,
    left_out: BTreeMap<&'static str, u64>,
}

impl Collector {
    fn new(length: u64, train: Option<StrobeTrain>) -> Self {
        Self {
            out: Survey::default(),
            finder: ExposureFinder::new(train),
            room: EVENTS.max(length / BYTES_AN_EVENT),
            outputs: BTreeSet::new(),
            left_out: BTreeMap::new(),
        }
    }

    /// Adds an event.
    fn add(&mut self, event: BoardEvent) {
        let out = &mut self.out;
        match event {
            BoardEvent::Sample(sample) => {
                out.imu.add(sample.stamp.nanos());
                out.imu.marked += u64::from(sample.is_marked);
            }
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
                self.finder.pulse(pulse.at.ticks());
                out.pulses.push(pulse);
            }
            BoardEvent::Strobe(edge) => self.finder.edge(edge),
            BoardEvent::Times(pair) => match self.shared(&pair.of) {
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

    /// Returns the same reference with a name that all pairs of an output share; `None` beyond
    /// the limits.
    fn shared(&mut self, of: &Reference) -> Option<Reference> {
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

    /// Counts an event that is left out.
    fn leave_out(&mut self, what: &'static str) {
        *self.left_out.entry(what).or_default() += 1;
    }
}

/// Surveys a recording of a depth camera with these flashes.
///
/// # Errors
///
/// Fails if the recording cannot be read.
pub(crate) fn survey(
    board: &Path,
    train: Option<StrobeTrain>,
    monitor: &ReadMonitor,
) -> Result<Survey, ExtractError> {
    let length = std::fs::metadata(board).map_or(0, |meta| meta.len());
    let mut collector = Collector::new(length, train);
    let mut words = each_event(board, monitor, |event| {
        collector.add(event);
        Ok(())
    })?;
    let left_out = collector.left_out.iter();
    words.extend(left_out.map(|(what, count)| format!("left out: {count} {what}")));
    let mut out = collector.out;
    out.left_out = words;
    out.exposures = collector.finder.finish().ok();
    out.pulses.sort_by_key(|pulse| (pulse.at, pulse.number));
    out.pulses.dedup_by_key(|pulse| (pulse.train, pulse.number));
    Ok(out)
}
