//! Sessions and boards folded into a state.

use super::rate::Rate;
use super::*;
use std::sync::Arc;

use clock::alignment::{GridPlan, Placement};
use clock::frames::Frames;
use clock::{BoardSeconds, ClockRelation, Wander};
use protocol::Period;
use session::error::SessionError;
use session::event::{PhoneName, Step};

fn at(seconds: f64, event: SessionEvent) -> Stamped {
    let at = BoardSeconds(seconds).ticks();
    Stamped { at, event }
}

fn message(at: Ticks, message: DeviceToHost) -> Stamped {
    let event = SessionEvent::Board {
        message,
        sample: None,
    };
    Stamped { at, event }
}

fn pulse(output: Output, k: u64, at: Ticks) -> Stamped {
    let pulse = protocol::Pulse {
        output,
        seq: k as u32,
        train: 1,
        number: k,
        at,
        aligned: true,
        readback: None,
    };
    message(at, DeviceToHost::Pulse(pulse))
}

fn clock_since(reference: f64) -> ClockRelation {
    ClockRelation {
        reference,
        offset: 94_000.25,
        skew: -15.2e-6,
        covariance: [[3.1e-6 * 3.1e-6, 0.0], [0.0, 0.0]],
        wander: Wander::default(),
    }
}

/// A train of 30 fps whose grid has an edge at so many seconds, and arrives there.
fn aligned(clock: ClockRelation, seconds: f64) -> Alignment {
    let anchor = BoardSeconds(seconds).ticks();
    Alignment {
        plan: GridPlan {
            frames: Frames {
                period_ns: 1e9 / 30.0,
                ..Frames::default()
            },
            clock,
            anchor,
            period: Period::from_ticks(1_600_000),
            ..GridPlan::default()
        },
        phase_sigma_us: 3.0,
        drift_sigma_us_per_min: 1.0,
        arrival_pulse: Some(100),
        arrival: Some(anchor),
        ..Alignment::default()
    }
}

/// A state in which there is something in every place.
pub(crate) fn busy() -> State {
    let text = "[[outputs]]\noutput = 3\nname = \"side\"\nevery = 6\n\
                [lidar]\nname = \"VLP-16\"\n\
                [[phones]]\nname = \"right phone\"\naddress = \"x\"\n";
    let profile = Profile::parse(text, None).unwrap();
    let mut state = State::of_session(&profile, true);
    state.board = String::from("0123456789ABCDEF01234567");
    state.now = BoardSeconds(123.0).ticks();
    state.phase = Some(Phase::Recording {
        since: BoardSeconds(62.0).ticks(),
    });
    state.length_s = Some(300.0);
    for k in 0..250 {
        let at = 113.0 + f64::from(k) * 0.04;
        let rate = [at.sin(), at.cos(), 0.3];
        state.gyro.push_back((BoardSeconds(at).ticks(), rate));
    }
    state.trigger = Trigger {
        state: String::from("running"),
        fps: Some(30.0024),
        pulse: Some(3_456),
        readback_ns: Some(83.0),
        readback_missing: 0,
        late: 0,
    };
    state.alignment = Some(aligned(clock_since(23.0), 60.0));
    state.last_pulse = Some(BoardSeconds(122.0).ticks());
    state.phones[0].clock = Some(clock_since(23.0));
    state.phones[1].placement = Some(Placement {
        offset_us: 1_234.0,
        offset_sigma_us: 5.0,
        drift_us_per_min: 0.0,
        drift_sigma_us_per_min: 0.0,
    });
    state.disk = Some(Disk {
        free: 40_000_000_000,
        left_s: Some(3_600_000.0),
    });
    state.mark = Some((BoardSeconds(90.0).ticks(), String::from("door")));
    let lost = Finding::check("imu_gap", "2 IMU samples lost").next_step("nothing to do");
    let lost = lost.at(BoardSeconds(99.0).ticks());
    state.warnings.push_back(lost);
    state.said.push_back(String::from("mark: door"));
    let side = &mut state.sensors[1];
    side.state = Some(TrainState::Running);
    side.pulse = Some(77);
    (0..11).for_each(|k| {
        side.rate
            .add(BoardSeconds(121.0 + 0.2 * f64::from(k)).ticks())
    });
    let lidar = &mut state.sensors[LIDAR];
    lidar.utc = Some(1_795_234_567);
    (0..3).for_each(|k| lidar.rate.add(BoardSeconds(121.0 + f64::from(k)).ticks()));
    state
}

pub(crate) fn begin_twist(state: &mut State) {
    state.twist = Some((Coach::default(), 9, 10.0));
}

#[test]
fn at_rest_the_advice_is_to_twist_faster() {
    let mut state = State::default();
    state.take(&at(
        1.0,
        SessionEvent::TwistStarted {
            number: 1,
            length_s: 7,
            enough_us: 10.0,
        },
    ));
    assert_eq!(state.twist().unwrap().advice(), "twist faster");
    state.take(&at(8.0, SessionEvent::TwistFinished { number: 1 }));
    assert_eq!(state.twist(), None);
}

