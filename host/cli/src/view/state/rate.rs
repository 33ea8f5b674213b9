//! Messages a second, and what is on the auxiliary outputs.

use std::collections::VecDeque;

use protocol::{TICK_HZ, Ticks, TrainState};

use super::shown::Sensor;

/// Rates are those over this time, ticks.
const RATE_TIME: u64 = 2 * TICK_HZ as u64;

/// Times of the messages of one stream, to count them.
#[derive(Clone, Debug, Default)]
pub(super) struct Rate(VecDeque<Ticks>);

impl Rate {
    pub(super) fn add(&mut self, at: Ticks) {
        self.0.push_back(at);
        drop_before(&mut self.0, at, RATE_TIME, |at| *at);
    }

    pub(super) fn per_second(&self, now: Ticks) -> f64 {
        let is_recent = |at: &&Ticks| now.0.saturating_sub(at.0) <= RATE_TIME;
        let mut recent = self.0.iter().filter(is_recent);
        let Some(first) = recent.next() else {
            return 0.0;
        };
        let (count, last) = recent.fold((0, first), |(count, _), at| (count + 1, at));
        if last.0 > first.0 {
            f64::from(count) * f64::from(TICK_HZ) / (last.0 - first.0) as f64
        } else {
            0.0
        }
    }
}

/// Drops the items from the front that are farther than `most` ticks from the latest.
pub(super) fn drop_before<T>(
    items: &mut VecDeque<T>,
    latest: Ticks,
    most: u64,
    time: fn(&T) -> Ticks,
) {
    while items
        .front()
        .is_some_and(|first| latest.0.abs_diff(time(first).0) > most)
    {
        items.pop_front();
    }
}

/// Place of the lidar among the sensors.
pub(super) const LIDAR: usize = 3;

/// Something on an auxiliary output, or the lidar.
#[derive(Clone, Debug, Default)]
pub(super) struct Connected {
    pub(super) name: Option<String>,
    pub(super) rate: Rate,
    pub(super) state: Option<TrainState>,
    pub(super) pulse: Option<u64>,
    pub(super) late: u32,
    pub(super) utc: Option<i64>,
}

impl Connected {
    /// Returns its shown form, unless it has no name, no pulses and does not run.
    pub(super) fn shown(&self, place: usize, now: Ticks) -> Option<Sensor> {
        let runs = self.state.is_some_and(|state| state != TrainState::Stopped);
        if self.name.is_none() && self.pulse.is_none() && !runs {
            return None;
        }
        let at = match place {
            LIDAR => String::from("gnss"),
            _ => format!("output {}", place + 2),
        };
        Some(Sensor {
            name: self.name.clone().unwrap_or_else(|| at.clone()),
            at,
            state: self.state.map_or("", state_word).to_owned(),
            rate: self.rate.per_second(now),
            pulse: self.pulse,
            late: self.late,
            utc: self.utc,
        })
    }
}

pub(super) const fn state_word(state: TrainState) -> &'static str {
    match state {
        TrainState::Stopped => "stopped",
        TrainState::Running => "running",
        TrainState::Slewing => "aligning",
        TrainState::Waiting => "waiting",
    }
}
