//! Every check of the board test on a board that is wrong in just that way, and on one at the edge
//! of its limits.
//!
//! A board in order is measured once on the simulator, and what it said is kept. The board test
//! then runs on that again, as it was or with the messages changed as a wrong board would have
//! sent them. Its commands and their times are the same, so the rest stays as it was.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use board::Board;
use board::bring_up::{BoardTestReport, Operator, Part, run};
use board::finding::Severity;
use board::transport::{Link, LinkError};
use protocol::{
    Answer, CORE_HZ, Decoder, DeviceToHost, Hello, MAX_FRAME, MIN_PULSE_GAP, Output, QueryImu,
    Reply, Request, ResetCause, Status, TICK_HZ, TickDelta, encode,
};
use rig::wiring;
use rig::wiring::jumpers::{Jumpers, Late};
use stm32f4_sim::pin::Pin;
use stm32f4_sim::shared::lock;

use crate::bring_up::{self, BringUpBench, plan};

/// Messages of the board over all links, with the time of each.
type Tape = Vec<(Duration, Entry)>;

#[derive(Clone, Debug)]
enum Entry {
    Connected,
    Bytes(Vec<u8>),
    Paused,
    GoneAtReceive,
    GoneAtSend,
}

/// A link that keeps what comes.
pub(crate) struct Kept {
    link: Box<dyn Link>,
    tape: Arc<Mutex<Tape>>,
}

impl Kept {
    fn around(link: Box<dyn Link>, tape: &Arc<Mutex<Tape>>) -> Box<dyn Link> {
        let tape = Arc::clone(tape);
        let mut kept = Self { link, tape };
        kept.note(Entry::Connected);
        Box::new(kept)
    }

    fn note(&mut self, entry: Entry) {
        lock(&self.tape).push((self.link.now(), entry));
    }
}

impl Link for Kept {
    fn now(&self) -> Duration {
        self.link.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let sent = self.link.send(bytes);
        if sent.is_err() {
            self.note(Entry::GoneAtSend);
        }
        sent
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let before = into.len();
        let received = self.link.receive(into, wait);
        self.note(match &received {
            Ok(()) => Entry::Bytes(into[before..].to_vec()),
            Err(_) => Entry::GoneAtReceive,
        });
        received
    }

    fn pause(&mut self, time: Duration) {
        self.link.pause(time);
        self.note(Entry::Paused);
    }
}

/// Changes a message, while pulses of this output come; false: it never came.
type Change = fn(&mut DeviceToHost, Output) -> bool;
type AnyChange = dyn Fn(&mut DeviceToHost, Output) -> bool;

/// A board that repeats the recorded messages.
struct Replay {
    tape: VecDeque<(Duration, Entry)>,
    now: Duration,
    change: Box<AnyChange>,
    /// Output of the last pulse.
    output: Output,
}

impl Replay {
    fn next(&mut self) -> Entry {
        let (now, entry) = self.tape.pop_front().expect("the tape is at its end");
        self.now = now;
        entry
    }
}

/// A link to it.
struct Replayed {
    replay: Rc<RefCell<Replay>>,
    decoder: Decoder<DeviceToHost>,
}

impl Replayed {
    fn connect(replay: &Rc<RefCell<Replay>>) -> Box<dyn Link> {
        assert!(matches!(replay.borrow_mut().next(), Entry::Connected));
        Box::new(Self {
            replay: Rc::clone(replay),
            decoder: Decoder::new(),
        })
    }
}

fn gone() -> LinkError {
    let reason = "so the tape says".into();
    LinkError::Gone { reason }
}

impl Link for Replayed {
    fn now(&self) -> Duration {
        self.replay.borrow().now
    }

    fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
        let mut replay = self.replay.borrow_mut();
        if matches!(replay.tape.front(), Some((_, Entry::GoneAtSend))) {
            replay.next();
            return Err(gone());
        }
        Ok(())
    }

    fn receive(&mut self, into: &mut Vec<u8>, _: Duration) -> Result<(), LinkError> {
        let mut replay = self.replay.borrow_mut();
        let bytes = match replay.next() {
            Entry::Bytes(bytes) => bytes,
            Entry::GoneAtReceive => return Err(gone()),
            other => panic!("{other:?} when it receives"),
        };
        let mut rest = bytes.as_slice();
        while let Some(message) = self.decoder.next(&mut rest) {
            // Half a frame, where a link ended.
            let Ok(mut message) = message else { continue };
            if let DeviceToHost::Pulse(pulse) = &message {
                replay.output = pulse.output;
            }
            if (replay.change)(&mut message, replay.output) {
                let mut buffer = [0; MAX_FRAME];
                into.extend_from_slice(encode(&message, &mut buffer).unwrap());
            }
        }
        Ok(())
    }

    fn pause(&mut self, _: Duration) {
        assert!(matches!(self.replay.borrow_mut().next(), Entry::Paused));
    }
}

/// Records the messages of a good board in these parts of the test, with a person at its wires.
fn tape(parts: &[Part]) -> Tape {
    let (tape, report) = tape_of(parts, |_| {});
    for check in &report.checks {
        assert_eq!(check.finding.severity, Severity::Good, "{check:?}");
    }
    tape
}

/// The same of a board that `prepare` has changed.
fn tape_of(parts: &[Part], prepare: impl FnOnce(&BringUpBench)) -> (Tape, BoardTestReport) {
    let tape = Arc::new(Mutex::new(Tape::new()));
    let kept = Arc::clone(&tape);
    let mut bench = BringUpBench::with_link(31, Jumpers::default(), move |link| {
        Kept::around(link, &kept)
    });
    prepare(&bench);
    let report = bench.measure_attended(&plan(parts));
    drop(bench);
    let said = std::mem::take(&mut *lock(&tape));
    (said, report)
}

fn replay(
    tape: &Tape,
    parts: &[Part],
    change: impl Fn(&mut DeviceToHost, Output) -> bool + 'static,
) -> BoardTestReport {
    let replay = Rc::new(RefCell::new(Replay {
        tape: tape.iter().cloned().collect(),
        now: Duration::ZERO,
        change: Box::new(change),
        output: Output::Camera,
    }));
    let mut board = Board::connect_from(Replayed::connect(&replay), 1).unwrap();
    let obeys = Operator {
        say: &|_| {},
        is_there: true,
        skips: &|| false,
        stop: &|| false,
        reconnect: &|_| Ok(Replayed::connect(&replay)),
    };
    run(&mut board, obeys, plan(parts)).unwrap()
}

fn status(message: &mut DeviceToHost, change: impl FnOnce(&mut Status)) -> bool {
    if let DeviceToHost::Status(status) = message {
        change(status);
    }
    true
}

fn pulse(message: &mut DeviceToHost, change: impl FnOnce(&mut protocol::Pulse)) -> bool {
    if let DeviceToHost::Pulse(pulse) = message
        && pulse.output == Output::Camera
    {
        change(pulse);
    }
    true
}

/// The pulse with this number is a tick late.
fn late_at(message: &mut DeviceToHost, number: u64) -> bool {
    pulse(message, |p| {
        p.at = p.at + TickDelta(i64::from(p.number == number))
    })
}

/// The pulse with this number was not read back.
fn unread(message: &mut DeviceToHost, number: u64) -> bool {
    pulse(message, |p| {
        p.readback = p.readback.filter(|_| p.number != number)
    })
}

fn capture(message: &mut DeviceToHost, change: impl FnOnce(&mut protocol::Capture)) -> bool {
    if let DeviceToHost::Capture(capture) = message {
        change(capture);
    }
    true
}

fn setup(message: &mut DeviceToHost, change: impl FnOnce(&mut protocol::ImuSetup)) -> bool {
    if let DeviceToHost::Answer(Answer {
        result: Ok(reply @ Reply::QueryImu(_)),
        ..
    }) = message
    {
        let mut setup = QueryImu::unwrap(reply.clone()).unwrap();
        change(&mut setup);
        *reply = QueryImu::wrap(setup);
    }
    true
}

