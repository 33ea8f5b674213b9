//! The memory map: which register an address is (RM0090 2.3).

use super::adc::{TS_CAL, VREFINT_CAL};
use super::events::Source;
use super::memory::is_flash;
use super::rules::{End, FLASH_ACR, Rule};
use super::{Soc, TIM1, TIM2, TIM3, TIM4, TIM5, names};
use crate::cpu::ROM_STACK;
use crate::pin::Pin;
use crate::time::SimTime;

const RCC: u32 = 0x4002_3800;
const DBGMCU_IDCODE: u32 = 0xe004_2000;
const OTG_FS: u32 = 0x5000_0000;

/// A block of registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Block {
    Tim(usize),
    Iwdg,
    Uart,
    I2c1,
    Gpio(usize),
    Rcc,
    Dma(usize),
    Rng,
    Adc,
    Otg,
    Flash,
    /// Without behaviour: at best some of its registers are stored.
    Other,
}

/// The block of an address, and its enable bit in RCC (register offset and bit);
/// nothing where the chip has no peripheral.
fn block(addr: u32) -> Option<(Block, Option<(u32, u32)>)> {
    const AHB1: u32 = 0x30;
    const AHB2: u32 = 0x34;
    const APB1: u32 = 0x40;
    const APB2: u32 = 0x44;
    if addr >> 18 == OTG_FS >> 18 {
        return Some((Block::Otg, Some((AHB2, 7))));
    }
    Some(match addr & !0x3ff {
        0x4000_0000 => (Block::Tim(TIM2), Some((APB1, 0))),
        0x4000_0400 => (Block::Tim(TIM3), Some((APB1, 1))),
        0x4000_0800 => (Block::Tim(TIM4), Some((APB1, 2))),
        0x4000_0c00 => (Block::Tim(TIM5), Some((APB1, 3))),
        0x4000_3000 => (Block::Iwdg, None),
        0x4000_5000 => (Block::Uart, Some((APB1, 20))),
        0x4000_5400 => (Block::I2c1, Some((APB1, 21))),
        0x4001_0000 => (Block::Tim(TIM1), Some((APB2, 0))),
        0x4001_2000 => (Block::Adc, Some((APB2, 8))),
        0x4001_3800 => (Block::Other, Some((APB2, 14))),
        base @ 0x4002_0000..=0x4002_2000 => {
            let port = (base - 0x4002_0000) / 0x400;
            (Block::Gpio(port as usize), Some((AHB1, port)))
        }
        RCC => (Block::Rcc, None),
        FLASH_ACR => (Block::Flash, None),
        0x4002_6000 => (Block::Dma(0), Some((AHB1, 21))),
        0x4002_6400 => (Block::Dma(1), Some((AHB1, 22))),
        0x5006_0800 => (Block::Rng, Some((AHB2, 6))),
        _ if names::is_peripheral(addr) => (Block::Other, None),
        _ => return None,
    })
}

impl Soc {
    /// True if a peripheral that is touched is there and has its clock, and holds software
    /// to it.
    fn usable(&mut self, enable: Option<(u32, u32)>, address: u32) -> bool {
        if self.part.lacks(address) {
            self.end(End::Absent { address });
            return false;
        }
        let Some((offset, bit)) = enable else {
            return true;
        };
        let enabled = self.rcc.enabled(offset, bit);
        // ES0182, delay after an RCC peripheral clock enabling.
        let needed = match offset {
            0x40 => 1 + self.clocks.hclk.hz_rounded() / self.clocks.pclk1.hz_rounded().max(1),
            0x44 => 1 + self.clocks.hclk.hz_rounded() / self.clocks.pclk2.hz_rounded().max(1),
            _ => 2,
        };
        // It is asked for before it waits for its bus.
        let began = self.cycle.saturating_sub(self.waits.at(address));
        let early = self.rcc.since_opened(offset, bit, began);
        if !enabled {
            self.forbid(Rule::Unclocked { address });
        } else if early.is_some_and(|cycles| cycles < needed) {
            self.forbid(Rule::ClockOnItsWay { address });
        }
        enabled
    }

