//! Exposures of the depth camera as a photodiode on the strobe input sees them: the middle of
//! each after the trigger's edge, in the board's own time.
//!
//! The light of one exposure is the train of flashes of the camera's mode, or one long flash (an
//! emitter that is on while the shutter is open). A train is recognised by its number and pitch,
//! so edges that were lost, other light and a bouncing contact do not move its middle: where they
//! leave more than one place for the train, that exposure has no result. A line through the
//! flashes takes up the rate of the camera's clock.

use std::collections::VecDeque;

use protocol::Ticks;
use serde::{Deserialize, Serialize};
use twist_sync::robust::{Line, median_in_place};

/// Flashes of one exposure, as the camera's maker states them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StrobeTrain {
    /// Number of flashes.
    pub count: u32,
    /// Time from the start of one flash to the start of the next, µs.
    pub pitch_us: f64,
    /// Length of a flash, µs.
    pub length_us: f64,
}

/// An edge on the strobe input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StrobeEdge {
    /// Board time.
    pub at: Ticks,
    /// True if the level rises.
    pub rising: bool,
    /// True if an edge before this one was lost.
    pub after_loss: bool,
}

impl From<&protocol::Capture> for StrobeEdge {
    fn from(capture: &protocol::Capture) -> Self {
        Self {
            at: capture.at,
            rising: capture.edge == protocol::Edge::Rising,
            after_loss: capture.after_loss,
        }
    }
}

impl From<&crate::messages::Capture> for StrobeEdge {
    fn from(capture: &crate::messages::Capture) -> Self {
        Self {
            at: Ticks(capture.ticks),
            rising: capture.rising,
            after_loss: capture.after_loss,
        }
    }
}

/// An exposure that follows a pulse of the trigger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenExposure {
    /// Rising edge of the pulse.
    pub edge: Ticks,
    /// Time from that edge to the middle of the exposure, µs.
    pub center_us: f64,
    /// Mean length of its flashes, µs.
    flash_us: f64,
    /// Number of its flashes that were seen.
    flashes: usize,
}

/// Statistics of the exposures of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeenExposures {
    /// Mean time from the trigger's edge to the middle of the exposure, µs.
    pub center_us: f64,
    /// Its 1-sigma, µs, with that of the photodiode's circuit.
    pub sigma_us: f64,
    /// Standard deviation of single exposures about a steady change, µs.
    pub spread_us: f64,
    /// Change over the recording, µs/min, and its 1-sigma.
    pub drift_us_per_min: [f64; 2],
    /// Length of a flash, µs.
    pub flash_us: f64,
    /// Number of pulses of the trigger.
    pub pulses: usize,
    /// Pulses whose exposure was seen, with at most two flashes missing.
    pub used: usize,
    /// Pulses whose train is cut, or has more than one place.
    pub cut: usize,
    /// Flashes that belong to no exposure.
    pub strange: usize,
}

/// Reason for which the light on the strobe input gives no time of exposure.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StrobesRefused {
    /// There are no flashes.
    #[error("the photodiode on the strobe input saw no light")]
    Dark,
    /// Too few pulses are followed by light of the camera.
    #[error(
        "the light on the strobe input is not the depth camera's: {used} of {pulses} pulses of the \
         trigger are followed by the flashes of its mode"
    )]
    DoesNotFollow {
        /// Pulses with an exposure.
        used: usize,
        /// All pulses.
        pulses: usize,
    },
    /// The light moves against the trigger.
    #[error(
        "the light on the strobe input moves against the trigger by {us_per_min:.0} µs/min: it is \
         a lamp's, or the camera does not follow the trigger"
    )]
    Moves {
        /// Its motion, µs/min.
        us_per_min: f64,
    },
}

/// Largest motion of an exposure against its pulse, µs/min, if it is significant. A camera counts
/// less than 70 ms from the edge: a clock that changes by 5 ppm moves that by 0.4 µs.
const MOST_DRIFT_US_PER_MIN: f64 = 50.0;

/// Number of 1-sigmas from which it is significant.
const SIGNIFICANT: f64 = 5.0;

/// 1-sigma of the delay of a photodiode with a resistor of 1 kΩ, µs, which makes the middle of a
/// flash late by half the sum of its delays: a BPW34 rises and falls in 0.1 µs at 1 kΩ (Vishay
/// 81521); less bias, a wire of 0.3 m and the pin multiply that.
const CIRCUIT_SIGMA_US: f64 = 0.25;

