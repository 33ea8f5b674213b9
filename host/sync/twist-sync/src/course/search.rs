//! Search for a first relation of two clocks whose offset is unknown.
//!
//! All gyroscopes on a rigid body measure the same magnitude of the angular rate, in any
//! orientation. So the magnitudes of both recordings, averaged over [`BIN`], are correlated
//! over all lags (an FFT over the whole recording: 100 kB an hour). The best lags
//! are then tried with [`estimate_offset`] on the parts with the most motion, and of those that pass
//! the gates the one that explains most is the relation, unless another explains about as much
//! (periodic motion). If none passes, those at which [single parts](super::together) agree are tried.

use std::error::Error;

use super::error::CourseError;
use super::together;
use crate::clock::ClockRelation;
use crate::correlate::Correlator;
use crate::estimate::{Estimate, Gate, Options, estimate_offset};
use crate::track::{GyroOpener, GyroSample, GyroTrack, MOST_SAMPLES};

/// Length of an average, ns: 40 ms.
const BIN: i64 = 40_000_000;
/// Longest recording that is searched: 48 hours.
const MAX_BINS: usize = 48 * 3600 * 25;
/// Longest pause of a recording that its timestamps may show by themselves, in bins: a minute.
const PAUSE: usize = 1500;
/// Length of the parts on which lags are tried, in bins: 12 s.
const PART: usize = 300;
/// Parts and lags that are tried.
const PARTS: usize = 4;
const LAGS: usize = 6;
/// Parts that agree by themselves with b and are tried.
const ALIKE: usize = 24;
/// Lags closer than this are one peak, in bins: 0.84 s.
const APART: u64 = 21;
/// Half-width of the search around a lag, s.
const MARGIN: f64 = 0.3;
/// Largest 1-sigma of the first relation, s: it only says where to look.
const FIRST_SIGMA_S: f64 = 10e-3;

/// Magnitude of the angular rate over time, in bins.
struct Profile {
    start: i64,
    bins: Vec<f64>,
}

/// Relates two recordings whose offset is unknown.
pub(crate) fn first_relation<E: Error + 'static>(
    a: GyroOpener<'_, E>,
    b: GyroOpener<'_, E>,
    options: &Options,
) -> Result<ClockRelation, CourseError<E>> {
    let no = |what: &str| CourseError::NoRelation(what.into());
    let profile_a = profile(a()?)?.ok_or_else(|| no("one of the recordings has no samples"))?;
    let profile_b = profile(b()?)?.ok_or_else(|| no("one of the recordings has no samples"))?;
    let lags = best_lags(&profile_a.bins, &profile_b.bins);
    let mut reason = None;
    let mut tried = |(part, lag): (i64, i64)| -> Result<Option<Estimate>, E> {
        let from = profile_a.start.saturating_add(part * BIN);
        let window = between(a, from, from.saturating_add(PART as i64 * BIN))?;
        // Bin i of a is bin i + lag of b.
        let offset = profile_b
            .start
            .saturating_sub(profile_a.start)
            .saturating_add(lag * BIN);
        let margin = (MARGIN * 2e9) as i64;
        let start = from.saturating_add(offset).saturating_sub(margin);
        let end = from
            .saturating_add(offset)
            .saturating_add(PART as i64 * BIN + margin);
        let around = between(b, start, end)?;
        let options = Options {
            search: Some((offset as f64 * 1e-9, MARGIN)),
            sigma_limit_s: options.sigma_limit_s.max(FIRST_SIGMA_S),
            ..*options
        };
        match estimate_offset(&window, &around, &options) {
            Ok(estimate) => Ok(Some(estimate)),
            Err(error) => {
                reason = reason.take().or(Some(error.to_string()));
                Ok(None)
            }
        }
    };
    for part in busiest(&profile_a.bins) {
        let mut found = Vec::new();
        for &lag in &lags {
            found.extend(tried((part, lag))?);
        }
        found.sort_by(|x, y| unexplained(x).total_cmp(&unexplained(y)));
        let Some(best) = found.first() else {
            continue;
        };
        let is_other = |other: &&Estimate| {
            let at = best.clock.reference;
            (other.clock.offset_at(at).value - best.clock.offset).abs() > MARGIN
        };
        let rival = found.iter().find(is_other);
        let ratio = rival.map_or(f64::INFINITY, |other| {
            unexplained(other) / unexplained(best)
        });
        let unique = Gate::unique_peak(ratio);
        return if unique.passed {
            Ok(best.clock)
        } else {
            Err(no(&unique.to_string()))
        };
    }
    for candidate in together::alike(&profile_a.bins, &profile_b.bins, PART, ALIKE) {
        if let Some(found) = tried(candidate)? {
            return Ok(found.clock);
        }
    }
    Err(no(
        &reason.unwrap_or_else(|| "the recordings are too short".into())
    ))
}

