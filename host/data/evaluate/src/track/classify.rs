//! Classification of frames with flashes, without, and with other light; and the scene
//! without flashes.

use nalgebra::{DMatrix, DVector, Vector4};
use rayon::prelude::*;
use serde::Serialize;

use crate::footage::Footage;
use crate::footage::store::StoredFrame;
use crate::stats::{mean, median, quantile};
use crate::train::fit::{FrameFit, Model};
use crate::train::linear::{Basis, polynomial_columns, side_by_side};
use crate::train::{Shape, TrainGeometry, row_light};

/// Degree of the polynomial that may change against the reference.
const REFERENCE_DEGREE: usize = 3;
/// Significance below which a frame has no flashes.
const UNSEEN: f64 = 5.0;
/// Neighbouring rows whose mean distinguishes a part of a flash from noise.
const DARK_ROWS_TOGETHER: usize = 8;
/// Frames in which a row must be dark to be its own reference.
const DARK_ROWS: u32 = 4;

/// Steps in which the middle of many points is found.
const CENTRE_STEPS: usize = 30;

/// Class of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FrameClass {
    /// Has flashes, used.
    Used,
    /// Has flashes, not among the chosen frames.
    Spare,
    /// No flashes.
    Dark,
    /// Neither clearly with nor clearly without flashes.
    Unclear,
    /// Has another room light than the other frames.
    Flicker,
}

/// Counts of the frames of each class.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    /// Frames read.
    pub read: usize,
    /// Frames examined (fewer than read in long recordings).
    pub examined: usize,
    /// Frames with flashes that were used.
    pub used: usize,
    /// Frames with flashes that were not needed.
    pub spare: usize,
    /// Frames without flashes.
    pub without_flashes: usize,
    /// Frames that are neither clearly with nor clearly without flashes.
    pub unclear: usize,
    /// Frames left out because the room light changes.
    pub flicker: usize,
}

/// Source of the scene's brightness without flashes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reference {
    /// Mean of this number of frames without flashes.
    DarkFrames(usize),
    /// Mean of each row over the frames in which it saw no flash.
    DarkRows,
    /// A smooth curve in each frame.
    Polynomial,
}

impl FrameCounts {
    /// Counts the classes of the examined frames; `read` is the number of all frames.
    pub(crate) fn count(seen: &[Seen], read: usize) -> Self {
        let count = |class| seen.iter().filter(|s| s.class == class).count();
        Self {
            read,
            examined: seen.len(),
            used: count(FrameClass::Used),
            spare: count(FrameClass::Spare),
            without_flashes: count(FrameClass::Dark),
            unclear: count(FrameClass::Unclear),
            flicker: count(FrameClass::Flicker),
        }
    }
}

/// A frame's first fit, and its class.
#[derive(Debug, Clone)]
pub(crate) struct Seen {
    pub(crate) fit: FrameFit,
    pub(crate) class: FrameClass,
}

/// Returns the basis of the reference and of the polynomials that may change against it.
pub(crate) fn with_reference(reference: &[f64]) -> Basis {
    let rows = reference.len();
    let reference = DMatrix::from_column_slice(rows, 1, reference);
    Basis::spanning(&side_by_side(
        &polynomial_columns(rows, REFERENCE_DEGREE),
        &reference,
    ))
}

/// Returns the mean of rows of equal length.
pub(crate) fn mean_of<'a, T: Copy + Into<f64> + 'a>(
    rows: impl Iterator<Item = &'a [T]>,
) -> Vec<f64> {
    let mut sum: Vec<f64> = Vec::new();
    let mut count = 0.0;
    for row in rows {
        sum.resize(row.len(), 0.0);
        for (s, &v) in sum.iter_mut().zip(row) {
            *s += v.into();
        }
        count += 1.0;
    }
    sum.iter_mut().for_each(|s| *s /= count);
    sum
}

/// Classifies frames; a train must explain at least `share` of a frame.
pub(crate) fn classify(seen: &mut [Seen], share: f64) {
    let amplitudes: Vec<f64> = seen
        .iter()
        .filter(|s| s.fit.is_train(share))
        .map(|s| s.fit.amplitude)
        .collect();
    let typical = quantile(&amplitudes, 0.9).unwrap_or(0.0);
    for s in seen {
        s.class = if s.fit.is_train(share) && s.fit.amplitude >= 0.3 * typical {
            FrameClass::Used
        } else if s.fit.significance < UNSEEN || s.fit.amplitude < 0.1 * typical {
            FrameClass::Dark
        } else {
            FrameClass::Unclear
        };
    }
}

