use std::collections::BTreeMap;

use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use super::*;
use crate::camera::{DEFAULT_CAMERA, Model};

/// Pulses every 33.33 ms, whole ticks.
const PERIOD: u64 = 1_599_871;

fn pulses(count: u64) -> Vec<Ticks> {
    (0..count).map(|k| Ticks(1_000_000 + k * PERIOD)).collect()
}

/// Gives a finder pulses and edges, each in order, edges half a second late as over a slow link.
fn exposures(
    pulses: &[Ticks],
    edges: &[StrobeEdge],
    train: Option<&StrobeTrain>,
) -> Result<(SeenExposures, Vec<SeenExposure>), StrobesRefused> {
    let mut finder = ExposureFinder::new(train.copied());
    let mut edges = edges.iter().peekable();
    for &pulse in pulses {
        while let Some(&edge) = edges.next_if(|edge| edge.at.0 + 24_000_000 < pulse.0) {
            finder.edge(edge);
        }
        finder.pulse(pulse);
    }
    edges.for_each(|&edge| finder.edge(edge));
    finder.finish()
}

fn ticks(us: f64) -> u64 {
    (us * 48.0).round() as u64
}

fn flash(out: &mut Vec<StrobeEdge>, from: u64, length: u64) {
    for (at, rising) in [(from, true), (from + length, false)] {
        out.push(StrobeEdge {
            at: Ticks(at),
            rising,
            after_loss: false,
        });
    }
}

/// The flashes of trains that start `delay_us` after each pulse, by the camera's own clock.
fn trains(pulses: &[Ticks], train: &StrobeTrain, delay_us: f64, ppm: f64) -> Vec<StrobeEdge> {
    let rate = 1.0 + ppm * 1e-6;
    let mut edges = Vec::new();
    for pulse in pulses {
        for number in 0..train.count {
            let from = (delay_us + f64::from(number) * train.pitch_us) * rate;
            flash(
                &mut edges,
                pulse.0 + ticks(from),
                ticks(train.length_us * rate),
            );
        }
    }
    edges
}

fn center(train: &StrobeTrain, delay_us: f64, ppm: f64) -> f64 {
    let half = 0.5 * (f64::from(train.count - 1) * train.pitch_us + train.length_us);
    (delay_us + half) * (1.0 + ppm * 1e-6)
}

#[test]
fn every_mode_with_a_train_is_measured_to_a_tenth_of_a_microsecond() {
    let mut modes = 0;
    for model in Model::all() {
        for mode in model.modes() {
            let Some(train) = mode.train else { continue };
            modes += 1;
            let every = 30 / mode.rates[0] as usize;
            let pulses: Vec<Ticks> = pulses(200).into_iter().step_by(every).collect();
            for (delay_us, ppm) in [
                (0.0, -389.0),
                (523.7, 300.0),
                (4_000.0, 0.0),
                // The train is not over when the next pulse comes.
                (24_000.0, 1_000.0),
            ] {
                let edges = trains(&pulses, &train, delay_us, ppm);
                let (seen, _) = exposures(&pulses, &edges, Some(&train)).unwrap();
                let error = seen.center_us - center(&train, delay_us, ppm);
                assert!(error.abs() < 0.1, "{} {}: {error}", model.id, mode.name);
                assert_eq!(
                    (seen.used, seen.cut, seen.strange),
                    (pulses.len() - 1, 0, 0)
                );
                assert!(seen.spread_us < 0.1 && seen.sigma_us < 1.0, "{seen:?}");
            }
        }
    }
    // Four modes of the Azure Kinect and of both Femtos.
    assert_eq!(modes, 12);
}

