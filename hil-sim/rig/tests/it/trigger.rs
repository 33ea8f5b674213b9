//! The trigger train of the real firmware on the simulated board: every edge at
//! the pin against the arithmetic of the command.

use crate::board_host::{Board, Epoch, UNITS_PER_TICK, pulses_of, train};
use crate::trigger_rig::Strobe;
use protocol::*;
use rig::random::{Seed, Stream};
use rig::wiring;
use stm32f4_sim::pin::Pin;
use stm32f4_sim::time::SimDuration;

/// The default width: 12 µs.
const WIDTH: u32 = 576;

fn picos(picos: u64) -> Period {
    Period::from_picos(picos).unwrap()
}

fn board() -> Board {
    let mut board = Board::boot(wiring::board());
    board.rig.log_pin(Pin::PA5);
    board
}

fn start(board: &mut Board, period: Period, width: u32) -> TriggerStatus {
    board.start(train(period, width))
}

/// Checks every pulse at the pin and every report against
/// `floor(first + k · period)`, from pulse 0 on. Returns how many there were.
pub(crate) fn check_train(board: &mut Board, first: EdgeTime, period: Period, width: u32) -> usize {
    let grid = EdgeGrid::new(first, period);
    board.stop();
    board.run(1_100);
    let edges = board.rig.take_edges();
    let pins = pulses_of(&edges, Pin::PA5);
    let status = board.trigger();
    assert_eq!(status.state, TrainState::Stopped);
    assert_eq!(status.pulses as usize, pins.len());
    let mut epoch = Epoch::default();
    for (k, &(rise, fall)) in pins.iter().enumerate() {
        let expected = grid.edge(k as i64).ticks;
        assert_eq!(epoch.tick(rise, expected), expected, "pulse {k} at the pin");
        let high = fall.units() - rise.units();
        assert_eq!(
            high,
            u64::from(width) * UNITS_PER_TICK,
            "width of pulse {k}"
        );
    }
    // Reports: those that came are exact, each says which pulse it is.
    for report in &board.pulses {
        let expected = grid.edge(report.number as i64).ticks;
        assert_eq!(report.at, expected, "report of pulse {}", report.number);
        assert!(report.aligned);
    }
    assert_eq!(status.late, 0, "{status:?}");
    pins.len()
}

/// Runs a train for `seconds`, after as many without as `idle`; checks every edge, and that every pulse was
/// reported.
fn exact(period: Period, width: u32, [idle, seconds]: [u64; 2]) -> usize {
    let mut board = board();
    board.run(idle * 1_000);
    let first = start(&mut board, period, width).next_edge;
    board.run(seconds * 1_000);
    let pulses = check_train(&mut board, first, period, width);
    assert_eq!(board.pulses.len(), pulses, "every pulse is reported");
    for (number, report) in board.pulses.iter().enumerate() {
        assert_eq!(report.number, number as u64);
    }
    pulses
}

/// The shortest period with the narrowest pulse and the phone's frame period over wraps of the
/// counter, the usual rates, and a width that leaves the handler the shortest gap.
#[test]
fn every_pulse_of_a_train_is_exact() {
    let nearly_whole = picos(1_000_000_001);
    for (period, width, times, least) in [
        (picos(1_000_000_000), MIN_PULSE_WIDTH, [60, 35], 34_000),
        (picos(33_330_652_540), WIDTH, [60, 40], 1_199),
        (picos(33_333_333_330), WIDTH, [0, 10], 299),
        (picos(200_000_000_000), WIDTH, [0, 10], 49),
        (
            nearly_whole,
            nearly_whole.ticks() - MIN_PULSE_GAP,
            [0, 5],
            0,
        ),
    ] {
        let pulses = exact(period, width, times);
        assert!(pulses > least, "{period:?}: {pulses}");
    }
}

/// USB as full as it gets, a flood of commands, a host that comes and goes, a
/// stuck I2C bus and what the firmware logs about all of it.
#[test]
fn pulses_are_exact_under_full_load() {
    for (period, seconds) in [(picos(1_000_000_000), 6), (picos(33_330_652_540), 8)] {
        let mut board = board();
        let first = start(&mut board, period, WIDTH).next_edge;
        board.rig.hold_sda(true);
        let mut pings = 0;
        for second in 0..seconds {
            board.ask(SendFiller(true)).unwrap();
            for _ in 0..40 {
                for _ in 0..10 {
                    board.send(Ping { host_time: 1 });
                    board.send(QueryTrigger(Output::Camera));
                    pings += 1;
                }
                board.run(20);
            }
            if second % 2 == 1 {
                board.unplug_and_plug(100);
            }
        }
        assert!(
            board.fillers() > 1_000,
            "the link was loaded: {}",
            board.fillers()
        );
        assert!(board.answers.len() > pings, "commands were answered");
        let pulses = check_train(&mut board, first, period, WIDTH);
        assert!(pulses as u64 > seconds * 900 / (u64::from(period.ticks()) / 48_000));
        // What was not delivered shows as a gap, and is counted unless it was on
        // the wire when the cable was pulled.
        let status = board.next_status();
        let delivered = board.pulses.len() as u32;
        let missing = pulses as u32 - delivered;
        assert!(status.dropped.pulses <= missing);
        assert!(
            missing - status.dropped.pulses <= 4 * seconds as u32,
            "{missing}"
        );
    }
}