    /// Reads a peripheral's register as of now; nothing if there is no peripheral.
    pub(super) fn read_register(&mut self, addr: u32) -> Option<u32> {
        let (block, enable) = block(addr)?;
        if !self.usable(enable, addr) {
            return Some(0);
        }
        let value = self.read_modelled(block, addr);
        Some(value.or_else(|| self.cells.read(addr)).unwrap_or_else(|| {
            self.end(End::Unmodelled {
                address: addr,
                write: false,
            });
            0
        }))
    }

    fn read_modelled(&mut self, block: Block, addr: u32) -> Option<u32> {
        let offset = addr & 0x3ff;
        let now = self.now;
        match block {
            Block::Tim(n) => {
                let value = self.tim[n].read(offset, now);
                // Only a captured value changes anything when it is read.
                if (0x34..=0x40).contains(&offset) {
                    self.after_tim(n);
                }
                value
            }
            Block::Iwdg => self.iwdg.read(offset),
            Block::Uart => self.uart.read(offset),
            Block::I2c1 => {
                if self.i2c.reads_one_byte(offset) {
                    self.forbid(Rule::OneByteRead);
                }
                let value = self.i2c.read(offset, now, &mut self.i2c_bus);
                if matches!(offset, 0x10 | 0x14 | 0x18) {
                    self.after_i2c();
                }
                value
            }
            Block::Gpio(port) => self.gpio.read(port, offset),
            Block::Rcc => {
                self.rcc.gates_read(offset);
                self.rcc.read(offset, now)
            }
            Block::Rng => {
                let (clock, hclk) = (self.clocks.usb, self.clocks.hclk);
                self.rng.read(offset, now, clock, hclk)
            }
            Block::Adc => self.adc.read(offset, now),
            Block::Dma(n) => self.dma[n].read(offset),
            Block::Otg => {
                let offset = addr - OTG_FS;
                if offset == 0x808 {
                    let frame = self.usb.frame(now);
                    self.otg.set_frame(frame);
                }
                let value = self.otg.read(offset);
                if self.otg.changed {
                    self.after_usb();
                }
                value
            }
            Block::Flash => self.flash.read(offset),
            Block::Other if addr == DBGMCU_IDCODE => Some(self.part.id(self.revision)),
            Block::Other => None,
        }
    }

    /// Writes a peripheral's register as of now; false if there is no peripheral.
    pub(super) fn write_register(&mut self, addr: u32, value: u32) -> bool {
        let Some((block, enable)) = block(addr) else {
            return false;
        };
        let done = !self.usable(enable, addr)
            || self.write_modelled(block, addr, value)
            || self.cells.write(addr, value);
        if !done {
            self.end(End::Unmodelled {
                address: addr,
                write: true,
            });
        }
        true
    }

    /// True if the register is modelled.
    fn write_modelled(&mut self, block: Block, addr: u32, value: u32) -> bool {
        let offset = addr & 0x3ff;
        let now = self.now;
        match block {
            Block::Tim(n) => {
                let started = self.tim[n].start().is_none();
                let done = self.tim[n].write(offset, value, now);
                self.after_tim(n);
                if started && self.tim[n].start_is_output() {
                    self.start_slaves(n);
                }
                done
            }
            Block::Iwdg => {
                let done = self.iwdg.write(offset, value, now);
                let at = self.iwdg.next_event();
                self.set_event(Source::Watchdog, at);
                done
            }
            Block::Uart => {
                let done = self.uart.write(offset, value, now);
                self.after_uart();
                done
            }
            Block::I2c1 => {
                if self.i2c.is_forbidden(offset, value) {
                    self.forbid(Rule::I2cPending);
                }
                let done = self.i2c.write(offset, value, now);
                if let Some(wires) = self.i2c_wires
                    && self.i2c.starts()
                {
                    self.require_pins(&[wires.scl, wires.sda], 4, "I2C1");
                }
                self.after_i2c();
                done
            }
            Block::Gpio(port) => {
                let Some(pins) = self.gpio.write(port, offset, value) else {
                    return false;
                };
                self.update_port(port, pins);
                if port == 0 {
                    self.update_mco();
                }
                true
            }
            Block::Rcc => self.write_rcc(offset, value),
            Block::Rng => self.rng.write(offset, value, now),
            Block::Adc => self.adc.write(offset, value, now, self.clocks.pclk2),
            Block::Dma(n) => {
                if let Some((stream, wrong)) = self.dma[n].enables_wrongly(offset, value) {
                    self.forbid(Rule::DmaEnabled {
                        controller: n + 1,
                        stream,
                        wrong,
                    });
                }
                let done = self.dma[n].write(offset, value);
                self.fetch_items(n);
                // A stream that was just enabled may have a request waiting.
                self.after_dma();
                self.ask_for_timers();
                self.after_i2c();
                self.after_uart();
                done
            }
            Block::Otg => {
                if let Some(endpoint) = self.otg.overfills(addr - OTG_FS) {
                    self.forbid(Rule::Fifo { endpoint });
                }
                let done = self.otg.write(addr - OTG_FS, value);
                self.after_usb();
                done
            }
            Block::Flash if addr == FLASH_ACR => {
                self.cells.write(addr, value);
                self.update_waits();
                self.require_clocks();
                self.require_prefetch(value);
                true
            }
            Block::Flash => self.flash.write(offset, value),
            Block::Other => false,
        }
    }

