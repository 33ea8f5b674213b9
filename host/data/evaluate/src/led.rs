//! Time of a phone's rows from the flashes of the board's own LED.
//!
//! The board flashes an LED at the phone's lens at times that it knows to a tick. On a rolling
//! shutter each flash brightens a band of rows, so each frame shows which row was exposed at
//! which board time. The flashes come at two periods, one above and one below the frame period,
//! with pauses: the bands walk over the whole picture in both directions.
//!
//! ## Model
//!
//! Times are board time in µs. A frame whose timestamp is at `t` by the clock relation exposes
//! the row `p` rows after the middle one around `t + middle + p · row_time`. Row `p` gets of a
//! flash around `f` the trapezoid of [`crate::train::overlap`] at
//! `x = f − t − middle − p · row_time`. For a fixed row the picture, the light's fall-off and
//! the camera's tone curve change the height and the slopes of that trapezoid but not its
//! symmetry, so they do not move its middle.
//!
//! ## Method
//!
//! | module | contents |
//! |---|---|
//! | [`film`] | a video as the brightness of its rows, and of its columns, each relative to that of the neighbouring frames |
//! | [`search`] | coarse place of the bands, by stacking all frames at the distance from the flashes; the same with wrong periods shows what other light gives |
//! | [`calibration`] | the measurement on the recording of a session |
//! | [`fit`] | least squares of all rows of all frames together; 1-sigmas by leaving out parts of the recording |
//!
//! Light that does not follow the flashes (lamps, screens, a moving hand) stacks up no better at
//! the right periods than at wrong ones, or differs between the two periods, and is refused. The
//! depth camera's flashes stand still in the picture, where the neighbouring frames remove them.

pub mod calibration;
pub mod film;
mod fit;

mod search;

use serde::Serialize;

use crate::stats::median;
use film::{Axis, Film, View};
use recording::profile::Direction;
use twist_sync::robust;

/// Shortest and longest readout of a picture that is searched, µs.
pub(crate) const READOUT_US: (f64, f64) = (3_000.0, 36_000.0);

/// Least score of the bands at either period, in 1-sigmas of stacked noise.
const LEAST_SCORE: f64 = 12.0;

/// Least ratio of that score to the best one at wrong periods.
const LEAST_RATIO: f64 = 2.0;

/// Most 1-sigmas between the results of the two periods.
const MOST_DISAGREEMENT: f64 = 5.0;

/// Least 1-sigma of that difference, µs: the bands walk in opposite directions, and what an
/// encoder leaves of the frame before lies on either side of them. A frame that is missing in
/// the video moves one of the results by milliseconds.
const DISAGREEMENT_SIGMA_US: f64 = 10.0;

/// Largest 1-sigma of a result, µs: no better than what is assumed of a gyroscope's delay.
const MOST_SIGMA_US: f64 = 200.0;

/// 1-sigma of the middle of a flash after that of its pulse, µs: an LED lights up and goes out
/// within some 0.1 µs, one with a phosphor within 1 µs.
const LIGHT_SIGMA_US: f64 = 0.5;

/// 1-sigma of the middle of the bands in a video that went through an encoder, lines: it predicts
/// each block of the picture from those above and on the left, and moves the bands of all frames
/// alike, so that no scatter shows it.
const ENCODER_SIGMA_LINES: f64 = 0.6;

/// Least 1-sigma of the middle of one strip of the picture, µs: two lines of the slowest readout, by
/// which an encoder moves bands in weak light.
const STRIP_SIGMA_US: f64 = 50.0;

/// Least number of flashes of each period.
const LEAST_FLASHES: usize = 100;

/// One flash of the LED, µs of board time since any reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LedFlash {
    /// Middle of the pulse at the pin.
    pub middle_us: f64,
    /// Length of the pulse.
    pub length_us: f64,
}

/// Knowledge before the measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Time from a frame's timestamp to the middle of exposure of its middle row, µs.
    pub middle_us: f64,
    /// Most that it may differ, µs.
    pub within_us: f64,
}

