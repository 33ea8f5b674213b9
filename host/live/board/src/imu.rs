//! The board's IMU samples in SI units, and the rate, jitter and noise of a stretch of them.
//!
//! Samples keep the time of their data-ready edge: the delay of the sensor's
//! low-pass is *not* subtracted here ([`Scale::gyro_delay_us`]).

use protocol::{
    AccelRange, GyroRange, ImuFault, ImuFlags, ImuModel, ImuSample, ImuSetup, LowPass, TICK_HZ,
    Ticks,
};
use serde::{Deserialize, Serialize};

/// Standard gravity, m/s².
pub const STANDARD_GRAVITY: f64 = 9.806_65;

/// Conversion from counts to SI units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scale {
    /// rad/s of one count of the gyroscope.
    pub gyro_rad_s: f64,
    /// m/s² of one count of the accelerometer.
    pub accel_m_s2: f64,
    /// Delay of the gyroscope's low-pass, µs.
    pub gyro_delay_us: u32,
    /// Delay of the accelerometer's low-pass, µs.
    pub accel_delay_us: u32,
    /// °C of one count of the thermometer.
    pub temperature_c: f64,
    /// °C at a count of zero.
    pub temperature_zero_c: f64,
}

/// Bandwidths of the gyroscope's low-pass, Hz.
pub const LOW_PASSES: [(u32, LowPass); 6] = [
    (188, LowPass::Hz188),
    (98, LowPass::Hz98),
    (42, LowPass::Hz42),
    (20, LowPass::Hz20),
    (10, LowPass::Hz10),
    (5, LowPass::Hz5),
];

/// Full scales of the gyroscope, °/s.
pub const GYRO_RANGES: [(u32, GyroRange); 4] = [
    (250, GyroRange::Dps250),
    (500, GyroRange::Dps500),
    (1_000, GyroRange::Dps1000),
    (2_000, GyroRange::Dps2000),
];

/// Full scales of the accelerometer, g.
pub const ACCEL_RANGES: [(u32, AccelRange); 4] = [
    (2, AccelRange::G2),
    (4, AccelRange::G4),
    (8, AccelRange::G8),
    (16, AccelRange::G16),
];

/// Returns the setting for a number.
///
/// # Errors
///
/// No setting has this number; the text lists the numbers.
pub fn setting<T: Copy>(number: u32, settings: &[(u32, T)]) -> Result<T, String> {
    let known = settings.iter().find(|(known, _)| *known == number);
    known.map(|(_, setting)| *setting).ok_or_else(|| {
        let numbers = settings.iter().map(|(known, _)| known.to_string());
        let mut numbers: Vec<String> = numbers.collect();
        let last = numbers.pop().unwrap_or_default();
        format!("{} or {last}", numbers.join(", "))
    })
}

fn number_of<T: PartialEq>(setting: T, settings: &[(u32, T)]) -> u32 {
    let known = settings.iter().find(|(_, known)| *known == setting);
    known.map_or(0, |(number, _)| *number)
}

/// Returns the sensor and its setup in words, with the figures of its data sheet.
#[must_use]
pub fn describe(setup: &ImuSetup) -> String {
    let sensor = &setup.sensor;
    let name = sensor.model.name();
    if sensor.model == ImuModel::Unknown {
        return name.to_owned();
    }
    let rate = number_of(setup.config.gyro_range, &GYRO_RANGES);
    let force = number_of(setup.config.accel_range, &ACCEL_RANGES);
    format!(
        "{name}, ±{rate} °/s, ±{force} g, low-pass {} Hz with a delay of {} ms, noise {} m°/s/√Hz \
         and {} µg/√Hz",
        f64::from(sensor.gyro_bandwidth_hz_times_10) / 10.0,
        f64::from(setup.gyro_delay_us) / 1e3,
        f64::from(sensor.gyro_noise_udps) / 1e3,
        sensor.accel_noise_ug
    )
}

