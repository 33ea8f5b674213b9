//! The trigger outputs 2 to 4 of the real firmware on the simulated board: every
//! edge at the pins against the arithmetic of the commands, beside the camera's
//! train and the pulse per second.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use crate::board_host::{Board, GNSS, UNITS_PER_TICK, train};
use crate::trigger::check_aligns;
use crate::trigger_rig::Strobe;
use protocol::*;
use rig::lidar::{Lidar, LidarConfig, LidarFaults};
use rig::wiring;
use stm32f4_sim::pin::{Level, Pin};
use stm32f4_sim::shared::{Shared, lock};
use stm32f4_sim::sim::SimBuilder;
use stm32f4_sim::time::{SimDuration, SimTime};

const CAMERA: u64 = 33_330_652_540;
const WIDTH: u32 = 576;
const OUTPUT_WIDTH: u32 = 100 * 48;

/// Pins of the trains: the camera's, outputs 2 to 4, the pulse per second.
const PINS: [Pin; 5] = [Pin::PA5, Pin::PE11, Pin::PE13, Pin::PE14, Pin::PE9];

fn picos(picos: u64) -> Period {
    Period::from_picos(picos).unwrap()
}

/// A train as it was commanded, checked edge by edge.
struct Train {
    pin: Pin,
    grid: EdgeGrid,
    width: u32,
    /// Edges seen at the pin, rising and falling.
    seen: u64,
    reported: u64,
}

impl Train {
    fn new(pin: Pin, status: &TriggerStatus) -> Self {
        Self {
            pin,
            grid: EdgeGrid::new(status.next_edge, status.period),
            width: status.width,
            seen: 0,
            reported: 0,
        }
    }

    fn expected(&self, number: u64) -> u64 {
        self.grid.edge(number as i64).ticks.0
    }

    /// Takes the next edge of the pin.
    fn edge(&mut self, level: Level, tick: u64) {
        let rise = self.expected(self.seen / 2);
        let (expected, wanted) = if self.seen.is_multiple_of(2) {
            (rise, Level::High)
        } else {
            (rise + u64::from(self.width), Level::Low)
        };
        assert_eq!(
            (tick, level),
            (expected, wanted),
            "edge {} of {}",
            self.seen,
            self.pin
        );
        self.seen += 1;
    }

    /// Takes the next report; those that were dropped are left out.
    fn report(&mut self, number: u64, at: Ticks) {
        assert!(number >= self.reported, "{} of {}", number, self.pin);
        assert_eq!(
            at.0,
            self.expected(number),
            "report {number} of {}",
            self.pin
        );
        self.reported = number + 1;
    }
}

struct OutputsBench {
    board: Board,
    trains: Vec<Train>,
    zero: Option<u64>,
    lidar: Shared<Lidar>,
}

impl OutputsBench {
    fn new() -> Self {
        Self::on(wiring::board())
    }

    fn on(builder: SimBuilder) -> Self {
        let lidar = Arc::new(Mutex::new(Lidar::new(LidarConfig::default())));
        let mut board = Board::boot(builder.model(Arc::clone(&lidar)));
        for pin in PINS {
            board.rig.log_pin(pin);
        }
        Self {
            board,
            trains: Vec::new(),
            zero: None,
            lidar,
        }
    }

    fn start(&mut self, output: Output, start: TriggerStart) -> TriggerStatus {
        self.board.ask(StartTrigger { output, start }).unwrap()
    }

