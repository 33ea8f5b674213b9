//! The relation of two clocks, a and b, and its prediction.
//!
//! Convention: `b = a + offset + skew · (a − reference)`, all in seconds.
//! The reference lies where offset and skew do not trade against each other
//! (the centroid of the information), so that their covariance is near zero
//! there.
//!
//! Away from the data the relation is extrapolated. Two crystals wander against
//! each other; the skew is modelled as a random walk ([`Wander`]), so that the
//! variance of a prediction over `τ` seconds is
//! `P₀₀ + 2τP₀₁ + τ²P₁₁ + q·|τ|³/3` with `q` the variance of the skew's change
//! per second. Limits: temperature steps (a phone that starts to record video
//! warms up) are not a random walk; choose the wander to cover them.

use nalgebra::{Matrix2, Vector2};

/// Wander of the relative rate of two clocks: the rms change of the skew
/// within one minute (dimensionless; 10⁻⁸ is 0.01 ppm).
///
/// The skew is modelled as a random walk.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(transparent))]
pub struct Wander(pub f64);

impl Wander {
    /// Creates a wander from the rms change of the skew in one minute, in ppm.
    #[must_use]
    pub const fn from_ppm(ppm: f64) -> Self {
        Self(ppm * 1e-6)
    }

    /// Returns the variance of the skew's change per second, in 1/s.
    #[must_use]
    pub fn diffusion(self) -> f64 {
        self.0 * self.0 / 60.0
    }
}

impl Default for Wander {
    /// Returns 0.05 ppm a minute: two uncompensated crystals at room temperature, with a margin.
    fn default() -> Self {
        Self::from_ppm(0.05)
    }
}

/// A time interval with its 1-sigma, both in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct WithSigma {
    /// The value in seconds.
    pub value: f64,
    /// Its standard deviation in seconds.
    pub sigma: f64,
}

/// The relation of two clocks with its uncertainty:
/// `b = a + offset + skew · (a − reference)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ClockRelation {
    /// Time of clock a at which `offset` holds, in seconds.
    pub reference: f64,
    /// Clock b minus clock a at the reference, in seconds.
    pub offset: f64,
    /// Rate of clock b relative to clock a, minus one (dimensionless).
    pub skew: f64,
    /// Covariance of (offset, skew) at the reference, in s², s; s, 1.
    pub covariance: [[f64; 2]; 2],
    /// Wander of the skew away from the reference.
    pub wander: Wander,
}

impl ClockRelation {
    /// Returns the relation for a clock a that reads `a_s` more and an offset that is larger
    /// by `between_s`.
    pub(crate) fn moved(self, a_s: f64, between_s: f64) -> Self {
        Self {
            reference: self.reference + a_s,
            offset: self.offset + between_s,
            ..self
        }
    }

    /// Returns the offset (b − a) at a time of clock a in seconds. Its sigma grows with the
    /// distance from the reference.
    #[must_use]
    pub fn offset_at(&self, a: f64) -> WithSigma {
        self.referenced_at(a).offset_here()
    }

    /// Returns the offset at the reference.
    pub(crate) fn offset_here(&self) -> WithSigma {
        WithSigma {
            value: self.offset,
            sigma: self.covariance[0][0].max(0.0).sqrt(),
        }
    }

    /// Returns the 1-sigma of the skew at a time of clock a, which includes the wander since
    /// the reference.
    #[must_use]
    pub fn skew_sigma_at(&self, a: f64) -> f64 {
        self.referenced_at(a).covariance[1][1].max(0.0).sqrt()
    }

    /// Converts a time of clock a to clock b, both in seconds.
    #[must_use]
    pub fn a_to_b(&self, a: f64) -> f64 {
        a + (self.offset + self.skew * (a - self.reference))
    }

    /// Converts a time of clock b to clock a, both in seconds: the exact inverse of
    /// [`Self::a_to_b`].
    #[must_use]
    pub fn b_to_a(&self, b: f64) -> f64 {
        self.reference + (b - self.reference - self.offset) / (1.0 + self.skew)
    }

    /// Returns the same relation with its reference moved to `a`, in seconds of clock a: a
    /// prediction, whose covariance grows by the wander over the distance.
    #[must_use]
    pub fn referenced_at(&self, a: f64) -> Self {
        State::from_relation(self, self.offset)
            .predicted(a - self.reference, self.wander)
            .relation(self.offset, a, self.wander)
    }

    /// Returns the relation as seen from the other clock: a and b change roles.
    ///
    /// The offset changes its sign at the same instant.
    #[must_use]
    pub fn inverted(&self) -> Self {
        let scale = 1.0 / (1.0 + self.skew);
        let p = &self.covariance;
        Self {
            reference: self.reference + self.offset,
            offset: -self.offset,
            skew: -self.skew * scale,
            covariance: [
                [p[0][0], p[0][1] * scale * scale],
                [p[1][0] * scale * scale, p[1][1] * scale.powi(4)],
            ],
            wander: self.wander,
        }
    }

    /// Joins two estimates of the same pair of clocks taken at different times
    /// (two twists). The time between them gives a far better skew than either has
    /// by itself.
    ///
    /// The result is the minimum-variance combination under the wander of
    /// `self`, referenced at the later estimate: the state to predict from.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        let (early, late) = if self.reference <= other.reference {
            (self, other)
        } else {
            (other, self)
        };
        let base = late.offset;
        let predicted = State::from_relation(early, base)
            .predicted(late.reference - early.reference, early.wander);
        predicted
            .updated(&State::from_relation(late, base))
            .map_or(predicted, |(joined, _)| joined)
            .relation(base, late.reference, self.wander)
    }
}

