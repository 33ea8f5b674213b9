//! Assignment of flashes to bands.
//!
//! A frame that shows only the inner part of a train fits equally well with the train
//! moved by whole pitches. First all frames are put on one continuous track, then
//! the track as a whole is moved to where the train's ends fit. Without an end in
//! view several positions remain; the result states them all and uses the one nearest to the
//! expected bias. The exposure is ambiguous in the same way: one that is
//! longer by a pitch moves the bands by half a pitch and changes only the level.

use nalgebra::DVector;
use rayon::prelude::*;
use serde::Serialize;

use crate::Settings;
use crate::stats::{evenly_spaced, mean};
use crate::train::Shape;
use crate::train::fit::{FrameFit, Model};

/// Frames on which the assignment is judged.
const FRAMES: usize = 16;
/// Margin (χ²) by which one assignment of flashes must fit better than another.
pub(crate) const DECIDED: f64 = 25.0;
/// Longest exposure that is considered, µs.
const MAX_EXPOSURE_US: f64 = 8500.0;
/// Largest distance of the level over dark frames from a whole number of flashes.
const LEVEL_TOLERANCE: f64 = 0.3;

/// Assignment of flashes to bands.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Identity {
    /// True if only one assignment fits the frames.
    pub unique: bool,
    /// All assignments that fit; the first is used.
    pub candidates: Vec<Candidate>,
}

/// One assignment of flashes to bands.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Candidate {
    /// Mean centre of the train over the used frames, µs.
    pub bias_us: f64,
    /// Exposure of the assignment, µs.
    pub exposure_us: f64,
}

/// Puts the frames on one track: each is moved by whole pitches to the position nearest to the
/// continuation of the recent frames.
pub(crate) fn unwrap_track(fits: &mut [FrameFit], times: &[f64], pitch_us: f64) {
    let mut recent: Vec<(f64, f64)> = Vec::new();
    for (fit, &time) in fits.iter_mut().zip(times) {
        if let (Some(&(t0, b0)), Some(&(t1, b1))) = (recent.first(), recent.last()) {
            let slope = if t1 > t0 { (b1 - b0) / (t1 - t0) } else { 0.0 };
            let expected = b1 + slope * (time - t1);
            let pitches = ((expected - fit.bias_us) / pitch_us).round();
            fit.bias_us += pitches * pitch_us;
        }
        recent.push((time, fit.bias_us));
        if recent.len() > 12 {
            recent.remove(0);
        }
    }
}

/// One interpretation of the frames: an exposure longer by `extra` pitches, and the
/// track moved by `pitches` whole pitches (and by half a pitch more for odd `extra`).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Reading {
    extra: i32,
    pitches: i32,
}

impl Reading {
    fn shift_us(self, pitch_us: f64) -> f64 {
        (f64::from(self.pitches) + 0.5 * f64::from(self.extra.rem_euclid(2))) * pitch_us
    }
}

/// Assigns flashes to bands and moves the track there.
///
/// `excess` is the mean brightness of the frames over that of frames without
/// flashes, if there are any.
pub(crate) fn identify(
    model: &Model,
    profiles: &[&[f32]],
    fits: &mut [FrameFit],
    shape: &Shape,
    excess: Option<f64>,
    settings: &Settings,
) -> Identity {
    let pitch = settings.train.pitch_us;
    let reach = settings.train.count as i32 - 1;
    let asked = evenly_spaced(fits.len(), FRAMES);
    let center = mean(&fits.iter().map(|f| f.bias_us).collect::<Vec<_>>());
    let expected = settings.near_us + settings.path_delay_us;
    let exposure = |extra: i32| shape.exposure_us + f64::from(extra) * pitch;
    let readings: Vec<Reading> = extras(fits, shape, excess, settings)
        .into_iter()
        .flat_map(|extra| {
            let half = 0.5 * f64::from(extra.rem_euclid(2));
            let nearest = ((expected - center) / pitch - half).round() as i32;
            (nearest - reach..=nearest + reach).map(move |pitches| Reading { extra, pitches })
        })
        .collect();
    let detrended: Vec<(DVector<f64>, &FrameFit)> = asked
        .iter()
        .filter_map(|&i| Some((model.detrend(profiles.get(i)?), fits.get(i)?)))
        .collect();
    // χ² of each reading as a mean over frames, so that errors of neighbouring rows and errors
    // that all frames share count only once.
    let scores: Vec<f64> = readings
        .par_iter()
        .map(|reading| {
            let values: Vec<f64> = detrended
                .iter()
                .map(|(y, fit)| {
                    let moved = Shape {
                        exposure_us: exposure(reading.extra),
                        ..shape.at(fit.bias_us + reading.shift_us(pitch))
                    };
                    let noise = fit.rss / y.len().max(1) as f64;
                    (model.local(y, &moved).rss - fit.rss) / (noise * fit.inflation).max(1e-12)
                })
                .collect();
            mean(&values)
        })
        .collect();
    let best = scores.iter().copied().fold(f64::INFINITY, f64::min);
    let mut fitting: Vec<Reading> = readings
        .iter()
        .zip(&scores)
        .filter(|(_, s)| **s <= best + DECIDED)
        .map(|(&r, _)| r)
        .collect();
    // The shortest exposure, then the position nearest to the expected one.
    let distance = |r: &Reading| (center + r.shift_us(pitch) - expected).abs();
    fitting
        .sort_by(|a, b| (a.extra.cmp(&b.extra)).then_with(|| distance(a).total_cmp(&distance(b))));
    if let Some(taken) = fitting.first() {
        for fit in fits.iter_mut() {
            fit.bias_us += taken.shift_us(pitch);
        }
    }
    let candidate = |reading: &Reading| Candidate {
        bias_us: center + reading.shift_us(pitch) - settings.path_delay_us,
        exposure_us: exposure(reading.extra),
    };
    Identity {
        unique: fitting.len() == 1,
        candidates: fitting.iter().map(candidate).collect(),
    }
}

/// Returns the numbers of pitches by which the exposure may be longer than the fitted one.
///
/// A row exposed for one more pitch sees one more flash, wherever it is: inside
/// the train only the level changes, and the bands move by half a pitch.
/// The level decides if there are frames without flashes for comparison.
fn extras(fits: &[FrameFit], shape: &Shape, excess: Option<f64>, settings: &Settings) -> Vec<i32> {
    let pitch = settings.train.pitch_us;
    let exposure = |extra: i32| shape.exposure_us + f64::from(extra) * pitch;
    let possible: Vec<i32> = (-8..=8)
        .filter(|&j| exposure(j) > 0.0 && (j <= 0 || exposure(j) <= MAX_EXPOSURE_US))
        .filter(|&j| {
            settings
                .exposure_us
                .or(settings.exposure_hint_us)
                .is_none_or(|known| (exposure(j) - known).abs() < 0.25 * pitch)
        })
        .collect();
    let amplitude = mean(&fits.iter().map(|f| f.amplitude).collect::<Vec<_>>());
    let light = mean(&fits.iter().map(|f| f.mean_light).collect::<Vec<_>>());
    if let Some(excess) = excess.filter(|_| amplitude > 0.0) {
        let more = (excess - light) / amplitude;
        let whole = more.round();
        if (more - whole).abs() < LEVEL_TOLERANCE && possible.contains(&(whole as i32)) {
            return vec![whole as i32];
        }
    }
    if possible.is_empty() {
        vec![0]
    } else {
        possible
    }
}
