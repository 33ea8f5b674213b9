//! The part of the MPU family's register map that the model knows.
//!
//! Numbers such as "4.3" are sections, and "register 55" the registers in decimal, of "MPU-9150 Register Map and Descriptions",
//! RM-MPU-9150A-00, revision 4.2; electrical facts are from the "MPU-9150
//! Product Specification", PS-MPU-9150A-00, revision 4.3. The MPU-6050 has the same map
//! (RM-MPU-6000A-00, revision 4.2). What the MPU-6500 and MPU-9250 do otherwise is from
//! "MPU-6500 Register Map and Descriptions", RM-MPU-6500A-00, revision 2.1, and
//! "MPU-9250 Register Map and Descriptions", RM-MPU-9250A-00, revision 1.6.

use super::SensorModel;
use super::log::Values;
use super::map::{InterruptPin, Measuring, RegisterMap, SignalPath, Source, Stored};
use crate::motion::inertial_channel::LowPass;
use stm32f4_sim::time::SimDuration;

/// Addresses of registers.
pub mod address {
    /// Sample rate divider (4.2).
    pub const SMPLRT_DIV: u8 = 0x19;
    /// DLPF_CFG and EXT_SYNC_SET (4.3).
    pub const CONFIG: u8 = 0x1a;
    /// Full scale and self-test of the gyroscope (4.4).
    pub const GYRO_CONFIG: u8 = 0x1b;
    /// Full scale and self-test of the accelerometer (4.5).
    pub const ACCEL_CONFIG: u8 = 0x1c;
    /// A_DLPF_CFG and ACCEL_FCHOICE_B of the MPU-6500 and MPU-9250 (register 29).
    pub(crate) const ACCEL_CONFIG_2: u8 = 0x1d;
    /// Level, drive, latch and clearing of the interrupt pin (register 55).
    pub(crate) const INT_PIN_CFG: u8 = 0x37;
    /// Interrupt sources that drive the pin (register 56).
    pub(crate) const INT_ENABLE: u8 = 0x38;
    /// Interrupts that came (register 58).
    pub(crate) const INT_STATUS: u8 = 0x3a;
    /// First of the 14 bytes of acceleration, temperature and angular rate (registers 59 to 72).
    pub const ACCEL_XOUT_H: u8 = 0x3b;
    /// Last of these bytes.
    pub(crate) const GYRO_ZOUT_L: u8 = 0x48;
    /// Resets of the analogue and digital signal paths (register 104).
    pub(crate) const SIGNAL_PATH_RESET: u8 = 0x68;
    /// FIFO, auxiliary bus, and their resets (register 106).
    pub(crate) const USER_CTRL: u8 = 0x6a;
    /// Reset, sleep, clock (register 107).
    pub const PWR_MGMT_1: u8 = 0x6b;
    /// Standby of single axes (register 108).
    pub(crate) const PWR_MGMT_2: u8 = 0x6c;
    /// FIFO data (register 116): the address does not move on.
    pub(crate) const FIFO_R_W: u8 = 0x74;
    /// Identity (register 117).
    pub(crate) const WHO_AM_I: u8 = 0x75;
}

/// Bits of INT_PIN_CFG (register 55).
mod int_pin {
    /// Active low.
    pub(super) const INT_LEVEL: u8 = 0x80;
    /// Open drain.
    pub(super) const INT_OPEN: u8 = 0x40;
    /// Held until cleared, instead of a pulse of 50 µs.
    pub(super) const LATCH_INT_EN: u8 = 0x20;
    /// Any read clears, instead of a read of INT_STATUS only.
    pub(super) const INT_RD_CLEAR: u8 = 0x10;
}

/// DATA_RDY_EN of INT_ENABLE and DATA_RDY_INT of INT_STATUS.
const DATA_RDY: u8 = 0x01;

/// Bits of PWR_MGMT_1 (register 107).
mod power {
    /// Resets all registers; clears itself.
    pub(super) const DEVICE_RESET: u8 = 0x80;
    /// Low-power sleep.
    pub(super) const SLEEP: u8 = 0x40;
    /// Wakes from time to time.
    pub(super) const CYCLE: u8 = 0x20;
    /// Temperature sensor off.
    pub(super) const TEMP_DIS: u8 = 0x08;
    /// Clock source.
    pub(super) const CLKSEL: u8 = 0x07;
}

