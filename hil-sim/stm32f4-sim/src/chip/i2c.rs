//! I2C1 as a controller: the v1 peripheral (RM0090 chapter 27).
//!
//! Every start, byte and stop takes its time on the wire, as CCR programs it.
//! DMA requests are raised like on the chip: TxE while transmitting, RxNE
//! while receiving, with LAST making the controller not acknowledge the last
//! byte. Not modelled: target mode, 10-bit addresses, POS, PEC, SMBus,
//! arbitration (there is one controller), clock stretching by targets.

use crate::clock::{Clock, Rate};
use crate::i2c::{Ack, Direction};
use crate::i2c_bus::I2cBus;
use crate::random::Random;
use crate::time::SimTime;

const CR1_PE: u32 = 1 << 0;
const CR1_START: u32 = 1 << 8;
const CR1_STOP: u32 = 1 << 9;
const CR1_ACK: u32 = 1 << 10;
const CR1_SWRST: u32 = 1 << 15;
const CR2_ITERREN: u32 = 1 << 8;
const CR2_ITEVTEN: u32 = 1 << 9;
const CR2_ITBUFEN: u32 = 1 << 10;
const CR2_DMAEN: u32 = 1 << 11;
const CR2_LAST: u32 = 1 << 12;
const SR1_SB: u32 = 1 << 0;
const SR1_ADDR: u32 = 1 << 1;
const SR1_BTF: u32 = 1 << 2;
const SR1_RXNE: u32 = 1 << 6;
const SR1_TXE: u32 = 1 << 7;
const SR1_BERR: u32 = 1 << 8;
const SR1_AF: u32 = 1 << 10;
/// The flags that software clears by writing zero.
const SR1_ERRORS: u32 = 0xdf00;
const SR2_MSL: u32 = 1 << 0;
const SR2_BUSY: u32 = 1 << 1;
const SR2_TRA: u32 = 1 << 2;

/// Clocks of SCL for which a STOP stays pending once the wires are free for it. The chip
/// needs one and the time in which its two edges rise, against pull-ups of up to 10 kΩ;
/// longer is harder on software that does not wait.
const STOP_CLOCKS: u64 = 4;

/// Activity of the controller on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Idle,
    /// A start condition is being made.
    Starting,
    /// SB is set; the address byte is awaited.
    AwaitAddress,
    /// The address byte is on the wire.
    Address(u8),
    /// ADDR is set; SCL is held until SR1 and SR2 were read.
    AwaitClear,
    /// Transmitter, nothing to send: SCL is held.
    TxIdle,
    /// This byte is on the wire.
    TxByte(u8),
    /// A byte is being received.
    RxByte(u8),
    /// Receiver with both registers full: SCL is held.
    RxFull,
    /// The last byte was not acknowledged: a stop or start is awaited.
    RxEnded,
    /// A stop condition is being made.
    Stopping,
}

/// Spurious bus errors: with this probability the controller reports one after a
/// byte, which goes on all the same (ES0182 2.10.1).
#[derive(Clone, Debug)]
pub(crate) struct BusErrors {
    pub(crate) random: Random,
    pub(crate) probability: f64,
}

#[derive(Debug)]
pub(crate) struct I2c {
    bus_errors: BusErrors,
    /// Number of bus errors.
    pub(crate) reported: u64,
    pclk: Rate,
    cr1: u32,
    cr2: u32,
    sr1: u32,
    ccr: u32,
    dr: u8,
    shift: u8,
    transmitter: bool,
    controller: bool,
    /// SR1 was read since ADDR was set.
    sr1_read: bool,
    phase: Phase,
    phase_end: SimTime,
}

impl I2c {
    pub(crate) fn new(bus_errors: BusErrors) -> Self {
        Self {
            bus_errors,
            reported: 0,
            pclk: Rate::hz(16_000_000),
            cr1: 0,
            cr2: 0,
            sr1: 0,
            ccr: 0,
            dr: 0,
            shift: 0,
            transmitter: false,
            controller: false,
            sr1_read: false,
            phase: Phase::Idle,
            phase_end: SimTime::NEVER,
        }
    }

    pub(crate) fn reset(&mut self) {
        *self = Self {
            pclk: self.pclk,
            reported: self.reported,
            ..Self::new(self.bus_errors.clone())
        };
    }

