//! The sensors beside the MPU-9150.

use super::*;
use stm32f4_sim::pin::Level;

/// Awake on its own clock at 500 Hz, low-pass 1, with CLKIN at 19.2 MHz all the same.
fn mpu(model: SensorModel, config: SimImuConfig) -> ModelBench<SimImu> {
    running_on(1, config.with_model(model), Gesture::Rest)
}

#[test]
fn each_sensor_has_its_identity_and_wakes_as_its_map_says() {
    for (model, identity, power) in [
        (SensorModel::Mpu9150, 0x68, 0x40),
        (SensorModel::Mpu6050, 0x68, 0x40),
        (SensorModel::Mpu6500, 0x70, 0x01),
        (SensorModel::Mpu9250, 0x71, 0x01),
    ] {
        let mut bench = asleep(SimImuConfig::ideal().with_model(model), Gesture::Rest);
        bench.run(SimDuration::from_millis(11));
        assert_eq!(bench.read(ADDRESS, WHO_AM_I, 1).unwrap(), [identity]);
        assert_eq!(bench.read(ADDRESS, PWR_MGMT_1, 1).unwrap(), [power]);
        bench.run(SimDuration::from_secs(1));
        let samples = bench.model.log().len();
        assert_eq!(samples > 0, power == 0x01, "{model:?}");
    }
}

#[test]
fn the_later_mpus_ignore_a_clock_at_their_pin() {
    for model in [SensorModel::Mpu6500, SensorModel::Mpu9250] {
        let mut config = SimImuConfig::ideal();
        config.own_clock.rate_ppm = 9_000.0;
        let mut bench = mpu(model, config);
        bench.write(ADDRESS, PWR_MGMT_1, &[5]).unwrap();
        bench.run(SimDuration::from_secs(10));
        let samples: Vec<_> = bench.model.take_log();
        let (first, last) = (samples.first().unwrap().at, samples.last().unwrap().at);
        let rate = (samples.len() - 1) as f64 / (last - first).as_secs_f64();
        // 9,000 ppm of its own, against a board whose crystal is 17 ppm fast.
        let off = (rate / 500.0 - 1.0) * 1e6;
        assert!((off - 8_983.0).abs() < 20.0, "{model:?}: {off}");
    }
}

#[test]
fn thermometers_differ() {
    for (model, counts) in [
        (SensorModel::Mpu9150, 0),
        (SensorModel::Mpu6050, -520),
        (SensorModel::Mpu6500, 4_674),
        (SensorModel::Mpu9250, 4_674),
    ] {
        // At 35 °C.
        let mut bench = mpu(model, SimImuConfig::ideal());
        bench.run(SimDuration::from_millis(100));
        let values = bench.model.log().iter().last().unwrap().values;
        assert_eq!(values.temperature, counts, "{model:?}");
    }
}

const ICM: SensorModel = SensorModel::Icm42688P;

fn icm(config: SimImuConfig, writes: &[(u8, u8)]) -> ModelBench<SimImu> {
    let mut bench = asleep(config.with_model(ICM), Gesture::Rest);
    bench.run(SimDuration::from_millis(2));
    write_all(&mut bench, writes);
    bench
}

/// INT1 push-pull and high, a pulse of 100 µs; all values valid; 500 Hz, ±500 °/s, ±4 g;
/// second order at ODR/2.
const SET_UP: [(u8, u8); 7] = [
    (0x14, 0x03),
    (0x4c, 0xb0),
    (0x4f, 0x4f),
    (0x50, 0x4f),
    (0x52, 0x00),
    (0x64, 0x00),
    (0x65, 0x08),
];
/// Pin 9 is CLKIN, and the clock is there.
const CLKIN: [(u8, u8); 4] = [(0x76, 1), (0x7b, 0x04), (0x76, 0), (0x4d, 0x95)];
const ON: (u8, u8) = (0x4e, 0x0f);

/// Runs for a number of periods of a clock at PB0; `period_ns` is their length.
fn clocked(bench: &mut ModelBench<SimImu>, periods: u64, period_ns: u64) {
    for _ in 0..periods {
        bench.set_pin(Pin::PB0, Level::High);
        // The sensor does at once what is due.
        bench.run(SimDuration::from_nanos(period_ns / 2));
        bench.set_pin(Pin::PB0, Level::Low);
        bench.run(SimDuration::from_nanos(period_ns - period_ns / 2));
    }
}

