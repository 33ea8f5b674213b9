//! The trigger's period while the phone's clock is tracked.
//!
//! After the alignment the grid of the trigger has a constant period, and drifts
//! as the rate of the clocks was wrong or changes. Where the relation of the clocks is
//! tracked ([`crate::tracker`]), the period follows instead:
//!
//! ```text
//! wanted, phone's time   w(n) = phone(anchor) + n · frame period
//! phase                  φ    = phone(edge n) − w(n)              by the tracked relation
//! next period            p    = frame period / (1 + rate) · (1 − φ / CATCH_UP_S)
//! ```
//!
//! A step changes the period at an edge that is on the old grid and on the new one: the phase does
//! not jump. The change is bounded in ppm a second and in ppm of the alignment's period, so
//! that the depth camera never sees more than that, whatever the tracker estimates.
//!
//! The frame period in the phone's time is not estimated here: an error of 1 ppb makes 3.6 µs
//! an hour.

use crate::tracker::{Asked, Tracker};
use protocol::{EdgeGrid, EdgeTime, Period, TICK_HZ, Ticks};

use crate::alignment::GridPlan;
use crate::{BoardSeconds, BoardToPhone, ClockRelation, PhoneSeconds};

/// Time constant with which a phase is corrected, s.
const CATCH_UP_S: f64 = 10.0;

/// Largest relative change of the period in a second. A crystal that warms up by 5 ppm in
/// ten minutes moves by 0.04 ppm a second at most.
const MOST_A_SECOND: f64 = 0.2e-6;

/// Largest relative difference from the alignment's period.
const MOST_AWAY: f64 = 50e-6;

/// Time between two steps of the period, s.
pub const STEP_EVERY_S: f64 = 2.0;

/// The connection to the phone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// A cable.
    Usb,
    /// A network.
    Network,
}

impl Link {
    /// Returns the time without an exchange after which the phone's clock counts as lost, s.
    #[must_use]
    pub const fn patience_s(self) -> f64 {
        match self {
            Self::Usb => 6.0,
            Self::Network => 20.0,
        }
    }
}

/// Returns true if both clocks have answered recently, at `computer` seconds of the computer's clock.
#[must_use]
pub fn has_lock(tracker: &Tracker, link: Link, computer: f64) -> bool {
    [Asked::A, Asked::B].into_iter().all(|clock| {
        let last = tracker.last_window(clock);
        last.is_some_and(|last| computer - last <= link.patience_s())
    })
}

/// The trigger's grid against the phone's frames.
#[derive(Clone, Debug)]
pub struct Steering {
    plan: GridPlan,
    /// Phone's time at the anchor of the plan.
    begin: PhoneSeconds,
    /// Phone's time from one wanted edge to the next, s.
    frame_s: f64,
    /// Present grid of the trigger.
    grid: EdgeGrid,
    /// Number of edges from the anchor of the plan to that of the grid.
    number: u64,
}

impl Steering {
    /// Starts on a planned grid, with `ratio` phone frames to a depth frame.
    #[must_use]
    pub fn new(plan: &GridPlan, ratio: u32) -> Self {
        Self {
            plan: *plan,
            begin: plan.clock.to_phone(plan.anchor.into()),
            frame_s: plan.frames.period_ns * 1e-9 * f64::from(ratio),
            grid: plan.grid(),
            number: 0,
        }
    }

    /// Returns the first edge of the grid that is not before `at`, with its number from the
    /// anchor of the plan.
    #[must_use]
    pub fn edge_from(&self, at: Ticks) -> (u64, EdgeTime) {
        let (count, edge) = self.grid.first_from(at);
        (self.number.saturating_add(count), edge)
    }

    /// Returns the delay of the grid against the phone's frames at `at`, s, by a tracked relation of
    /// the clocks.
    #[must_use]
    pub fn phase_s(&self, clock: &ClockRelation, at: Ticks) -> f64 {
        let (number, edge) = self.edge_from(at);
        let at = clock.to_phone(BoardSeconds(edge.as_secs_f64()));
        (at.0 - self.begin.0) - number as f64 * self.frame_s
    }

    /// Returns the 1-sigma of the phase at a time, µs, by a tracked relation: that of its offset,
    /// of the first frame's time, and of the frame period since.
    #[must_use]
    pub fn phase_sigma_us(&self, clock: &ClockRelation, at: BoardSeconds) -> f64 {
        let offset_us = clock.offset_at(at.0).sigma * 1e6;
        offset_us.hypot(self.plan.frames_sigma_us(at))
    }

    /// Returns the present period.
    #[must_use]
    pub const fn period(&self) -> Period {
        self.grid.period
    }

