//! Ground truth of the sensor's registers: the values, and when they came.

use stm32f4_sim::time::SimTime;

/// One sample, as it was written into the sensor's registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleRecord {
    /// Counted from zero over the whole run, power cuts included.
    pub number: u64,
    /// When it was written, which is when data-ready was asserted.
    pub at: SimTime,
    /// True if data-ready made an edge on the pin: not if the interrupt is
    /// disabled, or still latched from a sample before.
    pub edge: bool,
    /// The register values.
    pub values: Values,
}

/// The measurements of a sample, as seven numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Values {
    /// Acceleration, in counts.
    pub accel: [i16; 3],
    /// Temperature, in counts.
    pub temperature: i16,
    /// Angular rate, in counts.
    pub gyro: [i16; 3],
}

impl Values {
    /// The 14 bytes from ACCEL_XOUT_H of an MPU on.
    #[must_use]
    pub fn bytes(&self) -> [u8; 14] {
        let [ax, ay, az] = self.accel;
        let [gx, gy, gz] = self.gyro;
        bytes_of([ax, ay, az, self.temperature, gx, gy, gz])
    }
}

/// Numbers as registers hold them: high byte first.
pub(super) fn bytes_of(words: [i16; 7]) -> [u8; 14] {
    let mut bytes = [0; 14];
    for (pair, word) in bytes.chunks_exact_mut(2).zip(words) {
        pair.copy_from_slice(&word.to_be_bytes());
    }
    bytes
}