/// Returns the frames of one class, with their fits.
pub(crate) fn frames_of<'a>(
    footage: &'a Footage,
    seen: &'a [Seen],
    class: FrameClass,
) -> impl Iterator<Item = (&'a StoredFrame, &'a Seen)> {
    let frames = footage.frames.iter().zip(seen);
    frames.filter(move |(_, s)| s.class == class)
}

/// Reclassifies dark frames as unclear if they have light in rows that are dark in
/// the frames with flashes: the train's end has just entered the picture. One such
/// frame would put its flash into the scene of all.
pub(crate) fn recheck_dark(
    footage: &Footage,
    seen: &mut [Seen],
    shape: &Shape,
    train: &TrainGeometry,
) {
    let unlit = unlit_rows(footage, seen, shape, train);
    let (rows, scene): (Vec<usize>, Vec<f64>) = unlit
        .iter()
        .enumerate()
        .filter_map(|(row, value)| Some((row, (*value)?)))
        .unzip();
    // The scene's brightness and a constant (automatic exposure) are free.
    let ones = DMatrix::repeat(scene.len(), 1, 1.0);
    let scene = DMatrix::from_vec(scene.len(), 1, scene);
    let free = Basis::spanning(&side_by_side(&ones, &scene));
    let allowed = light_allowed(seen);
    for (frame, s) in footage.frames.iter().zip(seen) {
        if s.class != FrameClass::Dark {
            continue;
        }
        let mut rest = DVector::from_iterator(
            rows.len(),
            rows.iter()
                .map(|&row| frame.rows.get(row).map_or(0.0, |&v| v.into())),
        );
        free.remove_from(&mut rest);
        // Part of a flash is many rows high; noise is not.
        let mut together = rest.as_slice().chunks(DARK_ROWS_TOGETHER);
        if together.any(|some| mean(some).abs() > allowed) {
            s.class = FrameClass::Unclear;
        }
    }
}

/// Largest difference of the room light from frame to frame, grey levels.
fn light_allowed(seen: &[Seen]) -> f64 {
    let used = seen.iter().filter(|s| s.class == FrameClass::Used);
    let amplitudes: Vec<f64> = used.map(|s| s.fit.amplitude).collect();
    0.5 + 0.06 * median(&amplitudes)
}

/// Returns the scene from frames without flashes, or each row from the frames in
/// which it saw no flash, if every row has enough of those.
pub(crate) fn dark_scene(
    footage: &Footage,
    seen: &[Seen],
    shape: &Shape,
    train: &TrainGeometry,
) -> Option<(Basis, Reference)> {
    let dark: Vec<&[f32]> = frames_of(footage, seen, FrameClass::Dark)
        .map(|(frame, _)| frame.rows.as_slice())
        .collect();
    if !dark.is_empty() {
        let reference = mean_of(dark.iter().copied());
        return Some((
            with_reference(&reference),
            Reference::DarkFrames(dark.len()),
        ));
    }
    let rows: Option<Vec<f64>> = unlit_rows(footage, seen, shape, train)
        .into_iter()
        .collect();
    Some((with_reference(&rows?), Reference::DarkRows))
}

/// Returns each row's mean brightness over the frames in which it saw no flash, if there are
/// enough of them.
fn unlit_rows(
    footage: &Footage,
    seen: &[Seen],
    shape: &Shape,
    train: &TrainGeometry,
) -> Vec<Option<f64>> {
    let mut sums = vec![(0.0, 0u32); footage.rows.len];
    // A margin of one flash for the error of the first fit.
    let wide = Shape {
        exposure_us: shape.exposure_us + train.duration_us,
        ..*shape
    };
    for (frame, s) in frames_of(footage, seen, FrameClass::Used) {
        let shape = wide.at(s.fit.bias_us);
        for (i, ((sum, count), value)) in sums.iter_mut().zip(&frame.rows).enumerate() {
            if row_light(train, &shape, footage.rows.position(i)).value <= 0.0 {
                *sum += f64::from(*value);
                *count += 1;
            }
        }
    }
    sums.into_iter()
        .map(|(sum, count)| (count >= DARK_ROWS).then(|| sum / f64::from(count)))
        .collect()
}

