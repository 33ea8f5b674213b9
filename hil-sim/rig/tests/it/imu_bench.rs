//! A board with an IMU for tests, whose samples are held against what the sensor measured.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::board_host::{Board, UNITS_PER_TICK};
use protocol::*;
use rig::clocks::oscillator::{BoardTime, OscillatorConfig};
use rig::imu::{Fault, SampleRecord, SensorModel, SimImu, SimImuConfig};
use rig::motion::Motion;
use rig::random::{Seed, Stream};
use rig::wiring;
use stm32f4_sim::shared::{Shared, lock};
use stm32f4_sim::sim::{INPUT_SYNCHRONISER, SimBuilder};
use stm32f4_sim::time::{SimDuration, SimTime};

/// A board with a sensor, and the time of tick 0.
pub(crate) struct ImuBench {
    pub(crate) board: Board,
    pub(crate) sensor: Shared<SimImu>,
    zero: u64,
    /// Measurements with which no sample was compared yet.
    records: VecDeque<SampleRecord>,
}

impl ImuBench {
    /// Boots with a sensor that sees `motion` and has these `faults` from the start.
    pub(crate) fn new(motion: Arc<Motion>, faults: &[Fault]) -> Self {
        Self::on(wiring::board(), SensorModel::Mpu9150, motion, faults)
    }

    /// The same with another sensor.
    pub(crate) fn with_sensor(model: SensorModel, motion: Arc<Motion>, faults: &[Fault]) -> Self {
        Self::on(wiring::board(), model, motion, faults)
    }

    /// The same on this board.
    pub(crate) fn on(
        builder: SimBuilder,
        model: SensorModel,
        motion: Arc<Motion>,
        faults: &[Fault],
    ) -> Self {
        let seed = Seed(7);
        let board_time =
            BoardTime::new(OscillatorConfig::default(), seed.stream(Stream::BoardClock));
        let config = SimImuConfig::typical(seed).with_model(model);
        let mut sensor = SimImu::new(config, motion, board_time, seed);
        for &fault in faults {
            sensor.schedule(SimTime::ZERO, fault);
        }
        let sensor = sensor.shared();
        let builder = builder.model(sensor.clone()).i2c_target(sensor.clone());
        let mut board = Board::boot_with_train(builder, 576);
        board.run(100);
        let zero = board.zero();
        Self {
            board,
            sensor,
            zero,
            records: VecDeque::new(),
        }
    }

    pub(crate) fn at_rest() -> Self {
        Self::new(Motion::rest(), &[])
    }

    /// Makes a fault happen within some virtual milliseconds, between two
    /// transfers: 1.5 ms after a data-ready. (In the middle of one it may damage
    /// a byte unnoticed: the bus has no checksum.)
    pub(crate) fn fault(&mut self, fault: Fault) {
        self.board.run(4);
        let soon = (self.board.rig.now() + SimDuration::from_millis(1)).units();
        let edge = lock(&self.sensor)
            .log()
            .iter()
            .last()
            .map(|record| record.at);
        let interval = SimDuration::from_millis(2).units();
        let at = edge.map_or(soon, |edge| {
            let first = (edge + SimDuration::from_micros(1_500)).units();
            first + soon.saturating_sub(first).div_ceil(interval) * interval
        });
        let at = SimTime::from_units(at);
        lock(&self.sensor).schedule(at, fault);
        self.board.rig.models_changed();
    }

    /// The tick at which an edge at `at` is captured: after the synchroniser. The filter
    /// is taken off by the firmware.
    fn tick_of(&self, at: SimTime) -> Ticks {
        Ticks((at.units() - self.zero) / UNITS_PER_TICK + INPUT_SYNCHRONISER)
    }

    /// Checks all samples so far against what the sensor put into its registers,
    /// and forgets them. Samples may be missing, but none may be wrong.
    pub(crate) fn check_samples(&mut self) -> Vec<ImuSample> {
        self.records.extend(lock(&self.sensor).take_log());
        let samples = std::mem::take(&mut self.board.imu);
        for sample in &samples {
            let record = loop {
                let record = self.records.pop_front();
                let record = record.unwrap_or_else(|| panic!("no data-ready at {sample:?}"));
                if self.tick_of(record.at) == sample.at {
                    break record;
                }
            };
            let values = record.values;
            let read = (sample.accel, sample.temperature, sample.gyro);
            if !sample.flags.has(ImuFlags::LATE) {
                assert_eq!(read, (values.accel, values.temperature, values.gyro));
            }
        }
        samples
    }

    /// Waits until samples come without a gap for 50 ms; fails after `ms`.
    pub(crate) fn wait_for_good_samples(&mut self, ms: u64) {
        let mut good_from = None;
        let begin = self.board.rig.now();
        loop {
            let before = self.board.imu.len();
            self.board.run(10);
            let waited = (self.board.rig.now().units() - begin.units())
                / SimDuration::from_millis(1).units();
            if self.board.imu.len() >= before + 4 {
                let from = *good_from.get_or_insert(waited);
                if waited >= from + 50 {
                    return;
                }
            } else {
                good_from = None;
            }
            assert!(
                waited < ms + 60,
                "no good samples within {ms} ms: {:?}",
                self.board.statuses.last().map(|status| status.imu)
            );
        }
    }

    pub(crate) fn status(&mut self) -> ImuStatus {
        match self.board.ask(QueryImu) {
            Ok(setup) => setup.status,
            other => panic!("{other:?}"),
        }
    }
}

/// Checked at the end of every test.
impl Drop for ImuBench {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            let ignored = lock(&self.sensor).unmodelled.clone();
            assert!(
                ignored.is_empty(),
                "the firmware gave registers {ignored:02x?} values that the model ignores"
            );
        }
    }
}