    pub(crate) fn set_clock(&mut self, pclk: Rate) {
        self.pclk = pclk;
    }

    pub(crate) fn next_event(&self) -> SimTime {
        self.phase_end
    }

    /// True if the peripheral has the bus between a start and a stop.
    pub(crate) fn owns_bus(&self) -> bool {
        self.controller
    }

    /// True if software asks for a START that has not been made yet.
    pub(crate) fn starts(&self) -> bool {
        self.cr1 & CR1_START != 0
    }

    /// True if a write breaks the rule that CR1 is left alone while a START or STOP is
    /// pending. The reset of the peripheral is the way out of a bus that hangs.
    pub(crate) fn is_forbidden(&self, offset: u32, value: u32) -> bool {
        offset == 0x00 && self.cr1 & (CR1_START | CR1_STOP) != 0 && value & CR1_SWRST == 0
    }

    /// `bits` clock periods from `now` on.
    fn after(&self, bits: u64, now: SimTime) -> SimTime {
        let ccr = u64::from(self.ccr & 0xfff).max(1);
        // RM0090 27.6.8: low and high time in PCLK1 periods.
        let period = match (self.ccr >> 15, (self.ccr >> 14) & 1) {
            (0, _) => 2 * ccr,
            (_, 0) => 3 * ccr,
            _ => 25 * ccr,
        };
        Clock::new(self.pclk, now, 0).time_of(bits * period)
    }

    fn enter(&mut self, phase: Phase, bits: u64, now: SimTime) {
        self.phase = phase;
        self.phase_end = self.after(bits, now);
    }

    fn wait(&mut self, phase: Phase) {
        self.phase = phase;
        self.phase_end = SimTime::NEVER;
    }

    /// Event and error interrupt requests.
    pub(crate) fn irq(&self) -> (bool, bool) {
        let mut events = self.sr1 & (SR1_SB | SR1_ADDR | SR1_BTF | 0x18);
        if self.cr2 & CR2_ITBUFEN != 0 {
            events |= self.sr1 & (SR1_RXNE | SR1_TXE);
        }
        (
            self.cr2 & CR2_ITEVTEN != 0 && events != 0,
            self.cr2 & CR2_ITERREN != 0 && self.sr1 & SR1_ERRORS != 0,
        )
    }

    /// True if a byte to send is wanted from the DMA.
    pub(crate) fn wants_tx(&self) -> bool {
        self.cr2 & CR2_DMAEN != 0 && self.transmitter && self.sr1 & SR1_TXE != 0 && self.controller
    }

    /// True if the DMA is to fetch a received byte.
    pub(crate) fn wants_rx(&self) -> bool {
        self.cr2 & CR2_DMAEN != 0 && self.sr1 & SR1_RXNE != 0
    }

