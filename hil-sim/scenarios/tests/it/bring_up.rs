//! `smartdepthsync bring-up` as a process on the simulated board: it passes with the
//! wires as the book says, and names what is wrong with them where they are not.

use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};

use crate::support;
use crate::whole_rig::Session;
use protocol::{Failure, SELF_TEST_KEY, SelfTest};
use rig::imu::Fault;
use rig::jumpers::Jumpers;
use rig::random::Seed;
use rig::rig_config::RigConfig;
use rig::running_rig::{Pace, RunningRig};
use rig::wiring;
use serde_json::Value;
use stm32f4_sim::pin::Pin;
use stm32f4_sim::shared::lock;

struct Bench {
    rig: RunningRig,
    jumpers: Arc<Mutex<Jumpers>>,
    folder: tempfile::TempDir,
}

impl Bench {
    fn new(seed: u64, jumpers: Jumpers) -> Self {
        Self::at_speed(seed, jumpers, 10.0)
    }

    fn at_speed(seed: u64, jumpers: Jumpers, speed: f64) -> Self {
        let mut config = RigConfig::published(Seed(seed));
        config.depth_camera = None;
        let jumpers = Arc::new(Mutex::new(jumpers));
        let board = wiring::board().model(Arc::clone(&jumpers));
        let pace = Pace {
            speed: Some(speed),
            wait_for_host: false,
        };
        Self {
            rig: RunningRig::start(config, board, None, pace).unwrap(),
            jumpers,
            folder: tempfile::tempdir().unwrap(),
        }
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(support::smartdepthsync());
        command
            .args(["bring-up", "--port"])
            .arg(self.rig.port())
            .arg("--out")
            .arg(self.out())
            .args(arguments);
        command
    }

    fn out(&self) -> &Path {
        self.folder.path()
    }

    fn sensor(&self, fault: Fault) {
        let imu = self.rig.parts().imu.as_ref().unwrap();
        lock(imu).schedule(self.rig.now(), fault);
    }

