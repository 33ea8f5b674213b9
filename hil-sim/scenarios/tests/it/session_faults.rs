//! Sessions in which something is missing, goes away or is stopped, in every state: how they
//! end, and in which state they leave phone, trigger and files.

use std::cell::RefCell;
use std::rc::Rc;

use board::BoardError;
use board::finding::{EventKind, Severity};
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};
use recording::{MCAP_FILE, SESSION_FILE};
use rig::motion::MotionSpec;
use rig::random::{Seed, Stream};
use scenarios::virtual_session::Run;
use session::devices::{Choice, Wish};
use session::error::SessionError;
use session::event::{Prompt, SessionEvent, Step};

use crate::bench::{
    STATES, Twisted, is_fetching, is_recording, is_second_twist, ms, nth, outcome, problems,
};

/// Error of a session that failed.
fn failure(run: &Run) -> &SessionError {
    match &run.ended {
        Err(error) => error,
        Ok(Some(ended)) => ended.result.as_ref().unwrap_err(),
        Ok(None) => panic!("it was interrupted"),
    }
}

#[test]
fn without_phone_or_board_nothing_is_made() {
    let mut rig = Twisted::with(2, |_, phone| "v.0.2".clone_into(&mut phone.version));
    let options = rig.options("none", 5);
    let run = rig.bench.run(&options);
    let error = failure(&run);
    assert!(matches!(error, SessionError::Phone { .. }), "{error}");

    rig.bench.with(|rig| rig.phones[0].leave_network());
    let run = rig.bench.run(&options);
    let error = failure(&run);
    assert!(matches!(error, SessionError::Phone { .. }), "{error}");
    rig.bench.with(|rig| rig.phones[0].join_network());

    rig.bench.with(|rig| {
        rig.sim.usb_unplug();
        rig.pass(ms(100));
    });
    let run = rig.bench.run(&options);
    let error = failure(&run);
    let is_open = matches!(error, SessionError::Board(BoardError::Open(_)));
    assert!(is_open, "{error}");
    assert!(!rig.recording("none").exists());
}

#[test]
fn an_interrupt_before_the_phone_answers_leaves_no_folder() {
    let mut rig = Twisted::new(3);
    let hands = rig.bench.hands();
    rig.bench.with(|rig| {
        rig.phones[0].set_silent(true);
        let at = rig.now() + ms(3_000);
        rig.at(at, move |_| hands.interrupt());
    });
    let options = rig.options("silent", 60);
    let run = rig.bench.run(&options);
    assert!(matches!(run.ended, Ok(None)), "{:?}", run.ended);
    assert!(!rig.recording("silent").exists());
}

#[test]
fn an_interrupt_ends_a_session_in_order_in_every_state() {
    let mut rig = Twisted::new(3);
    // The slow way to the grid, so that it lasts.
    rig.bench.profile.align.slew_us = 20.0;
    for (state, is_it) in STATES {
        rig.interrupt_on(is_it);
        let options = rig.options(state, 60);
        let run = rig.bench.run(&options);
        assert_eq!(outcome(&run), SessionOutcome::Interrupted, "{state}");
        rig.readable(state, SessionOutcome::Interrupted);
        rig.all_is_stopped(state);
    }
}

#[test]
fn an_interrupt_after_the_recording_keeps_it_and_leaves_out_the_rest() {
    let mut rig = Twisted::new(3);
    rig.interrupt_on(is_second_twist);
    let mut options = rig.options("second_twist", 2);
    options.second_twist = true;
    rig.bench.run(&options);
    let file = rig.readable("second_twist", SessionOutcome::Interrupted);
    assert!(file.recorded.unwrap().to > file.recorded.unwrap().from);
    rig.all_is_stopped("second twist");
}

#[test]
fn an_interrupt_of_a_download_that_never_ends_leaves_no_part_of_the_video() {
    let mut rig = Twisted::new(3);
    let hands = rig.bench.hands();
    rig.soon_after(is_fetching, move |rig| {
        rig.phones[0].set_silent(true);
        let at = rig.now() + ms(5_000);
        rig.at(at, move |_| hands.interrupt());
    });
    let mut options = rig.options("fetch", 2);
    options.fetch_video = true;
    rig.bench.run(&options);
    rig.bench.with(|rig| rig.phones[0].set_silent(false));
    rig.readable("fetch", SessionOutcome::Interrupted);
    for file in std::fs::read_dir(rig.recording("fetch")).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap();
        assert!(!name.ends_with(".mp4"), "{name}");
    }
    rig.all_is_stopped("fetch");
}