    /// The camera's train, and all others, each beginning at `first`.
    fn start_all(&mut self, camera: Period, periods: [Period; 3], first: Ticks) {
        let from_first = |period, width| TriggerStart {
            first_edge: Some(first.into()),
            ..train(period, width)
        };
        let status = self.board.start(from_first(camera, WIDTH));
        self.trains.push(Train::new(Pin::PA5, &status));
        for (output, period) in Output::AUXILIARY.into_iter().zip(periods) {
            let status = self.start(output, from_first(period, OUTPUT_WIDTH));
            assert_eq!(
                (status.next_edge, status.state),
                (first.into(), TrainState::Waiting)
            );
            let pin = PINS[usize::from(output.number()) - 1];
            self.trains.push(Train::new(pin, &status));
        }
        let gnss = GnssSettings {
            sentences: Sentences::RmcZda,
            ..GNSS
        };
        let Ok(_) = self.board.ask(StartGnss(gnss)) else {
            panic!("refused");
        };
        let second = u64::from(TICK_HZ);
        // The next whole second; the answer to the ping was a moment ago.
        let next = Ticks((self.board.now().0 / second + 1) * second);
        self.trains.push(Train {
            pin: Pin::PE9,
            grid: EdgeGrid::new(next, Period::from_ticks(TICK_HZ)),
            width: gnss.pulse_width,
            seen: 0,
            reported: 0,
        });
    }

    /// Checks every edge and every report since the last check.
    fn check(&mut self) {
        let edges: VecDeque<(Pin, Level, SimTime)> = self.board.rig.take_edges().into();
        for (pin, level, at) in edges {
            let zero = *self.zero.get_or_insert_with(|| {
                let first = self.trains.iter().find(|train| train.pin == pin).unwrap();
                at.units() - first.expected(0) * UNITS_PER_TICK
            });
            let since = at.units() - zero;
            assert_eq!(
                since % UNITS_PER_TICK,
                0,
                "{pin}: an edge between two ticks"
            );
            let train = self.trains.iter_mut().find(|train| train.pin == pin);
            train
                .expect("only trains that were started move pins")
                .edge(level, since / UNITS_PER_TICK);
        }
        let Self { board, trains, .. } = self;
        let mut report = |pin, number, at| {
            let train = trains.iter_mut().find(|train| train.pin == pin);
            train.unwrap().report(number, at);
        };
        for pulse in board.pulses.drain(..) {
            report(Pin::PA5, pulse.number, pulse.at);
        }
        for pulse in board.outputs.drain(..) {
            let pin = PINS[usize::from(pulse.output.number()) - 1];
            report(pin, pulse.number, pulse.at);
            assert!(pulse.aligned);
        }
        board.pps.clear();
    }

    /// Number of pulses of the slowest train that have one of each other train within so
    /// many ticks, by the arithmetic of the edges that were seen.
    fn coincidences(&self, within: u64) -> usize {
        let slow = self.trains.iter().max_by_key(|train| train.grid.period);
        let slow = slow.expect("trains run");
        let near = |train: &Train, at: u64| {
            let (next, _) = train.grid.first_from(Ticks(at));
            let mut around = next.saturating_sub(1)..=next;
            around.any(|k| train.expected(k).abs_diff(at) <= within)
        };
        (0..slow.seen / 2)
            .map(|k| slow.expected(k))
            .filter(|&at| self.trains.iter().all(|train| near(train, at)))
            .count()
    }

    /// That none was lost: as many edges as there must have been by now.
    fn check_count(&mut self) {
        let now = self.board.now().0;
        self.check();
        for train in &self.trains {
            let pulses = train.seen / 2;
            assert!(
                train.expected(pulses + 1) > now,
                "{}: {pulses} pulses",
                train.pin
            );
            assert!(pulses > 0, "{}", train.pin);
        }
        let status = self.board.next_status();
        assert_eq!(status.trigger.late, 0);
        for output in status.outputs {
            assert_eq!(output.late, 0);
        }
        assert_eq!((status.gnss.late, status.gnss.missed), (0, 0));
        self.check();
    }
}

