//! ROS 1 messages of the published system (`sensor_msgs`): little-endian, packed,
//! strings and arrays with a u32 length in front.

/// A message that is not as its type says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the message ends within {0}")]
pub struct Short(pub &'static str);

/// `std_msgs/Header` without the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Counted by the publisher.
    pub seq: u32,
    /// Nanoseconds.
    pub stamp: i64,
}

/// `sensor_msgs/Imu` without orientation and covariances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imu {
    /// Number and time.
    pub header: Header,
    /// rad/s.
    pub gyro: [f64; 3],
    /// m/s².
    pub accel: [f64; 3],
}

/// `sensor_msgs/Temperature`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Temperature {
    /// Number and time.
    pub header: Header,
    /// °C.
    pub temperature: f64,
}

/// `sensor_msgs/TimeReference`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeReference {
    /// Number and time.
    pub header: Header,
    /// The same instant in the other time, nanoseconds.
    pub time_ref: i64,
}

/// `sensor_msgs/Image`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Image<'a> {
    /// Number and time.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Pixels in a row.
    pub width: u32,
    /// Kind of pixels, e.g. `16UC1`.
    pub encoding: &'a str,
    /// Byte order of the pixels.
    pub big_endian: bool,
    /// Bytes in a row.
    pub step: u32,
    /// The rows.
    pub data: &'a [u8],
}

struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    fn take(&mut self, count: usize, what: &'static str) -> Result<&'a [u8], Short> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(Short(what))?;
        self.0 = rest;
        Ok(taken)
    }

    fn bytes<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], Short> {
        let (taken, rest) = self.0.split_first_chunk::<N>().ok_or(Short(what))?;
        self.0 = rest;
        Ok(*taken)
    }

    fn u32(&mut self, what: &'static str) -> Result<u32, Short> {
        Ok(u32::from_le_bytes(self.bytes(what)?))
    }

    fn f64(&mut self, what: &'static str) -> Result<f64, Short> {
        Ok(f64::from_le_bytes(self.bytes(what)?))
    }

    fn vector(&mut self, what: &'static str) -> Result<[f64; 3], Short> {
        Ok([self.f64(what)?, self.f64(what)?, self.f64(what)?])
    }

    fn block(&mut self, what: &'static str) -> Result<&'a [u8], Short> {
        let length = self.u32(what)?;
        self.take(length as usize, what)
    }

    fn time(&mut self, what: &'static str) -> Result<i64, Short> {
        let seconds = i64::from(self.u32(what)?);
        let nanos = i64::from(self.u32(what)?);
        Ok(seconds * 1_000_000_000 + nanos)
    }

    fn header(&mut self) -> Result<Header, Short> {
        let header = Header {
            seq: self.u32("header.seq")?,
            stamp: self.time("header.stamp")?,
        };
        self.block("header.frame_id")?;
        Ok(header)
    }
}

impl Imu {
    /// Its type's name.
    pub const KIND: &'static str = "sensor_msgs/Imu";

    /// From a message's bytes.
    ///
    /// # Errors
    ///
    /// They end too early.
    pub fn parse(data: &[u8]) -> Result<Self, Short> {
        let mut cursor = Cursor(data);
        let header = cursor.header()?;
        cursor.take(4 * 8 + 9 * 8, "orientation")?;
        let gyro = cursor.vector("angular_velocity")?;
        cursor.take(9 * 8, "angular_velocity_covariance")?;
        let accel = cursor.vector("linear_acceleration")?;
        Ok(Self {
            header,
            gyro,
            accel,
        })
    }
}

impl Temperature {
    /// Its type's name.
    pub const KIND: &'static str = "sensor_msgs/Temperature";

    /// From a message's bytes.
    ///
    /// # Errors
    ///
    /// They end too early.
    pub fn parse(data: &[u8]) -> Result<Self, Short> {
        let mut cursor = Cursor(data);
        Ok(Self {
            header: cursor.header()?,
            temperature: cursor.f64("temperature")?,
        })
    }
}

impl TimeReference {
    /// Its type's name.
    pub const KIND: &'static str = "sensor_msgs/TimeReference";

    /// From a message's bytes.
    ///
    /// # Errors
    ///
    /// They end too early.
    pub fn parse(data: &[u8]) -> Result<Self, Short> {
        let mut cursor = Cursor(data);
        Ok(Self {
            header: cursor.header()?,
            time_ref: cursor.time("time_ref")?,
        })
    }
}

impl<'a> Image<'a> {
    /// Its type's name.
    pub const KIND: &'static str = "sensor_msgs/Image";

    /// From a message's bytes.
    ///
    /// # Errors
    ///
    /// They end too early.
    pub fn parse(data: &'a [u8]) -> Result<Self, Short> {
        let mut cursor = Cursor(data);
        Ok(Self {
            header: cursor.header()?,
            height: cursor.u32("height")?,
            width: cursor.u32("width")?,
            encoding: std::str::from_utf8(cursor.block("encoding")?).unwrap_or("not UTF-8"),
            big_endian: cursor.take(1, "is_bigendian")? != [0],
            step: cursor.u32("step")?,
            data: cursor.block("data")?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_cut_at_any_byte_is_an_error() {
        let mut data = Vec::new();
        data.extend_from_slice(&7_u32.to_le_bytes());
        data.extend_from_slice(&3_u32.to_le_bytes());
        data.extend_from_slice(&250_000_001_u32.to_le_bytes());
        data.extend_from_slice(&3_u32.to_le_bytes());
        data.extend_from_slice(b"imu");
        data.extend_from_slice(&[0; 13 * 8]);
        for value in [1.0_f64, 2.0, 3.0] {
            data.extend_from_slice(&value.to_le_bytes());
        }
        data.extend_from_slice(&[0; 9 * 8]);
        for value in [4.0_f64, 5.0, 6.0] {
            data.extend_from_slice(&value.to_le_bytes());
        }
        let imu = Imu::parse(&data).unwrap();
        assert_eq!((imu.header.seq, imu.header.stamp), (7, 3_250_000_001));
        assert_eq!((imu.gyro, imu.accel), ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]));
        for end in 0..data.len() {
            assert!(Imu::parse(&data[..end]).is_err(), "{end}");
        }
    }
}
