//! Evidence that the bands of a recording are the depth camera's flashes.
//!
//! A lamp that is dimmed by switching it, bars of a picture and flashes look alike to a
//! rolling shutter when the row time is not known. The trigger tells them apart: flashes are
//! missing in frames without a pulse, and they move with the trigger. What shows nothing of
//! this gives no figure. That a train begins and ends in view shows nothing: so do the bars
//! of a picture.

use serde::Serialize;

use super::classify::{FrameClass, FrameCounts, Seen, frames_of, mean_of};
use super::fit::{FrameFit, Model};
use super::footage::Footage;
use super::stats::{Line, mean};
use super::track::{Choice, Track, track};
use super::train::Shape;
use super::{EvaluateError, Settings, lamp};

/// Frames that must show the evidence.
const FRAMES: usize = 3;
/// Share of the flashes' light that frames with flashes must be brighter.
const LIGHT: f64 = 0.5;
/// Largest distance of the fitted row time from a known one, as a share. A lamp dimmed at
/// 630 Hz, which stands still at 30 frames per second, is 0.8 % off.
const ROW_TIME_AGREES: f64 = 0.005;
/// Frames, one after the other, that show a train at rest.
const REST: usize = 16;
/// Part of a pitch by which a train must have moved, or be moved by the second recording.
pub(crate) const MOVED: f64 = 0.1;
/// The trigger is aligned in the first so many seconds.
const BEGINNING_S: f64 = 60.0;
/// Motion that two crystals, or a trigger that is sent slowly onto the frames, make at
/// most: µs/s.
const FASTEST_US_PER_S: f64 = 1000.0;
/// The same after the train has arrived there: two crystals.
const STEADY_US_PER_S: f64 = 100.0;
/// Scatter about even motion, as a part of the pitch.
const UNEVEN: f64 = 0.03;

/// What shows that the bands are the depth camera's flashes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Evidence {
    /// So many frames show no band.
    FramesWithout(usize),
    /// Their spacing agrees with a row time that was known before.
    RowTime,
    /// They came to rest from elsewhere in so many frames, as the session aligned the trigger.
    Aligned(usize),
    /// They moved with the trigger from one recording to another.
    Shift,
}

/// Looks for evidence in all frames of a recording.
pub(crate) fn find(
    footage: &Footage,
    model: &Model,
    seen: &[Seen],
    shape: &Shape,
    settings: &Settings,
) -> Option<Evidence> {
    let counts = FrameCounts::of(seen, footage.frames.len());
    if tell_apart(&counts) && adds_light(footage, seen) {
        return Some(Evidence::FramesWithout(counts.without_flashes));
    }
    let known = settings.row_time_us.or(settings.row_time_hint_us);
    if known.is_some_and(|known| (shape.row_time_us / known - 1.0).abs() < ROW_TIME_AGREES) {
        return Some(Evidence::RowTime);
    }
    aligned(footage, model, seen)
}

/// True if enough frames are without flashes, and those with flashes are more than those that
/// are neither: flashes are there or they are not, what moves in the picture is there by degrees.
fn tell_apart(counts: &FrameCounts) -> bool {
    counts.without_flashes >= FRAMES && counts.unclear < counts.used
}

/// True if the frames with flashes are brighter than those without, by about the light of
/// the flashes: what only moves in the picture adds none.
fn adds_light(footage: &Footage, seen: &[Seen]) -> bool {
    let level = |class| {
        let frames = frames_of(footage, seen, class);
        mean(&mean_of(frames.map(|(frame, _)| frame.rows.as_slice())))
    };
    let lit = frames_of(footage, seen, FrameClass::Used);
    // An exposure longer by a pitch fits as well, with a whole flash more in every row.
    let least = |fit: &FrameFit| fit.mean_light.rem_euclid(fit.amplitude.max(1e-9));
    let light: Vec<f64> = lit.map(|(_, s)| least(&s.fit)).collect();
    level(FrameClass::Used) - level(FrameClass::Dark) > LIGHT * mean(&light)
}

/// Bands that came from elsewhere to rest, in the video of a session that aligned the trigger:
/// from where the even motion that they have at rest does not come, as a lamp's would.
fn aligned(footage: &Footage, model: &Model, seen: &[Seen]) -> Option<Evidence> {
    footage.applied?;
    let places: Vec<(f64, f64)> = footage
        .frames
        .iter()
        .zip(seen)
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

/// What a move is beside whole pitches, µs.
pub(crate) fn off_pitch(moved_us: f64, pitch_us: f64) -> f64 {
    moved_us - (moved_us / pitch_us).round() * pitch_us
}

/// Refuses bands that move as no depth camera in step does: `line` is their place, µs, over
/// seconds.
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

/// Evidence in a recording, or in its beginning if only a later part is used.
pub(crate) fn of(track: &Track, footage: &Footage, settings: &Settings) -> Option<Evidence> {
    track.evidence.or_else(|| before(footage, settings))
}

fn before(footage: &Footage, settings: &Settings) -> Option<Evidence> {
    let from_s = settings.from_s?;
    let settings = Settings {
        from_s: None,
        to_s: Some((from_s + 2.0).min(BEGINNING_S)),
        ..settings.clone()
    };
    let mut beginning = Footage::read(&footage.path, &settings, None).ok()?;
    beginning.applied = footage.applied;
    track(&beginning, &settings, Choice::All).ok()?.evidence
}

/// The refusal of a recording without evidence.
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

    /// Two as ffmpeg's wandering colours gave them, and one of flashes.
    #[test]
    fn frames_without_are_no_evidence_where_most_are_neither() {
        for (used, without_flashes, unclear, told) in
            [(7, 14, 19, false), (2, 26, 12, false), (16, 4, 0, true)]
        {
            let counts = FrameCounts {
                used,
                without_flashes,
                unclear,
                ..FrameCounts::default()
            };
            assert_eq!(tell_apart(&counts), told, "{counts:?}");
        }
    }
}
