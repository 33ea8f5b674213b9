//! The ground truth of a run: what the models noted while it lasted.

use crate::clocks::oscillator::Oscillator;
use crate::depth_camera::FrameRecord;
use crate::imu::SampleRecord;
use crate::phone::VideoTruth;
use crate::whole_rig::config::RigParts;
use crate::wiring;
use stm32f4_sim::shared::lock;
use stm32f4_sim::sim::Sim;
use stm32f4_sim::time::SimTime;

/// Until when the count's zero is read off: before its first wrap.
const FIRST_WRAP: SimTime = SimTime::from_nanos(60_000_000_000);

/// The ground truth of a run.
#[derive(Clone, Debug)]
pub struct RunTruth {
    /// Parts and their clocks.
    pub parts: RigParts,
    /// All frames of the depth camera, in order.
    pub depth: Vec<FrameRecord>,
    /// All samples of the board's IMU as they were in its registers, in order
    /// (48 bytes each: 86 MB an hour at 500 Hz).
    pub imu: Vec<SampleRecord>,
    /// Board time at which the tick count was zero in the board's first run.
    pub zero: Option<SimTime>,
    /// Clocks and videos of the phones, the one that the trigger is aligned to first.
    pub phones: Vec<(Oscillator, Vec<VideoTruth>)>,
    /// Board time at the end.
    pub end: SimTime,
}

/// The records so far.
#[derive(Debug, Default)]
pub(crate) struct Noted {
    depth: Vec<FrameRecord>,
    imu: Vec<SampleRecord>,
    zero: Option<SimTime>,
    was_reset: bool,
}

impl Noted {
    /// Collects the records of the models, so that these stay small.
    pub(crate) fn take(&mut self, board: &Sim, parts: &RigParts) {
        if board.now() < FIRST_WRAP && !self.was_reset && board.failures().is_empty() {
            self.zero = zero_of(board);
        }
        if let Some(camera) = &parts.depth_camera {
            self.depth.extend(lock(camera).take_frames());
        }
        if let Some(imu) = &parts.imu {
            self.imu.extend(lock(imu).take_log());
        }
    }

    /// Discards frames and samples.
    pub(crate) fn forget(&mut self) {
        (self.depth, self.imu) = (Vec::new(), Vec::new());
    }

    /// Returns the board's tick count at a board time; `None` after a reset, and before the count
    /// was observed.
    pub(crate) fn ticks(&self, at: SimTime) -> Option<u64> {
        let zero = self.zero.filter(|_| !self.was_reset)?;
        Some(at.units().checked_sub(zero.units())? / wiring::UNITS_PER_TICK)
    }

    /// Notes a reset of the board, which restarts its count.
    pub(crate) fn was_reset(&mut self) {
        self.was_reset = true;
    }

    /// Returns the frames of the depth camera so far.
    pub(crate) fn depth(&self) -> &[FrameRecord] {
        &self.depth
    }

    /// Together with the clocks and videos of the phones, and the time at the end.
    pub(crate) fn into_truth(
        self,
        parts: RigParts,
        phones: Vec<(Oscillator, Vec<VideoTruth>)>,
        end: SimTime,
    ) -> RunTruth {
        RunTruth {
            parts,
            depth: self.depth,
            imu: self.imu,
            zero: self.zero,
            phones,
            end,
        }
    }
}

/// When the board's tick count was zero, once the timer runs: its count now,
/// taken off. Right only before the count's first wrap, after 89 s.
pub(crate) fn zero_of(rig: &Sim) -> Option<SimTime> {
    let (at, count) = rig.timer(wiring::TIMEBASE);
    let units = u64::from(count) * wiring::UNITS_PER_TICK;
    (count > 0)
        .then(|| at.units().checked_sub(units))
        .flatten()
        .map(SimTime::from_units)
}
