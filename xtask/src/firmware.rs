//! The firmware's ELF and the phone's agent, and a compiler for their targets.
//!
//! Three routes to `core` for such a target, tried in this order:
//!
//! 1. the active toolchain has the target;
//! 2. `rustup target add` fetches it;
//! 3. Debian's `rustc-web` with its library source (`rust-web-src`): cargo
//!    stays rustup's, `core` is built from source with Debian's compiler.
//!    Installed through apt when we are root.
//!
//! `SMARTDEPTHSYNC_TARGET_ROUTE=debian` forces the third, to try it out.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::{image, process, tools};

const TARGET: &str = "thumbv7em-none-eabihf";
const FIRMWARE: &str = "firmware";
const BLACK_PILL: [&str; 3] = ["--no-default-features", "--features", "black-pill"];
const AGENT: &str = "host/phone-agent";
const AGENT_PROGRAM: &str = "smartdepthsync-phone-agent";
/// Targets of the agent, and what its files are called: by Android's names of processors.
const AGENT_TARGETS: [(&str, &str); 2] = [
    ("aarch64-unknown-none", "arm64-v8a"),
    ("armv7a-none-eabi", "armeabi-v7a"),
];
/// The agent is smaller than this, bytes.
const AGENT_MOST: u64 = 20_000;
const FOREIGN: &str = "hil-sim/stm32f4-sim/foreign";
const FOREIGN_PACKAGES: &[&str] = &["-p", "foreign-embassy", "-p", "foreign-hal"];
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const DEBIAN_SOURCE: &str = "/usr/lib/rustlib/src/rust/library/core/Cargo.toml";
const DEBIAN_PACKAGES: [&str; 2] = ["rustc-web", "rust-web-src"];
const ROUTE_VARIABLE: &str = "SMARTDEPTHSYNC_TARGET_ROUTE";

/// The oldest minor version of Rust 1.x that builds this workspace.
const OLDEST_MINOR: u32 = 91;

/// How the firmware is compiled.
enum Route {
    /// The active toolchain has the target.
    Toolchain,
    /// Debian's compiler builds `core` from its source.
    Debian { linker: PathBuf },
}

/// Builds all of the simulated rig: the firmware, the host tool and the simulator.
/// Gives the path of the ELF.
pub(crate) fn build_rig() -> Result<PathBuf> {
    let elf = build()?;
    build_agent()?;
    process::build_programs()?;
    Ok(elf)
}

/// A board that the firmware is built for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Board {
    /// STM32F4DISCOVERY
    #[default]
    Discovery,
    /// WeAct Black Pill (STM32F411CE)
    BlackPill,
}

/// Builds the firmware of the STM32F4DISCOVERY in the release profile and returns its ELF.
pub(crate) fn build() -> Result<PathBuf> {
    built(&["build", "--release"])
}

/// Builds the firmware in the release profile and gives it to the runner of its target
/// (`.cargo/config.toml`), which flashes it.
pub(crate) fn flash(board: Board) -> Result<()> {
    match board {
        Board::Discovery => cargo_for_target(FIRMWARE, TARGET, &["run", "--release"]),
        // An alias of the folder's `.cargo/config.toml`.
        Board::BlackPill => cargo_for_target(FIRMWARE, TARGET, &["black-pill"]),
    }
}

/// Builds the firmware of the Black Pill, beside that of the STM32F4DISCOVERY: the name of its
/// ELF, which is returned, ends in `-black-pill`. To be called before [`build`].
pub(crate) fn build_black_pill() -> Result<PathBuf> {
    let elf = built(&[&["build", "--release"], &BLACK_PILL[..]].concat())?;
    keep(&elf, "-black-pill")
}

