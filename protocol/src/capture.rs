//! Edges on the capture inputs.

use serde::{Deserialize, Serialize};

use crate::units::Ticks;

/// An edge on a capture input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capture {
    /// Sequence number of the capture stream.
    pub seq: u32,
    /// The input.
    pub channel: CaptureChannel,
    /// Its direction.
    pub edge: Edge,
    /// The captured time.
    pub at: Ticks,
    /// An edge before this one was lost (over-capture): the pairing of edges
    /// starts again here.
    pub after_loss: bool,
}

/// The capture inputs that are reported edge by edge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum CaptureChannel {
    /// PA2, TIM2 channel 3.
    #[default]
    Strobe,
}

/// Direction of an edge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Edge {
    /// Low to high.
    #[default]
    Rising,
    /// High to low.
    Falling,
}
