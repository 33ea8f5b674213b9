//! The motion of the rig: one smooth signal that every IMU on it sees.
//!
//! A [`Motion`] gives the angular rate and the specific force of the rig in
//! the rig's own axes at any true time, without state: both IMUs look at the same signal,
//! at the times at which their clocks make them sample. Times are
//! `f64` seconds since power-on of the rig (60 ps resolution after three days).
//!
//! It is a sequence of gestures ([`gesture`]): rest, twist, walk. Orientation is a closed
//! formula, so the angular rate is its exact derivative and gravity turns with it. It is
//! band-limited: nothing above 12 Hz but the gentle ends of a gesture.
//!
//! Axes: x forward, y left, z up when at rest. The rig is one rigid body and
//! all IMUs sit at its origin: the centripetal acceleration between them is
//! not modelled (only gyroscopes are compared by the synchronisation).

pub mod gesture;
pub mod inertial_channel;
mod view;

use std::sync::Arc;

use crate::random::Random;
use gesture::Gesture;
pub use gesture::Motion;
pub use view::MotionView;

/// Standard gravity, m/s².
pub(crate) const STANDARD_GRAVITY: f64 = 9.806_65;

/// A motion before its details are drawn: a sequence of gestures.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionSpec(pub Vec<Step>);

/// One gesture of a sequence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Its kind.
    pub gesture: Gesture,
    /// Its length, s; `None` for endless.
    pub seconds: Option<f64>,
}

impl MotionSpec {
    /// Returns one endless gesture.
    #[must_use]
    pub fn always(gesture: Gesture) -> Self {
        Self(vec![Step {
            gesture,
            seconds: None,
        }])
    }

    /// Draws the details of the motion from `random`.
    #[must_use]
    pub fn build(&self, random: Random) -> Arc<Motion> {
        Arc::new(Motion::new(&self.0, random))
    }
}

impl Default for MotionSpec {
    fn default() -> Self {
        Self::always(Gesture::Rest)
    }
}
