//! Every check of the board test on a board that is wrong in just that way, and on one at the edge
//! of its limits.
//!
//! A board in order is measured once on the simulator, and what it said is kept. The board test
//! then runs on that again, as it was or with the messages changed as a wrong board would have
//! sent them. Its commands and their times are the same, so the rest stays as it was.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ::bring_up::{Operator, Part, Plan, Report, run};
use board::Board;
use board::transport::{Link, LinkError};
use protocol::{
    Answer, CORE_HZ, Decoder, DeviceToHost, Edge, HandlerTime, ImuClock, MAX_FRAME, MIN_PULSE_GAP,
    Output, QueryImu, Reply, Request, Status, TickDelta, encode,
};
use recording::finding::Severity;
use rig::jumpers::Jumpers;
use stm32f4_sim::shared::lock;

use crate::bring_up::Bench;

/// What came from the board, or nothing, and the time then.
type Tape = Vec<(Duration, Vec<u8>)>;

/// A link that keeps what comes.
pub(crate) struct Kept {
    pub(crate) link: Box<dyn Link>,
    pub(crate) tape: Arc<Mutex<Tape>>,
}

impl Link for Kept {
    fn now(&self) -> Duration {
        self.link.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.link.send(bytes)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let before = into.len();
        self.link.receive(into, wait)?;
        lock(&self.tape).push((self.link.now(), into[before..].to_vec()));
        Ok(())
    }

    fn pause(&mut self, time: Duration) {
        self.link.pause(time);
        lock(&self.tape).push((self.link.now(), Vec::new()));
    }
}

/// Changes a message, while pulses of this output come; false: it never came.
type Change = fn(&mut DeviceToHost, Output) -> bool;

/// A link on which it comes again.
struct Replayed {
    tape: VecDeque<(Duration, Vec<u8>)>,
    now: Duration,
    decoder: Decoder<DeviceToHost>,
    change: Change,
    /// Of the last pulse.
    output: Output,
}

impl Replayed {
    fn next(&mut self) -> Result<Vec<u8>, LinkError> {
        let reason = || LinkError::Gone {
            reason: "the tape is at its end".into(),
        };
        let (now, bytes) = self.tape.pop_front().ok_or_else(reason)?;
        self.now = now;
        Ok(bytes)
    }
}

impl Link for Replayed {
    fn now(&self) -> Duration {
        self.now
    }

    fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
        Ok(())
    }

    fn receive(&mut self, into: &mut Vec<u8>, _: Duration) -> Result<(), LinkError> {
        let bytes = self.next()?;
        let mut rest = bytes.as_slice();
        while let Some(message) = self.decoder.next(&mut rest) {
            let mut message = message.unwrap();
            if let DeviceToHost::Pulse(pulse) = &message {
                self.output = pulse.output;
            }
            if (self.change)(&mut message, self.output) {
                let mut buffer = [0; MAX_FRAME];
                into.extend_from_slice(encode(&message, &mut buffer).unwrap());
            }
        }
        Ok(())
    }

    fn pause(&mut self, _: Duration) {
        self.next().unwrap();
    }
}

/// What a board in order says to these parts of the test, with somebody at its wires.
fn tape(parts: &[Part], clock: Duration) -> Tape {
    let tape = Arc::new(Mutex::new(Tape::new()));
    let kept = Arc::clone(&tape);
    let mut bench = Bench::with_link(31, Jumpers::default(), |link| {
        Box::new(Kept { link, tape: kept })
    });
    let report = bench.measure_attended_for(parts, clock, false);
    for check in &report.checks {
        assert_eq!(check.finding.severity, Severity::Good, "{check:?}");
    }
    drop(bench);
    std::mem::take(&mut *lock(&tape))
}

