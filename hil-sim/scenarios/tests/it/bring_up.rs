//! The board test on the simulated board, on virtual time: it passes with the wires as the
//! book says, and names what is wrong with them where they are not.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use ::session::devices::Connector;
use board::Board;
use board::bring_up::{BoardTestReport, BringUpError, Check, Operator, Part, Plan, Prompt, run};
use board::finding::Severity;
use board::transport::{Link, LinkError};
use protocol::{
    BoardSettings, Failure, MIN_PULSE_WIDTH, Output, Period, QueryBoard, QueryTrigger,
    SELF_TEST_KEY, SelfTest, SetBoard, StartTrigger, TrainState, TriggerStart,
};
use rig::imu::Fault;
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use rig::whole_rig::virtual_rig::VirtualRig;
use rig::wiring;
use rig::wiring::jumpers::Jumpers;
use scenarios::virtual_session::SharedRig;
use stm32f4_sim::shared::lock;
use stm32f4_sim::sim::SimBuilder;
use stm32f4_sim::time::SimDuration;

/// A link in place of another.
type Through = Box<dyn Fn(Box<dyn Link>) -> Box<dyn Link>>;

/// A board with its wires, and the person who moves them.
pub(crate) struct BringUpBench {
    rig: SharedRig,
    jumpers: Arc<Mutex<Jumpers>>,
    board: Board,
    /// All bytes pass through such a link.
    through: Through,
}

/// The measurements of a test that needs no others.
pub(crate) fn plan(parts: &[Part]) -> Plan<'_> {
    Plan {
        parts,
        clock: Duration::from_secs(12),
        soak: Duration::from_secs(80),
        keep: false,
    }
}

impl BringUpBench {
    fn new(seed: u64, jumpers: Jumpers) -> Self {
        Self::with_link(seed, jumpers, |link| link)
    }

    /// The same with all bytes through another link.
    pub(crate) fn with_link(
        seed: u64,
        jumpers: Jumpers,
        through: impl Fn(Box<dyn Link>) -> Box<dyn Link> + 'static,
    ) -> Self {
        Self::on_board(wiring::board(), seed, jumpers, through)
    }

    /// Runs the test on a board with another chip.
    fn on_board(
        board: SimBuilder,
        seed: u64,
        jumpers: Jumpers,
        through: impl Fn(Box<dyn Link>) -> Box<dyn Link> + 'static,
    ) -> Self {
        let mut config = RigConfig::published(Seed(seed));
        config.depth_camera = None;
        let jumpers = Arc::new(Mutex::new(jumpers));
        let board = board.model(Arc::clone(&jumpers));
        let rig = VirtualRig::new(config, board.tolerate_failures(), Vec::new()).unwrap();
        let mut rig = SharedRig::boot(rig).unwrap();
        let link = rig.connect(None).unwrap();
        let board = Board::connect_from(through(link), 1).unwrap();
        let through = Box::new(through);
        Self {
            rig,
            jumpers,
            board,
            through,
        }
    }

    /// Cuts the wire to CLKIN, and lets the sensor go on without it.
    pub(crate) fn cut_imu_clock(&self) {
        sensor(&self.rig, Fault::ClockCut(true));
        // Less than a command waits for its answer.
        self.rig.with(|rig| rig.pass(SimDuration::from_secs(1)));
    }

    /// Measures with nobody at the board.
    fn measure(&mut self, parts: &[Part]) -> Result<BoardTestReport, BringUpError> {
        self.run(&plan(parts), false, &|_, _| false)
    }

    /// Measures with somebody who does what they are asked for.
    pub(crate) fn measure_attended(&mut self, plan: &Plan<'_>) -> BoardTestReport {
        self.run(plan, true, &|_, _| false).unwrap()
    }

