//! Puts a simulation together.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use super::{LogSink, Sim, SimError};
use crate::chip::adc::Die;
use crate::chip::part::Part;
use crate::chip::{ChipConfig, I2cWires, Revision, Soc};
use crate::clock::Rate;
use crate::cpu::Cpu;
use crate::firmware::Firmware;
use crate::i2c::I2cTarget;
use crate::model::PinModel;
use crate::pin::Pin;
use crate::random::{RAM_STREAM, Seed};
use crate::rtt::{LogLine, Rtt};
use crate::shared::lock;
use crate::time::SimDuration;

/// Clocks that the synchroniser of a timer's input takes, unless the builder says
/// otherwise: two flip-flops and the detector of the edge. A guess, no manual has it.
pub const INPUT_SYNCHRONISER: u64 = 3;
/// Probability, for each byte on the I2C bus, that the chip reports a bus error where
/// there is none (ES0182 2.10.1, which says no more than that it happens), unless the
/// builder says otherwise: some a second with a sensor that is read at 500 Hz.
const BUS_ERRORS: f64 = 1e-3;
/// Voltage by which an output of the chip that drives 8 mA high may be below its supply
/// (DS8626 table 48).
const OUTPUT_DROP: f64 = 0.4;
/// Pins of I2C1 (DS8626 table 9).
const I2C1_SCL: [Pin; 2] = [Pin::PB6, Pin::PB8];
const I2C1_SDA: [Pin; 2] = [Pin::PB7, Pin::PB9];

/// Puts a [`Sim`] together.
pub struct SimBuilder {
    elf: PathBuf,
    missing_hint: &'static str,
    seed: Seed,
    plugged: bool,
    tolerate_failures: bool,
    by_rom: bool,
    chip: ChipConfig,
    models: Vec<Box<dyn PinModel>>,
    targets: Vec<Box<dyn I2cTarget>>,
    on_log: Option<LogSink>,
}

impl core::fmt::Debug for SimBuilder {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "SimBuilder({:?}, seed {:?})", self.elf, self.seed)
    }
}

impl SimBuilder {
    pub(super) fn new(elf: PathBuf) -> Self {
        Self {
            elf,
            missing_hint: "",
            seed: Seed(1),
            plugged: true,
            tolerate_failures: false,
            by_rom: false,
            chip: ChipConfig {
                part: Part::default(),
                crystal: None,
                i2c: None,
                bus_errors: BUS_ERRORS,
                synchroniser: INPUT_SYNCHRONISER,
                revision: Revision::Y,
                broken_rng: false,
                die: Die::default(),
                shortest_detach: SimDuration::ZERO,
            },
            models: Vec::new(),
            targets: Vec::new(),
            on_log: None,
        }
    }

    /// The firmware of another ELF.
    #[must_use]
    pub fn elf(mut self, path: impl Into<PathBuf>) -> Self {
        self.elf = path.into();
        self
    }

    /// Advice for the message that there is no ELF.
    #[must_use]
    pub fn missing_hint(mut self, hint: &'static str) -> Self {
        self.missing_hint = hint;
        self
    }

    /// Changes what the chip is like: its part, its revision, faults, what a manual leaves open.
    #[must_use]
    pub fn chip(mut self, change: impl FnOnce(&mut ChipConfig)) -> Self {
        change(&mut self.chip);
        self
    }

    /// Solders a crystal of this frequency to the high-speed oscillator.
    #[must_use]
    pub fn crystal(mut self, rate: Rate) -> Self {
        self.chip.crystal = Some(rate);
        self
    }

    /// Wires an I2C bus with its pull-ups to these pins, which must be pins of I2C1.
    #[must_use]
    pub fn i2c_bus(mut self, scl: Pin, sda: Pin) -> Self {
        self.chip.i2c = Some(I2cWires { scl, sda });
        self
    }

    /// The one seed of all randomness.
    #[must_use]
    pub fn seed(mut self, seed: Seed) -> Self {
        self.seed = seed;
        self
    }

    /// True if the USB cable is in at power-on. It is by default.
    #[must_use]
    pub fn plugged(mut self, plugged: bool) -> Self {
        self.plugged = plugged;
        self
    }