    fn report(&self) -> Value {
        let text = std::fs::read_to_string(self.out().join("bring-up.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    }
}

/// Verdict and measurement of each check of this name.
fn verdicts(report: &Value, name: &str) -> Vec<(String, String)> {
    let all = report["checks"].as_array().unwrap().iter();
    let found: Vec<_> = all
        .filter(|check| check["kind"] == name)
        .map(|check| {
            let text = |key: &str| check[key].as_str().unwrap().to_owned();
            (text("severity"), text("text"))
        })
        .collect();
    assert!(!found.is_empty(), "no check {name} in {report:#}");
    found
}

#[test]
fn a_board_in_order_passes_with_somebody_at_its_wires() {
    let bench = Bench::new(31, Jumpers::default());
    let parts = ["trigger", "outputs", "imu", "link"];
    let mut session = Session::start(
        &mut bench.command(
            &parts
                .map(|p| format!("--part={p}"))
                .each_ref()
                .map(String::as_str),
        ),
    );
    session.wait_for("move the wire at PA2 from PA5 to PE11");
    bench.jumpers.lock().unwrap().strobe = Some(Pin::PE11);
    session.wait_for("unplug SDA");
    bench.sensor(Fault::HoldSda(None));
    session.wait_for("plug SDA in again");
    bench.sensor(Fault::ReleaseSda);
    let said = session.ends_with(0);
    let report = bench.report();
    for check in report["checks"].as_array().unwrap() {
        assert_eq!(check["severity"], "good", "{check:#}\n{said}");
    }
    for name in [
        "edges on their ticks",
        "slew",
        "read-back",
        "strobe input",
        "pulse width",
        "pulse width of output 2",
        "output 2 beside the trigger",
        "sample rate",
        "data-ready",
        "recovery of the IMU",
        "throughput",
        "a host that does not read",
        "handlers",
        "handler of the trigger",
        "handler of the outputs",
        "handler of the hand-over",
        "handler of USB",
    ] {
        assert_eq!(verdicts(&report, name).len(), 1, "{name}");
    }
    let page = std::fs::read_to_string(bench.out().join("bring-up.html")).unwrap();
    assert!(
        page.contains("checks passed") && page.contains("<svg"),
        "{page}"
    );
}

#[test]
fn a_broken_wire_and_a_held_bus_fail_with_what_to_look_at() {
    let bench = Bench::new(
        32,
        Jumpers {
            readback: false,
            ..Jumpers::default()
        },
    );
    let arguments = [
        "--part=trigger",
        "--part=imu",
        "--part=outputs",
        "--hands-off",
    ];
    // Without its pull-ups the bus stays low.
    bench.sensor(Fault::HoldSda(None));
    let said = Session::start(&mut bench.command(&arguments)).ends_with(3);
    let report = bench.report();
    assert_eq!(verdicts(&report, "read-back")[0].0, "bad");
    assert_eq!(verdicts(&report, "strobe input")[0].0, "good");
    assert_eq!(verdicts(&report, "edges on their ticks")[0].0, "good");
    assert_eq!(
        verdicts(&report, "output 2 on the strobe input")[0].0,
        "check"
    );
    let (verdict, measured) = &verdicts(&report, "data-ready")[0];
    assert_eq!(verdict, "bad");
    assert!(measured.contains("BusHeld"), "{measured}");
    assert!(said.contains("the wire from PA5 to PA3"), "{said}");
    assert!(said.contains("pull-ups"), "{said}");
}

#[test]
fn a_board_in_use_is_left_alone() {
    let bench = Bench::new(33, Jumpers::default());
    let trigger = |action: &[&str]| {
        let mut command = Command::new(support::smartdepthsync());
        command
            .arg("trigger")
            .args(action)
            .arg("--port")
            .arg(bench.rig.port());
        Session::start(&mut command).ends_with(0)
    };
    trigger(&["start", "--fps", "30"]);
    let said = Session::start(&mut bench.command(&[])).ends_with(3);
    assert!(said.contains("the trigger is running"), "{said}");
    assert!(said.contains("trigger stop"), "{said}");
    assert!(trigger(&["status", "--json"]).contains("\"Running\""));
    assert!(!bench.out().join("bring-up.json").exists());
}

/// Slower than the gap between two pulses leaves it, though no edge comes late by it.
#[test]
fn a_slow_handler_fails() {
    let bench = Bench::new(34, Jumpers::default());
    let mut board = board::Board::open(bench.rig.port().to_str()).unwrap();
    let (key, failure) = (SELF_TEST_KEY, Failure::SlowHandler);
    board.call(SelfTest { key, failure }).unwrap();
    drop(board);
    let said = Session::start(&mut bench.command(&["--part=link", "--hands-off"])).ends_with(3);
    let report = bench.report();
    for name in ["handlers", "handler of the trigger"] {
        assert_eq!(verdicts(&report, name)[0].0, "bad", "{said}");
    }
    for name in ["handler of the outputs", "handler of USB", "throughput"] {
        assert_eq!(verdicts(&report, name)[0].0, "good", "{said}");
    }
    assert!(said.contains("a handler of higher priority that takes too long"));
}

/// At the speed of time, so that the computer's clock is the board's; as well as a busy
/// computer keeps it, which costs the board a millisecond now and then, so the longer the better.
#[test]
fn the_crystal_is_compared_with_the_computers_clock() {
    let compare = |speed, seconds| {
        let bench = Bench::at_speed(35, Jumpers::default(), speed);
        let length = format!("--clock-time={seconds}s");
        let arguments = ["--part=clock", &length, "--hands-off"];
        let (status, said) = Session::start(&mut bench.command(&arguments)).end();
        let (found, measured) = verdicts(&bench.report(), "crystal").swap_remove(0);
        assert!(measured.contains("the chip at 36."), "{measured}");
        (found, status.code(), said)
    };
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let (verdict, code, said) = compare(1.01, 4);
            assert_eq!((verdict.as_str(), code), ("bad", Some(3)), "{said}");
        });
        let mut said = String::new();
        let passes = [8, 16, 32].into_iter().any(|seconds| {
            let (verdict, code, last) = compare(1.0, seconds);
            said = last;
            (verdict.as_str(), code) == ("good", Some(0))
        });
        assert!(passes, "{said}");
    });
}
