//! The IMU of the real firmware on the simulated board, against the model of the
//! sensor: every sample's time and value, every fault.

use crate::board_host::UNITS_PER_TICK;
use crate::imu_bench::ImuBench;
use protocol::*;
use rig::imu::{Fault, SensorModel};
use rig::motion::gesture::Gesture;
use rig::motion::{Motion, MotionSpec};
use rig::random::{Seed, Stream};
use rig::wiring::{self, BoardKind};
use stm32f4_sim::pin::Pin;
use stm32f4_sim::shared::lock;
use stm32f4_sim::time::SimDuration;

/// One byte in ten with a spurious bus error: each sample comes, and is right.
#[test]
fn spurious_bus_errors_cost_no_sample() {
    let mut bench = ImuBench::on(
        wiring::board().chip(|chip| chip.bus_errors = 0.1),
        SensorModel::Mpu9150,
        Motion::rest(),
        &[],
    );
    bench.board.run(200);
    let before = (bench.status(), bench.board.rig.spurious_bus_errors());
    bench.check_samples();
    bench.board.run(2_000);
    let samples = bench.check_samples();
    assert!(samples.len() >= 990, "{}", samples.len());
    assert!(
        samples
            .windows(2)
            .all(|pair| pair[1].seq == pair[0].seq + 1)
    );
    let after = (bench.status(), bench.board.rig.spurious_bus_errors());
    assert!(after.1 > before.1 + 1_000, "{before:?} {after:?}");
    assert_eq!(after.0.recoveries, before.0.recoveries);
    assert_eq!((after.0.last_fault, after.0.late), (None, 0));
}

/// The registers of the chip that are stored and not modelled, and that the firmware
/// writes. A new one needs a look at the reason in the list of
/// [`stored_registers`](stm32f4_sim::sim::stored_registers): does it hold for what the
/// firmware wants of it?
#[test]
fn the_firmware_writes_no_other_plain_register() {
    let mut bench = ImuBench::at_rest();
    bench.board.run(500);
    let written: Vec<_> = bench.board.rig.stored_writes().into_iter().collect();
    let expected = [
        "DBGMCU_CR",
        "FLASH_ACR",
        "GPIOA_OSPEEDR",
        "GPIOB_OSPEEDR",
        "GPIOx_OSPEEDR",
        "I2C1_TRISE",
        "PWR_CR",
        "RCC_BDCR",
        "RCC_DCKCFGR",
    ];
    assert_eq!(written, expected);
}

/// Hand-held walking over a wrap of the 32-bit counter with the trigger at 30 fps: each sample
/// at its data-ready's tick and with its registers' values, 96,000 ticks apart every time.
#[test]
fn samples_are_exact_over_a_wrap_of_the_counter() {
    let walk = MotionSpec::always(Gesture::Walk);
    let mut bench = ImuBench::new(walk.build(Seed(7).stream(Stream::Motion)), &[]);
    // Until the host had opened the port.
    let dropped = bench.board.next_status().dropped;
    bench.check_samples();
    bench.board.run(100_000);
    let samples = bench.check_samples();
    assert!(samples.len() >= 49_990, "{}", samples.len());
    assert_eq!(samples.last().unwrap().at.0 >> 32, 1);
    for pair in samples.windows(2) {
        assert_eq!(pair[1].seq, pair[0].seq + 1);
        assert_eq!(pair[1].at - pair[0].at, TickDelta(96_000));
        assert!(!pair[1].flags.has(ImuFlags::LATE), "{:?}", pair[1]);
    }
    let status = bench.board.next_status();
    let imu = status.imu;
    assert_eq!((imu.late, imu.overcaptures, imu.recoveries), (0, 0, 0));
    assert_eq!((imu.state, imu.last_fault), (ImuState::Running, None));
    assert_eq!(imu.clock, ImuClock::External);
    assert_eq!(status.dropped, dropped);
}

/// A transfer that is not acknowledged, at each of its bytes, costs that sample
/// and no more.
#[test]
fn a_missing_acknowledge_costs_one_sample() {
    let mut bench = ImuBench::at_rest();
    bench.board.run(200);
    // Address, register, repeated address: what the sensor acknowledges.
    for byte in 0..3 {
        bench.check_samples();
        let before = bench.status();
        bench.fault(Fault::Nack { byte, times: 1 });
        bench.board.run(200);
        let samples = bench.check_samples();
        let gaps: Vec<_> = samples
            .windows(2)
            .filter(|pair| pair[1].seq != pair[0].seq + 1)
            .collect();
        assert_eq!(gaps.len(), 1, "byte {byte}");
        assert_eq!(gaps[0][1].seq, gaps[0][0].seq + 2);
        assert_eq!(gaps[0][1].at - gaps[0][0].at, TickDelta(2 * 96_000));
        assert!(gaps[0][1].flags.has(ImuFlags::AFTER_LOSS));
        let status = bench.status();
        assert_eq!(status.recoveries, before.recoveries);
        let register = mpu9150::ACCEL_XOUT_H;
        assert_eq!(
            status.last_fault,
            Some(ImuFault::NoAcknowledge { register })
        );
        assert_eq!(status.state, ImuState::Running);
    }
}

