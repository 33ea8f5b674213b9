//! Reasons that always end a run: a register that is not modelled, and what the manuals
//! forbid. Where the chip would hang, lose an access or only work most of
//! the time, the simulator stops and names the rule.

use core::fmt;

use super::gpio::Mode;
use super::{Revision, Soc, names};
use crate::pin::Pin;

/// Forbidden ways to enable a DMA stream (RM0090 10.3.17).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EnabledWrongly {
    /// While flags of its last transfer are set.
    WithFlags,
    /// By the write that sets it up.
    WhileSetUp,
}

/// Reason why a run ends at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// A register was touched that is neither modelled nor stored.
    Unmodelled {
        address: u32,
        write: bool,
    },
    /// A peripheral was touched that this chip does not have.
    Absent {
        address: u32,
    },
    Forbidden(Rule),
}

/// A rule that was broken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Rule {
    /// I2C_CR1 was written while a START or STOP that it asks for is pending: the
    /// write may ask for it once more (RM0090 27.6.1).
    I2cPending,
    /// A pin is not in the alternate function of the peripheral that needs it.
    Pin {
        pin: Pin,
        function: u8,
        peripheral: &'static str,
    },
    /// A DMA stream is not enabled as it should be.
    DmaEnabled {
        /// From 1.
        controller: usize,
        stream: usize,
        wrong: EnabledWrongly,
    },
    /// A DMA stream is to reach memory that is not on its bus (RM0090 2.3.1).
    DmaMemory { address: u32 },
    /// The flash is programmed a word at a time with a supply that is too low for that.
    FlashSupply { millivolts: u32 },
    /// A single byte is received by I2C.
    OneByteRead,
    /// The crystal stopped while the firmware relied on it unwatched.
    UnwatchedCrystal,
    /// A pin is driven above the supply while its pull resistor is on.
    PinVoltage { pin: Pin, millivolts: [u32; 2] },
    /// A peripheral is touched without its clock.
    Unclocked { address: u32 },
    /// A peripheral is touched before the clock that was just enabled has arrived
    /// (ES0182).
    ClockOnItsWay { address: u32 },
    /// A clock is out of its range, in Hz (DS8626 tables 14 and 43).
    Clock {
        what: &'static str,
        hz: u64,
        range: [u64; 2],
    },
    /// The flash has too few wait states for the core's clock (RM0090 table 10).
    FlashLatency { hz: u64, states: u32 },
    /// Revision A is to prefetch (ES0182).
    Prefetch,
    /// The core sleeps where the next instructions may not be what the flash holds
    /// (ES0182 2.1.3; where the address matters is from mynewt-core #2057 and "An STM32 WFI
    /// bug", cliffle.com).
    Wfi { address: u32 },
    /// More is written into a transmit FIFO than it holds (RM0090 34.11).
    Fifo { endpoint: usize },
}

/// The highest HCLK for each wait state of the flash, at 2.7 V to 3.6 V (RM0090 table 10).
const HZ_A_WAIT_STATE: u64 = 30_000_000;

/// Voltage by which a pin with its pull on may be above the supply (DS8626 table 14, note 6).
const PULLED_ABOVE_SUPPLY: f64 = 0.3;

pub(super) const FLASH_ACR: u32 = 0x4002_3c00;
pub(super) const ACR_LATENCY: u32 = 7;
const ACR_PRFTEN: u32 = 1 << 8;
const DBGMCU_CR: u32 = 0xe004_2004;
const DBG_SLEEP: u32 = 1;

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unmodelled { address, write } => {
                let verb = if *write { "writes" } else { "reads" };
                let register = names::register(*address);
                write!(
                    f,
                    "it {verb} {register} at {address:#010x}, which is not modelled"
                )
            }
            Self::Absent { address } => Rule::name_access(
                f,
                *address,
                "which this chip does not have: its reference manual has no such peripheral",
            ),
            Self::Forbidden(rule) => rule.fmt(f),
        }
    }
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::I2cPending => f.write_str(
                "it writes I2C1_CR1 while a START or STOP is pending, which may make it twice \
                 (RM0090 27.6.1): wait until the hardware has cleared the bit",
            ),
            Self::Pin {
                pin,
                function,
                peripheral,
            } => write!(
                f,
                "{peripheral} is used while {pin} is not in its alternate function {function} \
                 (DS8626 table 9)"
            ),
            Self::DmaEnabled {
                controller,
                stream,
                wrong,
            } => {
                let wrong = match wrong {
                    EnabledWrongly::WithFlags => {
                        "while flags of its last transfer are set: clear them first"
                    }
                    EnabledWrongly::WhileSetUp => "by the write that sets it up: set it up first",
                };
                write!(
                    f,
                    "it enables stream {stream} of DMA{controller} {wrong} (RM0090 10.3.17)"
                )
            }
            Self::DmaMemory { address } => write!(
                f,
                "a DMA stream is to use memory at {address:#010x}, which it cannot reach: only \
                 SRAM and flash are on its bus (RM0090 2.3.1)"
            ),
            Self::FlashSupply { millivolts } => write!(
                f,
                "it programs the flash by 32 bits at {millivolts} mV; that takes 2.7 V (RM0090 \
                 3.6.2): measure the supply first"
            ),
            Self::OneByteRead => f.write_str(
                "it receives a single byte by I2C, whose STOP must be asked for while that is on \
                 the wire, and interrupts are on (AN2824): read two",
            ),
            Self::UnwatchedCrystal => f.write_str(
                "the crystal has stopped, and clock security is off: its time is wrong from now \
                 on (RM0090 7.2.7)",
            ),
            Self::PinVoltage {
                pin,
                millivolts: [found, most],
            } => write!(
                f,
                "{pin} is driven to {found} mV while its pull resistor is on: {most} mV at most, \
                 0.3 V above the supply (DS8626 table 14, note 6)"
            ),
            Self::Unclocked { address } => Self::name_access(
                f,
                *address,
                "without the peripheral's clock: on the chip the access is lost",
            ),
            Self::ClockOnItsWay { address } => Self::name_access(
                f,
                *address,
                "before the clock that was just enabled has arrived (ES0182): read the enable \
                 register back first",
            ),
            Self::Clock { what, hz, range } => write!(
                f,
                "{what} is {hz} Hz; it may be {} to {} Hz (DS8626 tables 14 and 43)",
                range[0], range[1]
            ),
            Self::FlashLatency { hz, states } => write!(
                f,
                "the core runs at {hz} Hz while the flash has {states} wait states, which is \
                 enough for {} Hz (RM0090 table 10)",
                (u64::from(*states) + 1) * HZ_A_WAIT_STATE
            ),
            Self::Prefetch => f.write_str(
                "it switches on the flash's prefetch on revision A of the chip, which cannot \
                 (ES0182)",
            ),
            Self::Wfi { address } => write!(
                f,
                "it sleeps by a WFI at {address:#010x} with debug in sleep (DBGMCU_CR) and the \
                 flash's prefetch on: what the core runs next may not be what the flash holds \
                 (ES0182 2.1.3)"
            ),
            Self::Fifo { endpoint } => write!(
                f,
                "it writes more into the transmit FIFO of USB endpoint {endpoint} than that was \
                 given, or than the core has (RM0090 34.11)"
            ),
        }
    }
}

