//! Phones that stamp their frames with another clock than their gyroscope.

use phone::PhoneError;
use recording::session_file::{SessionFile, SessionOutcome};
use rig::clocks::link_delay::LinkRanges;
use scenarios::judge::Truth;
use scenarios::virtual_session::Run;
use session::error::SessionError;

use crate::bench::Twisted;

const SECOND_NS: i64 = 1_000_000_000;

/// A phone that has slept for a time, with its frames on the clock that stood still then or
/// on its sensors'.
fn sleeper(seed: u64, slept_ns: i64, is_on_monotonic: bool, is_read: bool) -> Twisted {
    let mut rig = Twisted::with(seed, |_, phone| {
        phone.slept_ns = slept_ns;
        phone.camera.is_on_monotonic = is_on_monotonic;
    });
    rig.bench.phone_link = is_read.then_some(LinkRanges::PHONE_USB);
    rig
}

/// The phone's error with which a session ended.
fn refusal(run: Run) -> PhoneError {
    match run.ended {
        Err(SessionError::Phone { error, .. }) => error,
        Ok(Some(ended)) => match ended.result {
            Err(SessionError::Phone { error, .. }) => error,
            other => panic!("{other:?}"),
        },
        other => panic!("{other:?}"),
    }
}

#[test]
fn frames_on_the_clock_that_sleeps_are_corrected_where_both_clocks_are_read() {
    let slept_ns = 3 * 3_600 * SECOND_NS + 123_456_789;
    let mut rig = sleeper(31, slept_ns, true, true);
    let options = rig.options("slept", 5);
    rig.bench.run(&options).good().unwrap();
    let session = rig.readable("slept", SessionOutcome::Good);
    let video = session.phones[0].video.unwrap();
    assert_eq!(video.boot_minus_frames_ns, slept_ns);

    let folder = rig.recording("slept");
    let truth = Truth::from_run(rig.bench.stop().unwrap()).unwrap();
    let phase = truth.judge(&folder).unwrap().phase;
    let sigma_us = session.alignment.unwrap().phase_sigma_us.hypot(1.0);
    assert!(
        phase.start_us.abs() < 5.0 * sigma_us,
        "{phase:?} {sigma_us}"
    );
    assert!(phase.start_us.abs() < 60.0, "{phase:?}");
}

#[test]
fn frames_of_an_unknown_clock_are_refused() {
    // Both clocks fit where they are 5 s apart, and the phase is on the later one.
    for (slept_s, is_on_monotonic, is_read) in [(3_600, true, false), (5, false, true)] {
        let mut rig = sleeper(32, slept_s * SECOND_NS, is_on_monotonic, is_read);
        let options = rig.options("slept", 5);
        let error = refusal(rig.bench.run(&options));
        let is_expected = match (error.cause(), is_read) {
            (PhoneError::StalePhase { early }, false) => (early - slept_s as f64).abs() < 2.0,
            (PhoneError::FrameClock { slept_s: found }, true) => {
                (found - slept_s as f64).abs() < 1e-3
            }
            _ => false,
        };
        assert!(is_expected, "{error:?}");
        rig.all_is_stopped("slept");
    }
    // A phone whose frames are on its sensors' clock may sleep as long as it wants.
    let mut rig = sleeper(33, 3_600 * SECOND_NS, false, true);
    rig.record("awake", 2);
    let session = SessionFile::load(&rig.recording("awake")).unwrap();
    assert_eq!(session.phones[0].video.unwrap().boot_minus_frames_ns, 0);
}
