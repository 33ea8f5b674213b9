//! The commands of `hil-sim`.

pub(crate) mod bench;
pub(crate) mod serve;
