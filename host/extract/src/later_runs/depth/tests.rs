//! Simulated cameras over a reset of the board, with known truth.

use super::*;
use crate::depth_clock::tests::{Dice, PERIOD_PS, Train};
use crate::depth_clock::{Decision, FrameState};

/// True nanoseconds since the first pulse of all.
const ZERO: i64 = 7_000_000_000;

/// A recording with one reset.
struct Scene {
    pulses: Vec<PulseTime>,
    frames: Vec<DeviceNanos>,
    /// The pulse of each frame; `None` for one of the camera's own.
    truth: Vec<Option<usize>>,
    reset: Reset,
}

struct Settings {
    seed: u64,
    /// Pulses of the first run.
    first: u64,
    slew: Option<(u64, i64, i64)>,
    /// Pulses of the second run, and a move of its phase.
    second: u64,
    second_slew: Option<(u64, i64, i64)>,
    /// How far the second run is off the former grid, ns.
    jump: i64,
    /// Without pulses, in periods.
    away: i64,
    /// By how much the second run's recorded times are wrong, ns; and the stated sigma.
    misplaced: (i64, f64),
    /// The recorder begins with this pulse.
    begins: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            first: 500,
            slew: Some((100, 9_000_000, 150_000)),
            second: 600,
            second_slew: None,
            jump: 300_000,
            away: 70,
            misplaced: (4_000, 4e3),
            begins: 1,
        }
    }
}

/// The camera's clock: 300 ppm fast, wandering, in ticks.
fn stamp(true_ns: i64) -> DeviceNanos {
    let seconds = (true_ns - ZERO) as f64 * 1e-9;
    let wander = 20e-6 * (seconds / 90.0).sin();
    let device = 3.123_456 + seconds * (1.0 + 300e-6) + wander;
    let ticks = (device * 90_000.0).floor();
    DeviceNanos((ticks / 90_000.0 * 1e6).floor() as i64 * 1000)
}

fn scene(settings: &Settings) -> Scene {
    let mut dice = Dice(settings.seed);
    let first = Train {
        count: settings.first,
        slew: settings.slew,
    }
    .pulses();
    let last = first[first.len() - 1].at.0;
    let begin = last + settings.away * PERIOD_PS / 1000 + settings.jump;
    let second = Train {
        count: settings.second,
        slew: settings.second_slew,
    };
    let second: Vec<PulseTime> = second
        .pulses()
        .into_iter()
        .map(|pulse| PulseTime {
            train: 2,
            at: BoardNanos(pulse.at.0 - ZERO + begin),
            ..pulse
        })
        .collect();
    let mut scene = Scene {
        pulses: first.clone(),
        frames: Vec::new(),
        truth: Vec::new(),
        reset: Reset {
            first_pulse: first.len(),
            sigma: settings.misplaced.1,
        },
    };
    let mut take = |at: i64, pulse: Option<usize>, always: bool| {
        if always || dice.below(40) != 0 {
            scene.frames.push(stamp(at));
            scene.truth.push(pulse);
        }
    };
    for (index, pulse) in first.iter().enumerate().skip(settings.begins) {
        take(pulse.at.0, Some(index), index == settings.begins);
    }
    // The camera goes on at 30 Hz of its own clock until half a period before the pulse.
    let own = (1e9 / 30.0 / (1.0 + 300e-6)) as i64;
    let half = PERIOD_PS / 2000;
    let free = (1..)
        .map(|n| last + n * own)
        .take_while(|at| *at < begin - half);
    free.for_each(|at| take(at, None, false));
    let skip = settings.begins.saturating_sub(first.len());
    for (index, pulse) in second.iter().enumerate().skip(skip) {
        take(pulse.at.0, Some(first.len() + index), false);
    }
    scene
        .pulses
        .extend(second.into_iter().map(|pulse| PulseTime {
            at: BoardNanos(pulse.at.0 + settings.misplaced.0),
            ..pulse
        }));
    scene
}

