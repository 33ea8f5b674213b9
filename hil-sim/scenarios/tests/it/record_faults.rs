//! `smartdepthsync record` over the process boundary, on the whole simulated
//! rig, when something is missing, goes away or is stopped, in every state of a
//! session: what it says, how it exits, and in which state it leaves phone,
//! trigger and files.

use std::io::Write as _;
use std::process::Command;

use crate::support::smartdepthsync;
use crate::turn;
use crate::whole_rig::{OVERSHOOT_S, SPEED, Session, WholeRig};
use recording::finding::Severity;
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};
use rig::phone::LinkFault;
use rustix::process::Signal;
use serde_json::Value;
use test_support::interrupts;

// Exit codes, as docs/exit-codes.md has them.
const REFUSED: i32 = 3;
const LOSS: i32 = 4;
const NO_PORT: i32 = 5;
const LINK_LOST: i32 = 11;
const PHONE: i32 = 12;
const STORAGE: i32 = 13;
const DEPTH_RECORDER: i32 = 14;
const INTERRUPTED: i32 = 130;

/// What a session says when it comes into a state.
const STATES: [&str; 6] = [
    "recording into",
    "twist 1: twist now",
    "the trigger runs",
    "the phone records",
    "aligning:",
    "recording for",
];

/// The train is stopped, and the phone records nothing.
pub(crate) fn all_is_stopped(rig: &WholeRig, state: &str) {
    assert!(!rig.phone().is_recording(), "{state}: the phone records");
    let output = Command::new(smartdepthsync())
        .args(["trigger", "status", "--json", "--port"])
        .arg(rig.rig.port())
        .output()
        .unwrap();
    assert!(output.status.success(), "{state}: {output:?}");
    let status: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(status["state"], "Stopped", "{state}: {status}");
}

/// The files of a recording can be read, and say how it ended.
pub(crate) fn readable(rig: &WholeRig, name: &str, outcome: SessionOutcome) -> SessionFile {
    let folder = rig.recording(name);
    let session = SessionFile::load(&folder).unwrap();
    assert_eq!(session.outcome, Some(outcome), "{name}");
    let mut reader = Reader::open(&folder).unwrap();
    let samples = reader
        .by_ref()
        .filter(|entry| matches!(entry.as_ref().unwrap().item, Item::Imu(_)))
        .count();
    assert!(samples > 0, "{name} has no samples");
    assert!(!reader.broken_off(), "{name}");
    session
}

pub(crate) fn problems(session: &SessionFile) -> Vec<&str> {
    session.problems.iter().map(|p| p.kind.as_str()).collect()
}

#[test]
fn without_phone_or_board_nothing_is_made() {
    let _turn = turn::beside_others();
    let rig = WholeRig::with(2, SPEED, |_, phone| "v.0.2".clone_into(&mut phone.version));
    let said = Session::start(&mut rig.record("version", &[])).ends_with(PHONE);
    assert!(said.contains("v.0.2") && said.contains("v.0.1.1"), "{said}");

    rig.phone().leave_network();
    let said = Session::start(&mut rig.record("no_phone", &[])).ends_with(PHONE);
    assert!(said.contains(&rig.phone().address().to_string()), "{said}");
    rig.phone().join_network().unwrap();

    rig.rig.unplug();
    let said = Session::start(&mut rig.record("no_board", &[])).ends_with(NO_PORT);
    assert!(said.contains("no port"), "{said}");
    assert!(!rig.out().exists());
}

