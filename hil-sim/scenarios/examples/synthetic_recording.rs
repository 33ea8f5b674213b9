//! Writes a synthetic recording (see `tests/it/synthetic.rs`): input for the
//! extraction's bench, and for a look at its outputs.
//!
//! usage: synthetic_recording FOLDER SECONDS [--depth WIDTHxHEIGHT] [--phone] [--seed N]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../tests/it/synthetic.rs"]
mod synthetic;

use std::path::PathBuf;

use clap::Parser;
use synthetic::{Synthetic, make};

/// Write a synthetic recording with known motion and clocks.
#[derive(Parser)]
struct SyntheticArgs {
    /// A folder that is not there yet
    folder: PathBuf,
    /// Length of the recording
    seconds: u64,
    /// Depth images of this size
    #[arg(long, value_parser = size)]
    depth: Option<(u32, u32)>,
    /// The phone's gyroscope, accelerometer and frame timestamps
    #[arg(long)]
    phone: bool,
    /// Seed of all that is random
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let parts = text
        .split_once('x')
        .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    parts.ok_or_else(|| "expected WIDTHxHEIGHT".into())
}

fn main() {
    let args = SyntheticArgs::parse();
    std::fs::create_dir_all(&args.folder).expect("the folder cannot be made");
    let truth = make(
        &args.folder,
        &Synthetic {
            seed: args.seed,
            seconds: args.seconds,
            depth: args.depth.is_some(),
            phone: args.phone,
            image: args.depth.unwrap_or((32, 18)),
            pixels: synthetic::scene,
            ..Synthetic::default()
        },
    );
    println!(
        "{} IMU samples, {} pulses, {} phone frames, {} depth frames",
        truth.imu_samples,
        truth.pulses_ns.len(),
        truth.color_start_ns.len(),
        truth.depth.len()
    );
}
