//! Data-ready, and the recovery from an unplugged SDA.

use crate::Received;
use crate::imu::{Scale, Summary, last_fault};
use protocol::{
    ImuClock, ImuModel, ImuSetup, ImuState, ImuStatus, MIN_PULSE_WIDTH, Output, QueryImu, Status,
    TickDelta,
};

use super::{BoardTest, HANDS_TIME, PERIOD, millis};
use crate::bring_up::train::{Extent, Trains};
use crate::bring_up::{BringUpError, IntervalHistogram, Prompt};

/// Time for which samples must come again without a break, at 500 a second.
const IMU_BACK: TickDelta = millis(1_000);

/// Most such stretches until that holds, after the wire was seen to be back.
const IMU_BACK_TRIES: u32 = 5;

impl BoardTest<'_> {
    pub(super) fn imu(&mut self) -> Result<(), BringUpError> {
        let setup = self.board.call(QueryImu)?;
        let scale = Scale::from_setup(&setup);
        let running = setup.status.state == ImuState::Running;
        let Some(scale) = scale.filter(|_| running) else {
            self.check(
                "data-ready",
                false,
                format!(
                    "the IMU is {:?}; {}",
                    setup.status.state,
                    last_fault(&setup)
                ),
                "samples",
                "the IMU's supply, SCL, SDA with their pull-ups, or INT at PA1",
            );
            return Ok(());
        };
        let received = self.receive_for(millis(10_000))?;
        let after = self.board.call(QueryImu)?;
        self.data_ready(&scale, &setup, &after, &received);
        let has_clock = after.status.clock == ImuClock::External;
        if has_clock {
            self.without_clock()?;
        }
        self.recovery(has_clock)
    }

    /// Checks that the sensor goes on with its own clock when the board's is unplugged.
    fn without_clock(&mut self) -> Result<(), BringUpError> {
        const NAME: &str = "IMU without its clock";
        const REASON: &str = "the sensor is not set up again on its own clock";
        let stopped = |h: &Received| {
            (h.statuses.last()).is_some_and(|s| s.imu.clock == ImuClock::Internal || !is_running(s))
        };
        let done = self.by_hand((NAME, REASON), Prompt::UnplugClock, stopped)?;
        if done.is_none() {
            return Ok(());
        }
        let (is_back, mut received) = self.comes_back()?;
        let clock = received.statuses.pop().map(|status| status.imu.clock);
        self.check(
            NAME,
            is_back && clock == Some(ImuClock::Internal),
            format!("samples {}, clock {clock:?}", back_text(is_back)),
            "samples for a second without a break, on the sensor's own clock",
            REASON,
        );
        (self.operator.say)(Prompt::PlugClockIn);
        Ok(())
    }

    /// Waits until samples come without a break. Returns true if they do. A wire that is being
    /// plugged in bounces, and the sensor fails once more.
    fn comes_back(&mut self) -> Result<(bool, Received), BringUpError> {
        let mut received = Received::default();
        for _ in 0..IMU_BACK_TRIES {
            let back = self.receive_for(IMU_BACK)?;
            let is_back = back.imu.len() > 400 && back.statuses.last().is_some_and(is_running);
            received.append(back);
            if is_back {
                return Ok((true, received));
            }
        }
        Ok((false, received))
    }

    fn data_ready(
        &mut self,
        scale: &Scale,
        before: &ImuSetup,
        after: &ImuSetup,
        received: &Received,
    ) {
        let mut summary = Summary::default();
        let mut intervals = Vec::new();
        let mut expected = None;
        for raw in &received.imu {
            if expected.is_some_and(|seq| seq != raw.seq) {
                summary.gap();
            }
            expected = Some(raw.seq.wrapping_add(1));
            intervals.extend(summary.add(&scale.apply(raw)));
        }
        self.intervals = histogram(&intervals);
        let report = summary.report();
        let nominal = f64::from(before.interval);
        let mean = report.interval_mean_ticks.unwrap_or(f64::NAN);
        let off_ppm = (mean / nominal - 1.0) * 1e6;
        let extent = report.interval_min_ticks.zip(report.interval_max_ticks);
        let extent = Extent(extent.map(|(least, most)| (least as i64, most as i64)));
        let external = after.status.clock == ImuClock::External;
        // On the board's clock the sensor divides the board's own crystal.
        let most_ppm = match after.sensor.model {
            _ if external => 10.0,
            // ±1.5 %, and ±2 % over its temperatures (data sheet, 3.3.2).
            ImuModel::Icm42688P => 35_000.0,
            _ => 15_000.0,
        };
        const CLOCK: &str = "the wire to CLKIN (PA8, or PB0 for an ICM-42688-P); clones of the MPU \
                             family may have no such input. Times of samples are exact without it";
        let rate = format!(
            "{off_ppm:+.1} ppm from nominal, {:?} clock; intervals {extent}",
            after.status.clock
        );
        let is_near = off_ppm.abs() <= most_ppm;
        if external || is_near {
            let limit = format!("{most_ppm} ppm on this clock");
            self.check("sample rate", is_near, rate, limit, CLOCK);
        } else {
            self.skip("sample rate", &rate, CLOCK);
        }
        if external {
            let text = String::from("the board's");
            self.check("clock of the IMU", true, text, "the board's", CLOCK);
        } else {
            self.skip("clock of the IMU", "the sensor's own", CLOCK);
        }
        let counted = |status: &ImuStatus| u64::from(status.overcaptures) + u64::from(status.late);
        let lost = received.lost + counted(&after.status).saturating_sub(counted(&before.status));
        let gaps = intervals
            .iter()
            .filter(|&&i| i as f64 > 1.5 * nominal)
            .count();
        self.check(
            "data-ready",
            lost == 0 && gaps == 0 && !intervals.is_empty(),
            format!(
                "{} samples, {lost} lost or late, {gaps} gaps",
                received.imu.len()
            ),
            "none lost, late or missing",
            "a handler that comes too late, or a loose wire at PA1",
        );
    }

    /// Checks the recovery from an unplugged SDA while the trigger runs.
    fn recovery(&mut self, has_clock: bool) -> Result<(), BringUpError> {
        const NAME: &str = "recovery of the IMU";
        const REASON: &str = "the I2C bus is not freed, or the sensor is not set up again";
        let grid = self.start(Output::Camera, PERIOD, MIN_PULSE_WIDTH)?;
        let failed = |h: &Received| h.statuses.last().is_some_and(|status| !is_running(status));
        let done = self.by_hand((NAME, REASON), Prompt::UnplugSda, failed)?;
        let Some((mut received, _)) = done else {
            return self.stop(Output::Camera).map(drop);
        };
        (self.operator.say)(Prompt::PlugSdaIn);
        received.append(self.receive_until(HANDS_TIME, |h| h.imu.len() > 1)?);
        let (is_back, back) = self.comes_back()?;
        let clock = back.statuses.last().map(|status| status.imu.clock);
        let is_on_clock = !has_clock || clock == Some(ImuClock::External);
        received.append(back);
        received.append(self.stop(Output::Camera)?);
        self.check(
            NAME,
            is_back && is_on_clock,
            format!("samples {}, clock {clock:?}", back_text(is_back)),
            "samples for a second without a break, within five of the plug, on the clock of before",
            REASON,
        );
        let mut trains = Trains::default();
        trains.compare(&grid, &received.pulses);
        trains.find(&received.pulses, MIN_PULSE_WIDTH, &[]);
        self.check(
            "trigger beside a failed IMU",
            trains.grid_error.within(0, 0) && trains.is_read_back(),
            format!(
                "{}; {} of them read back, {} later",
                trains.on_grid_text(),
                trains.read_back,
                trains.read_back_delay
            ),
            "0 ticks off, each read back on PA3 after one constant",
            "the recovery of the bus keeps the trigger's handler from running",
        );
        Ok(())
    }
}

