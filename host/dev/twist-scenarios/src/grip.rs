//! Grip of two gyroscopes while they are twisted.
//!
//! Gyroscope b sees `Q(t)·ω(t)` and the rate of `Q` itself, where `Q` is the rotation of
//! one body against the other. While they are held firmly, `Q` is constant; otherwise b moves
//! in part by itself. All draws come from the seed.
//!
//! The sizes are guessed ranges: there are no published measurements of how people hold a rig.

use nalgebra::{Rotation3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use twist_sync::interpolant::Uniform;

use super::{Rates, direction, second_order};

/// Grip of the two gyroscopes. Values are drawn from the given ranges.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Grip {
    /// Firm from beginning to end.
    #[default]
    Firm,
    /// Firm from this many seconds after the begin of the motion.
    Late(f64, f64),
    /// Firm until this many seconds before the end of the motion.
    LetGo(f64, f64),
    /// One turn against each other by this many degrees, in the middle third.
    Slip(f64, f64),
    /// Another grip of b, turned by 5° to 20°, for this many seconds in the middle.
    Wrong(f64, f64),
    /// A springy mount with a resonance at this many Hz and a damping ratio of 0.03 to 0.15.
    Flexing(f64, f64),
}

/// Motion of body b while a does `rates`.
pub(super) struct Held<'a> {
    rates: &'a Rates,
    other: &'a Rates,
    /// Begin and end of the time in which b moves by itself, and the share of its own motion.
    loose: Option<(f64, f64, f64)>,
    /// Axis, angle in rad, time and duration of each turn.
    turns: Vec<(Unit<Vector3<f64>>, f64, f64, f64)>,
    /// The motion behind a springy mount.
    flexing: Option<Uniform>,
    /// Stretches in which the two are not one body, seconds of true time.
    pub(super) stretches: Vec<(f64, f64)>,
}

/// Duration of taking hold or letting go, seconds.
const HANDLING_S: f64 = 0.15;

/// Smooth step from 0 to 1, for `x` from 0 to 1.
pub(super) fn rise(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
}

/// Slope of [`rise`].
fn rise_slope(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    30.0 * (x * (1.0 - x)).powi(2)
}

impl<'a> Held<'a> {
    /// `from` to `to` is the time of the motion.
    pub(super) fn new(
        grip: Grip,
        seed: u64,
        rates: &'a Rates,
        other: &'a Rates,
        (from, to): (f64, f64),
    ) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed ^ 0x6219);
        let mut out = Self {
            rates,
            other,
            loose: None,
            turns: Vec::new(),
            flexing: None,
            stretches: Vec::new(),
        };
        let mut between = |low: f64, high: f64| rng.random_range(low..=high);
        let share = between(0.3, 1.0);
        let middle = from + (to - from) * between(0.35, 0.65);
        let lasting = between(0.05, 0.3);
        match grip {
            Grip::Firm => {}
            Grip::Late(low, high) => {
                out.loose = Some((f64::NEG_INFINITY, from + between(low, high), share));
            }
            Grip::LetGo(low, high) => {
                out.loose = Some((to - between(low, high), f64::INFINITY, share));
            }
            Grip::Slip(low, high) => {
                let angle = between(low, high).to_radians();
                let axis = Unit::new_normalize(direction(&mut rng));
                out.turns.push((axis, angle, middle, lasting));
                out.stretches.push((middle, middle + lasting));
            }
            Grip::Wrong(low, high) => {
                let angle = between(5.0, 20.0).to_radians();
                let end = middle + between(low, high);
                let axis = Unit::new_normalize(direction(&mut rng));
                out.loose = Some((middle, end, 0.5 * share));
                out.turns.push((axis, angle, middle, HANDLING_S));
                out.turns.push((axis, -angle, end, HANDLING_S));
            }
            Grip::Flexing(low, high) => {
                let (hz, damping) = (between(low, high), between(0.03, 0.15));
                let motion = |t: f64| rates.at(t);
                out.flexing = second_order(&motion, hz, damping, true, from - 2.0, to + 2.0);
            }
        }
        let loose = out.loose;
        out.stretches
            .extend(loose.map(|(begin, end, _)| (begin, end + HANDLING_S)));
        out
    }

    /// Returns the rate of body b in its own axes.
    pub(super) fn at(&self, t: f64) -> Vector3<f64> {
        let carried = self.flexing.as_ref().map(|carried| carried.value(t).into());
        let mut rate: Vector3<f64> = carried.unwrap_or_else(|| self.rates.at(t));
        if let Some((begin, end, share)) = self.loose {
            let taken = rise((t - begin) / HANDLING_S) * (1.0 - rise((t - end) / HANDLING_S));
            rate += (self.other.at(t) - rate) * (share * taken);
        }
        for &(axis, angle, at, lasting) in &self.turns {
            let x = (t - at) / lasting;
            rate = Rotation3::from_axis_angle(&axis, -angle * rise(x)) * rate
                + axis.into_inner() * (angle * rise_slope(x) / lasting);
        }
        rate
    }
}
