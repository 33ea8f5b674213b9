//! The evaluation on rendered frames with a ground truth. All figures are simulated.

use crate::strobes::Scene;
use evaluate::precision::{RecordingResult, evaluate_recording};
use evaluate::track::Reference;
use evaluate::train::TrainGeometry;
use evaluate::{EvaluateError, Settings, drift};
use recording::profile::Direction;
use rig::picture::rolling_shutter::{Flicker, Readout, RollingShutter};

/// Row times known to the tool make the tests fast; what it does without is tested
/// where it matters.
fn hint(scene: &Scene) -> Settings {
    Settings {
        row_time_us: Some(scene.camera.row_time_ns * 1e-3),
        ..Settings::default()
    }
}

fn scene(exposure_us: f64, row_time_us: f64, amplitude: f64, seed: u64) -> Scene {
    Scene {
        camera: RollingShutter {
            columns: 96,
            exposure_ns: 1e3 * exposure_us,
            row_time_ns: 1e3 * row_time_us,
            amplitude,
            seed,
            ..RollingShutter::default()
        },
        // Anywhere within half a pitch.
        bias_us: ((seed as f64 * 0.618_034).fract() - 0.5) * 1500.0,
        ..Scene::default()
    }
}

fn error_us(scene: &Scene, result: &RecordingResult) -> f64 {
    result.bias_us - scene.truth_of_last_us(16)
}

/// Uncompressed frames: 1 µs at a flash of 3 grey levels, 0.2 µs at 20.
#[test]
fn uncompressed_frames_reach_a_fraction_of_a_microsecond() {
    println!("exposure  row time  grey |  fit error  row time ppm");
    for (i, (exposure, row_time)) in [
        (100.0, 10.2),
        (125.0, 10.2),
        (500.0, 8.0),
        (1000.0, 14.0),
        (2000.0, 10.2),
        (4000.0, 20.0),
    ]
    .into_iter()
    .enumerate()
    {
        for (grey, limit) in [(3.0, 1.0), (20.0, 0.2)] {
            let scene = scene(exposure, row_time, grey, 100 + i as u64);
            let result = scene.evaluate(&hint(&scene)).unwrap();
            let error = error_us(&scene, &result);
            let row = (result.row_time_us / row_time - 1.0) * 1e6;
            println!("{exposure:8} {row_time:9} {grey:5} | {error:10.3} {row:13.1}");
            assert!(error.abs() < limit, "{exposure} µs, {grey}: {error} µs");
            assert!(row.abs() < 2000.0, "{exposure} µs, {grey}: {row} ppm");
            assert!((result.exposure_us / exposure - 1.0).abs() < 0.02);
        }
    }
}

/// Nothing known beforehand: row time and exposure are found from the flashes.
#[test]
fn an_unknown_camera_is_measured() {
    for (exposure, row_time) in [(125.0, 8.0), (700.0, 20.0), (3800.0, 11.3)] {
        let scene = Scene {
            // An end of the train shows that these are flashes.
            bias_us: 4100.0,
            ..scene(exposure, row_time, 20.0, 7)
        };
        let result = scene.evaluate(&Settings::default()).unwrap();
        let error = error_us(&scene, &result);
        assert!(error.abs() < 0.5, "{exposure}, {row_time}: {error} µs");
        assert!((result.row_time_us / row_time - 1.0).abs() < 1e-3);
        assert!((result.exposure_us / exposure - 1.0).abs() < 0.02);
    }
}

