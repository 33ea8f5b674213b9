//! `smartdepthsync`: maps the outcome of a command to an exit code, nothing else.

use std::process::ExitCode;

/// Stack of the thread that runs the command, bytes: that of the main thread is as small as the shell's
/// limit.
const STACK: usize = 8 << 20;

fn main() -> ExitCode {
    let command = || smartdepthsync::cli::main(std::env::args_os()).into();
    let thread = std::thread::Builder::new().name(String::from("command"));
    match thread.stack_size(STACK).spawn(command) {
        // The panic was reported by its thread.
        Ok(running) => running.join().unwrap_or(ExitCode::FAILURE),
        Err(error) => {
            eprintln!(
                "error: the system starts no thread: {error}; raise `ulimit -v` or `ulimit -u`"
            );
            ExitCode::FAILURE
        }
    }
}
