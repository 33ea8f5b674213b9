//! Evidence that the bands of a recording are the depth camera's flashes.
//!
//! A lamp that is dimmed by switching, bars of a picture and flashes look alike to a
//! rolling shutter when the row time is unknown. The trigger distinguishes them: flashes are
//! missing in frames without a pulse, and they move with the trigger. Bands that show neither
//! give no result. A train that begins and ends in view is not evidence, because bars of a
//! picture do so too.

use serde::Serialize;

use crate::footage::Footage;
use crate::stats::{Line, mean};
use crate::track::BEGINNING_S;
use crate::track::classify::{FrameClass, FrameCounts, Seen, frames_of, mean_of};
use crate::track::lamp;
use crate::train::Shape;
use crate::train::fit::{FrameFit, Model};
use crate::{EvaluateError, Settings};

/// Frames that must show the evidence.
const FRAMES: usize = 3;
/// Least difference in brightness of frames with and without flashes, as a share of the flashes'
/// light.
const LIGHT: f64 = 0.5;
/// Largest distance of the fitted row time from a known one, as a share. A lamp dimmed at
/// 630 Hz, which stands still at 30 frames per second, is 0.8 % off.
const ROW_TIME_AGREES: f64 = 0.005;
/// Consecutive frames that show a train at rest.
const REST: usize = 16;
/// Least motion of a train before it rests, or between two recordings, as a part of a pitch.
pub(crate) const MOVED: f64 = 0.1;
/// Fastest motion due to two crystals, or to a trigger that is slowly aligned to the frames,
/// µs/s.
const FASTEST_US_PER_S: f64 = 1000.0;
/// Fastest motion after the alignment, due to two crystals, µs/s.
const STEADY_US_PER_S: f64 = 100.0;
/// Scatter about even motion, as a part of the pitch.
const UNEVEN: f64 = 0.03;

/// Evidence that the bands are the depth camera's flashes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Evidence {
    /// This number of frames shows no bands.
    FramesWithout(usize),
    /// The spacing of the bands agrees with a known row time.
    RowTime,
    /// The bands moved in this number of frames and then came to rest, as the session aligned the
    /// trigger.
    Aligned(usize),
    /// The bands moved with the trigger from one recording to another.
    Shift,
}

/// Searches all frames of a recording for evidence.
pub(crate) fn find(
    footage: &Footage,
    model: &Model,
    seen: &[Seen],
    shape: &Shape,
    settings: &Settings,
) -> Option<Evidence> {
    let counts = FrameCounts::count(seen, footage.frames.len());
    if are_distinct(&counts) && adds_light(footage, seen) {
        return Some(Evidence::FramesWithout(counts.without_flashes));
    }
    let known = settings.row_time_us.or(settings.row_time_hint_us);
    if known.is_some_and(|known| (shape.row_time_us / known - 1.0).abs() < ROW_TIME_AGREES) {
        return Some(Evidence::RowTime);
    }
    aligned(footage, model, seen)
}

/// Returns true if enough frames are without flashes, and those with flashes are more than the
/// unclear ones: flashes are present or absent, but motion in the picture is gradual.
fn are_distinct(counts: &FrameCounts) -> bool {
    counts.without_flashes >= FRAMES && counts.unclear < counts.used
}

/// Returns true if the frames with flashes are brighter than those without by about the light of
/// the flashes: motion in the picture adds no light.
fn adds_light(footage: &Footage, seen: &[Seen]) -> bool {
    let level = |class| {
        let frames = frames_of(footage, seen, class);
        mean(&mean_of(frames.map(|(frame, _)| frame.rows.as_slice())))
    };
    let lit = frames_of(footage, seen, FrameClass::Used);
    // An exposure longer by a pitch fits equally well, with one more flash in every row.
    let least = |fit: &FrameFit| fit.mean_light.rem_euclid(fit.amplitude.max(1e-9));
    let light: Vec<f64> = lit.map(|(_, s)| least(&s.fit)).collect();
    level(FrameClass::Used) - level(FrameClass::Dark) > LIGHT * mean(&light)
}

/// Finds bands that came to rest, in the video of a session that aligned the trigger. Before,
/// they must have been where their motion at rest, continued backwards, does not lead: the bands
/// of a lamp move evenly all the time.
///
/// Only the beginning is looked at: over minutes a line through half a second leads anywhere.
fn aligned(footage: &Footage, model: &Model, seen: &[Seen]) -> Option<Evidence> {
    footage.applied?;
    let places: Vec<(f64, f64)> = footage
        .frames
        .iter()
        .zip(seen)
        .take_while(|(frame, _)| frame.time_s <= BEGINNING_S)
        .filter(|(_, s)| s.class != FrameClass::Dark && s.fit.is_train(0.5))
        .map(|(frame, s)| (frame.time_s, s.fit.bias_us))
        .collect();
    let pitch = model.train.pitch_us;
    let at_rest = |some: &[(f64, f64)]| {
        let (_, first) = *some.first()?;
        let near = |&(time, place)| (time, first + off_pitch(place - first, pitch));
        let some: Vec<(f64, f64)> = some.iter().map(near).collect();
        let line = Line::fit(&some, 1).filter(|_| some.len() >= REST / 2)?;
        let rests = line.slope.abs() <= STEADY_US_PER_S && line.residual_sd <= UNEVEN * pitch;
        rests.then_some((line, some))
    };
    let (rest, some) = places.rchunks(REST).find_map(at_rest)?;
    let (since, _) = *some.first()?;
    let is_elsewhere = |&&(time, place): &&(f64, f64)| {
        let doubt = 4.0 * rest.slope_sigma * (since - time);
        time < since && off_pitch(place - rest.at(time), pitch).abs() > MOVED * pitch + doubt
    };
    let elsewhere = places.iter().filter(is_elsewhere).count();
    (elsewhere >= FRAMES).then_some(Evidence::Aligned(elsewhere))
}

/// Returns the part of a motion that is not whole pitches, µs.
pub(crate) fn off_pitch(moved_us: f64, pitch_us: f64) -> f64 {
    moved_us - (moved_us / pitch_us).round() * pitch_us
}

/// Refuses bands that do not move like those of a depth camera in step; `line` is their position
/// in µs over seconds.
pub(crate) fn in_step(
    line: &Line,
    footage: &Footage,
    settings: &Settings,
) -> Result<(), EvaluateError> {
    let even = line.residual_sd <= UNEVEN * settings.train.pitch_us;
    if even && line.slope.abs() <= FASTEST_US_PER_S {
        return Ok(());
    }
    Err(EvaluateError::NotInStep {
        path: footage.path.clone(),
        motion_us_per_s: line.slope,
        scatter_us: line.residual_sd,
        lamp: lamp::note(footage, settings),
    })
}

/// Returns the error for a recording without evidence.
pub(crate) fn doubt(
    evidence: Option<Evidence>,
    footage: &Footage,
    settings: &Settings,
) -> Option<EvaluateError> {
    evidence.is_none().then(|| EvaluateError::Unproven {
        path: footage.path.clone(),
        lamp: lamp::note(footage, settings),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two counts from ffmpeg's moving colours, and one with flashes.
    #[test]
    fn frames_without_flashes_are_no_evidence_if_most_are_unclear() {
        for (used, without_flashes, unclear, distinct) in
            [(7, 14, 19, false), (2, 26, 12, false), (16, 4, 0, true)]
        {
            let counts = FrameCounts {
                used,
                without_flashes,
                unclear,
                ..FrameCounts::default()
            };
            assert_eq!(are_distinct(&counts), distinct, "{counts:?}");
        }
    }
}