/// The stated uncertainty is that of the errors: 99 % intervals hold in at least
/// 95 % of 50 seeds, and the intervals are not simply wide.
#[test]
fn fifty_seeds_of_bias_lie_within_the_stated_uncertainty() {
    let (mut inside, mut squares, mut row_inside) = (0, 0.0, 0);
    for seed in 1..=50u64 {
        let exposure = [125.0, 300.0, 800.0, 2000.0][seed as usize % 4];
        let grey = [5.0, 20.0, 60.0][seed as usize % 3];
        let scene = Scene {
            camera: RollingShutter {
                columns: 32,
                // A scene with structure of its own, and a tone curve.
                texture: 0.01,
                gamma: 1.2,
                ..scene(exposure, 10.2, grey, seed).camera
            },
            ..scene(exposure, 10.2, grey, seed)
        };
        let result = scene.evaluate(&hint(&scene)).unwrap();
        let error = error_us(&scene, &result);
        inside += u32::from(error.abs() <= result.uncertainty_99_us);
        row_inside +=
            u32::from((result.row_time_us - 10.2).abs() <= 2.576 * result.row_time_sigma_us);
        squares += (error / result.sigma_us).powi(2);
    }
    let mean_square = squares / 50.0;
    println!("bias: {inside} of 50 inside, mean z² {mean_square:.2}; row time: {row_inside}");
    assert!(inside >= 48, "{inside} of 50");
    assert!(row_inside >= 48, "{row_inside} of 50");
    assert!((0.3..1.8).contains(&mean_square), "{mean_square}");
}

/// Five minutes of drift, one frame every three seconds: 50 seeds.
#[test]
fn fifty_seeds_of_drift_lie_within_the_stated_uncertainty() {
    let (mut inside, mut squares) = (0, 0.0);
    for seed in 1..=50u64 {
        let truth = ((seed as f64 * 0.381_966).fract() - 0.5) * 40.0;
        let scene = Scene {
            camera: RollingShutter {
                columns: 16,
                ..scene(250.0, 10.2, 20.0, seed).camera
            },
            bias_us: 100.0,
            drift_us_per_min: truth,
            frame_rate: 0.3,
            frames: 90,
            lit_from: 4,
            ..Scene::default()
        };
        let settings = hint(&scene);
        let recording = scene.recording(&settings).unwrap();
        let result = drift::evaluate(recording, &settings).unwrap().result;
        let error = result.drift_us_per_min - truth;
        inside += u32::from(error.abs() <= result.drift_uncertainty_99_us_per_min);
        squares += (error / result.drift_sigma_us_per_min).powi(2);
        assert!(error.abs() < 0.2, "seed {seed}: {error} µs/min");
    }
    let mean_square = squares / 50.0;
    println!("drift: {inside} of 50 inside, mean z² {mean_square:.2}");
    assert!(inside >= 48, "{inside} of 50");
    assert!((0.3..1.8).contains(&mean_square), "{mean_square}");
}

#[test]
fn flashes_on_every_second_frame_leave_the_others_as_reference() {
    let scene = Scene {
        lit_from: 1,
        lit_every: 2,
        frames: 40,
        ..scene(300.0, 10.2, 10.0, 5)
    };
    let result = scene.evaluate(&hint(&scene)).unwrap();
    assert_eq!(result.frames.without_flashes, 20);
    assert_eq!((result.frames.used, result.frames.spare), (16, 4));
    assert_eq!(result.reference, Reference::DarkFrames(20));
    assert!(error_us(&scene, &result).abs() < 0.3);
}

/// Rows of a scene with strong structure: with a reference it does not matter.
#[test]
fn the_reference_takes_the_scene_away() {
    let textured = |lit_from| Scene {
        camera: RollingShutter {
            texture: 0.05,
            ..scene(300.0, 10.2, 10.0, 5).camera
        },
        lit_from,
        ..scene(300.0, 10.2, 10.0, 5)
    };
    let with = textured(4);
    let with_result = with.evaluate(&hint(&with)).unwrap();
    let without = textured(0);
    let without_result = without.evaluate(&hint(&without)).unwrap();
    assert_eq!(without_result.reference, Reference::Polynomial);
    assert!(error_us(&with, &with_result).abs() < 0.3);
    assert!(with_result.sigma_us < 0.3 * without_result.sigma_us);
    assert!(error_us(&without, &without_result).abs() < without_result.uncertainty_99_us);
}