#[test]
fn one_long_flash_is_an_exposure() {
    let pulses = pulses(100);
    let mut edges = Vec::new();
    for pulse in &pulses {
        // Ends after the next pulse, as the exposure of a camera that reads out then.
        flash(&mut edges, pulse.0 + ticks(26_000.0), ticks(8_000.0));
    }
    let (seen, _) = exposures(&pulses, &edges, None).unwrap();
    assert!((seen.center_us - 30_000.0).abs() < 0.1, "{seen:?}");
    assert!((seen.flash_us - 8_000.0).abs() < 0.1);
}

fn azure() -> StrobeTrain {
    Model::find(DEFAULT_CAMERA)
        .unwrap()
        .default_mode
        .train
        .unwrap()
}

/// A recording as drawn: camera mode, its delay and clock, jitter, lost edges, bounce and other
/// flashes.
#[derive(Debug)]
struct Drawn {
    mode: usize,
    delay_us: f64,
    ppm: f64,
    /// Most by which an exposure, and a single flash, moves, µs.
    jitter_us: [f64; 2],
    /// Shares of the flashes that are lost, that bounce, and that another one follows.
    shares: [f64; 3],
    seed: u64,
}

fn drawn() -> impl Strategy<Value = Drawn> {
    let rig = (0..12_usize, 0.0..25_000.0, -500.0..500.0);
    let jitter = (0.0..100.0, 0.0..1.0);
    let shares = (0.0..0.15, 0.0..0.3, 0.0..0.5);
    (rig, jitter, shares, any::<u64>()).prop_map(|(rig, jitter, shares, seed)| Drawn {
        mode: rig.0,
        delay_us: rig.1,
        ppm: rig.2,
        jitter_us: jitter.into(),
        shares: shares.into(),
        seed,
    })
}

/// No result, and no single exposure, is more than a microsecond off, whatever is lost or added;
/// few losses leave a result.
#[test]
fn lost_and_extra_edges_never_move_a_train() {
    let modes = Model::all().iter().flat_map(Model::modes);
    let trains: Vec<(StrobeTrain, u32)> = modes
        .filter_map(|mode| Some((mode.train?, mode.rates[0])))
        .collect();
    let mut runner = TestRunner::new(Config::with_cases(100));
    let run = runner.run(&drawn(), |drawn| {
        let (train, rate) = trains[drawn.mode % trains.len()];
        let pulses: Vec<Ticks> = pulses(180)
            .into_iter()
            .step_by(30 / rate as usize)
            .collect();
        let mut random = Pcg32::seed_from_u64(drawn.seed);
        let [lost, bounce, other] = drawn.shares;
        let [of_exposure, of_flash] = drawn.jitter_us;
        let (mut edges, mut after_loss) = (Vec::new(), false);
        let mut centers = BTreeMap::new();
        for &pulse in &pulses {
            let delay_us = drawn.delay_us + random.random_range(0.0..=of_exposure);
            centers.insert(pulse, center(&train, delay_us, drawn.ppm));
            for pair in self::trains(&[pulse], &train, delay_us, drawn.ppm).chunks(2) {
                let moved = ticks(random.random_range(0.0..=of_flash));
                let (from, to) = (pair[0].at.0 + moved, pair[1].at.0 + moved);
                if random.random_bool(lost) {
                    after_loss = true;
                    continue;
                }
                let mut here = Vec::new();
                if random.random_bool(bounce) {
                    flash(&mut here, from, ticks(6.0));
                    flash(&mut here, from + ticks(10.0), to - from - ticks(10.0));
                } else {
                    flash(&mut here, from, to - from);
                }
                if random.random_bool(other) {
                    let later = ticks(random.random_range(150.0..1_000.0));
                    flash(
                        &mut here,
                        to + later,
                        ticks(random.random_range(20.0..250.0)),
                    );
                }
                here[0].after_loss = std::mem::take(&mut after_loss);
                edges.extend(here);
            }
        }
        let (seen, each) = match exposures(&pulses, &edges, Some(&train)) {
            Ok(found) => found,
            Err(_) if lost > 0.04 => return Ok(()),
            Err(refused) => return Err(TestCaseError::fail(refused.to_string())),
        };
        let mean = centers.values().sum::<f64>() / centers.len() as f64;
        let off = (seen.center_us - mean - 0.5 * of_flash).abs();
        prop_assert!(off < 1.0 + 3.0 * seen.sigma_us, "{mean}, {seen:?}");
        for exposure in &each {
            let off = exposure.center_us - centers[&exposure.edge];
            prop_assert!((-0.2..1.2).contains(&off), "{off}: {exposure:?}");
        }
        Ok(())
    });
    run.unwrap();
}