/// The rows of a phone's camera against its timestamps, as measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeasuredRows {
    /// Time from a frame's timestamp, by the clock relation, to the middle of exposure of the
    /// middle row, µs.
    pub middle_us: f64,
    /// Its 1-sigma, µs, without that of the clock relation.
    pub middle_sigma_us: f64,
    /// Time from one row's exposure to the next row's, µs; always positive.
    pub row_time_us: f64,
    /// Its 1-sigma, µs.
    pub row_time_sigma_us: f64,
    /// Number of rows of the whole picture.
    pub rows: usize,
    /// Direction of the readout in the picture.
    pub direction: Direction,
    /// Exposure of a row, µs, from the length of the bands.
    pub exposure_us: f64,
    /// Frames that were used.
    pub frames: usize,
    /// Flashes that were used.
    pub flashes: usize,
    /// Score of the bands at the weaker of the two periods, 1-sigmas.
    pub score: f64,
    /// Best score at wrong periods.
    pub score_of_others: f64,
    /// Difference of the middle between the two periods, and its 1-sigma, µs.
    pub disagreement_us: [f64; 2],
}

/// Reason for which no result is given.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error, Serialize)]
#[serde(rename_all = "snake_case", tag = "reason")]
pub enum LedRefusal {
    /// The board's record has too few flashes.
    #[error(
        "the recording has {found} flashes of the LED's shorter period and {other} of its longer one; \
         at least {LEAST_FLASHES} of each are needed"
    )]
    TooFewFlashes {
        /// Flashes at the shorter period.
        found: usize,
        /// Flashes at the longer period.
        other: usize,
    },
    /// Too few frames have a timestamp among the flashes.
    #[error("only {frames} frames of the video lie among the LED's flashes")]
    TooFewFrames {
        /// Frames with flashes.
        frames: usize,
    },
    /// No light in the picture follows the flashes.
    #[error(
        "no light in the video follows the LED: {score:.0} where at least {LEAST_SCORE:.0} is \
         expected"
    )]
    NotSeen {
        /// Score of the bands at the weaker of the two periods.
        score: f64,
    },
    /// Light follows the flashes no better than it follows other periods.
    #[error(
        "light in the video flickers, but not with the LED: {score:.0} at its periods, {others:.0} \
         at others"
    )]
    OtherLight {
        /// Score of the bands at the weaker of the two periods.
        score: f64,
        /// Best score at wrong periods.
        others: f64,
    },
    /// Along neither side do all parts of the picture follow the flashes as rows of a sensor do.
    #[error(
        "light in the video follows the LED, but not as it moves over a rolling shutter's rows: \
         too little of the picture is lit, or it is another light"
    )]
    NoSide,
    /// The two periods give different results.
    #[error(
        "the LED's two periods disagree by {by_us:.0} ± {sigma_us:.0} µs: some of the light is not \
         the LED's, or frames are missing in the video"
    )]
    Disagreement {
        /// Difference of the two results, µs.
        by_us: f64,
        /// Its 1-sigma, µs.
        sigma_us: f64,
    },
    /// The result is too uncertain.
    #[error("the LED is seen too weakly: ± {sigma_us:.0} µs")]
    TooWeak {
        /// 1-sigma of the middle, µs.
        sigma_us: f64,
    },
}