impl Scene {
    fn matched(&self, hint: Option<Hint>) -> Result<OverResets, MatchError> {
        match_over_resets(&self.frames, &self.pulses, &[self.reset], hint)
    }

    /// Frames with a pulse all have the right one, but those in `left_out`.
    fn check(&self, over: &OverResets, left_out: Range<usize>) {
        for (number, (frame, truth)) in over.found.frames.iter().zip(&self.truth).enumerate() {
            let expected = match truth {
                Some(pulse) if left_out.contains(pulse) => FrameState::NotMatched,
                Some(_) => FrameState::Matched,
                None if left_out.contains(&self.reset.first_pulse) || left_out.is_empty() => {
                    FrameState::OffPulse
                }
                None => frame.state,
            };
            assert_eq!(frame.state, expected, "{number} {truth:?}");
            if expected == FrameState::Matched {
                assert_eq!(frame.pulse, *truth, "{number}");
            }
        }
        let named = over.found.missing.iter();
        assert!(
            named
                .clone()
                .all(|pulse| !self.truth.contains(&Some(*pulse)))
        );
        let first = self.truth.iter().flatten().min().copied().unwrap();
        let last = self.truth.iter().flatten().max().copied().unwrap();
        let lost =
            (first..last).filter(|p| !left_out.contains(p) && !self.truth.contains(&Some(*p)));
        assert!(left_out.contains(&last) || lost.count() == named.count());
    }
}

#[test]
fn the_cameras_clock_leads_over_the_reset() {
    for seed in 0..15 {
        let mut dice = Dice(seed + 77);
        // From a computer's clock that bridges well to one that does not at all.
        let jump = [300_000, 2_000_000, 33_000_000][seed as usize % 3];
        let settings = Settings {
            seed,
            jump: dice.below(2 * jump) as i64 - jump as i64,
            away: 20 + dice.below(200) as i64,
            first: 300 + dice.below(500),
            second: 60 + dice.below(2_000),
            ..Settings::default()
        };
        let scene = scene(&settings);
        let over = scene.matched(None).unwrap();
        assert_eq!(over.anchor, 0);
        assert!(matches!(over.found.decision, Decision::Pattern { .. }));
        assert!(over.left_out.is_empty(), "{seed}: {:?}", over.left_out);
        let [carried] = over.carried.as_slice() else {
            panic!("{over:?}");
        };
        assert!(carried.off.abs() < 5.0 * carried.sigma && carried.sigma < 100e3);
        scene.check(&over, 0..0);
        // Frames of the gap by the camera's clock.
        for (frame, truth) in scene.frames.iter().zip(&scene.truth) {
            let at = over.found.clock.apply(*frame).unwrap();
            if let Some(pulse) = truth {
                let off = at.0 - scene.pulses[*pulse].at.0;
                assert!(off.abs() < 25_000, "{seed}: {off}");
            }
        }
    }
}

#[test]
fn runs_whose_distance_is_not_known_are_left_out() {
    let settings = Settings {
        misplaced: (9_000_000, 10e6),
        ..Settings::default()
    };
    let scene = scene(&settings);
    let over = scene.matched(None).unwrap();
    let [left_out] = over.left_out.as_slice() else {
        panic!("{over:?}");
    };
    assert!(
        matches!(left_out.why, RunError::TooCoarse { .. }),
        "{left_out:?}"
    );
    let of_second = scene
        .truth
        .iter()
        .filter(|pulse| **pulse >= Some(500))
        .count();
    // By how much the run is misplaced is not known, and the frames are counted by it.
    assert!(
        left_out.frames.abs_diff(of_second) <= 1,
        "{left_out:?} {of_second}"
    );
    scene.check(&over, 500..1_100);
}

