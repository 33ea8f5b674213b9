//! The pulses of the trigger: numbers without a gap, on the grid of the alignment.

use protocol::{Status, Ticks};

use crate::verify::{Findings, Grade, GridReport};
use recording::grid::{FollowedGrid, Grid};
use recording::messages::{Pulse, TriggerPeriod};
use recording::session_file::{Alignment, SessionFile};

/// The last pulse.
#[derive(Clone, Copy)]
struct LastPulse {
    train: u32,
    number: u64,
    at: Ticks,
    aligned: bool,
}

/// Time from an edge to its being counted, at most: far longer than an interrupt waits.
const COUNTED_WITHIN: u64 = protocol::TICK_HZ as u64 / 1000;

impl LastPulse {
    /// Whether a status of `at` that counts `made` pulses should have counted this one.
    /// Pulses are sent before a status that waits, so one that came first may be younger
    /// than it.
    const fn is_uncounted(&self, made: u64, at: Ticks) -> bool {
        self.number >= made && self.at.0.saturating_add(COUNTED_WITHIN) <= at.0
    }
}

/// The checks of the pulses while they run.
pub(super) struct Pulses {
    alignment: Option<Alignment>,
    /// The end of what was recorded, by the session file.
    session_to: Option<Ticks>,
    /// Later pulses are not held against the grid.
    recorded_to: Option<Ticks>,
    last: Option<LastPulse>,
    /// The shortest and the longest step on a grid that is not known, ticks.
    steps: Option<(u64, u64)>,
    grid: GridReport,
    /// That of the alignment, from change to change of the period.
    followed: Option<FollowedGrid>,
}

fn followed(alignment: &Alignment) -> FollowedGrid {
    FollowedGrid::new(Grid::from(alignment))
}

impl Pulses {
    pub(super) fn new(session: Option<&SessionFile>) -> Self {
        let recorded_to = session
            .filter(|session| session.outcome.is_some())
            .and_then(|session| session.recorded)
            .map(|span| span.to);
        let alignment = session.and_then(|session| session.alignment);
        Self {
            alignment,
            session_to: recorded_to,
            recorded_to,
            last: None,
            steps: None,
            grid: GridReport::default(),
            followed: alignment.as_ref().map(followed),
        }
    }

    /// The trigger has another period from an edge on.
    pub(super) fn follow(&mut self, period: &TriggerPeriod) {
        if let Some(followed) = &mut self.followed {
            followed.follow(period.into());
        }
    }

    /// Something is missing here: what follows is not compared with what was before.
    pub(super) fn forget(&mut self) {
        self.last = None;
        self.steps = None;
    }

    /// The board was reset: the alignment in the session file is of one run only.
    pub(super) fn begin_run(&mut self) {
        self.forget();
        self.followed = self.alignment.as_ref().map(followed);
        self.recorded_to = Some(Ticks(0));
    }

    /// The grid of a later run begins anew, with the session file's word for it.
    pub(super) fn realign(&mut self, anchor: Option<Ticks>) {
        if let (Some(alignment), Some(anchor)) = (&mut self.alignment, anchor) {
            alignment.anchor = anchor;
            alignment.arrival = Some(anchor);
            self.followed = Some(followed(alignment));
            self.recorded_to = self.session_to;
        } else {
            self.recorded_to = Some(Ticks(0));
        }
    }

    /// The pulses that were made against those that came.
    pub(super) fn count(&self, status: &Status, findings: &mut Findings) {
        if let Some(pulse) = self.last
            && pulse.train == status.trigger.train
        {
            let made = status.trigger.pulses;
            if pulse.is_uncounted(made, status.at) {
                findings.add(Grade::Error, "pulse_count", Some(status.at), || {
                    format!("pulse {} came, but the board counts {made}", pulse.number)
                });
            }
        }
    }

    pub(super) fn report(&self) -> Option<GridReport> {
        self.alignment.map(|_| self.grid)
    }

    pub(super) fn pulse(&mut self, pulse: &Pulse, findings: &mut Findings) {
        let at = Ticks(pulse.ticks);
        let now = LastPulse {
            train: pulse.train,
            number: pulse.number,
            at,
            aligned: pulse.aligned,
        };
        if let Some(last) = self.last.replace(now)
            && last.train == pulse.train
        {
            let step = pulse.number.wrapping_sub(last.number);
            if step == 0 || step > u64::MAX / 2 {
                findings.add(Grade::Error, "pulse_twice", Some(at), || {
                    format!("pulse {} comes after {}", pulse.number, last.number)
                });
            } else if step > 1 {
                findings.add_many(Grade::Warning, "pulses_missing", Some(at), step - 1, || {
                    format!(
                        "{} pulses are missing before pulse {}",
                        step - 1,
                        pulse.number
                    )
                });
            }
            self.step(last, now, step, findings);
        } else {
            self.steps = None;
        }
        self.hold_against_grid(pulse, at, findings);
    }

    /// Without a known grid: steps of a train on its grid differ by a tick at most.
    fn step(&mut self, last: LastPulse, now: LastPulse, step: u64, findings: &mut Findings) {
        if self.alignment.is_some() || step != 1 || !last.aligned || !now.aligned {
            self.steps = None;
            return;
        }
        let length = now.at.0.saturating_sub(last.at.0);
        let (low, high) = self.steps.map_or((length, length), |(low, high)| {
            (low.min(length), high.max(length))
        });
        if high - low > 1 {
            findings.add(Grade::Error, "grid", Some(now.at), || {
                format!(
                    "pulse {} comes {length} ticks after the one before, others {low} to {high}",
                    now.number
                )
            });
            self.steps = None;
        } else {
            self.steps = Some((low, high));
        }
    }

    fn hold_against_grid(&mut self, pulse: &Pulse, at: Ticks, findings: &mut Findings) {
        let (Some(alignment), Some(followed)) = (self.alignment, self.followed) else {
            return;
        };
        let arrived = alignment.arrival.unwrap_or(alignment.anchor);
        if at < arrived || self.recorded_to.is_some_and(|to| at > to) {
            return;
        }
        let off = followed.off(at).0.unsigned_abs();
        self.grid.checked += 1;
        if off != 0 {
            self.grid.off += 1;
            self.grid.worst_ticks = self.grid.worst_ticks.max(off);
            findings.add(Grade::Error, "off_grid", Some(at), || {
                format!(
                    "pulse {} is {off} ticks off the grid of the alignment",
                    pulse.number
                )
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_younger_than_the_status_behind_it_need_not_be_counted() {
        let pulse = LastPulse {
            train: 1,
            number: 2_203,
            at: Ticks(480_000),
            aligned: true,
        };
        let later = Ticks(480_000 + COUNTED_WITHIN);
        assert!(pulse.is_uncounted(2_203, later));
        assert!(!pulse.is_uncounted(2_204, later));
        assert!(!pulse.is_uncounted(2_203, Ticks(479_999)));
    }
}