#[test]
fn ctrl_c_stops_cleanly_in_every_state() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(3, SPEED);
    // Before anything was made: the phone does not answer.
    rig.phone().set_fault(Some(LinkFault::Silent));
    let session = Session::start(&mut rig.record("silent", &[]));
    interrupts::wait_until_caught(session.id());
    std::thread::sleep(std::time::Duration::from_millis(500));
    session.signal(Signal::INT);
    let said = session.ends_with(INTERRUPTED);
    assert!(said.contains("before anything was recorded"), "{said}");
    assert!(!rig.out().exists());
    rig.phone().set_fault(None);

    // The slow way to the grid, so that it lasts.
    let profile = rig.profile().replace("slew_us = 1000", "slew_us = 20");
    for (number, state) in STATES.into_iter().enumerate() {
        let name = format!("state_{number}");
        let mut command = rig.record_with(&name, &profile, &["--duration", "60s"]);
        let mut session = Session::start(&mut command);
        session.wait_for(state);
        rig.wait_ms(200);
        session.signal(Signal::INT);
        session.ends_with(INTERRUPTED);
        readable(&rig, &name, SessionOutcome::Interrupted);
        all_is_stopped(&rig, state);
    }

    // After the recording: the rest is left out, what was recorded stays.
    let after = ["--duration", "2s", "--second-twist"];
    let mut command = rig.record_with("second_twist", &long_twists(&rig), &after);
    let mut session = Session::start(&mut command);
    session.wait_for("twist 2: twist now");
    session.signal(Signal::INT);
    session.ends_with(INTERRUPTED);
    let file = readable(&rig, "second_twist", SessionOutcome::Interrupted);
    assert!(file.recorded.unwrap().to > file.recorded.unwrap().from);
    all_is_stopped(&rig, "second twist");

    let after = ["--duration", "15s", "--fetch-video"];
    let mut session = Session::start(&mut rig.record("fetch", &after));
    session.wait_for("recording for");
    rig.phone().set_fault(Some(LinkFault::Slow(20)));
    while rig.phone().is_recording() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    std::thread::sleep(std::time::Duration::from_millis(500));
    session.signal(Signal::INT);
    session.ends_with(INTERRUPTED);
    rig.phone().set_fault(None);
    readable(&rig, "fetch", SessionOutcome::Interrupted);
    // Half a video is not left under its name.
    for file in std::fs::read_dir(rig.recording("fetch")).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap();
        assert!(!name.ends_with(".mp4"), "{name}");
    }
    all_is_stopped(&rig, "fetch");
}

#[test]
fn a_phone_that_goes_away_ends_the_session_or_is_a_loss() {
    let _turn = turn::beside_others();
    let rig = WholeRig::with(4, SPEED, |_, phone| {
        // Then a start takes 8 s, of at most 10 s.
        phone.camera.first_frame_ms = (6_000.0, 6_000.0);
    });
    for (state, code, outcome) in [
        ("twist 1: twist now", PHONE, SessionOutcome::Failed),
        ("the trigger runs", PHONE, SessionOutcome::Failed),
        // From here on the board records on: the phone is missed when it is to
        // be stopped.
        ("the phone records", LOSS, SessionOutcome::Loss),
        ("aligning:", LOSS, SessionOutcome::Loss),
        ("recording for", LOSS, SessionOutcome::Loss),
        ("twist 2: twist now", LOSS, SessionOutcome::Loss),
    ] {
        let name = state.replace(|c: char| !c.is_ascii_alphanumeric(), "_");
        let arguments = ["--duration", "15s", "--second-twist"];
        // The slow way to the grid, so that it lasts.
        let profile = long_twists(&rig).replace("slew_us = 1000", "slew_us = 100");
        let mut session = Session::start(&mut rig.record_with(&name, &profile, &arguments));
        session.wait_for(state);
        rig.wait_ms(100);
        rig.phone().leave_network();
        let said = session.ends_with(code);
        assert!(said.contains("phone"), "{state}: {said}");
        rig.phone().join_network().unwrap();
        rig.stop_phone();
        let file = readable(&rig, &name, outcome);
        assert!(!problems(&file).is_empty(), "{state}");
        all_is_stopped(&rig, state);
    }

    // It comes back in time: a break between two requests costs nothing.
    let mut session = Session::start(&mut rig.record("back", &["--duration", "5s"]));
    session.wait_for("recording for");
    rig.phone().leave_network();
    rig.wait_ms(500);
    rig.phone().join_network().unwrap();
    session.ends_with(0);
    readable(&rig, "back", SessionOutcome::Good);
    all_is_stopped(&rig, "back");

    // Or while it is to be stopped, which is after 2 s: it is asked again.
    let mut session = Session::start(&mut rig.record("late", &["--duration", "2s"]));
    session.wait_for("recording for");
    rig.phone().leave_network();
    rig.wait_ms(8_000);
    rig.phone().join_network().unwrap();
    session.ends_with(0);
    readable(&rig, "late", SessionOutcome::Good);
    all_is_stopped(&rig, "late");

    // A download that breaks off: the recording is there, the video is not.
    rig.phone().set_fault(Some(LinkFault::ShortVideo(10)));
    let arguments = ["--duration", "2s", "--fetch-video"];
    let said = Session::start(&mut rig.record("short", &arguments)).ends_with(LOSS);
    assert!(said.contains("video"), "{said}");
    let file = readable(&rig, "short", SessionOutcome::Loss);
    assert_eq!(problems(&file), ["video_not_fetched"]);
}

