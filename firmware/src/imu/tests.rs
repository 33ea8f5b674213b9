//! Tests of the drivers on a mock bus.

use std::pin::pin;
use std::task::{Context, Poll, Waker};

use embedded_hal::i2c::{ErrorType, NoAcknowledgeSource, Operation};
use protocol::mpu9150::{GYRO_CONFIG, PWR_MGMT_1, SMPLRT_DIV};
use protocol::{AccelRange, GyroRange, ImuState, LowPass, icm42688p as icm};

use super::*;
use crate::config::IMU_DEFAULT;

/// PWR_MGMT_1 of the MPUs.
const DEVICE_RESET: u8 = 0x80;
const AFTER_RESET: u8 = 0x40;

/// A sensor as far as the driver sees it: registers, a fault to come, and a
/// log of what was written.
struct Mock {
    /// By bank; only the ICM-42688-P has more than one.
    registers: [[u8; 128]; 3],
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
        let mut mock = Self::with_identity(0x68);
        mock.registers[0][usize::from(PWR_MGMT_1)] = 0x40;
        mock
    }

    /// Any other, with zeros in its registers.
    fn with_identity(identity: u8) -> Self {
        let mut registers = [[0; 128]; 3];
        registers[0][usize::from(WHO_AM_I)] = identity;
        Self {
            registers,
            log: Vec::new(),
            fail: None,
            stuck: None,
            transfers: 0,
        }
    }

    fn is_icm(&self) -> bool {
        self.registers[0][usize::from(WHO_AM_I)] == 0x47
    }

    fn place(&mut self, register: usize) -> &mut u8 {
        let select = usize::from(icm::REG_BANK_SEL);
        let bank = if self.is_icm() && register != select {
            usize::from(self.registers[0][select])
        } else {
            0
        };
        &mut self.registers[bank][register]
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
                            self.registers[0][usize::from(SMPLRT_DIV)..0x6B].fill(0);
                            match self.registers[0][usize::from(WHO_AM_I)] {
                                0x68 => AFTER_RESET,
                                _ => 0x01,
                            }
                        }
                        (icm::DEVICE_CONFIG, 1) if self.is_icm() => 0,
                        _ => *value,
                    };
                    if self.stuck != Some(*register) {
                        *self.place(usize::from(*register)) = kept;
                    }
                }
                Operation::Write(other) => panic!("unexpected write {other:?}"),
                Operation::Read(bytes) => {
                    for byte in bytes.iter_mut() {
                        *byte = *self.place(pointer);
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

fn imu(mock: Mock) -> Imu<Mock> {
    Imu::new(mock, ImuModel::Unknown)
}

/// Up to the external clock.
fn set_up(sensor: &mut Imu<Mock>, config: &ImuConfig) -> Result<(), ImuFault> {
    now(sensor.set_up(config, &mut Delay::default()))?;
    now(sensor.start(ImuClock::External, &mut Delay::default()))
}

#[test]
fn every_setting_reaches_its_field() {
    use AccelRange::{G2, G4, G8, G16};
    use GyroRange::{Dps250, Dps500, Dps1000, Dps2000};
    use LowPass::{Hz5, Hz10, Hz20, Hz42, Hz98, Hz188};
    for (dlpf, low_pass) in (1..).zip([Hz188, Hz98, Hz42, Hz20, Hz10, Hz5]) {
        for (fs, gyro_range) in (0..).zip([Dps250, Dps500, Dps1000, Dps2000]) {
            for (afs, accel_range) in (0..).zip([G2, G4, G8, G16]) {
                let config = ImuConfig {
                    divider: 199,
                    low_pass,
                    gyro_range,
                    accel_range,
                };
                let mut sensor = imu(Mock::new());
                now(sensor.set_up(&config, &mut Delay::default())).unwrap();
                let kept = &sensor.registers.bus.registers[0];
                assert_eq!(kept[0x19..0x1D], [199, dlpf, fs << 3, afs << 3]);
                assert_eq!(kept[0x6B], 1);
            }
        }
    }
}

#[test]
fn another_sensor_is_not_touched() {
    let mut sensor = imu(Mock::new());
    sensor.registers.bus.registers[0][0x75] = 0x12;
    let fault = set_up(&mut sensor, &IMU_DEFAULT);
    assert_eq!(fault, Err(ImuFault::WrongIdentity { found: 0x12 }));
    // But for the bank that an ICM-42688-P may show.
    assert_eq!(sensor.registers.bus.log, [(0x76, 0)]);
    assert_eq!(sensor.model(), ImuModel::Unknown);
}

#[test]
fn a_fault_at_any_transfer_names_its_register() {
    let mut good = imu(Mock::new());
    set_up(&mut good, &IMU_DEFAULT).unwrap();
    let transfers = good.registers.bus.transfers;
    assert_eq!(transfers, 19);
    for at in 0..transfers {
        for source in [
            NoAcknowledgeSource::Address,
            NoAcknowledgeSource::Data,
            NoAcknowledgeSource::Unknown,
        ] {
            let mut sensor = imu(Mock::new());
            sensor.registers.bus.fail = Some((at, ErrorKind::NoAcknowledge(source)));
            let fault = set_up(&mut sensor, &IMU_DEFAULT);
            let register = sensor.register();
            assert_eq!(fault, Err(ImuFault::NoAcknowledge { register }));
        }
        for kind in [ErrorKind::ArbitrationLoss, ErrorKind::Bus, ErrorKind::Other] {
            let mut sensor = imu(Mock::new());
            sensor.registers.bus.fail = Some((at, kind));
            let fault = set_up(&mut sensor, &IMU_DEFAULT);
            let register = sensor.register();
            assert_eq!(fault, Err(ImuFault::Bus { register }));
        }
    }
    let mut sensor = imu(Mock::new());
    sensor.registers.bus.fail = Some((0, ErrorKind::Bus));
    let fault = now(sensor.read_sample());
    assert_eq!(fault, Err(ImuFault::Bus { register: 0x3B }));
}

#[test]
fn a_register_that_does_not_keep_its_value_is_named() {
    let mut sensor = imu(Mock::new());
    sensor.registers.bus.stuck = Some(GYRO_CONFIG);
    let fault = set_up(&mut sensor, &IMU_DEFAULT);
    let expected = ImuFault::Readback {
        register: 0x1B,
        wrote: 0x08,
        read: 0,
    };
    assert_eq!(fault, Err(expected));

    // A sensor that does not come back from its reset.
    let mut sensor = imu(Mock::new());
    sensor.registers.bus.stuck = Some(PWR_MGMT_1);
    sensor.registers.bus.registers[0][0x6B] = 0;
    let fault = set_up(&mut sensor, &IMU_DEFAULT);
    let expected = ImuFault::Readback {
        register: 0x6B,
        wrote: 0x80,
        read: 0,
    };
    assert_eq!(fault, Err(expected));
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
    let with = |divider| ImuConfig {
        divider,
        ..IMU_DEFAULT
    };
    let refused = Err(Refusal::ImuSettingOutOfRange);
    for model in [
        ImuModel::Unknown,
        ImuModel::Mpu6050,
        ImuModel::Mpu6500,
        ImuModel::Mpu9250,
    ] {
        assert_eq!(check(model, &with(199)), Ok(()));
        assert_eq!(check(model, &with(200)), refused);
    }
    // 1000, 500, 200, 100, 50 and 25 Hz.
    let rates = (0..=255).filter(|&n| check(ImuModel::Icm42688P, &with(n)).is_ok());
    assert_eq!(rates.collect::<Vec<_>>(), [0, 1, 4, 9, 19, 39]);
    assert_eq!(interval_ticks(&IMU_DEFAULT), 96_000);
    assert_eq!(interval_ms(&with(199)), 200);
}

#[test]
fn the_later_mpus_have_no_clock_input_and_a_filter_for_each_sensor() {
    let known = [
        (0x70, ImuModel::Mpu6500),
        (0x71, ImuModel::Mpu9250),
        (0x73, ImuModel::Mpu9250),
    ];
    for (identity, model) in known {
        let mut sensor = imu(Mock::with_identity(identity));
        let mut delay = Delay::default();
        let config = ImuConfig {
            low_pass: LowPass::Hz42,
            ..IMU_DEFAULT
        };
        now(sensor.set_up(&config, &mut delay)).unwrap();
        now(sensor.start(ImuClock::Internal, &mut delay)).unwrap();
        assert_eq!(sensor.model(), model);
        assert_eq!(model.clock_input(), None);
        let kept = &sensor.registers.bus.registers[0];
        assert_eq!(kept[0x19..=0x1D], [1, 3, 0x08, 0x08, 3]);
        assert_eq!((kept[0x6B], kept[0x37], kept[0x38]), (0x01, 0x10, 0x01));
    }
}

/// An ICM-42688-P after power-on, as far as its registers are not zero (data sheet,
/// chapters 14 to 16).
fn icm_mock() -> Mock {
    let mut mock = Mock::with_identity(0x47);
    for (bank, register, value) in [
        (0, 0x13, 0x05),
        (0, 0x4C, 0x30),
        (0, 0x4D, 0x91),
        (0, 0x4F, 0x06),
        (0, 0x50, 0x06),
        (0, 0x51, 0x16),
        (0, 0x52, 0x11),
        (0, 0x53, 0x0D),
        (0, 0x64, 0x10),
        (0, 0x65, 0x10),
        (1, 0x0B, 0xA0),
        (1, 0x7C, 0x5F),
        (2, 0x03, 0x30),
    ] {
        mock.registers[bank][register] = value;
    }
    mock
}

#[test]
fn an_icm_42688_p_is_set_up_with_both_sensors_off_and_then_started() {
    let mut sensor = imu(icm_mock());
    let mut delay = Delay::default();
    now(sensor.set_up(&IMU_DEFAULT, &mut delay)).unwrap();
    assert_eq!(sensor.model(), ImuModel::Icm42688P);
    let registers = |sensor: &Imu<Mock>| sensor.registers.bus.registers;
    assert_eq!(registers(&sensor)[0][0x4E], 0, "still off");
    let start = sensor.registers.bus.log.len();
    now(sensor.start(ImuClock::External, &mut delay)).unwrap();
    // Sensors on is the last thing written.
    let log = &sensor.registers.bus.log;
    assert_eq!(*log.last().unwrap(), (0x4E, 0x0F));
    assert!(log[..start].iter().all(|(register, _)| *register != 0x4E));
    let [zero, one, two] = registers(&sensor);
    // 500 Hz, 500 °/s, 4 g, second order at ODR/2; reserved bits as they were.
    assert_eq!(zero[0x4F..=0x53], [0x4F, 0x4F, 0x16, 0x00, 0x0D]);
    assert_eq!((zero[0x13], zero[0x14]), (0x09, 0x03));
    assert_eq!((zero[0x4C], zero[0x4D]), (0xB0, 0x95));
    assert_eq!((zero[0x64], zero[0x65], zero[0x76]), (0x00, 0x08, 0));
    assert_eq!((one[0x0B], one[0x7B], one[0x7C]), (0xA3, 0x04, 0x5C));
    assert_eq!(two[0x03], 0x31);
    // A millisecond for the reset, 200 µs for the start.
    assert!(delay.0 >= 1_200_000);

    let mut own = imu(icm_mock());
    now(own.set_up(&IMU_DEFAULT, &mut delay)).unwrap();
    now(own.start(ImuClock::Internal, &mut delay)).unwrap();
    assert_eq!(registers(&own)[0][0x4D], 0x91);
    assert_eq!(registers(&own)[1][0x7B], 0);
}

#[test]
fn an_icm_42688_p_that_was_left_in_another_bank_is_found() {
    for bank in [1, 2] {
        let mut mock = icm_mock();
        mock.registers[0][0x76] = bank;
        let mut sensor = imu(mock);
        set_up(&mut sensor, &IMU_DEFAULT).unwrap();
        assert_eq!(sensor.model(), ImuModel::Icm42688P);
    }
}

/// A rate that was taken while the sensor was not known, and that it does not have.
#[test]
fn a_setting_that_the_found_sensor_lacks_is_a_fault() {
    let mut sensor = imu(icm_mock());
    let config = ImuConfig {
        divider: 3,
        ..IMU_DEFAULT
    };
    assert_eq!(set_up(&mut sensor, &config), Err(ImuFault::NoSuchSetting));
}

/// The nearest filter, and its delay, as the data sheets have them.
#[test]
fn each_model_describes_itself() {
    let status = ImuStatus {
        state: ImuState::Running,
        clock: ImuClock::Internal,
        ..ImuStatus::default()
    };
    for (model, divider, low_pass, bandwidth, gyro_us, accel_us) in [
        (ImuModel::Mpu6050, 1, LowPass::Hz188, 1_880, 1_900, 2_000),
        (ImuModel::Mpu6500, 1, LowPass::Hz188, 1_840, 2_900, 5_800),
        (ImuModel::Mpu9250, 1, LowPass::Hz10, 100, 17_850, 16_830),
        (ImuModel::Icm42688P, 1, LowPass::Hz188, 2_467, 1_300, 1_300),
        (ImuModel::Icm42688P, 0, LowPass::Hz188, 1_916, 2_400, 2_400),
        (ImuModel::Icm42688P, 0, LowPass::Hz98, 971, 3_700, 3_700),
        (ImuModel::Icm42688P, 1, LowPass::Hz42, 485, 7_300, 7_300),
        (ImuModel::Icm42688P, 4, LowPass::Hz188, 987, 3_300, 3_300),
        (ImuModel::Icm42688P, 9, LowPass::Hz20, 192, 15_300, 15_300),
        (ImuModel::Icm42688P, 39, LowPass::Hz188, 123, 25_700, 25_700),
        (ImuModel::Icm42688P, 39, LowPass::Hz5, 85, 30_000, 30_000),
    ] {
        let config = ImuConfig {
            divider,
            low_pass,
            ..IMU_DEFAULT
        };
        let setup = describe(model, config, status);
        let found = (
            setup.sensor.model,
            setup.sensor.gyro_bandwidth_hz_times_10,
            setup.gyro_delay_us,
            setup.accel_delay_us,
        );
        assert_eq!(found, (model, bandwidth, gyro_us, accel_us));
        assert!(setup.sensor.gyro_noise_udps > 0 && setup.sensor.accel_noise_ug > 0);
    }
}
