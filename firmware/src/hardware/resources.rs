//! The peripherals and pins of a board, and the driver or task that each belongs to: a file a
//! board. The compiler refuses a pin that is given away twice, and one that a timer, bus or DMA
//! stream does not reach.

#[cfg(feature = "black-pill")]
mod black_pill;
#[cfg(feature = "discovery")]
mod discovery;

#[cfg(feature = "black-pill")]
pub(crate) use black_pill::*;
#[cfg(feature = "discovery")]
pub(crate) use discovery::*;
