//! `smartdepthsync`: maps the outcome of a command to an exit code.
fn main() {}
