//! The phase error of an instant against the edges themselves.

use proptest::prelude::*;
use protocol::{Period, TickDelta, Ticks};

proptest! {
    #[test]
    fn every_edge_of_a_grid_is_on_it(
        anchor in 1_u64 << 40..1 << 41,
        raw in Period::MIN.0..Period::MAX.0,
        k in -10_000_i64..1_000_000,
        off in -200_i64..200,
    ) {
        let period = Period(raw);
        let edge = period.edge(Ticks(anchor), k);
        prop_assert_eq!(period.phase_error(Ticks(anchor), edge), TickDelta::ZERO);
        let moved = edge + TickDelta(off);
        prop_assert_eq!(period.phase_error(Ticks(anchor), moved), TickDelta(off));
    }

    /// Against all edges around, for periods down to a tick: no other is nearer, and
    /// of two that are equally near it is the earlier.
    #[test]
    fn no_edge_is_nearer_than_the_phase_error(
        anchor in 1_u64 << 40..1 << 41,
        raw in 1_u64 << 32..1 << 44,
        at in 1_u64 << 40..1 << 41,
    ) {
        let (period, anchor, at) = (Period(raw), Ticks(anchor), Ticks(at));
        let near = (i128::from((at - anchor).0) << 32).div_euclid(raw.into());
        let near = i64::try_from(near).unwrap_or_default();
        let nearest = (near - 3..=near + 3)
            .map(|k| at - period.edge(anchor, k))
            .min_by_key(|off| off.unsigned_abs());
        prop_assert_eq!(Some(period.phase_error(anchor, at)), nearest);
    }
}