/// Returns the last fault of the sensor in words.
#[must_use]
pub fn last_fault(setup: &ImuSetup) -> String {
    setup.status.last_fault.map_or_else(
        || String::from("no fault is noted"),
        |fault| match fault {
            ImuFault::WrongIdentity { found } => format!(
                "last fault: the sensor's identity (WHO_AM_I) is {found:#04x}{}; the board knows \
                 0x68 (MPU-6050, MPU-9150), 0x70 (MPU-6500), 0x71 (MPU-9250), 0x73 (MPU-9255) and \
                 0x47 (ICM-42688-P)",
                relative(found)
            ),
            fault => format!("last fault: {fault:?}"),
        },
    )
}

/// Sensors that are sold in place of the supported ones, by WHO_AM_I.
fn relative(identity: u8) -> &'static str {
    match identity {
        0x72 => ", as clones of the MPU-6050 have it, whose registers differ",
        0x74 => ", which is an MPU-6515",
        0x98 => ", which is an ICM-20689 or a clone of the MPU-6050 made of one",
        0x00 | 0xff => ", which no sensor has: is it powered, and are SDA and SCL wired?",
        _ => "",
    }
}

/// One sample in SI units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Data-ready edge.
    pub at: Ticks,
    /// Flags of the board.
    pub flags: ImuFlags,
    /// Angular rate, rad/s.
    pub gyro: [f64; 3],
    /// Acceleration, m/s².
    pub accel: [f64; 3],
    /// Die temperature, °C.
    pub temperature: f64,
}

impl Scale {
    /// Returns the scale of a setup, or `None` if the board reported none.
    #[must_use]
    pub fn from_setup(setup: &ImuSetup) -> Option<Self> {
        let sensor = &setup.sensor;
        let counts = [
            setup.gyro_lsb_per_dps_times_10,
            setup.accel_lsb_per_g,
            sensor.temperature_lsb_per_c_times_100,
        ];
        if counts.contains(&0) {
            return None;
        }
        Some(Self {
            gyro_rad_s: (10.0 / f64::from(setup.gyro_lsb_per_dps_times_10)).to_radians(),
            accel_m_s2: STANDARD_GRAVITY / f64::from(setup.accel_lsb_per_g),
            gyro_delay_us: setup.gyro_delay_us,
            accel_delay_us: setup.accel_delay_us,
            temperature_c: 100.0 / f64::from(sensor.temperature_lsb_per_c_times_100),
            temperature_zero_c: f64::from(sensor.temperature_at_zero_centidegrees) / 100.0,
        })
    }

    /// Converts one sample to SI units.
    #[must_use]
    pub fn apply(&self, sample: &ImuSample) -> Sample {
        Sample {
            at: sample.at,
            flags: sample.flags,
            gyro: sample.gyro.map(|raw| f64::from(raw) * self.gyro_rad_s),
            accel: sample.accel.map(|raw| f64::from(raw) * self.accel_m_s2),
            temperature: f64::from(sample.temperature) * self.temperature_c
                + self.temperature_zero_c,
        }
    }
}

/// Running mean and standard deviation of numbers (Welford's algorithm).
#[derive(Clone, Copy, Debug, Default)]
pub struct RunningStats {
    count: u64,
    mean: f64,
    squares: f64,
}

impl RunningStats {
    /// Adds a number.
    pub fn add(&mut self, value: f64) {
        self.count += 1;
        let before = value - self.mean;
        self.mean += before / self.count as f64;
        self.squares += before * (value - self.mean);
    }

    /// Returns the number of values.
    #[must_use]
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Returns the mean, or `None` without values.
    #[must_use]
    pub fn mean(&self) -> Option<f64> {
        (self.count > 0).then_some(self.mean)
    }

    /// Returns the sample standard deviation, or `None` of fewer than two values.
    #[must_use]
    pub fn deviation(&self) -> Option<f64> {
        (self.count > 1).then(|| (self.squares / (self.count - 1) as f64).sqrt())
    }
}

/// Statistics of a stretch of samples.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    first: Option<Ticks>,
    last: Option<Ticks>,
    samples: u64,
    late: u64,
    saturated: u64,
    /// Samples after a loss on the board's side, or the first after a recovery.
    breaks: u64,
    interval: RunningStats,
    shortest: Option<u64>,
    longest: Option<u64>,
    gyro: [RunningStats; 3],
    accel: [RunningStats; 3],
    temperature: RunningStats,
    /// A message is missing before the next sample.
    gap: bool,
}

