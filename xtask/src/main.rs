//! `cargo xtask`: the one entry point, the same locally and in CI.
//!
//! Every command sets up what it needs (the firmware's target, the Python
//! environment, ffmpeg), or stops and prints the one command to run. It calls
//! cargo and other programs as processes and depends on no other crate of this
//! workspace, so it builds in seconds.

mod demo;
mod dependencies;
mod docs;
mod evaluate_bench;
mod extract_bench;
mod figures;
mod firmware;
mod package;
mod process;
mod sync_bench;
mod testing;
mod tools;
mod wheel;

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

/// Which runs of a campaign.
#[derive(clap::Args)]
struct Seeds {
    /// The first seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of seeds.
    #[arg(long, default_value_t = 200)]
    count: u64,
}

#[derive(Subcommand)]
enum Command {
    /// Build the firmware for the board, the host tool and the simulator.
    Build,
    /// Build the firmware, flash the board through probe-rs and show the log.
    Flash {
        /// Which board it is.
        #[arg(long, value_enum, default_value_t)]
        board: firmware::Board,
    },
    /// Run every test, on the host and in the simulator.
    Test {
        /// Passed on to cargo test, for example `-p smartdepthsync verify_command`.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        cargo_args: Vec<String>,
    },
    /// Run a whole session on the simulated rig and judge it by the truth: table, report.
    Demo(demo::Args),
    /// Check formatting, lints, dependencies and the book.
    Check {
        /// Check the book's links without building the book: building mdBook
        /// itself takes minutes.
        #[arg(long)]
        no_book: bool,
    },
    /// Run the readers that are too large for every run of the tests (Open3D, Rerun,
    /// LeRobot; 5.3 GB are downloaded the first time) and ROS 1's own on data sets of the
    /// simulated rig.
    Readers,
    /// Run trigger, IMU and strobe on the simulated board for hours, and compare
    /// every edge and sample with what it should be.
    Longrun {
        /// Virtual time, for example 6h or 3min.
        #[arg(long = "for", value_name = "DURATION", default_value = "6h")]
        length: String,
        /// Share of the time in which the link is as full as USB allows.
        #[arg(long, value_name = "PERCENT", default_value_t = 10)]
        full_link: u8,
        /// Leave the strobe input dark.
        #[arg(long)]
        no_strobe: bool,
        /// The seed of all randomness.
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
    /// Run all four trigger outputs and the lidar's for an hour of virtual time,
    /// and compare every edge with the arithmetic.
    Hour,
    /// Run the fault campaign: things go wrong during recordings on the simulated
    /// board, and the truth judges them.
    Faults(Seeds),
    /// Run sessions with a board or a phone that lies: any field of any message or
    /// answer becomes an extreme one.
    Lies(Seeds),
    /// Run the hostile campaign: absurd values in valid recordings, through whole
    /// commands that run in limits of their own.
    Hostile(Seeds),
    /// Measure the simulator or, with an option, another part. Compare figures
    /// within one run only.
    Bench {
        /// The speed of `smartdepthsync evaluate`.
        #[arg(long, conflicts_with = "sync")]
        evaluate: bool,
        /// The clock estimate: error, honesty and time on simulated twists, beside
        /// the published Python package.
        #[arg(long)]
        sync: bool,
        /// With --sync: twists per scenario.
        #[arg(long, default_value_t = 300, requires = "sync")]
        trials: u32,
        /// Phase and drift of the frames from launch to launch, on the whole
        /// simulated rig, with a fresh and a learnt profile.
        #[arg(long, conflicts_with_all = ["sync", "evaluate", "extract"])]
        frame_sync: bool,
        /// With --frame-sync: number of rigs.
        #[arg(long, default_value_t = 20, requires = "frame_sync")]
        launches: u32,
        /// With --frame-sync: over what may be true instead of what is believed, on the
        /// models alone.
        #[arg(long, requires = "frame_sync")]
        beliefs: bool,
        /// The extraction: speed and memory, beside a plain Python reader.
        #[arg(long, conflicts_with = "sync")]
        extract: bool,
        /// With --extract: minutes of depth at full size (1.3 GB each).
        #[arg(long, default_value_t = 10, requires = "extract")]
        depth_minutes: u32,
        /// Extraction, evaluation and calibration on recordings of the whole simulated
        /// rig, judged by the truth.
        #[arg(long, conflicts_with_all = ["sync", "extract", "evaluate"])]
        chain: bool,
        /// With --chain: length of the extracted recording, in seconds.
        #[arg(long, default_value_t = 600, requires = "chain")]
        seconds: u32,
        /// With --chain: number of seeds of the evaluation.
        #[arg(long, default_value_t = 50, requires = "chain")]
        seeds: u32,
    },
    /// Measure the drift after simulated twists and natural motion: the tables of
    /// docs/sync-study.md.
    Study {
        /// Sessions per case.
        #[arg(long, default_value_t = 60)]
        trials: u32,
        /// Instead, the phase over an hour while the phone's clock is tracked: the table of
        /// docs/tracking.md. `--trials` is the number of rigs.
        #[arg(long)]
        tracking: bool,
    },
    /// Check licences and sources of all dependencies, and every unsafe block.
    Dependencies,
    /// Build the Debian package with host tool, udev rule and firmware, and try it
    /// in a root of its own.
    Package,
    /// Build the Python package twist-sync, install it into target/venv, and test it there.
    Wheel,
    /// Build the book into target/book and check its links.
    Docs,
    /// Draw the book's figures again from simulated runs.
    DocsFigures,
}

fn run(command: Command) -> Result<()> {
    match command {
        Command::Build => build(),
        Command::Flash { board } => flash(board),
        Command::Test { cargo_args } => test(&cargo_args),
        Command::Demo(args) => demo(&args),
        Command::Check { no_book } => check(no_book),
        Command::Longrun {
            length,
            full_link,
            no_strobe,
            seed,
        } => long_run(&length, full_link, no_strobe, seed),
        Command::Faults(seeds) => campaign("faults", &seeds),
        Command::Lies(seeds) => campaign("lies", &seeds),
        Command::Hostile(seeds) => {
            tools::ensure_program("ffmpeg", "ffmpeg")?;
            tools::ensure_program("strace", "strace")?;
            campaign("hostile", &seeds)
        }
        Command::Bench { evaluate: true, .. } => evaluate_bench::run(),
        Command::Bench {
            extract: true,
            depth_minutes,
            ..
        } => extract_bench::run(depth_minutes),
        Command::Bench {
            chain: true,
            seconds,
            seeds,
            ..
        } => chain(seconds, seeds),
        Command::Bench {
            sync: true, trials, ..
        } => sync_bench::run(trials),
        Command::Bench {
            frame_sync: true,
            launches,
            beliefs,
            ..
        } => frame_sync(launches, beliefs),
        Command::Bench { sync: false, .. } => bench(),
        Command::Study {
            trials,
            tracking: true,
        } => track_study(trials),
        Command::Study { trials, .. } => sync_bench::study(trials),
        Command::Hour => ignored_tests("smartdepthsync-rig", "outputs::"),
        Command::Readers => {
            tools::ensure_readers()?;
            ignored_tests("hil-sim", "readers::")
        }
        Command::Dependencies => dependencies::check(),
        Command::Package => package(),
        Command::Wheel => wheel::build_and_test(),
        Command::Docs => docs::build_and_check(),
        Command::DocsFigures => figures::make(),
    }
}

fn build() -> Result<()> {
    firmware::build_with_wrong_pll()?;
    firmware::build_black_pill()?;
    let elf = firmware::build()?;
    firmware::build_agent()?;
    process::cargo(["build", "--release", "--workspace"])?;
    println!("firmware: {}", elf.display());
    Ok(())
}

fn flash(board: firmware::Board) -> Result<()> {
    if !process::answers("probe-rs", &["--version"]) {
        bail!(
            "there is no probe-rs on the PATH: see https://probe.rs for how to install it, or \
             docs/flash.md for two ways without it"
        );
    }
    firmware::flash(board)
}

fn test(cargo_args: &[String]) -> Result<()> {
    tools::ensure_for_tests()?;
    let elf = std::thread::scope(|scope| {
        // Each build of the firmware ends on one core: the packages come on another.
        let python = scope.spawn(tools::ensure_python);
        firmware::build_with_wrong_pll()?;
        firmware::build_black_pill()?;
        let elf = firmware::build()?;
        firmware::build_foreign()?;
        firmware::build_agent()?;
        let made = python.join();
        made.unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        anyhow::Ok(elf)
    })?;
    if cargo_args.is_empty() {
        return testing::all(&elf);
    }
    let mut args = vec!["test".to_owned(), "--release".to_owned()];
    args.extend_from_slice(cargo_args);
    process::run(&mut process::cargo_with_elf(&args, &elf))
}

/// Tests that take too long, or too much, for every run.
fn ignored_tests(package: &str, name: &str) -> Result<()> {
    let args = [
        "-p",
        package,
        "--test",
        "it",
        "--",
        "--ignored",
        "--nocapture",
        name,
    ];
    test(&args.map(str::to_owned))
}

fn check(no_book: bool) -> Result<()> {
    tools::ensure_component("rustfmt", "fmt")?;
    tools::ensure_component("clippy", "clippy")?;
    process::cargo(["fmt", "--all", "--check"])?;
    process::cargo([
        "clippy",
        "--release",
        "--workspace",
        "--all-targets",
        "--",
        "-D",
        "warnings",
    ])?;
    // As a lean build has it.
    process::cargo([
        "clippy",
        "--release",
        "-p",
        "smartdepthsync",
        "--no-default-features",
        "--",
        "-D",
        "warnings",
    ])?;
    firmware::clippy()?;
    // As a lean crate of its own, from what would be published.
    process::cargo(["package", "-p", "twist-sync", "--allow-dirty", "--quiet"])?;
    wheel::build_and_test()?;
    dependencies::check()?;
    if no_book {
        docs::check()
    } else {
        docs::build_and_check()
    }
}

fn package() -> Result<()> {
    let elves = [firmware::build_black_pill()?, firmware::build()?];
    firmware::build_agent()?;
    process::cargo(["build", "--release", "-p", "smartdepthsync"])?;
    package::build(&elves)
}

fn demo(args: &demo::Args) -> Result<()> {
    tools::ensure_program("ffmpeg", "ffmpeg")?;
    let elf = firmware::build_rig()?;
    demo::run(args, &elf)
}

fn long_run(length: &str, full_link: u8, no_strobe: bool, seed: u64) -> Result<()> {
    let elf = firmware::build()?;
    process::build_programs()?;
    let (full_link, seed) = (full_link.to_string(), seed.to_string());
    let mut args = vec!["long-run", "--for", length, "--seed", &seed];
    args.extend(["--full-link", &full_link]);
    if no_strobe {
        args.push("--no-strobe");
    }
    process::run_hil_sim(&args, &elf)
}

fn campaign(name: &str, Seeds { seed, count }: &Seeds) -> Result<()> {
    let elf = firmware::build_rig()?;
    let (seed, count) = (seed.to_string(), count.to_string());
    process::run_hil_sim(&[name, "--seed", &seed, "--count", &count], &elf)
}

fn frame_sync(launches: u32, beliefs: bool) -> Result<()> {
    let elf = firmware::build_rig()?;
    let out = process::target_dir().join("frame-sync");
    let (out, launches) = (out.display().to_string(), launches.to_string());
    let mut args = vec!["frame-sync", "--launches", &launches, "--out", &out];
    if beliefs {
        args.push("--beliefs");
    }
    process::run_hil_sim(&args, &elf)
}

fn track_study(rigs: u32) -> Result<()> {
    let rigs = format!("--rigs={rigs}");
    process::build_programs()?;
    process::run(process::command(process::program("hil-sim")).args(["track-study", &rigs]))
}

/// Extraction, evaluation and calibration on recordings of the whole simulated rig, by the truth.
fn chain(seconds: u32, seeds: u32) -> Result<()> {
    tools::ensure_program("ffmpeg", "ffmpeg")?;
    let elf = firmware::build_rig()?;
    let out = process::target_dir().join("chain").display().to_string();
    let (seconds, seeds) = (seconds.to_string(), seeds.to_string());
    for what in [
        &["extract", "--seconds", &seconds][..],
        &["evaluate", "--seeds", &seeds],
        &["calibrate"],
    ] {
        let args = [&["chain"], what, &["--out", &out]].concat();
        process::run_hil_sim(&args, &elf)?;
        println!();
    }
    Ok(())
}

fn bench() -> Result<()> {
    let elf = firmware::build()?;
    process::build_programs()?;
    process::run_hil_sim(&["bench"], &elf)
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
