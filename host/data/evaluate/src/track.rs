//! The train's position in each frame of a recording, from the frames' profiles.
//!
//! 1. A few frames are searched widely: is there a train, of which row time and
//!    exposure?
//! 2. Every frame is searched with that shape and fitted; frames with and without
//!    flashes are distinguished.
//! 3. Frames without flashes become the reference, so that the scene's own
//!    structure no longer looks like flashes; if there are none, rows that are dark in
//!    enough frames. Then step 2 is repeated.
//! 4. Frames whose smooth brightness differs from the others' by more than the
//!    room light's share allowed are left out: mains flicker, a hand, a lamp.
//! 5. Row time and exposure are fitted over many frames together, then every
//!    frame's centre once more.
//!
//! Assignment of flashes to bands: with the whole train in view, its ends decide. A frame
//! that shows only a part of it fits equally well with the train moved by whole
//! pitches. All frames are put on one continuous track first, so that one frame
//! with an end in view decides for all; the result states all possibilities that remain.

pub(crate) mod classify;
pub(crate) mod evidence;
mod identity;
mod lamp;
pub(crate) mod window;

use std::ops::Range;

use nalgebra::DVector;
use rayon::prelude::*;
use serde::Serialize;

use self::classify::{
    FrameClass, Seen, classify, dark_scene, frames_of, mark_flicker, mean_of, recheck_dark,
    with_reference,
};
pub use self::classify::{FrameCounts, Reference};
pub use self::evidence::Evidence;
pub use self::identity::{Candidate, Identity};
use self::identity::{identify, unwrap_track};
use crate::footage::Footage;
use crate::footage::store::StoredFrame;
use crate::stats::{evenly_spaced, mean, quantile};
use crate::train::Shape;
use crate::train::fit::{FrameFit, Model};
use crate::train::joint::{JointFit, Prior, Priors};
use crate::train::linear::{Basis, polynomial_columns, side_by_side};
use crate::train::search::{CombSearch, Found, WideSearch};
use crate::{EvaluateError, Settings};

/// Degree of the smooth part without a reference.
const DEGREE: usize = 5;
/// Share of a frame's structure that a train must explain if the scene is assumed to be a
/// smooth curve.
const PLAIN_SHARE: f64 = 0.6;
/// Share of a frame's structure that a train must explain if the scene is known.
const REFERENCE_SHARE: f64 = 0.2;
/// Degree of the smooth curve that a train must surpass in explaining a frame.
const COMPETITOR_DEGREE: usize = 13;
/// Margin by which it must, as a share of the curve's sum of squares.
const SHARPER: f64 = 0.2;
/// Time from the begin of a recording within which the session aligns the trigger, seconds.
const BEGINNING_S: f64 = 60.0;
/// Frames averaged for the report.
const SHOWN_FRAMES: usize = 16;
/// Frames fitted together for row time and exposure.
const JOINT_FRAMES: usize = 48;
/// Frames fitted together against a reference that was just found.
const SHARPEN_FRAMES: usize = 8;

/// One used frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct FramePoint {
    /// Number of the frame in its recording, from 0.
    pub index: usize,
    /// Seconds since the recording's first frame.
    pub time_s: f64,
    /// Centre of the train minus the middle row's centre of exposure, µs.
    pub bias_us: f64,
    /// Standard uncertainty of the bias from this frame alone at a fixed row time, µs.
    pub sigma_us: f64,
    /// Grey levels of a whole flash.
    pub amplitude: f64,
}

/// The result for one recording.
#[derive(Debug, Clone)]
pub(crate) struct Track {
    /// The used frames in order of time.
    pub points: Vec<FramePoint>,
    /// Counts of all frames.
    pub counts: FrameCounts,
    /// Row time, exposure and, in precision, the mean of all used frames.
    pub(crate) joint: JointFit,
    /// Assignment of flashes to bands.
    pub identity: Identity,
    /// Evidence that the bands are flashes.
    pub evidence: Option<Evidence>,
    /// Source of the scene's brightness without flashes.
    pub reference: Reference,
    /// Mean profile of at most 16 of the used frames, grey levels: the first ones, or
    /// those in the middle if all are used.
    pub mean_profile: Vec<f64>,
    /// Mean of their fitted profiles.
    pub fitted_profile: Vec<f64>,
    /// Mean of their biases, µs.
    pub shown_bias_us: f64,
    /// Remarks for the user.
    pub notes: Vec<String>,
}

