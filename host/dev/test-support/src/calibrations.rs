//! Camera calibrations as other tools write them.

use serde_json::{Value, json};

/// A calibration of two cameras by Kalibr, as PyYAML writes it in both of its styles, long lines
/// broken.
pub const CHAIN: &str = "cam0:
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

/// A calibration as the camera has it, with made-up numbers of the usual size: depth, and
/// colour 32 mm beside it and tilted by 6°.
#[must_use]
pub fn k4a() -> Value {
    // cx, cy, fx, fy, k1 to k6, codx, cody, p2, p1.
    let depth = [
        0.502, 0.498, 0.4926, 0.4927, 0.65, 0.04, -0.004, 0.99, 0.15, -0.02, 0.0, 0.0, -8e-5, 1e-4,
    ];
    let color = [
        0.498, 0.502, 0.475, 0.634, 0.6, -2.8, 1.6, 0.48, -2.6, 1.5, 0.0, 0.0, -2e-4, 3e-4,
    ];
    let (sin, cos) = 6.0_f64.to_radians().sin_cos();
    let camera =
        |place: &str, lens: [f64; 14], rotation: [f64; 9], way: [f64; 3], side: [u32; 2]| {
            json!({
                "Location": format!("CALIBRATION_CameraLocation{place}"),
                "Intrinsics": {
                    "ModelParameterCount": 14,
                    "ModelParameters": lens,
                    "ModelType": "CALIBRATION_LensDistortionModelBrownConrady",
                },
                "MetricRadius": 1.74,
                "Rt": { "Rotation": rotation, "Translation": way },
                "SensorWidth": side[0],
                "SensorHeight": side[1],
            })
        };
    let imu = |kind: &str| {
        json!({
            "SensorType": format!("CALIBRATION_InertialSensorType_{kind}"),
            "BiasTemperatureModel": vec![0.0; 12], "BiasUncertainty": vec![1e-4; 3],
            "MixingMatrixTemperatureModel": vec![0.0; 36], "ModelTypeMask": 16,
            "Noise": vec![1e-3; 6], "SecondOrderScaling": vec![0.0; 9],
            "Rt": { "Rotation": [0, -1, 0, 0, 0, 1, -1, 0, 0], "Translation": [0, 0, 0] },
            "TemperatureBounds": [5, 60], "TemperatureC": 40.0,
        })
    };
    let (straight, none) = ([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [0.0; 3]);
    let tilted = [1.0, 0.0, 0.0, 0.0, cos, sin, 0.0, -sin, cos];
    json!({ "CalibrationInformation": {
        "Cameras": [
            camera("D0", depth, straight, none, [1024, 1024]),
            camera("PV0", color, tilted, [-0.032, -0.002, 0.004], [4096, 3072]),
        ],
        "InertialSensors": [imu("Gyro"), imu("Accelerometer")],
    } })
}