/// SIG_COND_RESET of USER_CTRL (register 106): resets signal paths and sensor registers.
const SIG_COND_RESET: u8 = 0x01;

/// Number of registers that have an address.
const REGISTERS: usize = 128;

/// Length of the data-ready pulse if it is not latched (register 55).
pub(super) const PULSE: SimDuration = SimDuration::from_micros(50);

/// Nominal frequency of the external reference, in Hz (register 107).
const REFERENCE_HZ: u64 = 19_200_000;

/// Internal samples of the accelerometer a second (4.2): always 1 kHz.
const ACCEL_HZ: u64 = 1000;

/// Bandwidth in Hz and delay in µs.
type Pass = (f64, u32);

fn pass((bandwidth_hz, delay_us): Pass) -> LowPass {
    LowPass {
        bandwidth_hz,
        delay_s: f64::from(delay_us) * 1e-6,
    }
}

/// The table of section 4.3: gyroscope, accelerometer, internal rate of the gyroscope.
/// Setting 7 is reserved; the model takes it as 0 (same internal rate).
fn passes_6050(config: u8) -> (Pass, Pass, u64) {
    match config & 0x07 {
        1 => ((188.0, 1_900), (184.0, 2_000), 1000),
        2 => ((98.0, 2_800), (94.0, 3_000), 1000),
        3 => ((42.0, 4_800), (44.0, 4_900), 1000),
        4 => ((20.0, 8_300), (21.0, 8_500), 1000),
        5 => ((10.0, 13_400), (10.0, 13_800), 1000),
        6 => ((5.0, 18_600), (5.0, 19_000), 1000),
        _ => ((256.0, 980), (260.0, 0), 8000),
    }
}

/// Gyroscope of the MPU-6500 and MPU-9250 (register 26 of both).
fn gyro_pass_6500(config: u8) -> (Pass, u64) {
    match config & 0x07 {
        0 => ((250.0, 970), 8000),
        1 => ((184.0, 2_900), 1000),
        2 => ((92.0, 3_900), 1000),
        3 => ((41.0, 5_900), 1000),
        4 => ((20.0, 9_900), 1000),
        5 => ((10.0, 17_850), 1000),
        6 => ((5.0, 33_480), 1000),
        _ => ((3600.0, 170), 8000),
    }
}

/// Accelerometer of the MPU-6500 (register 29).
fn accel_pass_6500(config_2: u8) -> Pass {
    match config_2 & 0x07 {
        1 => (184.0, 5_800),
        2 => (92.0, 7_800),
        3 => (41.0, 11_800),
        4 => (20.0, 19_800),
        5 => (10.0, 35_700),
        6 => (5.0, 66_960),
        _ => (460.0, 1_940),
    }
}

/// Accelerometer of the MPU-9250 (register 29; hil-sim/rig/ranges.md).
fn accel_pass_9250(config_2: u8) -> Pass {
    match config_2 & 0x07 {
        0 | 1 => (218.1, 1_880),
        2 => (99.0, 2_880),
        3 => (44.8, 4_880),
        4 => (21.2, 8_870),
        5 => (10.2, 16_830),
        6 => (5.05, 32_480),
        _ => (420.0, 1_380),
    }
}

/// Counts per degree a second at a GYRO_CONFIG (4.4).
fn gyro_counts_per_dps(gyro_config: u8) -> f64 {
    match gyro_config >> 3 & 3 {
        0 => 131.0,
        1 => 65.5,
        2 => 32.8,
        _ => 16.4,
    }
}

/// Counts per g at an ACCEL_CONFIG (4.5).
fn accel_counts_per_g(accel_config: u8) -> f64 {
    match accel_config >> 3 & 3 {
        0 => 16_384.0,
        1 => 8_192.0,
        2 => 4_096.0,
        _ => 2_048.0,
    }
}

/// The registers of one of the four.
#[derive(Debug)]
pub(super) struct MpuRegisters {
    model: SensorModel,
    values: [u8; REGISTERS],
}

impl MpuRegisters {
    pub(super) fn new(model: SensorModel) -> Self {
        let mut map = Self {
            model,
            values: [0; REGISTERS],
        };
        map.reset();
        map
    }

    fn at(&self, register: u8) -> u8 {
        self.values[usize::from(register & 0x7f)]
    }

