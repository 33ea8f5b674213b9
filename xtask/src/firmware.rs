//! Builds of the firmware and of the phone's agent.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::{image, process, tools};

const TARGET: &str = "thumbv7em-none-eabihf";
const FIRMWARE: &str = "firmware";
const BLACK_PILL: [&str; 3] = ["--no-default-features", "--features", "black-pill"];
const AGENT: &str = "host/live/phone-agent";
const AGENT_PROGRAM: &str = "smartdepthsync-phone-agent";
/// Targets of the agent, with Android's names of their processors, by which its files are named.
const AGENT_TARGETS: [(&str, &str); 2] = [
    ("aarch64-unknown-none", "arm64-v8a"),
    ("armv7a-none-eabi", "armeabi-v7a"),
];
const FOREIGN: &str = "hil-sim/stm32f4-sim/foreign";
const FOREIGN_PACKAGES: &[&str] = &["-p", "foreign-hal"];

/// Builds all that the simulated rig needs: the firmware, whose ELF is returned, the agent, the
/// host tool and the simulator.
pub(crate) fn build_rig() -> Result<PathBuf> {
    let elf = build()?;
    build_agent()?;
    process::build_programs()?;
    Ok(elf)
}

/// Builds the firmware of both boards and the agent. Returns the ELF of the STM32F4DISCOVERY and
/// that of the Black Pill.
pub(crate) fn build_all() -> Result<[PathBuf; 2]> {
    let black_pill = build_black_pill()?;
    let elf = build()?;
    build_agent()?;
    Ok([elf, black_pill])
}

/// Builds the same and the foreign program that the tests of `stm32f4-sim` run. Returns the ELF
/// of the STM32F4DISCOVERY.
pub(crate) fn build_for_tests() -> Result<PathBuf> {
    let [elf, _] = build_all()?;
    // In one call of cargo with the firmware, features of their common dependencies would be
    // unified.
    let args = [&["build", "--release"], FOREIGN_PACKAGES].concat();
    cargo_for_target(FOREIGN, TARGET, &args)?;
    Ok(elf)
}

/// Builds the firmware of the STM32F4DISCOVERY in the release profile and returns its ELF.
pub(crate) fn build() -> Result<PathBuf> {
    built(&[])
}

/// Builds the firmware of the Black Pill and returns its ELF, a copy whose name ends in
/// `-black-pill`. Must be called before [`build`], which replaces the original.
pub(crate) fn build_black_pill() -> Result<PathBuf> {
    let elf = built(&BLACK_PILL)?;
    let kept = elf.with_file_name("smartdepthsync-firmware-black-pill");
    copy(&elf, &kept)?;
    Ok(kept)
}

/// Writes the DFU images of these ELFs beside the host tool, where `board flash` looks for them.
pub(crate) fn make_images(elves: &[&Path]) -> Result<()> {
    for elf in elves {
        let name = elf
            .file_name()
            .context("the path of an ELF has no file name")?;
        let to = process::program(name).with_extension("dfu");
        std::fs::write(&to, image::dfu_image(elf)?)
            .with_context(|| format!("cannot write {}", to.display()))?;
    }
    Ok(())
}

/// Builds the agent for each processor and copies it beside the host tool, which looks for it
/// there.
pub(crate) fn build_agent() -> Result<()> {
    for ((target, _), to) in AGENT_TARGETS.into_iter().zip(agents()) {
        cargo_for_target(AGENT, target, &["build", "--release", "--target", target])?;
        copy(
            &bare_metal().join(format!("{target}/release/{AGENT_PROGRAM}")),
            &to,
        )?;
    }
    Ok(())
}

/// Returns where [`build_agent`] puts the agents.
pub(crate) fn agents() -> impl Iterator<Item = PathBuf> {
    let agents = AGENT_TARGETS.into_iter();
    agents.map(|(_, processor)| process::program(format!("{AGENT_PROGRAM}-{processor}")))
}

