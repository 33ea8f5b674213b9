//! The timestamps of the other recordings in the time of the first one's clock.

use std::fmt::Write as _;
use std::path::Path;

use gyro_files::GyroRecording;
use twist_sync::WithSigma;
use twist_sync::network::Network;

use super::nanos_from;
use crate::outcome::{Failure, write_file};

/// Between two knots the relation is a straight line, seconds.
const KNOT_S: f64 = 1.0;
/// Most knots: a month.
const MOST_KNOTS: f64 = 31.0 * 86_400.0;

/// Writes `2_NAME.csv` and so on: `time_ns` of its own clock, `first_ns` of the first one's,
/// `sigma_ns`; and for recordings with frames, also of the first, `2_NAME_frames.csv`: middle of
/// exposure of the first, middle and last row in the first one's time.
pub(super) fn timestamps(
    folder: &Path,
    network: &Network,
    recordings: &[GyroRecording],
    names: &[&Path],
) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(|error| Failure::file("create", folder, &error))?;
    let first = recordings[0].first();
    for (k, recording) in recordings.iter().enumerate() {
        if k == 0 && recording.frames.is_empty() {
            continue;
        }
        let stem = names[k].file_stem().unwrap_or_default().to_string_lossy();
        let save = |what: &str, table: &str| {
            let path = folder.join(format!("{}_{stem}{what}.csv", k + 1));
            write_file(&path, table)
        };
        let knots = Knots::new(network, k, recording);
        let there = |time: i64| {
            let there = knots.at(time.saturating_sub(recording.first()) as f64 * 1e-9);
            (nanos_from(first, there.value), there.sigma * 1e9)
        };
        if k > 0 {
            let mut out = String::from("time_ns,first_ns,sigma_ns\n");
            for &time in &recording.times {
                let (first_ns, sigma_ns) = there(time);
                let _ = writeln!(out, "{time},{first_ns},{sigma_ns:.0}");
            }
            save("", &out)?;
        }
        if !recording.frames.is_empty() {
            let mut out = String::from("frame,first_row_ns,middle_row_ns,last_row_ns,sigma_ns\n");
            for (number, frame) in recording.frames.iter().enumerate() {
                let [top, (middle, sigma_ns), bottom] = frame.rows_ns().map(there);
                let _ = writeln!(
                    out,
                    "{number},{},{middle},{},{sigma_ns:.0}",
                    top.0, bottom.0
                );
            }
            save("_frames", &out)?;
        }
    }
    Ok(())
}

/// Times of the first clock and of another one, from the first samples of each.
struct Knots {
    own: Vec<f64>,
    first: Vec<WithSigma>,
}

impl Knots {
    fn new(network: &Network, device: usize, recording: &GyroRecording) -> Self {
        let length = recording.times.iter().max().copied().unwrap_or(0);
        let length_s = length.saturating_sub(recording.first()) as f64 * 1e-9;
        // The offset changes by a part in a thousand at most: a knot more on either side
        // covers what it is off at the ends.
        let starts_s = -network.at(0.0)[device].value;
        let margin_s = KNOT_S + 1e-3 * (length_s + starts_s.abs());
        let count = ((length_s + 2.0 * margin_s) / KNOT_S)
            .ceil()
            .min(MOST_KNOTS) as u64;
        let mut out = Self {
            own: Vec::new(),
            first: Vec::new(),
        };
        for k in 0..=count {
            let at = starts_s - margin_s + k as f64 * KNOT_S;
            let offset = network.at(at)[device];
            out.own.push(at + offset.value);
            out.first.push(WithSigma {
                value: at,
                sigma: offset.sigma,
            });
        }
        out
    }

    /// The time of the first clock at a time of the other one.
    fn at(&self, own_s: f64) -> WithSigma {
        let after = self.own.partition_point(|&t| t <= own_s);
        let after = after.clamp(1, self.own.len() - 1);
        let (from, to) = (self.own[after - 1], self.own[after]);
        let part = (own_s - from) / (to - from);
        let (low, high) = (self.first[after - 1], self.first[after]);
        WithSigma {
            value: low.value + part * (high.value - low.value),
            sigma: low.sigma + part.clamp(0.0, 1.0) * (high.sigma - low.sigma),
        }
    }
}