/// Builds the firmware with a wrong PLL factor, beside the right one: the name
/// of its ELF ends in `-wrong-pll`. A test of the simulator runs it. To be
/// called before [`build`], which leaves the right one under its own name.
pub(crate) fn build_with_wrong_pll() -> Result<()> {
    let elf = built(&["build", "--release", "--features", "wrong-pll"])?;
    keep(&elf, "-wrong-pll").map(drop)
}

/// Puts the images of these ELFs beside the host tool, where `board flash` looks for them.
pub(crate) fn make_images(elves: &[&Path]) -> Result<()> {
    for elf in elves {
        let name = elf.file_name().context("an ELF without a name")?;
        let to = process::target_dir()
            .join("release")
            .join(name)
            .with_extension("dfu");
        std::fs::write(&to, image::dfu_image(elf)?)
            .with_context(|| format!("cannot write {}", to.display()))?;
    }
    Ok(())
}

/// Copies an ELF to the same name with an ending, and returns that.
fn keep(elf: &Path, ending: &str) -> Result<PathBuf> {
    let mut kept = elf.as_os_str().to_owned();
    kept.push(ending);
    let kept = PathBuf::from(kept);
    std::fs::copy(elf, &kept)
        .with_context(|| format!("cannot copy {} to {}", elf.display(), kept.display()))?;
    Ok(kept)
}

/// Builds the programs that the tests of `stm32f4-sim` run beside the firmware. Not
/// in one call of cargo with it: the features of what both depend on would add up.
pub(crate) fn build_foreign() -> Result<()> {
    cargo_for_target(
        FOREIGN,
        TARGET,
        &[&["build", "--release"], FOREIGN_PACKAGES].concat(),
    )
}

/// Builds the agent for phones of each processor, and puts it beside the host tool, where
/// that looks for it.
pub(crate) fn build_agent() -> Result<()> {
    for ((target, _), to) in AGENT_TARGETS.into_iter().zip(agents()) {
        cargo_for_target(AGENT, target, &["build", "--release", "--target", target])?;
        let from = process::target_dir()
            .join(target)
            .join("release")
            .join(AGENT_PROGRAM);
        let folder = to.parent().unwrap_or(&to);
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make {}", folder.display()))?;
        let size = std::fs::copy(&from, &to)
            .with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
        if size >= AGENT_MOST {
            bail!(
                "{} has {size} bytes; expected less than {AGENT_MOST}",
                to.display()
            );
        }
    }
    Ok(())
}

/// Where the agents are once they are built.
pub(crate) fn agents() -> impl Iterator<Item = PathBuf> {
    let folder = process::target_dir().join("release");
    AGENT_TARGETS
        .into_iter()
        .map(move |(_, processor)| folder.join(format!("{AGENT_PROGRAM}-{processor}")))
}

/// Runs cargo and returns the ELF that it leaves.
fn built(args: &[&str]) -> Result<PathBuf> {
    cargo_for_target(FIRMWARE, TARGET, args)?;
    let elf = process::target_dir()
        .join(TARGET)
        .join("release")
        .join("smartdepthsync-firmware");
    if !elf.is_file() {
        bail!(
            "cargo built the firmware, but there is no {}",
            elf.display()
        );
    }
    Ok(elf)
}

/// Lints the programs for the chip's target, where the register code is compiled.
/// Debian's compiler brings no clippy: there a build without warnings has to do.
pub(crate) fn clippy() -> Result<()> {
    let strictly = ["--", "-D", "warnings"];
    let clippy = ["clippy", "--release"];
    match route(TARGET)? {
        Route::Toolchain => {
            cargo_for_target(FIRMWARE, TARGET, &[&clippy[..], &strictly].concat())?;
            let args = [&clippy[..], &BLACK_PILL, &strictly].concat();
            cargo_for_target(FIRMWARE, TARGET, &args)?;
            cargo_for_target(
                FOREIGN,
                TARGET,
                &[&clippy, FOREIGN_PACKAGES, &strictly].concat(),
            )?;
        }
        Route::Debian { .. } => {
            build_black_pill()?;
            build()?;
            build_foreign()?;
        }
    }
    for (target, _) in AGENT_TARGETS {
        let target_args = ["--target", target];
        let args = match route(target)? {
            Route::Toolchain => [&clippy[..], &target_args, &strictly].concat(),
            Route::Debian { .. } => [&["build", "--release"], &target_args[..]].concat(),
        };
        cargo_for_target(AGENT, target, &args)?;
    }
    Ok(())
}

