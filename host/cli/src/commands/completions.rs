//! `smartdepthsync completions`: for the shell.

use std::collections::BTreeMap;

use clap::Command;
use clap_complete::Shell;

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};

/// Print the completions for a shell, for example
/// `smartdepthsync completions bash > ~/.local/share/bash-completion/completions/smartdepthsync`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync completions bash")]
pub(crate) struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Runs the command.
///
/// # Errors
///
/// Standard output cannot be written.
pub(crate) fn run(
    args: &CompletionsArgs,
    mut program: Command,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "smartdepthsync", &mut script);
    let script = String::from_utf8_lossy(&script);
    context.print(&BTreeMap::from([("script", &script)]), || {
        script.to_string()
    })?;
    Ok(ExitStatus::Good)
}
