//! The arrival of a train on its grid, which an align has planned.

use protocol::{AlignPlan, TICK_HZ, Ticks, TrainState, TriggerStatus};

/// How much longer than planned it may take to be reported, ticks.
const MARGIN: u64 = 3 * TICK_HZ as u64;

/// When a train is to be on its grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlannedArrival {
    /// The first pulse on the grid.
    pub(crate) pulse: u64,
    /// Its time.
    pub(crate) at: Ticks,
}

impl From<&AlignPlan> for PlannedArrival {
    fn from(plan: &AlignPlan) -> Self {
        Self {
            pulse: plan.arrival_pulse,
            at: plan.arrival,
        }
    }
}

impl PlannedArrival {
    /// Whether the board should have reported it by now.
    pub(crate) const fn is_overdue(&self, now: Ticks) -> bool {
        now.0 > self.at.0.saturating_add(MARGIN)
    }

    /// Whether the train is on its grid: the report may have been lost on the link, the
    /// state of the train was not.
    pub(crate) fn has_come(&self, train: &TriggerStatus) -> bool {
        train.state == TrainState::Running && train.pulses > self.pulse
    }
}
