//! The truth about what the sensor put into its registers, and when.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use stm32f4_sim::time::SimTime;

/// One sample, as it was written into the sensor's registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleRecord {
    /// Counted from zero over the whole run, power cuts included.
    pub number: u64,
    /// When it was written, which is when data-ready was asserted.
    pub at: SimTime,
    /// Whether data-ready made an edge on the pin: not if the interrupt is
    /// disabled, or still latched from a sample before.
    pub edge: bool,
    /// The register values.
    pub values: Values,
}

/// What a sample measured, as seven numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
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

/// Samples that were logged, oldest first.
///
/// Without a limit all are kept until they are taken (48 bytes each, 86 MB an
/// hour at 500 Hz); with one, the oldest are dropped and counted.
#[derive(Clone, Debug, Default)]
pub struct SampleLog {
    records: VecDeque<SampleRecord>,
    limit: Option<usize>,
    dropped: u64,
}

impl SampleLog {
    /// Keeps at most `limit` records; everything if `None`.
    pub fn set_limit(&mut self, limit: Option<usize>) {
        self.limit = limit;
        self.trim();
    }

    pub(super) fn push(&mut self, record: SampleRecord) {
        self.records.push_back(record);
        self.trim();
    }

    fn trim(&mut self) {
        while self.limit.is_some_and(|limit| self.records.len() > limit) {
            self.records.pop_front();
            self.dropped += 1;
        }
    }

    /// What is kept.
    pub fn iter(&self) -> impl Iterator<Item = &SampleRecord> {
        self.records.iter()
    }

    /// Takes out what is kept.
    pub fn take(&mut self) -> Vec<SampleRecord> {
        self.records.drain(..).collect()
    }

    /// How many records are kept.
    #[must_use]
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether none is kept.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// How many were dropped because of the limit.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}
