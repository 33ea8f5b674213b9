//! `smartdepthsync record --track` with a phone behind `adb`.

use crate::adb_phone::AdbPhone;
use crate::support::tool;
use crate::whole_rig::{Session, WholeRig};
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};
use rustix::process::Signal;
use serde_json::Value;
use test_support::processes::is_installed;

/// Sessions that follow a clock pass as fast as the computer's.
const SPEED: f64 = 1.0;

// Exit codes, as docs/troubleshooting.md has them.
const PHONE: i32 = 12;
const INTERRUPTED: i32 = 130;

/// The computer's boot clock, ns, to a hundredth of a second.
fn boot_ns() -> i64 {
    let text = std::fs::read_to_string("/proc/uptime").unwrap();
    let seconds: f64 = text.split(' ').next().unwrap().parse().unwrap();
    (seconds * 1e9) as i64
}

/// With Debian's `adb`, and the program for phones as it is: it reads the computer's clock,
/// which the simulated phone then has.
#[test]
fn a_phone_behind_adb_is_followed_again_when_it_comes_back_and_nothing_is_left() {
    if !is_installed("qemu-aarch64", "qemu-user") {
        return;
    }
    let begun = boot_ns();
    let rig = WholeRig::with(18, SPEED, |_, phone| {
        phone.clock.offset_ns = begun;
        phone.clock.rate_ppm = 0.0;
    });
    let phone = AdbPhone::new(rig.phone().app.storage(), "qemu-aarch64");
    // Without a length: how long a busy computer takes to all this is not known.
    let mut command = rig.record("pulled", &["--track", "always", "--no-fetch", "--events"]);
    let mut session = Session::start(phone.show(&mut command));
    session.wait_for("tracked", |event| event["tracked"]["holds"] == true);
    let forwarded = phone.adb(&["forward", "--list"]);
    assert!(forwarded.contains(&phone.serial()), "{forwarded}");
    phone.pull();
    session.wait_for("track_lost", |_| true);
    phone.plug();
    phone.wait_for_programs(2);
    session.wait_for("track_back", |_| true);
    session.signal(Signal::INT);
    let (_, said) = session.end();

    let folder = rig.recording("pulled");
    let recorded = SessionFile::load(&folder).unwrap();
    assert_eq!(recorded.outcome, Some(SessionOutcome::Interrupted));
    let tracking = recorded.tracking.unwrap();
    assert_eq!(tracking.device, phone.serial());
    // A computer that pauses for seconds loses it once more, and says so.
    let events = said
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let lost = events
        .filter(|event| event["event"] == "track_lost")
        .count();
    assert_eq!(usize::try_from(tracking.lost).unwrap(), lost, "{said}");
    // What the session notes by itself does not divide the data set.
    assert!(recorded.markers.is_empty(), "{:?}", recorded.markers);
    let items = Reader::open(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().item);
    let clocks: Vec<_> = items
        .filter_map(|item| match item {
            Item::Exchange(exchange) if exchange.header.frame_id != "board" => {
                Some(exchange.clock_ns)
            }
            _ => None,
        })
        .collect();
    assert!(clocks.len() > 100, "{} exchanges", clocks.len());
    let span = begun..boot_ns() + 10_000_000;
    assert!(clocks.iter().all(|clock_ns| span.contains(clock_ns)));

    // The files of the video come through it too.
    rig.phone().app.wait_saved().unwrap();
    let phase = recorded.phones[0].video.unwrap().phase.0.to_string();
    let mut command = tool();
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
    let rig = WholeRig::new(19, SPEED);
    let phone = AdbPhone::new(rig.phone().app.storage(), "false");
    let mut command = rig.record("silent", &["--track", "always"]);
    let session = Session::start(phone.show(&mut command));
    phone.wait_for_programs(1);
    session.signal(Signal::INT);
    let (status, said) = session.end();
    // A computer that pauses for seconds has given it up by itself.
    let codes = [INTERRUPTED, PHONE].map(Some);
    assert!(codes.contains(&status.code()), "{status}: {said}");
    phone.wait_until_clean();
    rig.rig.stop().unwrap();
}