    /// Measures with somebody who does what they are asked for, but what `other` does.
    fn run(
        &mut self,
        plan: &Plan<'_>,
        is_there: bool,
        other: &dyn Fn(&SharedRig, Prompt) -> bool,
    ) -> Result<BoardTestReport, BringUpError> {
        let (rig, jumpers, through) = (&self.rig, &self.jumpers, &self.through);
        let ms = SimDuration::from_millis;
        let obeys = |prompt| match prompt {
            _ if other(rig, prompt) => {}
            Prompt::MoveStrobeWire(pin) => {
                let mut jumpers = lock(jumpers);
                jumpers.inverted = pin == "PC12";
                jumpers.strobe = Some(pin.parse().unwrap());
            }
            Prompt::UnplugClock => sensor(rig, Fault::ClockCut(true)),
            Prompt::PlugClockIn => sensor(rig, Fault::ClockCut(false)),
            Prompt::UnplugSda => sensor(rig, Fault::HoldSda(None)),
            Prompt::PlugSdaIn => sensor(rig, Fault::ReleaseSda),
            Prompt::Replug => rig.with(|rig| {
                let now = rig.now();
                rig.at(now + ms(1_003), |rig| rig.sim.usb_unplug());
                rig.at(now + ms(4_000), |rig| rig.sim.usb_plug());
            }),
            Prompt::Sleep => rig.with(|rig| {
                let now = rig.now();
                rig.at(now + ms(1_003), move |rig| rig.sim.usb_suspend(ms(5_000)));
            }),
            // The computer sleeps meanwhile.
            Prompt::Measures(Part::Soak) => rig.with(|rig| {
                let now = rig.now();
                rig.at(now + ms(20_003), move |rig| rig.sim.usb_suspend(ms(5_000)));
            }),
            Prompt::PressReset => rig.with(VirtualRig::press_reset),
            Prompt::SwitchPower => rig.with(VirtualRig::power_cycle),
            Prompt::Measures(_) => {}
        };
        let operator = Operator {
            say: &obeys,
            is_there,
            skips: &|| false,
            stop: &|| false,
            reconnect: &|within| {
                rig.with(|rig| rig.pass_until(within, |rig| rig.is_plugged()));
                rig.clone().connect(None).map(through)
            },
        };
        run(&mut self.board, operator, *plan)
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
fn check<'a>(report: &'a BoardTestReport, name: &str) -> &'a Check {
    let mut found = report.checks.iter().filter(|c| c.finding.kind == name);
    let check = found.next();
    assert!(found.next().is_none(), "{name} twice in {report:#?}");
    check.unwrap_or_else(|| panic!("no check {name} in {report:#?}"))
}

fn assert_severities(report: &BoardTestReport, expected: &[(&str, Severity)]) {
    for &(name, severity) in expected {
        let found = check(report, name);
        assert_eq!(found.finding.severity, severity, "{found:?}");
    }
}

/// The start delay of a board is two ticks off: the test says so, and keeps the right one.
#[test]
fn measured_delays_are_kept_and_hold() {
    let mut bench = BringUpBench::new(36, Jumpers::default());
    let before = bench.board.call(QueryBoard).unwrap();
    let wrong = BoardSettings {
        output_start_delay: before.output_start_delay + 4,
        ..before
    };
    bench.board.call(SetBoard(wrong)).unwrap();
    let parts = [Part::Trigger, Part::Outputs];
    let keep = |keep| Plan {
        keep,
        ..plan(&parts)
    };
    let name = "output 2 beside the trigger";
    let report = bench.measure_attended(&keep(true));
    assert_severities(&report, &[(name, Severity::Bad)]);
    assert_eq!(
        report.settings.output_start_delay,
        before.output_start_delay
    );
    lock(&bench.jumpers).strobe = Jumpers::default().strobe;
    let report = bench.measure_attended(&keep(false));
    assert_severities(&report, &[(name, Severity::Good)]);
    let text = &check(&report, "strobe input").finding.text;
    assert!(text.contains(", 0 ticks after"), "{text}");
}

