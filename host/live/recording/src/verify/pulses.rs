//! Checks that the pulses of the trigger lie on the grid of the alignment.

use super::GridCheck;
use super::fault::Fault;
use super::findings::Findings;
use crate::grid::FollowedGrid;
use crate::messages::{Pulse, TriggerPeriod};
use crate::session_file::SessionFile;
use protocol::Ticks;

/// The checks in progress.
#[derive(Default)]
pub(super) struct Pulses {
    /// The grid of the alignment; it follows the changes of the period.
    grid: Option<FollowedGrid>,
    /// First and last board time of the pulses that must lie on it.
    span: Option<(Ticks, Ticks)>,
    check: GridCheck,
}

impl Pulses {
    pub(super) fn new(session: Option<&SessionFile>) -> Self {
        let Some((session, alignment)) = session.and_then(|s| Some((s, s.alignment?))) else {
            return Self::default();
        };
        let closed = session.outcome.and(session.recorded);
        let from = alignment.arrival.unwrap_or(alignment.plan.anchor);
        Self {
            grid: Some(FollowedGrid::new(alignment.plan.grid())),
            span: Some((from, closed.map_or(Ticks(u64::MAX), |span| span.to))),
            ..Self::default()
        }
    }

    /// Changes the period of the grid from an edge on.
    pub(super) fn follow(&mut self, period: &TriggerPeriod) {
        if let Some(grid) = &mut self.grid {
            grid.follow(period.grid);
        }
    }

    pub(super) fn report(&self) -> Option<GridCheck> {
        self.grid.as_ref().map(|_| self.check)
    }

    pub(super) fn pulse(&mut self, pulse: &Pulse, findings: &mut Findings) {
        let at = Ticks(pulse.ticks);
        let (Some(grid), Some((from, to))) = (&self.grid, self.span) else {
            return;
        };
        if at < from || at > to {
            return;
        }
        let off = grid.off(at).0.unsigned_abs();
        self.check.checked += 1;
        if off != 0 {
            self.check.off += 1;
            self.check.worst_ticks = self.check.worst_ticks.max(off);
            let number = pulse.number;
            findings.add(&Fault::OffGrid { number, off }, Some(at));
        }
    }
}
