//! `cargo xtask`: the single entry point, the same locally and in CI.
//!
//! Every command sets up what it needs (the firmware's target, the Python
//! environment, ffmpeg), or stops and prints the one command to run. It calls
//! cargo and other programs as processes and depends on no other crate of this
//! workspace, so it builds in seconds.

mod dependencies;
mod docs;
mod figures;
mod firmware;
mod image;
mod process;
mod release;
mod tidy;
mod tools;
mod wheel;

use std::panic::resume_unwind;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::{Parser, Subcommand};

/// Build, test, demo and bench SmartDepthSync.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Build the firmware for the board, the host tool and the simulator.
    Build,
    /// Run every test, on the host and in the simulator.
    Test {
        /// Do what `check --no-book` does too, in the time that the tests leave of the processor.
        #[arg(long, conflicts_with = "cargo_args")]
        check: bool,
        /// Passed on to cargo test, for example `-p smartdepthsync verify_command`.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        cargo_args: Vec<String>,
    },
    /// Run a whole session on the simulated rig and compare it with the ground truth.
    Demo {
        /// Passed on to `hil-sim demo`, for example `--rig multi`. Paths are from the root.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        args: Vec<String>,
    },
    /// Build all that the simulated rig needs, and run `hil-sim`.
    HilSim {
        /// Passed on, for example `faults --count 20`. Paths are from the root.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        args: Vec<String>,
    },
    /// Boot a Linux kernel in QEMU with the simulated board at its USB, and work with it there.
    LinuxUsb,
    /// Check formatting, lints, dependencies, the rules of the source tree and the book.
    Check {
        /// Check the book's links without building the book: building mdBook
        /// itself takes minutes.
        #[arg(long)]
        no_book: bool,
    },
    /// Run the readers that are too large for every test run (Open3D, Rerun, LeRobot; the first
    /// time downloads 5.6 GB) and ROS 1's own reader on data sets of the simulated rig, and the
    /// fleet on two nodes.
    Readers,
    /// Measure a part of the host with its script, `xtask/PART_bench.py`: the clock estimate
    /// against the published Python package, or the extraction against a plain Python reader.
    /// Figures are comparable within one run only.
    Bench {
        #[arg(value_parser = ["sync", "extract"])]
        part: String,
        /// Twists per scenario (300), or minutes of depth at full size (10; 1.3 GB each).
        size: Option<u32>,
    },
    /// Make all files of a release, for amd64 and arm64, in `target/dist`, and try them on a system
    /// without Rust.
    Release,
    /// Build the Python packages twist-sync and smartdepthsync-data, install the first into
    /// target/venv, and test it there.
    Wheel,
    /// Build the book into target/book and check its links.
    Docs,
    /// Redraw the book's figures from simulated runs.
    DocsFigures,
}

fn run(command: Command) -> Result<()> {
    match command {
        Command::Build => build(),
        Command::Test { check: true, .. } => {
            test_all(|| both(wheel::build_and_test(), idle_check()))
        }
        Command::Test { cargo_args, .. } => {
            test(&cargo_args.iter().map(String::as_str).collect::<Vec<_>>())
        }
        Command::Demo { args } => hil_sim(&[&["demo".to_owned()], &args[..]].concat()),
        Command::HilSim { args } => hil_sim(&args),
        Command::Check { no_book } => check(no_book),
        Command::Readers => readers(),
        Command::LinuxUsb => linux_usb(),
        Command::Bench { part, size } => bench(&part, size),
        Command::Release => release::make(),
        Command::Wheel => wheel::build_and_test(),
        Command::Docs => docs::build_and_check(),
        Command::DocsFigures => figures::make(),
    }
}

fn build() -> Result<()> {
    let (elves, workspace) = beside(firmware::build_all, || {
        process::cargo(["build", "--release", "--workspace"])
    });
    workspace?;
    let [elf, black_pill] = elves?;
    firmware::make_images(&[&elf, &black_pill])?;
    println!("firmware: {}", elf.display());
    Ok(())
}

fn test(cargo_args: &[&str]) -> Result<()> {
    if cargo_args.is_empty() {
        return test_all(wheel::build_and_test);
    }
    let elf = ready_for_tests()?;
    process::cargo_with_elf(&[&["test", "--release"], cargo_args].concat(), &elf)
}

