//! The registers of the ICM-42688-P.
//!
//! Numbers such as "14.37" are sections of its data sheet, DS-000347, revision 1.8.
//! Modelled are the registers of signal path, clock and interrupt in banks 0 to 2; all others
//! of the banks 0 to 4 can be written and read. The delays of the filters are those at zero
//! frequency of the table in 5.5, which the data sheet gives to 0.1 ms; notch and anti-alias
//! filter, whose delays it does not give, add nothing.

use super::log::{Values, bytes_of};
use super::map::{InterruptPin, Measuring, RegisterMap, SignalPath, Source, Stored};
use crate::motion::inertial_channel::LowPass;
use stm32f4_sim::time::SimDuration;

/// Addresses of registers: bank and number.
type Address = (u8, u8);

const DEVICE_CONFIG: Address = (0, 0x11);
const INT_CONFIG: Address = (0, 0x14);
const INT_STATUS: Address = (0, 0x2d);
const INTF_CONFIG0: Address = (0, 0x4c);
const INTF_CONFIG1: Address = (0, 0x4d);
const PWR_MGMT0: Address = (0, 0x4e);
const GYRO_CONFIG0: Address = (0, 0x4f);
const ACCEL_CONFIG0: Address = (0, 0x50);
const GYRO_CONFIG1: Address = (0, 0x51);
const GYRO_ACCEL_CONFIG0: Address = (0, 0x52);
const ACCEL_CONFIG1: Address = (0, 0x53);
const INT_CONFIG1: Address = (0, 0x64);
const INT_SOURCE0: Address = (0, 0x65);
const INTF_CONFIG5: Address = (1, 0x7b);

/// First of the 14 bytes of data, and the one after the last.
const DATA: core::ops::Range<u8> = 0x1d..0x2b;
const FIFO_DATA: u8 = 0x30;
const REG_BANK_SEL: u8 = 0x76;

const BANKS: usize = 5;
const REGISTERS: usize = 128;

/// DATA_RDY_INT of INT_STATUS, UI_DRDY_INT1_EN of INT_SOURCE0.
const DATA_RDY: u8 = 0x08;

/// Registers that are not zero after a reset (chapters 14 to 16).
const RESET_VALUES: [(Address, u8); 26] = [
    ((0, 0x13), 0x05),
    (INT_STATUS, 0x10),
    (INTF_CONFIG0, 0x30),
    (INTF_CONFIG1, 0x91),
    (GYRO_CONFIG0, 0x06),
    (ACCEL_CONFIG0, 0x06),
    (GYRO_CONFIG1, 0x16),
    (GYRO_ACCEL_CONFIG0, 0x11),
    (ACCEL_CONFIG1, 0x0d),
    ((0, 0x54), 0x23),
    ((0, 0x56), 0x82),
    ((0, 0x62), 0x10),
    (INT_CONFIG1, 0x10),
    (INT_SOURCE0, 0x10),
    ((0, 0x75), 0x47),
    ((1, 0x03), 0x80),
    ((1, 0x0b), 0xa0),
    ((1, 0x0c), 0x0d),
    ((1, 0x0d), 0xaa),
    ((1, 0x0e), 0x80),
    ((1, 0x13), 0x11),
    ((1, 0x7a), 0x83),
    ((1, 0x7c), 0x5f),
    ((2, 0x03), 0x30),
    ((2, 0x04), 0x40),
    ((2, 0x05), 0x62),
];

/// Output data rate by GYRO_ODR and ACCEL_ODR, in Hz (14.37); nothing where it is reserved
/// or not whole.
fn output_rate(code: u8) -> Option<u64> {
    Some(match code & 0x0f {
        1 => 32_000,
        2 => 16_000,
        3 => 8_000,
        4 => 4_000,
        5 => 2_000,
        6 => 1_000,
        7 => 200,
        8 => 100,
        9 => 50,
        10 => 25,
        15 => 500,
        _ => return None,
    })
}

/// 3 dB bandwidth and delay of the UI filter (5.5), in Hz and ms, by order (0 to 2) and
/// UI_FILT_BW (0 to 7), at an output rate of 1 kHz. The table's rows of 500 Hz have half the
/// bandwidths and twice the delays; below that the settings from 1 on stay as at 400 Hz.
const UI_FILTER: [[(f64, f64); 8]; 3] = [
    [
        (498.3, 0.6),
        (227.2, 1.8),
        (188.9, 2.0),
        (111.0, 2.8),
        (92.4, 3.1),
        (59.6, 4.1),
        (48.8, 4.7),
        (23.9, 8.1),
    ],
    [
        (493.3, 0.7),
        (230.7, 2.1),
        (191.6, 2.4),
        (117.5, 3.2),
        (97.1, 3.7),
        (59.6, 5.2),
        (48.0, 6.1),
        (21.3, 12.0),
    ],
    [
        (492.9, 0.8),
        (234.7, 2.3),
        (195.8, 2.7),
        (118.9, 4.0),
        (97.9, 4.6),
        (60.8, 6.6),
        (46.8, 8.2),
        (25.2, 14.1),
    ],
];

