//! The depth camera's own calibration, `calibration.json` of its recording.
//!
//! Intrinsics are relative to the whole sensor, as fractions of its size with (0, 0) at the
//! corner; each mode bins and crops it (`src/transformation/mode_specific_calibration.c`
//! of the maker's SDK). Parameters are cx, cy, fx, fy, k1 to k6, codx, cody, p2, p1
//! (`k4atypes.h`). Translations are in metres, from depth to the camera.

use recording::profile::{DistortionModel, Intrinsics, Pose};
use serde::Deserialize;

use super::lens::{Lens, LensModel};
use super::register::ImageGeometry;

/// Largest tangent covered by a calibration that does not state it
/// (`src/calibration/calibration.c`).
const DEFAULT_RADIUS: f64 = 1.7;

/// Part of the sensor that a mode's images show, in pixels of the mode.
struct Crop {
    /// Width and height of the whole, binned sensor.
    sensor: [f64; 2],
    /// Columns and rows of it before the image.
    origin: [f64; 2],
    /// Width and height of the image.
    size: (u32, u32),
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct File {
    calibration_information: Information,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct Information {
    cameras: Vec<Raw>,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct Raw {
    location: String,
    intrinsics: RawIntrinsics,
    rt: RawPose,
    sensor_width: f64,
    sensor_height: f64,
    #[serde(default)]
    metric_radius: f64,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct RawIntrinsics {
    model_type: String,
    model_parameters: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct RawPose {
    rotation: [f64; 9],
    translation: [f64; 3],
}

/// One of the device's cameras, in the mode of a recording.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CalibratedCamera {
    pub(crate) lens: Lens,
    /// Width and height of the images in pixels.
    pub(crate) size: (u32, u32),
    /// Intrinsics in the form of other programs, which do not know the maker's older model.
    pub(crate) intrinsics: Option<Intrinsics>,
    /// Pose: from the device's origin, which is the depth camera, to this camera.
    pose: Pose,
}

impl CalibratedCamera {
    /// Returns lens and size of the images.
    pub(crate) fn image(&self) -> ImageGeometry<'_> {
        ImageGeometry {
            lens: &self.lens,
            size: self.size,
        }
    }
}

/// Calibration of depth and colour camera.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Calibration {
    pub(crate) depth: CalibratedCamera,
    /// The colour camera, if colour was recorded.
    pub(crate) color: Option<CalibratedCamera>,
    /// Pose of the colour camera, also without recorded colour.
    pub(crate) color_from_depth: Pose,
}

/// Reads a calibration for the depth mode `mode` and for colour images of the size `color`.
///
/// # Errors
///
/// Returns what was found and what was expected.
pub(crate) fn read(
    json: &[u8],
    mode: Option<&str>,
    color: Option<(u32, u32)>,
) -> Result<Calibration, String> {
    let file: File = serde_json::from_slice(json)
        .map_err(|error| format!("the camera's calibration.json cannot be read: {error}"))?;
    let cameras = &file.calibration_information.cameras;
    let find = |location: &str| {
        cameras
            .iter()
            .find(|camera| camera.location == location)
            .ok_or_else(|| {
                format!(
                    "the camera's calibration.json has {} cameras and none at {location}",
                    cameras.len()
                )
            })
    };
    let raw_depth = find("CALIBRATION_CameraLocationD0")?;
    let raw_color = find("CALIBRATION_CameraLocationPV0")?;
    let mode = mode.unwrap_or("no mode");
    let crop = depth_crop(mode)
        .ok_or_else(|| format!("depth mode {mode} has no calibration that is known"))?;
    let depth = camera(raw_depth, crop)?;
    let color_camera = match color {
        None => None,
        Some(size) => {
            let crop = color_crop(raw_color, size).ok_or_else(|| {
                format!(
                    "colour of {} × {} has no calibration that is known",
                    size.0, size.1
                )
            })?;
            Some(camera(raw_color, crop)?)
        }
    };
    let color_from_depth = pose(&raw_color.rt)?.after(&depth.pose.inverse());
    Ok(Calibration {
        depth,
        color: color_camera,
        color_from_depth,
    })
}

/// Returns the part of the sensor that a depth mode shows; `None` for an unknown mode.
fn depth_crop(mode: &str) -> Option<Crop> {
    let (sensor, origin, size) = match mode {
        "NFOV_UNBINNED" => (1024.0, [192.0, 180.0], (640, 576)),
        "NFOV_2X2BINNED" => (512.0, [96.0, 90.0], (320, 288)),
        "WFOV_UNBINNED" | "PASSIVE_IR" => (1024.0, [0.0; 2], (1024, 1024)),
        "WFOV_2X2BINNED" => (512.0, [0.0; 2], (512, 512)),
        _ => return None,
    };
    Some(Crop {
        sensor: [sensor; 2],
        origin,
        size,
    })
}

/// Returns the part of the sensor that colour images of a size show; `None` for an unknown size
/// or calibration. The sensor is 4:3, images of 16:9 are its middle. The first cameras have
/// calibrations of 16:9 images.
fn color_crop(raw: &Raw, (width, height): (u32, u32)) -> Option<Crop> {
    let known = [
        (1280, 720),
        (1920, 1080),
        (2560, 1440),
        (3840, 2160),
        (2048, 1536),
        (4096, 3072),
    ];
    if !known.contains(&(width, height)) {
        return None;
    }
    let whole = [f64::from(width), f64::from(width) * 0.75];
    let cut = [0.0, 0.5 * (whole[1] - f64::from(height))];
    let size = (width, height);
    // A calibration of 16:9 has the same width, and its rows begin an eighth later.
    let wide = (raw.sensor_width * 9.0 - raw.sensor_height * 16.0).abs() < 1e-6;
    let four_to_three = (raw.sensor_width * 3.0 - raw.sensor_height * 4.0).abs() < 1e-6;
    if wide {
        let own = [whole[0], whole[0] * 9.0 / 16.0];
        let before = 0.5 * (whole[1] - own[1]);
        return Some(Crop {
            sensor: own,
            origin: [0.0, cut[1] - before],
            size,
        });
    }
    four_to_three.then_some(Crop {
        sensor: whole,
        origin: cut,
        size,
    })
}

/// Reads a pose, unless it has absurd values.
fn pose(raw: &RawPose) -> Result<Pose, String> {
    let row = |row: usize| [0, 1, 2].map(|column| raw.rotation[3 * row + column]);
    let rotation = [row(0), row(1), row(2)];
    let values = raw.rotation.iter().chain(&raw.translation);
    if values.into_iter().all(|value| value.abs() <= 10.0) {
        Ok(Pose::new(rotation, raw.translation))
    } else {
        Err(String::from(
            "the camera's calibration.json has a pose that is not a rigid motion",
        ))
    }
}

/// Reads a camera for the part of its sensor that the images show.
fn camera(raw: &Raw, crop: Crop) -> Result<CalibratedCamera, String> {
    let Crop {
        sensor,
        origin,
        size,
    } = crop;
    let Some(&[cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, codx, cody, p2, p1]) =
        raw.intrinsics.model_parameters.first_chunk::<14>()
    else {
        return Err(format!(
            "the camera's calibration.json has {} parameters of a lens, expected 14",
            raw.intrinsics.model_parameters.len()
        ));
    };
    let brown = match raw.intrinsics.model_type.as_str() {
        "CALIBRATION_LensDistortionModelBrownConrady" => true,
        "CALIBRATION_LensDistortionModelRational6KT" => false,
        other => {
            let other: String = other.chars().take(64).collect();
            return Err(format!(
                "the camera's calibration.json has a lens of model {other:?}; expected \
                 CALIBRATION_LensDistortionModelBrownConrady or …Rational6KT"
            ));
        }
    };
    // Pixels count from the centre of the first.
    let focal = [fx * sensor[0], fy * sensor[1]];
    let center = [
        cx * sensor[0] - origin[0] - 0.5,
        cy * sensor[1] - origin[1] - 0.5,
    ];
    if !(focal.iter().all(|&side| side > 0.0 && side < 1e6)) {
        return Err(format!(
            "the camera's calibration.json has focal lengths of {focal:?} pixels"
        ));
    }
    let model = LensModel::Brown {
        radial: [k1, k2, k3, k4, k5, k6],
        tangential: [p1, p2],
        center: if brown { [0.0; 2] } else { [codx, cody] },
        mixed: if brown { 2.0 } else { 1.0 },
    };
    let radius = Some(raw.metric_radius)
        .filter(|&radius| radius > 1e-4)
        .unwrap_or(DEFAULT_RADIUS);
    let intrinsics = brown.then(|| Intrinsics {
        width: size.0,
        height: size.1,
        focal,
        center,
        distortion: DistortionModel::Rational,
        coefficients: vec![k1, k2, p1, p2, k3, k4, k5, k6],
    });
    Ok(CalibratedCamera {
        lens: Lens::new(focal, center, model, Some(radius)),
        size,
        intrinsics,
        pose: pose(&raw.rt)?,
    })
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64;

    use super::*;

    fn file() -> String {
        test_support::calibrations::k4a().to_string()
    }

    #[test]
    fn each_mode_shows_its_part_of_the_sensor() {
        let near = |found: [f64; 2], expected: [f64; 2]| {
            let is_near = |axis: usize| (found[axis] - expected[axis]).abs() < 1e-9;
            assert!(is_near(0) && is_near(1), "{found:?} and {expected:?}");
        };
        let found = read(file().as_bytes(), Some("NFOV_UNBINNED"), Some((1920, 1080))).unwrap();
        let depth = found.depth.intrinsics.unwrap();
        // Without the 192 columns and 180 rows before it, from the first pixel's centre.
        near(
            depth.center,
            [0.502 * 1024.0 - 192.5, 0.498 * 1024.0 - 180.5],
        );
        assert_eq!(found.depth.size, (640, 576));
        let color = found.color.unwrap().intrinsics.unwrap();
        near(color.center, [0.498 * 1920.0 - 0.5, 0.502 * 1440.0 - 180.5]);
        near(color.focal, [0.475 * 1920.0, 0.634 * 1440.0]);
        // The first cameras have calibrations of 16:9 images.
        let old = file().replace(":3072", ":2304");
        let old = read(old.as_bytes(), Some("NFOV_UNBINNED"), Some((2048, 1536))).unwrap();
        let color = old.color.unwrap().intrinsics.unwrap();
        near(color.center, [0.498 * 2048.0 - 0.5, 0.502 * 1152.0 + 191.5]);
        near(color.focal, [0.475 * 2048.0, 0.634 * 1152.0]);
    }

    #[test]
    fn faults_are_named_and_random_damage_does_not_panic() {
        let good = file();
        for (from, to, message) in [
            (
                "LocationD0",
                "LocationX",
                "none at CALIBRATION_CameraLocationD0",
            ),
            ("0.502,0.498,", "", "12 parameters"),
            ("BrownConrady", "Theta", "of model"),
            ("0.4926,0.4927", "0.4926,-1", "focal lengths"),
            ("CalibrationInformation", "Other", "cannot be read"),
        ] {
            let error = read(
                good.replacen(from, to, 1).as_bytes(),
                Some("NFOV_UNBINNED"),
                None,
            );
            assert!(error.unwrap_err().contains(message), "{from}");
        }
        assert!(
            read(good.as_bytes(), Some("OFF"), None)
                .unwrap_err()
                .contains("OFF")
        );
        assert!(read(good.as_bytes(), Some("NFOV_UNBINNED"), Some((7, 7))).is_err());
        let mut random = Pcg64::seed_from_u64(1);
        for _ in 0..3_000 {
            let mut bad = good.clone().into_bytes();
            for _ in 0..random.random_range(1..=4) {
                let at = random.random_range(0..bad.len());
                bad[at] = b"0123456789e-.,[]{}\"x"[random.random_range(0..20)];
            }
            if let Ok(found) = read(&bad, Some("NFOV_UNBINNED"), Some((1280, 720))) {
                for pixel in [[0.0, 0.0], [639.0, 575.0]] {
                    let ray = found.depth.lens.unproject(pixel);
                    let _ = ray.and_then(|ray| found.depth.lens.project(ray));
                }
            }
        }
    }
}