#[test]
fn an_icm_42688_p_divides_the_edges_at_its_clock_pin() {
    let writes = [&SET_UP[..], &CLKIN, &[ON]].concat();
    let mut bench = icm(SimImuConfig::ideal(), &writes);
    clocked(&mut bench, 32_000, 31_250);
    let samples: Vec<_> = bench.model.take_log();
    assert!((480..=490).contains(&samples.len()), "{}", samples.len());
    let times: Vec<_> = samples.iter().map(|sample| sample.at).collect();
    assert!(intervals(&times).iter().all(|i| *i == 96_000 * TICK));
    let up = bench.times(Pin::PA1, Drive::High);
    assert_eq!(up, times);
    // Each ends after 100 µs, but perhaps the last.
    let down = bench.times(Pin::PA1, Drive::Low);
    let pulse = SimDuration::from_micros(100);
    let ends = up.iter().filter(|rise| down.contains(&(**rise + pulse)));
    assert!(ends.count() + 1 >= up.len());
    assert!(bench.model.unmodelled.is_empty());

    // At 40 kHz all is faster by 5/4 (12.5); at 25 kHz there is nothing.
    clocked(&mut bench, 4_000, 25_000);
    let faster = bench.model.take_log();
    let last: Vec<_> = faster
        .iter()
        .rev()
        .take(20)
        .map(|sample| sample.at)
        .rev()
        .collect();
    assert!(intervals(&last).iter().all(|i| *i == 76_800 * TICK));
    clocked(&mut bench, 4_000, 40_000);
    assert!(bench.model.take_log().len() <= 1);
}

#[test]
fn banks_reset_and_data_of_an_icm_42688_p() {
    let mut config = SimImuConfig::ideal();
    config.temperature_c = 45.0;
    // A fortieth of it (`SimImuConfig::of`).
    config.gyro.bias = [-4000.0, 4000.0, 4000.0 / DEGREES];
    let mut bench = icm(config, &[]);
    // Bank 0 and bank 1 at the same number; the identity is in bank 0 alone.
    assert_eq!(bench.read(ADDRESS, 0x75, 1).unwrap(), [0x47]);
    assert_eq!(bench.read(ADDRESS, 0x13, 1).unwrap(), [0x05]);
    bench.write(ADDRESS, 0x76, &[1]).unwrap();
    assert_eq!(bench.read(ADDRESS, 0x13, 1).unwrap(), [0x11]);
    assert_eq!(bench.read(ADDRESS, 0x75, 1).unwrap(), [0]);
    bench.write(ADDRESS, 0x76, &[0]).unwrap();
    assert_eq!(bench.read(ADDRESS, 0x1d, 2).unwrap(), [0x80, 0x00]);
    // Marks, not values, at the lower end.
    for (write, lowest) in [((0x4c, 0x30), -32_766), ((0x4c, 0xb0), -32_768)] {
        let writes = [&SET_UP[..], &[write, ON]].concat();
        bench.write(ADDRESS, 0x11, &[1]).unwrap();
        bench.run(SimDuration::from_millis(2));
        write_all(&mut bench, &writes);
        bench.run(SimDuration::from_millis(500));
        let bytes = bench.read(ADDRESS, 0x1d, 14).unwrap();
        let words: Vec<_> = bytes
            .chunks_exact(2)
            .map(|pair| i16::from_be_bytes([pair[0], pair[1]]))
            .collect();
        // (45 - 25) · 132.48; 1 g up; 100 · 65.5.
        assert_eq!(words[..4], [2_650, 0, 0, 8_192]);
        assert_eq!(words[4..], [lowest, 32_767, 6_550]);
    }
    // What must not be changed while the sensors are on is reported (12.9).
    assert!(bench.model.unmodelled.is_empty());
    bench.write(ADDRESS, 0x52, &[0x11]).unwrap();
    assert!(bench.model.unmodelled.contains(&0x52));
}
