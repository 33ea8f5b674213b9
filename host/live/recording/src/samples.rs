//! Joins the messages about each sample of the board's IMU.
//!
//! A sample is written as up to three messages with one stamp, each of a standard ROS type where
//! there is one: flags ([`ImuFlags`], only if the sample is unusual), rates and accelerations
//! ([`Imu`]), and [`Temperature`]. They follow each other in the file, but damage may take any of
//! them: a sample without a temperature is released once 64 others wait after it.

use std::collections::VecDeque;

use super::messages::{Imu, ImuFlags, Temperature, Time};

/// Most samples that wait for a temperature.
const WAITING: usize = 64;

/// One sample of the board's IMU, as a recording has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordedSample {
    /// Board time of the data-ready edge; the filter's delay is not subtracted.
    pub stamp: Time,
    /// Rates of rotation, rad/s.
    pub gyro: [f64; 3],
    /// Accelerations, m/s².
    pub accel: [f64; 3],
    /// Temperature of the sensor, °C, unless its message is missing.
    pub temperature: Option<f64>,
    /// True if the board marked the sample as late or at the end of its range.
    pub is_marked: bool,
}

/// Samples whose messages are being joined.
#[derive(Default)]
pub struct SampleJoiner {
    /// Samples in the order of the file; those at the front wait for a temperature.
    waiting: VecDeque<RecordedSample>,
    /// Stamp of the last flags that mark a sample as late or at the end of its range.
    marked: Option<Time>,
}

impl SampleJoiner {
    /// Remembers the flags of the sample that comes next.
    pub fn add_flags(&mut self, flags: &ImuFlags) {
        if flags.late || flags.saturated {
            self.marked = Some(flags.header.stamp);
        }
    }

    /// Adds a sample, which waits for its temperature.
    pub fn add_imu(&mut self, imu: &Imu) {
        let stamp = imu.header.stamp;
        self.waiting.push_back(RecordedSample {
            stamp,
            gyro: imu.angular_velocity,
            accel: imu.linear_acceleration,
            temperature: None,
            is_marked: self.marked.take_if(|marked| *marked == stamp).is_some(),
        });
    }

    /// Adds the temperature of the sample with the same stamp.
    pub fn add_temperature(&mut self, value: &Temperature) {
        let mut samples = self.waiting.iter_mut();
        if let Some(sample) = samples.find(|sample| sample.stamp == value.header.stamp) {
            sample.temperature = Some(value.temperature);
        }
    }

    /// Returns the next sample, if it is complete or has waited for too long.
    pub fn next_ready(&mut self) -> Option<RecordedSample> {
        let is_ready = self.waiting.len() > WAITING || self.waiting.front()?.temperature.is_some();
        if is_ready {
            self.waiting.pop_front()
        } else {
            None
        }
    }

    /// Returns all samples that are left when the file ends.
    pub fn drain(&mut self) -> impl Iterator<Item = RecordedSample> {
        self.waiting.drain(..)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::Header;

    fn header(sec: i32) -> Header {
        Header {
            stamp: Time { sec, nanosec: 0 },
            frame_id: String::new(),
        }
    }

    fn imu(sec: i32) -> Imu {
        Imu {
            header: header(sec),
            orientation: [0.0; 4],
            orientation_covariance: [0.0; 9],
            angular_velocity: [f64::from(sec), 0.0, 0.0],
            angular_velocity_covariance: [0.0; 9],
            linear_acceleration: [0.0; 3],
            linear_acceleration_covariance: [0.0; 9],
        }
    }

    fn temperature(sec: i32) -> Temperature {
        Temperature {
            header: header(sec),
            temperature: 30.0,
            variance: 0.0,
        }
    }

    #[test]
    fn a_sample_comes_with_its_own_temperature_and_flags() {
        let mut joiner = SampleJoiner::default();
        let flags = |sec, late| ImuFlags {
            header: header(sec),
            late,
            saturated: false,
            first: true,
            after_loss: false,
        };
        joiner.add_flags(&flags(0, false));
        joiner.add_imu(&imu(0));
        // The sample of these flags is lost.
        joiner.add_flags(&flags(1, true));
        joiner.add_imu(&imu(2));
        joiner.add_temperature(&temperature(2));
        assert_eq!(joiner.next_ready(), None);
        joiner.add_temperature(&temperature(0));
        joiner.add_flags(&flags(3, true));
        joiner.add_imu(&imu(3));
        let ready: Vec<_> = std::iter::from_fn(|| joiner.next_ready()).collect();
        let found = ready
            .iter()
            .map(|s| (s.stamp.sec, s.temperature, s.is_marked));
        assert!(found.eq([(0, Some(30.0), false), (2, Some(30.0), false)]));
        let left: Vec<_> = joiner.drain().collect();
        assert_eq!(left.len(), 1);
        assert!(left[0].is_marked && left[0].temperature.is_none());
    }

    #[test]
    fn a_sample_without_a_temperature_holds_up_no_more_than_64() {
        let mut joiner = SampleJoiner::default();
        let mut ready = 0;
        for sec in 0..100 {
            joiner.add_imu(&imu(sec));
            if sec > 0 {
                joiner.add_temperature(&temperature(sec));
            }
            while let Some(sample) = joiner.next_ready() {
                assert_eq!(sample.stamp.sec, ready);
                ready += 1;
            }
            assert_eq!(ready, if sec < 64 { 0 } else { sec + 1 });
        }
    }
}