/// Runs `begin`, waits, runs `end`, and expects good samples within a second,
/// with the gap in the stream and the counters.
fn recovers(
    begin: &[Fault],
    ms: u64,
    end: &[Fault],
    expected: impl Fn(ImuFault) -> bool,
) -> ImuBench {
    let mut bench = ImuBench::at_rest();
    bench.board.run(300);
    bench.check_samples();
    let pulses = bench.board.trigger().pulses;
    let began = bench.board.rig.now();
    for &fault in begin {
        bench.fault(fault);
    }
    bench.board.run(ms);
    for &fault in end {
        bench.fault(fault);
    }
    bench.wait_for_good_samples(1_000);
    let samples = bench.check_samples();
    let status = bench.status();
    assert_eq!(status.state, ImuState::Running);
    assert!(status.recoveries >= 1, "{status:?}");
    let fault = status.last_fault.expect("the fault is reported");
    assert!(expected(fault), "{fault:?}");
    let longest = samples
        .windows(2)
        .map(|pair| pair[1].at - pair[0].at)
        .max()
        .unwrap();
    assert!(
        longest >= TickDelta(3 * 96_000),
        "the gap is visible: {longest}"
    );
    let first = samples
        .iter()
        .filter(|s| s.flags.has(ImuFlags::FIRST))
        .count();
    assert!(first >= 1, "the first sample after the gap is marked");
    // The trigger and the link went on untouched.
    let elapsed = (bench.board.rig.now().units() - began.units()) / UNITS_PER_TICK;
    let trigger = bench.board.trigger();
    assert_eq!(trigger.late, 0);
    let made = trigger.pulses - pulses;
    assert!(
        made.abs_diff(elapsed / 1_599_871) <= 2,
        "{made} pulses in {elapsed} ticks"
    );
    assert_eq!(
        bench.board.pulses.len() as u64,
        bench.board.pulses.last().unwrap().number + 1
    );
    bench
}

/// A sensor that holds SDA low as one that lost count of the clock: freeing the
/// bus costs a few samples at most, without setting the sensor up again.
#[test]
fn a_hung_sensor_is_freed_by_nine_clocks() {
    for clocks in 1..=9 {
        let mut bench = ImuBench::at_rest();
        bench.board.run(300);
        bench.check_samples();
        bench.fault(Fault::HoldSda(Some(clocks)));
        bench.board.run(500);
        let samples = bench.check_samples();
        let gap = samples.windows(2).map(|pair| pair[1].at - pair[0].at).max();
        let gap = gap.unwrap();
        assert!(
            (TickDelta(2 * 96_000)..=TickDelta(6 * 96_000)).contains(&gap),
            "{gap}"
        );
        let status = bench.status();
        assert_eq!((status.state, status.recoveries), (ImuState::Running, 0));
        assert!(status.last_fault.is_some());
    }
}

/// The bus is held, the power goes, another sensor answers, data-ready stays away, the clock's
/// wire breaks; and no acknowledge at any byte, for many transfers on end.
#[test]
fn faults_are_named_and_recovered() {
    use Fault::{ClockCut, DataReadyCut, HoldSda, Identity, PowerOff, PowerOn, ReleaseSda};
    type Row = (
        &'static [Fault],
        u64,
        &'static [Fault],
        fn(ImuFault) -> bool,
    );
    let no_acknowledge = |fault| matches!(fault, ImuFault::NoAcknowledge { .. });
    let no_data_ready = |fault| fault == ImuFault::NoDataReady;
    let other = |fault| fault == ImuFault::WrongIdentity { found: 0x12 };
    let rows: [Row; 4] = [
        (&[HoldSda(None)], 2_000, &[ReleaseSda], |fault| {
            fault == ImuFault::BusHeld
        }),
        (&[PowerOff], 3_000, &[PowerOn], no_acknowledge),
        (
            &[PowerOff, Identity(0x12), PowerOn],
            1_500,
            &[Identity(0x68)],
            other,
        ),
        (
            &[DataReadyCut(true)],
            1_000,
            &[DataReadyCut(false)],
            no_data_ready,
        ),
    ];
    for (begin, ms, end, expected) in rows {
        recovers(begin, ms, end, expected);
    }
    for byte in 0..3 {
        recovers(&[Fault::Nack { byte, times: 6 }], 300, &[], no_acknowledge);
    }
    // It goes on with its own clock.
    let mut bench = recovers(&[ClockCut(true)], 10, &[], no_data_ready);
    assert_eq!(bench.status().clock, ImuClock::Internal);
}