/// After some idle seconds, four trains and the lidar's outputs for some more, the USB full and a
/// flood of commands in every other one: every edge, every report.
fn run_all(idle: u64, seconds: u64) {
    let mut bench = OutputsBench::new();
    bench.board.run(idle * 1_000);
    let mut reported = Vec::new();
    // All begin together on a whole second, so the pulse per second is part of that.
    // From there on they slip by 1 µs a second against it: the camera and every sixth
    // of its frames one way, the shortest the other way.
    let camera = picos(33_333_300_000);
    let sixth = Period(camera.0 * 6);
    let periods = [sixth, Period::from_ticks(TICK_HZ / 5), picos(1_000_001_000)];
    let second = u64::from(TICK_HZ);
    let first = Ticks((bench.board.now().0 / second + 2) * second);
    bench.start_all(camera, periods, first);
    for second in 0..seconds {
        bench.board.ask(SendFiller(second % 2 == 0)).unwrap();
        for _ in 0..20 {
            for output in Output::AUXILIARY {
                bench.board.send(QueryTrigger(output));
            }
            bench.board.run(50);
        }
        bench.board.answers.clear();
        bench.board.statuses.clear();
        bench.check();
        reported.extend(
            lock(&bench.lidar)
                .take_seconds()
                .iter()
                .map(|second| second.utc),
        );
    }
    // The lidar got every second in time, each one more than the one before. The
    // last may not be over.
    let pulses = bench.trains.last().map_or(0, |pps| pps.seen.div_ceil(2));
    assert_eq!(reported.len() as u64 + 1, pulses);
    assert!(pulses >= seconds - 2, "{pulses}");
    assert_eq!(lock(&bench.lidar).faults(), LidarFaults::default());
    let first = reported[0].expect("the first second came in time");
    assert!(
        reported
            .iter()
            .zip(first..)
            .all(|(utc, next)| *utc == Some(next))
    );
    bench.check_count();
    for train in &bench.trains {
        println!(
            "{}: {} edges compared with the arithmetic, all at 0 ticks",
            train.pin, train.seen
        );
    }
    let together = bench.coincidences(50 * 48);
    assert!(together > 40, "{together}");
    println!(
        "coincidences of all five within 50 us: {together}; seconds reported to the lidar: {}, all in \
         time",
        reported.len()
    );
    let status = bench.board.next_status();
    println!(
        "{seconds} s: worst edge to end of handling {:.2} us (outputs), {:.2} us (camera), \
         simulated",
        f64::from(status.output_latency) / 48.0,
        f64::from(status.trigger_latency) / 48.0
    );
}

/// Over a wrap of the 32-bit counter.
#[test]
fn every_edge_of_all_trains_is_exact_at_full_load() {
    run_all(50, 45);
}

/// An input that oscillates at 400 kHz, faster than its handler: the board listens to it
/// for a few edges at a time, less than the auxiliary outputs can wait.
#[test]
fn a_flood_on_the_strobe_input_starves_no_output() {
    // 1.25 µs high, 1.25 µs low, after every pulse of the trigger.
    let strobe = Strobe::pulses(6_000, SimDuration::from_nanos(1_250));
    let mut bench = OutputsBench::on(wiring::board().model(strobe));
    let second = u64::from(TICK_HZ);
    let first = Ticks((bench.board.now().0 / second + 2) * second);
    let fast = picos(1_000_001_000);
    bench.start_all(picos(33_333_300_000), [fast; 3], first);
    bench.board.run(10_000);
    bench.check_count();
    let status = bench.board.next_status();
    assert!(status.strobe_floods > 100, "{status:?}");
    // What was taken is marked where edges are missing before it.
    let captures = bench.board.strobe.iter();
    let marked = captures.filter(|capture| capture.after_loss).count() as u32;
    let unseen = status.dropped.captures + 1;
    assert!(
        marked + unseen >= status.strobe_floods,
        "{marked} marked, {unseen} unseen, {} floods",
        status.strobe_floods
    );
    let latency = f64::from(status.output_latency) / 48.0;
    println!("worst edge to end of handling under a flood: {latency:.2} us, simulated");
}

/// `cargo xtask test -p smartdepthsync-rig outputs:: -- --ignored --nocapture`.
#[test]
#[ignore = "an hour of virtual time"]
fn an_hour_of_all_trains_is_exact() {
    run_all(0, 3_600);
}

