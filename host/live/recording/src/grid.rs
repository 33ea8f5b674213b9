//! Grid of the trigger's pulses while its period changes.

use protocol::{EdgeGrid, TickDelta, Ticks};

/// A grid whose period changes while the trigger runs.
#[derive(Clone, Copy, Debug)]
pub struct FollowedGrid {
    last: EdgeGrid,
    /// The grid before the last one, for pulses before its anchor.
    before: Option<EdgeGrid>,
}

impl FollowedGrid {
    /// Creates a grid that has not changed yet.
    #[must_use]
    pub const fn new(grid: EdgeGrid) -> Self {
        Self {
            last: grid,
            before: None,
        }
    }

    /// Returns the grid since the last change.
    #[must_use]
    pub const fn last(&self) -> EdgeGrid {
        self.last
    }

    /// Changes to another grid from the anchor of that grid on.
    pub const fn follow(&mut self, grid: EdgeGrid) {
        self.before = Some(self.last);
        self.last = grid;
    }

    /// Returns the distance of a pulse from the grid of its time, ticks; late is positive.
    #[must_use]
    pub fn off(&self, at: Ticks) -> TickDelta {
        let grid = match self.before {
            Some(before) if at < self.last.anchor.ticks => before,
            _ => self.last,
        };
        grid.phase_error(at)
    }
}

#[cfg(test)]
mod tests {
    use protocol::Period;

    use super::*;

    #[test]
    fn a_pulse_is_compared_with_the_grid_of_its_time() {
        let grid = |anchor, period| EdgeGrid::new(Ticks(anchor), Period::from_ticks(period));
        let mut followed = FollowedGrid::new(grid(1_000, 100));
        followed.follow(grid(2_000, 110));
        followed.follow(grid(3_100, 120));
        for (at, off) in [(3_100, 0), (3_220, 0), (3_210, -10), (2_990, 0), (2_880, 0)] {
            assert_eq!(followed.off(Ticks(at)), TickDelta(off), "{at}");
        }
        assert_eq!(followed.last(), grid(3_100, 120));
    }
}
