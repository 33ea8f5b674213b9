//! From the profiles of a recording to the train's place in each frame.
//!
//! 1. A few frames are searched widely: is there a train, of which row time and
//!    exposure?
//! 2. Every frame is searched with that shape and fitted; frames with and without
//!    flashes are told apart.
//! 3. Frames without flashes become the reference, so that the scene's own
//!    structure is no longer taken for flashes; or rows that are dark in enough
//!    frames do. Then step 2 again.
//! 4. Frames whose smooth brightness differs from the others' by more than the
//!    room light's share allowed are left out: mains flicker, a hand, a lamp.
//! 5. Row time and exposure are fitted over many frames together, then every
//!    frame's centre once more.
//!
//! Which flash is which: with the whole train in view, its ends decide. A frame
//! that shows only a part of it fits equally well with the train moved by whole
//! pitches. All frames are put on one continuous track first, so that one frame
//! with an end in view decides for all; what stays open is stated.

use rayon::prelude::*;
use serde::Serialize;

use super::classify::{
    FrameClass, FrameCounts, Reference, Seen, classify, dark_frames, dark_rows, doubt_dark,
    is_train, mark_flicker, mean_of, with_reference,
};
use super::fit::{FrameFit, JointFit, Model, Prior, Priors};
use super::identity::{Identity, identify, unwrap_track};
use super::linear::{Basis, dot, polynomial_columns};
use super::recording::Recording;
use super::search::{CombSearch, Found, WideSearch};
use super::stats::{mean, quantile};
use super::store::StoredFrame;
use super::train::Shape;
use super::{EvaluateError, Settings};

/// Degree of the smooth part without a reference.
const DEGREE: usize = 5;
/// Share of a frame's structure that a train must explain where the scene is
/// taken for a smooth curve.
const PLAIN_SHARE: f64 = 0.6;
/// The same where the scene is known.
const REFERENCE_SHARE: f64 = 0.2;
/// Degree of the smooth curve that a train must explain a frame better than.
const COMPETITOR_DEGREE: usize = 13;
/// By how much: share of the curve's sum of squares.
const SHARPER: f64 = 0.2;
/// Frames averaged for the report and for the published method.
pub const SHOWN_FRAMES: usize = 16;
/// Frames fitted together for row time and exposure.
const JOINT_FRAMES: usize = 48;
/// One used frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FramePoint {
    /// Number in the recording.
    pub index: usize,
    /// Seconds since the recording's first frame.
    pub time_s: f64,
    /// Centre of the train after the middle row's centre of exposure, µs.
    pub bias_us: f64,
    /// Its standard uncertainty from this frame alone, row time held, µs.
    pub sigma_us: f64,
    /// Grey levels of a whole flash.
    pub amplitude: f64,
}

/// The result for one recording.
#[derive(Debug, Clone)]
pub struct Track {
    /// The used frames in order of time.
    pub points: Vec<FramePoint>,
    /// Counts of all frames.
    pub counts: FrameCounts,
    /// Row time, exposure and, in precision, the mean of all used frames.
    pub joint: JointFit,
    /// Which flash is which.
    pub identity: Identity,
    /// Where the smooth part came from.
    pub reference: Reference,
    /// Mean profile of at most 16 of the used frames, grey levels: the first ones, or
    /// those in the middle where all are used.
    pub mean_profile: Vec<f64>,
    /// Mean of their fitted profiles.
    pub fitted_profile: Vec<f64>,
    /// Mean of their biases, µs.
    pub shown_bias_us: f64,
    /// Remarks for the user.
    pub notes: Vec<String>,
}

/// Which of the frames with flashes are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Choice {
    /// The last so many.
    Last(usize),
    /// All.
    All,
}

