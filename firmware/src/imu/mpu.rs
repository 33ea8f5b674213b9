//! The MPU family: MPU-6050 and MPU-9150, which take a clock of 19.2 MHz at CLKIN, and
//! MPU-6500 and MPU-9250, which do not.
//!
//! One register map (RM-MPU-9150A-00, whose sections are meant by bare numbers); the later
//! two have other filters, and the accelerometer's in a register of its own
//! (RM-MPU-6500A-00 revision 2.1, RM-MPU-9250A-00 revision 1.6).

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::I2c;
use protocol::mpu9150::{
    ACCEL_CONFIG, ACCEL_CONFIG_2, ACCEL_XOUT_H, CONFIG, GYRO_CONFIG, INT_ENABLE, INT_PIN_CFG,
    PWR_MGMT_1, SMPLRT_DIV,
};
use protocol::{AccelRange, GyroRange, ImuConfig, ImuFault, ImuModel, ImuSensor, LowPass};

use super::{Description, RawSample, Registers};

/// WHO_AM_I of the MPU-6050 and MPU-9150.
pub(super) const IDENTITY_6050: u8 = 0x68;

/// WHO_AM_I of the MPU-6500.
pub(super) const IDENTITY_6500: u8 = 0x70;

/// WHO_AM_I of the MPU-9250.
pub(super) const IDENTITY_9250: u8 = 0x71;

/// WHO_AM_I of the MPU-9255, which has the registers of the MPU-9250 (RM-MPU-9255 revision 1.0,
/// 4.42).
pub(super) const IDENTITY_9255: u8 = 0x73;

/// PWR_MGMT_1: reset all registers; the bit clears itself.
const DEVICE_RESET: u8 = 0x80;

/// PWR_MGMT_1, CLKSEL: PLL with the x gyroscope as reference.
const CLOCK_GYRO_X: u8 = 1;

/// PWR_MGMT_1, CLKSEL: PLL with external 19.2 MHz.
const CLOCK_EXTERNAL: u8 = 5;

/// INT_PIN_CFG: active high, push-pull, a pulse of 50 µs, cleared by any read.
const INTERRUPT_PULSE: u8 = 0x10;

/// INT_ENABLE: DATA_RDY_EN.
const INTERRUPT_DATA_READY: u8 = 0x01;

/// From reset to the next access, in ms: the data sheet gives 11 ms as typical,
/// 100 as the most (6.3).
const RESET_MS: u32 = 100;

pub(super) const fn has(config: &ImuConfig) -> bool {
    config.divider <= ImuConfig::MAX_DIVIDER
}

/// PWR_MGMT_1 after a reset: asleep; of the later two awake on their own clock
/// (RM-MPU-6500A-00, 3).
const fn after_reset(model: ImuModel) -> u8 {
    match model {
        ImuModel::Mpu6500 | ImuModel::Mpu9250 => 0x01,
        _ => 0x40,
    }
}

/// Bandwidth of the gyroscope in 0.1 Hz, its delay and the accelerometer's in µs, at
/// [`dlpf_cfg`] (4.3; RM-MPU-6500A-00, 4.5 and 4.8; RM-MPU-9250A-00 revision 1.6, registers 26
/// and 29; hil-sim/rig/ranges.md).
const fn filter(model: ImuModel, low_pass: LowPass) -> (u16, u32, u32) {
    // The later two have one gyroscope, and accelerometers with delays of their own.
    let (bandwidth, gyro_us, of_6500_us, of_9250_us) = match low_pass {
        LowPass::Hz188 => (1_840, 2_900, 5_800, 1_880),
        LowPass::Hz98 => (920, 3_900, 7_800, 2_880),
        LowPass::Hz42 => (410, 5_900, 11_800, 4_880),
        LowPass::Hz20 => (200, 9_900, 19_800, 8_870),
        LowPass::Hz10 => (100, 17_850, 35_700, 16_830),
        LowPass::Hz5 => (50, 33_480, 66_960, 32_480),
    };
    match model {
        ImuModel::Mpu6500 => (bandwidth, gyro_us, of_6500_us),
        ImuModel::Mpu9250 => (bandwidth, gyro_us, of_9250_us),
        _ => (
            low_pass.gyro_bandwidth_hz_times_10(),
            low_pass.gyro_delay_us(),
            low_pass.accel_delay_us(),
        ),
    }
}