/// The delays of the second order at the other rates, in ms, as the table has them: what
/// scaling would give is rounded to 0.1 ms differently.
const SECOND_ORDER_DELAY: [(u64, [f64; 8]); 5] = [
    (500, [1.3, 4.1, 4.7, 6.4, 7.3, 10.4, 12.2, 24.0]),
    (200, [3.3, 5.1, 5.8, 8.0, 9.1, 12.9, 15.3, 30.0]),
    (100, [6.5, 5.1, 5.8, 8.0, 9.1, 12.9, 15.3, 30.0]),
    (50, [12.9, 5.1, 5.8, 8.0, 9.1, 12.9, 15.3, 30.0]),
    (25, [25.7, 5.1, 5.8, 8.0, 9.1, 12.9, 15.3, 30.0]),
];

/// The UI filter of one sensor at an output rate; settings 8 to 15 are taken as 0.
fn ui_filter(rate: u64, order: u8, setting: u8) -> LowPass {
    let order = usize::from(order.min(2));
    let setting = usize::from(if setting < 8 { setting } else { 0 });
    let (bandwidth, delay) = UI_FILTER[order][setting];
    let runs_at = if setting == 0 { rate } else { rate.max(400) };
    let slower = 1_000.0 / runs_at as f64;
    let documented = SECOND_ORDER_DELAY
        .iter()
        .find(|(at, _)| order == 1 && *at == rate)
        .map(|(_, delays)| delays[setting]);
    LowPass {
        bandwidth_hz: bandwidth / slower,
        delay_s: documented.unwrap_or(delay * slower) * 1e-3,
    }
}

/// The banks.
#[derive(Debug)]
pub(super) struct IcmRegisters {
    values: [[u8; REGISTERS]; BANKS],
    bank: u8,
}

impl IcmRegisters {
    pub(super) fn new() -> Self {
        let mut map = Self {
            values: [[0; REGISTERS]; BANKS],
            bank: 0,
        };
        map.reset();
        map
    }

    fn at(&self, (bank, register): Address) -> u8 {
        self.values
            .get(usize::from(bank))
            .map_or(0, |values| values[usize::from(register & 0x7f)])
    }

    /// By RTC_MODE, PIN9_FUNCTION and CLKSEL (14.35, 15.18). The rates are those at 32 kHz
    /// (12.5).
    fn source(&self, rate: u64) -> Source {
        let clock = self.at(INTF_CONFIG1);
        match clock & 0x03 {
            _ if clock & 0x04 != 0 => {
                let is_clkin = self.at(INTF_CONFIG5) & 0x06 == 0x04;
                if is_clkin && rate <= 32_000 {
                    Source::Edges(32_000 / rate)
                } else {
                    Source::Stopped
                }
            }
            0 => Source::Internal,
            1 => Source::Pll,
            _ => Source::Stopped,
        }
    }
}

impl RegisterMap for IcmRegisters {
    fn reset(&mut self) {
        self.values = [[0; REGISTERS]; BANKS];
        self.bank = 0;
        for ((bank, register), value) in RESET_VALUES {
            self.values[usize::from(bank)][usize::from(register)] = value;
        }
    }

    fn measuring(&self) -> Measuring {
        let (gyro, accel) = (self.at(GYRO_CONFIG0), self.at(ACCEL_CONFIG0));
        let power = self.at(PWR_MGMT0);
        let filters = self.at(GYRO_ACCEL_CONFIG0);
        // Different rates for the two are not modelled.
        let rate = output_rate(gyro).filter(|_| gyro & 0x0f == accel & 0x0f);
        let hz = rate.unwrap_or(1_000);
        let order = |address, shift: u8| self.at(address) >> shift & 3;
        Measuring {
            // Both in low-noise mode.
            awake: power & 0x0f == 0x0f && rate.is_some(),
            source: self.source(hz),
            path: SignalPath {
                gyro: ui_filter(hz, order(GYRO_CONFIG1, 2), filters & 0x0f),
                accel: ui_filter(hz, order(ACCEL_CONFIG1, 3), filters >> 4),
                gyro_hz: hz,
                accel_hz: hz,
            },
            divider: 1,
            // 3.1: 16.4 LSB per °/s at ±2000, the double at each half.
            gyro_counts_per_dps: [16.4, 32.8, 65.5, 131.0, 262.0, 524.3, 1048.6, 2097.2]
                [usize::from(gyro >> 5)],
            // 3.2: 2,048 LSB per g at ±16.
            accel_counts_per_g: [2_048.0, 4_096.0, 8_192.0, 16_384.0][usize::from(accel >> 5 & 3)],
            gyro_off: [false; 3],
            accel_off: [false; 3],
            // 14.6.
            thermometer: (power & 0x20 == 0).then_some((132.48, 25.0)),
        }
    }