/// Builds the firmware with these options and returns its ELF.
fn built(options: &[&str]) -> Result<PathBuf> {
    cargo_for_target(
        FIRMWARE,
        TARGET,
        &[&["build", "--release"], options].concat(),
    )?;
    Ok(bare_metal().join(format!("{TARGET}/release/smartdepthsync-firmware")))
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    let copied = std::fs::copy(from, to);
    copied.with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
    Ok(())
}

/// Lints these programs for their own targets: only there is the register code compiled.
pub(crate) fn clippy() -> Result<()> {
    let clippy = |folder, target, options: &[&str]| {
        let args = [&["clippy", "--release"], options, &["--", "-D", "warnings"]].concat();
        cargo_for_target(folder, target, &args)
    };
    clippy(FIRMWARE, TARGET, &[])?;
    clippy(FIRMWARE, TARGET, &BLACK_PILL)?;
    clippy(FOREIGN, TARGET, FOREIGN_PACKAGES)?;
    for (target, _) in AGENT_TARGETS {
        clippy(AGENT, target, &["--target", target])?;
    }
    Ok(())
}

/// Returns cargo's target folder of the programs that run without an operating system. It is not
/// the host's: cargo locks the folder in which it builds, and both are built at the same time.
fn bare_metal() -> PathBuf {
    process::target_dir().join("bare-metal")
}

/// Runs cargo in a folder whose programs run without an operating system.
fn cargo_for_target(folder: &str, target: &str, args: &[&str]) -> Result<()> {
    tools::ensure_target(target)?;
    let mut cargo = process::command(process::cargo_program());
    // The folder's own .cargo/config.toml sets target and profile, as for `cargo run` there.
    cargo
        .current_dir(process::root().join(folder))
        .env("CARGO_TARGET_DIR", bare_metal());
    if target == TARGET {
        // The debug information names the source files by these folders.
        let options = process::remapped();
        cargo.arg(format!("--config=target.{TARGET}.rustflags={options:?}"));
    }
    process::run(cargo.args(args))
}

#[cfg(test)]
mod tests {
    use std::fs::{self, Permissions};
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    /// Starts the runners of cargo's configuration with a tiny program for the chip and a `probe-rs`
    /// that prints its arguments. Without these flags `probe-rs run` halts the core at each reset
    /// and fault (its `cmd/run.rs`: `VectorCatchConfig`).
    #[test]
    fn the_runners_of_both_boards_catch_neither_reset_nor_fault() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let file = |name: &str| folder.path().join(name);
        let manifest = "[package]\nname = 'nothing'\nedition = '2024'\n[workspace]\n[features]\nblack-pill = []\n";
        fs::write(file("Cargo.toml"), manifest)?;
        let program = "#![no_std]\n#![no_main]\n#[panic_handler]\nfn halt(_: &core::panic::PanicInfo<'_>) -> ! {\n    loop {}\n}\n";
        fs::create_dir(file("src"))?;
        fs::write(file("src/main.rs"), program)?;
        fs::write(file("probe-rs"), "#!/bin/sh\necho \"$@\"\n")?;
        fs::set_permissions(file("probe-rs"), Permissions::from_mode(0o755))?;
        let path = std::env::var_os("PATH").unwrap_or_default();
        let path = std::iter::once(folder.path().into()).chain(std::env::split_paths(&path));
        let path = std::env::join_paths(path)?;
        for (commands, chip) in [
            (&["run", "--release"][..], "STM32F407VGTx"),
            (&["black-pill"], "STM32F411CEUx"),
        ] {
            let called = process::text(
                process::command(process::cargo_program())
                    .current_dir(process::root().join(FIRMWARE))
                    .args(commands)
                    .arg("--manifest-path")
                    .arg(file("Cargo.toml"))
                    .env("CARGO_TARGET_DIR", file("target"))
                    .env("PATH", &path),
            )?;
            let expected = format!("run --no-catch-reset --no-catch-hardfault --chip {chip} ");
            assert!(called.starts_with(&expected), "{called}");
        }
        Ok(())
    }
}
