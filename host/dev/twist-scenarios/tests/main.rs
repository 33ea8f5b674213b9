//! The estimator on simulated twists and on a real one.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod memory;
mod real_streams;
mod recordings;
mod robustness;
mod statistics;
mod stretches;