#[test]
fn a_phone_that_goes_away_ends_the_session_or_is_a_loss() {
    let mut rig = Twisted::with(4, |_, phone| {
        // Then a start takes 8 s, of at most 10 s.
        phone.camera.first_frame_ms = (6_000.0, 6_000.0);
    });
    let states = STATES[1..].iter().copied();
    for (state, is_it) in states.chain([("second twist", is_second_twist as _)]) {
        rig.soon_after(is_it, |rig| rig.phones[0].leave_network());
        let mut options = rig.options(state, 2);
        options.second_twist = true;
        let run = rig.bench.run(&options);
        rig.bench.with(|rig| rig.phones[0].join_network());
        rig.stop_phone();
        // From the video on the board records on: the phone is missed when it is to be
        // stopped.
        let expected = match state {
            "twist" | "trigger" => {
                let error = failure(&run);
                assert!(matches!(error, SessionError::Phone { .. }), "{error}");
                SessionOutcome::Failed
            }
            _ => SessionOutcome::Loss,
        };
        let file = rig.readable(state, expected);
        assert!(!problems(&file).is_empty(), "{state}");
        rig.all_is_stopped(state);
    }
}

/// A break between two requests costs nothing; nor one while it is to be stopped, which is
/// after 2 s: it is asked again.
#[test]
fn a_phone_that_comes_back_in_time_costs_nothing() {
    let mut rig = Twisted::new(4);
    for (name, length, away) in [("back", 5, 500), ("late", 2, 5_000)] {
        rig.soon_after(is_recording, move |rig| {
            rig.phones[0].leave_network();
            let back = rig.now() + ms(away);
            rig.at(back, |rig| rig.phones[0].join_network());
        });
        rig.record(name, length);
    }
}

#[test]
fn a_phone_that_leaves_before_the_download_costs_the_video_alone() {
    let mut rig = Twisted::new(4);
    rig.bench
        .on(is_fetching, ms(0), |rig| rig.phones[0].leave_network());
    let mut options = rig.options("short", 2);
    options.fetch_video = true;
    rig.bench.run(&options);
    let file = rig.readable("short", SessionOutcome::Loss);
    assert_eq!(problems(&file), [EventKind::VideoNotFetched]);
}

#[test]
fn a_board_that_is_unplugged_and_comes_back_keeps_its_time() {
    let mut rig = Twisted::new(5);
    for (state, is_it) in STATES {
        rig.soon_after(is_it, |rig| {
            rig.sim.usb_unplug();
            let back = rig.now() + ms(500);
            rig.at(back, |rig| rig.sim.usb_plug());
        });
        let options = rig.options(state, 2);
        let run = rig.bench.run(&options);
        let is_back = |event: &SessionEvent| matches!(event, SessionEvent::LinkBack { .. });
        assert!(run.time_of(is_back).is_some(), "{state}");
        let file = rig.readable(state, SessionOutcome::Loss);
        assert_eq!(file.reconnects, 1, "{state}");
        assert!(
            problems(&file).contains(&EventKind::LinkLost.into()),
            "{state}"
        );
        // Board time went on: the recording has the length that was asked for.
        let span = file.recorded.unwrap();
        let length = (span.to - span.from).as_secs_f64();
        assert!((2.0..2.5).contains(&length), "{state}: {length}");
        rig.all_is_stopped(state);
    }
}

#[test]
fn a_board_that_is_reset_before_the_recording_ends_the_session() {
    let mut rig = Twisted::new(6);
    // The slow way to the grid, so that it lasts.
    rig.bench.profile.align.slew_us = 20.0;
    for (state, is_it) in &STATES[..5] {
        rig.soon_after(is_it, |rig| rig.press_reset());
        let options = rig.options(state, 60);
        let run = rig.bench.run(&options);
        let error = failure(&run);
        assert!(
            matches!(error, SessionError::BoardReset { .. }),
            "{state}: {error}"
        );
        rig.readable(state, SessionOutcome::Failed);
        rig.all_is_stopped(state);
    }
}

