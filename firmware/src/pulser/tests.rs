//! Tests of the pulser on a mock of the timer whose handler comes late.

use std::cell::Cell;

use protocol::{EdgeGrid, MIN_OUTPUT_WIDTH, TriggerAlign};

use super::*;

/// A timer channel. Every look at the counter costs time; while time goes on,
/// an armed match makes its edge.
struct Mock {
    /// It makes whole pulses.
    whole: bool,
    reach: u32,
    now: Cell<u64>,
    /// Absolute time of the armed match, and what it does.
    armed: Cell<Option<(u64, Action)>>,
    matched: Cell<bool>,
    high: Cell<bool>,
    edges: std::cell::RefCell<Vec<(u64, bool)>>,
    /// Delay of the wire, and whether it is there.
    wire: Option<u32>,
    captured: Cell<Option<u64>>,
    cost: u64,
}

impl Mock {
    fn new(now: u64, whole: bool) -> Self {
        Self {
            whole,
            reach: MAX_ARM_AHEAD,
            now: Cell::new(now),
            armed: Cell::new(None),
            matched: Cell::new(false),
            high: Cell::new(false),
            edges: std::cell::RefCell::default(),
            wire: None,
            captured: Cell::new(None),
            cost: 4,
        }
    }

    fn set_pin(&self, at: u64, high: bool) {
        if self.high.replace(high) != high {
            self.edges.borrow_mut().push((at, high));
            if high && let Some(delay) = self.wire {
                self.captured.set(Some(at + u64::from(delay)));
            }
        }
    }

    fn advance_to(&self, to: u64) {
        while let Some((at, action)) = self.armed.get()
            && at <= to
        {
            // The compare goes on to match at every wrap.
            self.armed.set(Some((at + (1 << 32), action)));
            self.matched.set(true);
            match action {
                Action::Wake => {}
                Action::Rise => self.set_pin(at, true),
                Action::Fall => self.set_pin(at, false),
                Action::Pulse { fall } => {
                    self.set_pin(at, true);
                    self.armed.set(Some((end(at, fall), Action::Fall)));
                }
            }
        }
        self.now.set(to);
    }
}

/// When the counter reads `fall` next after `rise`.
fn end(rise: u64, fall: u32) -> u64 {
    rise + u64::from(fall.wrapping_sub(rise as u32))
}

impl CompareOutput for Mock {
    fn makes_whole_pulses(&self) -> bool {
        self.whole
    }

    fn reach(&self) -> u32 {
        self.reach
    }

    fn counter(&self) -> u32 {
        self.advance_to(self.now.get() + self.cost);
        self.now.get() as u32
    }

    fn arm(&mut self, at: u32, action: Action) {
        self.matched.set(false);
        match action {
            Action::Wake => {}
            Action::Rise | Action::Fall => assert!(!self.whole),
            Action::Pulse { .. } => assert!(self.whole && !self.high.get()),
        }
        // The match comes when the counter next reaches the value.
        let ahead = at.wrapping_sub(self.now.get() as u32).wrapping_sub(1);
        assert!(action == Action::Wake || ahead <= self.reach || ahead >= 1 << 31);
        self.armed
            .set(Some((self.now.get() + 1 + u64::from(ahead), action)));
    }

    fn has_matched(&self) -> bool {
        self.matched.get()
    }

    fn force_low(&mut self) {
        self.armed.set(None);
        self.matched.set(false);
        self.set_pin(self.now.get(), false);
    }

    fn take_readback(&mut self) -> Option<Captured> {
        let at = self.captured.get().filter(|&at| at <= self.now.get())?;
        self.captured.set(None);
        Some(Captured {
            at: at as u32,
            more: false,
        })
    }
}

struct Rig {
    mock: Mock,
    time: Timebase,
    pulser: Pulser,
}

impl Rig {
    /// With a channel that makes single edges.
    fn new(now: u64) -> Self {
        Self::with(now, false)
    }

