//! Samples of the board's IMU: one sample is up to three messages with the same stamp, which
//! [`samples`](crate::samples) joins again.

use serde::{Deserialize, Serialize};

use super::{HEADER, Header, RosMessage, TIME};

const VECTOR3: (&str, &str) = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");
const QUATERNION: (&str, &str) = (
    "geometry_msgs/Quaternion",
    "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
);

/// `sensor_msgs/msg/Imu`. The orientation is unknown: its covariance begins with −1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// Time of the data-ready edge; filter delays are not subtracted.
    pub header: Header,
    /// Unknown.
    pub orientation: [f64; 4],
    /// −1, then zeros: no orientation.
    pub orientation_covariance: [f64; 9],
    /// rad/s.
    pub angular_velocity: [f64; 3],
    /// rad²/s²; zeros: unknown.
    pub angular_velocity_covariance: [f64; 9],
    /// m/s².
    pub linear_acceleration: [f64; 3],
    /// m²/s⁴; zeros: unknown.
    pub linear_acceleration_covariance: [f64; 9],
}

impl RosMessage for Imu {
    const TYPE: &'static str = "sensor_msgs/msg/Imu";
    const DEFINITION: &'static str = "std_msgs/Header header\n\
        geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
        geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
        geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n";
    const USES: &'static [(&'static str, &'static str)] = &[HEADER, TIME, QUATERNION, VECTOR3];
}

/// `smartdepthsync_msgs/msg/ImuFlags`: marks a sample of the IMU as unusual.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuFlags {
    /// Time of the sample.
    pub header: Header,
    /// The sample was read so late that it may be the next one.
    pub late: bool,
    /// A value is at the end of its range.
    pub saturated: bool,
    /// The sample is the first after the sensor was set up.
    pub first: bool,
    /// A data-ready edge before this one was lost.
    pub after_loss: bool,
}

impl RosMessage for ImuFlags {
    const TYPE: &'static str = "smartdepthsync_msgs/msg/ImuFlags";
    const DEFINITION: &'static str = include_str!("../../ros/smartdepthsync_msgs/msg/ImuFlags.msg");
}

/// `sensor_msgs/msg/Temperature`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Temperature {
    /// Time of the IMU sample.
    pub header: Header,
    /// °C.
    pub temperature: f64,
    /// 0: unknown.
    pub variance: f64,
}

impl RosMessage for Temperature {
    const TYPE: &'static str = "sensor_msgs/msg/Temperature";
    const DEFINITION: &'static str =
        "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n";
}