    /// Lets the firmware fail and go on: failures and resets are listed by
    /// [`Sim::failures`] instead of ending the run.
    #[must_use]
    pub fn tolerate_failures(mut self) -> Self {
        self.tolerate_failures = true;
        self
    }

    /// The ROM's bootloader starts the firmware, as after a download by DFU.
    #[must_use]
    pub fn started_by_rom(mut self) -> Self {
        self.by_rom = true;
        self
    }

    /// Wires a model to the board's pins.
    #[must_use]
    pub fn model(mut self, model: impl PinModel + 'static) -> Self {
        self.models.push(Box::new(model));
        self
    }

    /// Wires a device to the I2C bus.
    #[must_use]
    pub fn i2c_target(mut self, target: impl I2cTarget + 'static) -> Self {
        self.targets.push(Box::new(target));
        self
    }

    /// Calls `sink` with each line of the firmware's log as it appears.
    #[must_use]
    pub fn on_log(mut self, sink: impl FnMut(&LogLine) + Send + 'static) -> Self {
        self.on_log = Some(Box::new(sink));
        self
    }

    /// Powers the board on.
    ///
    /// # Errors
    ///
    /// If the ELF cannot be used, the I2C bus is wired to pins that are not I2C1's, or an
    /// output of the chip does not reach what a model takes as high.
    pub fn build(self) -> Result<Sim, SimError> {
        let firmware = Firmware::load(&self.elf, self.missing_hint).map_err(SimError::Firmware)?;
        if let Some(I2cWires { scl, sda }) = self.chip.i2c
            && !(I2C1_SCL.contains(&scl) && I2C1_SDA.contains(&sda))
        {
            return Err(SimError::Setup(format!(
                "the I2C bus is wired to {scl} (SCL) and {sda} (SDA); those of I2C1 are \
                 {I2C1_SCL:?} and {I2C1_SDA:?}"
            )));
        }
        let output = self.chip.die.supply - OUTPUT_DROP;
        for model in &self.models {
            let weak = model.inputs().into_iter().find(|(_, high)| *high > output);
            if let Some((pin, high)) = weak {
                return Err(SimError::Setup(format!(
                    "{} takes {high:.2} V and more at {pin} as high, and the board's output is \
                     only sure to reach {output:.2} V: put a gate between them",
                    model.name()
                )));
            }
        }
        let mut soc = Soc::new(self.seed, &self.chip);
        let mut random = self.seed.stream(RAM_STREAM);
        soc.fill_ram(&mut random);
        for (at, data) in firmware.segments() {
            let offset = at.wrapping_sub(0x0800_0000) as usize;
            match soc.mem.flash.get_mut(offset..offset + data.len()) {
                Some(to) => to.copy_from_slice(data),
                None => {
                    return Err(SimError::Setup(format!(
                        "a segment of {} bytes at {at:#010x} does not fit the flash",
                        data.len()
                    )));
                }
            }
        }
        for target in self.targets {
            soc.i2c_bus.add(target);
        }
        for model in self.models {
            for (pin, volts) in model.outputs() {
                soc.gpio.volts[pin.index()] = Some(volts);
            }
            soc.add_model(model);
        }
        if self.plugged {
            soc.plug();
        }
        let code_bytes = firmware.flash_size();
        let soc = Arc::new(Mutex::new(soc));
        let mut cpu = Cpu::new(Arc::clone(&soc), code_bytes).map_err(SimError::Setup)?;
        if self.by_rom {
            lock(&soc).leave_as_rom();
            cpu.start_by_rom(&mut random);
        }
        let mut panic_at = None;
        for name in ["rust_begin_unwind", "__rustc::rust_begin_unwind"] {
            let found = firmware
                .symbol(name)
                .or_else(|| firmware.find_symbol(name))
                .map(|s| s.address);
            if let Some(address) = found {
                cpu.add_breakpoint(address);
                panic_at = Some(address);
                break;
            }
        }
        let rtt = Rtt::new(&firmware);
        Ok(Sim {
            soc,
            cpu,
            firmware,
            rtt,
            log: Vec::new(),
            on_log: self.on_log,
            tolerate_failures: self.tolerate_failures,
            failures: Vec::new(),
            failing: None,
            panic_at,
            random,
        })
    }
}
