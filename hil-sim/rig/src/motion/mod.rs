//! The motion of the rig: one smooth signal that every IMU on it sees.
//!
//! A [`Motion`] gives the angular rate and the specific force of the rig in
//! the rig's own axes at any true time, without state: both IMUs, at whatever
//! times their clocks make them sample, look at the same signal. Times are
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
mod view;

use std::sync::Arc;

use crate::random::Random;
use gesture::Gesture;
pub use gesture::Motion;
pub use view::MotionView;

/// Standard gravity, m/s².
pub(crate) const STANDARD_GRAVITY: f64 = 9.806_65;

/// A motion that was chosen, before it is drawn: gestures one after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionSpec(pub Vec<Step>);

/// One gesture of a sequence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Its kind.
    pub gesture: Gesture,
    /// For how long, in seconds; nothing is for ever.
    pub seconds: Option<f64>,
}

impl MotionSpec {
    /// One gesture for ever.
    #[must_use]
    pub fn always(gesture: Gesture) -> Self {
        Self(vec![Step {
            gesture,
            seconds: None,
        }])
    }

    /// Draws the motion's details from `random`.
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

impl core::str::FromStr for MotionSpec {
    type Err = String;

    /// `rest`, `twist`, `walk`, or a sequence such as `rest:5,twist:12,walk`
    /// (seconds; the last one may go on for ever).
    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<&str> = text.split(',').collect();
        let mut steps = Vec::new();
        for (i, part) in parts.iter().enumerate() {
            let (name, seconds) = match part.split_once(':') {
                Some((name, seconds)) => (name, Some(seconds)),
                None => (*part, None),
            };
            let gesture = match name.trim() {
                "rest" => Gesture::Rest,
                "twist" => Gesture::Twist,
                "weak-twist" => Gesture::WeakTwist,
                "one-axis-twist" => Gesture::OneAxisTwist,
                "walk" => Gesture::Walk,
                other => {
                    return Err(format!(
                        "'{other}' is not a motion: expected rest, twist, weak-twist, one-axis-twist, \
                         walk, or a sequence \
                         such as rest:5,twist:12,walk"
                    ));
                }
            };
            let seconds = match seconds {
                None if i + 1 < parts.len() => {
                    return Err(format!(
                        "'{part}' in '{text}' has no duration: only the last motion of a \
                         sequence may go on for ever (write {name}:10 for 10 s)"
                    ));
                }
                None => None,
                Some(s) => match s.trim().parse::<f64>() {
                    Ok(s) if s.is_finite() && s > 0.0 => Some(s),
                    _ => {
                        return Err(format!(
                            "'{s}' in '{part}' is not a duration: expected seconds above 0, \
                             such as {name}:10"
                        ));
                    }
                },
            };
            steps.push(Step { gesture, seconds });
        }
        Ok(Self(steps))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sequence_is_read() {
        let step = |gesture, seconds| Step { gesture, seconds };
        let steps = vec![
            step(Gesture::Rest, Some(5.0)),
            step(Gesture::Twist, Some(12.5)),
            step(Gesture::Walk, None),
        ];
        assert_eq!("rest:5,twist:12.5,walk".parse(), Ok(MotionSpec(steps)));
    }

    #[test]
    fn bad_specifications_say_what_was_expected() {
        for (text, says) in [
            (
                "dance",
                "expected rest, twist, weak-twist, one-axis-twist, walk",
            ),
            ("rest,twist", "has no duration"),
            ("twist:-1", "seconds above 0"),
            ("twist:x", "seconds above 0"),
            ("twist:inf", "seconds above 0"),
            ("", "is not a motion"),
        ] {
            let error = text.parse::<MotionSpec>().unwrap_err();
            assert!(error.contains(says), "{text}: {error}");
        }
    }
}