    /// Makes a bench of each kind of channel.
    fn both(now: u64) -> [Self; 2] {
        [false, true].map(|whole| Self::with(now, whole))
    }

    fn with(now: u64, whole: bool) -> Self {
        let time = Timebase::new();
        let mut at = 0;
        while at < now {
            time.refresh(at as u32);
            at += 1 << 29;
        }
        time.refresh(now as u32);
        Self {
            mock: Mock::new(now, whole),
            time,
            pulser: Pulser::new(Limits::CAMERA),
        }
    }

    fn start(&mut self, start: TriggerStart) -> Result<(), Refusal> {
        self.pulser.start(&mut self.mock, &self.time, start)
    }

    fn status(&self) -> TriggerStatus {
        self.pulser.status(Ticks(self.mock.now.get()))
    }

    /// Runs to the next match, or the end of a whole pulse, and calls the handler
    /// `latency` ticks later.
    fn handle(&mut self, latency: u64) -> Option<Pulsed> {
        let at = match self.mock.armed.get()? {
            (rise, Action::Pulse { fall }) => end(rise, fall),
            (at, _) => at,
        };
        // The status task keeps time fresh.
        while self.mock.now.get() + (1 << 30) < at {
            self.mock.advance_to(self.mock.now.get() + (1 << 30));
            self.time.refresh(self.mock.now.get() as u32);
        }
        self.mock.advance_to(at.max(self.mock.now.get()));
        self.mock.advance_to(self.mock.now.get() + latency);
        self.time.refresh(self.mock.now.get() as u32);
        self.pulser.on_match(&mut self.mock, &self.time)
    }

    fn next_pulse(&mut self, latency: u64) -> Pulsed {
        loop {
            if let Some(pulse) = self.handle(latency) {
                return pulse;
            }
        }
    }
}

fn start(picos: u64, width: u32, first: u64) -> TriggerStart {
    TriggerStart {
        period: Period::from_picos(picos).unwrap(),
        width,
        first_edge: Some(Ticks(first).into()),
    }
}

#[test]
fn the_same_start_again_changes_nothing_and_another_is_refused() {
    let mut rig = Rig::new(0);
    let first = start(33_330_652_540, 576, 1_000_000);
    rig.start(first).unwrap();
    for _ in 0..3 {
        rig.next_pulse(50);
        let before = rig.status();
        rig.start(first).unwrap();
        assert_eq!(rig.status(), before);
        let other = start(33_330_652_540, 577, 1_000_000_000);
        assert_eq!(rig.start(other), Err(Refusal::TriggerRunning));
        assert_eq!(rig.status(), before);
    }
}

#[test]
fn an_edge_too_near_is_refused() {
    let mut rig = Rig::new(1_000_000);
    let near = start(
        1_000_000_000,
        576,
        1_000_000 + MIN_START_LEAD.unsigned_abs() - 1,
    );
    let refused = rig.start(near);
    assert!(matches!(refused, Err(Refusal::TimeOutOfRange { .. })));
    let soon = TriggerStart {
        first_edge: None,
        ..near
    };
    rig.start(soon).unwrap();
    let at = rig.next_pulse(50).at.0 - 1_000_000;
    assert!((48_000..48_100).contains(&at), "{at}");
}

/// A channel that sees half a millisecond ahead, under a handler that comes late.
#[test]
fn edges_beyond_the_reach_are_made_on_their_ticks() {
    for (picos, width) in [
        (33_330_652_540, MIN_OUTPUT_WIDTH),
        (33_330_652_540, 1_500_000),
        // Low for longer than the handler is late.
        (1_000_000_000, 25_000),
        (1_000_000_000_000, 24_000_000),
    ] {
        for latency in [10, 2_000, 15_000] {
            let mut rig = Rig::new(0);
            rig.mock.reach = 24_000;
            let start = start(picos, width, 1_000_000);
            rig.start(start).unwrap();
            let grid = EdgeGrid::new(Ticks(1_000_000), start.period);
            for k in 0..300_i64 {
                let pulse = rig.next_pulse(if k % 2 == 0 { latency } else { 10 });
                assert_eq!(pulse.at, grid.edge(k).ticks);
            }
            let edges = rig.mock.edges.borrow();
            for pair in edges.chunks(2) {
                let &[(rise, true), (fall, false)] = pair else {
                    panic!("{pair:?}");
                };
                // A fall in reach is armed by the late handler of its rise.
                let wide = width > 24_000;
                assert!(fall - rise == u64::from(width) || !wide && latency > 2_000);
            }
            assert_eq!(rig.status().pulses, 300);
        }
    }
}

