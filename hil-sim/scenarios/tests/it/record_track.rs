//! `smartdepthsync record --track`: the phone's clock is followed, every change of the
//! trigger's period is in the recording and within its bounds, and a phone that falls silent
//! is told.

use std::process::Command;

use crate::adb_phone::AdbPhone;
use crate::support::smartdepthsync;
use crate::turn;
use crate::whole_rig::{Session, WholeRig};
use protocol::Period;
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};
use rig::table::Table;
use rustix::process::Signal;

/// Sessions that follow a clock pass as fast as the computer's.
const SPEED: f64 = 1.0;

// Exit codes, as docs/exit-codes.md has them.
const PHONE: i32 = 12;
const INTERRUPTED: i32 = 130;

#[test]
fn the_period_follows_the_phones_clock_and_every_pulse_stays_on_its_grid() {
    let _turn = turn::beside_others();
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
    let report = report::verify::verify(&folder, &|| false).unwrap();
    let grid = report.grid.unwrap();
    assert!(grid.checked > 300 && grid.off == 0, "{grid:?}");
    drop(table);
    rig.rig.stop().unwrap();
}

/// What the computer's boot clock reads, ns, to a hundredth of a second.
fn boot_ns() -> i64 {
    let text = std::fs::read_to_string("/proc/uptime").unwrap();
    let seconds: f64 = text.split(' ').next().unwrap().parse().unwrap();
    (seconds * 1e9) as i64
}

/// With Debian's `adb`, and the program for phones as it is: it reads the computer's clock,
/// which the simulated phone then has.
#[test]
fn a_phone_behind_adb_is_followed_again_when_it_comes_back_and_nothing_is_left() {
    let _turn = turn::beside_others();
    let begun = boot_ns();
    let rig = WholeRig::with(18, SPEED, |_, phone| {
        phone.clock.offset_ns = begun;
        phone.clock.rate_ppm = 0.0;
    });
    let phone = AdbPhone::new(rig.phone().storage(), "qemu-aarch64");
    // Without a length: how long a busy computer takes to all this is not known.
    let mut command = rig.record("pulled", &["--track"]);
    let mut session = Session::start(phone.show(&mut command));
    session.wait_for(", locked");
    let forwarded = phone.adb(&["forward", "--list"]);
    assert!(forwarded.contains(&phone.serial()), "{forwarded}");
    phone.pull();
    session.wait_for("the phone's clock cannot be read any more");
    phone.plug();
    phone.wait_for_programs(2);
    session.wait_for("the phone's clock is followed again");
    session.signal(Signal::INT);
    let (_, said) = session.end();

    let folder = rig.recording("pulled");
    let recorded = SessionFile::load(&folder).unwrap();
    assert_eq!(recorded.outcome, Some(SessionOutcome::Interrupted));
    let tracking = recorded.tracking.unwrap();
    assert_eq!(tracking.device, phone.serial());
    // A computer that stands still for seconds loses it once more.
    assert!(tracking.lost >= 1, "{said}");
    // What the session notes by itself does not divide the data set.
    assert!(recorded.markers.is_empty(), "{:?}", recorded.markers);
    let items = Reader::open(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().item);
    let told: Vec<_> = items
        .filter_map(|item| match item {
            Item::Exchange(told) if told.header.frame_id != "board" => Some(told.clock_ns),
            _ => None,
        })
        .collect();
    assert!(told.len() > 100, "{} exchanges", told.len());
    let span = begun..boot_ns() + 10_000_000;
    assert!(told.iter().all(|clock_ns| span.contains(clock_ns)));

    // The files of the video come through it too.
    rig.phone().wait_saved().unwrap();
    let phase = recorded.phones[0].video.unwrap().phase.0.to_string();
    let mut command = Command::new(smartdepthsync());
    command.args(["phone", "get-files", "--phase", &phase, "--out"]);
    let output = phone.show(command.arg(&folder)).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let found = phone::video_files::find(&folder, None).unwrap().unwrap();
    assert_eq!(found.missing(), ["video (.mp4)"]);
    phone.wait_until_clean();
    rig.rig.stop().unwrap();
}

/// A phone on which the program does not run, as where it may not.
#[test]
fn ctrl_c_leaves_nothing_on_a_phone_whose_program_does_not_answer() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(19, SPEED);
    let phone = AdbPhone::new(rig.phone().storage(), "false");
    let mut command = rig.record("silent", &["--track"]);
    let session = Session::start(phone.show(&mut command));
    phone.wait_for_programs(1);
    session.signal(Signal::INT);
    let (status, said) = session.end();
    // A computer that stands still for seconds has given it up by itself.
    let codes = [INTERRUPTED, PHONE].map(Some);
    assert!(codes.contains(&status.code()), "{status}: {said}");
    phone.wait_until_clean();
    rig.rig.stop().unwrap();
}
