//! Edges of pins as a VCD file, to look at in a wave viewer such as GTKWave.
//!
//! [`VcdTrace`] is a model that only watches. The file's time scale is one
//! picosecond: the board's units of 15 fs are rounded down, so a tick of the
//! 48 MHz timer is off by less than a picosecond and errors do not add up. The
//! file has no date, so the same run gives the same bytes.
//!
//! A pin that carries a clock (MCO1 on PA8) is not traced edge by edge.

use std::io::{self, Write};

use vcd::{IdCode, SimulationCommand, TimescaleUnit, Value, Writer};

use crate::model::{PinIo, PinModel};
use crate::pin::{Level, Pin};
use crate::time::{SimTime, UNITS_PER_NANO};

/// Writes the edges of some pins.
pub struct VcdTrace<W: Write> {
    writer: Writer<W>,
    pins: Vec<(Pin, IdCode)>,
    /// Time of the last timestamp written.
    at: Option<u64>,
    error: Option<io::Error>,
}

impl<W: Write> VcdTrace<W> {
    /// Begins a trace of the given pins; the names are those of the wires.
    ///
    /// # Errors
    /// The header cannot be written.
    pub fn new(to: W, pins: &[(Pin, &str)]) -> io::Result<Self> {
        let mut writer = Writer::new(to);
        writer.version("stm32f4-sim")?;
        writer.timescale(1, TimescaleUnit::PS)?;
        writer.add_module("board")?;
        let mut codes = Vec::new();
        for (pin, name) in pins {
            codes.push((*pin, writer.add_wire(1, &format!("{name}_{pin}"))?));
        }
        writer.upscope()?;
        writer.enddefinitions()?;
        Ok(Self {
            writer,
            pins: codes,
            at: None,
            error: None,
        })
    }

    fn change(&mut self, at: SimTime, pin: Pin, level: Level) -> io::Result<()> {
        let Some((_, code)) = self.pins.iter().find(|(p, _)| *p == pin) else {
            return Ok(());
        };
        let at = picoseconds(at);
        if self.at != Some(at) {
            self.writer.timestamp(at)?;
            self.at = Some(at);
        }
        self.writer.change_scalar(*code, value(level))
    }

    fn begin(&mut self, io: &PinIo<'_>) -> io::Result<()> {
        self.writer.timestamp(picoseconds(io.now()))?;
        self.at = Some(picoseconds(io.now()));
        self.writer.begin(SimulationCommand::Dumpvars)?;
        for (pin, code) in &self.pins {
            self.writer.change_scalar(*code, value(io.level(*pin)))?;
        }
        self.writer.end()
    }

    fn keep(&mut self, result: io::Result<()>) {
        if let Err(error) = result {
            self.error.get_or_insert(error);
        }
    }

    /// Hands on everything that was written.
    ///
    /// # Errors
    /// The first error of the whole trace.
    pub fn flush(&mut self) -> io::Result<()> {
        match self.error.take() {
            Some(error) => Err(error),
            None => self.writer.flush(),
        }
    }
}

impl<W: Write> core::fmt::Debug for VcdTrace<W> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("VcdTrace")
            .field("pins", &self.pins)
            .finish_non_exhaustive()
    }
}

fn picoseconds(at: SimTime) -> u64 {
    (u128::from(at.units()) * 1000 / u128::from(UNITS_PER_NANO)) as u64
}

fn value(level: Level) -> Value {
    if level.is_high() {
        Value::V1
    } else {
        Value::V0
    }
}

impl<W: Write + Send> PinModel for VcdTrace<W> {
    fn name(&self) -> String {
        "edge trace".to_owned()
    }

    fn watched_pins(&self) -> Vec<Pin> {
        self.pins.iter().map(|(pin, _)| *pin).collect()
    }

    fn power_on(&mut self, io: &mut PinIo<'_>) {
        let result = self.begin(io);
        self.keep(result);
    }

    fn on_pin_edge(&mut self, pin: Pin, level: Level, io: &mut PinIo<'_>) {
        let result = self.change(io.now(), pin, level);
        self.keep(result);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model_bench::Bench;
    use crate::time::SimDuration;
    use vcd::{Command, Parser};

    #[test]
    fn a_parser_reads_the_edges_back_at_their_times() {
        let trace =
            VcdTrace::new(Vec::new(), &[(Pin::PA5, "trigger"), (Pin::PA2, "strobe")]).unwrap();
        let mut bench = Bench::new(trace);
        // One tick of 48 MHz is 20,833.3 ps.
        bench.run(SimDuration::from_units(
            crate::time::UNITS_PER_SECOND / 48_000_000,
        ));
        bench.set_pin(Pin::PA5, Level::High);
        bench.set_pin(Pin::PA2, Level::High);
        bench.run(SimDuration::from_micros(12));
        bench.set_pin(Pin::PA5, Level::Low);
        bench.model.flush().unwrap();
        let bytes = std::mem::take(bench.model.writer.writer());
        let mut parser = Parser::new(bytes.as_slice());
        let header = parser.parse_header().unwrap();
        assert_eq!(header.timescale, Some((1, TimescaleUnit::PS)));
        let trigger = header.find_var(&["board", "trigger_PA5"]).unwrap().code;
        let strobe = header.find_var(&["board", "strobe_PA2"]).unwrap().code;
        let mut at = 0;
        let mut changes = Vec::new();
        for command in parser {
            match command.unwrap() {
                Command::Timestamp(t) => at = t,
                Command::ChangeScalar(code, v) => changes.push((at, code, v)),
                _ => {}
            }
        }
        assert_eq!(
            changes,
            [
                (0, trigger, Value::V0),
                (0, strobe, Value::V0),
                (20_833, trigger, Value::V1),
                (20_833, strobe, Value::V1),
                (12_020_833, trigger, Value::V0),
            ]
        );
    }

    #[test]
    fn an_error_while_writing_is_reported_at_the_end() {
        struct Full(usize);
        impl Write for Full {
            fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                if self.0 < bytes.len() {
                    return Err(io::Error::other("disk full"));
                }
                self.0 -= bytes.len();
                Ok(bytes.len())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let trace = VcdTrace::new(Full(200), &[(Pin::PA5, "trigger")]).unwrap();
        let mut bench = Bench::new(trace);
        for k in 0..100 {
            bench.run(SimDuration::from_micros(1));
            bench.set_pin(Pin::PA5, Level::from(k % 2 == 0));
        }
        let error = bench.model.flush().unwrap_err();
        assert_eq!(error.to_string(), "disk full");
    }
}
