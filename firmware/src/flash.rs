//! The program that `cargo run` starts at the root of the workspace, on this computer: has cargo
//! put the firmware on a board through probe-rs, which then shows the board's log.
//!
//! The options of probe-rs are in `firmware/.cargo/config.toml`, as for `cargo run` in that folder.

use std::env;
use std::path::Path;
use std::process::{Command, ExitCode};

/// Next steps where the firmware cannot be flashed.
const OTHERWISE: &str = "\
without a probe: `cargo xtask build`, then `target/release/smartdepthsync board flash` over USB (DFU)
without a board: `cargo xtask demo` records two sessions on the simulated rig";

pub(crate) fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("error: {reason}\n{OTHERWISE}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), String> {
    let command: &[&str] = match env::args().nth(1).as_deref() {
        None | Some("discovery") => &["run", "--release"],
        Some("black-pill") => &["black-pill"],
        Some(other) => return Err(format!("{other:?}: expected no argument, or `black-pill`")),
    };
    find_probe()?;
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo
        .args(command)
        .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")));
    // What cargo has set for this program alone would have others built again.
    for (name, _) in env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PKG_") || text.starts_with("CARGO_MANIFEST_") {
            cargo.env_remove(name);
        }
    }
    let status = cargo
        .status()
        .map_err(|error| format!("cannot start cargo: {error}"))?;
    if status.success() {
        Ok(())
    } else {
        Err(String::from(
            "the board does not run the firmware: the reason is above",
        ))
    }
}

/// Returns an error unless probe-rs finds a debug probe.
fn find_probe() -> Result<(), String> {
    let listed = Command::new("probe-rs").arg("list").output();
    let listed = listed.map_err(|error| {
        format!(
            "`cargo run` flashes the board through probe-rs, which cannot be started ({error}); \
             install it: https://probe.rs/docs/getting-started/installation"
        )
    })?;
    // A line for each: `[0]: STLink V2-1 -- 0483:374b:066... (ST-LINK)`.
    let text = String::from_utf8_lossy(&listed.stdout);
    if text.lines().any(|line| line.starts_with('[')) {
        return Ok(());
    }
    Err(String::from(
        "probe-rs finds no debug probe; connect the mini-USB socket of the STM32F4DISCOVERY, or an \
         ST-LINK to the Black Pill, and see https://probe.rs/docs/getting-started/probe-setup",
    ))
}
