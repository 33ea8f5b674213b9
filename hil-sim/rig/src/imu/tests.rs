mod behaviour;
mod families;
mod other_driver;

use super::config::DEGREES;
use super::mpu::PULSE;
use super::mpu::address::*;
use super::*;
use crate::clocks::oscillator::OscillatorConfig;
use crate::motion::MotionSpec;
use crate::motion::gesture::Gesture;
use crate::random::Stream;
use stm32f4_sim::i2c::Direction;
use stm32f4_sim::model_bench::ModelBench;
use stm32f4_sim::time::SimDuration;

/// A reference clock of 19.2 MHz on PA8 from power-on, the sensor awake on it
/// at 500 Hz, low-pass 1, interrupt as a pulse.
fn running(config: SimImuConfig, motion: Gesture) -> ModelBench<SimImu> {
    running_on(5, config, motion)
}

/// The same on the clock of another CLKSEL.
fn running_on(source: u8, config: SimImuConfig, motion: Gesture) -> ModelBench<SimImu> {
    let mut bench = asleep(config, motion);
    bench.set_clock(Pin::PA8, Some(Rate::hz(19_200_000)));
    bench.run(SimDuration::from_millis(20));
    write_all(
        &mut bench,
        &[
            (PWR_MGMT_1, source),
            (SMPLRT_DIV, 1),
            (CONFIG, 1),
            (INT_PIN_CFG, 0),
            (INT_ENABLE, 1),
        ],
    );
    bench
}

/// Writes registers, one after the other.
fn write_all(bench: &mut ModelBench<SimImu>, writes: &[(u8, u8)]) {
    for &(register, value) in writes {
        bench.write(ADDRESS, register, &[value]).unwrap();
    }
}

fn asleep(config: SimImuConfig, motion: Gesture) -> ModelBench<SimImu> {
    let seed = Seed(42);
    let motion = MotionSpec::always(motion).build(seed.stream(Stream::Motion));
    let board = BoardTime::new(
        OscillatorConfig {
            rate_ppm: 17.0,
            ..OscillatorConfig::default()
        },
        seed.stream(Stream::BoardClock),
    );
    ModelBench::new(SimImu::new(config, motion, board, seed))
}

fn intervals(times: &[SimTime]) -> Vec<u64> {
    times.windows(2).map(|w| (w[1] - w[0]).units()).collect()
}

/// Units of time in one tick of the board's 48 MHz timer.
const TICK: u64 = stm32f4_sim::time::UNITS_PER_SECOND / 48_000_000;

#[test]
fn registers_have_their_reset_values_and_keep_what_is_written() {
    let mut bench = asleep(SimImuConfig::ideal(), Gesture::Rest);
    bench.run(SimDuration::from_millis(11));
    // The address does not move on from FIFO_R_W.
    let mut all = bench.read(ADDRESS, 0, 0x75).unwrap();
    all.extend(bench.read(ADDRESS, WHO_AM_I, 1).unwrap());
    for (register, value) in all.into_iter().enumerate() {
        let expected = match register {
            0x6b => 0x40,
            0x75 => 0x68,
            _ => 0,
        };
        assert_eq!(value, expected, "register {register:#x}");
    }
    bench
        .write(ADDRESS, SMPLRT_DIV, &[7, 2, 0x08, 0x10])
        .unwrap();
    assert_eq!(
        bench.read(ADDRESS, SMPLRT_DIV, 4).unwrap(),
        [7, 2, 0x08, 0x10]
    );
    bench.write(ADDRESS, WHO_AM_I, &[1]).unwrap();
    bench.write(ADDRESS, ACCEL_XOUT_H, &[1]).unwrap();
    assert_eq!(bench.read(ADDRESS, WHO_AM_I, 1).unwrap(), [0x68]);
    assert_eq!(bench.read(ADDRESS, ACCEL_XOUT_H, 1).unwrap(), [0]);
    assert!(bench.model.unmodelled.is_empty());
}

