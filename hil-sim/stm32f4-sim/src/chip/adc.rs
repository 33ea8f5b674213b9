//! ADC1 as far as it measures the chip itself (RM0090 chapter 13): single conversions,
//! started by software, of the temperature sensor and the internal reference. Channels at
//! pins, sequences, DMA, interrupts and the watchdog are not modelled.
//!
//! A conversion that breaks the data sheet gives full scale, which is not a temperature:
//! before the ADC or the sensor has settled, sampled for too short, or clocked too fast.

use crate::clock::Rate;
use crate::time::{SimDuration, SimTime};

/// The reference's channel (13.11).
const REFERENCE: u32 = 17;

const SR_EOC: u32 = 1 << 1;
const SR_STRT: u32 = 1 << 4;
const CR2_ADON: u32 = 1 << 0;
const CR2_SWSTART: u32 = 1 << 30;
const CCR_ADCPRE: u32 = 3 << 16;
const CCR_TSVREFE: u32 = 1 << 23;

/// Clocks of a sample by SMPx (13.13.4), and of the 12 bits after it (13.5).
const SAMPLE_CLOCKS: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];
const BIT_CLOCKS: u64 = 12;

/// Shortest sample of the sensor and of the reference, start-up times of the ADC and of
/// the sensor, fastest clock at 2.4 V and more (DS8626 tables 67, 69, 70).
const SHORTEST_SAMPLE: SimDuration = SimDuration::from_micros(10);
const ADC_SETTLES: SimDuration = SimDuration::from_micros(3);
const SENSOR_SETTLES: SimDuration = SimDuration::from_micros(10);
const FASTEST_HZ: u64 = 36_000_000;

const FULL_SCALE: f64 = 4_095.0;

/// Conversions that the factory made at 3.3 V: of the sensor at 30 and at 110 °C, and of
/// the reference (DS8626 tables 70 and 72).
pub(super) const TS_CAL: [u32; 2] = [943, 1_208];
pub(super) const VREFINT_CAL: u32 = 1_504;
const CAL_SUPPLY: f64 = 3.3;
const CAL_CELSIUS: [f64; 2] = [30.0, 110.0];

/// Quantities that the ADC measures.
#[derive(Clone, Copy, Debug)]
pub struct Die {
    /// Temperature of the die, in °C.
    pub celsius: f64,
    /// Analogue supply, in V.
    pub supply: f64,
}

impl Default for Die {
    /// A board behind its diode, warm from its own work.
    fn default() -> Self {
        Self {
            celsius: 36.0,
            supply: 2.9,
        }
    }
}

#[derive(Debug, Default)]
pub(crate) struct Adc {
    die: Die,
    /// The temperature sensor's channel.
    sensor: u32,
    cr1: u32,
    cr2: u32,
    smpr1: u32,
    sqr1: u32,
    sqr3: u32,
    ccr: u32,
    on_since: SimTime,
    sensor_since: SimTime,
    /// When the conversion under way ends, and its code.
    converting: Option<(SimTime, u32)>,
    read: bool,
}

impl Adc {
    pub(crate) fn new(die: Die, sensor: u32) -> Self {
        Self {
            die,
            sensor,
            ..Self::default()
        }
    }

    /// Supply, in V.
    pub(crate) fn supply(&self) -> f64 {
        self.die.supply
    }

    pub(crate) fn set_supply(&mut self, volts: f64) {
        self.die.supply = volts;
    }

    pub(crate) fn reset(&mut self) {
        *self = Self::new(self.die, self.sensor);
    }

    pub(crate) fn read(&mut self, offset: u32, now: SimTime) -> Option<u32> {
        let done = self.converting.filter(|&(at, _)| at <= now);
        Some(match offset {
            0x00 if done.is_some() && !self.read => SR_EOC | SR_STRT,
            0x00 => 0,
            0x04 => self.cr1,
            0x08 => self.cr2,
            0x0c => self.smpr1,
            0x2c => self.sqr1,
            0x34 => self.sqr3,
            0x4c => {
                self.read = true;
                done.map_or(0, |(_, code)| code)
            }
            0x304 => self.ccr,
            _ => return None,
        })
    }

    /// Writes a register; false for what is not modelled.
    pub(crate) fn write(&mut self, offset: u32, value: u32, now: SimTime, pclk2: Rate) -> bool {
        match offset {
            0x00 => {}
            0x04 if value == 0 => self.cr1 = 0,
            0x08 if value & !(CR2_ADON | CR2_SWSTART) == 0 => {
                if value & !self.cr2 & CR2_ADON != 0 {
                    self.on_since = now;
                }
                self.cr2 = value & CR2_ADON;
                if value & CR2_SWSTART != 0 && self.cr2 != 0 {
                    return self.convert(now, pclk2);
                }
            }
            0x0c => self.smpr1 = value,
            // One conversion.
            0x2c if value == 0 => self.sqr1 = 0,
            0x34 if value >> 5 == 0 => self.sqr3 = value,
            0x304 if value & !(CCR_ADCPRE | CCR_TSVREFE) == 0 => {
                if value & !self.ccr & CCR_TSVREFE != 0 {
                    self.sensor_since = now;
                }
                self.ccr = value;
            }
            _ => return false,
        }
        true
    }

    /// The voltage of a channel.
    fn volts(&self, channel: u32) -> Option<f64> {
        let calibrated = |code: u32| f64::from(code) / FULL_SCALE * CAL_SUPPLY;
        let [cold, hot] = TS_CAL.map(calibrated);
        let [from, to] = CAL_CELSIUS;
        match channel {
            _ if channel == self.sensor => {
                Some(cold + (hot - cold) * (self.die.celsius - from) / (to - from))
            }
            REFERENCE => Some(calibrated(VREFINT_CAL)),
            _ => None,
        }
    }

    fn convert(&mut self, now: SimTime, pclk2: Rate) -> bool {
        let Some(volts) = self.volts(self.sqr3) else {
            return false;
        };
        // Channel 10 is in the lowest bits of SMPR1.
        let setting = (self.smpr1 >> (3 * (self.sqr3 - 10))) & 7;
        let sample = SAMPLE_CLOCKS[setting as usize];
        let divider = 2 * (u64::from((self.ccr & CCR_ADCPRE) >> 16) + 1);
        let hz = pclk2.hz_rounded().max(1) / divider;
        let clocks = |n: u64| SimDuration::from_nanos(n * 1_000_000_000 / hz.max(1));
        let good = hz <= FASTEST_HZ
            && clocks(sample) >= SHORTEST_SAMPLE
            && now >= self.on_since + ADC_SETTLES
            && self.ccr & CCR_TSVREFE != 0
            && now >= self.sensor_since + SENSOR_SETTLES;
        let code = if good {
            (volts / self.die.supply * FULL_SCALE)
                .round()
                .min(FULL_SCALE)
        } else {
            FULL_SCALE
        };
        self.converting = Some((now + clocks(sample + BIT_CLOCKS), code as u32));
        self.read = false;
        true
    }
}
