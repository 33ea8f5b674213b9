//! Noise of the two IMUs, for the formats that tell it.

/// White noise and random walks of an IMU.
pub(super) struct Noise {
    /// rad/s/√Hz.
    pub(super) gyro: f64,
    /// rad/s²/√Hz.
    pub(super) gyro_walk: f64,
    /// m/s²/√Hz.
    pub(super) accel: f64,
    /// m/s³/√Hz.
    pub(super) accel_walk: f64,
    /// Where the numbers come from.
    pub(super) source: &'static str,
}

/// Noise of the board's MPU-9150: gyroscope 0.005 °/s/√Hz, accelerometer
/// 400 µg/√Hz (MPU-9150 product specification, 6.1 and 6.2). The random walks are
/// not specified; these are values usual for the part, to be replaced by an Allan
/// variance of the own one.
pub(super) const MPU_9150: Noise = Noise {
    gyro: 8.7e-5,
    gyro_walk: 2.0e-5,
    accel: 3.9e-3,
    accel_walk: 3.0e-3,
    source: "data sheet of the MPU-9150; random walks are usual values, not measured",
};

/// A phone's IMU, usual values.
pub(super) const PHONE: Noise = Noise {
    gyro: 1.7e-4,
    gyro_walk: 2.0e-5,
    accel: 2.0e-3,
    accel_walk: 3.0e-3,
    source: "usual values of phones, not measured",
};

impl Noise {
    /// Variances of a sample of gyroscope (rad²/s²) and accelerometer (m²/s⁴): white noise
    /// at this many samples a second, as Kalibr has it. Zeros: the rate is not known.
    pub(super) fn variances(&self, rate: Option<f64>) -> [f64; 2] {
        let rate = rate.unwrap_or(0.0);
        [self.gyro, self.accel].map(|density| density * density * rate)
    }

    /// As lines of YAML.
    pub(super) fn yaml(&self) -> String {
        format!(
            "# noise: {}\ngyroscope_noise_density: {:e}\ngyroscope_random_walk: {:e}\n\
             accelerometer_noise_density: {:e}\naccelerometer_random_walk: {:e}\n",
            self.source, self.gyro, self.gyro_walk, self.accel, self.accel_walk
        )
    }
}
