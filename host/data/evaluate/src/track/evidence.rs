//! Evidence that the bands of a recording are the depth camera's flashes.
//!
//! A lamp that is dimmed by switching, bars of a picture and flashes look alike to a
//! rolling shutter when the row time is unknown: a lamp of another frequency looks like flashes at
//! another row time. A lamp may also be switched on, off or to another brightness during the video. So
//! frames without bands are no evidence alone. What distinguishes flashes is that their train ends, that
//! their distance is known in microseconds, and that they move with the trigger. Bands that show none of
//! these give no result, nor do bands that stand still while the trigger moves, or go on where a train
//! ends. A train that begins and ends in every frame is not evidence, because bars of a picture do so
//! too.

use nalgebra::DVector;
use serde::Serialize;

use crate::footage::Footage;
use crate::stats::{Line, evenly_spaced, mean, median};
use crate::track::BEGINNING_S;
use crate::track::classify::{FrameClass, FrameCounts, Seen, frames_of, mean_of};
use crate::track::identity::DECIDED;
use crate::track::lamp;
use crate::train::fit::{FrameFit, Model};
use crate::train::{Shape, TrainGeometry};
use crate::{EvaluateError, Settings};

/// Frames that must show the evidence.
const FRAMES: usize = 3;
/// Least difference in brightness of frames with and without flashes, as a share of the flashes'
/// light.
const LIGHT: f64 = 0.5;
/// Largest distance of the fitted row time from a known one, as a share. A lamp dimmed at
/// 630 Hz, which stands still at 30 frames per second, is 0.8 % off.
pub(crate) const ROW_TIME_AGREES: f64 = 0.005;
/// Frames in which the ends of the train are looked for, and the share of them that must agree. A lamp
/// that blinks shows an end in some frames.
const ENDS: usize = 16;
const AGREE: f64 = 0.8;
/// Flashes that must be in view where the train ends: one distance between two fits any row time.
const IN_VIEW: usize = 3;
/// Flashes before and after a train that goes on: more than any picture shows.
const GOES_ON: u32 = 26;
/// Last frames, of whose median the rest of the recording is compared with the trigger.
const REST: usize = 16;
/// Least motion of a train before it rests, or between two recordings, as a part of a pitch.
pub(crate) const MOVED: f64 = 0.1;
/// Fastest motion due to two crystals, or to a trigger that is slowly aligned to the frames,
/// µs/s.
const FASTEST_US_PER_S: f64 = 1000.0;
/// Scatter about even motion, and about the trigger's motion, as a part of the pitch.
const UNEVEN: f64 = 0.03;

/// Evidence that the bands are the depth camera's flashes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Evidence {
    /// The train ends in the picture, at the same place in frame after frame, and this number of
    /// frames shows no bands.
    Ends(usize),
    /// The spacing of the bands agrees with a known row time.
    RowTime,
    /// The bands moved as the board's pulses did, in this number of frames.
    Trigger(usize),
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
    let [with, against] = beside_trigger(footage, model, seen);
    let [ends, goes_on] = train_ends(footage, model, seen, shape);
    if against >= FRAMES && against > with || goes_on >= FRAMES && goes_on > ends {
        return None;
    }
    if with >= FRAMES && with > 2 * against {
        return Some(Evidence::Trigger(with));
    }
    let rows = footage.reducer.sensor_rows();
    let readout = settings.known_readout;
    let known = settings
        .row_time_us
        .or(settings.row_time_hint_us)
        .or(readout.and_then(|readout| readout.exact_row_time_us(rows)));
    if known.is_some_and(|known| (shape.row_time_us / known - 1.0).abs() < ROW_TIME_AGREES) {
        return Some(Evidence::RowTime);
    }
    let counts = FrameCounts::count(seen, footage.frames.len());
    let has_ends = ends >= FRAMES && are_distinct(&counts) && adds_light(footage, seen);
    has_ends.then_some(Evidence::Ends(counts.without_flashes))
}

/// Returns the number of frames in which the train ends in the picture where it does in most, and the
/// number in which the bands go on beyond its end. No ends count unless most frames agree, and show
/// [`IN_VIEW`] flashes.
fn train_ends(footage: &Footage, model: &Model, seen: &[Seen], shape: &Shape) -> [usize; 2] {
    let train = TrainGeometry {
        count: model.train.count + 2 * GOES_ON,
        ..model.train
    };
    let endless = Model::new(model.rows, train, model.smooth.clone());
    let lit: Vec<_> = frames_of(footage, seen, FrameClass::Used).collect();
    let asked = evenly_spaced(lit.len(), ENDS);
    let (mut ends, mut goes_on) = (Vec::new(), 0);
    for (frame, s) in asked.iter().filter_map(|place| lit.get(*place)) {
        let y: DVector<f64> = model.detrend(&frame.rows);
        let (own, other) = (s.fit.rss, endless.local(&y, &shape.at(s.fit.bias_us)).rss);
        let noise = own.min(other) / y.len().max(1) as f64;
        let margin = (other - own) / (noise * s.fit.inflation).max(1e-12);
        if margin > DECIDED {
            ends.push(s.fit.bias_us);
        }
        goes_on += usize::from(margin < -DECIDED);
    }
    let usual = median(&ends);
    ends.retain(|bias| (bias - usual).abs() < 0.5 * model.train.pitch_us);
    let rows = &model.rows;
    let view_us = [0, rows.len.saturating_sub(1)].map(|i| rows.position(i) * shape.row_time_us);
    let in_view = (0..model.train.count)
        .map(|k| model.train.flash_us(k, usual))
        .filter(|at| (view_us[0]..=view_us[1]).contains(at))
        .count();
    let agree = ends.len() as f64 >= AGREE * asked.len() as f64 && in_view >= IN_VIEW;
    [if agree { ends.len() } else { 0 }, goes_on]
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

/// Returns the number of frames in which the bands were elsewhere than at the end of the recording by as
/// much as the board's pulses were, and the number of those in which the pulses were elsewhere and the
/// bands not there.
///
/// Only the beginning is looked at: over minutes the relation of the two clocks leads elsewhere.
fn beside_trigger(footage: &Footage, model: &Model, seen: &[Seen]) -> [usize; 2] {
    let Some(trigger) = &footage.trigger else {
        return [0; 2];
    };
    let pitch = model.train.pitch_us;
    let frames = footage.frames.iter().zip(seen);
    let beginning = frames.take_while(|(frame, _)| frame.time_s <= BEGINNING_S);
    let lit = beginning.filter(|(_, s)| s.class != FrameClass::Dark && s.fit.is_train(0.5));
    let places = lit.filter_map(|(frame, s)| {
        let expected = trigger.bias_us(footage.first_ns?, frame.time_s)?;
        Some((expected, s.fit.bias_us - expected))
    });
    let places: Vec<(f64, f64)> = places.collect();
    let Some(&[.., (rest, apart)]) = places.rchunks(REST).next() else {
        return [0; 2];
    };
    // Relative to the last, and of the median of the last ones.
    let from_last = |&(_, off): &(f64, f64)| off_pitch(off - apart, pitch);
    let last: Vec<f64> = places.iter().rev().take(REST).map(from_last).collect();
    let apart = apart + median(&last);
    let moved = places
        .iter()
        .filter(|(expected, _)| off_pitch(expected - rest, pitch).abs() > MOVED * pitch);
    let mut counts = [0; 2];
    for (_, off) in moved {
        let is_off = off_pitch(off - apart, pitch).abs() > UNEVEN * pitch;
        if let Some(count) = counts.get_mut(usize::from(is_off)) {
            *count += 1;
        }
    }
    counts
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
