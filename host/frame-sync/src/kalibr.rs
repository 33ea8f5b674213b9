//! What Kalibr found (`camchain-imucam.yaml`), into the rig profile.
//!
//! Of the file, `cam0` is the phone and `cam1`, if it is there, the colour camera of the
//! depth camera, as `extract --format kalibr` names them; `T_cam_imu` leads from the frame
//! of the board's IMU to that of the camera.
//!
//! Limits: of YAML this reads what Kalibr writes: names of cameras, below them keys with
//! words or numbers, in brackets or as lists, over as many lines as it takes.

use std::collections::BTreeMap;
use std::path::Path;

use recording::profile::{DistortionModel, Intrinsics, Pose, Profile, ProfileError};
use toml_edit::{Array, InlineTable, Item, Value};

use crate::learn::{open, phone_table};

/// Name of the phone in the file.
const PHONE: &str = "cam0";
/// Name of the depth camera's colour camera.
const COLOR: &str = "cam1";

/// Why nothing was taken over.
#[derive(Debug, thiserror::Error)]
pub enum KalibrError {
    /// The file is not what Kalibr writes.
    #[error("{0}; expected the camchain-imucam.yaml that kalibr_calibrate_imu_camera writes")]
    Chain(String),
    /// The profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
}

/// What was taken over.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Imported {
    /// Intrinsics of the phone.
    pub camera: Intrinsics,
    /// From the board's IMU to the phone's camera.
    pub from_imu: Pose,
    /// From the board's IMU to the depth camera's colour camera.
    pub color_from_imu: Option<Pose>,
}

/// Puts what Kalibr found into a profile's text; comments and order stay. `name` is that
/// of the phone; without it, it is `[phone]`.
///
/// # Errors
///
/// The chain is none of Kalibr's, or the profile is not valid or would not be one with it.
pub fn into_profile(
    text: &str,
    path: &Path,
    name: Option<&str>,
    chain: &str,
) -> Result<(String, Imported), KalibrError> {
    let chain = read(chain)?;
    let phone = chain
        .get(PHONE)
        .ok_or_else(|| KalibrError::Chain(format!("it has no {PHONE}")))?;
    let imported = Imported {
        camera: intrinsics(phone)?,
        from_imu: pose(PHONE, phone)?,
        color_from_imu: chain.get(COLOR).map(|keys| pose(COLOR, keys)).transpose()?,
    };
    let (profile, mut document) = open(text, path)?;
    let known = profile
        .all_phones()
        .find(|phone| name.is_some_and(|name| phone.name == name))
        .unwrap_or(&profile.phone);
    let others = known.cameras.iter();
    let others = others.filter(|camera| camera.size() != imported.camera.size());
    let cameras: Array = others.chain([&imported.camera]).map(camera_value).collect();
    let table = phone_table(&mut document, &profile, name, path)?;
    table.insert("from_imu", pose_item(&imported.from_imu));
    table.insert("cameras", toml_edit::value(cameras));
    if let Some(pose) = &imported.color_from_imu {
        let depth = document.entry("depth").or_insert(toml_edit::table());
        let depth = depth.as_table_mut().ok_or_else(|| ProfileError::Syntax {
            path: Some(path.to_owned()),
            reason: String::from("`depth` is no table"),
        })?;
        depth.insert("color_from_imu", pose_item(pose));
    }
    let text = document.to_string();
    Profile::parse(&text, Some(path))?;
    Ok((text, imported))
}

type Keys = BTreeMap<String, Vec<String>>;

/// Cameras, their keys, and the words of each.
fn read(text: &str) -> Result<BTreeMap<String, Keys>, KalibrError> {
    let mut cameras: BTreeMap<String, Keys> = BTreeMap::new();
    let (mut camera, mut key) = (None, None);
    for line in text.lines() {
        let line = line.split(" #").next().unwrap_or_default().trim_end();
        if line.starts_with('#') || line.is_empty() || line == "---" {
            continue;
        }
        let (name, rest) = match line.split_once(':') {
            Some((name, rest)) => (Some(name), rest),
            None => (None, line),
        };
        match name {
            Some(name) if !name.starts_with(' ') => {
                camera = Some(name.to_owned());
                key = None;
                cameras.entry(name.to_owned()).or_default();
                continue;
            }
            Some(name) => key = Some(name.trim().to_owned()),
            None => {}
        }
        let (Some(camera), Some(key)) = (&camera, &key) else {
            let line: String = line.chars().take(40).collect();
            return Err(KalibrError::Chain(format!("{line:?} belongs to no camera")));
        };
        let words = rest
            .split([' ', ',', '[', ']'])
            .filter(|word| !word.is_empty() && *word != "-");
        if let Some(keys) = cameras.get_mut(camera) {
            let slot = keys.entry(key.clone()).or_default();
            slot.extend(words.map(str::to_owned));
        }
    }
    Ok(cameras)
}

