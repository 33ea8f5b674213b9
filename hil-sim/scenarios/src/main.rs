//! `hil-sim`: runs the firmware's ELF on a simulated board.

mod commands;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The simulated rig of SmartDepthSync.
#[derive(Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run the board and offer its USB serial port as a pseudo-terminal.
    Serve(rig::serve::ServeArgs),
    /// Record the depth camera of a running `serve`, as the recorder that its profile names.
    RecordDepth(rig::depth_camera::cable::RecordDepthArgs),
    /// Run a whole session on the simulated rig and judge it by the ground truth.
    Demo(commands::demo::DemoArgs),
    /// Print figures over the model ranges: sessions on models, tracking, the whole chain.
    Study(commands::study::StudyArgs),
    /// Record while things go wrong, and judge the recordings by the ground truth.
    Faults(commands::faults::FaultsArgs),
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Serve(args) => rig::serve::run(&args),
        Command::RecordDepth(args) => rig::depth_camera::cable::record(&args),
        Command::Demo(args) => commands::demo::run(&args),
        Command::Study(args) => commands::study::run(&args),
        Command::Faults(args) => commands::faults::run(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