/// Measures the rows of a phone's camera.
///
/// # Errors
///
/// Returns the reason if the film does not show the flashes, or something else that is no LED.
pub fn measure(
    film: &Film,
    flashes: &[LedFlash],
    expected: &Expected,
) -> Result<MeasuredRows, LedRefusal> {
    let code = Code::new(flashes);
    let [found, other] = code.counts();
    if found.min(other) < LEAST_FLASHES {
        return Err(LedRefusal::TooFewFlashes { found, other });
    }
    let frames = film.frames_among(&code);
    if frames < 2 * LEAST_FLASHES {
        return Err(LedRefusal::TooFewFrames { frames });
    }
    // A partly lit picture follows the flashes along its other side too; only along the sensor's
    // own are all strips across exposed at the same time.
    let (mut best, mut seen) = (0.0_f64, None);
    for axis in [Axis::Rows, Axis::Columns] {
        let view = film.view(axis);
        let (score, place) = search::find(view, &code, expected);
        if score < LEAST_SCORE {
            best = best.max(score);
            continue;
        }
        let fitted = fit::fit(view, &code, place);
        let readout_us = fitted.place.row_time_us.abs() * view.rows() as f64;
        let is_of_sensor = (READOUT_US.0..READOUT_US.1).contains(&readout_us)
            && is_at_once(film.strips(axis), &code, fitted.place);
        if is_of_sensor && seen.is_none_or(|(_, other, _)| score > other) {
            seen = Some((axis, score, fitted));
        }
        best = best.max(score);
    }
    let Some((axis, score, fitted)) = seen else {
        return Err(if best < LEAST_SCORE {
            LedRefusal::NotSeen { score: best }
        } else {
            LedRefusal::NoSide
        });
    };
    let view = film.view(axis);
    let others = search::elsewhere(view, &code, expected);
    if score < LEAST_RATIO * others {
        return Err(LedRefusal::OtherLight { score, others });
    }
    let [by_us, sigma_us] = fitted.disagreement_us;
    let sigma_us = sigma_us.hypot(DISAGREEMENT_SIGMA_US);
    if by_us.abs() > MOST_DISAGREEMENT * sigma_us {
        return Err(LedRefusal::Disagreement { by_us, sigma_us });
    }
    // What parts of the frame before are left adds to the result in one direction of the walk, and
    // is taken off it in the other.
    let [by_us, by_sigma_us] = fitted.disagreement_us;
    let excess_us = (by_us * by_us - by_sigma_us * by_sigma_us).max(0.0).sqrt();
    let place = fitted.place;
    let encoder_us = if film.is_encoded {
        ENCODER_SIGMA_LINES * place.row_time_us.abs()
    } else {
        0.0
    };
    let [middle, row_time] = fitted.sigmas;
    let middle = middle
        .hypot(LIGHT_SIGMA_US)
        .hypot(0.5 * excess_us)
        .hypot(encoder_us);
    let row_time = row_time.hypot(encoder_us / view.rows() as f64);
    if middle.is_nan() || middle > MOST_SIGMA_US {
        return Err(LedRefusal::TooWeak { sigma_us: middle });
    }
    let direction = match (axis, place.row_time_us > 0.0) {
        (Axis::Rows, true) => Direction::Down,
        (Axis::Rows, false) => Direction::Up,
        (Axis::Columns, true) => Direction::Right,
        (Axis::Columns, false) => Direction::Left,
    };
    Ok(MeasuredRows {
        middle_us: place.middle_us,
        middle_sigma_us: middle,
        row_time_us: place.row_time_us.abs(),
        row_time_sigma_us: row_time,
        rows: view.rows(),
        direction,
        exposure_us: place.exposure_us,
        frames,
        flashes: code.flashes.len(),
        score,
        score_of_others: others,
        disagreement_us: fitted.disagreement_us,
    })
}

/// Returns true if the strips of a picture, side by side across the lines, see the flashes at the
/// same time: their middles have a slope from edge to edge that is known, and less than half of the
/// shortest readout. Strips that the light hardly reaches are outliers.
fn is_at_once<'a>(
    strips: impl ExactSizeIterator<Item = View<'a>>,
    code: &Code,
    place: Place,
) -> bool {
    let count = strips.len() as f64;
    // Place from 0 to 1, and middle.
    let lit: Vec<(f64, f64)> = strips
        .enumerate()
        .filter_map(|(strip, view)| {
            let fitted = fit::fit(view, code, place);
            let at = (strip as f64 + 0.5) / count;
            (fitted.sigmas[0] < MOST_SIGMA_US).then_some((at, fitted.place.middle_us))
        })
        .collect();
    let pairs = lit.iter().enumerate();
    let slopes = pairs.flat_map(|(place, from)| {
        let later = lit.iter().skip(place + 1);
        later.map(|to| (to.1 - from.1) / (to.0 - from.0))
    });
    let slope_us = median(&slopes.collect::<Vec<_>>());
    let rests = lit.iter().map(|(at, middle_us)| middle_us - slope_us * at);
    let scatter_us = robust::mad_sigma(rests.collect()).unwrap_or(f64::INFINITY);
    let reach = robust::Line::through(&lit).squares.sqrt();
    let sigma_us = scatter_us.max(STRIP_SIGMA_US) / reach;
    slope_us.abs() + 3.0 * sigma_us < 0.5 * READOUT_US.0
}

/// Place of the bands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    /// As [`MeasuredRows::middle_us`].
    pub(crate) middle_us: f64,
    /// Time from one line of the picture to the next, µs; negative if the picture is read
    /// upwards or leftwards.
    pub(crate) row_time_us: f64,
    /// Exposure of a row, µs.
    pub(crate) exposure_us: f64,
}

/// The flashes with their periods: runs of evenly spaced flashes, each run short or long.
#[derive(Debug, Clone)]
pub(crate) struct Code {
    pub(crate) flashes: Vec<CodedFlash>,
    /// Length of a flash, µs.
    pub(crate) length_us: f64,
}

/// A flash of the code.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CodedFlash {
    pub(crate) middle_us: f64,
    /// Distance to its neighbours, µs.
    pub(crate) period_us: f64,
    /// 0 in a run of the shorter period, 1 in one of the longer.
    pub(crate) kind: usize,
    /// Start of its run.
    pub(crate) run_us: f64,
}

