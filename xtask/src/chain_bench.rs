//! Extraction, evaluation and calibration on recordings of the whole simulated
//! rig, by the truth (`hil-sim chain`).

use std::path::Path;

use anyhow::Result;

use crate::process;

/// `cargo xtask bench --chain`: all three, the recordings under `target/chain`.
pub(crate) fn run(elf: &Path, seconds: u32, seeds: u32) -> Result<()> {
    let out = process::target_dir().join("chain").display().to_string();
    let (seconds, seeds) = (seconds.to_string(), seeds.to_string());
    for what in [
        &["extract", "--seconds", &seconds][..],
        &["evaluate", "--seeds", &seeds],
        &["calibrate"],
    ] {
        let args = [&["chain"], what, &["--out", &out]].concat();
        process::run_hil_sim(&args, elf)?;
        println!();
    }
    Ok(())
}