/// Longest dark time within a flash that bounces, µs.
const BOUNCE_US: f64 = 20.0;

/// Largest distance of a flash from its place in a train, µs: 0.1 % of half the longest train,
/// and 10 µs of jitter.
const OFF_PLACE_US: f64 = 20.0;

/// Largest difference of a flash's length from the maker's, or from that of the others, as a part
/// of it.
const OFF_LENGTH: f64 = 0.5;

/// Number of flashes of a train that may be missing.
const MISSING: usize = 2;

/// Largest distance of a single exposure from the median of all, µs: jitter of some 0.1 ms. Light
/// that does not follow the trigger lies anywhere in its period, so at 30 frames a second 3 % of
/// its places are as near; of a camera's, more than half are. Trains that lost edges have cut have
/// no place, and count on neither side.
const OFF_CENTER_US: f64 = 500.0;

/// Least number of exposures: two seconds at 5 frames a second.
const LEAST_USED: usize = 8;

/// Most flashes that are kept, if no pulses come: more than the board stamps in a minute.
const MOST_FLASHES: usize = 200_000;

/// Most that the message of an edge may come later than those of pulses, µs.
const LATE_US: f64 = 1e6;

/// A flash: rising to falling edge.
#[derive(Clone, Copy, Debug)]
struct Flash {
    from: Ticks,
    length_us: f64,
}

/// Finds the exposures in pulses and edges as they come.
#[derive(Clone, Debug, Default)]
pub struct ExposureFinder {
    train: Option<StrobeTrain>,
    /// Pulses whose exposure was not looked for yet.
    waiting: VecDeque<Ticks>,
    /// Flashes from the first of these pulses on.
    flashes: VecDeque<Flash>,
    /// Rising edge of the flash that is on.
    rising: Option<Ticks>,
    seen: Vec<SeenExposure>,
    pulses: usize,
    cut: usize,
    of_pulses: usize,
}

impl SeenExposures {
    /// Describes them in a sentence.
    #[must_use]
    pub fn text(&self) -> String {
        let [drift, drift_sigma] = self.drift_us_per_min;
        let strange = match self.strange {
            0 => String::new(),
            flashes => format!(", {flashes} other flashes"),
        };
        format!(
            "the photodiode sees the middle of the depth exposure {:.2} ± {:.2} µs after the \
             trigger's edge: {} of {} exposures, {} cut{strange}; spread {:.2} µs, drift {drift:.1} \
             ± {drift_sigma:.1} µs/min",
            self.center_us, self.sigma_us, self.used, self.pulses, self.cut, self.spread_us,
        )
    }

    /// Returns true if they contradict a constant that was measured before, µs with its 1-sigma.
    #[must_use]
    pub fn disagree_with(&self, center_us: f64, sigma_us: f64) -> bool {
        let sigma_us = self.sigma_us.hypot(sigma_us).hypot(self.spread_us);
        (self.center_us - center_us).abs() > SIGNIFICANT * sigma_us
    }
}

impl ExposureFinder {
    /// Returns a finder for a camera with these flashes; without a train, an exposure is one long
    /// flash.
    #[must_use]
    pub fn new(train: Option<StrobeTrain>) -> Self {
        Self {
            train,
            ..Self::default()
        }
    }

    /// Adds the rising edge of a pulse of the camera's trigger; pulses come in order.
    pub fn pulse(&mut self, at: Ticks) {
        if self.waiting.back().is_some_and(|&last| at <= last) {
            return;
        }
        self.waiting.push_back(at);
        while let Some((&edge, &next)) = self.waiting.front().zip(self.waiting.get(1))
            && micros(at, next) > self.span_us() + LATE_US
        {
            self.look(edge, next);
        }
    }

    /// Adds an edge on the strobe input; edges come in order. Flashes that a bounce divides are
    /// joined, and an edge without a partner is left out.
    pub fn edge(&mut self, edge: StrobeEdge) {
        let begin = self.rising.take().filter(|_| !edge.after_loss);
        if edge.rising {
            self.rising = Some(edge.at);
            return;
        }
        let Some(from) = begin.filter(|&from| from < edge.at) else {
            return;
        };
        let joined = self.flashes.back_mut().filter(|last| {
            let dark_us = micros(from, last.from) - last.length_us;
            dark_us <= BOUNCE_US
        });
        match joined {
            Some(last) => last.length_us = micros(edge.at, last.from),
            None => self.flashes.push_back(Flash {
                from,
                length_us: micros(edge.at, from),
            }),
        }
        if self.flashes.len() > MOST_FLASHES {
            self.flashes.pop_front();
        }
    }

