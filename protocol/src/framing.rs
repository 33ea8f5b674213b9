//! Frames on the byte stream.
//!
//! A frame is `COBS(postcard(message) ‖ CRC-32(le)) ‖ 0x00`. COBS keeps zero
//! bytes out of the frame, so a zero is always a boundary: whatever happens to
//! the bytes of one frame, the reader is back in step at the next zero.
//!
//! The CRC is CRC-32/ISO-HDLC (the one of Ethernet and zip) over the postcard
//! bytes. Empty frames (two zeros in a row) are allowed and ignored: a sender
//! may put a zero first to end whatever garbage is on the line.

use core::marker::PhantomData;

use crc::{CRC_32_ISO_HDLC, Crc};
use postcard::ser_flavors::Flavor;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// CRC-32/ISO-HDLC with a 1 KiB table.
const CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Bytes of the CRC after the message.
const CRC_LEN: usize = 4;

/// By how much COBS makes a message and its CRC longer at most: one byte, and
/// one for each full 254.
const COBS_OVERHEAD: usize = 1 + (MAX_MESSAGE + CRC_LEN) / 254;

/// The longest message in postcard form, in bytes.
pub const MAX_MESSAGE: usize = 416;

/// The longest frame on the wire, with CRC, COBS overhead (one byte in each
/// 254, and one) and the delimiter.
pub const MAX_FRAME: usize = MAX_MESSAGE + CRC_LEN + COBS_OVERHEAD + 1;

/// A frame that was not taken: it is longer than [`MAX_FRAME`] bytes, is not COBS, its
/// checksum does not match, or it holds no message of this protocol version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameError;

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("a frame is damaged, or of another protocol version")
    }
}

impl core::error::Error for FrameError {}

/// Counts of frames that a [`Decoder`] has received. They saturate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkCounters {
    /// Frames that became messages.
    pub frames: u32,
    /// Frames that were not taken.
    pub lost_frames: u32,
    /// Bytes of all these.
    pub lost_bytes: u32,
}

impl LinkCounters {
    /// Before the first byte.
    pub const ZERO: Self = Self {
        frames: 0,
        lost_frames: 0,
        lost_bytes: 0,
    };
}

/// Encodes one message as a frame, delimiter included, and returns the frame.
///
/// # Errors
///
/// `buffer` is too short; [`MAX_FRAME`] bytes always suffice for the messages
/// of this crate.
pub fn encode<'b, M: Serialize>(message: &M, buffer: &'b mut [u8]) -> postcard::Result<&'b [u8]> {
    const FULL: postcard::Error = postcard::Error::SerializeBufferFull;
    // The message is placed so that COBS, which lengthens it by up to COBS_OVERHEAD bytes, can
    // code it to the front of the same buffer.
    let body = buffer.get_mut(COBS_OVERHEAD..).ok_or(FULL)?;
    let space = body
        .get_mut(..MAX_MESSAGE.min(body.len()))
        .unwrap_or_default();
    let len = postcard::serialize_with_flavor(message, Bytes { space, len: 0 })?;
    let crc = CRC32.checksum(body.get(..len).ok_or(FULL)?);
    let end = COBS_OVERHEAD + len + CRC_LEN;
    let space = buffer.get_mut(end - CRC_LEN..end).ok_or(FULL)?;
    space.copy_from_slice(&crc.to_le_bytes());
    let coded = cobs_in_place(buffer, end).ok_or(FULL)?;
    *buffer.get_mut(coded).ok_or(FULL)? = 0;
    buffer.get(..=coded).ok_or(FULL)
}

/// Where a message is written, byte by byte: postcard's own place copies each field of one to ten
/// bytes by a call of `memcpy`, which on the board is half of the cost of a status.
struct Bytes<'b> {
    space: &'b mut [u8],
    len: usize,
}

impl Flavor for Bytes<'_> {
    type Output = usize;

    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        let free = self.space.get_mut(self.len);
        *free.ok_or(postcard::Error::SerializeBufferFull)? = byte;
        self.len += 1;
        Ok(())
    }

    fn finalize(self) -> postcard::Result<usize> {
        Ok(self.len)
    }
}

/// Codes `buffer[COBS_OVERHEAD..end]` to the front of `buffer`; returns the
/// length. What is written never overtakes what is read: it is ahead by one code
/// byte at first, and by one more after each full run of 254.
///
/// The `cobs` crate needs a second buffer and takes several times as long, which
/// on the board is a tenth of the cost of a message.
fn cobs_in_place(buffer: &mut [u8], end: usize) -> Option<usize> {
    let mut code_at = 0;
    let mut code = 1_u8;
    let mut write = 1;
    for read in COBS_OVERHEAD..end {
        let byte = *buffer.get(read)?;
        if byte != 0 {
            *buffer.get_mut(write)? = byte;
            write += 1;
            code += 1;
        }
        if byte == 0 || code == u8::MAX {
            *buffer.get_mut(code_at)? = code;
            code_at = write;
            code = 1;
            write += 1;
        }
    }
    *buffer.get_mut(code_at)? = code;
    Some(write)
}

/// A push parser: bytes go in, in any split; messages come out.
///
/// It never allocates and never panics. After any damage it is back in step at
/// the next zero byte and has counted what it lost.
///
/// ```
/// use protocol::{Decoder, HostToDevice, MAX_FRAME, QueryImu, encode};
///
/// let sent = HostToDevice { id: 7, command: QueryImu.into() };
/// let mut buffer = [0; MAX_FRAME];
/// let frame = encode(&sent, &mut buffer).unwrap();
///
/// let mut decoder = Decoder::<HostToDevice>::new();
/// let (mut head, mut tail) = frame.split_at(3);
/// assert_eq!(decoder.next(&mut head), None);
/// assert_eq!(decoder.next(&mut tail), Some(Ok(sent)));
/// ```
pub struct Decoder<M> {
    buffer: [u8; MAX_FRAME],
    len: usize,
    /// Bytes of a frame that is too long, so far.
    skipped: usize,
    counters: LinkCounters,
    message: PhantomData<fn() -> M>,
}

