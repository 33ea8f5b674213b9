//! Reset and clock control (RM0090 chapter 7).
//!
//! The clocks are what the firmware programs: every rate follows from the
//! registers, so a wrong factor shows as wrong time. Oscillators and PLL take
//! their time to get ready.

use crate::clock::Rate;
use crate::time::{SimDuration, SimTime};

/// Internal oscillator.
const HSI_HZ: u64 = 16_000_000;
/// Start-up of the crystal (typical; DS8626 table 39).
const HSE_START: SimDuration = SimDuration::from_millis(2);
/// Lock time of the PLL (DS8626 table 43: 75 to 200 us).
const PLL_LOCK: SimDuration = SimDuration::from_micros(150);
/// Start-up of the low-speed oscillator (DS8626 table 42).
const LSI_START: SimDuration = SimDuration::from_micros(15);

/// Why the microcontroller was reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power came up.
    PowerOn,
    /// The supply dipped below the level of its option bytes, and not so far that power was off.
    BrownOut,
    /// The reset pin (the board's button).
    Pin,
    /// The firmware asked for it (SYSRESETREQ).
    Software,
    /// The independent watchdog was not fed.
    IndependentWatchdog,
}

/// Rates of all clocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Clocks {
    pub(crate) hclk: Rate,
    pub(crate) pclk1: Rate,
    pub(crate) pclk2: Rate,
    /// Kernel clock of the timers on APB1 (twice PCLK1 if that is divided).
    pub(crate) timers1: Rate,
    /// Kernel clock of the timers on APB2.
    pub(crate) timers2: Rate,
    /// The PLL's 48 MHz output.
    pub(crate) usb: Rate,
    /// MCO1, if it carries a running clock.
    pub(crate) mco1: Option<Rate>,
}

#[derive(Debug)]
pub(crate) struct Rcc {
    /// Frequency of the crystal; without one its oscillator never gets ready.
    crystal: Option<Rate>,
    /// The crystal has stopped.
    stopped: bool,
    cr: u32,
    pllcfgr: u32,
    cfgr: u32,
    csr: u32,
    /// AHB1RSTR to APB2ENR, by word: resets and gates.
    gates: [u32; (0x48 - GATES as usize) / 4],
    /// Gates that were opened and not waited for, and the cycle at which they were.
    arriving: [(u32, u64); (0x48 - GATES as usize) / 4],
    hse_ready: SimTime,
    pll_ready: SimTime,
    lsi_ready: SimTime,
}

/// Offset of the first register of resets and gates.
const GATES: u32 = 0x10;
const CR_HSION: u32 = 1;
const CR_HSEON: u32 = 1 << 16;
const CR_CSSON: u32 = 1 << 19;
const CR_PLLON: u32 = 1 << 24;
const CR_PLLI2SON: u32 = 1 << 26;
const CSR_RMVF: u32 = 1 << 24;

impl Rcc {
    pub(crate) fn new(crystal: Option<Rate>) -> Self {
        let mut rcc = Self {
            crystal,
            stopped: false,
            cr: 0,
            pllcfgr: 0,
            cfgr: 0,
            csr: 0,
            gates: [0; (0x48 - GATES as usize) / 4],
            arriving: [(0, 0); (0x48 - GATES as usize) / 4],
            hse_ready: SimTime::NEVER,
            pll_ready: SimTime::NEVER,
            lsi_ready: SimTime::NEVER,
        };
        rcc.reset(ResetCause::PowerOn);
        rcc
    }

    /// Register values after a reset; its cause is added to the flags.
    pub(crate) fn reset(&mut self, cause: ResetCause) {
        let mut flags = self.csr & 0xfe00_0000;
        flags |= match cause {
            ResetCause::PowerOn => 0x0e00_0000,
            ResetCause::BrownOut => (1 << 25) | (1 << 26),
            ResetCause::Pin => 1 << 26,
            ResetCause::Software => (1 << 28) | (1 << 26),
            ResetCause::IndependentWatchdog => (1 << 29) | (1 << 26),
        };
        self.cr = 0x83;
        self.pllcfgr = 0x2400_3010;
        self.cfgr = 0;
        self.csr = flags;
        self.gates.fill(0);
        self.arriving.fill((0, 0));
        self.gates[((0x30 - GATES) / 4) as usize] = 0x0010_0000;
        self.hse_ready = SimTime::NEVER;
        self.pll_ready = SimTime::NEVER;
        self.lsi_ready = SimTime::NEVER;
    }

    /// The core runs at 60 MHz from the crystal, as by the ROM's bootloader for USB (AN2606),
    /// with clock security on, and the USB core has its clock.
    pub(crate) fn leave_as_rom(&mut self, now: SimTime) {
        let Some(crystal) = self.crystal else {
            return;
        };
        (self.hse_ready, self.pll_ready) = (now, now);
        self.cr |= CR_HSEON | CR_CSSON | CR_PLLON;
        let divider = crystal.hz_rounded() as u32 / 1_000_000;
        self.pllcfgr = (5 << 24) | (1 << 22) | (1 << 16) | (240 << 6) | divider;
        self.cfgr = 0x9400 | (2 << 2) | 2;
        self.gates[((0x30 - GATES) / 4) as usize] |= 0x0060_000f;
        self.gates[((0x34 - GATES) / 4) as usize] |= 1 << 7;
        self.gates[((0x44 - GATES) / 4) as usize] |= 1 << 14;
    }

