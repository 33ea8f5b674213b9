//! `smartdepthsync record --track`: the phone's clock is followed, every change of the
//! trigger's period is in the recording and within its bounds, and a phone that falls silent
//! is told.

use crate::turn;
use crate::whole_rig::{Session, WholeRig};
use protocol::Period;
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};
use rig::table::Table;
use rustix::process::Signal;

/// Sessions that follow a clock pass as fast as the computer's.
const SPEED: f64 = 1.0;

#[test]
fn the_period_follows_the_phones_clock_and_every_pulse_stays_on_its_grid() {
    let _turn = turn::alone();
    let rig = WholeRig::new(17, SPEED);
    let program = env!("CARGO_BIN_EXE_hil-sim");
    let table = Table::new(rig.rig.parts(), rig.phone(), program.as_ref()).unwrap();
    let mut command = rig.record("tracked", &["--duration", "16s", "--track"]);
    command.env("PATH", table.search_path());
    let said = Session::start(&mut command).ends_with(0);
    assert!(
        said.contains("the clock of phone SIMULATED is followed"),
        "{said}"
    );
    assert!(said.contains(", locked, phone 31.4 °C"), "{said}");

    let folder = rig.recording("tracked");
    let session = SessionFile::load(&folder).unwrap();
    let tracking = session.tracking.unwrap();
    assert_eq!(tracking.device, "SIMULATED");
    let alignment = session.alignment.unwrap();
    let (mut exchanges, mut periods) = ([0, 0], vec![alignment.period_q32 as f64]);
    for entry in Reader::open(&folder).unwrap() {
        match entry.unwrap().item {
            Item::Exchange(exchange) => {
                assert!(exchange.received_ns > exchange.sent_ns);
                exchanges[usize::from(exchange.header.frame_id != "board")] += 1;
            }
            Item::Period(step) => {
                assert!(Period(step.period_q32).in_bounds());
                periods.push(step.period_q32 as f64);
            }
            _ => {}
        }
    }
    // 50 and 25 a second, of the seconds from the connection on.
    assert!(exchanges[0] > 100 && exchanges[1] > 200, "{exchanges:?}");
    assert_eq!(periods.len(), 1 + tracking.steps as usize);
    assert!(tracking.steps >= 3, "{tracking:?}");
    for step in periods.windows(2) {
        let ppm = (step[1] / step[0] - 1.0) * 1e6;
        // 0.2 ppm a second, of steps two seconds apart; a slow computer's are rarer.
        assert!(ppm.abs() <= 2.0, "{ppm}");
    }
    // Every pulse is on the grid that held then.
    let report = verify::verify(&folder, &|| false).unwrap();
    let grid = report.grid.unwrap();
    assert!(grid.checked > 300 && grid.off == 0, "{grid:?}");
    drop(table);
    rig.rig.stop().unwrap();
}

/// The phone's cable is pulled until its program there has ended, and put back.
#[test]
fn a_phone_that_comes_back_is_followed_again_and_nothing_is_left_running() {
    let _turn = turn::alone();
    let rig = WholeRig::new(18, SPEED);
    let program = env!("CARGO_BIN_EXE_hil-sim");
    let mut table = Table::new(rig.rig.parts(), rig.phone(), program.as_ref()).unwrap();
    // Without a length: how long a busy computer takes to all this is not known.
    let mut command = rig.record("pulled", &["--track"]);
    command.env("PATH", table.search_path());
    let mut session = Session::start(&mut command);
    session.wait_for(", locked");
    table.pull_phone().unwrap();
    session.wait_for("the phone's clock is not heard any more");
    table.plug_phone(rig.phone()).unwrap();
    session.wait_for("the phone's clock is followed again");
    session.signal(Signal::INT);
    let (_, said) = session.end();

    let recorded = SessionFile::load(&rig.recording("pulled")).unwrap();
    assert_eq!(recorded.outcome, Some(SessionOutcome::Interrupted));
    // A computer that stands still for seconds loses it once more.
    assert!(recorded.tracking.unwrap().lost >= 1, "{said}");
    // What the session notes by itself does not divide the data set.
    assert!(recorded.markers.is_empty(), "{:?}", recorded.markers);
    let started = table.started_on_phone().unwrap();
    assert!(started.len() >= 2, "{said}");
    for number in started {
        let process = rustix::process::Pid::from_raw(number).unwrap();
        let runs = rustix::process::test_kill_process(process);
        assert!(runs.is_err(), "{number} still runs");
    }
    rig.rig.stop().unwrap();
}