impl Code {
    /// Largest relative difference of the distances of a run.
    const EVEN: f64 = 1e-3;

    /// Sorts flashes into runs. Those without a neighbour on either side are left out.
    fn new(flashes: &[LedFlash]) -> Self {
        let mut sorted: Vec<LedFlash> = flashes.to_vec();
        sorted.retain(|flash| flash.middle_us.is_finite() && flash.length_us > 0.0);
        sorted.sort_by(|a, b| a.middle_us.total_cmp(&b.middle_us));
        let lengths: Vec<f64> = sorted.iter().map(|flash| flash.length_us).collect();
        let length_us = median(&lengths);
        let mut steps: Vec<f64> = sorted
            .windows(2)
            .map(|pair| pair[1].middle_us - pair[0].middle_us)
            .collect();
        let same = |a: f64, b: f64| (a - b).abs() <= Self::EVEN * a;
        let mut coded = Vec::new();
        let mut run_us = f64::NEG_INFINITY;
        for (place, flash) in sorted.iter().enumerate() {
            let before = place.checked_sub(1).and_then(|place| steps.get(place));
            let after = steps.get(place).copied();
            let earlier = place.checked_sub(2).and_then(|place| steps.get(place));
            let continues = before.is_some_and(|&before| {
                after.is_some_and(|after| same(before, after))
                    || earlier.is_some_and(|&earlier| same(before, earlier))
            });
            let period_us = if continues { before.copied() } else { after };
            if !continues {
                run_us = flash.middle_us;
            }
            let Some(period_us) = period_us else { continue };
            coded.push(CodedFlash {
                middle_us: flash.middle_us,
                period_us,
                kind: 0,
                run_us,
            });
        }
        // The two periods lie on both sides of the mean of the typical extremes.
        steps.retain(|step| step.is_finite());
        steps.sort_by(f64::total_cmp);
        let part = |share: f64| {
            let place = (share * steps.len() as f64) as usize;
            steps.get(place).copied().unwrap_or_default()
        };
        let (short, long) = (part(0.1), part(0.8));
        let border = 0.5 * (short + long);
        coded.retain(|flash| flash.period_us < 1.2 * long && flash.period_us > 0.8 * short);
        for flash in &mut coded {
            flash.kind = usize::from(flash.period_us > border);
        }
        Self {
            flashes: coded,
            length_us,
        }
    }

    /// Number of flashes of the shorter and of the longer period.
    fn counts(&self) -> [usize; 2] {
        let long = self.flashes.iter().filter(|flash| flash.kind == 1).count();
        [self.flashes.len() - long, long]
    }

    /// The same with other periods: each run is stretched about its start by a part of itself.
    pub(crate) fn stretched(&self, by: f64) -> Self {
        let stretch = |flash: &CodedFlash| CodedFlash {
            middle_us: flash.middle_us + by * (flash.middle_us - flash.run_us),
            period_us: flash.period_us * (1.0 + by),
            ..*flash
        };
        let mut flashes: Vec<CodedFlash> = self.flashes.iter().map(stretch).collect();
        flashes.sort_by(|a, b| a.middle_us.total_cmp(&b.middle_us));
        Self {
            flashes,
            ..self.clone()
        }
    }

    /// The flashes within `from..to`.
    pub(crate) fn within(&self, from_us: f64, to_us: f64) -> &[CodedFlash] {
        let place = |at: f64| self.flashes.partition_point(|flash| flash.middle_us < at);
        let (from, to) = (place(from_us), place(to_us));
        self.flashes.get(from..to.max(from)).unwrap_or_default()
    }

    /// The last flash that is not after a time.
    pub(crate) fn last_before(&self, at_us: f64) -> Option<&CodedFlash> {
        let next = self
            .flashes
            .partition_point(|flash| flash.middle_us <= at_us);
        self.flashes.get(next.checked_sub(1)?)
    }

    /// The flash nearest to a time, if that lies within half its period.
    pub(crate) fn nearest(&self, at_us: f64) -> Option<CodedFlash> {
        let next = self
            .flashes
            .partition_point(|flash| flash.middle_us < at_us);
        let candidates = [next.checked_sub(1), Some(next)];
        let near = candidates
            .into_iter()
            .flatten()
            .filter_map(|place| self.flashes.get(place))
            .min_by(|a, b| {
                let away = |flash: &CodedFlash| (flash.middle_us - at_us).abs();
                away(a).total_cmp(&away(b))
            })?;
        ((near.middle_us - at_us).abs() <= 0.5 * near.period_us).then_some(*near)
    }
}
