//! `smartdepthsync man`: the manual pages.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Command;

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};

/// Write the manual pages, one a command, into a folder, for example
/// `smartdepthsync man ~/.local/share/man/man1`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The folder; it is made if it is not there
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
}

/// Runs the command.
///
/// # Errors
///
/// The folder cannot be written.
pub(crate) fn run(args: &Args, program: Command, context: &Context) -> Result<ExitStatus, Failure> {
    let failed = |error: std::io::Error| Failure::file("write", &args.folder, &error);
    std::fs::create_dir_all(&args.folder).map_err(failed)?;
    clap_mangen::generate_to(program, &args.folder).map_err(failed)?;
    let mut pages = Vec::new();
    for entry in std::fs::read_dir(&args.folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().map(|name| name.to_string_lossy());
        if name.is_some_and(|name| name.starts_with("smartdepthsync") && name.ends_with(".1")) {
            pages.push(path);
        }
    }
    pages.sort();
    context.print(&BTreeMap::from([("pages", &pages)]), || {
        format!("{} pages written to {}", pages.len(), args.folder.display())
    })?;
    Ok(ExitStatus::Good)
}
