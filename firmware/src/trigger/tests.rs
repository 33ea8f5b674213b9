//! Tests of the train's arithmetic against the closed formula.

use proptest::prelude::*;
use protocol::TICK_HZ;

use super::*;

const WIDTH: u32 = 576;

fn train(period: Period, first: u64) -> Train {
    let start = TriggerStart {
        period,
        width: WIDTH,
        first_edge: Some(Ticks(first).into()),
    };
    Train::new(start, Limits::CAMERA, Ticks(0), Ticks(0), Ticks(0)).unwrap()
}

fn align(anchor: u64, period: Period, slew: u32) -> TriggerAlign {
    TriggerAlign {
        anchor: Ticks(anchor),
        period,
        slew,
    }
}

#[test]
fn values_out_of_bounds_are_refused_with_the_bounds() {
    let now = Ticks(1_000_000);
    let good = TriggerStart {
        period: Period::from_ticks(1_600_000),
        width: WIDTH,
        first_edge: None,
    };
    let new = |start: TriggerStart| Train::new(start, Limits::CAMERA, now, now, now).map(|_| ());
    assert_eq!(new(good), Ok(()));
    for period in [
        Period(0),
        Period(Period::MIN.0 - 1),
        Period(Period::MAX.0 + 1),
        Period(u64::MAX),
    ] {
        let refused = new(TriggerStart { period, ..good });
        assert_eq!(refused, Err(Refusal::PeriodOutOfRange));
    }
    for width in [
        0,
        MIN_PULSE_WIDTH - 1,
        1_600_000 - MIN_PULSE_GAP + 1,
        u32::MAX,
    ] {
        let refused = new(TriggerStart { width, ..good });
        let max = 1_600_000 - MIN_PULSE_GAP;
        let min = MIN_PULSE_WIDTH;
        assert_eq!(refused, Err(Refusal::WidthOutOfRange { min, max }));
    }
    for first in [0, now.0 - 1, now.0 + MAX_TIME_AWAY + 1, u64::MAX] {
        let first_edge = Some(Ticks(first).into());
        let refused = new(TriggerStart { first_edge, ..good });
        assert_eq!(refused, Err(Refusal::TimeOutOfRange { now }));
    }
    let first_edge = Some(Ticks(now.0 + MAX_TIME_AWAY).into());
    assert_eq!(new(TriggerStart { first_edge, ..good }), Ok(()));

    let mut train = train(good.period, now.0);
    let before = train;
    let refused = |to: TriggerAlign| train.align(1, &to, now).map(|_| ());
    let period = good.period;
    let half = 800_000;
    assert_eq!(refused(align(now.0, period, half)), Ok(()));
    assert_eq!(
        refused(align(now.0, period, half + 1)),
        Err(Refusal::SlewOutOfRange { max: half })
    );
    assert_eq!(
        refused(align(now.0 + MAX_TIME_AWAY + 1, period, 0)),
        Err(Refusal::TimeOutOfRange { now })
    );
    assert_eq!(
        refused(align(now.0, Period(1), 0)),
        Err(Refusal::PeriodOutOfRange)
    );
    assert_eq!(
        train.set_period(Period::from_ticks(TICK_HZ + 1)),
        Err(Refusal::PeriodOutOfRange)
    );
    assert_eq!(train, before);
}

#[test]
fn a_wide_pulse_bounds_the_slew_and_the_period() {
    let period = Period::from_ticks(100_000);
    let start = TriggerStart {
        period,
        width: 90_000,
        first_edge: None,
    };
    let mut train = Train::new(start, Limits::CAMERA, Ticks(0), Ticks(0), Ticks(0)).unwrap();
    let max = 100_000 - 90_000 - MIN_PULSE_GAP;
    let refused = train.align(1, &align(0, period, max + 1), Ticks(0));
    assert_eq!(refused, Err(Refusal::SlewOutOfRange { max }));
    let refused = train.set_period(Period::from_ticks(90_000));
    let range = Refusal::WidthOutOfRange {
        min: MIN_PULSE_WIDTH,
        max: 90_000 - MIN_PULSE_GAP,
    };
    assert_eq!(refused, Err(range));
    // Even a jump leaves each pulse its room.
    let jump = train.align(1, &align(60_000, period, 0), Ticks(0)).unwrap();
    assert_eq!(jump.plan.shift, TickDelta(-40_000));
    assert!(train.adopt(&jump));
    let mut last = train.edge();
    for _ in 0..jump.plan.frames {
        let edge = train.advance();
        let distance = (edge.position.ticks - last.position.ticks).0;
        assert!(distance >= i64::from(90_000 + MIN_PULSE_GAP));
        last = edge;
    }
    assert_eq!(last.arrived, Some(1));
    assert_eq!((last.position.ticks.0 + 40_000) % 100_000, 0);
}

/// Walks to the arrival and checks every pulse on the way. Returns the edge.
fn walk(train: &mut Train, to: &TriggerAlign, plan: &AlignPlan, command: u32) -> Edge {
    let mut last = train.edge();
    loop {
        let edge = train.advance();
        assert_eq!(edge.number, last.number + 1);
        let distance = edge.position.raw() - last.position.raw();
        let beyond = (distance - i128::from(to.period.0)).unsigned_abs();
        if to.slew > 0 {
            assert!(
                beyond <= u128::from(to.slew) << 32,
                "moved by more than the slew"
            );
        }
        assert!(distance > 0);
        if edge.arrived.is_some() {
            assert_eq!(edge.arrived, Some(command));
            assert!(edge.aligned);
            assert_eq!(edge.number, plan.arrival_pulse);
            assert_eq!(edge.position.ticks, plan.arrival);
            let grid = EdgeGrid::new(to.anchor, to.period);
            assert_eq!(grid.since_edge(edge.position), Some(0), "not on the grid");
            return edge;
        }
        assert!(!edge.aligned);
        assert!(edge.number < plan.arrival_pulse);
        last = edge;
    }
}

