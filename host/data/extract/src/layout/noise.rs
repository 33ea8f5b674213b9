//! Noise of the two IMUs, for the formats that state it.

use std::borrow::Cow;

use board::imu::STANDARD_GRAVITY;
use protocol::ImuSensor;

/// White noise and random walks of an IMU.
pub(super) struct Noise {
    /// Noise density of the gyroscope, rad/s/√Hz.
    pub(super) gyro: f64,
    /// Random walk of the gyroscope, rad/s²/√Hz.
    pub(super) gyro_walk: f64,
    /// Noise density of the accelerometer, m/s²/√Hz.
    pub(super) accel: f64,
    /// Random walk of the accelerometer, m/s³/√Hz.
    pub(super) accel_walk: f64,
    /// Origin of the numbers.
    pub(super) source: Cow<'static, str>,
}

/// Usual noise of a phone's IMU.
pub(super) const PHONE: Noise = Noise {
    gyro: 1.7e-4,
    gyro_walk: 2.0e-5,
    accel: 2.0e-3,
    accel_walk: 3.0e-3,
    source: Cow::Borrowed("usual values of phones, not measured"),
};

impl Noise {
    /// Returns the noise of the board's sensor by its data sheet, to two digits. The random walks
    /// are not specified: they are values usual for such parts, to be replaced by the Allan
    /// variance of the actual sensor.
    pub(super) fn of_sensor(sensor: &ImuSensor) -> Self {
        let gyro = (f64::from(sensor.gyro_noise_udps) * 1e-6).to_radians();
        let accel = f64::from(sensor.accel_noise_ug) * 1e-6 * STANDARD_GRAVITY;
        Self {
            gyro: two_digits(gyro),
            gyro_walk: 2.0e-5,
            accel: two_digits(accel),
            accel_walk: 3.0e-3,
            source: Cow::Owned(format!(
                "data sheet of the {}; random walks are usual values, not measured",
                sensor.model.name()
            )),
        }
    }

    /// Returns the variances of a sample of gyroscope (rad²/s²) and accelerometer (m²/s⁴): white
    /// noise at `rate` (Hz), as in Kalibr. They are 0 if the rate is unknown.
    pub(super) fn variances(&self, rate: Option<f64>) -> [f64; 2] {
        let rate = rate.unwrap_or(0.0);
        [self.gyro, self.accel].map(|density| density * density * rate)
    }

    /// Formats the noise as lines of YAML.
    pub(super) fn yaml(&self) -> String {
        format!(
            "# noise: {}\ngyroscope_noise_density: {:e}\ngyroscope_random_walk: {:e}\n\
             accelerometer_noise_density: {:e}\naccelerometer_random_walk: {:e}\n",
            self.source, self.gyro, self.gyro_walk, self.accel, self.accel_walk
        )
    }
}

/// Rounds to two significant digits.
fn two_digits(value: f64) -> f64 {
    format!("{value:.1e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_sensor_has_the_noise_of_its_data_sheet() {
        let noise = Noise::of_sensor(&ImuSensor::default());
        assert_eq!((noise.gyro, noise.accel), (8.7e-5, 3.9e-3));
        assert!(noise.source.contains("MPU-9150"), "{}", noise.source);
    }
}
