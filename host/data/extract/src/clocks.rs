//! Relations of the clocks of other devices to the board's clock, over a whole recording.

pub(crate) mod gyro_clock;
pub(crate) mod phone_clock;
pub(crate) mod streams;