    /// True if it is one of the two later ones.
    fn is_late(&self) -> bool {
        matches!(self.model, SensorModel::Mpu6500 | SensorModel::Mpu9250)
    }

    /// By CLKSEL (register 107 of each). The later two have no clock input: 1 to 5 are the
    /// PLL on the gyroscope, or until that is ready the internal oscillator.
    fn source(&self) -> Source {
        match self.at(address::PWR_MGMT_1) & power::CLKSEL {
            1..=5 if self.is_late() => Source::Pll,
            1..=3 => Source::Pll,
            5 => Source::Reference(REFERENCE_HZ),
            // 4 is a PLL on an external 32.768 kHz.
            4 | 7 => Source::Stopped,
            _ => Source::Internal,
        }
    }

    fn path(&self) -> SignalPath {
        let config = self.at(address::CONFIG);
        let (gyro, accel, gyro_hz) = if self.is_late() {
            let (gyro, gyro_hz) = gyro_pass_6500(config);
            let config_2 = self.at(address::ACCEL_CONFIG_2);
            let accel = match self.model {
                SensorModel::Mpu6500 => accel_pass_6500(config_2),
                _ => accel_pass_9250(config_2),
            };
            (gyro, accel, gyro_hz)
        } else {
            passes_6050(config)
        };
        SignalPath {
            gyro: pass(gyro),
            accel: pass(accel),
            gyro_hz,
            accel_hz: ACCEL_HZ,
        }
    }

    /// True if the controller can write the register (section 3, table of registers).
    fn is_writable(&self, register: u8) -> bool {
        (register == address::ACCEL_CONFIG_2 && self.is_late())
            || matches!(register,
                0x0d..=0x10 | 0x19..=0x1c | 0x1f..=0x22 | 0x23..=0x34 | 0x37 | 0x38
                | 0x63..=0x69 | 0x6a..=0x6c | 0x72..=0x74)
    }
}

impl RegisterMap for MpuRegisters {
    /// Zero, but PWR_MGMT_1 and the identity (section 3 of each map).
    fn reset(&mut self) {
        self.values = [0; REGISTERS];
        let awake = if self.is_late() { 0x01 } else { power::SLEEP };
        self.values[usize::from(address::PWR_MGMT_1)] = awake;
        self.values[usize::from(address::WHO_AM_I)] = match self.model {
            SensorModel::Mpu6500 => 0x70,
            SensorModel::Mpu9250 => 0x71,
            _ => 0x68,
        };
    }

    fn measuring(&self) -> Measuring {
        let power = self.at(address::PWR_MGMT_1);
        let standby = self.at(address::PWR_MGMT_2);
        // Registers 65 and 66; MPU-9250 product specification, 3.4.2.
        let thermometer = match self.model {
            SensorModel::Mpu6050 => (340.0, 36.53),
            SensorModel::Mpu6500 | SensorModel::Mpu9250 => (333.87, 21.0),
            _ => (340.0, 35.0),
        };
        Measuring {
            awake: power & power::SLEEP == 0,
            source: self.source(),
            path: self.path(),
            divider: 1 + u64::from(self.at(address::SMPLRT_DIV)),
            gyro_counts_per_dps: gyro_counts_per_dps(self.at(address::GYRO_CONFIG)),
            accel_counts_per_g: accel_counts_per_g(self.at(address::ACCEL_CONFIG)),
            gyro_off: [2, 1, 0].map(|bit| standby >> bit & 1 != 0),
            accel_off: [5, 4, 3].map(|bit| standby >> bit & 1 != 0),
            thermometer: (power & power::TEMP_DIS == 0).then_some(thermometer),
        }
    }

    fn interrupt(&self) -> InterruptPin {
        let config = self.at(address::INT_PIN_CFG);
        let latched = config & int_pin::LATCH_INT_EN != 0;
        InterruptPin {
            data_ready: self.at(address::INT_ENABLE) & DATA_RDY != 0,
            active_high: config & int_pin::INT_LEVEL == 0,
            open_drain: config & int_pin::INT_OPEN != 0,
            pulse: (!latched).then_some(PULSE),
        }
    }

    fn peek(&self, register: u8, data: &[u8; 14]) -> u8 {
        match register & 0x7f {
            register @ address::ACCEL_XOUT_H..=address::GYRO_ZOUT_L => {
                data[usize::from(register - address::ACCEL_XOUT_H)]
            }
            register => self.at(register),
        }
    }