impl Rule {
    fn name_access(f: &mut fmt::Formatter<'_>, address: u32, why: &str) -> fmt::Result {
        let register = names::register(address);
        write!(f, "it touches {register} at {address:#010x} {why}")
    }
}

impl Soc {
    /// The run ends by this; the first reason counts.
    pub(super) fn end(&mut self, end: End) {
        self.end.get_or_insert(end);
    }

    pub(super) fn forbid(&mut self, rule: Rule) {
        self.end(End::Forbidden(rule));
    }

    /// Holds a peripheral that is used to its pins.
    pub(super) fn require_pins(&mut self, pins: &[Pin], function: u8, peripheral: &'static str) {
        for &pin in pins {
            if self.gpio.mode(pin) != Mode::Alternate(function) {
                self.forbid(Rule::Pin {
                    pin,
                    function,
                    peripheral,
                });
            }
        }
    }
}

impl Soc {
    /// Holds a WFI to the addresses at which it is safe.
    pub(crate) fn require_safe_sleep(&mut self, address: u32) {
        let is_set = |register, bit| self.cells.read(register).unwrap_or(0) & bit != 0;
        if address & 4 != 0 && is_set(DBGMCU_CR, DBG_SLEEP) && is_set(FLASH_ACR, ACR_PRFTEN) {
            self.forbid(Rule::Wfi { address });
        }
    }

    /// Holds a pin that is high to the voltage that it may have with its pull on.
    pub(super) fn require_voltage(&mut self, pin: Pin) {
        let most = self.adc.supply() + PULLED_ABOVE_SUPPLY;
        if let Some(volts) = self.gpio.volts[pin.index()]
            && volts > most
            && self.gpio.is_pulled(pin)
        {
            let millivolts = [volts, most].map(|volts| (volts * 1e3).round() as u32);
            self.forbid(Rule::PinVoltage { pin, millivolts });
        }
    }

    /// Holds clocks and wait states to their limits.
    pub(super) fn require_clocks(&mut self) {
        let (input, oscillator) = self.rcc.pll_rates();
        let clocks = &self.clocks;
        let [hclk, pclk1, pclk2] = self.part.fastest();
        let mut limits = vec![
            ("HCLK", clocks.hclk, [0, hclk]),
            ("PCLK1", clocks.pclk1, [0, pclk1]),
            ("PCLK2", clocks.pclk2, [0, pclk2]),
        ];
        if self.rcc.pll_is_on() {
            limits.push(("the PLL's input", input, [950_000, 2_100_000]));
            limits.push((
                "the PLL's oscillator",
                oscillator,
                [100_000_000, 432_000_000],
            ));
        }
        for (what, rate, range) in limits {
            let hz = rate.hz_rounded();
            if !(range[0]..=range[1]).contains(&hz) {
                self.forbid(Rule::Clock { what, hz, range });
            }
        }
        let hz = self.clocks.hclk.hz_rounded();
        let states = self.cells.read(FLASH_ACR).unwrap_or(0) & ACR_LATENCY;
        if hz > (u64::from(states) + 1) * HZ_A_WAIT_STATE {
            self.forbid(Rule::FlashLatency { hz, states });
        }
    }

    /// Holds a value of FLASH_ACR to what the chip's revision can.
    pub(super) fn require_prefetch(&mut self, acr: u32) {
        if self.revision == Revision::A && acr & ACR_PRFTEN != 0 {
            self.forbid(Rule::Prefetch);
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
