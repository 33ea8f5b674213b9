//! Tests of the wire format from outside.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod decoder;
mod edges;
mod golden;
