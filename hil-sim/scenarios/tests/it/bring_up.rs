//! The board test on the simulated board, on virtual time: it passes with the wires as the
//! book says, and names what is wrong with them where they are not.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use ::bring_up::{BringUpError, Check, Operator, Part, Plan, Prompt, Report, run};
use ::session::devices::Connector;
use board::Board;
use board::transport::{Link, LinkError};
use protocol::{
    BoardSettings, Failure, MIN_PULSE_WIDTH, Output, Period, QueryBoard, SELF_TEST_KEY, SelfTest,
    SetBoard, TrainState, TriggerStart,
};
use recording::finding::Severity;
use rig::imu::Fault;
use rig::jumpers::Jumpers;
use rig::random::Seed;
use rig::rig_config::RigConfig;
use rig::virtual_rig::VirtualRig;
use rig::wiring;
use scenarios::virtual_session::SharedRig;
use stm32f4_sim::shared::lock;
use stm32f4_sim::time::SimDuration;

/// A board with its wires, and whoever is at it.
pub(crate) struct Bench {
    rig: SharedRig,
    jumpers: Arc<Mutex<Jumpers>>,
    board: Board,
}

impl Bench {
    fn new(seed: u64, jumpers: Jumpers) -> Self {
        Self::with_link(seed, jumpers, |link| link)
    }

    /// What is said goes through another link.
    pub(crate) fn with_link(
        seed: u64,
        jumpers: Jumpers,
        through: impl FnOnce(Box<dyn Link>) -> Box<dyn Link>,
    ) -> Self {
        let mut config = RigConfig::published(Seed(seed));
        config.depth_camera = None;
        let jumpers = Arc::new(Mutex::new(jumpers));
        let board = wiring::board().model(Arc::clone(&jumpers));
        let rig = VirtualRig::new(config, board, Vec::new()).unwrap();
        let mut rig = SharedRig::boot(rig).unwrap();
        let link = rig.connect(None).unwrap();
        let board = Board::connect_from(through(link), 1).unwrap();
        Self {
            rig,
            jumpers,
            board,
        }
    }

    /// Measures with nobody at the board.
    fn measure(&mut self, parts: &[Part], clock: Duration) -> Result<Report, BringUpError> {
        let nobody = Operator {
            say: &|_| {},
            is_there: false,
            stop: &|| false,
        };
        let plan = Plan {
            parts,
            clock,
            keep: false,
        };
        run(&mut self.board, nobody, plan)
    }

    /// Measures with somebody who does what they are asked for.
    fn measure_attended(&mut self, parts: &[Part], keep: bool) -> Report {
        self.measure_attended_for(parts, Duration::ZERO, keep)
    }

    pub(crate) fn measure_attended_for(
        &mut self,
        parts: &[Part],
        clock: Duration,
        keep: bool,
    ) -> Report {
        let (rig, jumpers) = (&self.rig, &self.jumpers);
        let obeys = |prompt| match prompt {
            Prompt::MoveStrobeWire(output) => {
                lock(jumpers).strobe = Some(wiring::OUTPUTS[usize::from(output.number()) - 2]);
            }
            Prompt::UnplugSda => sensor(rig, Fault::HoldSda(None)),
            Prompt::PlugSdaIn => sensor(rig, Fault::ReleaseSda),
            Prompt::Measures(_) => {}
        };
        let somebody = Operator {
            say: &obeys,
            is_there: true,
            stop: &|| false,
        };
        let plan = Plan { parts, clock, keep };
        run(&mut self.board, somebody, plan).unwrap()
    }
}

fn sensor(rig: &SharedRig, fault: Fault) {
    sensor_in(rig, SimDuration::ZERO, fault);
}

fn sensor_in(rig: &SharedRig, time: SimDuration, fault: Fault) {
    rig.with(|rig| {
        let imu = rig.parts().imu.as_ref().unwrap();
        lock(imu).schedule(rig.now() + time, fault);
    });
}

