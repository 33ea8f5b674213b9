//! A pair of recordings as it can be given away: times from the first sample of each, no
//! names, and all that is needed to judge it again.

use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;

use super::{Input, Output};
use crate::outcome::{Failure, write_file};
use twist_sync::{GyroTrack, Options, estimate_offset};

/// What `result.json` holds.
#[derive(Serialize)]
struct Exported {
    version: &'static str,
    low_pass_hz: f64,
    max_sigma_us: f64,
    faults_handled: bool,
    /// Of the exported files; its offset is that of their times.
    result: Output,
}

/// Writes `mcu.csv`, `phone.csv` and `result.json`.
pub(super) fn write(
    folder: &Path,
    tracks: [&GyroTrack; 2],
    options: &Options,
) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(|error| Failure::file("write", folder, &error))?;
    let names = ["mcu.csv", "phone.csv"];
    let relative = tracks.map(|track| GyroTrack {
        epoch_s: 0.0,
        ..track.clone()
    });
    let inputs = [0, 1].map(|k| Input {
        file: names[k].to_owned(),
        form: String::from("header: time_ns in nanoseconds, x, y, z in rad/s"),
        samples: relative[k].len(),
        duration_s: relative[k].t.last().copied().unwrap_or(0.0),
    });
    let result = estimate_offset(&relative[0], &relative[1], options);
    let exported = Exported {
        version: env!("CARGO_PKG_VERSION"),
        low_pass_hz: options.low_pass_hz,
        max_sigma_us: options.sigma_limit_s * 1e6,
        faults_handled: options.handle_faults,
        result: Output::new(&result, options, inputs),
    };
    let json = serde_json::to_string_pretty(&exported).unwrap_or_default();
    let files = [csv(&relative[0]), csv(&relative[1]), json + "\n"];
    for (name, text) in names.into_iter().chain(["result.json"]).zip(files) {
        write_file(&folder.join(name), &text)?;
    }
    Ok(())
}

fn csv(track: &GyroTrack) -> String {
    let mut out = String::from("time_ns,x,y,z\n");
    for (t, [x, y, z]) in track.t.iter().zip(&track.w) {
        // Saturates: a wild timestamp stays one.
        let nanos = (t * 1e9).round() as i64;
        let _ = writeln!(out, "{nanos},{x},{y},{z}");
    }
    out
}
