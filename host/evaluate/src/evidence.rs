//! Evidence that the bands of a recording are the depth camera's flashes.
//!
//! A lamp that is dimmed by switching it, bars of a picture and flashes look alike to a
//! rolling shutter when the row time is not known. The trigger tells them apart: flashes are
//! missing in frames without a pulse, the train ends where the camera's exposure does,
//! and it moves with the trigger. What shows nothing of this gives no figure.

use rayon::prelude::*;
use serde::Serialize;

use super::classify::{FrameClass, Seen, frames_of, mean_of};
use super::fit::{FrameFit, Model};
use super::footage::Footage;
use super::stats::{Line, mean, spread};
use super::store::StoredFrame;
use super::track::{Choice, Track, track};
use super::train::{Shape, TrainGeometry};
use super::{EvaluateError, Settings, lamp};

/// Frames that must show the evidence.
const FRAMES: usize = 3;
/// Share of the flashes' light that frames with flashes must be brighter.
const LIGHT: f64 = 0.5;
/// Frames in which the train's ends are looked for.
const SEARCHED: usize = 200;
/// Flashes that are thought beyond each end of the train.
const BEYOND: u32 = 2;
/// By how much more must be left of a frame, as a factor, if the train went on or had a
/// flash less.
const DECIDED: f64 = 1.5;
/// Largest distance of the fitted row time from a known one, as a share.
const ROW_TIME_AGREES: f64 = 0.015;
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
    /// They begin and end with the train, in so many frames.
    Ends(usize),
    /// One end of the train was in so many frames while it was sent onto the phone's.
    EndMoved(usize),
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
    let without = seen.iter().filter(|s| s.class == FrameClass::Dark).count();
    if without >= FRAMES && adds_light(footage, seen) {
        return Some(Evidence::FramesWithout(without));
    }
    let known = settings.row_time_us.or(settings.row_time_hint_us);
    if known.is_some_and(|known| (shape.row_time_us / known - 1.0).abs() < ROW_TIME_AGREES) {
        return Some(Evidence::RowTime);
    }
    ends(footage, model, seen, shape).or_else(|| aligned(footage, model, seen))
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

/// Ends in view: both in the same frames, or one that has moved. One that stands still
/// may be the edge of a picture.
fn ends(footage: &Footage, model: &Model, seen: &[Seen], shape: &Shape) -> Option<Evidence> {
    let train = model.train;
    // One flash less, or some more, at one end or the other.
    let changed = |more: i32, at_end: bool| {
        let count = train.count.saturating_add_signed(more).max(1);
        let moved = 0.5 * f64::from(more) * train.pitch_us;
        let train = TrainGeometry { count, ..train };
        let other = Model::new(model.rows, train, model.smooth.clone());
        (other, if at_end { moved } else { -moved })
    };
    let longer = [false, true].map(|at_end| changed(BEYOND as i32, at_end));
    let shorter = [false, true].map(|at_end| changed(-1, at_end));
    let lit: Vec<(&StoredFrame, &FrameFit)> = footage
        .frames
        .iter()
        .zip(seen)
        .filter(|(_, s)| s.class != FrameClass::Dark && s.fit.is_train(0.2))
        .map(|(frame, s)| (frame, &s.fit))
        .collect();
    let found: Vec<(f64, [bool; 2])> = spread(lit.len(), SEARCHED)
        .par_iter()
        .filter_map(|&place| {
            let &(frame, fit) = lit.get(place)?;
            let y = model.detrend(&frame.rows);
            let is_worse = |(other, moved): &(Model, f64)| {
                let rss = other.local(&y, &shape.at(fit.bias_us + moved)).rss;
                rss > DECIDED * fit.rss
            };
            let shows = [0, 1].map(|end| is_worse(&longer[end]) && is_worse(&shorter[end]));
            (shows != [false; 2]).then_some((fit.bias_us, shows))
        })
        .collect();
    let both = found
        .iter()
        .filter(|(_, shows)| *shows == [true; 2])
        .count();
    let places = || found.iter().map(|(bias, _)| *bias);
    let moved = places().fold(f64::MIN, f64::max) - places().fold(f64::MAX, f64::min);
    if both >= FRAMES {
        return Some(Evidence::Ends(both));
    }
    let one = found.len() >= FRAMES && moved > MOVED * train.pitch_us;
    one.then_some(Evidence::EndMoved(found.len()))
}

/// Bands that came from elsewhere, in the video of a session that aligned the trigger.
/// That they are at rest since, [`in_step`] says: what wanders has this too.
fn aligned(footage: &Footage, model: &Model, seen: &[Seen]) -> Option<Evidence> {
    footage.applied?;
    let places: Vec<f64> = seen
        .iter()
        .filter(|s| s.class != FrameClass::Dark && s.fit.is_train(0.5))
        .map(|s| s.fit.bias_us)
        .collect();
    let pitch = model.train.pitch_us;
    let last = *places.last()?;
    let is_elsewhere = |place: &&f64| {
        let pitches = (**place - last) / pitch;
        (pitches - pitches.round()).abs() > MOVED
    };
    let elsewhere = places.iter().filter(is_elsewhere).count();
    (elsewhere >= FRAMES).then_some(Evidence::Aligned(elsewhere))
}

/// Refuses bands that move as no depth camera in step does: `line` is their place, µs, over
/// seconds.
pub(crate) fn in_step(
    line: &Line,
    evidence: Option<Evidence>,
    footage: &Footage,
    settings: &Settings,
) -> Result<(), EvaluateError> {
    let even = line.residual_sd <= UNEVEN * settings.train.pitch_us;
    let fastest = match evidence {
        // Bars that wander through the picture have ends too, but do not come to rest.
        Some(Evidence::EndMoved(_) | Evidence::Aligned(_)) => STEADY_US_PER_S,
        _ => FASTEST_US_PER_S,
    };
    if even && line.slope.abs() <= fastest {
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