#[test]
fn sensors_are_shown_by_name_once_there_is_something_to_them() {
    let text = "[[outputs]]\noutput = 3\nname = \"side\"\nevery = 6\n\
                [lidar]\nname = \"VLP-16\"\n";
    let profile = Profile::parse(text, None).unwrap();
    for (profile, names) in [
        (None, &["output 3", "gnss"]),
        (Some(&profile), &["side", "VLP-16"]),
    ] {
        let mut state = State::of_board(String::new(), profile);
        for k in 0..11 {
            state.take(&pulse(Output::Three, k, Ticks(k * 9_600_000)));
        }
        let pps = protocol::Pps {
            seq: 0,
            at: Ticks(96_000_000),
            utc: 1_795_234_567,
        };
        state.take(&message(pps.at, DeviceToHost::Pps(pps)));
        let sensors = state.sensors();
        let shown: Vec<&str> = sensors.iter().map(|sensor| sensor.name.as_str()).collect();
        assert_eq!(shown, names);
        assert!((sensors[0].rate - 5.0).abs() < 1e-9);
        assert_eq!(sensors[0].pulse, Some(10));
        assert_eq!(
            (sensors[0].at.as_str(), sensors[1].at.as_str()),
            ("output 3", "gnss")
        );
        let utc = sensors[1].utc_text().unwrap();
        assert_eq!(utc, "2026-11-21 04:16:07 UTC");
    }
}

#[test]
fn rates_are_those_of_the_last_seconds() {
    let mut rate = Rate::default();
    for k in 0..3_000_u64 {
        rate.add(Ticks(k * 96_000));
    }
    let now = Ticks(2_999 * 96_000);
    assert!((rate.per_second(now) - 500.0).abs() < 0.01);
    assert_eq!(rate.per_second(Ticks(now.0 + 10 * 48_000_000)), 0.0);
    // A while after the last of them, its rate is the same.
    let mut pulses = Rate::default();
    (0..70).for_each(|k| pulses.add(Ticks(k * 1_600_000)));
    for late in [0, 800_000, 1_599_999] {
        let shown = pulses.per_second(Ticks(69 * 1_600_000 + late));
        assert!((shown - 30.0).abs() < 1e-9, "{late}: {shown}");
    }
}

#[test]
fn a_session_is_followed_from_its_first_question_to_its_grid() {
    let profile = Profile::published().unwrap();
    let mut state = State::of_session(&profile, true);
    let error = Arc::new(SessionError::NoScale);
    let step = Step::Connect;
    state.take(&at(0.0, SessionEvent::StepFailed { step, error }));
    let step = state.warnings[0].next_step.as_deref();
    assert!(step.unwrap().contains("board flash"), "{step:?}");
    assert_eq!(
        (state.doing().as_str(), state.keys()),
        ("connecting", Keys::Answer)
    );

    let clock = clock_since(10.0);
    let phone = PhoneName {
        name: profile.phone.name.clone(),
        is_only: true,
    };
    let connecting = Phase::Connecting;
    state.take(&at(5.0, SessionEvent::Phase { phase: connecting }));
    assert!(state.warnings.is_empty(), "{:?}", state.warnings);
    let refused = SessionEvent::TwistRefused {
        number: 1,
        phone: phone.clone(),
        reason: String::from("too little motion"),
    };
    state.take(&at(9.0, refused));
    assert_eq!(state.warnings.len(), 1);
    let place = 0;
    state.take(&at(
        10.0,
        SessionEvent::ClockKnown {
            place,
            phone,
            clock,
        },
    ));
    assert!(state.warnings.is_empty(), "{:?}", state.warnings);
    let now = state.clock_now(&state.phones[0]).unwrap();
    assert_eq!((now.offset_s, now.age_s), (94_000.25, 0.0));

    let alignment = aligned(clock, 20.0);
    let anchor = alignment.plan.anchor;
    state.take(&at(
        19.0,
        SessionEvent::Aligning {
            shift_us: 5.0,
            frames: 10,
            alignment,
        },
    ));
    state.take(&pulse(Output::Camera, 99, Ticks(anchor.0 - 1_600_000)));
    assert_eq!(state.phase_now(), None);
    state.take(&pulse(Output::Camera, 100, Ticks(anchor.0 + 1_600_048)));
    let phase = state.phase_now().unwrap();
    assert!((phase.phase_us - 1.0).abs() < 1e-9, "{phase:?}");

    let lost = |count| SessionEvent::Lost {
        stream: String::from("pulses"),
        count,
    };
    state.take(&at(20.1, lost(3)));
    let since = BoardSeconds(20.5).ticks();
    let phase = Phase::Recording { since };
    state.take(&at(20.5, SessionEvent::Phase { phase }));
    let length_s = Some(60.0);
    state.take(&at(20.5, SessionEvent::RecordingStarted { length_s }));
    state.take(&at(22.5, lost(2)));
    assert_eq!(state.losses.messages, 2);
    assert_eq!(state.recorded_s(), Some((2.0, Some(60.0))));
    let reason = String::from("unplugged");
    let lost = SessionEvent::LinkLost {
        reason,
        patience_s: Some(600),
    };
    let notice = lost.notice().unwrap();
    assert!(notice.finding.text.contains("600 s"), "{notice:?}");
    state.take(&at(23.0, lost));
    // It counts down; a machine may stall here for a while.
    let doing = state.doing();
    let left = doing.strip_prefix("link lost, ").unwrap();
    let left = left.strip_suffix(" s left").unwrap();
    assert!((500..=600).contains(&left.parse().unwrap()), "{doing}");
    assert!(
        state.warnings[0]
            .next_step
            .as_ref()
            .unwrap()
            .contains("USB")
    );
    state.take(&at(24.0, SessionEvent::LinkBack { away_s: 1.0 }));
    assert_eq!(
        (state.doing().as_str(), state.losses.reconnects),
        ("recording", 1)
    );
}