/// Cameras that run free: the train wanders, and every row is dark at some time.
#[test]
fn rows_become_their_own_reference_when_the_train_wanders() {
    let scene = Scene {
        camera: RollingShutter {
            texture: 0.05,
            ..scene(125.0, 10.2, 20.0, 9).camera
        },
        bias_us: -600.0,
        drift_us_per_min: 24_000.0,
        frames: 120,
        lit_from: 0,
        ..Scene::default()
    };
    let settings = hint(&scene);
    let recording = scene.recording(&settings).unwrap();
    let drift::EvaluatedDrift {
        result, line_us, ..
    } = drift::evaluate(recording, &settings).unwrap();
    assert_eq!(result.reference, Reference::DarkRows);
    let error = result.drift_us_per_min - 24_000.0;
    assert!(
        error.abs() < result.drift_uncertainty_99_us_per_min.max(1.0),
        "{error} ± {}",
        result.drift_sigma_us_per_min
    );
    assert!((line_us[0] + 600.0).abs() < 1.0);
}

#[test]
fn a_train_that_enters_the_picture_is_not_taken_for_the_scene() {
    let scene = Scene {
        lit_from: 0,
        entering: 20,
        frames: 60,
        ..scene(500.0, 10.2, 45.0, 24)
    };
    let result = scene.evaluate(&hint(&scene)).unwrap();
    let error = error_us(&scene, &result);
    println!("{error:+.3} µs, {:?}, {:?}", result.frames, result.notes);
    assert!(error.abs() < 0.2, "{error} µs");
    // At most the frames in question are left out.
    assert!(result.frames.flicker <= 20, "{:?}", result.frames);
    assert_eq!(result.frames.used, 16);
}

#[test]
fn mains_flicker_is_recognised_and_left_out() {
    // 100 Hz at 30 frames per second: another phase in each of three frames.
    let flickering = |depth| Scene {
        camera: RollingShutter {
            flicker: Some(Flicker {
                frequency_hz: 100.0,
                depth,
                phase_rad: 0.4,
            }),
            ..scene(250.0, 10.2, 20.0, 11).camera
        },
        ..scene(250.0, 10.2, 20.0, 11)
    };
    let strong = flickering(0.3);
    let e = strong.evaluate(&hint(&strong)).unwrap_err();
    assert!(
        matches!(e, EvaluateError::OnlyFlicker { flicker: 16, .. }),
        "{e}"
    );
    assert!(e.to_string().contains("switch the lamps off"), "{e}");

    let weak = flickering(0.005);
    let result = weak.evaluate(&hint(&weak)).unwrap();
    assert_eq!((result.frames.used, result.frames.flicker), (16, 0));
}

#[test]
fn which_flash_is_which_is_decided_by_the_ends_or_stated_as_open() {
    // All of the train in view.
    let slow = scene(125.0, 20.0, 20.0, 2);
    let result = slow.evaluate(&hint(&slow)).unwrap();
    assert!(result.identity.unique);

    // Only seven flashes in view, whichever they are.
    let fast = Scene {
        bias_us: 30.0,
        ..scene(125.0, 10.2, 20.0, 2)
    };
    let result = fast.evaluate(&hint(&fast)).unwrap();
    assert!(!result.identity.unique);
    let mut places: Vec<f64> = result
        .identity
        .candidates
        .iter()
        .map(|c| c.bias_us)
        .collect();
    places.sort_by(f64::total_cmp);
    assert_eq!(places.len(), 3, "{places:?}");
    for (place, truth) in places.iter().zip([-1545.0, 30.0, 1605.0]) {
        assert!((place - truth).abs() < 1.0, "{places:?}");
    }
    assert!((result.bias_us - 30.0).abs() < 0.3);
    let near = Settings {
        near_us: 1500.0,
        ..hint(&fast)
    };
    assert!((fast.evaluate(&near).unwrap().bias_us - 1605.0).abs() < 0.3);

    // Moved until an end is in view.
    let moved = Scene {
        bias_us: 4030.0,
        ..fast
    };
    let result = moved.evaluate(&hint(&moved)).unwrap();
    assert!(result.identity.unique);
    assert!((result.bias_us - 4030.0).abs() < 0.3);
}

