//! The binary form of messages: little-endian CDR, as ROS 2 writes it.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// The encapsulation header of little-endian CDR.
const CDR_LE: [u8; 4] = [0, 1, 0, 0];

/// Reason why a message cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum CdrError {
    /// The bytes are not little-endian CDR.
    #[error("a message does not begin as little-endian CDR does")]
    Encapsulation,
    /// The bytes are CDR of another type.
    #[error("a message is not of its type: {0}")]
    Content(#[from] cdr_encoding::Error),
}

/// Writes a message in its CDR form, with the encapsulation header.
///
/// # Errors
///
/// Returns an error if the length of a text or list does not fit into 32 bits.
pub fn to_cdr<M: Serialize>(message: &M) -> Result<Vec<u8>, CdrError> {
    let mut bytes = CDR_LE.to_vec();
    bytes.extend(cdr_encoding::to_vec::<M, byteorder::LittleEndian>(message)?);
    Ok(bytes)
}

/// Reads a message from its CDR form.
///
/// # Errors
///
/// Returns an error if the bytes are not CDR, or not of this type.
pub fn from_cdr<M: DeserializeOwned>(bytes: &[u8]) -> Result<M, CdrError> {
    let body = bytes.strip_prefix(&CDR_LE).ok_or(CdrError::Encapsulation)?;
    let (message, _) = cdr_encoding::from_bytes::<M, byteorder::LittleEndian>(body)?;
    Ok(message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{Header, Imu, LinkFrame, Temperature, Time, TimeReference};

    #[test]
    fn cdr_has_the_layout_of_ros_2() {
        let message = TimeReference {
            header: Header {
                stamp: Time { sec: 1, nanosec: 2 },
                frame_id: String::from("ab"),
            },
            time_ref: Time {
                sec: -1,
                nanosec: 3,
            },
            source: String::from("x"),
        };
        let bytes = to_cdr(&message).unwrap();
        // Encapsulation; 1; 2; length 3 "ab\0", one byte of padding; −1; 3;
        // length 2 "x\0".
        let expected: [&[u8]; 8] = [
            &[0, 1, 0, 0],
            &[1, 0, 0, 0],
            &[2, 0, 0, 0],
            &[3, 0, 0, 0, b'a', b'b', 0, 0],
            &[0xFF; 4],
            &[3, 0, 0, 0],
            &[2, 0, 0, 0],
            b"x\0",
        ];
        assert_eq!(bytes, expected.concat());
        assert_eq!(from_cdr::<TimeReference>(&bytes).unwrap(), message);
    }

    #[test]
    fn doubles_are_aligned_to_eight_bytes_after_the_encapsulation() {
        let message = Temperature {
            header: Header {
                stamp: Time::default(),
                frame_id: String::new(),
            },
            temperature: 1.0,
            variance: 0.0,
        };
        let bytes = to_cdr(&message).unwrap();
        // 4 + 8 (time) + 5 (empty text with its zero) + 3 padding + 16.
        assert_eq!(bytes.len(), 4 + 16 + 16);
        assert_eq!(bytes[20..28], 1.0_f64.to_le_bytes());
    }

    #[test]
    fn bytes_of_another_kind_are_an_error() {
        assert!(matches!(
            from_cdr::<Imu>(&[0, 0, 0, 0]),
            Err(CdrError::Encapsulation)
        ));
        assert!(matches!(
            from_cdr::<Imu>(&[0, 1, 0, 0, 5]),
            Err(CdrError::Content(_))
        ));
        assert!(
            from_cdr::<LinkFrame>(&[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255])
                .is_err()
        );
    }
}
