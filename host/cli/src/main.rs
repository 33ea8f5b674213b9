//! `smartdepthsync`: maps the outcome of a command to an exit code, nothing else.

use std::process::ExitCode;

fn main() -> ExitCode {
    smartdepthsync::cli::main(std::env::args_os()).into()
}
