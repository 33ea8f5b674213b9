//! The messages between the SmartDepthSync board and its host.
#![no_std]
#![forbid(unsafe_code)]