impl<M: DeserializeOwned> Decoder<M> {
    /// An empty decoder, in step from the first byte on.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: [0; MAX_FRAME],
            len: 0,
            skipped: 0,
            counters: LinkCounters::ZERO,
            message: PhantomData,
        }
    }

    /// Returns the counts of frames received and lost.
    #[must_use]
    pub const fn counters(&self) -> LinkCounters {
        self.counters
    }

    /// Forgets a half-received frame (after the line was cut, for instance).
    /// The counters stay.
    pub const fn reset(&mut self) {
        self.len = 0;
        self.skipped = 0;
    }

    /// Consumes bytes from the front of `input` up to the end of one frame.
    ///
    /// Returns `None` once `input` is used up; call it until then.
    pub fn next(&mut self, input: &mut &[u8]) -> Option<Result<M, FrameError>> {
        loop {
            let (chunk, ended) = match input.iter().position(|&byte| byte == 0) {
                Some(end) => {
                    let chunk = input.get(..end).unwrap_or_default();
                    *input = input.get(end + 1..).unwrap_or_default();
                    (chunk, true)
                }
                None => (core::mem::take(input), false),
            };
            self.take(chunk);
            if !ended {
                return None;
            }
            if let Some(result) = self.finish() {
                return Some(result);
            }
        }
    }

    fn take(&mut self, chunk: &[u8]) {
        if self.skipped > 0 {
            self.skipped = self.skipped.saturating_add(chunk.len());
            return;
        }
        match self.buffer.get_mut(self.len..self.len + chunk.len()) {
            Some(space) => {
                space.copy_from_slice(chunk);
                self.len += chunk.len();
            }
            None => self.skipped = self.len.saturating_add(chunk.len()),
        }
    }

    /// Ends the frame; `None` for an empty one.
    fn finish(&mut self) -> Option<Result<M, FrameError>> {
        let len = core::mem::take(&mut self.len);
        let skipped = core::mem::take(&mut self.skipped);
        let result = match (len, skipped) {
            (0, 0) => return None,
            (_, 0) => decode(self.buffer.get_mut(..len).unwrap_or_default()),
            _ => Err(FrameError),
        };
        let counters = &mut self.counters;
        if result.is_ok() {
            counters.frames = counters.frames.saturating_add(1);
        } else {
            let bytes = u32::try_from(len.max(skipped)).unwrap_or(u32::MAX);
            counters.lost_frames = counters.lost_frames.saturating_add(1);
            counters.lost_bytes = counters.lost_bytes.saturating_add(bytes);
        }
        Some(result)
    }
}

impl<M: DeserializeOwned> Default for Decoder<M> {
    fn default() -> Self {
        Self::new()
    }
}

/// The message of a whole frame, without its delimiter, as a recording has it.
///
/// # Errors
///
/// The frame is damaged, or no such message.
pub fn decode_frame<M: DeserializeOwned>(frame: &[u8]) -> Result<M, FrameError> {
    let mut buffer = [0; MAX_FRAME];
    let copy = buffer.get_mut(..frame.len()).ok_or(FrameError)?;
    copy.copy_from_slice(frame);
    decode(copy)
}

fn decode<M: DeserializeOwned>(frame: &mut [u8]) -> Result<M, FrameError> {
    match postcard::take_from_bytes(body(frame)?) {
        Ok((message, [])) => Ok(message),
        _ => Err(FrameError),
    }
}

/// The protocol version of a board whose messages are not understood.
///
/// `frame` is what stands between two delimiters. `None` if it is damaged or
/// no [`Hello`](crate::Hello): the version stays the first field of the first
/// variant in every version of the protocol.
#[must_use]
pub fn hello_version(frame: &[u8]) -> Option<u16> {
    // COBS of a message that begins with zero begins with 1.
    if frame.first() != Some(&1) {
        return None;
    }
    let mut buffer = [0; MAX_FRAME];
    let copy = buffer.get_mut(..frame.len())?;
    copy.copy_from_slice(frame);
    let (&variant, fields) = body(copy).ok()?.split_first()?;
    if variant != 0 {
        return None;
    }
    postcard::take_from_bytes(fields)
        .ok()
        .map(|(version, _)| version)
}

/// Undoes COBS and checks the CRC.
fn body(frame: &mut [u8]) -> Result<&[u8], FrameError> {
    let len = cobs::decode_in_place(frame).map_err(|_| FrameError)?;
    let decoded = frame.get(..len).ok_or(FrameError)?;
    let (body, crc) = decoded.split_last_chunk::<CRC_LEN>().ok_or(FrameError)?;
    if CRC32.checksum(body) != u32::from_le_bytes(*crc) {
        return Err(FrameError);
    }
    Ok(body)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_of_an_unknown_hello_is_read_and_nothing_else() {
        let mut buffer = [0; MAX_FRAME];
        let hello = encode(&(0_u8, 700_u16, [1_u8; 9]), &mut buffer).unwrap();
        let hello = hello.strip_suffix(&[0]).unwrap();
        assert_eq!(hello_version(hello), Some(700));
        assert_eq!(hello_version(hello.split_last().unwrap().1), None);
        assert_eq!(hello_version(&[]), None);
        assert_eq!(hello_version(&[1; MAX_FRAME + 1]), None);

        let answer = encode(&(1_u8, 700_u16), &mut buffer).unwrap();
        assert_eq!(hello_version(answer.strip_suffix(&[0]).unwrap()), None);
    }
}