/// Choice among the frames with flashes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Choice {
    /// This number of frames at the end.
    Last(usize),
    /// All frames.
    All,
    /// The frames between two times, in seconds of the recording.
    Within(f64, f64),
}

/// The train in each frame, by one model of the scene.
struct Sighting {
    model: Model,
    shape: Shape,
    seen: Vec<Seen>,
    reference: Reference,
}

/// A frame to measure, and the bias of the train in its first fit, µs.
type UsedFrame<'a> = (&'a StoredFrame, f64);

/// Finds the train in every frame of a recording.
pub(crate) fn track(
    footage: &Footage,
    settings: &Settings,
    choice: Choice,
) -> Result<Track, EvaluateError> {
    let plain = Basis::polynomials(footage.rows.len, DEGREE);
    let mut sighting = first_sight(footage, settings, &plain)
        .map(|first| against_scene(first, footage, settings))
        .filter(|found| found.seen.iter().any(|s| s.class == FrameClass::Used))
        .ok_or_else(|| EvaluateError::NoFlashes {
            path: footage.path.clone(),
            frames: footage.frames.len(),
            lamp: lamp::note(footage, settings),
        })?;
    let flicker = mark_flicker(
        &sighting.model,
        &plain,
        &footage.frames,
        &mut sighting.seen,
        &sighting.shape,
    );
    let evidence = evidence::find(
        footage,
        &sighting.model,
        &sighting.seen,
        &sighting.shape,
        settings,
    );
    choice.mark_spare(&mut sighting.seen, footage);
    let counts = FrameCounts::count(&sighting.seen, footage.read);
    let used = sighting.used(footage);
    if used.is_empty() {
        return Err(EvaluateError::OnlyFlicker {
            path: footage.path.clone(),
            flicker: counts.flicker,
            frames: footage.frames.len(),
            peak_to_peak: flicker.map_or(0.0, |f| f.peak_to_peak),
        });
    }

    // Row time and exposure from frames spread over the recording; then every frame's
    // centre once more.
    let together = evenly_spaced(used.len(), JOINT_FRAMES.max(choice.limit()));
    let mut joint = fit_some(&sighting.model, &used, &together, &sighting.shape, settings);
    let shown = choice.shown(used.len());
    let mut fits = fit_each(&sighting.model, &used, &joint.shape());
    let (mean_profile, fitted_profile) = mean_profiles(
        &sighting.model,
        used.get(shown.clone()).unwrap_or_default(),
        fits.get(shown.clone()).unwrap_or_default(),
        &joint.shape(),
    );

    let times: Vec<f64> = used.iter().map(|(f, _)| f.time_s).collect();
    unwrap_track(&mut fits, &times, settings.train.pitch_us);
    let profiles: Vec<&[f32]> = used.iter().map(|(f, _)| f.rows.as_slice()).collect();
    let dark = sighting.dark_level(footage);
    let identity = identify(
        &sighting.model,
        &profiles,
        &mut fits,
        &joint.shape(),
        dark.map(|dark| mean(&mean_of(profiles.iter().copied())) - dark),
        settings,
    );
    if let Some(taken) = identity.candidates.first() {
        joint.exposure_us = taken.exposure_us;
    }
    follow(&mut joint, &together, &fits, settings);

    let points: Vec<FramePoint> = used
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
    let shown = points.get(shown).unwrap_or_default();
    let shown_bias_us = mean(&shown.iter().map(|p| p.bias_us).collect::<Vec<_>>());
    let notes = flicker.map(|f| f.note).into_iter();
    Ok(Track {
        shown_bias_us,
        points,
        counts,
        identity,
        evidence,
        reference: sighting.reference,
        mean_profile,
        fitted_profile,
        notes: notes.chain(blind(&joint, settings)).collect(),
        joint,
    })
}