#[test]
fn a_board_that_is_unplugged_and_comes_back_keeps_its_time() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(5, SPEED);
    for (number, state) in STATES.into_iter().enumerate() {
        let name = format!("state_{number}");
        let mut command = rig.record_with(&name, &rig.full_rate_profile(), &["--duration", "25s"]);
        let mut session = Session::start(&mut command);
        session.wait_for(state);
        rig.wait_ms(100);
        rig.rig.unplug();
        rig.wait_ms(500);
        rig.rig.plug();
        let (status, said) = session.end();
        assert!(said.contains("the link is back"), "{state}: {said}");
        // In a twist the missing samples may cost the twist, and the next is good.
        assert_eq!(status.code(), Some(LOSS), "{state}: {said}");
        let file = readable(&rig, &name, SessionOutcome::Loss);
        assert_eq!(file.reconnects, 1, "{state}");
        assert!(problems(&file).contains(&"link_lost"), "{state}");
        // Board time went on: the recording has the length that was asked for.
        let span = file.recorded.unwrap();
        let seconds = (span.to - span.from).as_secs_f64();
        let asked = 25.0..25.0 + OVERSHOOT_S;
        assert!(asked.contains(&seconds), "{state}: {seconds}");
        all_is_stopped(&rig, state);
    }
}

#[test]
fn a_board_that_is_reset_before_the_recording_ends_the_session() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(6, SPEED);
    // The slow way to the grid, so that it lasts.
    let profile = rig.profile().replace("slew_us = 1000", "slew_us = 20");
    let before = &STATES[..STATES.len() - 1];
    for (number, state) in before.iter().copied().enumerate() {
        let name = format!("state_{number}");
        let mut command = rig.record_with(&name, &profile, &["--duration", "60s"]);
        let mut session = Session::start(&mut command);
        session.wait_for(state);
        rig.wait_ms(100);
        rig.rig.press_reset();
        let said = session.ends_with(LINK_LOST);
        assert!(said.contains("so the session ends here"), "{state}: {said}");
        readable(&rig, &name, SessionOutcome::Failed);
        all_is_stopped(&rig, state);
    }
}

#[test]
fn a_board_that_stays_away_is_waited_for_until_somebody_stops_it() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(7, SPEED);
    let mut session = Session::start(&mut rig.record("away", &["--duration", "60s"]));
    session.wait_for("recording for");
    rig.wait_ms(100);
    rig.rig.unplug();
    std::thread::sleep(std::time::Duration::from_millis(500));
    session.signal(Signal::INT);
    let said = session.ends_with(INTERRUPTED);
    assert!(said.contains("trigger could not be stopped"), "{said}");
    let file = readable(&rig, "away", SessionOutcome::Interrupted);
    assert!(problems(&file).contains(&"link_lost"));
    assert!(!rig.phone().is_recording());

    // The next session finds the train running and takes it over.
    rig.rig.plug();
    Session::start(&mut rig.record("next", &["--duration", "2s"])).ends_with(0);
    readable(&rig, "next", SessionOutcome::Good);
    all_is_stopped(&rig, "next");
}

