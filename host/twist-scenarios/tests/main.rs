//! The estimator on simulated twists and on a real one.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod memory;
mod robustness;
mod statistics;
mod stretches;