#[test]
fn a_train_whose_first_flash_is_always_missing_is_not_placed() {
    let pulses = pulses(100);
    let train = azure();
    let edges = trains(&pulses, &train, 500.0, 0.0);
    let cut: Vec<StrobeEdge> = edges
        .chunks(18)
        .flat_map(|frame| frame[2..].to_vec())
        .collect();
    let refused = exposures(&pulses, &cut, Some(&train)).unwrap_err();
    assert_eq!(
        refused,
        StrobesRefused::DoesNotFollow {
            used: 0,
            pulses: 99
        }
    );
}

#[test]
fn light_that_does_not_follow_the_trigger_is_refused() {
    let pulses = pulses(300);
    assert_eq!(exposures(&pulses, &[], None), Err(StrobesRefused::Dark));
    for hz in [100.0, 120.0, 317.0] {
        let mut lamp = Vec::new();
        for flash_number in 0..(10.0 * hz) as u64 {
            let from = ticks(flash_number as f64 * 1e6 / hz);
            flash(&mut lamp, from, ticks(0.5e6 / hz));
        }
        for train in [None, Some(azure())] {
            let seen = exposures(&pulses, &lamp, train.as_ref()).map(|(seen, _)| seen.used);
            assert!(
                matches!(
                    seen,
                    Err(StrobesRefused::DoesNotFollow { .. } | StrobesRefused::Moves { .. })
                ),
                "{hz} Hz, {train:?}: {seen:?}"
            );
        }
    }
    // The trains of a camera that runs by itself, 0.1 % slower.
    let own: Vec<Ticks> = pulses.iter().map(|at| Ticks(at.0 + at.0 / 1_000)).collect();
    let own = trains(&own, &azure(), 500.0, 0.0);
    let seen = exposures(&pulses, &own, Some(&azure())).map(|(seen, _)| seen.used);
    assert!(
        matches!(seen, Err(StrobesRefused::DoesNotFollow { .. })),
        "{seen:?}"
    );
}

#[test]
fn a_slow_circuit_and_a_drift_are_stated() {
    let pulses = pulses(900);
    let train = azure();
    let mut edges = trains(&pulses, &train, 500.0, 0.0);
    for edge in edges.iter_mut().filter(|edge| !edge.rising) {
        edge.at.0 += ticks(12.0);
    }
    let (slow, _) = exposures(&pulses, &edges, Some(&train)).unwrap();
    let truth = center(&train, 500.0, 0.0);
    assert!((slow.center_us - truth - 6.0).abs() < 0.1);
    assert!((6.0..6.2).contains(&slow.sigma_us), "{}", slow.sigma_us);
    // 10 µs a minute.
    let moved: Vec<Ticks> = pulses
        .iter()
        .map(|at| Ticks(at.0 + (at.0 - pulses[0].0) / 6_000_000))
        .collect();
    let (drifting, _) =
        exposures(&pulses, &trains(&moved, &train, 500.0, 0.0), Some(&train)).unwrap();
    let [drift, sigma] = drifting.drift_us_per_min;
    assert!((drift - 10.0).abs() < 0.1 && sigma < 0.1, "{drift} {sigma}");
    // What moves is no constant.
    assert!(
        (1.4..2.0).contains(&drifting.sigma_us),
        "{}",
        drifting.sigma_us
    );
}