    /// Ends the activity on the wires. `remaining` are the items that the DMA
    /// still has to fetch, for LAST.
    pub(crate) fn advance(&mut self, now: SimTime, bus: &mut I2cBus, remaining: u32) {
        if now < self.phase_end {
            return;
        }
        if matches!(
            self.phase,
            Phase::Address(_) | Phase::TxByte(_) | Phase::RxByte(_)
        ) && self.bus_errors.random.chance(self.bus_errors.probability)
        {
            self.sr1 |= SR1_BERR;
            self.reported += 1;
        }
        match self.phase {
            Phase::Starting => {
                if bus.is_stuck() {
                    // Somebody holds SDA low: the bus never gets free.
                    self.wait(Phase::Starting);
                    return;
                }
                self.cr1 &= !CR1_START;
                self.sr1 = (self.sr1 | SR1_SB) & !(SR1_TXE | SR1_BTF);
                self.controller = true;
                self.wait(Phase::AwaitAddress);
            }
            Phase::Address(byte) => {
                let direction = if byte & 1 != 0 {
                    Direction::Read
                } else {
                    Direction::Write
                };
                match bus.start(byte >> 1, direction, now) {
                    Ack::Ack => {
                        self.sr1 |= SR1_ADDR;
                        self.sr1_read = false;
                        self.transmitter = direction == Direction::Write;
                        self.wait(Phase::AwaitClear);
                    }
                    Ack::Nack => {
                        self.sr1 |= SR1_AF;
                        self.transmitter = direction == Direction::Write;
                        self.wait(Phase::RxEnded);
                    }
                }
            }
            Phase::TxByte(byte) => match bus.write(byte, now) {
                Ack::Ack => {
                    if self.cr1 & CR1_STOP != 0 {
                        self.enter(Phase::Stopping, STOP_CLOCKS, now);
                    } else if self.sr1 & SR1_TXE == 0 {
                        self.sr1 |= SR1_TXE;
                        self.enter(Phase::TxByte(self.dr), 9, now);
                    } else {
                        self.sr1 |= SR1_BTF;
                        self.wait(Phase::TxIdle);
                        self.start_or_stop(now);
                    }
                }
                Ack::Nack => {
                    self.sr1 |= SR1_AF;
                    self.wait(Phase::RxEnded);
                    self.start_or_stop(now);
                }
            },
            Phase::RxByte(byte) => self.received(byte, bus, now, remaining),
            Phase::Stopping => {
                bus.stop(now);
                self.cr1 &= !CR1_STOP;
                self.sr1 &= !(SR1_TXE | SR1_BTF | SR1_ADDR | SR1_SB);
                self.controller = false;
                self.transmitter = false;
                self.wait(Phase::Idle);
                self.start_or_stop(now);
            }
            Phase::Idle
            | Phase::AwaitAddress
            | Phase::AwaitClear
            | Phase::TxIdle
            | Phase::RxFull
            | Phase::RxEnded => self.phase_end = SimTime::NEVER,
        }
    }

    /// A byte is in: it is acknowledged or not, and goes on to the data register if that is free.
    fn received(&mut self, byte: u8, bus: &mut I2cBus, now: SimTime, remaining: u32) {
        let behind = u32::from(self.sr1 & SR1_RXNE != 0);
        let last = self.cr2 & (CR2_LAST | CR2_DMAEN) == CR2_LAST | CR2_DMAEN
            && remaining.saturating_sub(behind) <= 1;
        let ack = self.cr1 & CR1_ACK != 0 && !last && self.cr1 & CR1_STOP == 0;
        let ack = if ack { Ack::Ack } else { Ack::Nack };
        bus.read_acknowledged(ack, now);
        if self.sr1 & SR1_RXNE != 0 {
            self.shift = byte;
            self.sr1 |= SR1_BTF;
            self.wait(if ack == Ack::Ack {
                Phase::RxFull
            } else {
                Phase::RxEnded
            });
        } else {
            self.dr = byte;
            self.sr1 |= SR1_RXNE;
            if ack == Ack::Ack {
                self.receive(bus, now);
            } else {
                self.wait(Phase::RxEnded);
            }
        }
        if self.phase == Phase::RxEnded {
            self.start_or_stop(now);
        }
    }

    /// Begins to receive the next byte.
    fn receive(&mut self, bus: &mut I2cBus, now: SimTime) {
        let byte = bus.read(now);
        self.enter(Phase::RxByte(byte), 9, now);
    }

    /// Makes the start or stop condition that software asked for, if the wires
    /// are at a point where that is possible.
    fn start_or_stop(&mut self, now: SimTime) {
        if self.cr1 & CR1_PE == 0 {
            return;
        }
        match self.phase {
            Phase::Idle => {
                if self.cr1 & CR1_START != 0 {
                    self.enter(Phase::Starting, 1, now);
                } else {
                    // A stop without a transfer does nothing here.
                    self.cr1 &= !CR1_STOP;
                }
            }
            Phase::TxIdle | Phase::RxEnded | Phase::AwaitAddress => {
                if self.cr1 & CR1_STOP != 0 {
                    self.enter(Phase::Stopping, STOP_CLOCKS, now);
                } else if self.cr1 & CR1_START != 0 && self.phase != Phase::AwaitAddress {
                    self.enter(Phase::Starting, 1, now);
                }
            }
            _ => {}
        }
    }

    /// Tries again to get a bus that was stuck.
    pub(crate) fn bus_released(&mut self, now: SimTime) {
        if self.phase == Phase::Starting && self.phase_end == SimTime::NEVER {
            self.enter(Phase::Starting, 1, now);
        }
    }

