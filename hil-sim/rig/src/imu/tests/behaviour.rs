//! The bus, the interrupt pin, switches and faults.

use super::*;

#[test]
fn a_sample_during_a_transaction_shows_after_its_stop() {
    let mut bench = running(SimImuConfig::ideal(), Gesture::Twist);
    bench.run(SimDuration::from_secs(2));
    bench.start(ADDRESS, Direction::Write);
    bench.write_byte(ACCEL_XOUT_H);
    let before = bench.model.peek(GYRO_ZOUT_L);
    let old: Vec<u8> = (ACCEL_XOUT_H..=GYRO_ZOUT_L)
        .map(|r| bench.model.peek(r))
        .collect();
    bench.run(SimDuration::from_millis(10));
    assert_eq!(bench.model.peek(GYRO_ZOUT_L), before);
    let newest = bench.model.log().iter().last().unwrap().values.bytes();
    assert_ne!(old[..], newest);
    bench.stop();
    let now: Vec<u8> = (ACCEL_XOUT_H..=GYRO_ZOUT_L)
        .map(|r| bench.model.peek(r))
        .collect();
    assert_eq!(now[..], newest);
}

#[test]
fn the_interrupt_pin_follows_its_configuration() {
    // (INT_PIN_CFG, idle, asserted)
    for (config, idle, asserted) in [
        (0x00, Drive::Low, Drive::High),
        (0x80, Drive::High, Drive::Low),
        (0x40, Drive::Low, Drive::Floating),
        (0xc0, Drive::Floating, Drive::Low),
    ] {
        let mut bench = running(SimImuConfig::ideal(), Gesture::Rest);
        bench.write(ADDRESS, INT_PIN_CFG, &[config]).unwrap();
        bench.run(SimDuration::from_millis(100));
        bench.driven.clear();
        bench.run(SimDuration::from_millis(100));
        let up = bench.times(Pin::PA1, asserted);
        let down = bench.times(Pin::PA1, idle);
        assert_eq!(up.len(), 50, "{config:#x}");
        assert!(up.iter().zip(&down).all(|(u, d)| *d - *u == PULSE));
    }
}

#[test]
fn a_latched_interrupt_stays_until_it_is_cleared() {
    // Only by INT_STATUS.
    let mut bench = running(SimImuConfig::ideal(), Gesture::Rest);
    bench.write(ADDRESS, INT_PIN_CFG, &[0x20]).unwrap();
    bench.run(SimDuration::from_millis(100));
    assert_eq!(bench.times(Pin::PA1, Drive::High).len(), 1);
    bench.read(ADDRESS, ACCEL_XOUT_H, 14).unwrap();
    assert_eq!(bench.driven.last().unwrap().2, Drive::High);
    assert_eq!(bench.read(ADDRESS, INT_STATUS, 1).unwrap(), [1]);
    assert_eq!(bench.driven.last().unwrap().2, Drive::Low);
    assert_eq!(bench.read(ADDRESS, INT_STATUS, 1).unwrap(), [0]);
    // By any read.
    bench.write(ADDRESS, INT_PIN_CFG, &[0x30]).unwrap();
    bench.run(SimDuration::from_millis(3));
    assert_eq!(bench.driven.last().unwrap().2, Drive::High);
    bench.read(ADDRESS, WHO_AM_I, 1).unwrap();
    assert_eq!(bench.driven.last().unwrap().2, Drive::Low);
    // Samples that came while it was latched made no edge, and the log says so.
    let (with, without): (Vec<SampleRecord>, Vec<SampleRecord>) =
        bench.model.log().iter().copied().partition(|r| r.edge);
    assert!(without.len() > 30, "{} {}", with.len(), without.len());
    assert_eq!(with.len(), bench.times(Pin::PA1, Drive::High).len());
    // Disabled: no edge at all.
    bench.write(ADDRESS, INT_ENABLE, &[0]).unwrap();
    bench.run(SimDuration::from_millis(1));
    bench.driven.clear();
    bench.run(SimDuration::from_millis(20));
    assert!(bench.driven.is_empty());
}