/// The summary as it is reported.
#[derive(Clone, Debug, Serialize)]
pub struct SummaryReport {
    /// Samples received.
    pub samples: u64,
    /// From first to last, seconds of board time.
    pub seconds: f64,
    /// Samples a second over unbroken intervals.
    pub rate_hz: Option<f64>,
    /// Unbroken intervals.
    pub intervals: u64,
    /// Mean interval, ticks.
    pub interval_mean_ticks: Option<f64>,
    /// Standard deviation of the interval, ticks.
    pub interval_jitter_ticks: Option<f64>,
    /// Shortest interval, ticks.
    pub interval_min_ticks: Option<u64>,
    /// Longest interval, ticks.
    pub interval_max_ticks: Option<u64>,
    /// Standard deviation of each axis, rad/s: noise, if the rig lay still.
    pub gyro_noise_rad_s: [Option<f64>; 3],
    /// Mean of each axis, rad/s: bias, if the rig lay still.
    pub gyro_mean_rad_s: [Option<f64>; 3],
    /// Standard deviation of each axis, m/s².
    pub accel_noise_m_s2: [Option<f64>; 3],
    /// Mean of each axis, m/s².
    pub accel_mean_m_s2: [Option<f64>; 3],
    /// Mean temperature of the die, °C.
    pub temperature_c: Option<f64>,
    /// Samples whose registers may hold the next sample already.
    pub late: u64,
    /// Samples at an end of their range.
    pub saturated: u64,
    /// Interruptions on the board's side (lost edges, recoveries).
    pub breaks: u64,
}

impl Summary {
    /// Adds a sample. Returns the interval from the one before it in ticks, if that is unbroken.
    pub fn add(&mut self, sample: &Sample) -> Option<u64> {
        let follows_break =
            sample.flags.has(ImuFlags::FIRST) || sample.flags.has(ImuFlags::AFTER_LOSS);
        let mut unbroken = None;
        self.samples += 1;
        self.late += u64::from(sample.flags.has(ImuFlags::LATE));
        self.saturated += u64::from(sample.flags.has(ImuFlags::SATURATED));
        if let Some(last) = self.last {
            self.breaks += u64::from(follows_break);
            if !follows_break && !self.gap {
                let interval = (sample.at - last).unsigned_abs();
                unbroken = Some(interval);
                self.interval.add(interval as f64);
                self.shortest = Some(self.shortest.map_or(interval, |least| least.min(interval)));
                self.longest = Some(self.longest.map_or(interval, |most| most.max(interval)));
            }
        }
        self.gap = false;
        self.first.get_or_insert(sample.at);
        self.last = Some(sample.at);
        for axis in 0..3 {
            self.gyro[axis].add(sample.gyro[axis]);
            self.accel[axis].add(sample.accel[axis]);
        }
        self.temperature.add(sample.temperature);
        unbroken
    }

    /// Notes that samples are missing before the next one.
    pub const fn gap(&mut self) {
        self.gap = true;
    }

    /// Returns the number of samples.
    #[must_use]
    pub const fn samples(&self) -> u64 {
        self.samples
    }

    /// Returns the time of the first sample.
    #[must_use]
    pub const fn first(&self) -> Option<Ticks> {
        self.first
    }

    /// Returns the time of the last sample.
    #[must_use]
    pub const fn last(&self) -> Option<Ticks> {
        self.last
    }

    /// Returns true if the board reported a defect of these samples: late ones or breaks.
    #[must_use]
    pub const fn is_impaired(&self) -> bool {
        self.late > 0 || self.breaks > 0
    }

