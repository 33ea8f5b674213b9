//! The motion of the rig: one smooth signal that every IMU on it sees.
//!
//! A [`Motion`] gives the angular rate and the specific force of the rig in
//! the rig's own axes at any true time, without state: both IMUs, at whatever
//! times their clocks make them sample, look at the same signal. Times are
//! `f64` seconds since power-on of the rig (60 ps resolution after three days).
//!
//! - *Synthetic* motion ([`gesture`]) is a sequence of gestures (rest, twist,
//!   walk). Orientation is a closed formula, so the angular rate is its exact
//!   derivative and gravity turns with it. It is band-limited: nothing above
//!   12 Hz but the gentle ends of a gesture.
//! - *Recorded* motion ([`recorded`]) is a table of rates (and forces) with a
//!   cubic spline through it, for instance a real twist.
//!
//! Axes: x forward, y left, z up when at rest. The rig is one rigid body and
//! all IMUs sit at its origin: the centripetal acceleration between them is
//! not modelled (only gyroscopes are compared by the synchronisation).

pub mod gesture;
pub mod recorded;
mod view;

use std::path::PathBuf;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::random::Random;
use gesture::{Gesture, Performance};
use recorded::Recording;
pub use view::MotionView;

/// Standard gravity, m/s².
pub(crate) const STANDARD_GRAVITY: f64 = 9.806_65;

/// A motion that was chosen, before it is drawn or loaded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum MotionSpec {
    /// Gestures one after the other.
    Script(Vec<Step>),
    /// A CSV file (see [`recorded`]).
    File(PathBuf),
}

/// One gesture of a script.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// What is done.
    pub gesture: Gesture,
    /// For how long, in seconds; nothing is for ever.
    pub seconds: Option<f64>,
}

impl MotionSpec {
    /// One gesture for ever.
    #[must_use]
    pub fn always(gesture: Gesture) -> Self {
        Self::Script(vec![Step {
            gesture,
            seconds: None,
        }])
    }

    /// Draws the motion's details from `random`, or loads its file.
    ///
    /// # Errors
    /// The file cannot be read or is not a motion.
    pub fn build(&self, random: Random) -> anyhow::Result<Arc<Motion>> {
        Ok(Arc::new(match self {
            Self::Script(steps) => Motion::Synthetic(Performance::new(steps, random)),
            Self::File(path) => Motion::Recorded(Recording::load(path)?),
        }))
    }
}

impl Default for MotionSpec {
    fn default() -> Self {
        Self::always(Gesture::Rest)
    }
}

impl core::str::FromStr for MotionSpec {
    type Err = String;

    /// `rest`, `twist`, `walk`, a sequence such as `rest:5,twist:12,walk`
    /// (seconds; the last one may go on for ever), or the name of a `.csv` file.
    fn from_str(text: &str) -> Result<Self, String> {
        let path = PathBuf::from(text);
        if path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("csv"))
        {
            return Ok(Self::File(path));
        }
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
                "walk" => Gesture::Walk,
                other => {
                    return Err(format!(
                        "'{other}' is not a motion: expected rest, twist, walk, a sequence \
                         such as rest:5,twist:12,walk, or the name of a .csv file"
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
        Ok(Self::Script(steps))
    }
}

impl core::fmt::Display for MotionSpec {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Script(steps) => {
                for (i, step) in steps.iter().enumerate() {
                    if i > 0 {
                        f.write_str(",")?;
                    }
                    f.write_str(match step.gesture {
                        Gesture::Rest => "rest",
                        Gesture::Twist => "twist",
                        Gesture::Walk => "walk",
                    })?;
                    if let Some(s) = step.seconds {
                        write!(f, ":{s}")?;
                    }
                }
                Ok(())
            }
        }
    }
}

/// The motion of the rig.
#[derive(Clone, Debug)]
pub enum Motion {
    /// From formulas.
    Synthetic(Performance),
    /// From a file.
    Recorded(Recording),
}

impl Motion {
    /// No motion at all.
    #[must_use]
    pub fn rest() -> Arc<Self> {
        Arc::new(Self::Synthetic(Performance::rest()))
    }

    /// Angular rate about the rig's axes at true time `t`, in rad/s.
    #[must_use]
    pub fn angular_rate(&self, t: f64) -> [f64; 3] {
        match self {
            Self::Synthetic(p) => p.angular_rate(t),
            Self::Recorded(r) => r.angular_rate(t),
        }
    }

    /// Specific force (what an accelerometer measures: acceleration minus
    /// gravity) along the rig's axes at true time `t`, in m/s². At rest it is
    /// `[0, 0, 9.80665]`.
    #[must_use]
    pub fn specific_force(&self, t: f64) -> [f64; 3] {
        match self {
            Self::Synthetic(p) => p.specific_force(t),
            Self::Recorded(r) => r.specific_force(t),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specifications_go_both_ways() {
        for text in ["rest", "twist", "walk", "rest:5,twist:12.5,walk", "a/b.csv"] {
            assert_eq!(text.parse::<MotionSpec>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn bad_specifications_say_what_was_expected() {
        for (text, says) in [
            ("dance", "expected rest, twist, walk"),
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