/// Finds the train in every frame of a recording.
pub fn track(
    recording: &Recording,
    settings: &Settings,
    choice: Choice,
) -> Result<Track, EvaluateError> {
    let mut notes = Vec::new();
    let frames = &recording.frames;
    let plain = Basis::polynomials(recording.rows.len, DEGREE);
    let no_flashes = || EvaluateError::NoFlashes {
        path: recording.path.clone(),
        frames: frames.len(),
    };
    let (mut model, mut shape) = first_sight(recording, settings, &plain).ok_or_else(no_flashes)?;
    let mut seen = look(&model, frames, &shape, settings);
    classify(&mut seen, PLAIN_SHARE);
    doubt_dark(recording, frames, &mut seen, &shape, settings);
    let mut reference = Reference::Polynomial;

    let refined = dark_frames(frames, &seen)
        .or_else(|| dark_rows(recording, frames, &seen, &shape, settings));
    if let Some((basis, kind)) = refined {
        let basis = Model::new(recording.rows, settings.train, basis);
        if let Some(better) = sharpen(&basis, frames, &seen, &shape, settings) {
            shape = better;
        }
        let mut again = look(&basis, frames, &shape, settings);
        classify(&mut again, REFERENCE_SHARE);
        doubt_dark(recording, frames, &mut again, &shape, settings);
        if again.iter().any(|s| s.class == FrameClass::Used) {
            model = basis;
            seen = again;
            reference = kind;
        }
    }
    if !seen.iter().any(|s| s.class == FrameClass::Used) {
        return Err(no_flashes());
    }

    let flicker = mark_flicker(
        &model,
        &plain,
        frames,
        &mut seen,
        &shape,
        settings.keep_flicker,
    );
    if let Some(flicker) = &flicker {
        notes.push(flicker.note.clone());
    }
    let mut counts = FrameCounts {
        read: recording.read,
        examined: frames.len(),
        ..FrameCounts::default()
    };
    let mut good: Vec<usize> = (0..seen.len())
        .filter(|&i| seen.get(i).is_some_and(|s| s.class == FrameClass::Used))
        .collect();
    if let Choice::Last(n) = choice {
        let spare = good.len().saturating_sub(n);
        for i in good.drain(..spare) {
            if let Some(s) = seen.get_mut(i) {
                s.class = FrameClass::Spare;
            }
        }
    }
    for s in &seen {
        match s.class {
            FrameClass::Used => counts.used += 1,
            FrameClass::Spare => counts.spare += 1,
            FrameClass::Dark => counts.without_flashes += 1,
            FrameClass::Unclear => counts.unclear += 1,
            FrameClass::Flicker => counts.flicker += 1,
        }
    }
    if good.is_empty() {
        return Err(EvaluateError::OnlyFlicker {
            path: recording.path.clone(),
            flicker: counts.flicker,
            frames: frames.len(),
            peak_to_peak: flicker.map_or(0.0, |f| f.peak_to_peak),
        });
    }

    // Row time and exposure from frames spread over the recording.
    let used: Vec<(&StoredFrame, f64)> = good
        .iter()
        .filter_map(|&i| Some((frames.get(i)?, seen.get(i)?.bias_us)))
        .collect();
    let shared = spread(used.len(), JOINT_FRAMES.max(choice.limit()));
    let (some, some_start): (Vec<Vec<f64>>, Vec<f64>) = shared
        .iter()
        .filter_map(|&i| used.get(i))
        .map(|(frame, bias)| (model.detrend(&frame.rows), *bias))
        .unzip();
    let mut joint = model.fit_joint(&some, &some_start, &shape, &priors(settings));
    let shape = Shape {
        bias_us: 0.0,
        row_time_us: joint.row_time_us,
        exposure_us: joint.exposure_us,
    };
    // Of a long recording those in the middle are shown: at its begin the train may
    // still be moved.
    let first_shown = match choice {
        Choice::Last(_) => 0,
        Choice::All => used.len().saturating_sub(SHOWN_FRAMES) / 2,
    };
    let mut shown_residuals: Vec<Vec<f64>> = Vec::new();
    let mut fits: Vec<FrameFit> = Vec::with_capacity(used.len());
    // In pieces, because the curves of all frames together are large.
    for piece in used.chunks(256) {
        let mut some: Vec<FrameFit> = piece
            .par_iter()
            .map(|&(frame, bias_us)| {
                model.fit_frame(&model.detrend(&frame.rows), &Shape { bias_us, ..shape })
            })
            .collect();
        for (place, fit) in some.iter_mut().enumerate() {
            let residuals = std::mem::take(&mut fit.residuals);
            fit.light = Vec::new();
            let is_shown =
                (first_shown..first_shown + SHOWN_FRAMES).contains(&(fits.len() + place));
            if is_shown {
                shown_residuals.push(residuals);
            }
        }
        fits.append(&mut some);
    }

    let profiles: Vec<&[f32]> = used.iter().map(|(f, _)| f.rows.as_slice()).collect();
    let times: Vec<f64> = used.iter().map(|(f, _)| f.time_s).collect();
    unwrap_track(&mut fits, &times, settings.train.pitch_us);
    let excess = (reference_level(frames, &seen), mean(&levels(&profiles)));
    let chosen = identify(
        &model,
        &profiles,
        &mut fits,
        &shape,
        excess.0.map(|dark| excess.1 - dark),
        settings,
    );
    let identity = chosen.identity;
    joint.exposure_us = chosen.exposure_us;
    // The joint fit's own frames were put elsewhere by whole or half pitches.
    for (bias, &i) in joint.bias_us.iter_mut().zip(&shared) {
        if let Some(fit) = fits.get(i) {
            let half = 0.5 * settings.train.pitch_us;
            *bias += ((fit.bias_us - *bias) / half).round() * half;
        }
    }
    joint.mean_us = mean(&joint.bias_us);

    let points = used
        .iter()
        .zip(&fits)
        .map(|((frame, _), fit)| FramePoint {
            index: frame.index,
            time_s: frame.time_s,
            bias_us: fit.bias_us - settings.path_delay_us,
            sigma_us: fit.sigma_us,
            amplitude: fit.amplitude,
        })
        .collect();
    let shown_profiles = profiles.iter().skip(first_shown).take(SHOWN_FRAMES);
    let mean_profile = mean_of(shown_profiles.copied());
    let shown_fits = fits.iter().skip(first_shown).take(SHOWN_FRAMES);
    let shown_biases: Vec<f64> = shown_fits.map(|fit| fit.bias_us).collect();
    let shown_bias_us = mean(&shown_biases) - settings.path_delay_us;
    let residuals = mean_of(shown_residuals.iter().map(Vec::as_slice));
    let fitted_profile = mean_profile
        .iter()
        .zip(&residuals)
        .map(|(p, r)| p - r)
        .collect();
    joint.mean_us -= settings.path_delay_us;
    joint
        .bias_us
        .iter_mut()
        .for_each(|b| *b -= settings.path_delay_us);
    if blind(&joint, settings) {
        notes.push(format!(
            "the exposure of {:.0} µs is close to a whole number of flash pitches ({} µs): every row sees almost the same light and only the train's ends tell its place. Choose another exposure",
            joint.exposure_us, settings.train.pitch_us
        ));
    }
    Ok(Track {
        points,
        counts,
        joint,
        identity,
        reference,
        mean_profile,
        fitted_profile,
        shown_bias_us,
        notes,
    })
}

