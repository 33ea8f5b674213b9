//! Matching of simulated cameras whose pulses are known.

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::*;

const PERIOD_PS: i64 = 33_330_652_540;

/// Pulses of 30.0024 Hz with a move of the phase: first pulse, total ns, ns a pulse (0: all at
/// once).
fn train(count: u64, slew: Option<(u64, i64, i64)>) -> Vec<PulseTime> {
    let mut moved = 0_i64;
    let pulse = |number| {
        if let Some((from, total, step)) = slew
            && number >= from
        {
            let left = total - moved;
            moved += if step == 0 {
                left
            } else {
                left.clamp(-step, step)
            };
        }
        let at = 7_000_000_000 + (number as i64 * PERIOD_PS) / 1000 + moved;
        PulseTime {
            train: 1,
            number,
            at: BoardNanos(at),
            phone: 0,
        }
    };
    (0..count).map(pulse).collect()
}

/// The camera's stamp for a pulse: 300 ppm fast, with wander, in ticks of 90 kHz.
fn stamp(pulse: &PulseTime) -> DeviceNanos {
    let seconds = (pulse.at.0 - 7_000_000_000) as f64 * 1e-9;
    let wander = 40e-6 * (seconds / 200.0).sin();
    let device = 3.123_456 + seconds * (1.0 + 300e-6) + wander;
    let ticks = (device * 90_000.0).floor();
    DeviceNanos((ticks / 90_000.0 * 1e6).floor() as i64 * 1000)
}

/// Frames of the pulses from `skip` on, one in `drop_in` lost, and the index of each one's pulse.
fn frames(
    pulses: &[PulseTime],
    skip: usize,
    drop_in: u64,
    seed: u64,
) -> (Vec<DeviceNanos>, Vec<usize>) {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut out = (Vec::new(), Vec::new());
    for (index, pulse) in pulses.iter().enumerate().skip(skip) {
        // The first frame is never lost: it fixes the true shift.
        if index > skip && drop_in > 0 && random.random_range(0..drop_in) == 0 {
            continue;
        }
        out.0.push(stamp(pulse));
        out.1.push(index);
    }
    out
}

fn check(found: &DepthMatch, expected: &[usize]) {
    assert_eq!(found.frames.len(), expected.len());
    for (frame, &pulse) in found.frames.iter().zip(expected) {
        assert_eq!(
            (frame.state, frame.pulse),
            (FrameState::Matched, Some(pulse))
        );
        assert!(frame.residual.abs() < 20_000, "{frame:?}");
    }
    let (first, last) = (expected[0], expected[expected.len() - 1]);
    let missing: Vec<usize> = (first..=last)
        .filter(|pulse| !expected.contains(pulse))
        .collect();
    assert_eq!(found.missing, missing);
    assert!(
        (found.rate_error - 300e-6).abs() < 1e-6,
        "{}",
        found.rate_error
    );
}

#[test]
fn an_alignment_in_the_recording_decides() {
    // Usual slews, both ways; the recorder starts before them.
    for (seed, slew) in [
        (1, (900, 9_000_000, 100_000)),
        (2, (300, -15_000_000, 20_000)),
        (3, (600, 4_000_000, 2_000)),
    ] {
        let pulses = train(18_000, Some(slew));
        let (frames, made_by) = frames(&pulses, 137, 50, seed);
        let found = match_frames(&frames, &pulses, None).unwrap();
        assert!(matches!(found.decision, Decision::Pattern { margin } if margin > 30.0));
        check(&found, &made_by);
    }
}

/// A camera that has already begun the next frame when a late pulse comes follows the
/// whole move one pulse late: everything fits at the wrong shift.
#[test]
fn a_move_followed_late_is_not_mistaken_for_another_shift() {
    let pulses = train(3_000, Some((1_000, 16_000_000, 1_000_000)));
    let mut late = pulses.clone();
    for index in 1..late.len() {
        let expected = pulses[index - 1].at.0 + PERIOD_PS / 1000;
        if pulses[index].at.0 > expected + 200_000 {
            late[index].at = BoardNanos(expected);
        }
    }
    let (frames, made_by) = frames(&late, 3, 0, 1);
    let error = match_frames(&frames, &pulses, None).unwrap_err();
    assert!(
        matches!(error, MatchError::Ambiguous(a) if a.first <= 3 && a.last >= 3 && a.moved_fast),
        "{error:?}"
    );
    let found = match_frames(&frames, &pulses, Some(Hint::FirstPulse(3))).unwrap();
    let wrong = found
        .frames
        .iter()
        .zip(&made_by)
        .filter(|(frame, pulse)| frame.pulse != Some(**pulse));
    let wrong = wrong.count();
    assert!(wrong <= 17, "{wrong}");
}

