//! Imports a calibration by Kalibr (`camchain-imucam.yaml`) into the rig profile.
//!
//! In the file, `cam0` is the phone and `cam1`, if present, the colour camera of the depth
//! camera, as `extract --format kalibr` names them; `T_cam_imu` transforms from the frame of the
//! board's IMU to that of the camera.

use std::path::Path;

use serde::Deserialize;
use toml_edit::{Array, InlineTable, Item, Value};

use crate::profile::edit::{open, phone_table, table};
use crate::profile::{DistortionModel, Intrinsics, Pose, Profile, ProfileError};

/// Name of the phone in the file.
const PHONE: &str = "cam0";
/// Name of the depth camera's colour camera.
const COLOR: &str = "cam1";

/// Error of an import.
#[derive(Debug, thiserror::Error)]
pub enum KalibrError {
    /// The file does not have the form that Kalibr writes; the text says why.
    #[error("{0}; expected the camchain-imucam.yaml that kalibr_calibrate_imu_camera writes")]
    Chain(String),
    /// The profile is not valid, or would not be with the calibration.
    #[error(transparent)]
    Profile(#[from] ProfileError),
}

/// Imported calibration.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Imported {
    /// Intrinsics of the phone.
    pub camera: Intrinsics,
    /// Transform from the frame of the board's IMU to that of the phone's camera, m.
    pub from_imu: Pose,
    /// Transform from the frame of the board's IMU to that of the depth camera's colour camera, m.
    pub color_from_imu: Option<Pose>,
}

/// Puts the calibration `chain` into the text of a profile and returns the new text; comments and
/// order stay. `name` is the name of the phone; without one, it is `[phone]`.
///
/// # Errors
///
/// Returns an error if the chain does not have Kalibr's form, or if the profile is not valid or
/// would not be valid with it.
pub fn into_profile(
    text: &str,
    path: &Path,
    name: Option<&str>,
    chain: &str,
) -> Result<(String, Imported), KalibrError> {
    let chain = read(chain)?;
    let phone = chain
        .cam0
        .ok_or_else(|| KalibrError::Chain(format!("it has no {PHONE}")))?;
    let color = chain.cam1.map(|color| pose(COLOR, &color.pose));
    let imported = Imported {
        camera: intrinsics(&phone)?,
        from_imu: pose(PHONE, &phone.pose)?,
        color_from_imu: color.transpose()?,
    };
    let (profile, mut document) = open(text, path)?;
    let known = profile
        .all_phones()
        .find(|phone| name.is_some_and(|name| phone.name == name))
        .unwrap_or(&profile.phone);
    let others = known.cameras.iter();
    let others = others.filter(|camera| camera.size() != imported.camera.size());
    let cameras: Array = others.chain([&imported.camera]).map(camera_value).collect();
    let phone = phone_table(&mut document, &profile, name, path)?;
    phone.insert("from_imu", pose_item(&imported.from_imu));
    phone.insert("cameras", toml_edit::value(cameras));
    if let Some(pose) = &imported.color_from_imu {
        table(&mut document, "depth", path)?.insert("color_from_imu", pose_item(pose));
    }
    let text = document.to_string();
    Profile::parse(&text, Some(path))?;
    Ok((text, imported))
}

/// The parts of the file that are read.
#[derive(Deserialize)]
struct Chain {
    cam0: Option<Camera>,
    cam1: Option<Camera>,
}

/// A camera; only the pose of the second one is used.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Camera {
    #[serde(rename = "T_cam_imu")]
    pose: Vec<Vec<f64>>,
    camera_model: String,
    intrinsics: Vec<f64>,
    distortion_model: String,
    distortion_coeffs: Vec<f64>,
    resolution: Vec<f64>,
}

fn read(text: &str) -> Result<Chain, KalibrError> {
    // Without a snippet the message is one line.
    let options = serde_saphyr::options! { with_snippet: false };
    serde_saphyr::from_str_with_options(text, options)
        .map_err(|error| KalibrError::Chain(error.to_string()))
}

fn numbers<const N: usize>(name: &str, key: &str, values: &[f64]) -> Result<[f64; N], KalibrError> {
    values.try_into().map_err(|_| {
        let count = values.len();
        KalibrError::Chain(format!(
            "{key} of {name} has {count} values, and not {N} numbers"
        ))
    })
}

fn pose(name: &str, rows: &[Vec<f64>]) -> Result<Pose, KalibrError> {
    let cells = numbers::<16>(name, "T_cam_imu", &rows.concat())?;
    Ok(Pose([0, 1, 2, 3].map(|row| {
        [0, 1, 2, 3].map(|column| cells[4 * row + column])
    })))
}

