//! The subcommands of `smartdepthsync`, one a file.