#[test]
fn a_jump_leaves_the_neighbouring_shifts() {
    let pulses = train(3_000, Some((1_000, 16_000_000, 0)));
    let (frames, made_by) = frames(&pulses, 3, 0, 1);
    // The camera may have begun the frame of the jump already.
    let error = match_frames(&frames, &pulses, None).unwrap_err();
    assert!(
        matches!(error, MatchError::Ambiguous(a) if (a.first, a.last) == (2, 4) && a.moved_fast),
        "{error:?}"
    );
    assert!(error.to_string().contains("a frame late"), "{error}");
    check(
        &match_frames(&frames, &pulses, Some(Hint::FirstPulse(3))).unwrap(),
        &made_by,
    );
    // Without the frames around the jump nothing distinguishes the shifts.
    let hole = |index: &usize| (950..1050).contains(index);
    let kept: Vec<DeviceNanos> = frames
        .iter()
        .zip(&made_by)
        .filter(|(_, index)| !hole(index))
        .map(|(frame, _)| *frame)
        .collect();
    let error = match_frames(&kept, &pulses, None).unwrap_err();
    assert!(
        matches!(error, MatchError::Ambiguous(a) if a.first <= 3 && a.last >= 3),
        "{error:?}"
    );
}

#[test]
fn a_regular_train_is_ambiguous_until_a_hint_settles_it() {
    let pulses = train(2_000, None);
    let (frames, made_by) = frames(&pulses[..1_900], 2, 30, 5);
    let error = match_frames(&frames, &pulses, None).unwrap_err();
    let MatchError::Ambiguous(left) = error else {
        panic!("{error:?}");
    };
    assert!(left.first <= 2 && left.last >= 100, "{left:?}");
    // A user who recorded the camera's IMU is not advised to do so.
    let message = |has_imu| MatchError::Ambiguous(Ambiguity { has_imu, ..left }).to_string();
    assert!(message(false).contains("with the camera's IMU on"));
    assert!(!message(true).contains("IMU on") && message(true).contains("turning by hand"));

    let given = match_frames(&frames, &pulses, Some(Hint::FirstPulse(2))).unwrap();
    assert!(matches!(given.decision, Decision::Hint { left, .. } if left > 90));
    check(&given, &made_by);

    // A clock known to 3 ms, with its rate 5 ppm off; the centre of exposure
    // is 6.3625 ms after the pulse.
    let center = 6_362_500;
    let around = stamp(&pulses[1_000]);
    let board = pulses[1_000].at.0 + center + 3_000_000;
    let clock = |sigma| Hint::Clock {
        source: HintSource::CameraGyroscope,
        map: PiecewiseMap::from_knots([
            (around, BoardNanos(board)),
            (
                DeviceNanos(around.0 + 1_000_305_000),
                BoardNanos(board + 1_000_000_000),
            ),
        ]),
        around,
        sigma,
        center,
    };
    check(
        &match_frames(&frames, &pulses, Some(clock(3e6))).unwrap(),
        &made_by,
    );
    // Too coarse to distinguish periods: not used.
    assert!(matches!(
        match_frames(&frames, &pulses, Some(clock(8e6))),
        Err(MatchError::Ambiguous(_))
    ));
}

#[test]
fn pattern_and_hint_must_agree() {
    let pulses = train(4_000, Some((500, 9_000_000, 100_000)));
    let (frames, made_by) = frames(&pulses, 10, 40, 9);
    check(
        &match_frames(&frames, &pulses, Some(Hint::FirstPulse(10))).unwrap(),
        &made_by,
    );
    let error = match_frames(&frames, &pulses, Some(Hint::FirstPulse(11))).unwrap_err();
    assert!(
        matches!(
            error,
            MatchError::Conflict {
                pattern: 10,
                hint: 11,
                ..
            }
        ),
        "{error:?}"
    );
}