/// Power of the residual over that of the motion.
fn unexplained(estimate: &Estimate) -> f64 {
    let Some((residual, motion)) = estimate.report.residual_rms.zip(estimate.report.motion_rms)
    else {
        return f64::INFINITY;
    };
    (residual / motion).powi(2).max(1e-14)
}

fn profile<E>(stream: impl Iterator<Item = Result<GyroSample, E>>) -> Result<Option<Profile>, E> {
    let mut begin = None;
    let mut sums: Vec<(f64, u32)> = Vec::new();
    let (mut taken, mut skipped) = (0, 0);
    for sample in stream {
        let sample = sample?;
        let start = *begin.get_or_insert(sample.at);
        let since = usize::try_from(sample.at.saturating_sub(start) / BIN).ok();
        // A timestamp far ahead is wild, unless most are there: then the earlier ones were. So
        // there are no more bins than samples and a pause.
        let bin = match since.filter(|bin| *bin <= sums.len() + taken + PAUSE) {
            Some(bin) => bin,
            None if skipped < taken => {
                skipped += 1;
                continue;
            }
            None => {
                begin = Some(sample.at);
                sums.clear();
                (taken, skipped) = (0, 0);
                0
            }
        };
        taken += 1;
        if bin >= MAX_BINS {
            break;
        }
        if sums.len() <= bin {
            sums.resize(bin + 1, (0.0, 0));
        }
        let rate = sample
            .rate
            .iter()
            .map(|axis| axis * axis)
            .sum::<f64>()
            .sqrt();
        if rate.is_finite() {
            sums[bin].0 += rate;
            sums[bin].1 += 1;
        }
    }
    Ok(begin.map(|start| Profile {
        start,
        bins: sums
            .into_iter()
            .map(|(sum, count)| sum / f64::from(count.max(1)))
            .collect(),
    }))
}

/// Lags in bins (bin `i` of a is bin `i + lag` of b), the highest correlation first.
fn best_lags(a: &[f64], b: &[f64]) -> Vec<i64> {
    let correlator = Correlator::new(a.len() + b.len());
    let spectrum = |bins: &[f64]| {
        let mean = bins.iter().sum::<f64>() / bins.len().max(1) as f64;
        correlator.spectrum(bins.iter().map(|bin| bin - mean))
    };
    let (a, b) = (spectrum(a), spectrum(b));
    let correlation = correlator.correlation(&a, &b);
    let length = correlation.len();
    let mut order: Vec<usize> = (0..length).collect();
    order.sort_unstable_by(|&x, &y| correlation[y].total_cmp(&correlation[x]));
    let lag = |place: usize| {
        if place < length / 2 {
            place as i64
        } else {
            place as i64 - length as i64
        }
    };
    first_apart(order.into_iter().take(100_000).map(lag), APART, LAGS)
}

/// The first `most` values that are at least `apart` from each other.
fn first_apart(values: impl Iterator<Item = i64>, apart: u64, most: usize) -> Vec<i64> {
    let mut chosen: Vec<i64> = Vec::new();
    for value in values {
        if chosen.iter().all(|other| other.abs_diff(value) >= apart) {
            chosen.push(value);
        }
        if chosen.len() == most {
            break;
        }
    }
    chosen
}

/// First bins of the parts with the most motion, apart from each other.
fn busiest(bins: &[f64]) -> Vec<i64> {
    let power = |from: usize| -> f64 {
        let end = (from + PART).min(bins.len());
        bins[from..end].iter().map(|bin| bin * bin).sum()
    };
    let mut parts: Vec<(usize, f64)> = (0..bins.len())
        .step_by(PART / 4)
        .map(|from| (from, power(from)))
        .collect();
    parts.sort_by(|a, b| b.1.total_cmp(&a.1));
    let starts = parts.into_iter().map(|(from, _)| from as i64);
    first_apart(starts, PART as u64, PARTS)
}

fn between<E>(open: GyroOpener<'_, E>, from: i64, to: i64) -> Result<GyroTrack, E> {
    let mut samples = Vec::new();
    for sample in open()? {
        let sample = sample?;
        if sample.at >= to || samples.len() >= MOST_SAMPLES {
            break;
        }
        if sample.at >= from {
            samples.push(sample);
        }
    }
    Ok(GyroTrack::from_samples(&samples))
}
