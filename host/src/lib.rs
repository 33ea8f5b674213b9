//! The host side of SmartDepthSync as a library; the command-line tool is thin.
#![forbid(unsafe_code)]

pub mod sync;
