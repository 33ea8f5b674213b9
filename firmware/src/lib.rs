//! Portable logic of the SmartDepthSync firmware, tested on the host.
#![cfg_attr(not(test), no_std)]
