//! ADC1, which measures the chip's temperature and supply: two conversions, one at each look, so
//! nobody waits for them. (The HAL's driver waits for each, and looks for the STM32F411's sensor at
//! channel 16, as in 0.6.0; it is at 18, RM0383 11.9.)

use embassy_stm32::pac::adc::vals::SampleTime;
use embassy_stm32::pac::adccommon::vals::Adcpre;
use embassy_stm32::peripherals::ADC1;
use embassy_stm32::{Peri, pac, rcc};
use firmware::boards::BOARD;
use firmware::config::SYSCLK_HZ;
use firmware::die_temperature::{self, Calibration};

const ADC: pac::adc::Adc = pac::ADC1;

/// Registers that all ADCs of the chip share.
#[cfg(feature = "discovery")]
const COMMON: pac::adccommon::AdcCommon = pac::ADC123_COMMON;
#[cfg(not(feature = "discovery"))]
const COMMON: pac::adccommon::AdcCommon = pac::ADC1_COMMON;

/// Channels of the sensor and of the reference (RM0090 13.11).
const SENSOR: u8 = BOARD.temperature_channel;
const REFERENCE: u8 = 17;
/// Start-up time of the sensor, the longest, in µs (DS8626 table 70).
const SETTLING_US: u32 = 10;

pub(crate) struct Thermometer {
    /// Nothing else uses the converter.
    _adc: Peri<'static, ADC1>,
    calibration: Calibration,
    converting: u8,
    sensor: Option<u16>,
    measured: Measured,
}

/// Measures the supply now, in mV: 41 µs. The next look then has no result. To be called by tasks,
/// once there is a [`Thermometer`].
pub(crate) fn supply_mv() -> Option<u16> {
    let _ = ADC.dr().read();
    ADC.sqr3().write(|w| w.set_sq(0, REFERENCE));
    ADC.cr2().modify(|w| w.set_swstart(true));
    // Each read takes 4 clocks and more.
    let most_reads = 100 * (SYSCLK_HZ / 1_000_000) / 4;
    (0..most_reads).find(|_| ADC.sr().read().eoc())?;
    die_temperature::supply_mv(&calibration(), ADC.dr().read().data())
}

/// Measurements of the chip itself.
#[derive(Clone, Copy, Default)]
pub(crate) struct Measured {
    /// Temperature, in 0.1 °C.
    pub(crate) decidegrees: Option<i16>,
    /// Supply, in mV.
    pub(crate) supply_mv: Option<u16>,
}

impl Thermometer {
    /// Switches sensor and ADC on.
    pub(crate) fn new(adc: Peri<'static, ADC1>) -> Self {
        rcc::enable_and_reset::<ADC1>();
        COMMON.ccr().modify(|w| {
            // APB2's 48 MHz / 4; the ADC takes 36 at most.
            w.set_adcpre(Adcpre::DIV4);
            w.set_tsvrefe(true);
        });
        // 40 µs; the sensor wants 10 (DS8626 table 70). The register begins with
        // channel 10.
        ADC.smpr1().write(|w| {
            for channel in [SENSOR, REFERENCE] {
                w.set_smp(usize::from(channel - 10), SampleTime::CYCLES480);
            }
        });
        ADC.cr2().write(|w| w.set_adon(true));
        cortex_m::asm::delay(SETTLING_US * (SYSCLK_HZ / 1_000_000));
        Self {
            _adc: adc,
            calibration: calibration(),
            converting: 0,
            sensor: None,
            measured: Measured::default(),
        }
    }

    /// Takes the conversion of the last look, 0.1 ms ago at least, and starts the next.
    pub(crate) fn look(&mut self) -> Measured {
        let done = ADC.sr().read().eoc().then(|| ADC.dr().read().data());
        if self.converting == SENSOR {
            self.sensor = done;
        } else if let (Some(sensor), Some(reference)) = (self.sensor, done) {
            self.measured = Measured {
                decidegrees: die_temperature::decidegrees(&self.calibration, sensor, reference),
                supply_mv: die_temperature::supply_mv(&self.calibration, reference),
            };
        }
        self.converting = if self.converting == SENSOR {
            REFERENCE
        } else {
            SENSOR
        };
        ADC.sqr3().write(|w| w.set_sq(0, self.converting));
        ADC.cr2().modify(|w| w.set_swstart(true));
        self.measured
    }
}

#[allow(unsafe_code, reason = "memory that the factory wrote")]
fn calibration() -> Calibration {
    // SAFETY: addresses in the chip's system memory, which is always there.
    let word = |address: usize| unsafe { (address as *const u16).read_volatile() };
    Calibration {
        reference: word(0x1FFF_7A2A),
        at_30: word(0x1FFF_7A2C),
        at_110: word(0x1FFF_7A2E),
    }
}
