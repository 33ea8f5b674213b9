//! The firmware's defmt log, read from its RTT buffer as a debugger would.

use defmt_decoder::{DecodeError, Table};
use defmt_parser::Level;

use crate::firmware::Firmware;
use crate::time::SimTime;

/// A line of the firmware's log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// Virtual time at which the simulator read it (within 60 us of its writing).
    pub at: SimTime,
    /// Importance; none where it was printed without a level.
    level: Option<Level>,
    /// The text.
    pub message: String,
    /// Source file and line, if the ELF has them.
    pub location: Option<String>,
}

impl core::fmt::Display for LogLine {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let level = self.level.map_or("", |level| level.as_str());
        let level = level.to_uppercase();
        write!(f, "{:>14} {level:<5} {}", self.at.to_string(), self.message)?;
        if let Some(location) = &self.location {
            write!(f, " ({location})")?;
        }
        Ok(())
    }
}

/// Memory that the log reader works on.
pub(crate) trait Words {
    fn word(&self, addr: u32) -> Option<u32>;
    fn set_word(&mut self, addr: u32, value: u32);
    fn bytes(&self, addr: u32, len: usize) -> Option<&[u8]>;
}

/// Reads and decodes the log.
pub(crate) struct Rtt {
    control: Option<u32>,
    table: Option<Table>,
    locations: defmt_decoder::Locations,
    /// Bytes of a frame that is not complete.
    pending: Vec<u8>,
}

/// Layout of the control block (defmt-rtt 1, and SEGGER's).
const ID: &[u8; 16] = b"SEGGER RTT\0\0\0\0\0\0";
const UP_BUFFER: u32 = 28;
const UP_SIZE: u32 = 32;
const UP_WRITE: u32 = 36;
const UP_READ: u32 = 40;

impl Rtt {
    pub(crate) fn new(firmware: &Firmware) -> Self {
        let table = Table::parse(firmware.bytes()).ok().flatten();
        let locations = table
            .as_ref()
            .and_then(|t| t.get_locations(firmware.bytes()).ok())
            .unwrap_or_default();
        Self {
            control: firmware.symbol("_SEGGER_RTT").map(|s| s.address),
            table,
            locations,
            pending: Vec::new(),
        }
    }

    /// The firmware starts again.
    pub(crate) fn restart(&mut self) {
        self.pending.clear();
    }

    /// True if something waits in the buffer.
    #[inline]
    pub(crate) fn has_data(&self, mem: &impl Words) -> bool {
        let Some(control) = self.control else {
            return false;
        };
        mem.word(control + UP_WRITE) != mem.word(control + UP_READ)
    }

    /// Takes what waits in the buffer and appends the lines that it makes.
    pub(crate) fn poll(&mut self, mem: &mut impl Words, now: SimTime, out: &mut Vec<LogLine>) {
        let Some(control) = self.control else { return };
        if mem.bytes(control, 16) != Some(ID) {
            return;
        }
        let get = |o: u32| mem.word(control + o).unwrap_or(0);
        let (buffer, size, write, read) =
            (get(UP_BUFFER), get(UP_SIZE), get(UP_WRITE), get(UP_READ));
        if write >= size || read >= size || write == read {
            return;
        }
        let mut taken = Vec::new();
        if write > read {
            taken.extend_from_slice(
                mem.bytes(buffer + read, (write - read) as usize)
                    .unwrap_or(&[]),
            );
        } else {
            taken.extend_from_slice(
                mem.bytes(buffer + read, (size - read) as usize)
                    .unwrap_or(&[]),
            );
            taken.extend_from_slice(mem.bytes(buffer, write as usize).unwrap_or(&[]));
        }
        mem.set_word(control + UP_READ, write);
        self.pending.extend_from_slice(&taken);
        // Frames end with a zero byte (defmt's rzcobs encoding).
        while let Some(end) = self.pending.iter().position(|b| *b == 0) {
            let frame: Vec<u8> = self.pending.drain(..=end).collect();
            if frame.len() > 1 {
                out.push(self.decode(&frame, now));
            }
        }
    }

    fn decode(&self, bytes: &[u8], at: SimTime) -> LogLine {
        let broken = |why: &str| LogLine {
            at,
            level: Some(Level::Error),
            message: format!(
                "log frame of {} bytes cannot be decoded: {why}",
                bytes.len()
            ),
            location: None,
        };
        let Some(table) = &self.table else {
            return broken("the ELF has no defmt table");
        };
        let mut decoder = table.new_stream_decoder();
        decoder.received(bytes);
        match decoder.decode() {
            Ok(frame) => LogLine {
                at,
                level: frame.level(),
                message: frame.display_message().to_string(),
                location: self.locations.get(&frame.index()).map(|l| {
                    let file = l.file.file_name().map_or_else(
                        || l.file.display().to_string(),
                        |n| n.to_string_lossy().into_owned(),
                    );
                    format!("{file}:{}", l.line)
                }),
            },
            Err(DecodeError::UnexpectedEof) => broken("it ends too early"),
            Err(DecodeError::Malformed) => broken("it is damaged"),
        }
    }
}