/// A link of a computer whose clock runs at `rate` of the board's, and is steered to `steered` of
/// that.
struct OffClock {
    link: Box<dyn Link>,
    rate: f64,
    steered: f64,
}

impl Link for OffClock {
    fn now(&self) -> Duration {
        self.link.now().mul_f64(self.rate * self.steered)
    }

    fn steady(&self) -> Duration {
        self.link.now().mul_f64(self.rate)
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.link.send(bytes)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        self.link.receive(into, wait)
    }

    fn pause(&mut self, time: Duration) {
        self.link.pause(time);
    }
}

/// The check of this name.
fn check<'a>(report: &'a Report, name: &str) -> &'a Check {
    let mut found = report.checks.iter().filter(|c| c.finding.kind == name);
    let check = found.next();
    assert!(found.next().is_none(), "{name} twice in {report:#?}");
    check.unwrap_or_else(|| panic!("no check {name} in {report:#?}"))
}

fn assert_severities(report: &Report, expected: &[(&str, Severity)]) {
    for &(name, severity) in expected {
        let found = check(report, name);
        assert_eq!(found.finding.severity, severity, "{found:?}");
    }
}

#[test]
fn a_board_in_order_passes_with_somebody_at_its_wires() {
    let mut bench = Bench::new(31, Jumpers::default());
    let parts = [Part::Trigger, Part::Outputs, Part::Imu, Part::Link];
    let report = bench.measure_attended(&parts, false);
    for name in [
        "edges on their ticks",
        "slew",
        "read-back",
        "strobe input",
        "pulse width",
        "output 2 on the strobe input",
        "pulse width of output 3",
        "output 4 beside the trigger",
        "sample rate",
        "clock of the IMU",
        "data-ready",
        "recovery of the IMU",
        "trigger beside a failed IMU",
        "throughput",
        "a host that does not read",
        "handlers",
        "handler of the trigger",
        "handler of the outputs",
        "handler of the hand-over",
        "handler of USB",
        "masked interrupts",
        "core and stack",
    ] {
        check(&report, name);
    }
    for check in &report.checks {
        assert_eq!(check.finding.severity, Severity::Good, "{check:?}");
    }
    let page = report::board_test::page(&report);
    assert!(
        page.contains("checks passed") && page.contains("<svg"),
        "{page}"
    );
}

/// The start delay of a board is two ticks off: the test says so, and keeps the right one.
#[test]
fn measured_delays_are_kept_and_hold() {
    let mut bench = Bench::new(36, Jumpers::default());
    let before = bench.board.call(QueryBoard).unwrap();
    let wrong = BoardSettings {
        output_start_delay: before.output_start_delay + 4,
        ..before
    };
    bench.board.call(SetBoard(wrong)).unwrap();
    let parts = [Part::Trigger, Part::Outputs];
    let name = "output 2 beside the trigger";
    let report = bench.measure_attended(&parts, true);
    assert_severities(&report, &[(name, Severity::Bad)]);
    assert_eq!(
        report.settings.output_start_delay,
        before.output_start_delay
    );
    lock(&bench.jumpers).strobe = Jumpers::default().strobe;
    let report = bench.measure_attended(&parts, false);
    assert_severities(&report, &[(name, Severity::Good)]);
    let text = &check(&report, "strobe input").finding.text;
    assert!(text.contains(", 0 ticks after"), "{text}");
}