    pub(crate) fn read(&mut self, offset: u32, now: SimTime, bus: &mut I2cBus) -> Option<u32> {
        Some(match offset {
            0x00 => self.cr1,
            0x04 => self.cr2,
            0x10 => self.read_dr(now, bus),
            0x14 => {
                self.sr1_read = true;
                self.sr1
            }
            0x18 => {
                if self.sr1 & SR1_ADDR != 0 && self.sr1_read {
                    self.address_cleared(now, bus);
                }
                let mut sr2 = 0;
                if self.controller {
                    sr2 |= SR2_MSL | SR2_BUSY;
                }
                if self.transmitter {
                    sr2 |= SR2_TRA;
                }
                if self.cr1 & CR1_PE != 0 && bus.is_stuck() {
                    sr2 |= SR2_BUSY;
                }
                sr2
            }
            0x1c => self.ccr,
            _ => return None,
        })
    }

    /// True if this read clears ADDR of a transfer of a single byte: it will not be acknowledged.
    pub(crate) fn reads_one_byte(&self, offset: u32) -> bool {
        let clears = offset == 0x18 && self.sr1 & SR1_ADDR != 0 && self.sr1_read;
        clears && !self.transmitter && self.cr1 & CR1_ACK == 0
    }

    fn address_cleared(&mut self, now: SimTime, bus: &mut I2cBus) {
        self.sr1 &= !SR1_ADDR;
        if self.phase != Phase::AwaitClear {
            return;
        }
        if self.transmitter {
            self.sr1 |= SR1_TXE;
            self.wait(Phase::TxIdle);
            self.start_or_stop(now);
        } else {
            self.receive(bus, now);
        }
    }

    fn read_dr(&mut self, now: SimTime, bus: &mut I2cBus) -> u32 {
        let value = self.dr;
        if self.sr1 & SR1_RXNE != 0 {
            self.sr1 &= !SR1_RXNE;
            if self.sr1 & SR1_BTF != 0 && !self.transmitter {
                self.sr1 = (self.sr1 & !SR1_BTF) | SR1_RXNE;
                self.dr = self.shift;
                if self.phase == Phase::RxFull {
                    self.receive(bus, now);
                }
            }
        }
        u32::from(value)
    }

    /// The DMA fetches the received byte.
    pub(crate) fn dma_read(&mut self, now: SimTime, bus: &mut I2cBus) -> u8 {
        self.read_dr(now, bus) as u8
    }

    /// The DMA or software delivers a byte to send.
    pub(crate) fn write_dr(&mut self, byte: u8, now: SimTime) {
        if self.phase == Phase::AwaitAddress {
            self.sr1 &= !SR1_SB;
            self.enter(Phase::Address(byte), 9, now);
            return;
        }
        if !self.transmitter || !self.controller {
            return;
        }
        self.sr1 &= !SR1_BTF;
        if self.phase == Phase::TxIdle {
            self.sr1 |= SR1_TXE;
            self.enter(Phase::TxByte(byte), 9, now);
        } else {
            self.dr = byte;
            self.sr1 &= !SR1_TXE;
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: SimTime) -> bool {
        match offset {
            0x00 => self.write_cr1(value, now),
            0x04 => self.cr2 = value & 0x1f3f,
            0x10 => self.write_dr(value as u8, now),
            0x14 => self.sr1 &= value | !SR1_ERRORS,
            0x1c => self.ccr = value & 0xcfff,
            _ => return false,
        }
        true
    }

    fn write_cr1(&mut self, value: u32, now: SimTime) {
        if value & CR1_SWRST != 0 {
            // Everything but the clock is reset; the wires are let go.
            self.reset();
            self.cr1 = CR1_SWRST;
            return;
        }
        let was_enabled = self.cr1 & CR1_PE != 0;
        self.cr1 = value & 0xbffb;
        if value & CR1_PE == 0 {
            if was_enabled {
                self.sr1 = 0;
                self.cr1 &= !(CR1_START | CR1_STOP);
                self.controller = false;
                self.transmitter = false;
                self.wait(Phase::Idle);
            }
            return;
        }
        self.start_or_stop(now);
    }
}

#[cfg(test)]
mod tests;