/// Transition matrix of (offset, skew) over `dt` seconds.
pub(crate) fn transition(dt: f64) -> Matrix2<f64> {
    Matrix2::new(1.0, dt, 0.0, 1.0)
}

/// Covariance of (offset, skew) that the wander adds over `dt` seconds.
fn diffusion(dt: f64, wander: Wander) -> Matrix2<f64> {
    let q = wander.diffusion();
    let span = dt.abs();
    let cross = q * span * dt / 2.0;
    Matrix2::new(q * span.powi(3) / 3.0, cross, cross, q * span)
}

/// State of a Kalman filter: offset (relative to a base, so that no digits are lost) and skew,
/// with their covariance.
#[derive(Clone, Copy)]
pub(crate) struct State {
    mean: Vector2<f64>,
    covariance: Matrix2<f64>,
}

impl State {
    pub(crate) fn from_relation(relation: &ClockRelation, base: f64) -> Self {
        Self {
            mean: Vector2::new(relation.offset - base, relation.skew),
            covariance: Matrix2::from(relation.covariance).transpose(),
        }
    }

    pub(crate) fn parts(&self) -> (Vector2<f64>, Matrix2<f64>) {
        (self.mean, self.covariance)
    }

    pub(crate) fn relation(&self, base: f64, reference: f64, wander: Wander) -> ClockRelation {
        let symmetric = 0.5 * (self.covariance + self.covariance.transpose());
        ClockRelation {
            reference,
            offset: base + self.mean[0],
            skew: self.mean[1],
            covariance: symmetric.into(),
            wander,
        }
    }

    /// Predicts the state `dt` seconds later (or earlier, if negative).
    pub(crate) fn predicted(&self, dt: f64, wander: Wander) -> Self {
        let f = transition(dt);
        Self {
            mean: f * self.mean,
            covariance: f * self.covariance * f.transpose() + diffusion(dt, wander),
        }
    }

    /// Updates the state with a measurement at the same time. Returns the square of the
    /// innovation in sigmas as well, and `None` if nothing is uncertain.
    pub(crate) fn updated(&self, measured: &Self) -> Option<(Self, f64)> {
        let inverse = (self.covariance + measured.covariance).try_inverse()?;
        let innovation = measured.mean - self.mean;
        let square = innovation.dot(&(inverse * innovation));
        let gain = self.covariance * inverse;
        let keep = Matrix2::identity() - gain;
        let updated = Self {
            mean: self.mean + gain * innovation,
            // Joseph form: stays positive.
            covariance: keep * self.covariance * keep.transpose()
                + gain * measured.covariance * gain.transpose(),
        };
        Some((updated, square))
    }

    /// One step of the Rauch–Tung–Striebel smoother: the state, improved by the
    /// smoothed state `dt` seconds later.
    pub(crate) fn improved(&self, later: &Self, dt: f64, wander: Wander) -> Self {
        let forward = self.predicted(dt, wander);
        let Some(inverse) = forward.covariance.try_inverse() else {
            return *self;
        };
        let gain = self.covariance * transition(dt).transpose() * inverse;
        Self {
            mean: self.mean + gain * (later.mean - forward.mean),
            covariance: self.covariance
                + gain * (later.covariance - forward.covariance) * gain.transpose(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> ClockRelation {
        ClockRelation {
            reference: 1264.0,
            offset: 947_848.638,
            skew: 40e-6,
            covariance: [[4e-12, 0.0], [0.0, 4e-12]],
            wander: Wander::from_ppm(0.02),
        }
    }

    #[test]
    fn the_two_directions_are_inverse() {
        let m = model();
        for a in [0.0, 1e-6, 60.0, 86_400.0] {
            assert!((m.b_to_a(m.a_to_b(a)) - a).abs() < 1e-9, "{a}");
        }
        let inverse = m.inverted();
        let back = inverse.a_to_b(m.a_to_b(2000.0));
        assert!((back - 2000.0).abs() < 1e-9);
        assert_eq!(inverse.offset, -m.offset);
    }

    #[test]
    fn prediction_grows_and_matches_its_formula() {
        let m = model();
        let at = |s: f64| m.offset_at(1264.0 + s).sigma;
        assert!(at(0.0) < at(10.0) && at(10.0) < at(100.0));
        // 2 µs, 2 ppm, 0.02 ppm a minute, after one minute.
        let expected =
            (4e-12_f64 + 3600.0 * 4e-12 + (2e-8_f64).powi(2) / 60.0 * 60.0_f64.powi(3) / 3.0)
                .sqrt();
        assert!((at(60.0) - expected).abs() < 1e-12);
        let moved = m.referenced_at(1324.0);
        assert!((moved.covariance[0][0].sqrt() - expected).abs() < 1e-12);
        assert!((moved.offset - m.offset - 60.0 * 40e-6).abs() < 1e-9);
    }

    #[test]
    fn two_twists_give_the_skew() {
        let early = ClockRelation {
            wander: Wander(0.0),
            ..model()
        };
        let mut late = early;
        late.reference = 1324.0;
        late.offset = early.offset + 60.0 * 41e-6;
        late.skew = 38e-6;
        let joined = early.joined(&late);
        // Baseline: sqrt(2) · 2 µs / 60 s = 0.047 ppm against 2 ppm of one twist.
        assert!((joined.covariance[1][1].sqrt() - 0.0471e-6).abs() < 1e-9);
        assert!((joined.skew - 41e-6).abs() < 0.01e-6);
        assert_eq!(joined, late.joined(&early));
    }
}