#[test]
fn a_run_that_is_elsewhere_than_said_contradicts() {
    let settings = Settings {
        misplaced: (2_000_000, 5e3),
        ..Settings::default()
    };
    let error = scene(&settings).matched(None).unwrap_err();
    let MatchError::OverReset { run: 2, why } = error else {
        panic!("{error}");
    };
    assert!(
        matches!(*why, RunError::Beside { off_us, .. } if (off_us + 2_000.0).abs() < 30.0),
        "{why}"
    );
}

#[test]
fn an_ambiguous_first_run_stays_so_until_a_hint() {
    let settings = Settings {
        slew: None,
        ..Settings::default()
    };
    let scene = scene(&settings);
    let error = scene.matched(None).unwrap_err();
    assert!(matches!(error, MatchError::Ambiguous(_)), "{error}");
    let over = scene.matched(Some(Hint::FirstPulse(1))).unwrap();
    scene.check(&over, 0..0);
    // Several periods off show: the camera takes up the pulses where it should not.
    // Frames are counted, and some are lost.
    let by = |error| match error {
        MatchError::OverReset { run: 2, why } => match *why {
            RunError::TakenUp { by } => by,
            why => panic!("{why}"),
        },
        error => panic!("{error}"),
    };
    let error = scene.matched(Some(Hint::FirstPulse(9))).unwrap_err();
    assert!((5..=8).contains(&by(error)));
    let settings = Settings {
        begins: 9,
        ..settings
    };
    let scene = self::scene(&settings);
    let error = scene.matched(Some(Hint::FirstPulse(1))).unwrap_err();
    assert!((-8..=-5).contains(&by(error)));
}

#[test]
fn a_first_run_that_is_too_short_is_matched_backwards() {
    let settings = Settings {
        first: 12,
        slew: None,
        begins: 3,
        ..Settings::default()
    };
    let scene = scene(&settings);
    let at = ZERO + 20_000_000_000;
    let center = 6_362_500;
    let map = AffineMap::new(
        stamp(at),
        BoardNanos(at + center + 2_000_000),
        1.0 / (1.0 + 303e-6) - 1.0,
    )
    .unwrap();
    let sigma = 2.5e6;
    let over = scene
        .matched(Some(Hint::Clock { map, sigma, center }))
        .unwrap();
    assert_eq!(over.anchor, 1);
    let [left_out] = over.left_out.as_slice() else {
        panic!("{over:?}");
    };
    assert_eq!(left_out.run, 0);
    assert!(matches!(left_out.why, RunError::TooFew { .. }));
    scene.check(&over, 0..12);

    // With enough of them, backwards from a second run whose pattern decides.
    let settings = Settings {
        first: 200,
        slew: None,
        second_slew: Some((300, -7_000_000, 150_000)),
        ..Settings::default()
    };
    let scene = self::scene(&settings);
    let over = scene.matched(None).unwrap();
    assert_eq!(
        (over.anchor, over.carried.len()),
        (1, 1),
        "{:?}",
        over.left_out
    );
    scene.check(&over, 0..0);
}

#[test]
fn a_recorder_that_begins_behind_the_reset_is_not_matched_to_the_first_run() {
    for begins in [480, 520, 560] {
        let settings = Settings {
            begins,
            ..Settings::default()
        };
        let scene = scene(&settings);
        let error = scene.matched(None).unwrap_err();
        assert!(
            matches!(error, MatchError::Ambiguous(_)),
            "{begins}: {error}"
        );
    }
}

#[test]
fn hostile_resets_do_not_panic() {
    let mut scene = scene(&Settings::default());
    let resets = [0, 5, 5, 700, usize::MAX].map(|first_pulse| Reset {
        first_pulse,
        sigma: f64::NAN,
    });
    let _ = match_over_resets(&scene.frames, &scene.pulses, &resets, None);
    scene.frames[3].0 = i64::MIN;
    scene.frames[9].0 = i64::MAX;
    for first in [0, 499, 500, 5_000] {
        let _ = scene.matched(Some(Hint::FirstPulse(first)));
    }
    let _ = match_over_resets(&[], &[], &[scene.reset], None);
}