    /// Returns the statistics of the exposures so far. The last pulse only ends the one before it.
    ///
    /// # Errors
    ///
    /// Returns the reason if the light is not that of a camera that follows the trigger.
    pub fn statistics(&self) -> Result<SeenExposures, StrobesRefused> {
        self.clone().finish().map(|(statistics, _)| statistics)
    }

    /// Returns the statistics, and each exposure that is part of them, in order.
    ///
    /// # Errors
    ///
    /// As [`ExposureFinder::statistics`].
    pub fn finish(mut self) -> Result<(SeenExposures, Vec<SeenExposure>), StrobesRefused> {
        while let Some((&edge, &next)) = self.waiting.front().zip(self.waiting.get(1)) {
            self.look(edge, next);
        }
        if self.of_pulses == 0 {
            return Err(StrobesRefused::Dark);
        }
        let mut each = self.seen;
        let usual = |of: fn(&SeenExposure) -> f64| {
            let mut values: Vec<f64> = each.iter().map(of).collect();
            median_in_place(&mut values).unwrap_or_default()
        };
        let typical = usual(|exposure| exposure.center_us);
        let flash_us = usual(|exposure| exposure.flash_us);
        let before = each.len();
        each.retain(|exposure| {
            (exposure.center_us - typical).abs() <= OFF_CENTER_US
                && (exposure.flash_us - flash_us).abs() <= OFF_LENGTH * flash_us
        });
        let (used, pulses) = (each.len(), self.pulses);
        let cut = self.cut + before - used;
        let scattered = before - used;
        if used < LEAST_USED || scattered > used || 4 * used < pulses {
            return Err(StrobesRefused::DoesNotFollow { used, pulses });
        }
        let count = used as f64;
        let first = each.first().map_or(Ticks::ZERO, |exposure| exposure.edge);
        let minutes = |exposure: &SeenExposure| micros(exposure.edge, first) / 60e6;
        let points = each.iter().map(|seen| (minutes(seen), seen.center_us));
        let points: Vec<(f64, f64)> = points.collect();
        let line = Line::through(&points);
        let off = points.iter().map(|(at, center)| center - line.at(*at));
        let spread_us = (off.map(|off| off * off).sum::<f64>() / (count - 2.0).max(1.0)).sqrt();
        let moved_us = line.slope.abs() * (line.squares / count).sqrt();
        let drift = line.slope;
        let drift_sigma = spread_us / line.squares.sqrt().max(f64::MIN_POSITIVE);
        if drift.abs() > MOST_DRIFT_US_PER_MIN.max(SIGNIFICANT * drift_sigma) {
            return Err(StrobesRefused::Moves { us_per_min: drift });
        }
        // A circuit that stretches a flash moves its middle by up to half of that.
        let train = self.train.as_ref();
        let stretch_us = train.map_or(0.0, |train| 0.5 * (flash_us - train.length_us).abs());
        let of_mean = spread_us / count.sqrt();
        let known: usize = each.iter().map(|exposure| exposure.flashes).sum();
        let statistics = SeenExposures {
            center_us: line.mean,
            sigma_us: of_mean
                .hypot(moved_us)
                .hypot(CIRCUIT_SIGMA_US)
                .hypot(stretch_us),
            spread_us,
            drift_us_per_min: [drift, drift_sigma],
            flash_us,
            pulses,
            used,
            cut,
            strange: self.of_pulses.saturating_sub(known),
        };
        Ok((statistics, each))
    }

    /// Length of a train beyond its first flash's start, µs.
    fn span_us(&self) -> f64 {
        self.train
            .map_or(0.0, |train| f64::from(train.count) * train.pitch_us)
    }