fn is_running(status: &Status) -> bool {
    status.imu.state == ImuState::Running
}

const fn back_text(is_back: bool) -> &'static str {
    if is_back {
        "came again by themselves"
    } else {
        "did not come again steadily"
    }
}

/// At most 60 bins.
fn histogram(intervals: &[u64]) -> IntervalHistogram {
    let (Some(&first), Some(&last)) = (intervals.iter().min(), intervals.iter().max()) else {
        return IntervalHistogram::default();
    };
    let bin = (last - first) / 60 + 1;
    let mut counts = vec![0; ((last - first) / bin + 1) as usize];
    for interval in intervals {
        if let Some(count) = counts.get_mut(((interval - first) / bin) as usize) {
            *count += 1;
        }
    }
    IntervalHistogram { first, bin, counts }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_interval_is_in_one_of_few_bins() {
        let all: Vec<u64> = (96_000..97_000).chain([200_000]).collect();
        let histogram = histogram(&all);
        assert!(histogram.counts.len() <= 61);
        assert_eq!(histogram.counts.iter().sum::<u64>(), all.len() as u64);
        assert_eq!(histogram.first, 96_000);
        assert_eq!(super::histogram(&[5, 5]).counts, [2]);
        assert_eq!(super::histogram(&[]), IntervalHistogram::default());
    }
}