/// A wire bounces while it is plugged in: that is no fault. A contact that never holds is.
#[test]
fn the_sensor_recovers_from_a_wire_that_bounces_and_not_from_a_loose_one() {
    let ms = SimDuration::from_millis;
    let loose: Vec<u64> = (0..16).map(|n| 300 + 400 * n).collect();
    for (again, severity) in [
        (&[20, 90, 130][..], Severity::Good),
        (&loose, Severity::Bad),
    ] {
        let mut bench = Bench::new(37, Jumpers::default());
        let rig = &bench.rig;
        let plugs = |prompt| match prompt {
            Prompt::UnplugSda => sensor(rig, Fault::HoldSda(None)),
            Prompt::PlugSdaIn => {
                sensor(rig, Fault::ReleaseSda);
                for &at in again {
                    sensor_in(rig, ms(at), Fault::HoldSda(None));
                    sensor_in(rig, ms(at + 40), Fault::ReleaseSda);
                }
            }
            Prompt::Measures(_) | Prompt::MoveStrobeWire(_) => {}
        };
        let somebody = Operator {
            say: &plugs,
            is_there: true,
            stop: &|| false,
        };
        let plan = Plan {
            parts: &[Part::Imu],
            clock: Duration::ZERO,
            keep: false,
        };
        let report = run(&mut bench.board, somebody, plan).unwrap();
        assert_severities(
            &report,
            &[
                ("recovery of the IMU", severity),
                ("trigger beside a failed IMU", Severity::Good),
            ],
        );
    }
}

#[test]
fn a_broken_wire_and_a_held_bus_fail() {
    let jumpers = Jumpers {
        readback: false,
        ..Jumpers::default()
    };
    let mut bench = Bench::new(32, jumpers);
    // Without its pull-ups the bus stays low.
    sensor(&bench.rig, Fault::HoldSda(None));
    let parts = [Part::Trigger, Part::Imu, Part::Outputs];
    let report = bench.measure(&parts, Duration::ZERO).unwrap();
    assert_severities(
        &report,
        &[
            ("read-back", Severity::Bad),
            ("strobe input", Severity::Good),
            ("edges on their ticks", Severity::Good),
            ("output 2 on the strobe input", Severity::Check),
            ("data-ready", Severity::Bad),
        ],
    );
}

#[test]
fn a_board_in_use_is_left_alone() {
    let mut bench = Bench::new(33, Jumpers::default());
    let start = TriggerStart {
        period: Period::from_picos(33_333_333_333).unwrap(),
        width: MIN_PULSE_WIDTH,
        first_edge: None,
        first_fraction: 0,
    };
    bench.board.start_trigger(Output::Camera, start).unwrap();
    let refused = bench.measure(&Part::ALL, Duration::ZERO);
    assert!(matches!(refused, Err(BringUpError::InUse)), "{refused:?}");
    assert_eq!(bench.board.trigger().unwrap().state, TrainState::Running);
}

/// Slower than the gap between two pulses leaves it, though no edge comes late by it.
#[test]
fn a_slow_handler_fails() {
    let mut bench = Bench::new(34, Jumpers::default());
    let (key, failure) = (SELF_TEST_KEY, Failure::SlowHandler);
    bench.board.call(SelfTest { key, failure }).unwrap();
    let report = bench.measure(&[Part::Link], Duration::ZERO).unwrap();
    assert_severities(
        &report,
        &[
            ("handlers", Severity::Bad),
            ("handler of the trigger", Severity::Bad),
            ("handler of the outputs", Severity::Good),
            ("handler of USB", Severity::Good),
            ("throughput", Severity::Good),
        ],
    );
}

/// The limit is 100 ppm; a look at the port every millisecond adds some 20 over a minute.
#[test]
fn the_crystal_is_compared_with_the_computers_clock() {
    for (ppm, steered_ppm, severity) in [
        (0.0, 0.0, Severity::Good),
        (70.0, 500.0, Severity::Good),
        (-70.0, -500.0, Severity::Good),
        (150.0, 0.0, Severity::Bad),
        (-150.0, 0.0, Severity::Bad),
    ] {
        let mut bench = Bench::with_link(35, Jumpers::default(), |link| {
            Box::new(OffClock {
                link,
                rate: 1.0 + ppm * 1e-6,
                steered: 1.0 + steered_ppm * 1e-6,
            })
        });
        let report = bench
            .measure(&[Part::Clock], Duration::from_secs(30))
            .unwrap();
        let crystal = check(&report, "crystal");
        assert_eq!(crystal.finding.severity, severity, "{crystal:?}");
        let text = &crystal.finding.text;
        assert!(text.contains("the chip at 36."), "{text}");
    }
}