#[test]
fn a_board_that_stays_away_is_waited_for_until_somebody_stops_it() {
    let mut rig = Twisted::new(7);
    let hands = rig.bench.hands();
    rig.soon_after(is_recording, move |rig| {
        rig.sim.usb_unplug();
        let at = rig.now() + ms(20_000);
        rig.at(at, move |_| hands.interrupt());
    });
    let options = rig.options("away", 60);
    rig.bench.run(&options);
    let file = rig.readable("away", SessionOutcome::Interrupted);
    for problem in [EventKind::LinkLost, EventKind::TriggerNotStopped] {
        assert!(problems(&file).contains(&problem.into()), "{problem}");
    }
    assert!(!rig.bench.with(|rig| rig.phones[0].app.is_recording()));

    // The next session finds the train running and takes it over.
    rig.bench.with(|rig| {
        rig.sim.usb_plug();
        rig.pass(ms(1_000));
    });
    rig.record("next", 2);
}

#[test]
fn a_board_that_never_comes_back_ends_the_session_with_all_that_was_recorded() {
    let mut rig = Twisted::new(10);
    let unplugged = Rc::<std::cell::Cell<f64>>::default();
    let at = Rc::clone(&unplugged);
    rig.bench.on(is_recording, ms(3_000), move |rig| {
        at.set(rig.now().as_secs_f64());
        rig.sim.usb_unplug();
    });
    let mut options = rig.options("never", 60);
    options.link_patience = std::time::Duration::from_secs(2);
    let run = rig.bench.run(&options);
    let error = failure(&run);
    assert!(matches!(error, SessionError::LinkLost { .. }), "{error}");
    let file = rig.readable("never", SessionOutcome::Failed);
    assert!(problems(&file).contains(&EventKind::LinkLost.into()));
    assert!(!rig.bench.with(|rig| rig.phones[0].app.is_recording()));
    // All that had come is there.
    let samples = Reader::open(&rig.recording("never")).unwrap();
    let samples = samples.filter_map(Result::ok);
    let last = samples.filter(|entry| matches!(entry.item, Item::Imu(_)));
    let last = last.last().unwrap().at.as_secs_f64();
    let zero = rig.bench.stop().unwrap().zero.unwrap().as_secs_f64();
    let missing = unplugged.get() - zero - last;
    assert!((0.0..0.02).contains(&missing), "{missing}");
}

/// Returns true if a prompt asks for this step again.
fn asks_again(event: &SessionEvent, wanted: Step) -> bool {
    matches!(event, SessionEvent::Prompt { prompt: Prompt::Repeat { step, .. } } if *step == wanted)
}

fn asks_to_twist(event: &SessionEvent) -> bool {
    let prompt = |prompt: &Prompt| matches!(prompt, Prompt::Twist { .. });
    matches!(event, SessionEvent::Prompt { prompt: asked } if prompt(asked))
}

fn asks(wanted: Prompt) -> impl Fn(&SessionEvent) -> bool {
    move |event| matches!(event, SessionEvent::Prompt { prompt } if *prompt == wanted)
}

#[test]
fn a_person_tries_again_and_leaves() {
    let mut rig = Twisted::new(11);
    rig.bench.seat_person();
    rig.bench.with(|rig| rig.phones[0].leave_network());
    let hands = rig.bench.hands();
    rig.soon_after(
        |event| asks_again(event, Step::Connect),
        move |rig| {
            rig.phones[0].join_network();
            hands.answer(Choice::Repeat);
        },
    );
    rig.answer_on(asks_to_twist, Choice::Quit);
    let options = rig.options("asked", 60);
    rig.bench.run(&options);
    rig.readable("asked", SessionOutcome::Interrupted);
}

#[test]
fn a_person_goes_through_a_session_by_keys_and_sets_marks() {
    let mut rig = Twisted::new(11);
    rig.bench.seat_person();
    rig.answer_on(asks_to_twist, Choice::Continue);
    rig.answer_on(asks(Prompt::TwistGood), Choice::Continue);
    let hands = rig.bench.hands();
    rig.soon_after(is_recording, move |rig| {
        hands.wish(Wish::Mark(None));
        hands.wish(Wish::Mark(Some(String::from("door"))));
        let at = rig.now() + ms(2_000);
        rig.at(at, move |_| hands.wish(Wish::Stop));
    });
    let options = rig.bench.options("marked");
    rig.bench.run(&options).good().unwrap();
    let file = rig.readable("marked", SessionOutcome::Good);
    let labels: Vec<&str> = file.markers.iter().map(|m| m.label.as_str()).collect();
    assert_eq!(labels, ["marker 1", "door"]);
    rig.all_is_stopped("marked");
}