#[test]
fn full_scales_change_counts_and_saturate() {
    let mut config = SimImuConfig::ideal();
    config.gyro.bias = [7.0, -7.0, 0.5];
    let mut counts = Vec::new();
    for setting in [0x00, 0x08, 0x10, 0x18] {
        let mut bench = running(config, Gesture::Rest);
        bench
            .write(ADDRESS, GYRO_CONFIG, &[setting, setting])
            .unwrap();
        bench.run(SimDuration::from_millis(100));
        let v = bench.model.log().iter().last().unwrap().values;
        counts.push((v.gyro, v.accel[2]));
    }
    // 7 rad/s = 401.07 °/s; 0.5 rad/s = 28.648 °/s.
    assert_eq!(
        counts,
        [
            ([32767, -32768, 3753], 16384),
            ([26270, -26270, 1876], 8192),
            ([13155, -13155, 940], 4096),
            ([6578, -6578, 470], 2048),
        ]
    );
}

#[test]
fn standby_and_temperature_switches_hold_values() {
    let mut config = SimImuConfig::ideal();
    config.temperature_c = 20.0;
    config.self_heating_c = 10.0;
    config.warm_up_s = 1.0;
    let mut bench = running(config, Gesture::Twist);
    bench.run(SimDuration::from_secs(3));
    let warm = bench.model.log().iter().last().unwrap().values.temperature;
    // 20 + 10 · (1 - e^-3.02) °C.
    assert!(
        (f64::from(warm) / 340.0 + 35.0 - 29.51).abs() < 0.02,
        "{warm}"
    );
    bench.write(ADDRESS, PWR_MGMT_1, &[0x0d, 0x24]).unwrap(); // TEMP_DIS, x axes
    let held = bench.model.log().iter().last().unwrap().values;
    bench.model.take_log();
    bench.run(SimDuration::from_secs(1));
    for r in bench.model.log().iter() {
        assert_eq!(r.values.temperature, held.temperature);
        assert_eq!(r.values.gyro[0], held.gyro[0]);
        assert_eq!(r.values.accel[0], held.accel[0]);
    }
    assert!(
        bench
            .model
            .log()
            .iter()
            .any(|r| r.values.gyro[1] != held.gyro[1])
    );
}

#[test]
fn a_device_reset_forgets_everything() {
    let mut bench = running(SimImuConfig::ideal(), Gesture::Twist);
    bench.run(SimDuration::from_secs(1));
    bench.write(ADDRESS, PWR_MGMT_1, &[0x80]).unwrap();
    assert_eq!(bench.read(ADDRESS, WHO_AM_I, 1), Err(0));
    bench.driven.clear();
    bench.run(SimDuration::from_millis(100));
    assert_eq!(bench.read(ADDRESS, PWR_MGMT_1, 1).unwrap(), [0x40]);
    assert_eq!(bench.read(ADDRESS, SMPLRT_DIV, 2).unwrap(), [0, 0]);
    assert_eq!(bench.read(ADDRESS, ACCEL_XOUT_H, 14).unwrap(), [0; 14]);
    assert!(bench.times(Pin::PA1, Drive::High).is_empty());
}

#[test]
fn ignored_settings_are_named() {
    let mut bench = running(SimImuConfig::ideal(), Gesture::Rest);
    assert!(bench.model.unmodelled.is_empty());
    bench.write(ADDRESS, 0x23, &[0x78]).unwrap(); // FIFO_EN
    bench.write(ADDRESS, GYRO_CONFIG, &[0xe0]).unwrap(); // self-test
    assert_eq!(
        bench.model.unmodelled.iter().copied().collect::<Vec<_>>(),
        [GYRO_CONFIG, 0x23]
    );
}