/// Prepares all that tests need except the workspace, and returns the firmware's ELF.
fn ready_for_tests() -> Result<PathBuf> {
    tools::ensure_for_tests()?;
    tools::ensure_python()?;
    firmware::build_for_tests()
}

/// Runs every test of the workspace, and at the same time `others`.
fn test_all(others: impl FnOnce() -> Result<()> + Send) -> Result<()> {
    // A single build often waits for one crate or for a download.
    let (elf, workspace) = beside(ready_for_tests, || {
        process::cargo("test --release --workspace --no-run".split(' '))
    });
    let elf = elf.and_then(|elf| workspace.map(|()| elf))?;
    let (others, tests) = beside(others, || {
        process::cargo_with_elf(
            &["test", "--release", "--workspace", "--no-fail-fast"],
            &elf,
        )
    });
    both(tests, others)
}

/// Runs `check` with a lower priority: it takes the processor only while the tests wait.
fn idle_check() -> Result<()> {
    let own = std::env::current_exe()?;
    process::run(
        process::command("nice")
            .arg(own)
            .args(["check", "--no-book"]),
    )
}

/// Does the first on a thread of its own, and at the same time the second.
fn beside<A: Send, B>(first: impl FnOnce() -> A + Send, second: impl FnOnce() -> B) -> (A, B) {
    std::thread::scope(|scope| {
        let first = scope.spawn(first);
        let second = second();
        let first = first.join();
        (first.unwrap_or_else(|panic| resume_unwind(panic)), second)
    })
}

/// Joins the results of two jobs, so that no error is lost.
fn both(one: Result<()>, other: Result<()>) -> Result<()> {
    match (one, other) {
        (Err(one), Err(other)) => bail!("{one:#}\nerror: {other:#}"),
        (one, other) => one.and(other),
    }
}

/// Runs the tests whose readers are too large for every test run.
fn readers() -> Result<()> {
    tools::ensure_readers()?;
    let test = "-p hil-sim --test it -- --ignored --nocapture readers::";
    self::test(&test.split(' ').collect::<Vec<_>>())
}

/// Connects the simulated board to the USB of a real kernel.
fn linux_usb() -> Result<()> {
    tools::ensure_program("qemu-system-x86_64", "qemu-system-x86")?;
    tools::ensure_program("cpio", "cpio")?;
    process::cargo("build --release --workspace --bin smartdepthsync".split(' '))?;
    let target = process::target_dir();
    process::run(
        process::command("bash")
            .arg("xtask/linux_usb.sh")
            .arg(target.join("tmp/linux-usb"))
            .arg(target.join("release/smartdepthsync")),
    )?;
    let test = "-p smartdepthsync-rig --test it -- --ignored --nocapture linux_kernel";
    self::test(&test.split(' ').collect::<Vec<_>>())
}

fn check(no_book: bool) -> Result<()> {
    process::cargo(["fmt", "--all", "--check"])?;
    let (others, workspace) = beside(
        || {
            firmware::clippy()?;
            // Builds the crate by itself from what would be published.
            process::cargo("package -p twist-sync --allow-dirty --quiet".split(' '))
        },
        || process::cargo("clippy --release --workspace --all-targets -- -D warnings".split(' ')),
    );
    both(workspace, others)?;
    dependencies::check()?;
    tidy::check()?;
    if no_book {
        docs::check()
    } else {
        docs::build_and_check()
    }
}

fn bench(part: &str, size: Option<u32>) -> Result<()> {
    let python = wheel::installed()?;
    let examples = "--example synthetic_recording --example sync_bench";
    let build = format!("build --release --workspace --bin smartdepthsync {examples}");
    process::cargo(build.split(' '))?;
    process::run(
        process::command(python)
            .arg(format!("xtask/{part}_bench.py"))
            .arg(process::target_dir())
            .args(size.map(|size| size.to_string())),
    )
}

fn hil_sim(args: &[String]) -> Result<()> {
    tools::ensure_program("ffmpeg", "ffmpeg")?;
    process::hil_sim(args, &firmware::build_rig()?)
}

fn main() -> ExitCode {
    match run(Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