/// A wire bounces while it is plugged in: that is not a fault. A contact that never holds is.
#[test]
pub(crate) fn the_sensor_recovers_from_a_wire_that_bounces_and_not_from_a_loose_one() {
    let ms = SimDuration::from_millis;
    let loose: Vec<u64> = (0..16).map(|n| 300 + 400 * n).collect();
    for (again, severity) in [
        (&[20, 90, 130][..], Severity::Good),
        (&loose, Severity::Bad),
    ] {
        let mut bench = BringUpBench::new(37, Jumpers::default());
        let plugs = |rig: &SharedRig, prompt| {
            if prompt == Prompt::PlugSdaIn {
                sensor(rig, Fault::ReleaseSda);
                for &at in again {
                    sensor_in(rig, ms(at), Fault::HoldSda(None));
                    sensor_in(rig, ms(at + 40), Fault::ReleaseSda);
                }
            }
            prompt == Prompt::PlugSdaIn
        };
        let report = bench.run(&plan(&[Part::Imu]), true, &plugs).unwrap();
        let expected = [
            ("recovery of the IMU", severity),
            ("trigger beside a failed IMU", Severity::Good),
        ];
        assert_severities(&report, &expected);
    }
}

/// The clock's wire is pulled off with a few bounces, and the sensor goes on; one that takes
/// data-ready off with it stops it.
#[test]
pub(crate) fn a_sensor_goes_on_without_its_clock_and_not_without_data_ready() {
    let ms = SimDuration::from_millis;
    for (is_wrong, severity) in [(false, Severity::Good), (true, Severity::Bad)] {
        let mut bench = BringUpBench::new(38, Jumpers::default());
        let pulls = |rig: &SharedRig, prompt| {
            match prompt {
                Prompt::UnplugClock => {
                    for (at, cut) in [(0, true), (15, false), (31, true), (60, false), (80, true)] {
                        sensor_in(rig, ms(at), Fault::ClockCut(cut));
                    }
                    sensor(rig, Fault::DataReadyCut(is_wrong));
                }
                Prompt::PlugClockIn => {
                    sensor(rig, Fault::ClockCut(false));
                    sensor(rig, Fault::DataReadyCut(false));
                }
                _ => return false,
            }
            true
        };
        let report = bench.run(&plan(&[Part::Imu]), true, &pulls).unwrap();
        let expected = [
            ("IMU without its clock", severity),
            ("recovery of the IMU", Severity::Good),
        ];
        assert_severities(&report, &expected);
    }
}

/// After a gate that does not invert, a lidar like the VLP-16 would read nothing.
#[test]
pub(crate) fn a_line_that_is_high_when_idle_is_reported() {
    let mut bench = BringUpBench::new(39, Jumpers::default());
    let jumpers = Arc::clone(&bench.jumpers);
    let plugs = |_: &SharedRig, prompt| {
        let is_line = prompt == Prompt::MoveStrobeWire("PC12");
        if is_line {
            lock(&jumpers).strobe = Some("PC12".parse().unwrap());
        }
        is_line
    };
    let report = bench.run(&plan(&[Part::Lidar]), true, &plugs).unwrap();
    let expected = [
        ("serial line", Severity::Good),
        ("inverted serial line", Severity::Check),
    ];
    assert_severities(&report, &expected);
}

/// A cable that loads the divider makes edges slow; one with 2 µs still leaves the camera its 8.
#[test]
pub(crate) fn a_divider_that_is_loaded_too_much_fails() {
    let ns = SimDuration::from_nanos;
    let (good, bad) = (Severity::Good, Severity::Bad);
    for (rise, fall, read_back, pulse) in [
        (120, 90, good, good),
        // 21 ticks and 22; 96 ticks and 97 shorter, 24 and 25 longer.
        (437, 0, good, good),
        (459, 0, bad, good),
        (1_999, 0, bad, good),
        (2_022, 0, bad, bad),
        (0, 499, good, good),
        (0, 522, good, bad),
    ] {
        let jumpers = Jumpers {
            strobe: Some("PA3".parse().unwrap()),
            buffer: Some([ns(rise), ns(fall)]),
            ..Jumpers::default()
        };
        let report = BringUpBench::new(40, jumpers)
            .measure(&[Part::Buffer])
            .unwrap();
        let expected = [
            ("read-back after the buffer", read_back),
            ("pulse after the buffer", pulse),
        ];
        assert_severities(&report, &expected);
    }
}

