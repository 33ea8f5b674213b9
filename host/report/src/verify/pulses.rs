//! The pulses of the trigger: numbers without a gap, on the grid of the alignment.

use protocol::{TICK_HZ, Ticks};
use recording::diagnostics::BoardCounters;
use recording::finding::Severity;
use recording::grid::{FollowedGrid, Grid};
use recording::messages::{Pulse, TriggerPeriod};
use recording::session_file::SessionFile;

use super::{Findings, GridReport};

/// Time from an edge to its being counted, at most: far longer than an interrupt waits.
const COUNTED_WITHIN: u64 = TICK_HZ as u64 / 1000;

/// Whether a status of `at` that counts `made` pulses should have counted this one. Pulses
/// are sent before a status that waits, so one that came first may be younger than it.
const fn is_uncounted(pulse: &Pulse, made: u64, at: Ticks) -> bool {
    pulse.number >= made && pulse.ticks.saturating_add(COUNTED_WITHIN) <= at.0
}

/// The checks of the pulses while they run.
#[derive(Default)]
pub(super) struct Pulses {
    /// The grid of the alignment, from change to change of the period.
    grid: Option<FollowedGrid>,
    /// What is held against it.
    held: Option<(Ticks, Ticks)>,
    report: GridReport,
    last: Option<Pulse>,
}

impl Pulses {
    pub(super) fn new(session: Option<&SessionFile>) -> Self {
        let Some((session, alignment)) = session.and_then(|s| Some((s, s.alignment?))) else {
            return Self::default();
        };
        let closed = session.outcome.and(session.recorded);
        let from = alignment.arrival.unwrap_or(alignment.anchor);
        Self {
            grid: Some(FollowedGrid::new(Grid::from(&alignment))),
            held: Some((from, closed.map_or(Ticks(u64::MAX), |span| span.to))),
            ..Self::default()
        }
    }

    /// The trigger has another period from an edge on.
    pub(super) fn follow(&mut self, period: &TriggerPeriod) {
        if let Some(grid) = &mut self.grid {
            grid.follow(period.into());
        }
    }

    /// Something is missing here: what follows is not compared with what was before.
    pub(super) fn forget(&mut self) {
        self.last = None;
    }

    /// The pulses that were made against those that came.
    pub(super) fn count(&self, counters: &BoardCounters, at: Ticks, findings: &mut Findings) {
        let (train, made) = (counters.train, counters.pulses);
        if let Some(pulse) = self.last.as_ref().filter(|pulse| pulse.train == train)
            && is_uncounted(pulse, made, at)
        {
            findings.bad("pulse_count", Some(at), || {
                format!("pulse {} came, but the board counts {made}", pulse.number)
            });
        }
    }

    pub(super) fn report(&self) -> Option<GridReport> {
        self.grid.as_ref().map(|_| self.report)
    }

    pub(super) fn pulse(&mut self, pulse: &Pulse, findings: &mut Findings) {
        let at = Ticks(pulse.ticks);
        let last = self.last.replace(pulse.clone());
        if let Some(last) = last.filter(|last| last.train == pulse.train) {
            step(&last, pulse, findings);
        }
        let (Some(grid), Some((from, to))) = (&self.grid, self.held) else {
            return;
        };
        if at < from || at > to {
            return;
        }
        let off = grid.off(at).0.unsigned_abs();
        self.report.checked += 1;
        if off != 0 {
            self.report.off += 1;
            self.report.worst_ticks = self.report.worst_ticks.max(off);
            findings.bad("off_grid", Some(at), || {
                let number = pulse.number;
                format!("pulse {number} is {off} ticks off the grid of the alignment")
            });
        }
    }
}

/// The step from one pulse of a train to the next that came.
fn step(last: &Pulse, pulse: &Pulse, findings: &mut Findings) {
    let (at, number) = (Some(Ticks(pulse.ticks)), pulse.number);
    let step = number.wrapping_sub(last.number);
    if step == 0 || step > u64::MAX / 2 {
        findings.bad("pulse_twice", at, || {
            format!("pulse {number} comes after {}", last.number)
        });
    } else if step > 1 {
        let count = step - 1;
        findings.add(Severity::Check, "pulses_missing", (at, count), || {
            format!("{count} pulses are missing before pulse {number}")
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_younger_than_the_status_behind_it_need_not_be_counted() {
        let pulse = Pulse {
            header: recording::messages::Header::default(),
            ticks: 480_000,
            train: 1,
            number: 2_203,
            aligned: true,
            readback: false,
            readback_ticks: 0,
        };
        let later = Ticks(480_000 + COUNTED_WITHIN);
        assert!(is_uncounted(&pulse, 2_203, later));
        assert!(!is_uncounted(&pulse, 2_204, later));
        assert!(!is_uncounted(&pulse, 2_203, Ticks(479_999)));
    }
}