/// Runs cargo in a folder whose programs are for a target without a system.
fn cargo_for_target(folder: &str, target: &str, args: &[&str]) -> Result<()> {
    let mut cargo = process::command(process::cargo_program());
    // The folder's own .cargo/config.toml sets target and profile, as for `cargo run` there.
    cargo
        .current_dir(process::root().join(folder))
        .env("CARGO_TARGET_DIR", process::target_dir());
    let (before, after) = match args.iter().position(|&arg| arg == "--") {
        Some(at) => args.split_at(at),
        None => (args, &[][..]),
    };
    cargo.args(before);
    if target == TARGET {
        // Its debug information names the sources, there by their folders.
        let options = process::remapped();
        cargo.arg(format!("--config=target.{TARGET}.rustflags={options:?}"));
    }
    if let Route::Debian { linker } = route(target)? {
        let target = target.to_uppercase().replace('-', "_");
        cargo
            .arg("-Zbuild-std=core")
            .env("RUSTC", DEBIAN_RUSTC)
            .env("RUSTC_BOOTSTRAP", "1")
            .env(format!("CARGO_TARGET_{target}_LINKER"), linker);
    }
    process::run(cargo.args(after))
}

fn route(target: &str) -> Result<Route> {
    let forced = env::var(ROUTE_VARIABLE).unwrap_or_default();
    match forced.as_str() {
        "" => {}
        "debian" => return debian(target),
        other => bail!("{ROUTE_VARIABLE} is {other:?}; it can be unset or \"debian\""),
    }
    if tools::add_target(target)? {
        return Ok(Route::Toolchain);
    }
    debian(target)
}

fn debian(target: &str) -> Result<Route> {
    if !debian_ready() {
        tools::apt_install(&DEBIAN_PACKAGES).with_context(|| {
            format!(
                "there is no Rust library for {target}; run `rustup target add {target}`, \
                 or on Debian `sudo apt-get install {}`",
                DEBIAN_PACKAGES.join(" ")
            )
        })?;
    }
    if !debian_ready() {
        bail!(
            "{DEBIAN_RUSTC} is older than Rust 1.{OLDEST_MINOR} or its library source is missing; \
             run `rustup target add {target}`, or on Debian 12 with its security archive \
             `sudo apt-get install {}`",
            DEBIAN_PACKAGES.join(" ")
        );
    }
    let linker = tools::sysroot()?.join("lib/rustlib/x86_64-unknown-linux-gnu/bin/rust-lld");
    if linker.is_file() {
        return Ok(Route::Debian { linker });
    }
    for candidate in ["rust-lld", "ld.lld"] {
        if process::answers(candidate, &["-flavor", "gnu", "--version"])
            || process::answers(candidate, &["--version"])
        {
            let linker = PathBuf::from(candidate);
            return Ok(Route::Debian { linker });
        }
    }
    bail!("no linker for {target}: run `sudo apt-get install lld`")
}

fn debian_ready() -> bool {
    Path::new(DEBIAN_SOURCE).is_file()
        && minor_version(DEBIAN_RUSTC).is_some_and(|minor| minor >= OLDEST_MINOR)
}

/// The `x` of `rustc 1.x.y`.
fn minor_version(rustc: &str) -> Option<u32> {
    let text = process::text(Command::new(rustc).arg("--version")).ok()?;
    let version = text.split_whitespace().nth(1)?;
    version.split('.').nth(1)?.parse().ok()
}