impl Track {
    /// Returns the evidence in the frames of this track, or, if only a later part of the
    /// recording is used, in its beginning.
    pub(crate) fn evidence_or_earlier(
        &self,
        footage: &Footage,
        settings: &Settings,
    ) -> Option<Evidence> {
        self.evidence.or_else(|| earlier(footage, settings))
    }
}

/// Returns the evidence in the beginning of a recording of which a later part is used.
fn earlier(footage: &Footage, settings: &Settings) -> Option<Evidence> {
    let from_s = settings.from_s?;
    let settings = Settings {
        from_s: None,
        to_s: Some((from_s + 2.0).min(BEGINNING_S)),
        ..settings.clone()
    };
    let beginning = footage.read_part(&settings).ok()?;
    track(&beginning, &settings, Choice::All).ok()?.evidence
}

impl Sighting {
    /// Searches and fits every frame with a shape of the train.
    fn new(
        model: Model,
        shape: Shape,
        reference: Reference,
        footage: &Footage,
        settings: &Settings,
    ) -> Self {
        let search = CombSearch::new(
            model.rows,
            &settings.train,
            shape.row_time_us,
            shape.exposure_us,
            &model.smooth,
            0.25 * settings.train.duration_us,
        );
        let mut seen: Vec<Seen> = footage
            .frames
            .par_iter()
            .map(|frame| {
                let y = model.detrend(&frame.rows);
                let found = search.best(y.as_slice(), settings.near_us);
                Seen {
                    fit: model.fit_frame(&y, &found.map_or(shape, |f| f.shape)),
                    class: FrameClass::Unclear,
                }
            })
            .collect();
        let share = match reference {
            Reference::Polynomial => PLAIN_SHARE,
            Reference::DarkFrames(_) | Reference::DarkRows => REFERENCE_SHARE,
        };
        classify(&mut seen, share);
        recheck_dark(footage, &mut seen, &shape, &settings.train);
        Self {
            model,
            shape,
            seen,
            reference,
        }
    }

    fn used<'a>(&'a self, footage: &'a Footage) -> Vec<UsedFrame<'a>> {
        frames_of(footage, &self.seen, FrameClass::Used)
            .map(|(frame, seen)| (frame, seen.fit.bias_us))
            .collect()
    }

    /// Returns the mean brightness of the frames without flashes, if there are any.
    fn dark_level(&self, footage: &Footage) -> Option<f64> {
        let dark = frames_of(footage, &self.seen, FrameClass::Dark);
        let mean_rows = mean_of(dark.map(|(frame, _)| frame.rows.as_slice()));
        (!mean_rows.is_empty()).then(|| mean(&mean_rows))
    }
}

/// Repeats the search with the known scene without flashes, if there is one and it shows the
/// train.
fn against_scene(first: Sighting, footage: &Footage, settings: &Settings) -> Sighting {
    let scene = dark_scene(footage, &first.seen, &first.shape, &settings.train);
    let Some((basis, reference)) = scene else {
        return first;
    };
    let model = Model::new(footage.rows, settings.train, basis);
    let used = first.used(footage);
    let shape = if used.is_empty() {
        first.shape
    } else {
        let some = evenly_spaced(used.len(), SHARPEN_FRAMES);
        fit_some(&model, &used, &some, &first.shape, settings).shape()
    };
    let again = Sighting::new(model, shape, reference, footage, settings);
    if again.seen.iter().any(|s| s.class == FrameClass::Used) {
        again
    } else {
        Sighting { shape, ..first }
    }
}

