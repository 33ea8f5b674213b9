//! Intrinsics and poses of the cameras in the rig profile.

use serde::{Deserialize, Serialize};

use super::ProfileError;
use super::check::{within, wrong};

/// Largest error of each product of two rows of a rotation.
const ORTHONORMAL: f64 = 1e-3;

/// Direction of the readout in an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// The first row of the image is exposed first.
    #[default]
    Down,
    /// The last row first.
    Up,
    /// The rightmost column first.
    Left,
    /// The leftmost column first.
    Right,
}

impl Direction {
    /// Returns the word in the profile.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Down => "down",
            Self::Up => "up",
            Self::Left => "left",
            Self::Right => "right",
        }
    }
}

/// Rigid transform from one frame to another: rows of a 4 × 4 matrix, translation in m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose(pub [[f64; 4]; 4]);

impl Pose {
    /// Returns the rows of the rotation.
    #[must_use]
    pub fn rotation(&self) -> [[f64; 3]; 3] {
        [0, 1, 2].map(|row| [0, 1, 2].map(|column| self.0[row][column]))
    }

    /// Returns the translation, m.
    #[must_use]
    pub fn translation(&self) -> [f64; 3] {
        [0, 1, 2].map(|row| self.0[row][3])
    }

    /// Creates a transform from the rows of a rotation and a translation, m.
    #[must_use]
    pub fn new(rotation: [[f64; 3]; 3], translation: [f64; 3]) -> Self {
        let row = |row: usize| {
            let [x, y, z] = rotation[row];
            [x, y, z, translation[row]]
        };
        Self([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]])
    }

    /// Returns the inverse transform.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation();
        let back = [0, 1, 2].map(|row| [0, 1, 2].map(|column| rotation[column][row]));
        let way = self.translation();
        let turned = back.map(|row| -(row[0] * way[0] + row[1] * way[1] + row[2] * way[2]));
        Self::new(back, turned)
    }

    /// Returns the transform that applies `other` first and then this one.
    #[must_use]
    pub fn after(&self, other: &Self) -> Self {
        let cell =
            |row: usize, column: usize| (0..4).map(|k| self.0[row][k] * other.0[k][column]).sum();
        Self([0, 1, 2, 3].map(|row| [0, 1, 2, 3].map(|column| cell(row, column))))
    }

    pub(super) fn check(&self, key: &'static str) -> Result<(), ProfileError> {
        let rotation = self.rotation();
        let product =
            |a: usize, b: usize| -> f64 { (0..3).map(|k| rotation[a][k] * rotation[b][k]).sum() };
        let orthonormal = (0..3).all(|a| {
            (a..3).all(|b| (product(a, b) - f64::from(u8::from(a == b))).abs() <= ORTHONORMAL)
        });
        let [x, y, z] = rotation;
        let determinant = x[0] * (y[1] * z[2] - y[2] * z[1]) - x[1] * (y[0] * z[2] - y[2] * z[0])
            + x[2] * (y[0] * z[1] - y[1] * z[0]);
        let near = self.translation().iter().all(|way| way.abs() <= 100.0);
        if orthonormal && determinant > 0.0 && near && self.0[3] == [0.0, 0.0, 0.0, 1.0] {
            return Ok(());
        }
        Err(wrong(
            key,
            format!("{:?}", self.0),
            "the rows of a rotation with a translation below 100 m, and 0, 0, 0, 1",
        ))
    }
}

/// Model of the distortion of a lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DistortionModel {
    /// No distortion.
    None,
    /// k1, k2, p1, p2 (Kalibr, OpenCV).
    Radtan,
    /// k1, k2, p1, p2, k3, k4, k5, k6 (OpenCV).
    Rational,
    /// Four coefficients of the angle (Kalibr, OpenCV's fisheye).
    Equidistant,
}

impl DistortionModel {
    /// Returns the number of coefficients.
    #[must_use]
    pub const fn coefficients(self) -> usize {
        match self {
            Self::None => 0,
            Self::Radtan | Self::Equidistant => 4,
            Self::Rational => 8,
        }
    }

    /// Returns the word in the profile.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Radtan => "radtan",
            Self::Rational => "rational",
            Self::Equidistant => "equidistant",
        }
    }
}

/// Intrinsics of a camera for one size of its images. The centre of the first pixel is
/// (0, 0).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Width of the images, pixels.
    pub width: u32,
    /// Height of the images, pixels.
    pub height: u32,
    /// Focal lengths along x and y, pixels.
    pub focal: [f64; 2],
    /// Principal point, pixels.
    pub center: [f64; 2],
    /// Model of the distortion.
    pub distortion: DistortionModel,
    /// Coefficients of the distortion, in the order of its model.
    pub coefficients: Vec<f64>,
}

impl Intrinsics {
    /// Returns width and height, pixels.
    #[must_use]
    pub const fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    pub(super) fn check(&self) -> Result<(), ProfileError> {
        let side = 1.0..=16_384.0;
        let [fx, fy] = self.focal;
        let [cx, cy] = self.center;
        within(
            "phone.cameras",
            &[
                ("width", self.width.into(), side.clone(), "pixels"),
                ("height", self.height.into(), side, "pixels"),
                ("focal", fx, 1.0..=1e6, "pixels"),
                ("focal", fy, 1.0..=1e6, "pixels"),
                ("center", cx, -1e5..=1e5, "pixels"),
                ("center", cy, -1e5..=1e5, "pixels"),
            ],
        )?;
        let expected = self.distortion.coefficients();
        let finite = self.coefficients.iter().all(|value| value.abs() <= 1e4);
        if self.coefficients.len() == expected && finite {
            return Ok(());
        }
        Err(wrong(
            "phone.cameras.coefficients",
            format!("{:?}", self.coefficients),
            format!("{expected} numbers for {}", self.distortion.name()),
        ))
    }
}