/// Just beyond the reach, the call on the way leaves time to arm the edge.
#[test]
fn an_edge_just_beyond_the_reach_is_not_late() {
    // The last, minutes ahead, is beyond what 32 bits tell from the past.
    for beyond in [0, 1, 30, 60, 1_000, 5_166_258_297] {
        let at = 1_000 + u64::from(MAX_ARM_AHEAD) + beyond;
        for mut rig in Rig::both(1_000) {
            rig.start(start(33_330_652_540, 576, at)).unwrap();
            assert_eq!(rig.next_pulse(50).at, Ticks(at));
            assert_eq!(rig.mock.edges.borrow()[0], (at, true));
            assert_eq!(rig.status().late, 0);
        }
    }
}

#[test]
fn a_stop_ends_after_the_pulse_that_is_being_made() {
    // Before the edge, well ahead: no pulse comes.
    let mut rig = Rig::new(0);
    rig.start(start(33_330_652_540, 576, 1_000_000)).unwrap();
    rig.next_pulse(50);
    rig.pulser.stop(&mut rig.mock, &rig.time);
    assert_eq!(rig.status().state, TrainState::Stopped);
    assert_eq!(rig.handle(50), None);
    assert_eq!(rig.mock.edges.borrow().len(), 2);

    // Within a pulse: it keeps its width.
    rig.start(start(33_330_652_540, 576, 1_200_000)).unwrap();
    assert_eq!(rig.handle(50), None);
    rig.pulser.stop(&mut rig.mock, &rig.time);
    assert_ne!(rig.status().state, TrainState::Stopped);
    let refused = rig.start(start(33_330_652_540, 576, 9_000_000));
    assert_eq!(refused, Err(Refusal::TriggerRunning));
    assert_eq!(rig.next_pulse(50).number, 0);
    assert_eq!(rig.status().state, TrainState::Stopped);
    let edges = [(1_200_000, true), (1_200_576, false)];
    assert_eq!(rig.mock.edges.borrow()[2..], edges);

    // So near that it might race the edge: the pulse still comes, whole.
    rig.start(start(33_330_652_540, 576, 2_000_000)).unwrap();
    rig.mock.advance_to(2_000_000 - 100);
    rig.pulser.stop(&mut rig.mock, &rig.time);
    assert_eq!(rig.next_pulse(50).at, Ticks(2_000_000));
    assert_eq!(rig.status().state, TrainState::Stopped);
    assert_eq!(rig.mock.edges.borrow().len(), 6);
    assert_eq!(rig.status().train, 3);
    // Once more changes nothing.
    rig.pulser.stop(&mut rig.mock, &rig.time);
    assert_eq!(rig.status().state, TrainState::Stopped);
}

