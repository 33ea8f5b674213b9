//! Frames with flashes, without, and with other light; and what the scene looks
//! like without flashes.

use rayon::prelude::*;
use serde::Serialize;

use super::Settings;
use super::fit::{FrameFit, Model};
use super::linear::{Basis, add_scaled, dot, polynomial_columns};
use super::recording::Recording;
use super::stats::{median, quantile};
use super::store::StoredFrame;
use super::train::{Shape, row_light};

/// Degree of what may change against the reference.
const REFERENCE_DEGREE: usize = 3;
/// Standard deviations from which a train counts as seen.
const SEEN: f64 = 8.0;
/// Below this nothing is there.
const UNSEEN: f64 = 5.0;
/// Neighbouring rows whose mean tells part of a flash from noise.
const DARK_ROWS_TOGETHER: usize = 8;
/// Frames in which a row must be dark to be its own reference.
const DARK_ROWS: u32 = 4;

/// What was done with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameClass {
    /// Flashes found, used.
    Used,
    /// Flashes found, not among those asked for.
    Spare,
    /// No flashes.
    Dark,
    /// Neither clearly with nor clearly without flashes.
    Unclear,
    /// Room light differs from that of the other frames.
    Flicker,
}

/// How many frames went where.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    /// Frames read.
    pub read: usize,
    /// Frames looked at (fewer than read in long recordings).
    pub examined: usize,
    /// With flashes and used.
    pub used: usize,
    /// With flashes, not needed.
    pub spare: usize,
    /// Without flashes.
    pub without_flashes: usize,
    /// Unclear.
    pub unclear: usize,
    /// Left out because the room light changes.
    pub flicker: usize,
}

/// What the smooth part of the brightness was taken from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reference {
    /// The mean of frames without flashes.
    DarkFrames(usize),
    /// Row by row, from frames in which the row saw no flash.
    DarkRows,
    /// A polynomial.
    Polynomial,
}

/// What is kept of a frame's first fit.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    pub(super) bias_us: f64,
    pub(super) significance: f64,
    pub(super) share: f64,
    pub(super) amplitude: f64,
    pub(super) coefficients: [f64; 4],
    pub(super) class: FrameClass,
}

impl Seen {
    /// Keeps what matters of a fit.
    pub(super) fn new(fit: &FrameFit) -> Self {
        Self {
            bias_us: fit.bias_us,
            significance: fit.significance,
            share: fit.share.min(fit.edge_share),
            amplitude: fit.amplitude,
            coefficients: fit.coefficients,
            class: FrameClass::Unclear,
        }
    }

    fn is_train(&self, share: f64) -> bool {
        self.significance >= SEEN && self.share >= share && self.amplitude > 0.0
    }
}

/// Whether a fit is a train of flashes that explains at least `share` of a frame.
pub(super) fn is_train(fit: &FrameFit, share: f64) -> bool {
    fit.significance >= SEEN && fit.share.min(fit.edge_share) >= share && fit.amplitude > 0.0
}

/// The reference, and what may change against it.
pub(super) fn with_reference(reference: Vec<f64>) -> Basis {
    let rows = reference.len();
    let mut columns = polynomial_columns(rows, REFERENCE_DEGREE);
    columns.push(reference);
    Basis::spanning(columns)
}