    /// Returns the figures.
    #[must_use]
    pub fn report(&self) -> SummaryReport {
        let mean = self.interval.mean();
        SummaryReport {
            samples: self.samples,
            seconds: match (self.first, self.last) {
                (Some(first), Some(last)) => (last - first).as_secs_f64(),
                _ => 0.0,
            },
            rate_hz: mean.map(|mean| f64::from(TICK_HZ) / mean),
            intervals: self.interval.count(),
            interval_mean_ticks: mean,
            interval_jitter_ticks: self.interval.deviation(),
            interval_min_ticks: self.shortest,
            interval_max_ticks: self.longest,
            gyro_noise_rad_s: self.gyro.map(|axis| axis.deviation()),
            gyro_mean_rad_s: self.gyro.map(|axis| axis.mean()),
            accel_noise_m_s2: self.accel.map(|axis| axis.deviation()),
            accel_mean_m_s2: self.accel.map(|axis| axis.mean()),
            temperature_c: self.temperature.mean(),
            late: self.late,
            saturated: self.saturated,
            breaks: self.breaks,
        }
    }
}

/// Statistics of the IMU's samples: their summary, and their noise even in motion.
#[derive(Clone, Debug, Default)]
pub struct ImuLook {
    summary: Summary,
    /// The last three rates, the latest first, and how many there are.
    before: ([[f64; 3]; 3], usize),
    third: [RunningStats; 3],
}

impl ImuLook {
    /// Adds a sample.
    pub fn add(&mut self, sample: &Sample) {
        self.summary.add(sample);
        let (before, count) = &mut self.before;
        if *count == before.len() {
            for axis in 0..3 {
                let [one, two, three] = before.map(|rate| rate[axis]);
                self.third[axis].add(sample.gyro[axis] - 3.0 * one + 3.0 * two - three);
            }
        }
        *before = [sample.gyro, before[0], before[1]];
        *count = (*count + 1).min(before.len());
    }

    /// Notes that samples are missing before the next one.
    pub const fn gap(&mut self) {
        self.summary.gap();
        self.before.1 = 0;
    }

    /// Returns the summary so far.
    #[must_use]
    pub fn report(&self) -> SummaryReport {
        self.summary.report()
    }

    /// Returns the noise of the gyroscope while it turns, rad/s: that of the worst axis.
    ///
    /// The third difference of samples 2 ms apart takes out what a hand can do
    /// (5 rad/s at 10 Hz leave 0.002 rad/s) and leaves white noise times the root
    /// of 1 + 9 + 9 + 1. The sensor's low-pass takes some of that too, so it is an
    /// estimate to within a factor of two.
    #[must_use]
    pub fn noise_in_motion(&self) -> Option<f64> {
        self.third
            .iter()
            .filter_map(RunningStats::deviation)
            .map(|deviation| deviation / 20.0_f64.sqrt())
            .reduce(f64::max)
    }
}

#[cfg(test)]
mod tests {
    use protocol::ImuSensor;
    use test_support::board::imu_setup;

    use super::*;

    fn setup() -> ImuSetup {
        ImuSetup {
            gyro_delay_us: 1_900,
            accel_delay_us: 2_000,
            sensor: ImuSensor::default(),
            ..imu_setup()
        }
    }

    fn raw(at: u64, flags: ImuFlags, gyro: i16) -> ImuSample {
        ImuSample {
            seq: 0,
            at: Ticks(at),
            flags,
            accel: [8_192, 0, -4_096],
            temperature: -3_400,
            gyro: [gyro, 0, -655],
        }
    }

    #[test]
    fn a_sensor_that_is_sold_for_a_known_one_is_named() {
        for (found, name) in [
            (0x72, "clones of the MPU-6050"),
            (0x74, "MPU-6515"),
            (0x98, "ICM-20689"),
            (0xff, "is it powered"),
        ] {
            let mut setup = setup();
            setup.status.last_fault = Some(ImuFault::WrongIdentity { found });
            let said = last_fault(&setup);
            assert!(said.contains(&format!("{found:#04x}, ")), "{said}");
            assert!(said.contains(name), "{said}");
        }
    }

