//! Tests of the driver on a mock bus.

use std::pin::pin;
use std::task::{Context, Poll, Waker};

use embedded_hal::i2c::{ErrorType, NoAcknowledgeSource, Operation};
use protocol::mpu9150::register_name;

use super::*;
use crate::config::IMU_DEFAULT;

/// A sensor as far as the driver sees it: registers, a fault to come, and a
/// log of what was written.
struct Mock {
    registers: [u8; 128],
    log: Vec<(u8, u8)>,
    /// The transfer (counted from 0) that fails, and how.
    fail: Option<(usize, ErrorKind)>,
    /// A register that does not keep what is written.
    stuck: Option<u8>,
    transfers: usize,
}

#[derive(Debug)]
struct MockError(ErrorKind);

impl Error for MockError {
    fn kind(&self) -> ErrorKind {
        self.0
    }
}

impl Mock {
    fn new() -> Self {
        let mut registers = [0; 128];
        registers[usize::from(WHO_AM_I)] = 0x68;
        registers[usize::from(PWR_MGMT_1)] = 0x40;
        Self {
            registers,
            log: Vec::new(),
            fail: None,
            stuck: None,
            transfers: 0,
        }
    }
}

impl ErrorType for Mock {
    type Error = MockError;
}

impl I2c for Mock {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), MockError> {
        assert_eq!(address, 0x68);
        let transfer = self.transfers;
        self.transfers += 1;
        if let Some((at, kind)) = self.fail
            && at == transfer
        {
            return Err(MockError(kind));
        }
        let mut pointer = 0;
        for operation in operations {
            match operation {
                Operation::Write([register]) => pointer = usize::from(*register),
                Operation::Write([register, value]) => {
                    self.log.push((*register, *value));
                    let kept = match (*register, *value) {
                        (PWR_MGMT_1, DEVICE_RESET) => {
                            self.registers[usize::from(SMPLRT_DIV)..0x6B].fill(0);
                            AFTER_RESET
                        }
                        _ => *value,
                    };
                    if self.stuck != Some(*register) {
                        self.registers[usize::from(*register)] = kept;
                    }
                }
                Operation::Write(other) => panic!("unexpected write {other:?}"),
                Operation::Read(bytes) => {
                    for byte in bytes.iter_mut() {
                        *byte = self.registers[pointer];
                        pointer += 1;
                    }
                }
            }
        }
        Ok(())
    }
}

#[derive(Default)]
struct Delay(u64);

impl DelayNs for Delay {
    async fn delay_ns(&mut self, ns: u32) {
        self.0 += u64::from(ns);
    }
}

fn now<T>(future: impl Future<Output = T>) -> T {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("the mock never waits"),
    }
}

/// Up to the external clock.
fn set_up(sensor: &mut Mpu9150<Mock>, config: &ImuConfig) -> Result<(), ImuFault> {
    now(sensor.set_up(config, &mut Delay::default()))?;
    now(sensor.use_external_clock())
}

#[test]
fn the_default_is_written_after_a_reset() {
    let mut sensor = Mpu9150::new(Mock::new());
    let mut delay = Delay::default();
    now(sensor.set_up(&IMU_DEFAULT, &mut delay)).unwrap();
    // Its own clock first: every other setting is made while it surely runs.
    let expected = [
        (0x6B, 0x80),
        (0x6B, 0x01),
        (0x19, 1),
        (0x1A, 1),
        (0x1B, 0x08),
        (0x1C, 0x08),
        (0x37, 0x10),
        (0x38, 0x01),
    ];
    assert_eq!(sensor.bus.log, expected);
    now(sensor.use_external_clock()).unwrap();
    assert_eq!(sensor.bus.log[expected.len()..], [(0x6B, 0x05)]);
    assert_eq!(delay.0, 100_000_000);
}

#[test]
fn every_setting_reaches_its_field() {
    for (low_pass, dlpf) in [
        (LowPass::Hz188, 1),
        (LowPass::Hz98, 2),
        (LowPass::Hz42, 3),
        (LowPass::Hz20, 4),
        (LowPass::Hz10, 5),
        (LowPass::Hz5, 6),
    ] {
        for (gyro_range, fs) in [
            (GyroRange::Dps250, 0x00),
            (GyroRange::Dps500, 0x08),
            (GyroRange::Dps1000, 0x10),
            (GyroRange::Dps2000, 0x18),
        ] {
            for (accel_range, afs) in [
                (AccelRange::G2, 0x00),
                (AccelRange::G4, 0x08),
                (AccelRange::G8, 0x10),
                (AccelRange::G16, 0x18),
            ] {
                let config = ImuConfig {
                    divider: 199,
                    low_pass,
                    gyro_range,
                    accel_range,
                };
                let mut sensor = Mpu9150::new(Mock::new());
                now(sensor.set_up(&config, &mut Delay::default())).unwrap();
                let kept = &sensor.bus.registers;
                assert_eq!(kept[0x19..0x1D], [199, dlpf, fs, afs]);
                assert_eq!(kept[0x6B], 1);
            }
        }
    }
}