/// Fits row time and exposure to the frames at these indices together.
fn fit_some(
    model: &Model,
    used: &[UsedFrame<'_>],
    places: &[usize],
    start: &Shape,
    settings: &Settings,
) -> JointFit {
    let (profiles, biases): (Vec<DVector<f64>>, Vec<f64>) = places
        .iter()
        .filter_map(|&place| used.get(place))
        .map(|(frame, bias)| (model.detrend(&frame.rows), *bias))
        .unzip();
    model.fit_joint(&profiles, &biases, start, &priors(settings))
}

/// Fits each frame's centre with a common row time and exposure.
fn fit_each(model: &Model, used: &[UsedFrame<'_>], shape: &Shape) -> Vec<FrameFit> {
    used.par_iter()
        .map(|&(frame, bias_us)| model.fit_frame(&model.detrend(&frame.rows), &shape.at(bias_us)))
        .collect()
}

/// Mean profile of some frames, and mean of their fitted profiles.
fn mean_profiles(
    model: &Model,
    frames: &[UsedFrame<'_>],
    fits: &[FrameFit],
    shape: &Shape,
) -> (Vec<f64>, Vec<f64>) {
    let profile = mean_of(frames.iter().map(|(frame, _)| frame.rows.as_slice()));
    let residuals: Vec<DVector<f64>> = frames
        .iter()
        .zip(fits)
        .map(|((frame, _), fit)| (model.detrend(&frame.rows), shape.at(fit.bias_us)))
        .map(|(detrended, shape)| model.local(&detrended, &shape).residuals)
        .collect();
    let residuals = mean_of(residuals.iter().map(DVector::as_slice));
    let fitted = profile.iter().zip(&residuals).map(|(p, r)| p - r).collect();
    (profile, fitted)
}

/// Moves the frames of the joint fit by whole or half pitches, as the track has been moved since,
/// and subtracts the light path's delay.
fn follow(joint: &mut JointFit, together: &[usize], fits: &[FrameFit], settings: &Settings) {
    let half = 0.5 * settings.train.pitch_us;
    for (bias, &place) in joint.bias_us.iter_mut().zip(together) {
        if let Some(fit) = fits.get(place) {
            *bias += ((fit.bias_us - *bias) / half).round() * half;
        }
        *bias -= settings.path_delay_us;
    }
    joint.mean_us = mean(&joint.bias_us);
}

impl Choice {
    /// Marks frames that are not chosen as spare.
    fn mark_spare(self, seen: &mut [Seen], footage: &Footage) {
        let frames = footage.frames.iter().map(|frame| frame.time_s);
        let used = seen.iter_mut().zip(frames);
        let used = used.filter(|(s, _)| s.class == FrameClass::Used);
        let spare = |(s, _): (&mut Seen, f64)| s.class = FrameClass::Spare;
        match self {
            Self::All => {}
            Self::Last(n) => {
                let used: Vec<_> = used.collect();
                used.into_iter().rev().skip(n).for_each(spare);
            }
            Self::Within(from, to) => used
                .filter(|(_, at)| !(from..=to).contains(at))
                .for_each(spare),
        }
    }

    fn limit(self) -> usize {
        match self {
            Self::Last(n) => n.min(256),
            Self::All | Self::Within(..) => 0,
        }
    }

    /// Returns the range of the used frames that are shown: in a long recording those in the
    /// middle, because the train may still be moved at its begin.
    fn shown(self, used: usize) -> Range<usize> {
        let first = match self {
            Self::Last(_) => 0,
            Self::All | Self::Within(..) => used.saturating_sub(SHOWN_FRAMES) / 2,
        };
        first..used.min(first + SHOWN_FRAMES)
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

/// Returns a remark if the exposure hides the flashes.
fn blind(joint: &JointFit, settings: &Settings) -> Option<String> {
    let pitches = joint.exposure_us / settings.train.pitch_us;
    let beside_whole = (pitches - pitches.round()).abs() * settings.train.pitch_us;
    (pitches > 0.5 && beside_whole < 0.3 * settings.train.duration_us).then(|| {
        format!(
            "the exposure of {:.0} µs is close to a whole number of flash pitches ({} µs): every row sees almost the same light and only the train's ends tell its place. Choose another exposure",
            joint.exposure_us, settings.train.pitch_us
        )
    })
}

/// Finds the train somewhere in the recording, with a smooth curve or the darkest frames as the
/// scene, and searches every frame for its shape.
fn first_sight(footage: &Footage, settings: &Settings, plain: &Basis) -> Option<Sighting> {
    let searches = searches(footage, settings);
    [Some(plain.clone()), darkest(&footage.frames)]
        .into_iter()
        .flatten()
        .find_map(|basis| {
            let model = Model::new(footage.rows, settings.train, basis);
            let shape = search_some(&model, &searches, footage, settings)?;
            // The darkest frames may contain flashes: as strict as with a smooth curve.
            let reference = Reference::Polynomial;
            Some(Sighting::new(model, shape, reference, footage, settings))
        })
}

/// Scene from the darkest frames, which are the likeliest without flashes.
fn darkest(frames: &[StoredFrame]) -> Option<Basis> {
    let level = |frame: &StoredFrame| frame.rows.iter().map(|&v| f64::from(v)).sum::<f64>();
    let levels: Vec<f64> = frames.iter().map(level).collect();
    let limit = quantile(&levels, 0.1).filter(|_| frames.len() >= 4)?;
    let dark = frames.iter().zip(&levels).filter(|(_, l)| **l <= limit);
    let dark = mean_of(dark.map(|(frame, _)| frame.rows.as_slice()));
    Some(with_reference(&dark))
}

/// Finds a train in some frames of different structure.
fn search_some(
    model: &Model,
    searches: &[WideSearch],
    footage: &Footage,
    settings: &Settings,
) -> Option<Shape> {
    let mut order: Vec<(f64, &StoredFrame)> = footage
        .frames
        .par_iter()
        .map(|frame| (model.detrend(&frame.rows).norm_squared(), frame))
        .collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0));
    let last = order.len().saturating_sub(1) as f64;
    let mut ranks = [0.0, 0.1, 0.3, 0.5, 0.75]
        .map(|r| (r * last) as usize)
        .to_vec();
    ranks.dedup();
    // A smooth curve with as many parameters as a train.
    let competitor = Basis::spanning(&side_by_side(
        model.smooth.columns(),
        &polynomial_columns(footage.rows.len, COMPETITOR_DEGREE),
    ));
    let frames = ranks.iter().filter_map(|&rank| order.get(rank));
    let frames: Vec<_> = frames
        .map(|(_, frame)| model.detrend(&frame.rows))
        .collect();
    // The first is usually enough.
    let (first, others) = frames.split_at(frames.len().min(1));
    searches.iter().find_map(|wide| {
        [first, others].into_iter().find_map(|frames| {
            let found = wide.run(model.rows, &settings.train, frames, &model.smooth);
            frames.iter().zip(&found).find_map(|(y, found)| {
                let mut bent = y.clone();
                competitor.remove_from(&mut bent);
                best_train(model, y, found, bent.norm_squared(), settings)
            })
        })
    })
}

/// Searches in the order of their attempts: near known or earlier values, then everywhere.
fn searches(footage: &Footage, settings: &Settings) -> Vec<WideSearch> {
    let rows = footage.reducer.sensor_rows();
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

/// Fits the shapes that a search found in one frame; returns the best that is a train.
fn best_train(
    model: &Model,
    y: &DVector<f64>,
    found: &[Found],
    smooth_rss: f64,
    settings: &Settings,
) -> Option<Shape> {
    let frame = std::slice::from_ref(y);
    found
        .iter()
        .filter_map(|found| {
            let start = &found.shape;
            let shape = model
                .fit_joint(frame, &[start.bias_us], start, &priors(settings))
                .shape();
            let fit = model.fit_frame(y, &shape);
            let sharp = fit.rss <= (1.0 - SHARPER) * smooth_rss;
            (sharp && fit.is_train(PLAIN_SHARE)).then_some((fit.share, shape))
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, shape)| shape)
}