    #[test]
    fn another_sensor_has_another_thermometer_and_says_what_it_is() {
        let mut setup = imu_setup();
        let sample = Scale::from_setup(&setup)
            .unwrap()
            .apply(&raw(5, ImuFlags(0), 0));
        assert!((sample.temperature - (25.0 - 3_400.0 / 132.48)).abs() < 1e-12);
        assert_eq!(
            describe(&setup),
            "ICM-42688-P, ±500 °/s, ±4 g, low-pass 246.7 Hz with a delay of 1.3 ms, noise 2.8 \
             m°/s/√Hz and 70 µg/√Hz"
        );
        setup.sensor.model = ImuModel::Unknown;
        assert_eq!(describe(&setup), "not found");
    }

    #[test]
    fn intervals_across_a_gap_or_a_recovery_are_left_out() {
        let scale = Scale::from_setup(&setup()).unwrap();
        let mut summary = Summary::default();
        for (at, flags, gap) in [
            (0, ImuFlags::FIRST, false),
            (96_000, ImuFlags(0), false),
            (192_001, ImuFlags::SATURATED, false),
            (960_000, ImuFlags(0), true),
            (1_056_000, ImuFlags::LATE, false),
            (9_000_000, ImuFlags::AFTER_LOSS, false),
        ] {
            if gap {
                summary.gap();
            }
            summary.add(&scale.apply(&raw(at, flags, 0)));
        }
        let report = summary.report();
        assert_eq!(report.samples, 6);
        assert_eq!(report.intervals, 3);
        assert_eq!(report.interval_min_ticks, Some(96_000));
        assert_eq!(report.interval_max_ticks, Some(96_001));
        assert_eq!((report.late, report.saturated, report.breaks), (1, 1, 1));
        assert!(summary.is_impaired());
    }

    #[test]
    fn noise_is_the_sample_deviation() {
        let scale = Scale::from_setup(&setup()).unwrap();
        let mut summary = Summary::default();
        for (index, gyro) in [-3, -1, 1, 3].into_iter().enumerate() {
            summary.add(&scale.apply(&raw(index as u64 * 96_000, ImuFlags(0), gyro)));
        }
        let noise = summary.report().gyro_noise_rad_s[0].unwrap();
        // Deviation of ±1, ±3 with n − 1 = 3: sqrt(20 / 3) counts.
        let expected = (20.0_f64 / 3.0).sqrt() * scale.gyro_rad_s;
        assert!((noise - expected).abs() < 1e-12);
        assert_eq!(summary.report().rate_hz, Some(500.0));
        assert_eq!(summary.report().gyro_noise_rad_s[1], Some(0.0));
    }

    fn look(rate: impl Fn(f64) -> f64) -> ImuLook {
        let mut look = ImuLook::default();
        for index in 0..500_u64 {
            let at = index as f64 * 2e-3;
            look.add(&Sample {
                at: Ticks(index * 96_000),
                gyro: [rate(at), 0.0, 0.5 * rate(at)],
                ..Sample::default()
            });
        }
        look
    }

    #[test]
    fn noise_is_told_from_motion() {
        let hand = |at: f64| 5.0 * (std::f64::consts::TAU * 3.0 * at).sin();
        let still = look(hand).noise_in_motion().unwrap();
        assert!(still < 1e-3, "{still}");
        // A square wave from sample to sample: the worst noise that there is.
        let noisy = look(|at| {
            hand(at)
                + if ((at * 500.0) as u64).is_multiple_of(2) {
                    0.1
                } else {
                    -0.1
                }
        });
        let noise = noisy.noise_in_motion().unwrap();
        assert!((0.1..0.2).contains(&noise), "{noise}");
        assert_eq!(ImuLook::default().noise_in_motion(), None);
    }

    #[test]
    fn a_gap_is_no_noise() {
        let mut look = ImuLook::default();
        for (index, rate) in [0.0, 0.0, 0.0, 0.0, 4.0, 4.0, 4.0, 4.0]
            .into_iter()
            .enumerate()
        {
            if index == 4 {
                look.gap();
            }
            look.add(&Sample {
                at: Ticks(index as u64 * 96_000),
                gyro: [rate; 3],
                ..Sample::default()
            });
        }
        assert_eq!(look.noise_in_motion(), Some(0.0));
    }
}