#[test]
fn one_tick_of_anchor_is_one_tick_of_phase() {
    let period = Period::from_picos(33_330_652_540).unwrap();
    let mut edges = Vec::new();
    for anchor in 10_000_000..10_000_005 {
        let mut train = train(period, 10_000_000);
        let to = align(anchor, period, 0);
        let alignment = train.align(1, &to, Ticks(0)).unwrap();
        assert!(train.adopt(&alignment));
        edges.push(walk(&mut train, &to, &alignment.plan, 1).position.ticks.0);
    }
    for pair in edges.windows(2) {
        assert_eq!(pair[1] - pair[0], 1);
    }
}

#[test]
fn the_short_way_is_never_longer_than_half_a_period() {
    let period = Period::from_ticks(100_000);
    for (anchor, shift) in [
        (0, 0),
        (1, 1),
        (49_999, 49_999),
        (50_000, -50_000),
        (50_001, -49_999),
        (99_999, -1),
        (300_001, 1),
    ] {
        let train = train(period, 1_000_000);
        let plan = train
            .align(1, &align(anchor, period, 0), Ticks(0))
            .unwrap()
            .plan;
        assert_eq!(plan.shift, TickDelta(shift), "anchor {anchor}");
    }
}

#[test]
fn the_same_align_again_changes_nothing() {
    let period = Period::from_picos(33_330_652_540).unwrap();
    let to = align(10_700_000, period, 1_000);
    let mut once = train(period, 10_000_000);
    let plan = once.align(1, &to, Ticks(0)).unwrap();
    assert!(once.adopt(&plan));
    let mut twice = once;
    for _ in 0..300 {
        once.advance();
        twice.advance();
    }
    let again = twice.align(2, &to, Ticks(0)).unwrap();
    assert_eq!(again.plan.arrival_pulse, plan.plan.arrival_pulse);
    assert_eq!(again.plan.arrival, plan.plan.arrival);
    assert!(twice.adopt(&again));
    walk(&mut twice, &to, &again.plan, 2);
    walk(&mut once, &to, &plan.plan, 1);
    assert_eq!(once.edge(), twice.edge());

    // And once more when it is already there.
    let there = twice.align(3, &to, Ticks(0)).unwrap();
    assert_eq!((there.plan.shift, there.plan.frames), (TickDelta(0), 0));
    assert!(twice.adopt(&there));
    let edge = walk(&mut twice, &to, &there.plan, 3);
    assert_eq!(edge.position, once.advance().position);
}

#[test]
fn a_plan_is_refused_after_the_next_edge_was_armed() {
    let period = Period::from_ticks(100_000);
    let mut train = train(period, 1_000_000);
    let plan = train.align(1, &align(5, period, 10), Ticks(0)).unwrap();
    train.advance();
    let before = train;
    assert!(!train.adopt(&plan));
    assert_eq!(train, before);
}

#[test]
fn a_new_period_goes_on_from_the_armed_edge() {
    let mut train = train(Period::from_ticks(100_000), 1_000_000);
    train.advance();
    let new = Period((123_456 << 32) + 0x8000_0001);
    train.set_period(new).unwrap();
    for k in 1..1000 {
        let edge = train.advance();
        assert_eq!(edge.position, EdgeGrid::new(Ticks(1_100_000), new).edge(k));
        assert!(edge.aligned);
    }
}

#[test]
fn no_period_is_set_during_an_align() {
    let period = Period::from_ticks(100_000);
    let mut train = train(period, 1_000_000);
    let plan = train.align(1, &align(5_000, period, 10), Ticks(0)).unwrap();
    assert!(train.adopt(&plan));
    let refused = train.set_period(Period::from_ticks(200_000));
    assert_eq!(refused, Err(Refusal::AlignInProgress));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    /// From any phase to any grid, with any period, near time zero and far
    /// from it: arrives exactly, as announced, within the slew, no pulse lost.
    #[test]
    fn any_align_arrives_exactly_where_and_when_it_said(
        first in 0_u64..1 << 50,
        away in -(MAX_TIME_AWAY as i64)..MAX_TIME_AWAY as i64,
        old in Period::MIN.0..=Period::MAX.0,
        new in Period::MIN.0..=Period::MAX.0,
        keep in any::<bool>(),
        parts in 0_u32..200,
    ) {
        let new = Period(if keep { old } else { new });
        let now = Ticks(first);
        let start = TriggerStart { period: Period(old), width: WIDTH, first_edge: Some(now.into()) };
        let mut train = Train::new(start, Limits::CAMERA, now, now, now).unwrap();
        train.advance();
        let step = (new.ticks() / 2).checked_div(parts).unwrap_or(0);
        let slew = step.min(Limits::CAMERA.max_slew(new, WIDTH));
        let to = align(first.saturating_add_signed(away), new, slew);
        let alignment = train.align(9, &to, now).unwrap();
        let plan = alignment.plan;
        prop_assert!(plan.shift.unsigned_abs() <= u64::from(new.ticks() / 2 + 1));
        prop_assert!(train.adopt(&alignment));
        walk(&mut train, &to, &plan, 9);
        // It stays on the grid.
        let at = train.edge().position;
        let next = train.advance();
        prop_assert_eq!(next.position.raw(), at.raw() + i128::from(new.0));
    }
}