#[test]
fn lost_pulses_doubled_frames_and_free_running_frames_are_named() {
    let all = train(3_000, Some((400, 9_000_000, 100_000)));
    let (mut frames, mut made_by) = frames(&all, 5, 25, 11);
    // Three pulses never reached the recording.
    let lost = [700, 701, 1500];
    let pulses: Vec<PulseTime> = all
        .iter()
        .enumerate()
        .filter(|(index, _)| !lost.contains(index))
        .map(|(_, pulse)| *pulse)
        .collect();
    // One frame is doubled 300 µs later, and the camera continues for two seconds.
    frames.insert(1000, DeviceNanos(frames[999].0 + 300_000));
    made_by.insert(1000, usize::MAX);
    let last = frames[frames.len() - 1].0;
    for i in 1..=60 {
        frames.push(DeviceNanos(last + i * 33_333_000));
        made_by.push(usize::MAX);
    }
    let found = match_frames(&frames, &pulses, None).unwrap();
    for (index, (frame, &pulse)) in found.frames.iter().zip(&made_by).enumerate() {
        if index == 1000 {
            assert_eq!(frame.state, FrameState::Doubled);
        } else if pulse == usize::MAX {
            assert_eq!(frame.state, FrameState::AfterLastPulse, "{index}");
        } else if lost.contains(&pulse) {
            assert_eq!(frame.state, FrameState::OffPulse, "{index}");
            let board = found.clock.apply(frames[index]).unwrap();
            assert!((board.0 - all[pulse].at.0).abs() < 15_000, "{index}");
        } else {
            assert_eq!(frame.state, FrameState::Matched, "{index}");
            assert_eq!(pulses[frame.pulse.unwrap()].number, pulse as u64);
        }
    }
}

#[test]
fn frames_may_continue_after_the_last_pulse() {
    let pulses = train(1_970, Some((84, -6_500_000, 100_000)));
    let (mut frames, made_by) = frames(&pulses, 1, 0, 5);
    let last = frames[frames.len() - 1].0;
    frames.extend((1..=3_200).map(|i| DeviceNanos(last + i * 33_333_000)));
    let found = match_frames(&frames, &pulses, None).unwrap();
    for (frame, &pulse) in found.frames.iter().zip(&made_by) {
        assert_eq!(frame.pulse, Some(pulse));
    }
    assert_eq!(found.missing, Vec::<usize>::new());
    let rest = &found.frames[made_by.len()..];
    assert!(
        rest.iter()
            .all(|frame| frame.state == FrameState::AfterLastPulse)
    );
}

#[test]
fn a_free_running_camera_is_an_error() {
    let pulses = train(3_000, Some((400, 9_000_000, 100_000)));
    let at = |i: i64| DeviceNanos(i * 50_000_000);
    let slow: Vec<DeviceNanos> = (0..1_000).map(at).collect();
    assert!(matches!(
        match_frames(&slow, &pulses, None),
        Err(MatchError::OtherRate { .. })
    ));
    let mut random = Pcg64::seed_from_u64(3);
    let wild: Vec<DeviceNanos> = (0..1_000)
        .map(|i| DeviceNanos(i * 33_330_000 + random.random_range(0..30_000_000)))
        .collect();
    let error = match_frames(&wild, &pulses, None).unwrap_err();
    assert!(
        matches!(
            error,
            MatchError::NotFollowing { .. } | MatchError::OtherRate { .. }
        ),
        "{error:?}"
    );
    assert!(matches!(
        match_frames(&wild[..5], &pulses, None),
        Err(MatchError::TooFew { frames: 5, .. })
    ));
}

#[test]
fn hostile_times_do_not_panic() {
    let pulses: Vec<PulseTime> = [
        0,
        1,
        2,
        i64::MAX / 2,
        i64::MAX - 1,
        i64::MAX,
        i64::MAX,
        5,
        6,
        7,
        8,
        9,
    ]
    .iter()
    .map(|&at| PulseTime {
        train: 0,
        number: u64::MAX,
        at: BoardNanos(at),
        phone: 0,
    })
    .collect();
    let mut sorted = pulses.clone();
    sorted.sort_by_key(|pulse| pulse.at);
    let frames: Vec<DeviceNanos> = [i64::MIN, -1, 0, 0, 0, 1, 2, 3, i64::MAX, 5, 6, 7]
        .iter()
        .map(|&at| DeviceNanos(at))
        .collect();
    let _ = match_frames(&frames, &sorted, None);
    let still = vec![DeviceNanos(5); 20];
    let _ = match_frames(&still, &sorted, None);
}