/// Makes some edges on the way to another phase late.
fn slewing(message: &mut DeviceToHost, late: i64) -> bool {
    pulse(message, |p| {
        if !p.aligned && p.number % 5 == 0 {
            p.at = p.at + TickDelta(late);
        }
    })
}

/// Cuts the filler, of 240 bytes, to this length.
fn filler(message: &mut DeviceToHost, bytes: usize) -> bool {
    if let DeviceToHost::Filler(filler) = message {
        filler.payload.truncate(bytes);
    }
    true
}

/// Gives samples the times of a sensor's clock that is slow by some ppm.
fn off_by(message: &mut DeviceToHost, ppm: u64) -> bool {
    if let DeviceToHost::Imu(sample) = message {
        sample.at.0 += sample.at.0 * ppm / 1_000_000;
    }
    true
}

/// A board at the edge of the limit, which passes.
#[derive(Clone, Copy)]
enum AtLimit {
    /// The limit is 0 or an exact text: any board in order.
    InOrder,
    By(Change),
    /// In another row of this check.
    Elsewhere,
}
use AtLimit::{By, Elsewhere, InOrder};

/// Checks that fail, a board at its limit, a board that is wrong in just that way.
type Row = (&'static str, AtLimit, Change);

/// A check, a figure at its limit, and how much more fails.
type Limit = (&'static str, &'static str, (u32, i32));

const TRIGGER: &[Row] = &[
    ("edges on their ticks", InOrder, |m, _| {
        pulse(m, |p| {
            p.at = p.at + TickDelta(i64::from(p.number == 7 && p.train == 1))
        })
    }),
    // Captures would move with the edges; here they stay. The board in order is at the limit: the
    // fraction of its period takes the one tick.
    ("slew, strobe input", InOrder, |m, _| slewing(m, 3)),
    ("read-back", Elsewhere, |m, _| unread(m, 5)),
    ("strobe input", Elsewhere, |m, _| match m {
        DeviceToHost::Capture(capture) => capture.seq != 10 && capture.seq != 11,
        _ => true,
    }),
];

const IMU: &[Row] = &[
    ("sample rate", By(|m, _| off_by(m, 9)), |m, _| off_by(m, 11)),
    ("data-ready", InOrder, |m, _| match m {
        DeviceToHost::Imu(sample) => sample.seq != 1_500,
        _ => true,
    }),
    ("trigger beside a failed IMU", Elsewhere, |m, _| {
        late_at(m, 30)
    }),
    (
        "trigger beside a failed IMU",
        By(|m, _| {
            pulse(m, |p| {
                p.readback = p.readback.map(|delay| delay + i32::from(p.number == 30))
            })
        }),
        |m, _| {
            pulse(m, |p| {
                p.readback = p
                    .readback
                    .map(|delay| delay + 2 * i32::from(p.number == 30))
            })
        },
    ),
];

const LINK: &[Row] = &[
    ("throughput", By(|m, _| filler(m, 200)), |m, _| {
        filler(m, 120)
    }),
    ("a host that does not read", InOrder, |m, _| {
        status(m, |s| s.dropped.imu *= 2)
    }),
    ("handlers", Elsewhere, |m, _| {
        status(m, |s| s.trigger.late = 1)
    }),
    // A probe has left: calls, and a counter that stands still.
    ("handler of the trigger", Elsewhere, |m, _| {
        status(m, |s| s.handlers.trigger.cycles = 0)
    }),
    ("handler of the hand-over", Elsewhere, |m, _| {
        status(m, |s| s.handlers.handover.cycles = 0)
    }),
    ("handler of USB", Elsewhere, |m, _| {
        status(m, |s| s.handlers.usb.cycles = 0)
    }),
];

/// A figure of the status is this much.
fn set(message: &mut DeviceToHost, figure: &str, n: u32) -> bool {
    status(message, |s| match figure {
        "trigger latency" => s.trigger_latency = n,
        "output latency" => s.output_latency = n,
        "trigger" => s.handlers.trigger.worst = n * MICROSECOND,
        "outputs" => s.handlers.outputs.worst = n * MICROSECOND,
        "hand-over" => s.handlers.handover.worst = n * MICROSECOND,
        "USB" => s.handlers.usb.worst = n * MICROSECOND,
        "all masked" => s.masked.all = n,
        "masked" => s.masked.below_trigger = n,
        "core" => s.cpu_permille = n as u16,
        "stack" => s.stack_used = s.stack_size * n / 100,
        "supply" => s.supply_mv = Some(n as u16),
        other => panic!("{other}"),
    })
}

const MICROSECOND: u32 = CORE_HZ / 1_000_000;

/// Checks that pass at a limit of a figure and fail beyond it.
const LINK_LIMITS: &[Limit] = &[
    ("handlers", "trigger latency", (MIN_PULSE_GAP, 1)),
    ("handlers", "output latency", (MIN_PULSE_GAP, 1)),
    ("handler of the trigger", "trigger", (20, 1)),
    ("handler of the outputs", "outputs", (50, 1)),
    ("handler of the hand-over", "hand-over", (1_000, 1)),
    ("handler of USB", "USB", (1_000, 1)),
    ("masked interrupts", "all masked", (15 * MICROSECOND, 1)),
    ("masked interrupts", "masked", (100 * MICROSECOND, 1)),
    ("core and stack", "core", (900, 1)),
    ("core and stack", "stack", (80, 2)),
];

const CLOCK_LIMITS: &[Limit] = &[
    ("supply", "supply", (2_700, -1)),
    ("supply", "supply", (3_600, 1)),
];

/// Moves edges of the serial line: by a factor from the beginning of their sentence, and later by
/// some ticks.
fn of_line(message: &mut DeviceToHost, times: f64, later: i64) -> bool {
    capture(message, |c| {
        let begins = 2_400_000;
        let place = c.at.0 % u64::from(TICK_HZ);
        if place >= begins {
            let moved = (place - begins) as f64 * (times - 1.0);
            c.at = c.at + TickDelta(moved.round() as i64 + later);
        }
    })
}

fn pps(message: &mut DeviceToHost, change: impl FnOnce(&mut protocol::Pps)) -> bool {
    if let DeviceToHost::Pps(pps) = message {
        change(pps);
    }
    true
}

const LIDAR: &[Row] = &[
    ("whole seconds", InOrder, |m, _| {
        pps(m, |p| p.at = p.at + TickDelta(1))
    }),
    // 9 bits at a rate that is 0.2 % off are 90 ticks; at 0.3 % they are 135.
    ("serial line", By(|m, _| of_line(m, 1.002, 0)), |m, _| {
        of_line(m, 1.003, 0)
    }),
    ("serial line", Elsewhere, |m, _| of_line(m, 1.0, 6 * 48_000)),
    ("serial line", Elsewhere, |m, _| pps(m, |p| p.utc += 1)),
];

const EACH_REPLUG: &str = "leaving the bus, unplugged cable, sleep of the computer";

const REPLUG: &[Row] = &[
    (EACH_REPLUG, InOrder, |m, _| late_at(m, 20)),
    (EACH_REPLUG, Elsewhere, |m, _| {
        status(m, |s| s.dropped.imu *= 2)
    }),
    (EACH_REPLUG, Elsewhere, |m, _| unread(m, 20)),
    // Messages are lost that the board does not count.
    (EACH_REPLUG, Elsewhere, |m, _| {
        status(m, |s| s.dropped.imu /= 2)
    }),
    // Some 2,500 samples are lost while it sleeps: 50 of them uncounted, or 63. 57 is the limit.
    (
        "sleep of the computer",
        By(|m, _| status(m, |s| s.dropped.imu -= s.dropped.imu / 50)),
        |m, _| status(m, |s| s.dropped.imu -= s.dropped.imu / 40),
    ),
];

fn hello(message: &mut DeviceToHost, change: impl FnOnce(&mut Hello)) -> bool {
    if let DeviceToHost::Hello(hello) = message {
        change(hello);
    }
    true
}

/// Names another cause for the reset that left a panic with this text.
fn misnamed(message: &mut DeviceToHost, panic: &str) -> bool {
    hello(message, |h| {
        if h.last_panic
            .as_deref()
            .is_some_and(|text| text.contains(panic))
        {
            h.reset_cause = ResetCause::Pin;
        }
    })
}

/// Reports a panic of a run that ended by this cause, without one.
fn rumour(message: &mut DeviceToHost, cause: ResetCause) -> bool {
    hello(message, |h| {
        if h.reset_cause == cause {
            h.last_panic.clone_from(&h.kept_panic);
        }
    })
}

const RESETS: &[Row] = &[
    ("after a panic", InOrder, |m, _| misnamed(m, "on request")),
    ("after a panic", Elsewhere, |m, _| {
        hello(m, |h| {
            if h.last_panic
                .as_deref()
                .is_some_and(|text| text.contains("on request"))
            {
                h.last_panic = None;
            }
        })
    }),
    // The flash did not keep it.
    ("after a fault", InOrder, |m, _| {
        hello(m, |h| {
            if h.kept_panic
                .as_deref()
                .is_some_and(|text| text.contains("HardFault"))
            {
                h.kept_panic = None;
            }
        })
    }),
    ("after a fault", Elsewhere, |m, _| misnamed(m, "HardFault")),
    ("after a stack overflow", InOrder, |m, _| {
        misnamed(m, "tasks' stack")
    }),
    ("after a handler's overflow", InOrder, |m, _| {
        misnamed(m, "handlers' stack")
    }),
    ("after a hang, after a task that died", InOrder, |m, _| {
        rumour(m, ResetCause::Watchdog)
    }),
    ("after a hang, after a task that died", Elsewhere, |m, _| {
        hello(m, |h| {
            if h.reset_cause == ResetCause::Watchdog {
                h.reset_cause = ResetCause::Unknown;
            }
        })
    }),
    ("after the reset button", InOrder, |m, _| {
        rumour(m, ResetCause::Pin)
    }),
    ("after power-off", InOrder, |m, _| {
        rumour(m, ResetCause::PowerOn)
    }),
    // What the panic left did not survive it.
    ("after power-off", Elsewhere, |m, _| {
        hello(m, |h| {
            if h.reset_cause == ResetCause::PowerOn {
                h.kept_panic = None;
            }
        })
    }),
];

const SOAK: &[Row] = &[
    ("soak", InOrder, |m, _| late_at(m, 2_000)),
    ("soak", Elsewhere, |m, _| unread(m, 2_000)),
    ("soak", Elsewhere, |m, _| status(m, |s| s.dropped.imu *= 2)),
];

/// Parts, edges that are late at the pins, and the checks that fail by it: none of boards at a limit.
/// Three of the 24 ticks from an edge to its capture are the input's.
const AT_THE_PINS: &[(&[Part], Late, &str)] = &[
    // Nothing but the falling edges at the strobe input is one tick later than the others.
    (
        &[Part::Trigger],
        |to, _, level, _| 21 + u64::from(to == wiring::STROBE && !level.is_high()),
        "",
    ),
    (
        &[Part::Trigger],
        |to, _, _, _| 22 * u64::from(to == wiring::READBACK),
        "read-back",
    ),
    (
        &[Part::Trigger],
        |to, _, _, n| 2 * u64::from(to == wiring::READBACK && n % 5 == 0),
        "read-back",
    ),
    (
        &[Part::Trigger],
        |to, _, _, _| 22 * u64::from(to == wiring::STROBE),
        "strobe input",
    ),
    (
        &[Part::Trigger],
        |to, _, _, n| 2 * u64::from(to == wiring::STROBE && n % 5 == 0),
        "strobe input",
    ),
    (
        &[Part::Trigger],
        |to, _, level, _| 2 * u64::from(to == wiring::STROBE && !level.is_high()),
        "pulse width",
    ),
    (
        &[Part::Trigger, Part::Outputs],
        |_, from, _, n| u64::from(from != wiring::TRIGGER && n % 20 == 9),
        "",
    ),
    (
        &[Part::Outputs],
        |_, from, _, n| 2 * u64::from(from != wiring::TRIGGER && n % 20 == 9),
        "output 2 on the strobe input, output 3 on the strobe input, output 4 on the strobe input",
    ),
    (
        &[Part::Outputs],
        |_, from, level, _| 2 * u64::from(from != wiring::TRIGGER && !level.is_high()),
        "pulse width of output 2, pulse width of output 3, pulse width of output 4",
    ),
    (
        &[Part::Trigger, Part::Outputs],
        |_, from, _, _| u64::from(from != wiring::TRIGGER),
        "output 2 beside the trigger, output 3 beside the trigger, output 4 beside the trigger",
    ),
    (
        &[Part::Lidar],
        |_, from, _, n| (n % 2) * u64::from(from == Pin::PE9),
        "",
    ),
    (
        &[Part::Lidar],
        |_, from, _, n| 2 * (n % 2) * u64::from(from == Pin::PE9),
        "pulse per second",
    ),
    (
        &[Part::Lidar],
        |_, from, level, _| 2 * u64::from(from == Pin::PE9 && !level.is_high()),
        "width of the pulse per second",
    ),
];

#[test]
fn edges_that_are_late_at_the_pins_fail() {
    for (n, &(parts, late, expected)) in AT_THE_PINS.iter().enumerate() {
        let jumpers = Jumpers {
            late: Some(late),
            ..Jumpers::default()
        };
        let report =
            BringUpBench::with_link(31, jumpers, |link| link).measure_attended(&plan(parts));
        assert_eq!(failed(&report), expected, "row {n}: {report:#?}");
    }
}

/// Names of the checks that failed.
fn failed(report: &BoardTestReport) -> String {
    let bad = |c: &&board::bring_up::Check| c.finding.severity == Severity::Bad;
    let names: Vec<_> = (report.checks.iter().filter(bad))
        .map(|check| check.finding.kind.to_string())
        .collect();
    names.join(", ")
}

/// Checks of which wrong boards and those at a limit are in another test, of wires and parts.
const TESTS: &[(&str, fn())] = &[
    (
        "read-back after the buffer",
        bring_up::a_divider_that_is_loaded_too_much_fails,
    ),
    (
        "pulse after the buffer",
        bring_up::a_divider_that_is_loaded_too_much_fails,
    ),
    (
        "crystal",
        bring_up::the_crystal_is_compared_with_the_computers_clock,
    ),
    (
        "clock of the IMU",
        a_sensor_on_its_own_clock_is_reported_and_does_not_fail,
    ),
    (
        "IMU without its clock",
        bring_up::a_sensor_goes_on_without_its_clock_and_not_without_data_ready,
    ),
    (
        "recovery of the IMU",
        bring_up::the_sensor_recovers_from_a_wire_that_bounces_and_not_from_a_loose_one,
    ),
    (
        "inverted serial line",
        bring_up::a_line_that_is_high_when_idle_is_reported,
    ),
];

/// One after the other, with somebody at the board's wires.
const IN_ORDER: &[Part] = &[
    Part::Trigger,
    Part::Outputs,
    Part::Lidar,
    Part::Imu,
    Part::Link,
];

/// Each row by itself, and no check of any part without a row and a limit.
#[test]
fn each_check_fails_on_a_board_with_that_one_fault() {
    let tables: [(&[Part], &[Row], &[Limit]); 10] = [
        (&[Part::Trigger], TRIGGER, &[]),
        (IN_ORDER, &[], &[]),
        (&[Part::Lidar], LIDAR, &[]),
        (&[Part::Imu], IMU, &[]),
        (&[Part::Link], LINK, LINK_LIMITS),
        (&[Part::Clock], &[], CLOCK_LIMITS),
        (&[Part::Replug], REPLUG, &[]),
        (&[Part::Resets], RESETS, &[]),
        (&[Part::Buffer], &[], &[]),
        (&[Part::Soak], SOAK, &[]),
    ];
    let (mut odd, mut known) = (Vec::new(), Vec::new());
    for (parts, rows, limits) in tables {
        let tape = tape(parts);
        let judge = |change: Change, expected: &str| {
            let report = replay(&tape, parts, change);
            let failed = failed(&report);
            (failed != expected).then(|| format!("{failed:?} for {expected:?}"))
        };
        for (n, (name, at_limit, wrong)) in rows.iter().enumerate() {
            let at_limit = match at_limit {
                By(change) => judge(*change, ""),
                InOrder | Elsewhere => None,
            };
            let found = at_limit.into_iter().chain(judge(*wrong, name));
            odd.extend(found.map(|what| format!("{name}, row {n}: {what}")));
        }
        for &(name, figure, (limit, more)) in limits {
            for (n, expected) in [(limit, ""), (limit.wrapping_add_signed(more), name)] {
                let failed = failed(&replay(&tape, parts, move |m, _| set(m, figure, n)));
                if failed != expected {
                    odd.push(format!("{name}, {figure} {n}: {failed:?}"));
                }
            }
        }
        let unchanged = replay(&tape, parts, |_, _| true);
        for check in &unchanged.checks {
            assert_eq!(check.finding.severity, Severity::Good, "{check:?}");
        }
        if parts == IN_ORDER {
            let page = report::board_test::page(&unchanged);
            // The simulated sensor's intervals are all alike: no drawing, but a line.
            let intervals = "data-ready. All ";
            assert!(
                page.contains("checks passed") && page.contains(intervals),
                "{page}"
            );
        }
        let checks = unchanged.checks.into_iter();
        known.extend(checks.map(|check| check.finding.kind.to_string()));
    }
    assert!(odd.is_empty(), "{odd:#?}");
    let all = || tables.iter().flat_map(|(_, rows, _)| rows.iter());
    let names = |row: &Row| row.0.split(", ").collect::<Vec<_>>();
    let at_pins = || AT_THE_PINS.iter().flat_map(|row| row.2.split(", "));
    let limits = || {
        tables
            .iter()
            .flat_map(|(.., limits)| limits.iter().map(|limit| limit.0))
    };
    let in_tests = || {
        at_pins()
            .chain(TESTS.iter().map(|(name, _)| *name))
            .chain(limits())
    };
    for name in &known {
        let rows: Vec<&Row> = all().filter(|row| names(row).contains(&&**name)).collect();
        let has_limit = rows.iter().any(|row| !matches!(row.1, Elsewhere));
        let has_test = in_tests().any(|check| check == name);
        assert!(has_limit || has_test, "no board for {name}");
    }
    let rows = all()
        .flat_map(names)
        .chain(in_tests().filter(|name| !name.is_empty()));
    for name in rows {
        assert!(
            known.iter().any(|check| check == name),
            "nothing checks {name}"
        );
    }
}

/// A sensor without its clock, or a clone without that input, is right with less.
#[test]
fn a_sensor_on_its_own_clock_is_reported_and_does_not_fail() {
    let parts = [Part::Imu];
    let (tape, _) = tape_of(&parts, BringUpBench::cut_imu_clock);
    // A clone's clock is farther off than the data sheet has it.
    let report = replay(&tape, &parts, |m, _| {
        setup(m, |s| s.interval = s.interval / 100 * 103)
    });
    for check in &report.checks {
        let expected = match check.finding.kind.to_string().as_str() {
            "sample rate" | "clock of the IMU" => Severity::Check,
            _ => Severity::Good,
        };
        assert_eq!(check.finding.severity, expected, "{check:?}");
    }
}