/// Mean brightness of each frame.
fn levels(profiles: &[&[f32]]) -> Vec<f64> {
    profiles
        .iter()
        .map(|p| mean(&p.iter().map(|&v| f64::from(v)).collect::<Vec<_>>()))
        .collect()
}

/// Mean brightness of the frames without flashes.
fn reference_level(frames: &[StoredFrame], seen: &[Seen]) -> Option<f64> {
    let dark: Vec<&[f32]> = frames
        .iter()
        .zip(seen)
        .filter(|(_, s)| s.class == FrameClass::Dark)
        .map(|(f, _)| f.rows.as_slice())
        .collect();
    (!dark.is_empty()).then(|| mean(&levels(&dark)))
}

impl Choice {
    fn limit(self) -> usize {
        match self {
            Self::Last(n) => n.min(256),
            Self::All => 0,
        }
    }
}

fn priors(settings: &Settings) -> Priors {
    Priors {
        row_time_us: settings.row_time_us.map(|value| Prior {
            value,
            sigma: 5e-3 * value,
        }),
        exposure_us: settings.exposure_us.map(|value| Prior {
            value,
            sigma: 0.02 * value + 5.0,
        }),
    }
}

fn blind(joint: &JointFit, settings: &Settings) -> bool {
    let pitches = joint.exposure_us / settings.train.pitch_us;
    pitches > 0.5
        && (pitches - pitches.round()).abs() * settings.train.pitch_us
            < 0.3 * settings.train.duration_us
}

/// At most `count` indices spread evenly over `0..len`.
pub(super) fn spread(len: usize, count: usize) -> Vec<usize> {
    if len <= count {
        return (0..len).collect();
    }
    (0..count)
        .map(|k| k * (len - 1) / (count - 1).max(1))
        .collect()
}