fn replay(tape: &Tape, parts: &[Part], clock: Duration, change: Change) -> Report {
    let link = Replayed {
        tape: tape.iter().cloned().collect(),
        now: Duration::ZERO,
        decoder: Decoder::new(),
        change,
        output: Output::Camera,
    };
    let mut board = Board::connect_from(Box::new(link), 1).unwrap();
    let obeys = Operator {
        say: &|_| {},
        is_there: true,
        stop: &|| false,
    };
    let plan = Plan {
        parts,
        clock,
        keep: false,
    };
    run(&mut board, obeys, plan).unwrap()
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

/// Pulses of an output that say to be so many ticks earlier than they are.
fn further(
    message: &mut DeviceToHost,
    output: Output,
    which: fn(&protocol::Pulse) -> bool,
    early: i64,
) -> bool {
    if let DeviceToHost::Pulse(pulse) = message
        && pulse.output == output
        && which(pulse)
    {
        pulse.at = pulse.at - TickDelta(early);
    }
    true
}

fn falling(message: &mut DeviceToHost, is_so: bool, late: i64) -> bool {
    capture(message, |c| {
        if is_so && c.edge == Edge::Falling {
            c.at = c.at + TickDelta(late);
        }
    })
}

/// Some edges on the way to another phase are so late.
fn slewing(message: &mut DeviceToHost, late: i64) -> bool {
    pulse(message, |p| {
        if !p.aligned && p.number % 5 == 0 {
            p.at = p.at + TickDelta(late);
        }
    })
}

/// Filler of so many bytes, of 240.
fn filler(message: &mut DeviceToHost, bytes: usize) -> bool {
    if let DeviceToHost::Filler(filler) = message {
        filler.payload.truncate(bytes);
    }
    true
}

fn worst(time: &mut HandlerTime, micros: u32) {
    time.worst = micros * (CORE_HZ / 1_000_000);
}

/// Times of samples by a sensor's clock that is so many ppm slow.
fn off_by(message: &mut DeviceToHost, ppm: u64) -> bool {
    if let DeviceToHost::Imu(sample) = message {
        sample.at.0 += sample.at.0 * ppm / 1_000_000;
    }
    true
}

/// The longest delay of a capture that passes, ticks.
const LONGEST: i64 = 24;

/// Checks that fail, a board at its limit, a board that is wrong in just that way.
type Row = (&'static str, Option<Change>, Change);

const TRIGGER: &[Row] = &[
    ("edges on their ticks", None, |m, _| {
        pulse(m, |p| {
            p.at = p.at + TickDelta(i64::from(p.number == 7 && p.train == 1))
        })
    }),
    // Captures would move with the edges; here they stay. The board in order is at the limit: the
    // fraction of its period takes the one tick.
    ("slew, strobe input", None, |m, _| slewing(m, 3)),
    (
        "read-back",
        Some(|m, _| pulse(m, |p| p.readback = Some(LONGEST as i32))),
        |m, _| pulse(m, |p| p.readback = Some(LONGEST as i32 + 1)),
    ),
    ("read-back", None, |m, _| {
        pulse(m, |p| {
            if p.number == 5 {
                p.readback = None;
            }
        })
    }),
    // Edges that come late by some ticks, which no message says.
    ("read-back", None, |m, _| {
        pulse(m, |p| {
            p.readback = p
                .readback
                .map(|delay| delay + 2 * i32::from(p.number % 5 == 0))
        })
    }),
    (
        "strobe input",
        Some(|m, _| capture(m, |c| c.at = c.at + TickDelta(LONGEST - 3))),
        |m, _| capture(m, |c| c.at = c.at + TickDelta(LONGEST - 2)),
    ),
    ("strobe input", None, |m, _| match m {
        DeviceToHost::Capture(capture) => capture.seq != 10 && capture.seq != 11,
        _ => true,
    }),
    (
        "pulse width",
        Some(|m, _| {
            capture(m, |c| {
                c.at = c.at + TickDelta(i64::from(c.edge == Edge::Falling))
            })
        }),
        |m, _| {
            capture(m, |c| {
                c.at = c.at + TickDelta(2 * i64::from(c.edge == Edge::Falling))
            })
        },
    ),
];

const OUTPUTS: &[Row] = &[
    ("output 2 on the strobe input", None, |m, _| {
        further(m, Output::Two, |p| p.number % 20 == 9, 2)
    }),
    (
        "pulse width of output 2",
        Some(|m, output| falling(m, output == Output::Two, 1)),
        |m, output| falling(m, output == Output::Two, 2),
    ),
    ("output 2 beside the trigger", None, |m, _| {
        further(m, Output::Two, |_| true, 1)
    }),
    ("output 3 on the strobe input", None, |m, _| {
        further(m, Output::Three, |p| p.number % 20 == 9, 2)
    }),
    (
        "pulse width of output 3",
        Some(|m, output| falling(m, output == Output::Three, 1)),
        |m, output| falling(m, output == Output::Three, 2),
    ),
    ("output 3 beside the trigger", None, |m, _| {
        further(m, Output::Three, |_| true, 1)
    }),
    ("output 4 on the strobe input", None, |m, _| {
        further(m, Output::Four, |p| p.number % 20 == 9, 2)
    }),
    (
        "pulse width of output 4",
        Some(|m, output| falling(m, output == Output::Four, 1)),
        |m, output| falling(m, output == Output::Four, 2),
    ),
    ("output 4 beside the trigger", None, |m, _| {
        further(m, Output::Four, |_| true, 1)
    }),
];

const IMU: &[Row] = &[
    ("sample rate", Some(|m, _| off_by(m, 9)), |m, _| {
        off_by(m, 11)
    }),
    ("data-ready", None, |m, _| match m {
        DeviceToHost::Imu(sample) => sample.seq != 1_500,
        _ => true,
    }),
    ("trigger beside a failed IMU", None, |m, _| {
        pulse(m, |p| p.at = p.at + TickDelta(i64::from(p.number == 30)))
    }),
    (
        "trigger beside a failed IMU",
        Some(|m, _| {
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
    ("throughput", Some(|m, _| filler(m, 200)), |m, _| {
        filler(m, 120)
    }),
    ("a host that does not read", None, |m, _| {
        status(m, |s| s.dropped.imu *= 2)
    }),
    (
        "handlers",
        Some(|m, _| status(m, |s| s.trigger_latency = MIN_PULSE_GAP)),
        |m, _| status(m, |s| s.output_latency = MIN_PULSE_GAP + 1),
    ),
    ("handlers", None, |m, _| status(m, |s| s.trigger.late = 1)),
    (
        "handler of the trigger",
        Some(|m, _| status(m, |s| worst(&mut s.handlers.trigger, 20))),
        |m, _| status(m, |s| worst(&mut s.handlers.trigger, 21)),
    ),
    (
        "handler of the outputs",
        Some(|m, _| status(m, |s| worst(&mut s.handlers.outputs, 50))),
        |m, _| status(m, |s| worst(&mut s.handlers.outputs, 51)),
    ),
    (
        "handler of the hand-over",
        Some(|m, _| status(m, |s| worst(&mut s.handlers.handover, 1_000))),
        |m, _| status(m, |s| worst(&mut s.handlers.handover, 1_001)),
    ),
    (
        "handler of USB",
        Some(|m, _| status(m, |s| worst(&mut s.handlers.usb, 1_000))),
        |m, _| status(m, |s| worst(&mut s.handlers.usb, 1_001)),
    ),
    // A probe has left: calls, and a counter that stands still.
    ("handler of the trigger", None, |m, _| {
        status(m, |s| s.handlers.trigger.cycles = 0)
    }),
    ("handler of the hand-over", None, |m, _| {
        status(m, |s| s.handlers.handover.cycles = 0)
    }),
    ("handler of USB", None, |m, _| {
        status(m, |s| s.handlers.usb.cycles = 0)
    }),
    (
        "masked interrupts",
        Some(|m, _| status(m, |s| s.masked.all = 15 * (CORE_HZ / 1_000_000))),
        |m, _| status(m, |s| s.masked.all = 15 * (CORE_HZ / 1_000_000) + 1),
    ),
    (
        "masked interrupts",
        Some(|m, _| status(m, |s| s.masked.below_trigger = 100 * (CORE_HZ / 1_000_000))),
        |m, _| {
            status(m, |s| {
                s.masked.below_trigger = 100 * (CORE_HZ / 1_000_000) + 1
            })
        },
    ),
    (
        "core and stack",
        Some(|m, _| status(m, |s| s.cpu_permille = 900)),
        |m, _| status(m, |s| s.cpu_permille = 901),
    ),
    (
        "core and stack",
        Some(|m, _| status(m, |s| s.stack_used = s.stack_size / 100 * 80)),
        |m, _| status(m, |s| s.stack_used = s.stack_size / 100 * 82),
    ),
];

const CLOCK: &[Row] = &[
    (
        "supply",
        Some(|m, _| status(m, |s| s.supply_mv = Some(2_700))),
        |m, _| status(m, |s| s.supply_mv = Some(2_699)),
    ),
    (
        "supply",
        Some(|m, _| status(m, |s| s.supply_mv = Some(3_600))),
        |m, _| status(m, |s| s.supply_mv = Some(3_601)),
    ),
];

#[test]
fn every_check_fails_on_a_board_that_is_wrong_in_just_that_way() {
    let clock = Duration::from_secs(30);
    let mut known = Vec::new();
    let mut odd = Vec::new();
    for (parts, rows) in [
        (&[Part::Trigger][..], TRIGGER),
        (&[Part::Trigger, Part::Outputs], OUTPUTS),
        (&[Part::Imu], IMU),
        (&[Part::Link], LINK),
        (&[Part::Clock], CLOCK),
    ] {
        let tape = tape(parts, clock);
        let unchanged = replay(&tape, parts, clock, |_, _| true);
        known.extend(
            unchanged
                .checks
                .iter()
                .map(|check| check.finding.kind.clone()),
        );
        for (n, (name, at_limit, wrong)) in rows.iter().enumerate() {
            let failed = |change: Change| -> String {
                let report = replay(&tape, parts, clock, change);
                let bad = |c: &&::bring_up::Check| c.finding.severity == Severity::Bad;
                let bad = report.checks.iter().filter(bad);
                let names: Vec<&str> = bad.map(|check| check.finding.kind.as_str()).collect();
                names.join(", ")
            };
            let mut judge = |failed: String, expected: &str| {
                if failed != expected {
                    odd.push(format!("{name}, row {n}: {failed:?} for {expected:?}"));
                }
            };
            if let Some(at_limit) = at_limit {
                judge(failed(*at_limit), "");
            }
            judge(failed(*wrong), name);
        }
    }
    assert!(odd.is_empty(), "{odd:#?}");
    // No check is without a row, or held elsewhere.
    let elsewhere = ["crystal", "clock of the IMU", "recovery of the IMU"];
    let rows = [TRIGGER, OUTPUTS, IMU, LINK, CLOCK].concat();
    for name in known {
        let is_held = rows.iter().any(|row| row.0.contains(&*name)) || elsewhere.contains(&&*name);
        assert!(is_held, "nothing makes {name} fail");
    }
}

/// A sensor without its clock, or a clone without that input, is right with less.
#[test]
fn a_sensor_on_its_own_clock_is_said_and_does_not_fail() {
    let parts = [Part::Imu];
    let tape = tape(&parts, Duration::ZERO);
    let report = replay(&tape, &parts, Duration::ZERO, |m, _| {
        setup(m, |s| {
            s.status.clock = ImuClock::Internal;
            s.interval = s.interval / 100 * 103;
        })
    });
    for check in &report.checks {
        let expected = match &*check.finding.kind {
            "sample rate" | "clock of the IMU" => Severity::Check,
            _ => Severity::Good,
        };
        assert_eq!(check.finding.severity, expected, "{check:?}");
    }
}