    fn interrupt(&self) -> InterruptPin {
        let config = self.at(INT_CONFIG);
        let short = self.at(INT_CONFIG1) & 0x40 != 0;
        let latched = config & 0x04 != 0;
        // INT_ASYNC_RESET is to be cleared "for proper INT1 and INT2 pin operation"
        // (12.6); without that the model's pin does nothing.
        let proper = self.at(INT_CONFIG1) & 0x10 == 0;
        InterruptPin {
            data_ready: self.at(INT_SOURCE0) & DATA_RDY != 0 && proper,
            active_high: config & 0x01 != 0,
            open_drain: config & 0x02 == 0,
            pulse: (!latched).then_some(SimDuration::from_micros(if short { 8 } else { 100 })),
        }
    }

    fn peek(&self, register: u8, data: &[u8; 14]) -> u8 {
        match register & 0x7f {
            REG_BANK_SEL => self.bank,
            register if self.bank == 0 && DATA.contains(&register) => {
                data[usize::from(register - DATA.start)]
            }
            register => self.at((self.bank, register)),
        }
    }

    fn store(&mut self, register: u8, value: u8) -> Stored {
        let mut stored = Stored::default();
        if register == REG_BANK_SEL {
            self.bank = value & 0x07;
            return stored;
        }
        let address = (self.bank, register & 0x7f);
        match address {
            DEVICE_CONFIG if value & 0x01 != 0 => {
                stored.reset = true;
                return stored;
            }
            // Data, status and identity are read-only.
            (0, 0x1d..=0x38 | 0x6c | 0x6d | 0x75) => return stored,
            // What is reset here has no state in the model.
            (0, 0x4b) => return stored,
            _ => {}
        }
        if let Some(values) = self.values.get_mut(usize::from(self.bank)) {
            values[usize::from(address.1)] = value;
        }
        // Self-test, FIFO, FSYNC, and what the register map calls reserved in a setting.
        stored.ignored = match address {
            (0, 0x16 | 0x70) => value != 0,
            INTF_CONFIG0 => value & 0x10 == 0,
            // Modes other than off and low noise.
            PWR_MGMT0 => !matches!(value & 0x0f, 0 | 0x0f) || value & 0x10 != 0,
            GYRO_CONFIG0 | ACCEL_CONFIG0 => output_rate(value).is_none(),
            GYRO_ACCEL_CONFIG0 => value & 0x88 != 0,
            INT_SOURCE0 => value & !DATA_RDY & 0x7f & !0x10 != 0,
            (3 | 4, _) => true,
            _ => false,
        };
        // While a sensor is on, only rates, ranges and modes may be changed (12.9).
        let at_any_time = matches!(address, PWR_MGMT0 | GYRO_CONFIG0 | ACCEL_CONFIG0);
        stored.ignored |= self.at(PWR_MGMT0) & 0x0f != 0 && !at_any_time;
        stored
    }

    fn after(&self, register: u8) -> u8 {
        if register == FIFO_DATA && self.bank == 0 {
            register
        } else {
            (register + 1) & 0x7f
        }
    }

    fn bytes(&self, values: &Values) -> [u8; 14] {
        // Without FIFO_HOLD_LAST_DATA_EN two values are taken as marks (12.8, 14.34).
        let all = self.at(INTF_CONFIG0) & 0x80 != 0;
        let kept = |value: i16| if all { value } else { value.max(-32_766) };
        let [ax, ay, az] = values.accel.map(kept);
        let [gx, gy, gz] = values.gyro.map(kept);
        bytes_of([values.temperature, ax, ay, az, gx, gy, gz])
    }

    fn no_data(&self) -> [u8; 14] {
        // -32768 (14.5 to 14.18).
        core::array::from_fn(|n| if n % 2 == 0 { 0x80 } else { 0 })
    }

    fn set_ready(&mut self, ready: bool) {
        let status = &mut self.values[0][usize::from(INT_STATUS.1)];
        *status = if ready { *status | DATA_RDY } else { 0 };
    }

    fn clears(&self, register: u8) -> bool {
        self.bank == 0 && register == INT_STATUS.1
    }

    fn selects_clock(&self, register: u8, value: u8) -> bool {
        (self.bank, register) == INTF_CONFIG1 && value & 0x04 != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rows of the table in 5.5 at 500 and 200 Hz, from the bandwidths at 1 kHz.
    #[test]
    fn slower_rates_have_the_bandwidths_of_the_data_sheet() {
        for (rate, order, expected) in [
            (500, 0, [249.1, 113.6, 94.4, 55.5, 46.2, 29.8, 24.4, 11.9]),
            (500, 1, [246.7, 115.3, 95.8, 58.8, 48.5, 29.8, 24.0, 10.6]),
            (200, 1, [98.7, 92.3, 76.6, 47.0, 38.8, 23.8, 19.2, 8.5]),
            (25, 1, [12.3, 92.3, 76.6, 47.0, 38.8, 23.8, 19.2, 8.5]),
            (500, 2, [246.4, 117.4, 97.9, 59.5, 48.9, 30.4, 23.4, 12.6]),
        ] {
            for (setting, bandwidth) in (0..).zip(expected) {
                let filter = ui_filter(rate, order, setting);
                assert!(
                    (filter.bandwidth_hz - bandwidth).abs() < 0.11,
                    "{rate} Hz, {order}, {setting}: {}",
                    filter.bandwidth_hz
                );
            }
        }
    }
}