    /// Starts the timers that wait for the start of timer `master`, at its time.
    fn start_slaves(&mut self, master: usize) {
        // What is on ITR0 to ITR3 of TIM1 to TIM5 (RM0090 tables 93 and 97); TIM8
        // is not modelled.
        const INPUTS: [[Option<usize>; 4]; 5] = [
            [Some(TIM5), Some(TIM2), Some(TIM3), Some(TIM4)],
            [Some(TIM1), None, Some(TIM3), Some(TIM4)],
            [Some(TIM1), Some(TIM2), Some(TIM5), Some(TIM4)],
            [Some(TIM1), Some(TIM2), Some(TIM3), None],
            [Some(TIM2), Some(TIM3), Some(TIM4), None],
        ];
        let Some(at) = self.tim[master].start() else {
            return;
        };
        for (slave, inputs) in INPUTS.iter().enumerate() {
            let awaited = self.tim[slave].awaits().and_then(|input| inputs[input]);
            if awaited == Some(master) {
                self.tim[slave].trigger(at);
                self.after_tim(slave);
            }
        }
    }

    fn write_rcc(&mut self, offset: u32, value: u32) -> bool {
        let now = self.now;
        let before = self.rcc.read(offset, now).unwrap_or(0);
        let done = self.rcc.write(offset, value, now);
        self.rcc.note_gates(offset, before, self.cycle);
        match offset {
            0x00 | 0x04 | 0x08 => {
                self.apply_clocks();
                // An output clock may come up when its source gets ready.
                let at = self.rcc.next_ready(now);
                self.set_event(Source::Clock, at);
            }
            0x10..=0x24 => self.reset_peripherals(offset, value),
            _ => {}
        }
        done
    }

    /// AHB1RSTR to APB2RSTR: resets the peripherals whose bits are set.
    fn reset_peripherals(&mut self, offset: u32, bits: u32) {
        let now = self.now;
        let chosen = |bit: u32| bits & (1 << bit) != 0;
        match offset {
            0x10 => {
                for port in (0..Pin::PORTS).filter(|port| chosen(*port as u32)) {
                    self.gpio.reset_port(port);
                    self.cells.clear_block(0x4002_0000 + 0x400 * port as u32);
                    self.update_port(port, 0xffff);
                }
                for n in (0..2).filter(|n| chosen(21 + *n as u32)) {
                    self.dma[n] = super::Dma::default();
                }
                self.after_dma();
            }
            0x14 if chosen(7) => {
                self.otg.reset();
                self.after_usb();
            }
            0x20 => {
                for (bit, n) in [(0, TIM2), (1, TIM3), (2, TIM4), (3, TIM5)] {
                    if chosen(bit) {
                        self.tim[n].reset(now);
                        self.after_tim(n);
                    }
                }
                if chosen(21) {
                    self.i2c.reset();
                    self.cells.clear_block(0x4000_5400);
                    self.after_i2c();
                }
                if chosen(20) {
                    self.uart.reset();
                    self.after_uart();
                }
            }
            0x24 if chosen(0) => {
                self.tim[TIM1].reset(now);
                self.after_tim(TIM1);
            }
            _ => {}
        }
    }

    // ---- rsemu's view of the same map ------------------------------------------