    /// Looks for the exposure whose first flash begins between two pulses.
    fn look(&mut self, edge: Ticks, next: Ticks) {
        self.waiting.pop_front();
        self.flashes.retain(|flash| flash.from >= edge);
        let (period_us, span_us) = (micros(next, edge), self.span_us());
        let after: Vec<(f64, f64)> = self
            .flashes
            .iter()
            .map(|flash| (micros(flash.from, edge), flash.length_us))
            .take_while(|(from, _)| *from < period_us + span_us)
            .collect();
        self.pulses += 1;
        self.of_pulses += after.iter().filter(|(from, _)| *from < period_us).count();
        let found = match &self.train {
            Some(train) => in_train(&after, train, period_us),
            None => longest(&after),
        };
        match found {
            Found::At([center_us, flash_us], flashes) => self.seen.push(SeenExposure {
                edge,
                center_us,
                flash_us,
                flashes,
            }),
            Found::Unclear => self.cut += 1,
            Found::Nothing => {}
        }
    }
}

/// Light after a pulse.
enum Found {
    /// An exposure: its middle after the pulse and the length of a flash, µs, and the number of
    /// its flashes.
    At([f64; 2], usize),
    /// Flashes whose train is cut or has several places.
    Unclear,
    /// None.
    Nothing,
}

/// The one place of a train in flashes (start and length, µs), with its first flash within
/// `period_us`.
fn in_train(flashes: &[(f64, f64)], train: &StrobeTrain, period_us: f64) -> Found {
    let middles: Vec<(f64, f64)> = flashes
        .iter()
        .filter(|(_, length)| (length - train.length_us).abs() <= OFF_LENGTH * train.length_us)
        .map(|(from, length)| (from + 0.5 * length, *length))
        .collect();
    let count = train.count as usize;
    let place = |number: usize| number as f64 - 0.5 * (count as f64 - 1.0);
    let nearest = |at: f64| {
        let next = middles.partition_point(|flash| flash.0 < at);
        let around = middles.get(next.saturating_sub(1)..).unwrap_or_default();
        let off = |flash: &(f64, f64)| (flash.0 - at).abs();
        around
            .iter()
            .take(2)
            .copied()
            .min_by(|a, b| off(a).total_cmp(&off(b)))
            .filter(|flash| off(flash) <= OFF_PLACE_US)
    };
    let matched = |first_us: f64| -> Vec<(f64, f64, f64)> {
        let flash = |number: usize| {
            let (middle, length) = nearest(first_us + number as f64 * train.pitch_us)?;
            Some((place(number), middle, length))
        };
        (0..count).filter_map(flash).collect()
    };
    let mut best: Vec<(f64, f64, f64)> = Vec::new();
    let (mut best_us, mut is_one) = (0.0, true);
    for (middle, _) in &middles {
        // One of the first flashes was seen, or too many are missing.
        for number in 0..=MISSING {
            let first_us = middle - number as f64 * train.pitch_us;
            if !(0.0..period_us).contains(&first_us) {
                continue;
            }
            let here = matched(first_us);
            let is_same = (first_us - best_us).abs() <= 3.0 * OFF_PLACE_US;
            if here.len() > best.len() {
                is_one = true;
                (best, best_us) = (here, first_us);
            } else if here.len() == best.len() && !is_same {
                is_one = false;
            }
        }
    }
    if best.is_empty() {
        return Found::Nothing;
    }
    if !is_one || best.len() + MISSING < count {
        return Found::Unclear;
    }
    let n = best.len() as f64;
    let mean = |value: &dyn Fn(&(f64, f64, f64)) -> f64| best.iter().map(value).sum::<f64>() / n;
    let (number, middle) = (mean(&|flash| flash.0), mean(&|flash| flash.1));
    let squares = mean(&|flash| (flash.0 - number).powi(2));
    let slope = if squares > 0.0 {
        mean(&|flash| (flash.0 - number) * (flash.1 - middle)) / squares
    } else {
        train.pitch_us
    };
    Found::At(
        [middle - number * slope, mean(&|flash| flash.2)],
        best.len(),
    )
}

/// The one flash that is at least twice as long as any other.
fn longest(flashes: &[(f64, f64)]) -> Found {
    let Some(&(from, length)) = flashes.iter().max_by(|a, b| a.1.total_cmp(&b.1)) else {
        return Found::Nothing;
    };
    let is_like = |other: &&(f64, f64)| 2.0 * other.1 > length;
    if flashes.iter().filter(is_like).count() > 1 {
        return Found::Unclear;
    }
    Found::At([from + 0.5 * length, length], 1)
}

/// Time from `from` to `at`, µs.
fn micros(at: Ticks, from: Ticks) -> f64 {
    (at - from).as_secs_f64() * 1e6
}

#[cfg(test)]
mod tests;