    fn store(&mut self, register: u8, value: u8) -> Stored {
        if !self.is_writable(register) {
            return Stored::default();
        }
        let mut kept = value;
        let mut stored = Stored::default();
        match register {
            address::PWR_MGMT_1 if value & power::DEVICE_RESET != 0 => {
                stored.reset = true;
                return stored;
            }
            // Resets filters of which the model has no state; reads as zero.
            address::SIGNAL_PATH_RESET => return stored,
            address::USER_CTRL => {
                stored.clear = value & SIG_COND_RESET != 0;
                // Reset bits clear themselves.
                kept = value & 0xf0;
            }
            _ => {}
        }
        self.values[usize::from(register)] = kept;
        stored.ignored = 0
            != match register {
                address::SMPLRT_DIV | address::PWR_MGMT_2 => 0,
                // EXT_SYNC_SET.
                address::CONFIG => value & 0x38,
                // Self-test, and the bypass of the filter.
                address::GYRO_CONFIG | address::ACCEL_CONFIG => value & 0xe7,
                // ACCEL_FCHOICE_B.
                address::ACCEL_CONFIG_2 => value & 0x08,
                // FSYNC and bypass.
                address::INT_PIN_CFG => value & 0x0f,
                address::INT_ENABLE => value & !DATA_RDY,
                address::PWR_MGMT_1 => value & power::CYCLE,
                _ => value,
            };
        stored
    }

    fn after(&self, register: u8) -> u8 {
        if register == address::FIFO_R_W {
            register
        } else {
            (register + 1) & 0x7f
        }
    }

    fn bytes(&self, values: &Values) -> [u8; 14] {
        values.bytes()
    }

    fn no_data(&self) -> [u8; 14] {
        [0; 14]
    }

    fn set_ready(&mut self, ready: bool) {
        let status = &mut self.values[usize::from(address::INT_STATUS)];
        *status = if ready { *status | DATA_RDY } else { 0 };
    }

    fn clears(&self, register: u8) -> bool {
        register == address::INT_STATUS
            || self.at(address::INT_PIN_CFG) & int_pin::INT_RD_CLEAR != 0
    }

    fn selects_clock(&self, register: u8, value: u8) -> bool {
        register == address::PWR_MGMT_1 && matches!(value & power::CLKSEL, 4 | 5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_protocol_and_the_sensor_agree_on_every_setting() {
        use protocol::{AccelRange, GyroRange, LowPass};
        // With the bandwidths of gyroscope and accelerometer, in Hz (section 4.3).
        for (setting, pass, gyro_hz, accel_hz) in [
            (1, LowPass::Hz188, 188.0, 184.0),
            (2, LowPass::Hz98, 98.0, 94.0),
            (3, LowPass::Hz42, 42.0, 44.0),
            (4, LowPass::Hz20, 20.0, 21.0),
            (5, LowPass::Hz10, 10.0, 10.0),
            (6, LowPass::Hz5, 5.0, 5.0),
        ] {
            let mut map = MpuRegisters::new(SensorModel::Mpu9150);
            map.store(address::CONFIG, setting);
            let path = map.path();
            assert_eq!(
                (path.gyro.delay_s * 1e6).round() as u32,
                pass.gyro_delay_us()
            );
            assert_eq!(
                (path.accel.delay_s * 1e6).round() as u32,
                pass.accel_delay_us()
            );
            let found = (path.gyro.bandwidth_hz, path.accel.bandwidth_hz);
            assert_eq!(found, (gyro_hz, accel_hz));
            assert_eq!(path.gyro_hz, 1000);
        }
        use GyroRange::{Dps250, Dps500, Dps1000, Dps2000};
        for (setting, range) in (0..).zip([Dps250, Dps500, Dps1000, Dps2000]) {
            let tenths = f64::from(range.lsb_per_dps_times_10());
            assert!((gyro_counts_per_dps(setting << 3) * 10.0 - tenths).abs() < 1e-9);
        }
        use AccelRange::{G2, G4, G8, G16};
        for (setting, range) in (0..).zip([G2, G4, G8, G16]) {
            assert!((accel_counts_per_g(setting << 3) - f64::from(range.lsb_per_g())).abs() < 1e-9);
        }
    }
}