#[test]
fn nothing_answers_before_the_start_up_time_nor_at_other_addresses() {
    let mut bench = asleep(SimImuConfig::ideal(), Gesture::Rest);
    assert_eq!(bench.read(ADDRESS, WHO_AM_I, 1), Err(0));
    bench.run_until(SimTime::from_nanos(11_000_000));
    assert_eq!(bench.read(0x69, WHO_AM_I, 1), Err(0));
    assert_eq!(bench.read(ADDRESS, WHO_AM_I, 1).unwrap(), [0x68]);
}

#[test]
fn a_sleeping_sensor_does_not_sample_and_wakes_after_30_ms() {
    let mut bench = asleep(SimImuConfig::ideal(), Gesture::Rest);
    bench.set_clock(Pin::PA8, Some(Rate::hz(19_200_000)));
    bench.run(SimDuration::from_secs(1));
    assert!(bench.model.log().is_empty());
    bench.write(ADDRESS, PWR_MGMT_1, &[5]).unwrap();
    let woke = bench.now;
    bench.run(SimDuration::from_millis(40));
    let first = bench.model.log().iter().next().unwrap().at;
    let after = (first - woke).as_nanos();
    assert!((30_000_000..31_100_000).contains(&after), "{after}");
    bench.write(ADDRESS, PWR_MGMT_1, &[0x45]).unwrap();
    bench.model.take_log();
    bench.run(SimDuration::from_millis(100));
    assert!(bench.model.log().is_empty());
}

#[test]
fn the_divider_and_the_reference_set_the_rate() {
    for (config, divider, hz, ticks) in [
        (1, 0, 19_200_000, 48_000),
        (1, 4, 19_200_000, 240_000),
        (6, 255, 19_200_000, 48_000 * 256),
        (0, 0, 19_200_000, 6_000),
        (0, 7, 19_200_000, 48_000),
        // A wrong reference within the lock range: 1 % fast, 1 % short.
        (1, 100, 19_392_000, 48_000 * 101 * 100 / 101),
    ] {
        let mut bench = running(SimImuConfig::ideal(), Gesture::Rest);
        bench.set_clock(Pin::PA8, Some(Rate::hz(hz)));
        bench
            .write(ADDRESS, SMPLRT_DIV, &[divider, config])
            .unwrap();
        bench.run(SimDuration::from_millis(300));
        bench.model.take_log();
        bench.run(SimDuration::from_secs(3));
        let times: Vec<_> = bench.model.log().iter().map(|r| r.at).collect();
        let intervals = intervals(&times);
        assert!(intervals.len() > 5);
        assert!(
            intervals.iter().all(|i| *i == ticks * TICK),
            "CONFIG {config}, SMPLRT_DIV {divider}, {hz} Hz: {}",
            intervals[0] / TICK
        );
    }
}

#[test]
fn without_a_usable_external_clock_there_is_no_data_ready() {
    for rate in [None, Some(Rate::hz(24_000_000)), Some(Rate::hz(8_000_000))] {
        let mut bench = running(SimImuConfig::ideal(), Gesture::Rest);
        bench.run(SimDuration::from_millis(100));
        bench.set_clock(Pin::PA8, rate);
        bench.driven.clear();
        bench.run(SimDuration::from_secs(1));
        assert!(bench.times(Pin::PA1, Drive::High).is_empty(), "{rate:?}");
        // Its own PLL gets it going again.
        bench.write(ADDRESS, PWR_MGMT_1, &[1]).unwrap();
        bench.run(SimDuration::from_secs(1));
        let n = bench.times(Pin::PA1, Drive::High).len();
        assert!((494..=496).contains(&n), "{n}");
    }
}