/// A camera at 5 fps on every sixth frame of 30, joined while the train runs: its
/// edges are edges of the train, every time.
#[test]
fn a_multiple_stays_on_every_sixth_pulse() {
    let mut bench = OutputsBench::new();
    let start = train(picos(CAMERA), WIDTH);
    let status = bench.board.start(start);
    bench.trains.push(Train::new(Pin::PA5, &status));
    bench.board.run(777);
    let status = bench.board.trigger();
    let next = status.next_edge;
    assert_ne!(next.fraction, 0, "the train has a fraction by now");
    let join = EdgeGrid::new(next, status.period).edge(5);
    let sixth = TriggerStart {
        period: Period(status.period.0 * 6),
        width: OUTPUT_WIDTH,
        first_edge: Some(join),
    };
    let joined = bench.start(Output::Two, sixth);
    assert_eq!(joined.next_edge, join);
    bench.trains.push(Train::new(Pin::PE11, &joined));
    let mut camera = Vec::new();
    let mut slow = Vec::new();
    for _ in 0..60 {
        bench.board.run(1_000);
        camera.extend(bench.board.pulses.iter().map(|pulse| pulse.at));
        slow.extend(bench.board.outputs.iter().map(|out| out.at));
        bench.check();
    }
    assert!(slow.len() > 290, "{}", slow.len());
    let begin = camera.iter().position(|&at| at == slow[0]).unwrap();
    let sixths: Vec<_> = camera[begin..].iter().step_by(6).copied().collect();
    assert_eq!(sixths[..slow.len()], slow[..]);
}

#[test]
fn every_align_of_an_output_arrives_on_its_grid() {
    let mut bench = OutputsBench::new();
    let period = picos(50_000_123_457);
    bench.start(Output::Three, train(period, OUTPUT_WIDTH));
    check_aligns(&mut bench.board, (Output::Three, Pin::PE13), period, 40);
    assert_eq!(bench.board.next_status().outputs[1].late, 0);
}

#[test]
fn outputs_refuse_what_they_cannot_make_and_stop_cleanly() {
    let mut bench = OutputsBench::new();
    let output = Output::Four;
    let good = train(picos(CAMERA), OUTPUT_WIDTH);
    for width in [0, MIN_OUTPUT_WIDTH - 1, good.period.ticks()] {
        let start = TriggerStart { width, ..good };
        let refused = bench.board.ask(StartTrigger { output, start });
        let max = good.period.ticks() - MIN_OUTPUT_GAP;
        let min = MIN_OUTPUT_WIDTH;
        assert_eq!(refused, Err(Refusal::WidthOutOfRange { min, max }));
    }
    let period = good.period;
    let stopped = bench.board.ask(SetPeriod { output, period });
    assert_eq!(stopped, Err(Refusal::TriggerStopped));
    assert_eq!(bench.board.rig.edge_count(Pin::PE14), 0);

    // The widest and the narrowest pulse, then a stop and a start.
    for width in [MIN_OUTPUT_WIDTH, good.period.ticks() - MIN_OUTPUT_GAP] {
        let start = TriggerStart { width, ..good };
        let status = bench.start(Output::Four, start);
        bench.trains = vec![Train::new(Pin::PE14, &status)];
        bench.board.run(500);
        bench.check();
        let start = TriggerStart {
            period: picos(CAMERA + 1),
            ..start
        };
        let refused = bench.board.ask(StartTrigger { output, start });
        assert_eq!(refused, Err(Refusal::TriggerRunning));
        bench.board.ask(StopTrigger(output)).unwrap();
        bench.board.run(100);
        bench.check();
        assert!(
            bench.trains[0].seen.is_multiple_of(2),
            "the last pulse has ended"
        );
        let edges = bench.board.rig.edge_count(Pin::PE14);
        bench.board.run(300);
        assert_eq!(bench.board.rig.edge_count(Pin::PE14), edges);
    }
    // A first edge minutes ahead, beyond what a 32-bit compare tells from the past.
    let first = Ticks(bench.board.now().0 + 100 * u64::from(TICK_HZ) + 12_345);
    let far = TriggerStart {
        first_edge: Some(EdgeTime {
            ticks: first,
            fraction: u32::MAX,
        }),
        ..good
    };
    let status = bench.start(Output::Four, far);
    bench.trains = vec![Train::new(Pin::PE14, &status)];
    bench.board.run(99_000);
    assert!(bench.trains[0].seen == 0 && bench.board.rig.take_edges().is_empty());
    bench.board.run(3_000);
    bench.check();
    assert!(bench.trains[0].seen > 100);
}
