//! The model of the MPU-6050 under a driver that others wrote.

use std::cell::RefCell;
use std::rc::Rc;

use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use mpu6050_dmp::accel::AccelFullScale;
use mpu6050_dmp::address::Address;
use mpu6050_dmp::clock_source::ClockSource;
use mpu6050_dmp::config::DigitalLowPassFilter;
use mpu6050_dmp::gyro::GyroFullScale;
use mpu6050_dmp::sensor::Mpu6050;

use super::*;

/// The bench as a bus and as a clock.
#[derive(Clone, Debug)]
struct Board(Rc<RefCell<ModelBench<SimImu>>>);

impl ErrorType for Board {
    type Error = ErrorKind;
}

impl I2c for Board {
    fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), ErrorKind> {
        let mut bench = self.0.borrow_mut();
        let result = match operations {
            [Operation::Write([register, values @ ..])] => bench.write(address, *register, values),
            [Operation::Write([register]), Operation::Read(into)] => bench
                .read(address, *register, into.len())
                .map(|bytes| into.copy_from_slice(&bytes)),
            other => panic!("{other:?}"),
        };
        result.map_err(|_| ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown))
    }
}

impl DelayNs for Board {
    fn delay_ns(&mut self, ns: u32) {
        let mut bench = self.0.borrow_mut();
        bench.run(SimDuration::from_nanos(ns.into()));
    }
}

#[test]
fn a_driver_that_others_wrote_reads_what_the_mpu_6050_measures() {
    let mut config = SimImuConfig::ideal().with_model(SensorModel::Mpu6050);
    config.temperature_c = 30.0;
    config.gyro.bias = [0.5, -1.5, 0.0];
    let mut board = Board(Rc::new(RefCell::new(asleep(config, Gesture::Rest))));
    board.delay_ms(20);
    let mut sensor = Mpu6050::new(board.clone(), Address::default()).unwrap();
    sensor.reset(&mut board).unwrap();
    sensor.disable_sleep().unwrap();
    sensor.set_clock_source(ClockSource::Xgyro).unwrap();
    sensor.set_gyro_full_scale(GyroFullScale::Deg500).unwrap();
    sensor.set_accel_full_scale(AccelFullScale::G4).unwrap();
    let filter = DigitalLowPassFilter::Filter1;
    sensor.set_digital_lowpass_filter(filter).unwrap();
    sensor.set_sample_rate_divider(1).unwrap();
    board.delay_ms(1_000);
    {
        // 500 Hz by its divider and filter.
        let bench = board.0.borrow();
        let samples = bench.model.log().len();
        assert!((480..500).contains(&samples), "{samples}");
        assert_eq!(bench.model.peek(GYRO_CONFIG), 0x08);
        assert_eq!(bench.model.peek(ACCEL_CONFIG), 0x08);
    }
    let (accel, gyro) = sensor.motion6().unwrap();
    let gyro = gyro.scaled(GyroFullScale::Deg500);
    for (read, is) in [gyro.x(), gyro.y(), gyro.z()]
        .into_iter()
        .zip([0.5, -1.5, 0.0])
    {
        let is = is * DEGREES;
        assert!((f64::from(read) - is).abs() < 0.02, "{read} for {is}");
    }
    let accel = accel.scaled(AccelFullScale::G4);
    assert!((accel.z() - 1.0).abs() < 0.001, "{accel:?}");
    let celsius = sensor.temperature().unwrap().celsius();
    assert!((f64::from(celsius) - 30.0).abs() < 0.02, "{celsius}");
}