#[test]
fn the_own_clock_has_its_rate_error_in_true_time() {
    let config = SimImuConfig {
        own_clock: OscillatorConfig {
            rate_ppm: 5000.0,
            ..OscillatorConfig::default()
        },
        ..SimImuConfig::ideal()
    };
    let mut bench = running(config, Gesture::Rest);
    bench.write(ADDRESS, PWR_MGMT_1, &[1]).unwrap();
    bench.run(SimDuration::from_secs(1));
    bench.model.take_log();
    bench.run(SimDuration::from_secs(100));
    let times: Vec<_> = bench.model.log().iter().map(|r| r.at).collect();
    let mean = (times[times.len() - 1] - times[0]).as_secs_f64() / (times.len() - 1) as f64;
    // 500 Hz · (1 + 5000 ppm) in true time; the board counts 17 ppm more.
    let expected = 2e-3 * (1.0 + 17e-6) / (1.0 + 5e-3);
    assert!((mean / expected - 1.0).abs() < 1e-9, "{mean} {expected}");
}

#[test]
fn values_are_those_of_an_independent_calculation() {
    let mut bench = running(SimImuConfig::ideal(), Gesture::Twist);
    for (register, value) in [(GYRO_CONFIG, 0x08), (ACCEL_CONFIG, 0x08)] {
        bench.write(ADDRESS, register, &[value]).unwrap();
    }
    bench.run(SimDuration::from_millis(50));
    bench.model.take_log();
    bench.run(SimDuration::from_secs(5));
    let motion = MotionSpec::always(Gesture::Twist).build(Seed(42).stream(Stream::Motion));
    // The low-pass as an integral over a fine grid of an untruncated Gaussian.
    let filtered = |f: &dyn Fn(f64) -> [f64; 3], hz: f64, delay: f64, t: f64, axis: usize| {
        let sigma = (2.0f64.ln()).sqrt() / (core::f64::consts::TAU * hz);
        let (mut sum, mut norm) = (0.0, 0.0);
        for k in -300..=300 {
            let x = f64::from(k) * 0.02;
            let w = (-0.5 * x * x).exp();
            sum += w * f(t - delay + x * sigma)[axis];
            norm += w;
        }
        sum / norm
    };
    let mut largest = 0;
    for record in bench.model.log().iter().step_by(7) {
        let t = record.at.as_secs_f64() / (1.0 + 17e-6);
        for axis in 0..3 {
            let rate = filtered(&|t| motion.angular_rate(t), 188.0, 1.9e-3, t, axis);
            let counts = (rate.to_degrees() * 65.5).round();
            assert!((f64::from(record.values.gyro[axis]) - counts).abs() <= 1.0);
            largest = largest.max(record.values.gyro[axis].unsigned_abs());
            let force = filtered(&|t| motion.specific_force(t), 184.0, 2.0e-3, t, axis);
            let counts = (force / 9.80665 * 8192.0).round();
            assert!((f64::from(record.values.accel[axis]) - counts).abs() <= 1.0);
        }
        assert_eq!(record.values.temperature, 0);
    }
    assert!(largest > 8000, "the twist was seen: {largest}");
}

#[test]
fn a_typical_sensor_is_as_noisy_as_its_data_sheet_says() {
    let mut bench = running(SimImuConfig::typical(Seed(5)), Gesture::Rest);
    bench.write(ADDRESS, CONFIG, &[2]).unwrap(); // 98 Hz
    bench.run(SimDuration::from_secs(20));
    let n = bench.model.log().len() as f64;
    let (mut sum, mut squares) = (0.0, 0.0);
    for r in bench.model.log().iter() {
        let dps = f64::from(r.values.gyro[0]) / 131.0;
        sum += dps;
        squares += dps * dps;
    }
    let sd = (squares / n - (sum / n).powi(2)).sqrt();
    // Product specification, table 6.1: total RMS noise 0.06 °/s at DLPF 2.
    assert!((0.045..0.065).contains(&sd), "{sd}");
    assert!((sum / n).abs() < 2.5);
}
