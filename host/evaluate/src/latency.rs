//! From the trigger's edge to the centre of exposure, by a photodiode on the
//! board's strobe input: the second route to a depth camera's constant, without
//! any video.
//!
//! Pulses and edges of the strobes are both in ticks of one timer, so nothing has
//! to be related. The edges between a pulse and the next are that pulse's train
//! if they are just as many as the train has, rising and falling in turn, and
//! none was lost; other pulses are left out and counted. The centre of exposure is
//! the mean of the flashes' middles.
//!
//! Limits: the light path's own delay (photodiode, comparator) is in the result.
//! Pulses must be further apart than the camera's delay and train together.

use protocol::{Capture, Edge, TICK_HZ, Ticks};
use serde::Serialize;

use super::stats::{mean, standard_deviation};
use super::train::TrainGeometry;

/// Mean and spread of one quantity, µs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantity {
    pub mean_us: f64,
    /// Standard deviation of a single one.
    pub sd_us: f64,
    /// Standard uncertainty of the mean, with that of a tick.
    pub sigma_us: f64,
}

impl Quantity {
    fn of(values: &[f64]) -> Self {
        let sd_us = standard_deviation(values).unwrap_or(0.0);
        // Ticks may round all values the same way.
        let tick = 1e6 / f64::from(TICK_HZ) / 12.0_f64.sqrt();
        Self {
            mean_us: mean(values),
            sd_us,
            sigma_us: (sd_us / (values.len().max(1) as f64).sqrt()).hypot(tick),
        }
    }
}

/// Result of the captures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Latency {
    /// Pulses with a whole train.
    pub pulses: usize,
    /// Pulses without one.
    pub left_out: usize,
    /// From the rising edge of the pulse to the centre of exposure.
    pub center: Quantity,
    /// From the rising edge of the pulse to the start of the first flash.
    pub first_flash: Quantity,
    /// From flash to flash.
    pub pitch: Quantity,
    /// Length of a flash as the photodiode sees it.
    pub duration: Quantity,
}

/// Ticks as µs.
fn micros(ticks: u64) -> f64 {
    ticks as f64 * 1e6 / f64::from(TICK_HZ)
}

/// Starts and ends of the flashes of one pulse, µs after it; `None` unless they
/// are a whole train.
fn flashes(pulse: Ticks, captures: &[&Capture], train: &TrainGeometry) -> Option<Vec<(f64, f64)>> {
    if captures.len() != 2 * train.count as usize || captures.iter().any(|c| c.after_loss) {
        return None;
    }
    captures
        .chunks_exact(2)
        .map(|pair| match pair {
            [start, end] if start.edge == Edge::Rising && end.edge == Edge::Falling => {
                Some((micros(start.at.0 - pulse.0), micros(end.at.0 - pulse.0)))
            }
            _ => None,
        })
        .collect()
}

/// Latency from the rising edges of pulses and the edges of the strobes, in any
/// order. The last pulse has no end and does not count. `None` if no pulse has a
/// whole train.
#[must_use]
pub fn latency(pulses: &[Ticks], captures: &[Capture], train: &TrainGeometry) -> Option<Latency> {
    let mut pulses = pulses.to_vec();
    pulses.sort_unstable();
    let mut captures: Vec<&Capture> = captures.iter().collect();
    captures.sort_by_key(|c| c.at);
    let place = |at: Ticks| captures.partition_point(|c| c.at < at);
    let (mut centers, mut firsts) = (Vec::new(), Vec::new());
    let (mut pitches, mut durations) = (Vec::new(), Vec::new());
    let mut left_out = 0;
    for pair in pulses.windows(2) {
        let own = captures.get(place(pair[0])..place(pair[1])).unwrap_or(&[]);
        let Some(flashes) = flashes(pair[0], own, train) else {
            left_out += 1;
            continue;
        };
        let middles: Vec<f64> = flashes.iter().map(|f| 0.5 * (f.0 + f.1)).collect();
        centers.push(mean(&middles));
        firsts.extend(flashes.first().map(|f| f.0));
        let between: Vec<f64> = middles.windows(2).map(|m| m[1] - m[0]).collect();
        if !between.is_empty() {
            pitches.push(mean(&between));
        }
        durations.push(mean(&flashes.iter().map(|f| f.1 - f.0).collect::<Vec<_>>()));
    }
    (!centers.is_empty()).then(|| Latency {
        pulses: centers.len(),
        left_out,
        center: Quantity::of(&centers),
        first_flash: Quantity::of(&firsts),
        pitch: Quantity::of(&pitches),
        duration: Quantity::of(&durations),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::CaptureChannel;

    const PERIOD: u64 = 1_600_000;

    fn train(pulse: u64, delay: u64) -> Vec<Capture> {
        (0..18)
            .map(|k| Capture {
                seq: 0,
                channel: CaptureChannel::Strobe,
                edge: if k % 2 == 0 {
                    Edge::Rising
                } else {
                    Edge::Falling
                },
                // 1,575 µs from start to start, 125 µs long.
                at: Ticks(pulse * PERIOD + delay + k / 2 * 75_600 + k % 2 * 6_000),
                after_loss: false,
            })
            .collect()
    }

    #[test]
    fn the_centre_is_the_middle_of_the_train() {
        let pulses: Vec<Ticks> = (0..11).map(|k| Ticks(k * PERIOD)).collect();
        // 500 µs, and a tick more every other time.
        let captures: Vec<Capture> = (0..11).flat_map(|k| train(k, 24_000 + k % 2)).collect();
        let found = latency(&pulses, &captures, &TrainGeometry::NFOV).unwrap();
        assert_eq!((found.pulses, found.left_out), (10, 0));
        let half_tick = 0.5e6 / 48e6;
        assert!((found.center.mean_us - 6862.5 - half_tick).abs() < 1e-6);
        assert!((found.first_flash.mean_us - 500.0 - half_tick).abs() < 1e-6);
        assert!((found.pitch.mean_us - 1575.0).abs() < 1e-6);
        assert!((found.duration.mean_us - 125.0).abs() < 1e-6);
        assert!((0.006..0.01).contains(&found.center.sigma_us), "{found:?}");
    }

    #[test]
    fn pulses_without_a_whole_train_are_left_out() {
        let pulses: Vec<Ticks> = (0..6).map(|k| Ticks(k * PERIOD)).collect();
        let mut captures: Vec<Capture> = (2..6).flat_map(|k| train(k, 24_000)).collect();
        captures.remove(5); // of pulse 2
        captures[17 + 4].after_loss = true; // of pulse 3
        let found = latency(&pulses, &captures, &TrainGeometry::NFOV).unwrap();
        assert_eq!((found.pulses, found.left_out), (1, 4));
        assert_eq!(
            latency(&pulses, &captures[..17], &TrainGeometry::NFOV),
            None
        );
        assert_eq!(latency(&[], &[], &TrainGeometry::NFOV), None);
    }
}