fn numbers<const N: usize>(name: &str, keys: &Keys, key: &str) -> Result<[f64; N], KalibrError> {
    let words = keys.get(key).map_or(&[][..], Vec::as_slice);
    let values: Vec<f64> = words.iter().filter_map(|word| word.parse().ok()).collect();
    if values.len() == words.len()
        && let Ok(values) = values.try_into()
    {
        return Ok(values);
    }
    let count = words.len();
    Err(KalibrError::Chain(format!(
        "{key} of {name} has {count} values, and not {N} numbers"
    )))
}

fn word<'a>(keys: &'a Keys, key: &str) -> &'a str {
    keys.get(key)
        .and_then(|words| words.first())
        .map_or("", String::as_str)
}

fn pose(name: &str, keys: &Keys) -> Result<Pose, KalibrError> {
    let cells = numbers::<16>(name, keys, "T_cam_imu")?;
    Ok(Pose([0, 1, 2, 3].map(|row| {
        [0, 1, 2, 3].map(|column| cells[4 * row + column])
    })))
}

fn intrinsics(keys: &Keys) -> Result<Intrinsics, KalibrError> {
    let model = word(keys, "camera_model");
    if model != "pinhole" {
        return Err(KalibrError::Chain(format!(
            "{PHONE} has camera_model {model:?}, and only pinhole can be taken over"
        )));
    }
    let (distortion, coefficients) = match word(keys, "distortion_model") {
        "none" => (DistortionModel::None, Vec::new()),
        "radtan" => (
            DistortionModel::Radtan,
            numbers::<4>(PHONE, keys, "distortion_coeffs")?.to_vec(),
        ),
        "equidistant" => (
            DistortionModel::Equidistant,
            numbers::<4>(PHONE, keys, "distortion_coeffs")?.to_vec(),
        ),
        other => {
            return Err(KalibrError::Chain(format!(
                "{PHONE} has distortion_model {other:?}, and radtan, equidistant or none can be taken over"
            )));
        }
    };
    let [fx, fy, cx, cy] = numbers(PHONE, keys, "intrinsics")?;
    let side = |value: f64| {
        let whole = value.fract() == 0.0 && (1.0..=16_384.0).contains(&value);
        whole.then_some(value as u32)
    };
    let [width, height] = numbers(PHONE, keys, "resolution")?;
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
    use recording::profile::DEFAULT;

    use super::*;

    /// As PyYAML writes it in both of its styles, long lines broken.
    const CHAIN: &str = "cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.0212]
  - [0.0, 0.0, -1.0,
    -0.031]
  - [1.0, 0.0, 0.0, 1.5e-3]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.7e-05]
  distortion_model: radtan
  intrinsics: [1412.5, 1410.25, 958.0, 541.5]
  resolution: [1920, 1080]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: -0.0021
cam1:
  T_cam_imu:
  - - 1.0
    - 0.0
    - 0.0
    - -0.05
  - - 0.0
    - 1.0
    - 0.0
    - 0.0
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
";

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
        for (from, to, told) in [
            ("cam0:", "camera:", "no cam0"),
            ("pinhole", "omni", "\"omni\""),
            ("radtan", "fov", "\"fov\""),
            ("1412.5, ", "", "3 values, and not 4"),
            ("0.0212", "x", "16 values, and not 16 numbers"),
            ("1920, 1080", "0, 1080", "0 × 1080"),
            (
                "[0.0, -1.0, 0.0, 0.0212]",
                "[0.5, -1.0, 0.0, 0.0]",
                "phone.from_imu",
            ),
        ] {
            let chain = CHAIN.replace(from, to);
            let error = into_profile(DEFAULT, Path::new("rig.toml"), None, &chain).unwrap_err();
            assert!(error.to_string().contains(told), "{from}: {error}");
        }
        assert!(into_profile(DEFAULT, Path::new("x"), None, "- 1\n").is_err());
    }
}
