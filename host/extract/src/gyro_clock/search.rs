//! The first relation of two clocks about which nothing is known.
//!
//! How fast a rigid body turns is the same for every gyroscope on it, whatever its
//! axes. So the rates of both recordings, averaged over [`BIN`], are correlated
//! over all lags (an FFT over the whole recording: 100 kB an hour). The best lags
//! are then tried on the parts with the most motion by the sync math, which has
//! the last word.

use realfft::RealFftPlanner;

use super::{GyroClockError, GyroOpener, GyroSample, track};
use twist_sync::{ClockRelation, Options, estimate_offset};

/// Length of an average, ns: 40 ms.
const BIN: i64 = 40_000_000;
/// Longest recording that is searched: 48 hours.
const MAX_BINS: usize = 48 * 3600 * 25;
/// Length of the parts on which lags are tried, in bins: 12 s.
const PART: usize = 300;
/// Parts and lags that are tried.
const PARTS: usize = 4;
const LAGS: usize = 6;
/// Lags closer than this are one peak, in bins: 0.8 s.
const APART: usize = 20;
/// Half-width of the search around a lag, s.
const MARGIN: f64 = 0.3;

/// Turning rate over time, in bins.
struct Profile {
    start: i64,
    bins: Vec<f32>,
}

/// Relates two recordings without any knowledge of their offset.
///
/// # Errors
///
/// Reading fails, or nothing fits.
pub(super) fn first_relation<E: std::error::Error + 'static>(
    board: GyroOpener<'_, E>,
    other: GyroOpener<'_, E>,
    options: &Options,
) -> Result<ClockRelation, GyroClockError<E>> {
    let no = |what: &str| GyroClockError::NoRelation(what.into());
    let ours = profile(board()?)?.ok_or_else(|| no("the board's recording has no samples"))?;
    let theirs = profile(other()?)?.ok_or_else(|| no("the other recording has no samples"))?;
    let lags = best_lags(&ours.bins, &theirs.bins);
    let mut reason = None;
    for part in busiest(&ours.bins) {
        let from = ours.start + part as i64 * BIN;
        let window = samples_between(board()?, from, from + PART as i64 * BIN)?;
        for &lag in &lags {
            // Board bin i is bin i + lag of the other recording.
            let offset = theirs.start - ours.start + lag * BIN;
            let margin = (MARGIN * 2e9) as i64;
            let start = from.saturating_add(offset).saturating_sub(margin);
            let end = from
                .saturating_add(offset)
                .saturating_add(PART as i64 * BIN + margin);
            let around = samples_between(other()?, start, end)?;
            let options = Options {
                search: Some((offset as f64 * 1e-9, MARGIN)),
                ..*options
            };
            match estimate_offset(&track(&window), &track(&around), &options) {
                Ok(estimate) => return Ok(estimate.clock),
                Err(error) => reason = reason.or(Some(error.to_string())),
            }
        }
    }
    Err(no(
        &reason.unwrap_or_else(|| "the recordings are too short".into())
    ))
}

fn profile<E>(stream: impl Iterator<Item = Result<GyroSample, E>>) -> Result<Option<Profile>, E> {
    let mut start = None;
    let mut sums: Vec<(f32, u32)> = Vec::new();
    for sample in stream {
        let sample = sample?;
        let start = *start.get_or_insert(sample.at);
        let Ok(bin) = usize::try_from(sample.at.saturating_sub(start) / BIN) else {
            continue;
        };
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
            sums[bin].0 += rate as f32;
            sums[bin].1 += 1;
        }
    }
    Ok(start.map(|start| Profile {
        start,
        bins: sums
            .into_iter()
            .map(|(sum, count)| if count > 0 { sum / count as f32 } else { 0.0 })
            .collect(),
    }))
}

/// Lags (in bins: theirs = ours + lag) by falling correlation.
fn best_lags(ours: &[f32], theirs: &[f32]) -> Vec<i64> {
    let length = (ours.len() + theirs.len()).next_power_of_two();
    let mut planner = RealFftPlanner::<f32>::new();
    let forward = planner.plan_fft_forward(length);
    let backward = planner.plan_fft_inverse(length);
    let spectrum = |bins: &[f32]| {
        let mean = bins.iter().sum::<f32>() / bins.len().max(1) as f32;
        let mut input = forward.make_input_vec();
        for (slot, bin) in input.iter_mut().zip(bins) {
            *slot = bin - mean;
        }
        let mut output = forward.make_output_vec();
        // Lengths come from the plan itself.
        let _ = forward.process(&mut input, &mut output);
        output
    };
    let a = spectrum(ours);
    let mut product = spectrum(theirs);
    for (b, a) in product.iter_mut().zip(&a) {
        *b *= a.conj();
    }
    // The ends of a real signal's spectrum are real but for rounding.
    if let Some(first) = product.first_mut() {
        first.im = 0.0;
    }
    if let Some(last) = product.last_mut() {
        last.im = 0.0;
    }
    let mut correlation = backward.make_output_vec();
    let _ = backward.process(&mut product, &mut correlation);
    let mut order: Vec<usize> = (0..length).collect();
    order.sort_unstable_by(|&a, &b| correlation[b].total_cmp(&correlation[a]));
    let mut lags: Vec<i64> = Vec::new();
    for index in order.into_iter().take(length.min(100_000)) {
        let lag = if index < length / 2 {
            index as i64
        } else {
            index as i64 - length as i64
        };
        if lags
            .iter()
            .all(|&other| other.abs_diff(lag) as usize > APART)
        {
            lags.push(lag);
            if lags.len() == LAGS {
                break;
            }
        }
    }
    lags
}

/// First bins of the parts with the most motion, apart from each other.
fn busiest(bins: &[f32]) -> Vec<usize> {
    let power = |from: usize| -> f32 {
        let end = (from + PART).min(bins.len());
        bins[from..end].iter().map(|bin| bin * bin).sum()
    };
    let mut parts: Vec<(usize, f32)> = (0..bins.len())
        .step_by(PART / 4)
        .map(|from| (from, power(from)))
        .collect();
    parts.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut chosen: Vec<usize> = Vec::new();
    for (from, _) in parts {
        if chosen.iter().all(|other| other.abs_diff(from) >= PART) {
            chosen.push(from);
            if chosen.len() == PARTS {
                break;
            }
        }
    }
    chosen
}

fn samples_between<E>(
    stream: impl Iterator<Item = Result<GyroSample, E>>,
    from: i64,
    to: i64,
) -> Result<Vec<GyroSample>, E> {
    let mut samples = Vec::new();
    for sample in stream {
        let sample = sample?;
        if sample.at >= to || samples.len() >= super::MAX_WINDOW_SAMPLES {
            break;
        }
        if sample.at >= from {
            samples.push(sample);
        }
    }
    Ok(samples)
}