/// A board that leaves the bus for good ends the test, with a report.
#[test]
fn a_board_that_does_not_come_back_fails() {
    let mut bench = BringUpBench::new(41, Jumpers::default());
    let rig = bench.rig.clone();
    bench.through = Box::new(move |link| {
        rig.with(|rig| rig.sim.usb_unplug());
        link
    });
    let parts = [Part::Replug, Part::Resets];
    let report = bench.measure(&parts).unwrap();
    assert_severities(&report, &[("leaving the bus", Severity::Bad)]);
    assert_eq!(report.checks.len(), 1);
}

#[test]
fn a_broken_wire_and_a_held_bus_fail() {
    let jumpers = Jumpers {
        readback: false,
        ..Jumpers::default()
    };
    let mut bench = BringUpBench::new(32, jumpers);
    // Without its pull-ups the bus stays low.
    sensor(&bench.rig, Fault::HoldSda(None));
    let parts = [Part::Trigger, Part::Imu, Part::Outputs];
    let report = bench.measure(&parts).unwrap();
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
    let mut bench = BringUpBench::new(33, Jumpers::default());
    let start = TriggerStart {
        period: Period::from_picos(33_333_333_333).unwrap(),
        width: MIN_PULSE_WIDTH,
        first_edge: None,
    };
    let output = Output::Camera;
    bench.board.call(StartTrigger { output, start }).unwrap();
    let refused = bench.measure(&Part::ALL);
    assert!(matches!(refused, Err(BringUpError::InUse)), "{refused:?}");
    let status = bench.board.call(QueryTrigger(Output::Camera)).unwrap();
    assert_eq!(status.state, TrainState::Running);
}

/// Slower than the gap between two pulses leaves it, though no edge comes late by it.
#[test]
fn a_slow_handler_fails() {
    let mut bench = BringUpBench::new(34, Jumpers::default());
    let (key, failure) = (SELF_TEST_KEY, Failure::SlowHandler);
    bench.board.call(SelfTest { key, failure }).unwrap();
    let report = bench.measure(&[Part::Link]).unwrap();
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

/// From the chip's own measurement of its reference: 3.6 V is the most that it may have.
#[test]
fn a_supply_that_is_too_high_fails() {
    let board = wiring::board().chip(|chip| chip.die.supply = 3.7);
    let mut bench = BringUpBench::on_board(board, 36, Jumpers::default(), |link| link);
    let report = bench.measure(&[Part::Clock]).unwrap();
    let expected = [("supply", Severity::Bad), ("crystal", Severity::Good)];
    assert_severities(&report, &expected);
}

/// The limit is 100 ppm; a look at the port every millisecond adds some 20 over a minute.
#[test]
pub(crate) fn the_crystal_is_compared_with_the_computers_clock() {
    for (ppm, steered_ppm, severity) in [
        (99.0, 500.0, Severity::Good),
        (-99.0, -500.0, Severity::Good),
        (150.0, 0.0, Severity::Bad),
        (-150.0, 0.0, Severity::Bad),
    ] {
        let mut bench = BringUpBench::with_link(35, Jumpers::default(), move |link| {
            Box::new(OffClock {
                link,
                rate: 1.0 + ppm * 1e-6,
                steered: 1.0 + steered_ppm * 1e-6,
            })
        });
        let report = bench.measure(&[Part::Clock]).unwrap();
        let crystal = check(&report, "crystal");
        assert_eq!(crystal.finding.severity, severity, "{crystal:?}");
        let text = &crystal.finding.text;
        assert!(text.contains("the chip at 36."), "{text}");
    }
}
