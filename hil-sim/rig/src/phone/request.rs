//! The IMU request as the app finds it in a line.

use super::sensors::Kind;

/// An IMU request (`RemoteRpcServer.java`:42).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ImuRequest {
    /// Milliseconds; none if the number does not go into the app's, which ends the app
    /// (line 76).
    pub(super) duration_ms: Option<i64>,
    /// Accelerometer, gyroscope, magnetometer.
    pub(super) wants: [bool; 3],
}

impl ImuRequest {
    /// Looks for the request anywhere in the line, as the app does.
    pub(super) fn find(line: &str) -> Option<Self> {
        line.match_indices("imu?duration=")
            .find_map(|(at, found)| Self::read(line.get(at + found.len()..)?))
    }

    fn read(rest: &str) -> Option<Self> {
        let digits = rest.find(|c: char| !c.is_ascii_digit())?;
        let duration = rest.get(..digits).filter(|digits| !digits.is_empty())?;
        let duration_ms = duration.parse().ok();
        let mut rest = rest.get(digits..)?;
        let mut wants = [false; 3];
        for (name, wants) in ["&accel=", "&gyro=", "&magnetic="].iter().zip(&mut wants) {
            rest = rest.strip_prefix(name)?;
            let digit = rest.chars().next().filter(char::is_ascii_digit)?;
            *wants = digit == '1';
            rest = rest.get(1..)?;
        }
        Some(Self { duration_ms, wants })
    }

    pub(super) fn wants(&self, kind: Kind) -> bool {
        kind.one_of(self.wants)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_imu_requests() {
        let found = ImuRequest::find("imu?duration=1000&accel=0&gyro=1&magnetic=0");
        assert_eq!(
            found,
            Some(ImuRequest {
                duration_ms: Some(1000),
                wants: [false, true, false]
            })
        );
        // Found anywhere, as a regular expression does.
        let within = "GET /imu?duration=5&accel=1&gyro=1&magnetic=1&gravity=0 HTTP/1.1";
        assert_eq!(
            ImuRequest::find(within).and_then(|r| r.duration_ms),
            Some(5)
        );
        for line in [
            "",
            "imu",
            "imu?duration=&accel=0&gyro=1&magnetic=0",
            "imu?duration=-1&accel=0&gyro=1&magnetic=0",
            "imu?duration=1000&accel=0&gyro=1",
            "imu?duration=1000",
        ] {
            assert_eq!(ImuRequest::find(line), None, "{line}");
        }
        let overflow = "imu?duration=9223372036854775808&accel=0&gyro=1&magnetic=0";
        let found = ImuRequest::find(overflow).unwrap();
        assert_eq!(found.duration_ms, None);
    }
}