#[test]
fn a_board_that_never_comes_back_ends_the_session_with_all_that_was_recorded() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(10, SPEED);
    let arguments = ["--duration", "60s", "--link-patience", "2s"];
    let mut session = Session::start(&mut rig.record("never", &arguments));
    session.wait_for("recording for");
    rig.wait_ms(3_000);
    let unplugged = rig.rig.now().as_secs_f64();
    rig.rig.unplug();
    let said = session.ends_with(LINK_LOST);
    assert!(said.contains("did not come back within 2 s"), "{said}");
    assert!(said.contains("check the USB cable"), "{said}");
    let file = readable(&rig, "never", SessionOutcome::Failed);
    assert!(problems(&file).contains(&"link_lost"));
    assert!(!rig.phone().is_recording());
    // All that had come is there.
    let last = Reader::open(&rig.recording("never"))
        .unwrap()
        .filter_map(|entry| entry.ok())
        .filter(|entry| matches!(entry.item, Item::Imu(_)))
        .last()
        .unwrap();
    let missing = unplugged - last.at.as_secs_f64();
    assert!(missing < 1.0, "{missing}");

    // A phone that is away at once is asked for again by whoever is there, and
    // left by them.
    rig.rig.plug();
    rig.phone().leave_network();
    let (mut session, mut keys) = Session::at_keys(&mut asking(&rig.record("asked", &[])));
    session.wait_for("[Enter] or [r] try again");
    rig.phone().join_network().unwrap();
    keys.write_all(b"\n").unwrap();
    session.wait_for("recording into");
    session.wait_for("[Enter] to begin");
    keys.write_all(b"q\n").unwrap();
    session.ends_with(INTERRUPTED);
    readable(&rig, "asked", SessionOutcome::Interrupted);
}

/// The profile with twists that last.
fn long_twists(rig: &WholeRig) -> String {
    rig.profile().replace("twist_s = 6", "twist_s = 15")
}

/// The same command with somebody there who answers.
fn asking(command: &Command) -> Command {
    let mut asking = Command::new(command.get_program());
    asking.args(command.get_args().filter(|argument| *argument != "--yes"));
    asking
}

#[test]
fn a_twist_that_is_needed_cannot_be_left_out() {
    let _turn = turn::beside_others();
    // At rest no twist relates the clocks.
    let rig = WholeRig::with(15, SPEED, |config, _| {
        config.motion = "rest".parse().unwrap();
    });
    let (mut session, mut keys) = Session::at_keys(&mut asking(&rig.record("kept", &[])));
    session.wait_for("[Enter] to begin");
    keys.write_all(b"s\n").unwrap();
    session.wait_for("this twist cannot be left out");
    assert!(!session.said().contains("twist now"), "{}", session.said());
    keys.write_all(b"\n").unwrap();
    session.wait_for("[Enter] or [r] twist again");
    keys.write_all(b"s\n").unwrap();
    keys.write_all(b"q\n").unwrap();
    let said = session.ends_with(INTERRUPTED);
    assert_eq!(said.matches("cannot be left out").count(), 2, "{said}");
    readable(&rig, "kept", SessionOutcome::Interrupted);
}

/// Bytes come, but nothing that is understood: no sign of life.
#[test]
fn a_link_that_only_gives_damage_ends_the_recording_in_its_time() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(14, SPEED);
    // Its length does not end it.
    let arguments = ["--duration", "6000s", "--link-patience", "2s"];
    let mut session = Session::start(&mut rig.record("damage", &arguments));
    session.wait_for("recording for");
    rig.rig.corrupt(1_000_000);
    let said = session.ends_with(LINK_LOST);
    assert!(
        said.contains("no message came from the board for 5 s"),
        "{said}"
    );
    let file = readable(&rig, "damage", SessionOutcome::Failed);
    assert!(
        problems(&file).contains(&"link_lost"),
        "{:?}",
        problems(&file)
    );
}

#[test]
fn what_is_bad_before_a_recording_ends_it_and_says_what_to_do() {
    let _turn = turn::beside_others();
    let rig = WholeRig::with(13, SPEED, |config, _| config.imu = None);
    let said = Session::start(&mut rig.record("no_imu", &["--duration", "2s"])).ends_with(REFUSED);
    assert!(said.contains("IMU: no samples"), "{said}");
    assert!(said.contains("check its wiring"), "{said}");
    assert!(!said.contains("twist 1"), "{said}");
    let file = SessionFile::load(&rig.recording("no_imu")).unwrap();
    assert_eq!(file.outcome, Some(SessionOutcome::Failed));
    let verdict = |name: &str| {
        let check = file.preflight.iter().find(|check| check.kind == name);
        check.unwrap_or_else(|| panic!("{name}")).severity
    };
    assert_eq!(verdict("IMU"), Severity::Bad);
    assert_eq!(verdict("disk"), Severity::Good);
    assert_eq!(verdict("constant bias"), Severity::Check);
    assert_eq!(verdict("phone"), Severity::Good);
    all_is_stopped(&rig, "no IMU");
}