#[test]
fn a_twist_that_is_needed_cannot_be_left_out() {
    // At rest no twist relates the clocks.
    let mut rig = Twisted::with(15, |config, _| config.motion = MotionSpec::default());
    rig.bench.seat_person();
    rig.answer_on(nth(0, asks_to_twist), Choice::Skip);
    rig.answer_on(nth(1, asks_to_twist), Choice::Continue);
    rig.answer_on(nth(0, asks(Prompt::TwistAgain)), Choice::Skip);
    rig.answer_on(nth(1, asks(Prompt::TwistAgain)), Choice::Quit);
    let options = rig.options("kept", 60);
    let run = rig.bench.run(&options);
    let refusals = run.events.iter().map(|seen| &seen.stamped.event);
    let refusals = refusals.filter(|event| asks(Prompt::CannotSkip)(event));
    assert_eq!(refusals.count(), 2);
    let twisted = run.time_of(|event| matches!(event, SessionEvent::TwistStarted { .. }));
    let refused = run.time_of(asks(Prompt::CannotSkip));
    assert!(twisted > refused, "{twisted:?}");
    rig.readable("kept", SessionOutcome::Interrupted);
}

/// Bytes come, but nothing that is understood: no sign of life.
#[test]
fn a_link_that_only_gives_damage_ends_the_recording_in_its_time() {
    let mut rig = Twisted::new(14);
    rig.soon_after(is_recording, |rig| rig.sim.usb_corrupt(1_000_000, 0));
    // Its length does not end it.
    let mut options = rig.options("damage", 6_000);
    options.link_patience = std::time::Duration::from_secs(2);
    let run = rig.bench.run(&options);
    let is_quiet = |event: &SessionEvent| matches!(event, SessionEvent::BoardQuiet { .. });
    assert!(run.time_of(is_quiet).is_some());
    let error = failure(&run);
    assert!(matches!(error, SessionError::LinkLost { .. }), "{error}");
    let file = rig.readable("damage", SessionOutcome::Failed);
    assert!(problems(&file).contains(&EventKind::LinkLost.into()));
}

#[test]
fn a_failed_check_ends_a_session_before_its_recording() {
    let mut rig = Twisted::with(13, |config, _| config.imu = None);
    let options = rig.options("no_imu", 2);
    let run = rig.bench.run(&options);
    let error = failure(&run);
    let is_imu = matches!(error, SessionError::Check { name, .. } if name == "IMU");
    assert!(is_imu, "{error}");
    let is_twist = |event: &SessionEvent| matches!(event, SessionEvent::TwistStarted { .. });
    assert!(run.time_of(is_twist).is_none());
    let file = SessionFile::load(&rig.recording("no_imu")).unwrap();
    assert_eq!(file.outcome, Some(SessionOutcome::Failed));
    let verdict = |name: &str| {
        let check = file.preflight.iter().find(|check| check.kind == name);
        check.unwrap_or_else(|| panic!("{name}")).severity
    };
    assert_eq!(verdict("IMU"), Severity::Bad);
    assert_eq!(verdict("phone"), Severity::Good);
    rig.all_is_stopped("no IMU");
}

#[test]
fn a_depth_recorder_is_watched_and_stopped() {
    let mut rig = Twisted::new(9);
    rig.bench.has_recorder = true;
    rig.record("good", 3);
    assert!(rig.recording("good").join("depth.mkv").is_file());

    let recorder = rig.bench.recorder();
    rig.soon_after(is_recording, move |_| recorder.end());
    let options = rig.options("gone", 5);
    rig.bench.run(&options);
    let file = rig.readable("gone", SessionOutcome::Loss);
    assert_eq!(problems(&file), [EventKind::DepthRecorderGone]);
    rig.all_is_stopped("gone");

    // It does not end when it is asked to.
    let recorder = rig.bench.recorder();
    rig.soon_after(is_recording, move |_| recorder.hang());
    let options = rig.options("deaf", 3);
    let run = rig.bench.run(&options);
    let is_killed = |event: &SessionEvent| matches!(event, SessionEvent::RecorderKilled { .. });
    assert!(run.time_of(is_killed).is_some());
    rig.readable("deaf", SessionOutcome::Loss);
    rig.all_is_stopped("deaf");
}

#[test]
fn a_folder_that_is_deleted_while_it_records_ends_the_session_at_once() {
    let mut rig = Twisted::new(17);
    let folder = rig.recording("gone");
    rig.soon_after(is_recording, move |_| {
        std::fs::remove_dir_all(folder).unwrap();
    });
    let options = rig.options("gone", 600);
    let run = rig.bench.run(&options);
    let error = failure(&run);
    let is_moved = matches!(error, SessionError::RecordingMoved { .. });
    assert!(is_moved, "{error}");
    rig.all_is_stopped("folder deleted");
}