fn intrinsics(camera: &Camera) -> Result<Intrinsics, KalibrError> {
    let model = &camera.camera_model;
    if model != "pinhole" {
        return Err(KalibrError::Chain(format!(
            "{PHONE} has camera_model {model:?}, and only pinhole can be taken over"
        )));
    }
    let coefficients =
        || numbers::<4>(PHONE, "distortion_coeffs", &camera.distortion_coeffs).map(Vec::from);
    let (distortion, coefficients) = match camera.distortion_model.as_str() {
        "none" => (DistortionModel::None, Vec::new()),
        "radtan" => (DistortionModel::Radtan, coefficients()?),
        "equidistant" => (DistortionModel::Equidistant, coefficients()?),
        other => {
            return Err(KalibrError::Chain(format!(
                "{PHONE} has distortion_model {other:?}, and radtan, equidistant or none can be taken over"
            )));
        }
    };
    let [fx, fy, cx, cy] = numbers(PHONE, "intrinsics", &camera.intrinsics)?;
    let side = |value: f64| {
        let whole = value.fract() == 0.0 && (1.0..=16_384.0).contains(&value);
        whole.then_some(value as u32)
    };
    let [width, height] = numbers(PHONE, "resolution", &camera.resolution)?;
    let (Some(width), Some(height)) = (side(width), side(height)) else {
        return Err(KalibrError::Chain(format!(
            "the resolution of {PHONE} is {width} × {height}"
        )));
    };
    Ok(Intrinsics {
        width,
        height,
        focal: [fx, fy],
        center: [cx, cy],
        distortion,
        coefficients,
    })
}

fn pose_item(pose: &Pose) -> Item {
    let rows: Array = pose
        .0
        .iter()
        .map(|row| Value::from(row.iter().copied().collect::<Array>()))
        .collect();
    toml_edit::value(rows)
}

fn camera_value(camera: &Intrinsics) -> Value {
    let list = |values: &[f64]| Value::from(values.iter().copied().collect::<Array>());
    let mut table = InlineTable::new();
    table.insert("width", i64::from(camera.width).into());
    table.insert("height", i64::from(camera.height).into());
    table.insert("focal", list(&camera.focal));
    table.insert("center", list(&camera.center));
    table.insert("distortion", camera.distortion.name().into());
    table.insert("coefficients", list(&camera.coefficients));
    Value::from(table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::DEFAULT;
    use test_support::calibrations::CHAIN;

    #[test]
    fn a_chain_becomes_part_of_the_profile() {
        let (text, imported) = into_profile(DEFAULT, Path::new("rig.toml"), None, CHAIN).unwrap();
        let profile = Profile::parse(&text, None).unwrap();
        assert_eq!(
            profile.phone.cameras,
            std::slice::from_ref(&imported.camera)
        );
        assert_eq!(profile.phone.from_imu, Some(imported.from_imu));
        assert_eq!(imported.from_imu.translation(), [0.0212, -0.031, 1.5e-3]);
        assert_eq!(imported.camera.coefficients, [-0.28, 0.07, 0.0002, 1.7e-05]);
        let color = profile.depth.color_from_imu.unwrap();
        assert_eq!(color.translation(), [-0.05, 0.0, 0.0]);
        assert!(text.contains("# Where the app"));
        // Another size comes to it, and the same one replaces it.
        let other = CHAIN.replace("1920, 1080", "1280, 720");
        let (text, _) = into_profile(&text, Path::new("rig.toml"), None, &other).unwrap();
        let (text, _) = into_profile(&text, Path::new("rig.toml"), None, CHAIN).unwrap();
        assert_eq!(Profile::parse(&text, None).unwrap().phone.cameras.len(), 2);
    }

    #[test]
    fn what_is_no_chain_is_named() {
        for (from, to, expected) in [
            ("cam0:", "camera:", "no cam0"),
            ("pinhole", "omni", "\"omni\""),
            ("radtan", "fov", "\"fov\""),
            ("1412.5, ", "", "3 values, and not 4"),
            ("0.0212", "x", "line 3"),
            ("0.0212", "", "15 values, and not 16 numbers"),
            ("1920, 1080", "0, 1080", "0 × 1080"),
            (
                "[0.0, -1.0, 0.0, 0.0212]",
                "[0.5, -1.0, 0.0, 0.0]",
                "phone.from_imu",
            ),
        ] {
            let chain = CHAIN.replace(from, to);
            let error = into_profile(DEFAULT, Path::new("rig.toml"), None, &chain).unwrap_err();
            assert!(error.to_string().contains(expected), "{from}: {error}");
        }
        assert!(into_profile(DEFAULT, Path::new("x"), None, "- 1\n").is_err());
    }

    #[test]
    fn hostile_yaml_is_refused_without_using_the_machine_up() {
        // Names for ever larger lists, ten times the one before.
        let mut bomb = String::from("a0: &a0 [0, 0, 0, 0, 0, 0, 0, 0, 0, 0]\n");
        for level in 1..20 {
            let last = format!("*a{}", level - 1);
            bomb += &format!("a{level}: &a{level} [{}]\n", [last.as_str(); 10].join(", "));
        }
        let bomb = format!(
            "{bomb}{}",
            CHAIN.replace("[1412.5, 1410.25, 958.0, 541.5]", "*a19")
        );
        let deep = format!("cam0:\n  intrinsics: {}", "[".repeat(1 << 20));
        for chain in [bomb, deep] {
            let error = into_profile(DEFAULT, Path::new("rig.toml"), None, &chain).unwrap_err();
            assert!(matches!(error, KalibrError::Chain(_)), "{error}");
        }
    }
}