    fn crystal_rate(&self) -> Rate {
        self.crystal.unwrap_or(Rate::hz(0))
    }

    fn pll_source(&self) -> Rate {
        if self.pllcfgr & (1 << 22) != 0 {
            self.crystal_rate()
        } else {
            Rate::hz(HSI_HZ)
        }
    }

    /// PLL output for a divider of its oscillator.
    fn pll(&self, div: u64) -> Rate {
        let m = u64::from(self.pllcfgr & 0x3f).max(1);
        let n = u64::from((self.pllcfgr >> 6) & 0x1ff);
        self.pll_source().scaled(n, m * div)
    }

    fn pll_p(&self) -> Rate {
        self.pll(u64::from((self.pllcfgr >> 16) & 3) * 2 + 2)
    }

    /// Present rates.
    pub(crate) fn clocks(&self, now: SimTime) -> Clocks {
        let pll_on = self.cr & CR_PLLON != 0 && now >= self.pll_ready;
        let sysclk = match self.cfgr & 3 {
            1 => self.crystal_rate(),
            2 => self.pll_p(),
            _ => Rate::hz(HSI_HZ),
        };
        let hpre = match (self.cfgr >> 4) & 0xf {
            0..=7 => 1,
            8 => 2,
            9 => 4,
            10 => 8,
            11 => 16,
            12 => 64,
            13 => 128,
            14 => 256,
            _ => 512,
        };
        let apb = |field: u32| match field & 7 {
            0..=3 => 1u64,
            4 => 2,
            5 => 4,
            6 => 8,
            _ => 16,
        };
        let (p1, p2) = (apb(self.cfgr >> 10), apb(self.cfgr >> 13));
        let hclk = sysclk.scaled(1, hpre);
        let timers = |p: u64| if p == 1 { hclk } else { hclk.scaled(2, p) };
        let q = u64::from((self.pllcfgr >> 24) & 0xf).max(1);
        let mco1_div = match (self.cfgr >> 24) & 7 {
            0..=3 => 1,
            4 => 2,
            5 => 3,
            6 => 4,
            _ => 5,
        };
        let mco1 = match (self.cfgr >> 21) & 3 {
            0 => Some(Rate::hz(HSI_HZ)),
            2 if self.cr & CR_HSEON != 0 && now >= self.hse_ready => self.crystal,
            3 if pll_on => Some(self.pll_p()),
            _ => None,
        };
        Clocks {
            hclk,
            pclk1: hclk.scaled(1, p1),
            pclk2: hclk.scaled(1, p2),
            timers1: timers(p1),
            timers2: timers(p2),
            usb: if pll_on { self.pll(q) } else { Rate::hz(0) },
            mco1: mco1.map(|r| r.scaled(1, mco1_div)),
        }
    }

    /// The crystal stops, or swings again. Returns true if clock security notices that it stops:
    /// the core then goes on from the internal oscillator (RM0090 7.2.7).
    pub(crate) fn set_crystal(&mut self, swings: bool) -> Option<bool> {
        self.stopped = !swings;
        let used = self.cr & CR_HSEON != 0 && self.hse_ready != SimTime::NEVER;
        if swings || !used {
            return None;
        }
        let watched = self.cr & CR_CSSON != 0;
        (self.hse_ready, self.pll_ready) = (SimTime::NEVER, SimTime::NEVER);
        self.cr = (self.cr | CR_HSION) & !(CR_HSEON | CR_PLLON);
        self.cfgr &= !0xf;
        Some(watched)
    }

    /// When an oscillator that is starting gets ready.
    pub(crate) fn next_ready(&self, now: SimTime) -> SimTime {
        [self.hse_ready, self.pll_ready]
            .into_iter()
            .filter(|t| *t > now)
            .min()
            .unwrap_or(SimTime::NEVER)
    }

    /// Index of a register of resets or gates.
    fn gate(&self, offset: u32) -> Option<usize> {
        // With holes between those of AHB3 and APB1, and of APB2 and AHB1.
        let there = matches!(offset, 0x10..=0x18 | 0x20..=0x24 | 0x30..=0x38 | 0x40..=0x44);
        there.then(|| ((offset - GATES) / 4) as usize)
    }

    /// True if bit `bit` of the enable register at `offset` is set.
    pub(crate) fn enabled(&self, offset: u32, bit: u32) -> bool {
        self.gate(offset)
            .and_then(|n| self.gates.get(n))
            .is_some_and(|w| w & (1 << bit) != 0)
    }