    /// Reads bytes for rsemu's core; false if nothing is there.
    pub(crate) fn bus_read(&mut self, addr: u32, dst: &mut [u8], debug: bool) -> bool {
        if let Some(bytes) = self.mem.bytes(addr, dst.len()) {
            dst.copy_from_slice(bytes);
            // The instruction itself is counted by its line.
            if is_flash(addr) && addr.wrapping_sub(self.instruction) >= 4 {
                self.waited += self.waits.flash;
            }
            return true;
        }
        if (0x1fff_0000..0x1fff_7a30).contains(&addr) {
            let word = self.read_system_memory(addr & !3);
            let shift = (addr & 3) * 8;
            for (n, b) in dst.iter_mut().enumerate() {
                *b = (word >> (shift + n as u32 * 8).min(31)) as u8;
            }
            return true;
        }
        if debug || dst.len() > 4 {
            return false;
        }
        self.waited += self.waits.at(addr);
        let Some(word) = self.read_register(addr & !3) else {
            return false;
        };
        let from = (addr & 3) as usize;
        let bytes = word.to_le_bytes();
        match bytes.get(from..from + dst.len()) {
            Some(b) => {
                dst.copy_from_slice(b);
                true
            }
            None => false,
        }
    }

    /// Writes bytes for rsemu's core; false if nothing is there.
    pub(crate) fn bus_write(&mut self, addr: u32, src: &[u8], debug: bool) -> bool {
        let mut word = [0u8; 4];
        let from = (addr & 3) as usize;
        let Some(to) = word.get_mut(from..from + src.len()) else {
            // Wider than a word or across one: byte by byte, RAM only.
            return src
                .iter()
                .enumerate()
                .all(|(n, b)| self.mem.write8(addr.wrapping_add(n as u32), u32::from(*b)));
        };
        to.copy_from_slice(src);
        let value = u32::from_le_bytes(word);
        let done = match src.len() {
            4 => self.mem.write32(addr, value),
            2 => self.mem.write16(addr, value >> (from * 8)),
            1 => self.mem.write8(addr, value >> (from * 8)),
            _ => false,
        };
        if done || debug {
            return done;
        }
        if self.mem.bytes(addr, src.len()).is_some() {
            self.program(addr, src);
            return true;
        }
        self.waited += self.waits.at(addr);
        self.write_register(addr & !3, value)
    }

    /// Factory-programmed words (RM0090 chapter 39; DS8626 tables 72 and 75).
    fn read_system_memory(&self, addr: u32) -> u32 {
        match addr {
            // The vectors of the ROM's bootloader: a stack, and a program that is not modelled.
            0x1fff_0000 => ROM_STACK,
            0x1fff_0004 => 0x1fff_0101,
            0x1fff_7a10 => self.uid[0],
            0x1fff_7a14 => self.uid[1],
            0x1fff_7a18 => self.uid[2],
            // Flash size in KiB in the upper half.
            0x1fff_7a20 => u32::from(self.part.flash_kib()) << 16,
            // VREFINT_CAL in the upper half; TS_CAL1 and TS_CAL2.
            0x1fff_7a28 => VREFINT_CAL << 16,
            0x1fff_7a2c => (TS_CAL[1] << 16) | TS_CAL[0],
            _ => 0,
        }
    }

    /// Number of bus errors that the I2C peripheral reported where there was none.
    pub(crate) fn spurious_bus_errors(&self) -> u64 {
        self.i2c.reported
    }

    /// A register that is stored and not modelled.
    pub(crate) fn stored(&self, address: u32) -> Option<u32> {
        self.cells.read(address)
    }

    /// The stored registers that were written since their reset.
    pub(crate) fn stored_writes(&self) -> impl Iterator<Item = &'static str> {
        self.cells.written()
    }

    /// Reads RAM or flash, for a debugger's eye.
    pub(crate) fn peek(&self, addr: u32, len: usize) -> Option<Vec<u8>> {
        self.mem.bytes(addr, len).map(<[u8]>::to_vec)
    }

    /// Counter of a timer, without any effect, and the time of the last edge of the
    /// clock that it counts.
    pub(crate) fn timer(&self, timer: usize) -> (SimTime, u32) {
        let tim = &self.tim[timer];
        (tim.tick_began(self.now), tim.count(self.now))
    }

    /// Time at which the first event of any kind is due.
    pub(crate) fn due(&self) -> SimTime {
        self.events.next()
    }
}
