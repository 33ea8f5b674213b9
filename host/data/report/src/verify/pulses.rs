//! The pulses of the trigger on the grid of the alignment.

use protocol::Ticks;
use recording::grid::{FollowedGrid, Grid};
use recording::messages::{Pulse, TriggerPeriod};
use recording::session_file::SessionFile;

use super::{Findings, GridReport};

/// The checks of the pulses while they run.
#[derive(Default)]
pub(super) struct Pulses {
    /// The grid of the alignment, from change to change of the period.
    grid: Option<FollowedGrid>,
    /// What is held against it.
    held: Option<(Ticks, Ticks)>,
    report: GridReport,
}

impl Pulses {
    pub(super) fn new(session: Option<&SessionFile>) -> Self {
        let Some((session, alignment)) = session.and_then(|s| Some((s, s.alignment?))) else {
            return Self::default();
        };
        let closed = session.outcome.and(session.recorded);
        let from = alignment.arrival.unwrap_or(alignment.plan.anchor);
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

    pub(super) fn report(&self) -> Option<GridReport> {
        self.grid.as_ref().map(|_| self.report)
    }

    pub(super) fn pulse(&mut self, pulse: &Pulse, findings: &mut Findings) {
        let at = Ticks(pulse.ticks);
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