#[test]
fn a_full_disk_ends_the_session_and_what_was_written_can_be_read() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(8, SPEED);
    // The system refuses to let a file grow beyond 512 kB, as a full disk does.
    let wanted = rig.record("full", &["--duration", "600s"]);
    let mut command = Command::new("sh");
    command
        .args([
            "-c",
            "ulimit -f 1024; exec env --default-signal=XFSZ \"$0\" \"$@\"",
        ])
        .arg(wanted.get_program())
        .args(wanted.get_args());
    let said = Session::start(&mut command).ends_with(STORAGE);
    assert!(said.contains("File too large"), "{said}");
    let folder = rig.recording("full");
    let samples = Reader::open(&folder)
        .unwrap()
        .filter(|entry| matches!(entry.as_ref().map(|e| &e.item), Ok(Item::Imu(_))))
        .count();
    assert!(samples > 500, "{samples}");
    all_is_stopped(&rig, "full disk");
}

#[test]
fn the_depth_recorder_is_started_watched_and_stopped() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(9, SPEED);
    let profile =
        |command: &str| format!("{}\n[depth.recorder]\ncommand = {command}\n", rig.profile());
    let none = profile("[\"no-such-depth-recorder\"]");
    let mut command = rig.record_with("none", &none, &["--duration", "2s"]);
    let said = Session::start(&mut command).ends_with(DEPTH_RECORDER);
    assert!(said.contains("no-such-depth-recorder"), "{said}");
    // It is said before anybody has twisted anything.
    assert!(!said.contains("twist 1"), "{said}");
    readable(&rig, "none", SessionOutcome::Failed);
    all_is_stopped(&rig, "none");

    let gone = profile("[\"sh\", \"-c\", \"sleep 2; exit 3\"]");
    let mut command = rig.record_with("gone", &gone, &["--duration", "60s"]);
    let said = Session::start(&mut command).ends_with(LOSS);
    assert!(said.contains("ended by itself"), "{said}");
    let file = readable(&rig, "gone", SessionOutcome::Loss);
    assert_eq!(problems(&file), ["depth_recorder_gone"]);

    let good = profile("[\"sh\", \"-c\", \"echo {fps} > {folder}/depth.txt; exec sleep 600\"]");
    let mut command = rig.record_with("good", &good, &["--duration", "10s"]);
    Session::start(&mut command).ends_with(0);
    readable(&rig, "good", SessionOutcome::Good);
    let text = std::fs::read_to_string(rig.recording("good").join("depth.txt")).unwrap();
    assert_eq!(text, "30\n");
}

/// Killed, the program can stop nothing any more: its guard does.
#[test]
fn a_kill_takes_the_depth_recorder_along() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(15, SPEED);
    let profile = format!(
        "{}\n[depth.recorder]\nstop = \"terminate\"\ncommand = [\"sh\", \"-c\", \"echo $$ > \
         {{folder}}/pid; exec sleep 600\"]\n",
        rig.profile()
    );
    let mut session = Session::start(&mut rig.record_with("kill", &profile, &[]));
    session.wait_for("the trigger runs");
    let recorder = format!("/proc/{}", recorder_pid(&rig, "kill"));
    let recorder = std::path::PathBuf::from(recorder);
    assert!(recorder.exists());
    session.signal(Signal::KILL);
    session.end();
    let began = std::time::Instant::now();
    while recorder.exists() {
        assert!(began.elapsed().as_secs() < 60, "the recorder lives on");
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    rig.stop_phone();
}

/// The number that a depth recorder writes into its recording.
fn recorder_pid(rig: &WholeRig, name: &str) -> i32 {
    let file = rig.recording(name).join("pid");
    loop {
        match std::fs::read_to_string(&file) {
            Ok(pid) if pid.ends_with('\n') => return pid.trim().parse().unwrap(),
            _ => rig.wait_ms(10),
        }
    }
}

#[test]
fn a_folder_that_is_deleted_while_it_records_ends_the_session_at_once() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(17, SPEED);
    let mut session = Session::start(&mut rig.record("gone", &["--duration", "600s"]));
    session.wait_for("recording for");
    std::fs::remove_dir_all(rig.recording("gone")).unwrap();
    let began = std::time::Instant::now();
    let said = session.ends_with(STORAGE);
    assert!(began.elapsed().as_secs() < 20, "{said}");
    assert!(said.contains("was deleted or moved"), "{said}");
    all_is_stopped(&rig, "folder deleted");
}
