//! A sample of a gyroscope as a message of ROS 2.

use recording::messages::{CdrError, Header, Imu, Time, to_cdr};

/// The message in CDR, of `at` in ns and `rate` in rad/s.
pub(crate) fn message(at: i64, rate: [f64; 3]) -> Result<Vec<u8>, CdrError> {
    to_cdr(&Imu {
        header: Header {
            stamp: Time::from_nanos(at),
            frame_id: String::from("imu"),
        },
        orientation: [0.0; 4],
        orientation_covariance: [0.0; 9],
        angular_velocity: rate,
        angular_velocity_covariance: [0.0; 9],
        linear_acceleration: [0.0; 3],
        linear_acceleration_covariance: [0.0; 9],
    })
}