#[test]
fn a_handler_that_comes_too_late_is_counted_and_the_grid_is_kept() {
    let mut rig = Rig::new(0);
    rig.start(start(1_000_000_000, 576, 1_000_000)).unwrap();
    rig.next_pulse(50);
    // The falling edge is armed too late: the pulse is ended by force.
    let pulse = rig.handle(1_000).unwrap();
    assert_eq!(pulse.at, Ticks(1_048_000));
    assert_eq!(rig.status().late, 1);
    let ended = *rig.mock.edges.borrow().last().unwrap();
    assert!((1_049_000..1_049_100).contains(&ended.0) && !ended.1);
    // The next is on the grid again.
    assert_eq!(rig.next_pulse(50).at, Ticks(1_096_000));
    // The rising edge is armed too late: it comes late, and its time is true.
    assert_eq!(rig.handle(50), None);
    let pulse = rig.handle(60_000).unwrap();
    assert_eq!(pulse.at, Ticks(1_144_000));
    let late = rig.next_pulse(50);
    assert_eq!(rig.status().late, 2);
    assert!(late.at.0 > 1_192_000);
    let rises: Vec<u64> = rig
        .mock
        .edges
        .borrow()
        .iter()
        .filter(|e| e.1)
        .map(|e| e.0)
        .collect();
    assert_eq!(*rises.last().unwrap(), late.at.0);
    let next = rig.next_pulse(50);
    assert_eq!(next.number, late.number + 1);
    assert_eq!(next.at, Ticks(1_240_000));
}

/// Whole pulses need nobody until the next one, however long nobody comes.
#[test]
fn a_whole_pulse_keeps_its_width_without_the_handler() {
    let mut rig = Rig::with(0, true);
    rig.start(start(1_000_000_000, 576, 1_000_000)).unwrap();
    assert_eq!(rig.next_pulse(46_000).at, Ticks(1_000_000));
    assert_eq!(rig.next_pulse(46_000).at, Ticks(1_048_000));
    // Until after the next edge: that one comes late, at the time that is reported.
    assert_eq!(rig.next_pulse(60_000).at, Ticks(1_096_000));
    let late = rig.next_pulse(50);
    assert!(late.at.0 > 1_096_576 + 60_000, "{late:?}");
    assert_eq!(rig.status().late, 1);
    // The grid is kept.
    assert_eq!(rig.next_pulse(50).at, Ticks(1_192_000));
    let edges = rig.mock.edges.borrow();
    for pair in edges.chunks(2) {
        assert_eq!(pair[1].0 - pair[0].0, 576, "{pair:?}");
    }
    assert_eq!(edges[6], (late.at.0, true));
}

#[test]
fn a_whole_pulse_that_is_near_or_begun_is_not_taken_back() {
    let mut rig = Rig::with(0, true);
    for (away, made) in [
        (10_000, false),
        (STOP_MARGIN.unsigned_abs() - 100, true),
        (0, true),
    ] {
        let first = rig.mock.now.get() + 1_000_000;
        rig.start(start(33_330_652_540, 5_760, first)).unwrap();
        rig.mock.advance_to(first - away);
        if away == 0 {
            rig.mock.advance_to(first + 100);
            assert_eq!(rig.status().pulses, 1, "it has risen");
            assert_eq!(rig.status().state, TrainState::Running);
        }
        rig.pulser.stop(&mut rig.mock, &rig.time);
        assert_eq!(rig.handle(50).is_some(), made);
        assert_eq!(rig.status().state, TrainState::Stopped);
        assert!(!rig.mock.high.get());
    }
    assert_eq!(rig.mock.edges.borrow().len(), 4);
}

#[test]
fn a_whole_pulse_keeps_the_handler_free_until_it_ends() {
    let mut rig = Rig::with(0, true);
    rig.start(start(33_330_652_540, 100_000, 1_000_000))
        .unwrap();
    let margin = TickDelta(720);
    assert!(!rig.pulser.is_busy(Ticks(999_990), margin));
    assert!(!rig.pulser.is_busy(Ticks(1_000_050), margin));
    assert!(rig.pulser.is_busy(Ticks(1_099_500), margin));
    assert!(!rig.pulser.is_overdue(Ticks(1_579_999), TickDelta(480_000)));
    assert!(rig.pulser.is_overdue(Ticks(1_580_001), TickDelta(480_000)));
}

