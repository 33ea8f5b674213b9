//! Edges of a grid, and distances from them, against their definitions.

use proptest::prelude::*;
use protocol::{EdgeGrid, EdgeTime, Period, TickDelta, Ticks};

fn edge_time() -> impl Strategy<Value = EdgeTime> {
    (1_u64 << 40..1 << 41, any::<u32>()).prop_map(|(ticks, fraction)| EdgeTime {
        ticks: Ticks(ticks),
        fraction,
    })
}

proptest! {
    #[test]
    fn a_time_is_its_ticks_and_its_fraction(ticks: u64, fraction: u32, period: u64) {
        let time = EdgeTime { ticks: Ticks(ticks), fraction };
        prop_assert_eq!(EdgeTime::from_raw(time.raw()), time);
        let later = time + Period(period);
        let saturates = later == EdgeTime::from_raw(i128::MAX);
        prop_assert!(saturates || later.raw() - time.raw() == i128::from(period));
        prop_assert_eq!(later, EdgeGrid::new(time, Period(period)).edge(1));
    }

    #[test]
    fn every_edge_of_a_grid_is_on_it(
        anchor in edge_time(),
        raw in Period::MIN.0..Period::MAX.0,
        k in -10_000_i64..1_000_000,
        off in -200_i64..200,
    ) {
        let grid = EdgeGrid::new(anchor, Period(raw));
        let edge = grid.edge(k);
        prop_assert_eq!(grid.since_edge(edge), Some(0));
        prop_assert_eq!(grid.phase_error(edge.ticks), TickDelta::ZERO);
        let moved = edge.ticks + TickDelta(off);
        prop_assert_eq!(grid.phase_error(moved), TickDelta(off));
    }

    #[test]
    fn the_first_edge_is_not_early_and_the_one_before_it_is(
        anchor in edge_time(),
        raw in 1_u64 << 32..1 << 44,
        at in edge_time(),
    ) {
        let grid = EdgeGrid::new(anchor, Period(raw));
        let (number, edge) = grid.first_from(at);
        prop_assert_eq!(grid.edge(number as i64), edge);
        prop_assert!(edge >= at);
        prop_assert!(number == 0 || grid.edge(number as i64 - 1) < at);
    }

    /// Against all edges around, for periods down to a tick: no other is nearer, and
    /// of two that are equally near it is the earlier.
    #[test]
    fn no_edge_is_nearer_than_the_phase_error(
        anchor in edge_time(),
        raw in 1_u64 << 32..1 << 44,
        at in 1_u64 << 40..1 << 41,
    ) {
        let (grid, at) = (EdgeGrid::new(anchor, Period(raw)), Ticks(at));
        let near = (EdgeTime::from(at).raw() - anchor.raw()).div_euclid(raw.into());
        let near = i64::try_from(near).unwrap_or_default();
        let nearest = (near - 3..=near + 3)
            .map(|k| at - grid.edge(k).ticks)
            .min_by_key(|off| off.unsigned_abs());
        prop_assert_eq!(Some(grid.phase_error(at)), nearest);
    }
}
