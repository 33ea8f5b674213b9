//! Projection of rays to pixels and back.
//!
//! The models are those of OpenCV and Kalibr (radial-tangential, rational, equidistant)
//! and the older one of the depth camera's maker, which differs in the factor of the
//! mixed tangential term and has a centre of distortion.

use recording::profile::{DistortionModel, Intrinsics};

/// Largest distance from the axis that is considered, as a tangent.
const WIDEST: f64 = 4.0;
/// Number of steps of the search for the turning point.
const STEPS: u32 = 400;
/// Largest number of rounds of Newton's method.
const ROUNDS: u32 = 30;
/// Largest error of a ray that is accepted, pixels.
const CLOSE: f64 = 1e-3;

/// Distortion model of a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum LensModel {
    /// A ratio of polynomials of the radius, and a tangential part.
    Brown {
        /// k1 to k6; the last three belong to the denominator.
        radial: [f64; 6],
        /// p1 and p2.
        tangential: [f64; 2],
        /// Centre of distortion on the plane at distance 1.
        center: [f64; 2],
        /// Factor of the mixed term: 2, or 1 in the maker's older model.
        mixed: f64,
    },
    /// A polynomial of the angle.
    Equidistant([f64; 4]),
}

/// Projection of a camera, without its pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lens {
    focal: [f64; 2],
    center: [f64; 2],
    model: LensModel,
    /// Largest tangent of a ray that the model covers.
    radius: f64,
}

impl Lens {
    /// Creates a lens. `radius` is the largest tangent that the calibration covers, if it is
    /// stated.
    pub(crate) fn new(
        focal: [f64; 2],
        center: [f64; 2],
        model: LensModel,
        radius: Option<f64>,
    ) -> Self {
        let mut lens = Self {
            focal,
            center,
            model,
            radius: f64::INFINITY,
        };
        lens.radius = radius.unwrap_or(WIDEST).min(lens.turning_point());
        lens
    }

    /// Creates the lens of these intrinsics.
    pub(crate) fn from_intrinsics(intrinsics: &Intrinsics) -> Self {
        let k = |index: usize| intrinsics.coefficients.get(index).copied().unwrap_or(0.0);
        let model = match intrinsics.distortion {
            DistortionModel::Equidistant => LensModel::Equidistant([k(0), k(1), k(2), k(3)]),
            // The others are the rational model with zeros.
            DistortionModel::None | DistortionModel::Radtan | DistortionModel::Rational => {
                LensModel::Brown {
                    radial: [k(0), k(1), k(4), k(5), k(6), k(7)],
                    tangential: [k(2), k(3)],
                    center: [0.0; 2],
                    mixed: 2.0,
                }
            }
        };
        Self::new(intrinsics.focal, intrinsics.center, model, None)
    }

    /// Returns the radius beyond which a polynomial decreases, so that a pixel has two rays.
    fn turning_point(&self) -> f64 {
        let step = WIDEST / f64::from(STEPS);
        let at = |index: u32| {
            let radius = f64::from(index) * step;
            radius * self.stretch(radius * radius)
        };
        (1..=STEPS)
            .find(|&index| at(index) <= at(index - 1))
            .map_or(WIDEST, |index| f64::from(index - 1) * step)
    }

