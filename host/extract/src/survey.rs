//! The first pass over the board's recording: everything but the samples.

use std::collections::BTreeMap;

use super::board_data::{BoardEvent, BoardInput, Images, TimePair};
use super::depth_clock::PulseTime;
use super::later_runs::RunMark;
use super::progress::Progress;
use super::streams::{Stopped, each_event};
use super::time::{BoardNanos, SECOND};
use timebase::ClockModel;

/// Relations of phones' clocks to the board's, by the names of the phones.
pub(crate) type PhoneClocks = BTreeMap<Option<String>, ClockModel>;

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
    /// Runs of the board after resets.
    pub(crate) runs: Vec<RunMark>,
    /// The same of each run that another followed.
    pub(crate) former_clocks: Vec<PhoneClocks>,
    /// The IMU's samples.
    pub(crate) imu: ImuSpan,
    /// Depth images in the recording itself (bags).
    pub(crate) images: u64,
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
    /// Samples whose time does not lie behind the one before.
    pub disordered: u64,
    /// Longest distance of two samples, ns.
    pub longest_gap_ns: i64,
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
            self.longest_gap_ns = self.longest_gap_ns.max(at.saturating_sub(self.last_ns));
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
    /// The last clock model that was known in each run of the board: of the phone of
    /// that name; without one, of the phone that the trigger was aligned to.
    pub(crate) fn clocks_of(&self, other: Option<&str>) -> Vec<Option<ClockModel>> {
        let phone = other.map(str::to_owned);
        let runs = self.former_clocks.iter().chain([&self.clocks]);
        runs.map(|known| known.get(&phone).copied()).collect()
    }

    /// Median distance of pulses, ns.
    pub(crate) fn pulse_period(&self) -> Option<i64> {
        let mut steps: Vec<i64> = self
            .pulses
            .windows(2)
            .map(|pair| pair[1].at.0.saturating_sub(pair[0].at.0))
            .collect();
        if steps.is_empty() {
            return None;
        }
        let middle = steps.len() / 2;
        Some(*steps.select_nth_unstable(middle).1)
    }

    /// Pulses that are missing within a train: (train, first number, how many).
    pub(crate) fn missing_pulses(&self) -> Vec<(u32, u64, u64)> {
        let step = |pair: &[PulseTime]| {
            let same = pair[0].train == pair[1].train;
            let gap = pair[1].number.checked_sub(pair[0].number)?;
            (same && gap > 1).then(|| (pair[0].train, pair[0].number + 1, gap - 1))
        };
        self.pulses.windows(2).filter_map(step).collect()
    }
}

/// Reads the recording once.
///
/// # Errors
///
/// Stopped, or the recording cannot be read.
pub(crate) fn survey(input: &BoardInput, progress: &dyn Progress) -> Result<Survey, Stopped> {
    let mut out = Survey::default();
    let what = "reading the board's recording";
    out.damage = each_event(input, Images::Stamps, what, progress, |event| {
        match event {
            BoardEvent::Imu(row) => out.imu.add(row.at.0),
            BoardEvent::Pulse(pulse) => out.pulses.push(pulse),
            BoardEvent::Mark(at) => out.marks.push(at),
            BoardEvent::Times(pair) => out.times.push(pair),
            BoardEvent::Clock(phone, model) => {
                out.clocks.insert(phone, model);
            }
            BoardEvent::Image(_) => out.images += 1,
            BoardEvent::Run(mark) => {
                out.runs.push(mark);
                out.former_clocks.push(out.clocks.clone());
            }
        }
        Ok::<(), Stopped>(())
    })?;
    out.pulses.sort_by_key(|pulse| (pulse.at, pulse.number));
    out.pulses.dedup_by_key(|pulse| (pulse.train, pulse.number));
    Ok(out)
}