/// Mean of equally long rows.
pub(super) fn mean_of<'a, T: Copy + Into<f64> + 'a>(
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

/// Sorts frames; a train must explain at least `share` of a frame.
pub(super) fn classify(seen: &mut [Seen], share: f64) {
    let amplitudes: Vec<f64> = seen
        .iter()
        .filter(|s| s.is_train(share))
        .map(|s| s.amplitude)
        .collect();
    let typical = quantile(&amplitudes, 0.9).unwrap_or(0.0);
    for s in seen {
        s.class = if s.is_train(share) && s.amplitude >= 0.3 * typical {
            FrameClass::Used
        } else if s.significance < UNSEEN || s.amplitude < 0.1 * typical {
            FrameClass::Dark
        } else {
            FrameClass::Unclear
        };
    }
}

/// The mean of the frames without flashes.
pub(super) fn dark_frames(frames: &[StoredFrame], seen: &[Seen]) -> Option<(Basis, Reference)> {
    let dark: Vec<&[f32]> = frames
        .iter()
        .zip(seen)
        .filter(|(_, s)| s.class == FrameClass::Dark)
        .map(|(f, _)| f.rows.as_slice())
        .collect();
    if dark.is_empty() {
        return None;
    }
    let count = dark.len();
    Some((
        with_reference(mean_of(dark.into_iter())),
        Reference::DarkFrames(count),
    ))
}

/// Doubts frames that were taken for dark, but have light in rows that are dark in
/// the frames with flashes: the train's end has only entered the picture. One such
/// frame would put its flash into the scene of all.
pub(super) fn doubt_dark(
    recording: &Recording,
    frames: &[StoredFrame],
    seen: &mut [Seen],
    shape: &Shape,
    settings: &Settings,
) {
    let unlit = unlit_rows(recording, frames, seen, shape, settings);
    let (rows, scene): (Vec<usize>, Vec<f64>) = unlit
        .iter()
        .enumerate()
        .filter_map(|(row, value)| Some((row, (*value)?)))
        .unzip();
    // The scene's brightness and a constant (automatic exposure) are free.
    let free = Basis::spanning([vec![1.0; scene.len()], scene]);
    let allowed = light_allowed(seen);
    for (frame, s) in frames.iter().zip(seen) {
        if s.class != FrameClass::Dark {
            continue;
        }
        let mut rest: Vec<f64> = rows
            .iter()
            .filter_map(|&row| frame.rows.get(row).map(|&v| f64::from(v)))
            .collect();
        free.remove_from(&mut rest);
        // Part of a flash is many rows high; noise is not.
        let mean = |some: &[f64]| some.iter().sum::<f64>() / some.len() as f64;
        if rest
            .chunks(DARK_ROWS_TOGETHER)
            .any(|some| mean(some).abs() > allowed)
        {
            s.class = FrameClass::Unclear;
        }
    }
}

/// How far room light may differ from frame to frame, grey levels.
fn light_allowed(seen: &[Seen]) -> f64 {
    let amplitudes: Vec<f64> = seen
        .iter()
        .filter(|s| s.class == FrameClass::Used)
        .map(|s| s.amplitude)
        .collect();
    0.5 + 0.06 * median(&amplitudes)
}

/// Each row's brightness from the frames in which it saw no flash, when every
/// row has some.
pub(super) fn dark_rows(
    recording: &Recording,
    frames: &[StoredFrame],
    seen: &[Seen],
    shape: &Shape,
    settings: &Settings,
) -> Option<(Basis, Reference)> {
    let rows: Option<Vec<f64>> = unlit_rows(recording, frames, seen, shape, settings)
        .into_iter()
        .collect();
    Some((with_reference(rows?), Reference::DarkRows))
}

/// Each row's mean brightness over the frames in which the row saw no flash, where
/// there are enough of them.
fn unlit_rows(
    recording: &Recording,
    frames: &[StoredFrame],
    seen: &[Seen],
    shape: &Shape,
    settings: &Settings,
) -> Vec<Option<f64>> {
    let n = recording.rows.len;
    let mut sum = vec![0.0; n];
    let mut count = vec![0u32; n];
    // A margin of one flash for what the first fit does not know well.
    let wide = Shape {
        exposure_us: shape.exposure_us + settings.train.duration_us,
        ..*shape
    };
    for (frame, s) in frames.iter().zip(seen) {
        if s.class != FrameClass::Used {
            continue;
        }
        let shape = Shape {
            bias_us: s.bias_us,
            ..wide
        };
        for (i, ((sum, count), value)) in
            sum.iter_mut().zip(&mut count).zip(&frame.rows).enumerate()
        {
            let light = row_light(&settings.train, &shape, recording.rows.position(i));
            if light.value <= 0.0 {
                *sum += f64::from(*value);
                *count += 1;
            }
        }
    }
    sum.iter()
        .zip(&count)
        .map(|(s, &c)| (c >= DARK_ROWS).then(|| s / f64::from(c)))
        .collect()
}

/// Frames whose room light is not that of the others.
pub(super) struct Flicker {
    pub(super) peak_to_peak: f64,
    pub(super) note: String,
}

/// Marks frames whose smooth brightness has another form than the others'.
///
/// A change of the whole picture's brightness (automatic exposure) is no change of
/// form. Flicker in step with the frame rate is the same in all frames and cannot
/// be told from the scene; it is then part of the smooth part and does no harm.
pub(super) fn mark_flicker(
    model: &Model,
    plain: &Basis,
    frames: &[StoredFrame],
    seen: &mut [Seen],
    shape: &Shape,
    keep: bool,
) -> Option<Flicker> {
    // How the light is distributed is the same in all frames; fitted in each frame
    // on its own it would take a part of the smooth change along when the exposure
    // is long. Only its strength is left free.
    let mut usual_light = [0.0; 4];
    let lit: Vec<&Seen> = seen
        .iter()
        .filter(|s| s.class == FrameClass::Used)
        .collect();
    for (k, sum) in usual_light.iter_mut().enumerate() {
        let values: Vec<f64> = lit
            .iter()
            .filter_map(|s| s.coefficients.get(k).copied())
            .collect();
        *sum = median(&values);
    }
    // Coefficients of each frame's smooth part, flashes taken off.
    let forms: Vec<Vec<f64>> = frames
        .par_iter()
        .zip(&*seen)
        .map(|(frame, s)| {
            let mut rest: Vec<f64> = frame.rows.iter().map(|&v| f64::from(v)).collect();
            if s.class != FrameClass::Dark {
                let place = Shape {
                    bias_us: s.bias_us,
                    ..*shape
                };
                let light = model.light(&place, &usual_light);
                let mut bare = light.clone();
                plain.remove_from(&mut bare);
                let strength = dot(&bare, &rest) / dot(&bare, &bare).max(1e-12);
                add_scaled(&mut rest, -strength, &light);
            }
            plain.coefficients(&rest)
        })
        .collect();
    // What to compare with: frames without flashes, if there are any.
    let dark = seen.iter().filter(|s| s.class == FrameClass::Dark).count();
    let compared = |class: FrameClass| {
        if dark >= 3 {
            class == FrameClass::Dark
        } else {
            class == FrameClass::Used
        }
    };
    // The median: a few frames in which a flash was missed must not make all others
    // look wrong.
    let usual: Vec<f64> = (0..plain.columns().len())
        .map(|k| {
            let values: Vec<f64> = forms
                .iter()
                .zip(&*seen)
                .filter(|(_, s)| compared(s.class))
                .filter_map(|(form, _)| form.get(k).copied())
                .collect();
            median(&values)
        })
        .collect();
    let allowed = light_allowed(seen);
    // The constant and a multiple of the usual form are free.
    let free = Basis::spanning([
        {
            let mut constant = vec![0.0; usual.len()];
            if let Some(first) = constant.first_mut() {
                *first = 1.0;
            }
            constant
        },
        usual,
    ]);
    let mut worst = Vec::new();
    let mut marked = 0;
    for (form, s) in forms.iter().zip(seen.iter_mut()) {
        let mut change = form.clone();
        free.remove_from(&mut change);
        let curve = plain.curve(&change);
        let high = curve.iter().copied().fold(f64::MIN, f64::max);
        let low = curve.iter().copied().fold(f64::MAX, f64::min);
        if high - low > allowed && s.class == FrameClass::Used {
            worst.push(high - low);
            marked += 1;
            if !keep {
                s.class = FrameClass::Flicker;
            }
        }
    }
    if marked == 0 {
        return None;
    }
    let peak_to_peak = median(&worst);
    let done = if keep {
        "used all the same"
    } else {
        "left out"
    };
    Some(Flicker {
        peak_to_peak,
        note: format!(
            "{marked} frames with flashes {done}: their room light differs from the other frames' by about {peak_to_peak:.1} grey levels (mains flicker, moving shadows)"
        ),
    })
}