#[test]
fn an_exposure_that_the_frames_leave_open_is_stated() {
    let long = Scene {
        lit_from: 0,
        ..scene(2000.0, 10.2, 20.0, 4)
    };
    let open = long.evaluate(&hint(&long)).unwrap();
    let exposures: Vec<f64> = open
        .identity
        .candidates
        .iter()
        .map(|c| c.exposure_us)
        .collect();
    assert!(!open.identity.unique);
    assert!(
        exposures.iter().any(|e| (e - 425.0).abs() < 10.0),
        "{exposures:?}"
    );
    assert!(
        exposures.iter().any(|e| (e - 2000.0).abs() < 10.0),
        "{exposures:?}"
    );
    let known = Settings {
        exposure_us: Some(2000.0),
        ..hint(&long)
    };
    let result = long.evaluate(&known).unwrap();
    assert!(error_us(&long, &result).abs() < 0.3, "{result:?}");
}

#[test]
fn rotation_region_and_wide_mode() {
    for (readout, direction) in [
        (Readout::BottomToTop, Direction::Up),
        (Readout::LeftToRight, Direction::Right),
        (Readout::RightToLeft, Direction::Left),
    ] {
        let scene = Scene {
            camera: RollingShutter {
                readout,
                ..scene(125.0, 10.2, 20.0, 6).camera
            },
            bias_us: 321.0,
            ..Scene::default()
        };
        let settings = Settings {
            readout: direction,
            // Not centred in the image.
            region: Some(match direction {
                Direction::Up => "10,100,60,900".parse().unwrap(),
                _ => "100,10,900,60".parse().unwrap(),
            }),
            ..hint(&scene)
        };
        let result = scene.evaluate(&settings).unwrap();
        assert!(
            (result.bias_us - 321.0).abs() < 0.3,
            "{direction:?}: {result:?}"
        );
    }
    let wide = Scene {
        // As of WFOV unbinned.
        train: rig::picture::rolling_shutter::FlashTrain {
            pitch_ns: 2_515_000,
            ..rig::picture::rolling_shutter::FlashTrain::NFOV
        },
        bias_us: -222.0,
        ..scene(200.0, 16.0, 20.0, 8)
    };
    let settings = Settings {
        train: TrainGeometry::WFOV,
        ..hint(&wide)
    };
    assert!((wide.evaluate(&settings).unwrap().bias_us + 222.0).abs() < 0.3);
}

#[test]
fn an_exposure_of_one_pitch_is_called_blind() {
    let scene = Scene {
        camera: RollingShutter {
            columns: 256,
            ..scene(1575.0, 20.0, 60.0, 4).camera
        },
        bias_us: 50.0,
        ..Scene::default()
    };
    let settings = Settings {
        exposure_us: Some(1575.0),
        ..hint(&scene)
    };
    match scene.evaluate(&settings) {
        Ok(result) => assert!(
            result
                .notes
                .iter()
                .any(|n| n.contains("whole number of flash pitches")),
            "{result:?}"
        ),
        Err(e) => assert!(matches!(e, EvaluateError::NoFlashes { .. }), "{e}"),
    }
}

/// A trigger that is being aligned while the frames are taken is not precision.
#[test]
fn motion_within_the_frames_is_remarked() {
    let moving = Scene {
        drift_us_per_min: 30_000.0,
        ..scene(125.0, 10.2, 20.0, 6)
    };
    let settings = hint(&moving);
    let recording = moving.recording(&settings).unwrap();
    let result = evaluate_recording(recording, &settings, 16).unwrap().result;
    assert!(
        result.notes.iter().any(|n| n.contains("moved by")),
        "{result:?}"
    );
    assert!(error_us(&moving, &result).abs() < 1.0);
}