#[test]
fn every_align_arrives_on_its_grid() {
    let mut board = board();
    let period = picos(33_330_652_540);
    start(&mut board, period, WIDTH);
    check_aligns(&mut board, (Output::Camera, Pin::PA5), period, 200);
    assert_eq!(board.trigger().late, 0);
}

/// Aligns a train that has just begun from random phases: each time it arrives at 0 ticks
/// where it said, within the slew, without losing or doubling a pulse.
pub(crate) fn check_aligns(
    board: &mut Board,
    (output, pin): (Output, Pin),
    period: Period,
    rounds: u32,
) {
    board.run(100);
    let mut random = Seed(1).stream(Stream::Test);
    let mut previous: Option<Pulse> = None;
    let mut epoch = Epoch::default();
    for round in 0..rounds {
        let now = board.now();
        // Anywhere within half an hour, past or future as far as there is one.
        let away = random.bits() % (1_800 * u64::from(TICK_HZ));
        let to = TriggerAlign {
            anchor: match round % 2 {
                0 => Ticks(now.0 + away),
                _ => Ticks(now.0.saturating_sub(away)),
            },
            period,
            slew: match round % 10 {
                9 => 0,
                _ => 100_000 + (random.bits() % 700_000) as u32,
            },
        };
        let command = AlignTrigger { output, to };
        let id = board.send(command);
        board.wait(2_000, |board| board.answers.iter().any(|a| a.id == id));
        let answer = board.answers.iter().find(|a| a.id == id).unwrap();
        let Ok(Reply::AlignTrigger(plan)) = answer.result else {
            panic!("{answer:?}");
        };
        board.wait(2_000, |board| board.arrived.iter().any(|a| a.command == id));
        let arrived = *board.arrived.iter().find(|a| a.command == id).unwrap();
        assert_eq!(
            (arrived.output, arrived.remaining),
            (output, TickDelta::ZERO)
        );
        assert_eq!(
            (arrived.pulse, arrived.at),
            (plan.arrival_pulse, plan.arrival)
        );
        // On the grid itself: anchor + j · period for a whole j, exactly.
        let away = (arrived.at - to.anchor).as_secs_f64() / period.as_secs_f64();
        let exact = EdgeGrid::new(to.anchor, period).edge(away.round() as i64);
        assert_eq!(arrived.at, exact.ticks, "round {round}");

        board.run(40);
        let pins = pulses_of(&board.rig.take_edges(), pin);
        let reports = match output {
            Output::Camera => std::mem::take(&mut board.pulses),
            _ => std::mem::take(&mut board.outputs),
        };
        assert_eq!(pins.len(), reports.len());
        for (&(rise, _), report) in pins.iter().zip(&reports) {
            assert_eq!(epoch.tick(rise, report.at), report.at);
            if let Some(previous) = previous {
                assert_eq!(report.number, previous.number + 1, "lost or doubled");
                let moved = (report.at - previous.at).0 - i64::from(period.ticks());
                // Whole edges jitter by a tick around the fraction.
                let most = match to.slew {
                    0 => period.ticks() / 2 + 1,
                    slew => slew + 1,
                };
                assert!(moved.unsigned_abs() <= most.into(), "moved by {moved}");
            }
            assert!(report.aligned || report.number < arrived.pulse);
            previous = Some(*report);
        }
        // Once more: it is there already, and nothing moves.
        if round % 20 == 0 {
            let again = board.ask(command).unwrap();
            assert_eq!((again.shift, again.frames), (TickDelta::ZERO, 0));
        }
    }
}

/// Ringing after each edge, shorter than the filter's eight samples, makes no edge.
#[test]
fn ringing_on_the_strobe_input_makes_no_edges() {
    let mut strobe = Strobe::flashes();
    // 5 excursions of 83 ns within 1 µs.
    strobe.ringing = Some((5, SimDuration::from_nanos(83)));
    let mut board = Board::boot(wiring::board().model(strobe));
    start(&mut board, picos(33_333_333_330), WIDTH);
    board.run(3_000);
    board.stop();
    board.run(200);
    assert_eq!(board.strobe.len(), 18 * board.pulses.len());
    for (index, capture) in board.strobe.iter().enumerate() {
        assert_eq!(capture.edge == Edge::Rising, index % 2 == 0, "edge {index}");
        assert!(!capture.after_loss);
    }
}

/// A pulse needs no software: the core stands still in the middle of it, as under a
/// debugger, and it ends where it should.
#[test]
fn a_pulse_ends_by_itself() {
    let mut board = board();
    let period = picos(33_333_333_330);
    let first = start(&mut board, period, MIN_PULSE_WIDTH).next_edge;
    board.run(50);
    for round in 0..20 {
        // To 5 µs after the rise: half of the pulse.
        while !board.rig.level(Pin::PA5).is_high() {
            board.rig.run_for(SimDuration::from_micros(5)).unwrap();
        }
        board.rig.halt_core(SimDuration::from_millis(1 + round));
        assert!(!board.rig.level(Pin::PA5).is_high(), "round {round}");
        board.run(3);
    }
    check_train(&mut board, first, period, MIN_PULSE_WIDTH);
}