pub(super) const fn describe(model: ImuModel, config: &ImuConfig) -> Description {
    let (bandwidth, gyro_delay_us, accel_delay_us) = filter(model, config.low_pass);
    let sensor = match model {
        // PS-MPU-9250A-01, 3.1, 3.2 and 3.4.2 (noise, thermometer). The MPU-6500 is assumed to
        // be the same (hil-sim/rig/ranges.md).
        ImuModel::Mpu6500 | ImuModel::Mpu9250 => ImuSensor {
            gyro_noise_udps: 10_000,
            accel_noise_ug: 300,
            temperature_lsb_per_c_times_100: 33_387,
            temperature_at_zero_centidegrees: 2_100,
            ..ImuSensor::MPU_9150
        },
        // The MPU-6050 has the same noise (PS-MPU-6000A-00, 6.1 and 6.2) and is at
        // 36.53 °C at a count of 0.
        _ => ImuSensor::MPU_9150,
    };
    let sensor = ImuSensor {
        model,
        gyro_bandwidth_hz_times_10: bandwidth,
        ..sensor
    };
    Description {
        gyro_delay_us,
        accel_delay_us,
        sensor,
    }
}

/// DLPF_CFG (4.3), and A_DLPF_CFG of those that have it.
const fn dlpf_cfg(low_pass: LowPass) -> u8 {
    match low_pass {
        LowPass::Hz188 => 1,
        LowPass::Hz98 => 2,
        LowPass::Hz42 => 3,
        LowPass::Hz20 => 4,
        LowPass::Hz10 => 5,
        LowPass::Hz5 => 6,
    }
}

/// GYRO_CONFIG: FS_SEL in bits 4 and 3 (4.4); the filter is not bypassed.
const fn gyro_config(range: GyroRange) -> u8 {
    (match range {
        GyroRange::Dps250 => 0,
        GyroRange::Dps500 => 1,
        GyroRange::Dps1000 => 2,
        GyroRange::Dps2000 => 3,
    }) << 3
}

/// ACCEL_CONFIG: AFS_SEL in bits 4 and 3 (4.5).
const fn accel_config(range: AccelRange) -> u8 {
    (match range {
        AccelRange::G2 => 0,
        AccelRange::G4 => 1,
        AccelRange::G8 => 2,
        AccelRange::G16 => 3,
    }) << 3
}

/// Up to data-ready pulses on its own clock.
pub(super) async fn set_up<B: I2c>(
    registers: &mut Registers<B>,
    model: ImuModel,
    config: &ImuConfig,
    delay: &mut impl DelayNs,
) -> Result<(), ImuFault> {
    registers.write(PWR_MGMT_1, DEVICE_RESET).await?;
    delay.delay_ms(RESET_MS).await;
    registers
        .expect(PWR_MGMT_1, DEVICE_RESET, after_reset(model))
        .await?;

    for (register, value) in [
        (PWR_MGMT_1, CLOCK_GYRO_X),
        (SMPLRT_DIV, config.divider),
        (CONFIG, dlpf_cfg(config.low_pass)),
        (GYRO_CONFIG, gyro_config(config.gyro_range)),
        (ACCEL_CONFIG, accel_config(config.accel_range)),
    ] {
        registers.set(register, value).await?;
    }
    if matches!(model, ImuModel::Mpu6500 | ImuModel::Mpu9250) {
        let filter = dlpf_cfg(config.low_pass);
        registers.set(ACCEL_CONFIG_2, filter).await?;
    }
    registers.set(INT_PIN_CFG, INTERRUPT_PULSE).await?;
    registers.set(INT_ENABLE, INTERRUPT_DATA_READY).await
}

pub(super) async fn start<B: I2c>(
    registers: &mut Registers<B>,
    external: bool,
) -> Result<(), ImuFault> {
    if external {
        registers.set(PWR_MGMT_1, CLOCK_EXTERNAL).await?;
    }
    Ok(())
}

/// First of the seven registers of a sample, of two bytes each.
pub(super) const SAMPLE: u8 = ACCEL_XOUT_H;

/// The sample in those registers.
pub(super) const fn sample([ax, ay, az, temperature, gx, gy, gz]: [i16; 7]) -> RawSample {
    RawSample {
        accel: [ax, ay, az],
        temperature,
        gyro: [gx, gy, gz],
    }
}
