//! `smartdepthsync man`: the manual pages.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Command;

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};

/// Write the manual pages, one a command, into a folder, for example
/// `smartdepthsync man ~/.local/share/man/man1`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync man man1")]
pub(crate) struct ManArgs {
    /// The folder; it is made if it is not there
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
}

/// Runs the command.
///
/// # Errors
///
/// The folder cannot be written.
pub(crate) fn run(
    args: &ManArgs,
    program: Command,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    std::fs::create_dir_all(&args.folder)
        .and_then(|()| clap_mangen::generate_to(program, &args.folder))
        .map_err(|error| Failure::file("write", &args.folder, &error))?;
    context.show(&BTreeMap::from([(
        "folder",
        args.folder.display().to_string(),
    )]))?;
    Ok(ExitStatus::Good)
}