    /// Returns the period to set now, `since_s` seconds after the last one was set; `None` if it
    /// stays.
    #[must_use]
    pub fn wanted(&self, clock: &ClockRelation, at: Ticks, since_s: f64) -> Option<Period> {
        let phase = self.phase_s(clock, at);
        let aligned = self.plan.period.as_ticks_f64();
        let ticks = self.frame_s / (1.0 + clock.skew) * f64::from(TICK_HZ);
        let wanted = ticks * (1.0 - phase / CATCH_UP_S);
        let now = self.period().as_ticks_f64();
        let most = MOST_A_SECOND * since_s.clamp(0.0, CATCH_UP_S) * aligned;
        let wanted = wanted.clamp(now - most, now + most);
        let away = MOST_AWAY * aligned;
        let wanted = wanted.clamp(aligned - away, aligned + away);
        let period = Period::from_ticks_f64(wanted);
        let changes = wanted.is_finite() && period != self.period() && period.in_bounds();
        changes.then_some(period)
    }

    /// Adopts a period that the board has set; `next` is an edge that it makes with this period.
    ///
    /// Returns the grid from the first edge that is also on the old one; if answers were lost, `next`
    /// lies after it.
    pub fn follow(&mut self, next: EdgeTime, period: Period) -> EdgeGrid {
        let (count, anchor) = turn(self.grid, next, period);
        self.number = self.number.saturating_add(count);
        self.grid = EdgeGrid { anchor, period };
        self.grid
    }
}

/// Returns the edge at which a train changed from the grid `old`, whose anchor is earlier, to
/// the period `new`, and its number from that anchor. `next` is an edge of the new period.
fn turn(old: EdgeGrid, next: EdgeTime, new: Period) -> (u64, EdgeTime) {
    let apart = i128::from(old.period.0.max(1));
    let ahead = (next.raw() - old.anchor.raw()).max(0);
    let count = (ahead + apart / 2) / apart;
    // Each period since is longer than an old one by as much.
    let beyond = next.raw() - old.anchor.raw() - count * apart;
    let each = i128::from(new.0) - i128::from(old.period.0);
    let since = match (beyond.checked_rem(each), beyond.checked_div(each)) {
        (Some(0), Some(since)) => since.clamp(0, count),
        // On neither grid: `next` is the only edge known.
        _ => 0,
    };
    let number = u64::try_from(count - since).unwrap_or(u64::MAX);
    (
        number,
        EdgeTime::from_raw(next.raw() - since * i128::from(new.0)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Wander;
    use crate::alignment::Target;
    use crate::frames::Frames;
    use crate::twists::Twists;

    /// The answer to a step may come late, or be that to its repetition.
    #[test]
    fn a_step_is_found_at_its_edge_however_late_it_is_reported() {
        let anchor = EdgeTime {
            ticks: Ticks(9_000_000_000),
            fraction: 5,
        };
        let old = EdgeGrid::new(anchor, Period(1_600_000 << 32 | 77));
        for (late, more) in [(0, 2_000_000_001), (1, -3), (61, 2_000_000_001), (200, -7)] {
            let new = Period(old.period.0.wrapping_add_signed(more));
            let turned = old.edge(35);
            let next = EdgeGrid::new(turned, new).edge(late);
            assert_eq!(turn(old, next, new), (35, turned), "{late}");
        }
    }

    /// The clocks are apart by 2 ppm more than the alignment knew, and the train begins 30 µs
    /// late. Within a minute it is on the frames, from either side; with the sign of the phase
    /// or of the rate the other way round it would go on moving away.
    #[test]
    fn the_train_comes_back_onto_the_frames_from_either_side() {
        for sign in [1.0, -1.0] {
            let assumed = clock(1e-5);
            let mut steering = Steering::new(&plan(&assumed), 1);
            let begin = steering.plan.anchor;
            let mut actual = clock(1e-5 + sign * 2e-6);
            let at_begin = BoardSeconds::from(begin);
            actual.offset +=
                assumed.to_phone(at_begin).0 - actual.to_phone(at_begin).0 + sign * 30e-6;
            let at = |seconds: u64| Ticks(begin.0 + seconds * u64::from(TICK_HZ));
            let phase_us = |steering: &Steering, at| steering.phase_s(&actual, at) * 1e6;
            assert!((phase_us(&steering, begin) - sign * 30.0).abs() < 0.1);
            for step in 1..=45 {
                let now = at(2 * step);
                if let Some(period) = steering.wanted(&actual, now, STEP_EVERY_S) {
                    let (_, edge) = steering.edge_from(now);
                    steering.follow(edge, period);
                }
                let phase = phase_us(&steering, now);
                assert!(phase.abs() < 60.0, "after {step} steps {phase}");
            }
            let left = phase_us(&steering, at(90));
            assert!(left.abs() < 1.0, "{left}");
        }
    }

    fn clock(skew: f64) -> ClockRelation {
        ClockRelation {
            reference: 100.0,
            offset: 5.0,
            skew,
            covariance: [[1e-12, 0.0], [0.0, 1e-14]],
            wander: Wander::default(),
        }
    }

    fn plan(clock: &ClockRelation) -> GridPlan {
        let (frames, _) = Frames::known(None, 1e9 / 30.0, Some(1_000.0));
        let target = Target {
            middle: PhoneSeconds(106.006),
            lead_s: 6_362.5e-6,
            ratio: 1,
            depth_fps: 30,
        };
        GridPlan::new(&Twists::new(*clock).course(), frames, &target).unwrap()
    }
}