/// A kill leaves of the files what the system was given of them: their copies at that moment.
#[test]
fn a_kill_at_any_moment_leaves_a_recording_that_lacks_at_most_a_second() {
    const KILLS: usize = 50;
    let mut rig = Twisted::with(11, |_, phone| {
        phone.camera.first_frame_ms = (20.0, 50.0);
    });
    let left = Rc::<RefCell<Vec<(f64, tempfile::TempDir)>>>::default();
    let (copies, recording) = (Rc::clone(&left), rig.recording("killed"));
    let connected = STATES[0].1;
    rig.bench.on(connected, ms(0), move |rig| {
        let mut random = Seed(11).stream(Stream::Test);
        for _ in 0..KILLS {
            let (copies, recording) = (Rc::clone(&copies), recording.clone());
            // A whole session to its first seconds of recording takes 14 s.
            let at = rig.now() + ms(random.uniform(0.0, 18_000.0) as u64);
            rig.at(at, move |rig| {
                let copy = tempfile::tempdir().unwrap();
                for file in [MCAP_FILE, SESSION_FILE] {
                    std::fs::copy(recording.join(file), copy.path().join(file)).unwrap();
                }
                copies.borrow_mut().push((rig.now().as_secs_f64(), copy));
            });
        }
    });
    let options = rig.options("killed", 10);
    let run = rig.bench.run(&options);
    let recorded_s = run.time_of(is_recording).unwrap().as_secs_f64();
    run.good().unwrap();

    let left = left.borrow();
    assert_eq!(left.len(), KILLS);
    let recorded = left.iter().filter(|(killed, _)| *killed > recorded_s);
    assert!(recorded.count() >= 5);
    let zero = rig.bench.stop().unwrap().zero.unwrap().as_secs_f64();
    let begun_s = left
        .iter()
        .map(|(killed, _)| *killed)
        .fold(f64::MAX, f64::min);
    for (killed, folder) in left.iter() {
        SessionFile::load(folder.path()).unwrap();
        let entries = Reader::open(folder.path()).unwrap().map(Result::unwrap);
        let samples = entries.filter(|entry| matches!(entry.item, Item::Imu(_)));
        let last = samples
            .last()
            .map_or(0.0, |entry| entry.at.as_secs_f64() + zero);
        // Without a sample yet, all since the beginning is missing.
        let missing = killed - last.max(begun_s);
        assert!(
            missing < 1.0,
            "killed at {killed:.3} s: {missing:.3} s missing"
        );
    }
}

/// An app takes a while to close its video; its sensors are busy until then.
#[test]
fn a_session_ends_well_however_long_a_stop_takes() {
    for (seed, stop_ms) in [(84, 0.0), (85, 700.0), (86, 1_400.0), (87, 2_000.0)] {
        let mut rig = Twisted::with(seed, |_, phone| phone.app.stop_ms = stop_ms);
        let mut options = rig.options("whole", 3);
        options.second_twist = true;
        options.fetch_video = true;
        let ended = rig.bench.run(&options).good().unwrap();
        assert_eq!(ended.file.phones[0].twists.len(), 2);
        assert!(ended.file.files.iter().any(|name| name.ends_with(".mp4")));
        rig.all_is_stopped("whole");
    }
}

#[test]
fn a_session_notices_that_the_video_has_ended() {
    let mut rig = Twisted::new(88);
    rig.bench.on(is_recording, ms(1_000), |rig| {
        rig.phones[0].app.press_record()
    });
    let options = rig.options("ended", 15);
    rig.bench.run(&options);
    let file = rig.readable("ended", SessionOutcome::Loss);
    assert_eq!(problems(&file), [EventKind::VideoEnded]);
    assert_eq!(file.markers.len(), 1);
    assert!(file.markers[0].label.contains("video ended"));
}

#[test]
fn a_session_whose_video_does_not_start_stops_what_it_began() {
    // The phase comes after the app's own timeout, and the video runs.
    let mut rig = Twisted::with(89, |_, phone| phone.camera.frame_period_ns = 200e6);
    let options = rig.options("slow", 5);
    let run = rig.bench.run(&options);
    let error = failure(&run);
    assert!(matches!(error, SessionError::Phone { .. }), "{error}");
    let is_undone = |event: &SessionEvent| matches!(event, SessionEvent::VideoUndone { .. });
    assert!(run.time_of(is_undone).is_some());
    assert_eq!(rig.bench.with(|rig| rig.phones[0].app.videos().len()), 1);
    rig.all_is_stopped("slow");
}