#[test]
fn another_sensor_is_not_touched() {
    let mut sensor = Mpu9150::new(Mock::new());
    sensor.bus.registers[0x75] = 0x71;
    let fault = set_up(&mut sensor, &IMU_DEFAULT);
    assert_eq!(fault, Err(ImuFault::WrongIdentity { found: 0x71 }));
    assert!(sensor.bus.log.is_empty());
}

#[test]
fn a_fault_at_any_transfer_names_its_register() {
    let mut good = Mpu9150::new(Mock::new());
    set_up(&mut good, &IMU_DEFAULT).unwrap();
    let transfers = good.bus.transfers;
    assert_eq!(transfers, 19);
    for at in 0..transfers {
        for source in [
            NoAcknowledgeSource::Address,
            NoAcknowledgeSource::Data,
            NoAcknowledgeSource::Unknown,
        ] {
            let mut sensor = Mpu9150::new(Mock::new());
            sensor.bus.fail = Some((at, ErrorKind::NoAcknowledge(source)));
            let fault = set_up(&mut sensor, &IMU_DEFAULT);
            let register = sensor.register();
            assert_eq!(fault, Err(ImuFault::NoAcknowledge { register }));
            assert!(register_name(register).is_some());
        }
        for kind in [ErrorKind::ArbitrationLoss, ErrorKind::Bus, ErrorKind::Other] {
            let mut sensor = Mpu9150::new(Mock::new());
            sensor.bus.fail = Some((at, kind));
            let fault = set_up(&mut sensor, &IMU_DEFAULT);
            let register = sensor.register();
            assert_eq!(fault, Err(ImuFault::Bus { register }));
        }
    }
    let mut sensor = Mpu9150::new(Mock::new());
    sensor.bus.fail = Some((0, ErrorKind::Bus));
    let fault = now(sensor.read_sample());
    assert_eq!(fault, Err(ImuFault::Bus { register: 0x3B }));
}

#[test]
fn a_register_that_does_not_keep_its_value_is_named() {
    let mut sensor = Mpu9150::new(Mock::new());
    sensor.bus.stuck = Some(GYRO_CONFIG);
    let fault = set_up(&mut sensor, &IMU_DEFAULT);
    let expected = ImuFault::Readback {
        register: 0x1B,
        wrote: 0x08,
        read: 0,
    };
    assert_eq!(fault, Err(expected));

    // A sensor that does not come back from its reset.
    let mut sensor = Mpu9150::new(Mock::new());
    sensor.bus.stuck = Some(PWR_MGMT_1);
    sensor.bus.registers[0x6B] = 0;
    let fault = set_up(&mut sensor, &IMU_DEFAULT);
    let expected = ImuFault::Readback {
        register: 0x6B,
        wrote: 0x80,
        read: 0,
    };
    assert_eq!(fault, Err(expected));
}

#[test]
fn a_sample_is_fourteen_bytes_in_one_transfer() {
    let mut sensor = Mpu9150::new(Mock::new());
    let words: [i16; 7] = [1, -2, i16::MAX, -521, 3000, -4000, 5];
    for (index, word) in words.iter().enumerate() {
        sensor.bus.registers[0x3B + 2 * index..][..2].copy_from_slice(&word.to_be_bytes());
    }
    let sample = now(sensor.read_sample()).unwrap();
    let expected = RawSample {
        accel: [1, -2, i16::MAX],
        temperature: -521,
        gyro: [3000, -4000, 5],
    };
    assert_eq!(sample, expected);
    assert_eq!(sensor.bus.transfers, 1);
}

#[test]
fn only_the_ends_of_the_range_are_saturated() {
    let clear = RawSample {
        accel: [i16::MAX - 1, i16::MIN + 1, 0],
        temperature: i16::MIN,
        gyro: [0; 3],
    };
    assert!(!clear.is_saturated());
    for axis in 0..3 {
        for end in [i16::MIN, i16::MAX] {
            let mut sample = clear;
            sample.accel[axis] = end;
            assert!(sample.is_saturated());
            let mut sample = clear;
            sample.gyro[axis] = end;
            assert!(sample.is_saturated());
        }
    }
}

#[test]
fn settings_are_bounded_and_described() {
    let slow = ImuConfig {
        divider: 199,
        ..IMU_DEFAULT
    };
    assert_eq!(check(&slow), Ok(()));
    let slower = ImuConfig {
        divider: 200,
        ..IMU_DEFAULT
    };
    assert_eq!(check(&slower), Err(Refusal::ImuSettingOutOfRange));
    assert_eq!(interval_ticks(&IMU_DEFAULT), 96_000);
    assert_eq!(interval_ms(&slow), 200);
}