/// Finds the train somewhere in the recording, with or without a first guess of
/// a dark reference.
fn first_sight(
    recording: &Recording,
    settings: &Settings,
    plain: &Basis,
) -> Option<(Model, Shape)> {
    let frames = &recording.frames;
    let mut bases = vec![plain.clone()];
    // Flashes only add light: the darkest frames are the likeliest without any.
    let levels: Vec<f64> = frames
        .iter()
        .map(|f| f.rows.iter().map(|&v| f64::from(v)).sum())
        .collect();
    let limit = quantile(&levels, 0.1)?;
    if frames.len() >= 4 {
        let dark = mean_of(
            frames
                .iter()
                .zip(&levels)
                .filter(|(_, level)| **level <= limit)
                .map(|(f, _)| f.rows.as_slice()),
        );
        bases.push(with_reference(dark));
    }
    for basis in bases {
        let model = Model::new(recording.rows, settings.train, basis);
        let mut order: Vec<(usize, f64)> = frames
            .par_iter()
            .map(|f| {
                let y = model.detrend(&f.rows);
                dot(&y, &y)
            })
            .enumerate()
            .collect();
        order.sort_by(|a, b| b.1.total_cmp(&a.1));
        // A smooth curve with as many parameters as a train.
        let competitor = Basis::spanning(
            (model.smooth.columns().iter().cloned())
                .chain(polynomial_columns(recording.rows.len, COMPETITOR_DEGREE)),
        );
        let candidates: Vec<&StoredFrame> = {
            let last = order.len().saturating_sub(1) as f64;
            let mut ranks: Vec<usize> = [0.0, 0.1, 0.3, 0.5, 0.75]
                .iter()
                .map(|r| (r * last) as usize)
                .collect();
            ranks.dedup();
            ranks
                .into_iter()
                .filter_map(|at| frames.get(order.get(at)?.0))
                .collect()
        };
        for wide in searches(recording, settings) {
            for frame in &candidates {
                let y = model.detrend(&frame.rows);
                let mut bent = y.clone();
                competitor.remove_from(&mut bent);
                let smooth_rss = dot(&bent, &bent);
                let found = wide.run(recording.rows, &settings.train, &y, &model.smooth);
                if let Some(shape) = best_train(&model, &y, &found, smooth_rss, settings) {
                    return Some((model, shape));
                }
            }
        }
    }
    None
}

/// Where to look: near what is known or was found before, then everywhere.
fn searches(recording: &Recording, settings: &Settings) -> Vec<WideSearch> {
    let rows = recording.reducer.sensor_rows();
    let search = |row_time, exposure| WideSearch::new(rows, row_time, exposure, settings.near_us);
    let hinted_row_time = settings.row_time_us.or(settings.row_time_hint_us);
    let hinted_exposure = settings.exposure_us.or(settings.exposure_hint_us);
    let mut all = vec![
        search(hinted_row_time, hinted_exposure),
        search(hinted_row_time, settings.exposure_us),
        search(settings.row_time_us, settings.exposure_us),
    ];
    all.dedup();
    all
}

/// Fits what a search found in one frame; the best that is a train.
fn best_train(
    model: &Model,
    y: &[f64],
    found: &[Found],
    smooth_rss: f64,
    settings: &Settings,
) -> Option<Shape> {
    let frame = [y.to_vec()];
    found
        .iter()
        .filter_map(|found| {
            let joint = model.fit_joint(
                &frame,
                &[found.shape.bias_us],
                &found.shape,
                &priors(settings),
            );
            let shape = Shape {
                bias_us: joint.mean_us,
                row_time_us: joint.row_time_us,
                exposure_us: joint.exposure_us,
            };
            let fit = model.fit_frame(y, &shape);
            let sharp = fit.rss <= (1.0 - SHARPER) * smooth_rss;
            (sharp && is_train(&fit, PLAIN_SHARE)).then_some((fit.share, shape))
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, shape)| shape)
}

/// Searches and fits every frame.
fn look(model: &Model, frames: &[StoredFrame], shape: &Shape, settings: &Settings) -> Vec<Seen> {
    let search = CombSearch::new(
        model.rows,
        &settings.train,
        shape.row_time_us,
        shape.exposure_us,
        &model.smooth,
        0.25 * settings.train.duration_us,
    );
    frames
        .par_iter()
        .map(|frame| {
            let y = model.detrend(&frame.rows);
            let start = search
                .best(&y, settings.near_us)
                .map_or(*shape, |f| f.shape);
            Seen::new(&model.fit_frame(&y, &start))
        })
        .collect()
}

/// Row time and exposure once more, from a few frames, with the reference.
fn sharpen(
    model: &Model,
    frames: &[StoredFrame],
    seen: &[Seen],
    shape: &Shape,
    settings: &Settings,
) -> Option<Shape> {
    let used: Vec<(&StoredFrame, f64)> = frames
        .iter()
        .zip(seen)
        .filter(|(_, s)| s.class == FrameClass::Used)
        .map(|(f, s)| (f, s.bias_us))
        .collect();
    let some = spread(used.len(), 8);
    let (y, bias): (Vec<Vec<f64>>, Vec<f64>) = some
        .iter()
        .filter_map(|&i| used.get(i))
        .map(|(f, bias)| (model.detrend(&f.rows), *bias))
        .unzip();
    if y.is_empty() {
        return None;
    }
    let joint = model.fit_joint(&y, &bias, shape, &priors(settings));
    Some(Shape {
        bias_us: joint.mean_us,
        row_time_us: joint.row_time_us,
        exposure_us: joint.exposure_us,
    })
}