#[test]
fn an_align_is_adopted_and_its_arrival_reported_once() {
    let mut rig = Rig::new(0);
    let begin = start(33_330_652_540, 576, 1_000_000);
    rig.start(begin).unwrap();
    rig.next_pulse(50);
    let to = TriggerAlign {
        anchor: Ticks(1_000_777),
        period: begin.period,
        slew: 100,
    };
    let alignment = rig
        .pulser
        .running()
        .unwrap()
        .align(77, &to, Ticks(0))
        .unwrap();
    assert_eq!(rig.pulser.adopt(&alignment), Ok(true));
    assert_eq!(rig.status().state, TrainState::Slewing);
    let mut arrivals = Vec::new();
    for _ in 0..20 {
        let pulse = rig.next_pulse(50);
        if pulse.arrived.is_some() {
            arrivals.push((pulse.number, pulse.at, pulse.arrived));
        }
        assert_eq!(pulse.aligned, pulse.number < 2 || !arrivals.is_empty());
    }
    let plan = alignment.plan;
    assert_eq!(plan.shift.0, 777);
    assert_eq!(arrivals, [(plan.arrival_pulse, plan.arrival, Some(77))]);
    rig.pulser.stop(&mut rig.mock, &rig.time);
    assert_eq!(rig.pulser.adopt(&alignment), Err(Refusal::TriggerStopped));
    let refused = rig.pulser.set_period(begin.period);
    assert_eq!(refused, Err(Refusal::TriggerStopped));
}

#[test]
fn the_read_back_is_matched_to_its_pulse() {
    let mut rig = Rig::new(0);
    rig.start(start(1_000_000_000, 576, 1_000_000)).unwrap();
    assert_eq!(rig.next_pulse(50).readback, None);
    let unwired = rig.status().readback;
    assert_eq!((unwired.seen, unwired.missing), (0, 0));
    rig.mock.wire = Some(3);
    for _ in 0..5 {
        assert_eq!(rig.next_pulse(50).readback, Some(3));
    }
    rig.mock.wire = None;
    for _ in 0..2 {
        assert_eq!(rig.next_pulse(50).readback, None);
    }
    // An edge that is not a pulse.
    rig.mock.captured.set(Some(rig.mock.now.get() - 1));
    assert_eq!(rig.next_pulse(50).readback, None);
    let expected = Readback {
        seen: 5,
        missing: 3,
        stray: 1,
        delay: Some(3),
    };
    assert_eq!(rig.status().readback, expected);
}

#[test]
fn the_status_tells_the_next_edge_exactly() {
    for mut rig in Rig::both(0) {
        let begin = start(33_330_652_540, 576, 1_000_000);
        rig.start(begin).unwrap();
        let grid = EdgeGrid::new(Ticks(1_000_000), begin.period);
        for k in 1..50 {
            rig.next_pulse(50);
            assert_eq!(rig.status().next_edge, grid.edge(k));
        }
    }
}

#[test]
fn an_overdue_edge_is_noticed() {
    let mut rig = Rig::new(0);
    rig.start(start(1_000_000_000, 576, 1_000_000)).unwrap();
    assert!(!rig.pulser.is_overdue(Ticks(1_000_000), TickDelta(480_000)));
    assert!(rig.pulser.is_overdue(Ticks(1_480_001), TickDelta(480_000)));
}

#[test]
fn edges_near_and_past_keep_the_handler_free() {
    let mut rig = Rig::new(0);
    assert!(!rig.pulser.is_busy(Ticks(5), TickDelta(720)));
    rig.start(start(33_330_652_540, 100_000, 1_000_000))
        .unwrap();
    assert!(!rig.pulser.is_busy(Ticks(999_000), TickDelta(720)));
    assert!(rig.pulser.is_busy(Ticks(999_500), TickDelta(720)));
    assert!(rig.pulser.is_busy(Ticks(1_000_050), TickDelta(720)));
    assert_eq!(rig.handle(50), None);
    assert!(!rig.pulser.is_busy(Ticks(1_000_100), TickDelta(720)));
    assert!(rig.pulser.is_busy(Ticks(1_099_500), TickDelta(720)));
    assert!(rig.handle(50).is_some());
    assert!(!rig.pulser.is_busy(Ticks(1_100_100), TickDelta(720)));
}