/// Every family is found by its identity, on both boards, and runs on the board's clock if it
/// takes one.
/// On any clock, each sample has the tick of its data-ready and the values of
/// its registers (`check_samples`): on the board's 96,000 ticks apart, on its own not.
#[test]
fn every_family_is_found_and_is_exact_in_time_on_any_clock() {
    let seed = Seed(7);
    let twist = MotionSpec::always(Gesture::Twist);
    let motion = twist.build(seed.stream(Stream::Motion));
    use BoardKind::{BlackPill, Discovery};
    for (board, model, found, takes_clock) in [
        (Discovery, SensorModel::Mpu9150, ImuModel::Mpu6050, true),
        (Discovery, SensorModel::Mpu6050, ImuModel::Mpu6050, true),
        (Discovery, SensorModel::Mpu6500, ImuModel::Mpu6500, false),
        (Discovery, SensorModel::Mpu9250, ImuModel::Mpu9250, false),
        (Discovery, SensorModel::Icm42688P, ImuModel::Icm42688P, true),
        (BlackPill, SensorModel::Mpu6050, ImuModel::Mpu6050, true),
        (BlackPill, SensorModel::Icm42688P, ImuModel::Icm42688P, true),
    ] {
        for wired in [true, false] {
            let cut = [Fault::ClockCut(true)];
            let faults = if wired { &[][..] } else { &cut };
            let builder = wiring::board_of(board, None);
            let mut bench = ImuBench::on(builder, model, motion.clone(), faults);
            bench.wait_for_good_samples(1_000);
            bench.check_samples();
            bench.board.run(1_000);
            let samples = bench.check_samples();
            let Ok(setup) = bench.board.ask(QueryImu) else {
                panic!("{model:?} does not answer");
            };
            let on_boards = takes_clock && wired;
            let clock = if on_boards {
                ImuClock::External
            } else {
                ImuClock::Internal
            };
            let said = (setup.sensor.model, setup.status.clock, setup.status.state);
            assert_eq!(said, (found, clock, ImuState::Running));
            assert_eq!((setup.status.late, setup.status.recoveries), (0, 0));
            let fault = setup.status.last_fault.is_some();
            assert_eq!(fault, takes_clock && !wired, "{setup:?}");
            assert!(samples.len() > 480, "{model:?}: {}", samples.len());
            for pair in samples.windows(2) {
                let interval = (pair[1].at - pair[0].at).0;
                assert_eq!(interval == 96_000, on_boards, "{model:?}: {interval}");
                assert!((94_000..=98_000).contains(&interval), "{interval}");
            }
            // With all waits that the manuals allow.
            let load = bench.board.next_status().cpu_permille;
            assert!(load < 150, "{model:?}: {load} of 1000");
            // The clock for an ICM-42688-P is there for that alone.
            let level = |bench: &ImuBench| bench.board.rig.level(Pin::PB0);
            let before = level(&bench);
            bench
                .board
                .rig
                .run_for(SimDuration::from_nanos(15_625))
                .unwrap();
            let toggles = level(&bench) != before;
            assert_eq!(toggles, model == SensorModel::Icm42688P);
        }
    }
}

/// An ICM-42688-P has six rates; all others are refused, and nothing has changed.
#[test]
fn settings_of_an_icm_42688_p_reach_it_or_are_refused() {
    let mut bench = ImuBench::with_sensor(SensorModel::Icm42688P, Motion::rest(), &[]);
    bench.wait_for_good_samples(1_000);
    let setting = |divider| ImuConfig {
        divider,
        low_pass: LowPass::Hz98,
        gyro_range: GyroRange::Dps1000,
        accel_range: AccelRange::G8,
    };
    let refused = Err(Refusal::ImuSettingOutOfRange);
    assert_eq!(bench.board.ask(ConfigureImu(setting(3))), refused);
    for (divider, interval) in [(0, 48_000), (9, 480_000)] {
        let Ok(setup) = bench.board.ask(ConfigureImu(setting(divider))) else {
            panic!("refused");
        };
        assert_eq!((setup.config, setup.interval), (setting(divider), interval));
        bench.board.run(500);
        bench.check_samples();
        bench.board.run(500);
        let samples = bench.check_samples();
        assert!(samples.len() as u64 >= 24_000_000 / u64::from(interval) - 2);
        for pair in samples.windows(2) {
            assert_eq!(pair[1].at - pair[0].at, TickDelta(i64::from(interval)));
        }
    }
}

