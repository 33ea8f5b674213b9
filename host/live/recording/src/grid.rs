//! The grid that the trigger's pulses are on.

pub use clock::steering::Grid;
use protocol::{Period, TickDelta, Ticks};

use super::messages::TriggerPeriod;
use super::session_file::Alignment;

impl From<&Alignment> for Grid {
    fn from(alignment: &Alignment) -> Self {
        Self {
            anchor: alignment.plan.anchor,
            fraction: 0,
            period: Period(alignment.plan.period_q32),
        }
    }
}

impl From<&TriggerPeriod> for Grid {
    fn from(period: &TriggerPeriod) -> Self {
        Self {
            anchor: Ticks(period.ticks),
            fraction: period.fraction,
            period: Period(period.period_q32),
        }
    }
}

/// A grid whose period changes while the trigger runs.
#[derive(Clone, Copy, Debug)]
pub struct FollowedGrid {
    last: Grid,
    /// The grid before the last one, for pulses before its anchor.
    before: Option<Grid>,
}

impl FollowedGrid {
    /// A grid that has not changed yet.
    #[must_use]
    pub const fn new(grid: Grid) -> Self {
        Self {
            last: grid,
            before: None,
        }
    }

    /// The grid since the last change.
    #[must_use]
    pub const fn last(&self) -> Grid {
        self.last
    }

    /// From its anchor on the train is on another grid.
    pub const fn follow(&mut self, grid: Grid) {
        self.before = Some(self.last);
        self.last = grid;
    }

    /// How far a pulse is off the grid that held then, in ticks; late is positive.
    #[must_use]
    pub fn off(&self, at: Ticks) -> TickDelta {
        let grid = match self.before {
            Some(before) if at < self.last.anchor => before,
            _ => self.last,
        };
        grid.period.phase_error_of(grid.anchor, grid.fraction, at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_is_held_against_the_grid_of_its_time() {
        let grid = |anchor, period| Grid {
            anchor: Ticks(anchor),
            fraction: 0,
            period: Period::from_ticks(period),
        };
        let mut followed = FollowedGrid::new(grid(1_000, 100));
        followed.follow(grid(2_000, 110));
        followed.follow(grid(3_100, 120));
        for (at, off) in [(3_100, 0), (3_220, 0), (3_210, -10), (2_990, 0), (2_880, 0)] {
            assert_eq!(followed.off(Ticks(at)), TickDelta(off), "{at}");
        }
        assert_eq!(followed.last(), grid(3_100, 120));
    }
}
