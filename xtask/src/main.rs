//! `cargo xtask`: the one entry point, the same locally and in CI.
fn main() {}