    /// By how much the radial part moves a point outwards.
    fn stretch(&self, square: f64) -> f64 {
        match self.model {
            LensModel::Brown { radial, .. } => {
                let [k1, k2, k3, k4, k5, k6] = radial;
                let above = 1.0 + square * (k1 + square * (k2 + square * k3));
                let below = 1.0 + square * (k4 + square * (k5 + square * k6));
                above / below
            }
            LensModel::Equidistant([k1, k2, k3, k4]) => {
                let radius = square.sqrt();
                if radius < 1e-9 {
                    return 1.0;
                }
                let angle = radius.atan();
                let s = angle * angle;
                angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) / radius
            }
        }
    }

    /// Projects the point (x, y, 1) to a pixel; `None` outside of the model.
    pub(crate) fn project(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let ([p1, p2], [cx, cy], mixed) = match self.model {
            LensModel::Brown {
                tangential,
                center,
                mixed,
                ..
            } => (tangential, center, mixed),
            LensModel::Equidistant(_) => ([0.0; 2], [0.0; 2], 0.0),
        };
        let (x, y) = (x - cx, y - cy);
        let square = x * x + y * y;
        if square > self.radius * self.radius {
            return None;
        }
        let stretch = self.stretch(square);
        let (x, y) = (
            x * stretch + (square + 2.0 * x * x) * p2 + mixed * x * y * p1 + cx,
            y * stretch + (square + 2.0 * y * y) * p1 + mixed * x * y * p2 + cy,
        );
        let pixel = [
            x * self.focal[0] + self.center[0],
            y * self.focal[1] + self.center[1],
        ];
        pixel.iter().all(|side| side.is_finite()).then_some(pixel)
    }

    /// Returns (x, y) of the point (x, y, 1) that a pixel shows; `None` if there is none.
    pub(crate) fn unproject(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        const STEP: f64 = 1e-6;
        let mut at = [
            (pixel[0] - self.center[0]) / self.focal[0],
            (pixel[1] - self.center[1]) / self.focal[1],
        ];
        // The start may be outside of the model if the lens distorts inwards.
        let reach = at[0].hypot(at[1]);
        if reach > 0.9 * self.radius {
            at = at.map(|side| side * 0.9 * self.radius / reach);
        }
        for _ in 0..ROUNDS {
            let here = self.project(at)?;
            let off = [pixel[0] - here[0], pixel[1] - here[1]];
            if off[0].hypot(off[1]) < CLOSE {
                return Some(at);
            }
            let right = self.project([at[0] + STEP, at[1]])?;
            let below = self.project([at[0], at[1] + STEP])?;
            let [a, c] = [0, 1].map(|side| (right[side] - here[side]) / STEP);
            let [b, d] = [0, 1].map(|side| (below[side] - here[side]) / STEP);
            let determinant = a * d - b * c;
            if determinant.abs() < 1e-9 {
                return None;
            }
            let mut step = [
                (d * off[0] - b * off[1]) / determinant,
                (a * off[1] - c * off[0]) / determinant,
            ];
            // A step beyond the edge of the model is halved.
            for _ in 0..ROUNDS {
                if self.project([at[0] + step[0], at[1] + step[1]]).is_some() {
                    break;
                }
                step = step.map(|side| 0.5 * side);
            }
            at = [at[0] + step[0], at[1] + step[1]];
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intrinsics(distortion: DistortionModel, coefficients: &[f64]) -> Intrinsics {
        Intrinsics {
            width: 640,
            height: 576,
            focal: [504.0, 503.0],
            center: [320.5, 331.0],
            distortion,
            coefficients: coefficients.to_vec(),
        }
    }

    #[test]
    fn projecting_the_ray_of_a_pixel_returns_the_pixel() {
        // As large as in the maker's calibrations.
        let rational = [0.65, 0.04, 1e-4, -8e-5, -4e-3, 0.99, 0.15, -0.02];
        for intrinsics in [
            intrinsics(DistortionModel::None, &[]),
            intrinsics(DistortionModel::Radtan, &[-0.28, 0.07, 1e-4, 2e-4]),
            intrinsics(DistortionModel::Rational, &rational),
            intrinsics(DistortionModel::Equidistant, &[-0.01, 0.005, 1e-3, -1e-4]),
        ] {
            let lens = Lens::from_intrinsics(&intrinsics);
            for (x, y) in [(0.0, 0.0), (320.5, 331.0), (639.0, 575.0), (12.0, 500.0)] {
                let ray = lens.unproject([x, y]).unwrap();
                let back = lens.project(ray).unwrap();
                assert!(
                    (back[0] - x).abs() < 0.01 && (back[1] - y).abs() < 0.01,
                    "{back:?}"
                );
            }
        }
    }

    #[test]
    fn rays_beyond_the_turning_point_have_no_pixel() {
        let lens =
            Lens::from_intrinsics(&intrinsics(DistortionModel::Radtan, &[-0.3, 0.0, 0.0, 0.0]));
        // r − 0.3 r³ turns at r = 1.054.
        assert!(lens.project([1.0, 0.0]).is_some());
        assert_eq!(lens.project([1.1, 0.0]), None);
        assert_eq!(lens.unproject([5_000.0, 331.0]), None);
        assert_eq!(lens.project([f64::NAN, 0.0]), None);
    }
}