    /// A gate register was written at `cycle`; it had the value `before`.
    pub(crate) fn note_gates(&mut self, offset: u32, before: u32, cycle: u64) {
        if let Some(n) = self.gate(offset) {
            let opened = self.gates[n] & !before;
            if opened != 0 {
                self.arriving[n] = (opened, cycle);
            }
        }
    }

    /// Software reads a gate register back, which takes as long as its clocks take.
    pub(crate) fn gates_read(&mut self, offset: u32) {
        if let Some(n) = self.gate(offset) {
            self.arriving[n].0 = 0;
        }
    }

    /// Cycles since a gate was opened that nobody has waited for.
    pub(crate) fn since_opened(&self, offset: u32, bit: u32, cycle: u64) -> Option<u64> {
        let (bits, since) = self.arriving[self.gate(offset)?];
        (bits & (1 << bit) != 0).then(|| cycle - since)
    }

    /// The PLL's input and its oscillator.
    pub(crate) fn pll_rates(&self) -> (Rate, Rate) {
        let m = u64::from(self.pllcfgr & 0x3f).max(1);
        (self.pll_source().scaled(1, m), self.pll(1))
    }

    /// True if the PLL is switched on.
    pub(crate) fn pll_is_on(&self) -> bool {
        self.cr & CR_PLLON != 0
    }

    pub(crate) fn read(&self, offset: u32, now: SimTime) -> Option<u32> {
        Some(match offset {
            0x00 => {
                let mut cr = self.cr & !((1 << 1) | (1 << 17) | (1 << 25) | (1 << 27));
                if cr & CR_HSION != 0 {
                    cr |= 1 << 1;
                }
                if cr & CR_HSEON != 0 && now >= self.hse_ready {
                    cr |= 1 << 17;
                }
                if cr & CR_PLLON != 0 && now >= self.pll_ready {
                    cr |= 1 << 25;
                }
                if cr & CR_PLLI2SON != 0 {
                    cr |= 1 << 27;
                }
                cr
            }
            0x04 => self.pllcfgr,
            0x08 => self.cfgr,
            0x74 => {
                let ready = self.csr & 1 != 0 && now >= self.lsi_ready;
                self.csr | (u32::from(ready) << 1)
            }
            _ => *self.gates.get(self.gate(offset)?)?,
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: SimTime) -> bool {
        match offset {
            0x00 => {
                let on = value & !self.cr;
                if on & CR_HSEON != 0 && self.crystal.is_some() && !self.stopped {
                    self.hse_ready = now + HSE_START;
                }
                if on & CR_PLLON != 0 {
                    self.pll_ready = now + PLL_LOCK;
                }
                let mut value = value;
                // The clock that runs the core cannot be stopped (RM0090 7.3.1).
                match self.cfgr & 3 {
                    0 => value |= CR_HSION,
                    1 => value |= CR_HSEON,
                    _ => value |= CR_PLLON,
                }
                self.cr = value & 0x0d0d_00f9;
            }
            0x04 => {
                // Locked while the PLL runs.
                if self.cr & CR_PLLON == 0 {
                    self.pllcfgr = value;
                }
            }
            0x08 => {
                let mut value = value & !0xc;
                let ready = match value & 3 {
                    0 => self.cr & CR_HSION != 0,
                    1 => self.cr & CR_HSEON != 0 && now >= self.hse_ready,
                    2 => self.cr & CR_PLLON != 0 && now >= self.pll_ready,
                    _ => false,
                };
                if !ready {
                    value = (value & !3) | (self.cfgr & 3);
                }
                self.cfgr = value | ((value & 3) << 2);
            }
            0x74 => {
                if value & 1 != 0 && self.csr & 1 == 0 {
                    self.lsi_ready = now + LSI_START;
                }
                let mut flags = self.csr & 0xfe00_0000;
                if value & CSR_RMVF != 0 {
                    flags = 0;
                }
                self.csr = flags | (value & 1);
            }
            _ => match self.gate(offset).and_then(|n| self.gates.get_mut(n)) {
                Some(word) => *word = value,
                None => return false,
            },
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_that_is_not_ready_is_not_selected() {
        let mut rcc = Rcc::new(Some(Rate::hz(8_000_000)));
        rcc.write(0x08, 2, SimTime::ZERO);
        assert_eq!(rcc.read(0x08, SimTime::ZERO).unwrap() & 0xf, 0);
    }

    #[test]
    fn reset_flags_add_up_until_they_are_removed() {
        let mut rcc = Rcc::new(Some(Rate::hz(8_000_000)));
        assert_eq!(rcc.read(0x74, SimTime::ZERO).unwrap() >> 25, 0x07);
        rcc.write(0x74, CSR_RMVF, SimTime::ZERO);
        assert_eq!(rcc.read(0x74, SimTime::ZERO).unwrap() >> 25, 0);
        rcc.reset(ResetCause::IndependentWatchdog);
        assert_eq!(
            rcc.read(0x74, SimTime::ZERO).unwrap(),
            (1 << 29) | (1 << 26)
        );
    }
}