/// A sensor that is lost in the middle of the switch to CLKIN's clock, every time: it
/// runs on its own, and the fault is reported.
#[test]
fn a_sensor_lost_at_its_external_clock_runs_on_its_own() {
    let mut bench = ImuBench::new(Motion::rest(), &[Fault::LostAtExternalClock(u32::MAX)]);
    bench.wait_for_good_samples(1_000);
    let status = bench.status();
    assert_eq!(status.clock, ImuClock::Internal);
    assert_eq!((status.state, status.recoveries), (ImuState::Running, 0));
    let register = mpu9150::PWR_MGMT_1;
    assert_eq!(
        status.last_fault,
        Some(ImuFault::NoAcknowledge { register })
    );
}

#[test]
fn settings_reach_the_sensor_and_are_reported() {
    let mut bench = ImuBench::at_rest();
    bench.board.run(300);
    for (divider, interval) in [(0, 48_000), (9, 480_000), (199, 9_600_000), (1, 96_000)] {
        let config = ImuConfig {
            divider,
            low_pass: LowPass::Hz42,
            gyro_range: GyroRange::Dps1000,
            accel_range: AccelRange::G8,
        };
        let Ok(setup) = bench.board.ask(ConfigureImu(config)) else {
            panic!("refused");
        };
        assert_eq!(setup.config, config);
        assert_eq!(setup.interval, interval);
        assert_eq!(setup.gyro_lsb_per_dps_times_10, 328);
        assert_eq!(setup.accel_lsb_per_g, 4_096);
        assert_eq!((setup.gyro_delay_us, setup.accel_delay_us), (4_800, 4_900));
        bench.board.run(1_000);
        bench.check_samples();
        bench.board.run(2_000);
        let samples = bench.check_samples();
        assert!(samples.len() as u64 >= 2 * 48_000_000 / u64::from(interval) - 2);
        for pair in samples.windows(2) {
            assert_eq!(pair[1].seq, pair[0].seq + 1);
            assert_eq!(pair[1].at - pair[0].at, TickDelta(i64::from(interval)));
        }
        let sensor = lock(&bench.sensor);
        assert_eq!(sensor.peek(mpu9150::SMPLRT_DIV), divider);
        assert_eq!(sensor.peek(mpu9150::CONFIG), 3);
        assert_eq!(sensor.peek(mpu9150::GYRO_CONFIG), 0x10);
        assert_eq!(sensor.peek(mpu9150::ACCEL_CONFIG), 0x10);
        drop(sensor);

        // Once more, as after an answer that came late: nothing is set up again.
        let again = bench.board.ask(ConfigureImu(config));
        assert_eq!(again.unwrap().status.state, ImuState::Running);
        bench.board.run(500);
        let later = bench.check_samples();
        assert!(later.iter().all(|s| s.flags == ImuFlags::default()));
        let seqs = samples.iter().chain(&later).map(|sample| sample.seq);
        assert!(seqs.is_sorted_by(|a, b| *b == a + 1));
    }
    let config = ImuConfig {
        divider: 200,
        low_pass: LowPass::Hz5,
        gyro_range: GyroRange::Dps250,
        accel_range: AccelRange::G2,
    };
    assert_eq!(
        bench.board.ask(ConfigureImu(config)),
        Err(Refusal::ImuSettingOutOfRange)
    );
}

/// At any phase of data-ready against the board's own work of each second: at 1 kHz a
/// sample has 0.6 ms beside its transfer.
#[test]
fn no_sample_is_late_at_any_phase_of_data_ready() {
    let mut bench = ImuBench::at_rest();
    bench.board.run(300);
    for tenth in 0..10 {
        let at_1_khz = ImuConfig {
            divider: 0,
            low_pass: LowPass::Hz42,
            // Another one each time: it is set up again.
            gyro_range: [GyroRange::Dps500, GyroRange::Dps1000][tenth % 2],
            accel_range: AccelRange::G4,
        };
        let shift = SimDuration::from_micros(100 * tenth as u64);
        bench.board.rig.run_for(shift).unwrap();
        bench.board.ask(ConfigureImu(at_1_khz)).unwrap();
        bench.board.run(500);
        bench.check_samples();
        let late = bench.status().late;
        bench.board.run(2_200);
        let samples = bench.check_samples();
        assert!(samples.len() >= 2_190, "{} at {tenth}", samples.len());
        assert!(
            samples.iter().all(|s| !s.flags.has(ImuFlags::LATE)),
            "{tenth}"
        );
        assert_eq!(bench.status().late, late, "{tenth}");
    }
}