/// Result of the search for frames with another room light.
pub(crate) struct Flicker {
    pub(crate) peak_to_peak: f64,
    pub(crate) note: String,
}

/// Marks frames whose smooth brightness has another form than the others'.
///
/// A change of the whole picture's brightness (automatic exposure) is not a change of
/// form. Flicker in step with the frame rate is the same in all frames and cannot
/// be distinguished from the scene; it is then part of the smooth part and does no harm.
pub(crate) fn mark_flicker(
    model: &Model,
    plain: &Basis,
    frames: &[StoredFrame],
    seen: &mut [Seen],
    shape: &Shape,
) -> Option<Flicker> {
    let forms = smooth_forms(model, plain, frames, seen, shape);
    // With each other, and not with the frames without flashes: where black is crushed or the tone curve
    // bends, flashes add something smooth to the picture, the same in each frame.
    let lit = forms.iter().zip(&*seen);
    let lit = lit.filter(|(_, s)| s.class == FrameClass::Used);
    let usual = centre(&lit.map(|(form, _)| form).collect::<Vec<_>>())?;
    let allowed = light_allowed(seen);
    // The constant, which is the first of the plain columns, and a multiple of the
    // usual form are free.
    let free = Basis::spanning(&DMatrix::from_fn(
        plain.columns().ncols(),
        2,
        |k, column| match column {
            0 => f64::from(k == 0),
            _ => usual.get(k).copied().unwrap_or(0.0),
        },
    ));
    let mut worst = Vec::new();
    for (mut change, s) in forms.into_iter().zip(seen.iter_mut()) {
        free.remove_from(&mut change);
        let curve = plain.curve(&change);
        let height = curve.max() - curve.min();
        if height > allowed && s.class == FrameClass::Used {
            worst.push(height);
            s.class = FrameClass::Flicker;
        }
    }
    if worst.is_empty() {
        return None;
    }
    let peak_to_peak = median(&worst);
    Some(Flicker {
        peak_to_peak,
        note: format!(
            "frames with flashes left out: {}; their room light differs from the other frames' by about {peak_to_peak:.1} grey levels (mains flicker, moving shadows)",
            worst.len()
        ),
    })
}

/// Returns the point from which the sum of the distances to some points is least (Weiszfeld's iteration):
/// a few of them elsewhere hardly move it, and it lies in the middle of a flicker's phases, which are spread
/// evenly over the mains' period.
fn centre(points: &[&DVector<f64>]) -> Option<DVector<f64>> {
    let mut centre = (*points.first()?).clone();
    centre.fill(0.0);
    let mut weights = vec![1.0; points.len()];
    for _ in 0..CENTRE_STEPS {
        let total: f64 = weights.iter().sum();
        centre.fill(0.0);
        for (point, weight) in points.iter().zip(&weights) {
            centre.axpy(weight / total, point, 1.0);
        }
        for (weight, point) in weights.iter_mut().zip(points) {
            *weight = 1.0 / (*point - &centre).norm().max(1e-6);
        }
    }
    Some(centre)
}

/// Returns the coefficients of each frame's smooth part, with the flashes subtracted.
fn smooth_forms(
    model: &Model,
    plain: &Basis,
    frames: &[StoredFrame],
    seen: &[Seen],
    shape: &Shape,
) -> Vec<DVector<f64>> {
    // The distribution of the light is the same in all frames. Fitted in each frame
    // separately, it would absorb a part of the smooth change when the exposure
    // is long. Only its strength is free.
    let lit = || seen.iter().filter(|s| s.class == FrameClass::Used);
    let usual_light = Vector4::from_fn(|k, _| {
        let values: Vec<f64> = lit().map(|s| s.fit.coefficients[k]).collect();
        median(&values)
    });
    frames
        .par_iter()
        .zip(seen)
        .map(|(frame, s)| {
            let rows = frame.rows.iter().map(|&v| f64::from(v));
            let mut rest = DVector::from_iterator(frame.rows.len(), rows);
            if s.class != FrameClass::Dark {
                let light = model.light(&shape.at(s.fit.bias_us), &usual_light);
                let mut bare = light.clone();
                plain.remove_from(&mut bare);
                let strength = bare.dot(&rest) / bare.norm_squared().max(1e-12);
                rest.axpy(-strength, &light, 1.0);
            }
            plain.coefficients(&rest)
        })
        .collect()
}
