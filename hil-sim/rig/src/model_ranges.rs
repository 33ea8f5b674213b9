//! Numbers of the models that nothing from outside confirms, each with its nominal value and
//! the range in which that of a real rig may lie. The book's page of model ranges has a row
//! for each, with its source; a test compares them.
//!
//! A seed draws a rig from the ranges ([`ModelValues::drawn`]); of a drawn rig that is worst a
//! study takes them back one at a time ([`ModelValues::each_without_one`]). What a rig's owner
//! measures once (filter delay, readout, the delay of the flash) is drawn apart from these
//! ([`draw_constants`]), for rigs whose owner has yet to do so.

use crate::clocks::oscillator::{OscillatorConfig, Warming};
use crate::depth_camera::micros;
use crate::motion::gesture::Gesture;
use crate::phone::PhoneConfig;
use crate::random::{Random, Seed, Stream, log_uniform};
use crate::whole_rig::config::RigConfig;

/// Distribution over the range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Draw {
    /// Even.
    Even,
    /// Even in its logarithm.
    Log,
    /// The same, with either sign.
    EitherSign,
    /// A whole number.
    Whole,
    /// Nominal in most rigs; even in one of [`RARE`].
    Rare,
}

/// Number of rigs of which one has a [`Draw::Rare`] value.
const RARE: f64 = 10.0;

/// A number of the models with its range.
#[derive(Clone, Copy, Debug)]
pub struct ModelRange {
    /// Name of its row in the book.
    pub name: &'static str,
    /// Unit; empty if it has none.
    pub unit: &'static str,
    /// Nominal value.
    pub nominal: f64,
    /// Smallest and largest value of a real rig.
    pub range: (f64, f64),
    /// Distribution over the range.
    pub draw: Draw,
    apply: Apply,
}

type Apply = fn(f64, &mut RigConfig, &mut PhoneConfig);

/// Effects of an exposure that is not locked.
const OF_EXPOSURE: [&str; 3] = [
    "longest exposure",
    "change of the exposure within a recording",
    "frame period in the dark",
];

/// Warming of a clock, ppm in 10 min, with either sign.
pub const WARMING_PPM: (f64, f64) = (0.1, 5.0);

/// Time constant of the warming, s.
pub const WARMING_S: (f64, f64) = (120.0, 1_200.0);

/// Wander of a clock, ppm per √s.
pub const WANDER_PPM: (f64, f64) = (0.0005, 0.01);

/// From the trigger's edge to the first flash, s. Its jitter is up to 0.1 ms, and no flash
/// precedes its edge.
const FLASH_S: (f64, f64) = (0.35e-3, 10e-3);

/// Delay of the phone's gyroscope filter, s.
const GYROSCOPE_S: (f64, f64) = (1e-3, 8e-3);

/// Readout of the phone's picture, ns, and the largest part of the frame period that it takes.
const READOUT_NS: (f64, f64) = (5e6, 33e6);
const READOUT_PART: f64 = 0.98;

/// Draws the constants that lie between the two exposures from their whole ranges, by a seed.
pub fn draw_constants(seed: Seed, rig: &mut RigConfig, phone: &mut PhoneConfig) {
    let mut random = seed.stream(Stream::Constants);
    let mut draw = |(least, most): (f64, f64)| random.uniform(least, most);
    let flash_s = draw(FLASH_S);
    camera(rig, |camera| camera.flash_delay = micros(flash_s * 1e6));
    phone.gyroscope.low_pass.delay_s = draw(GYROSCOPE_S);
    let camera = &mut phone.camera;
    let longest_ns = READOUT_NS.1.min(READOUT_PART * camera.frame_period_ns);
    camera.row_time_ns = draw((READOUT_NS.0, longest_ns)) / (camera.rows as f64 - 1.0);
}

/// All ranges.
pub const MODEL_RANGES: [ModelRange; 41] = [
    ModelRange::named("warming of the board's crystal", Draw::EitherSign)
        .within(0.0, WARMING_PPM, "ppm in 10 min")
        .sets(|ppm, rig, _| rig.board_clock.warming.ppm = ppm),
    ModelRange::named("warming of the phone's clock", Draw::EitherSign)
        .within(0.0, WARMING_PPM, "ppm in 10 min")
        .sets(|ppm, _, phone| phone.clock.warming.ppm = ppm),
    ModelRange::named("warming of the camera's clock", Draw::EitherSign)
        .within(0.0, WARMING_PPM, "ppm in 10 min")
        .sets(|ppm, rig, _| camera(rig, |camera| camera.clock.warming.ppm = ppm)),
    ModelRange::named("time in which a rig warms up", Draw::Log)
        .within(Warming::SPAN_S, WARMING_S, "s")
        .sets(|time_s, rig, phone| each_clock(rig, phone, |clock| clock.warming.time_s = time_s)),
    ModelRange::named("wander of a clock", Draw::Log)
        .within(0.001, WANDER_PPM, "ppm per √s")
        .sets(|ppm, rig, phone| each_clock(rig, phone, |clock| clock.wander = ppm * 1e-6)),
    ModelRange::named("frames of the phone that are lost", Draw::Even)
        .within(0.0, (0.0, 1.0), "%")
        .sets(|percent, _, phone| phone.camera.lost = percent / 100.0),
    ModelRange::named("frames of the phone that are doubled", Draw::Even)
        .within(0.0, (0.0, 1.0), "%")
        .sets(|percent, _, phone| phone.camera.doubled = percent / 100.0),
    ModelRange::named("frames of the phone that are lost at once", Draw::Rare)
        .within(1.0, (1.0, 30.0), "")
        .sets(|count, _, phone| phone.camera.lost_at_once = count as u32),
    ModelRange::named(OF_EXPOSURE[0], Draw::Log)
        .within(0.5, (0.5, 33.0), "ms")
        .sets(|ms, _, phone| phone.camera.longest_exposure_ns = (ms * 1e6) as u64),
    ModelRange::named(OF_EXPOSURE[1], Draw::Rare)
        .within(0.0, (0.0, 50.0), "%")
        .sets(|percent, _, phone| phone.camera.exposure_swing = percent / 100.0),
    ModelRange::named(OF_EXPOSURE[2], Draw::Rare)
        .within(33.0, (33.0, 66.0), "ms")
        .sets(|ms, _, phone| phone.camera.dark_period_ns = ms * 1e6),
    ModelRange::named("frames on the clock that sleeps", Draw::Rare)
        .within(0.0, (0.0, 1.0), "h")
        .sets(|hours, _, phone| {
            phone.camera.is_on_monotonic = true;
            phone.slept_ns = (hours * 3.6e12) as i64;
        }),
    ModelRange::named("frame period that follows the exposure", Draw::Even)
        .within(0.0, (0.0, 200.0), "ns/ms")
        .sets(|ns, _, phone| phone.camera.period_of_exposure = ns * 1e-6),
    ModelRange::named("jitter of frame timestamps", Draw::Log)
        .within(1.0, (0.1, 20.0), "µs")
        .sets(|us, _, phone| phone.camera.timestamp_jitter_ns = us * 1e3),
    // Relative to what this phone has for its nominal 500 Hz.
    ModelRange::named("rate of the phone's gyroscope", Draw::Even)
        .within(500.0, (100.0, 500.0), "Hz")
        .sets(|hz, _, phone| phone.gyroscope.rate_hz *= hz / 500.0),
    ModelRange::named("jitter of sensor timestamps", Draw::Log)
        .within(1.0, (1.0, 500.0), "µs")
        .sets(|us, _, phone| phone.gyroscope.timestamp_jitter_ns = us * 1e3),
    ModelRange::named("sawtooth of sensor timestamps", Draw::Even)
        .within(0.0, (0.0, 60.0), "µs")
        .sets(|us, _, phone| phone.gyroscope.stamps.sawtooth_ns = us * 1e3),
    ModelRange::named("period of that sawtooth", Draw::Log)
        .within(1.0, (0.5, 20.0), "s")
        .sets(|s, _, phone| phone.gyroscope.stamps.sawtooth_s = s),
    ModelRange::named("wander of sensor timestamps", Draw::Even)
        .within(0.0, (0.0, 5.0), "µs")
        .sets(|us, _, phone| phone.gyroscope.stamps.wander_ns = us * 1e3),
    ModelRange::named("time over which that wander is correlated", Draw::Log)
        .within(0.5, (0.1, 2.0), "s")
        .sets(|s, _, phone| phone.gyroscope.stamps.wander_s = s),
    ModelRange::named("step of sensor timestamps", Draw::Even)
        .within(0.0, (0.0, 31.0), "µs")
        .sets(|us, _, phone| phone.gyroscope.stamps.step_ns = us * 1e3),
    ModelRange::named("kind of twist", Draw::Whole)
        .within(0.0, (0.0, 2.0), "")
        .sets(|kind, rig, _| twists(rig, kind)),
    ModelRange::named("step of the temperature", Draw::EitherSign)
        .within(0.0, (0.1, 2.0), "ppm")
        .sets(|ppm, _, phone| phone.clock.warming.step_ppm = ppm),
    // The specimen has one within the nominal limit.
    ModelRange::named("bias of the board's gyroscope", Draw::Even)
        .within(2.0, (2.0, 20.0), "°/s")
        .sets(|dps, rig, _| {
            imu(rig, |imu| {
                imu.gyro.bias = imu.gyro.bias.map(|bias| bias * dps / 2.0)
            })
        }),
    ModelRange::named("bias against temperature", Draw::Even)
        .within(0.0, (0.0, 0.32), "°/s per °C")
        .sets(|dps, rig, _| {
            imu(rig, |imu| {
                imu.gyro_drift = [1.0, -1.0, 0.5].map(|axis: f64| (axis * dps).to_radians())
            })
        }),
    ModelRange::named("rate of data-ready", Draw::Even)
        .within(0.0, (-1.0, 0.0), "ppm")
        .sets(|ppm, rig, _| imu(rig, |imu| imu.data_ready.rate_ppm = ppm)),
    ModelRange::named("wander of data-ready", Draw::Even)
        .within(0.0, (0.0, 0.4), "µs")
        .sets(|us, rig, _| imu(rig, |imu| imu.data_ready.wander_ns = us * 1e3)),
    ModelRange::named("temperature of the running IMU above the room", Draw::Even)
        .within(4.0, (1.0, 10.0), "°C")
        .sets(|celsius, rig, _| imu(rig, |imu| imu.self_heating_c = celsius)),
    ModelRange::named("time in which the IMU warms up", Draw::Log)
        .within(60.0, (30.0, 600.0), "s")
        .sets(|time_s, rig, _| imu(rig, |imu| imu.warm_up_s = time_s)),
    ModelRange::named("jitter from pulse to flash", Draw::Even)
        .within(0.0, (0.0, 100.0), "µs")
        .sets(|us, rig, _| camera(rig, |camera| camera.flash_jitter = micros(us))),
    ModelRange::named("first depth frame on pulse", Draw::Whole)
        .within(2.0, (2.0, 8.0), "")
        .sets(|pulse, rig, _| camera(rig, |camera| camera.first_frame = pulse as u32)),
    ModelRange::named("camera's clock zeroed at the first pulse", Draw::Whole)
        .within(0.0, (0.0, 1.0), "")
        .sets(|yes, rig, _| camera(rig, |camera| camera.zeroed_at_first_pulse = yes > 0.5)),
    ModelRange::named("depth frames spoilt under an external train", Draw::Even)
        .within(0.0, (0.0, 5.0), "%")
        .sets(|percent, rig, _| camera(rig, |camera| camera.spoil_probability = percent / 100.0)),
    ModelRange::named("depth frames lost", Draw::Even)
        .within(0.0, (0.0, 2.0), "%")
        .sets(|percent, rig, _| camera(rig, |camera| camera.drop_probability = percent / 100.0)),
    ModelRange::named("depth frames lost at once", Draw::Rare)
        .within(1.0, (1.0, 60.0), "")
        .sets(|count, rig, _| camera(rig, |camera| camera.dropped_at_once = count as u32)),
    ModelRange::named("photodiode: delay when light comes", Draw::Log)
        .within(0.0, (0.05, 1.0), "µs")
        .sets(|us, rig, _| camera(rig, |camera| camera.photodiode_delay.0 = micros(us))),
    ModelRange::named("photodiode: delay when light goes", Draw::Log)
        .within(0.0, (0.05, 1.0), "µs")
        .sets(|us, rig, _| camera(rig, |camera| camera.photodiode_delay.1 = micros(us))),
    ModelRange::named("time of the temperature's step", Draw::Even)
        .within(150.0, (0.0, 600.0), "s")
        .sets(|s, _, phone| phone.clock.warming.step_at_s = s),
    ModelRange::named("time in which the clock follows the temperature", Draw::Log)
        .within(30.0, (10.0, 300.0), "s")
        .sets(|s, _, phone| phone.clock.warming.step_time_s = s),
    ModelRange::named("LED: time in which its light comes", Draw::Log)
        .within(0.1, (0.02, 0.5), "µs")
        .sets(|us, rig, _| rig.led.iter_mut().for_each(|led| led.rise = micros(us))),
    ModelRange::named("LED: persistence", Draw::Log)
        .within(0.1, (0.02, 1.0), "µs")
        .sets(|us, rig, _| {
            rig.led
                .iter_mut()
                .for_each(|led| led.persistence = micros(us))
        }),
];

fn camera(rig: &mut RigConfig, change: impl FnOnce(&mut crate::depth_camera::DepthCameraConfig)) {
    if let Some(camera) = &mut rig.depth_camera {
        change(camera);
    }
}

/// Sets the kind of motion of all twists: strong, as the published one, or about one axis.
fn twists(rig: &mut RigConfig, kind: f64) {
    for step in &mut rig.motion.0 {
        if step.gesture == Gesture::Twist {
            step.gesture = match kind as u32 {
                0 => Gesture::Twist,
                1 => Gesture::WeakTwist,
                _ => Gesture::OneAxisTwist,
            };
        }
    }
}

fn imu(rig: &mut RigConfig, change: impl FnOnce(&mut crate::imu::SimImuConfig)) {
    if let Some(imu) = &mut rig.imu {
        change(imu);
    }
}

fn each_clock(
    rig: &mut RigConfig,
    phone: &mut PhoneConfig,
    mut change: impl FnMut(&mut OscillatorConfig),
) {
    change(&mut rig.board_clock);
    change(&mut phone.clock);
    camera(rig, |camera| change(&mut camera.clock));
}

impl ModelRange {
    const fn named(name: &'static str, draw: Draw) -> Self {
        Self {
            name,
            unit: "",
            nominal: 0.0,
            range: (0.0, 0.0),
            draw,
            apply: |_, _, _| (),
        }
    }

    const fn within(self, nominal: f64, range: (f64, f64), unit: &'static str) -> Self {
        Self {
            unit,
            nominal,
            range,
            ..self
        }
    }

    const fn sets(self, apply: Apply) -> Self {
        Self { apply, ..self }
    }

    fn drawn(&self, random: &mut Random) -> f64 {
        let (least, most) = self.range;
        match self.draw {
            Draw::Even => random.uniform(least, most),
            Draw::Log => log_uniform(random, self.range),
            Draw::EitherSign => {
                let size = log_uniform(random, self.range);
                if random.chance(0.5) { size } else { -size }
            }
            Draw::Whole => random.uniform(least, most + 1.0).floor().min(most),
            Draw::Rare => {
                let (value, is_rare) = (random.uniform(least, most), random.chance(1.0 / RARE));
                if is_rare { value } else { self.nominal }
            }
        }
    }

    /// Returns the ends of its range that differ from the nominal value; with either sign, both
    /// signs of the larger end.
    #[cfg(test)]
    fn extremes(&self) -> Vec<f64> {
        let (least, most) = self.range;
        let ends = match self.draw {
            Draw::EitherSign => [-most, most],
            _ => [least, most],
        };
        ends.into_iter()
            .filter(|&end| end != self.nominal)
            .collect()
    }
}

/// A value in each of the ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelValues([f64; MODEL_RANGES.len()]);

impl Default for ModelValues {
    /// Returns the nominal values.
    fn default() -> Self {
        Self(MODEL_RANGES.map(|range| range.nominal))
    }
}

impl ModelValues {
    /// Draws values from the ranges by a seed.
    #[must_use]
    pub fn drawn(seed: Seed) -> Self {
        let mut random = seed.stream(Stream::ModelRanges);
        Self(MODEL_RANGES.map(|range| range.drawn(&mut random)))
    }

    /// Returns the same values with another one at a place of [`MODEL_RANGES`].
    #[must_use]
    pub fn with(mut self, place: usize, value: f64) -> Self {
        if let Some(old) = self.0.get_mut(place) {
            *old = value;
        }
        self
    }

    /// Returns the nominal values, with twists as strong as the one of a person's hand that is
    /// published.
    #[must_use]
    pub fn nominal_by_hand() -> Self {
        let place = MODEL_RANGES
            .iter()
            .position(|range| range.name == "kind of twist");
        Self::default().with(place.unwrap_or(MODEL_RANGES.len()), 1.0)
    }

    /// Returns the same values where exposure and frame rate are locked.
    #[must_use]
    pub fn with_exposure_locked(mut self) -> Self {
        for (range, value) in MODEL_RANGES.iter().zip(&mut self.0) {
            if OF_EXPOSURE.contains(&range.name) {
                *value = range.nominal;
            }
        }
        self
    }

    /// Returns the same values with one after the other set to nominal, each with its description;
    /// values that are nominal already are left out.
    #[must_use]
    pub fn each_without_one(&self) -> Vec<(String, Self)> {
        let ranges = MODEL_RANGES.iter().enumerate().zip(self.0);
        let others = ranges.filter(|((_, range), value)| *value != range.nominal);
        let without = others.map(|((place, range), value)| {
            let words = format!("{}: {value:.1} {}", range.name, range.unit);
            (words.trim_end().to_owned(), self.with(place, range.nominal))
        });
        without.collect()
    }

    /// Returns the value at a place of [`MODEL_RANGES`].
    #[cfg(test)]
    fn value(&self, place: usize) -> Option<f64> {
        self.0.get(place).copied()
    }

    /// Applies the values to a rig and its phone. Nominal values are left as they are.
    pub fn apply(&self, rig: &mut RigConfig, phone: &mut PhoneConfig) {
        for (range, value) in MODEL_RANGES.iter().zip(self.0) {
            if value != range.nominal {
                (range.apply)(value, rig, phone);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::led::LedConfig;
    use crate::motion::MotionSpec;

    fn nominal() -> (RigConfig, PhoneConfig) {
        let motion = MotionSpec::always(Gesture::Twist);
        let mut rig = RigConfig::published(Seed(3)).with_motion(motion);
        rig.led = Some(LedConfig::nominal(rig.board));
        (rig, PhoneConfig::draw(Seed(3)))
    }

    fn made(values: &ModelValues) -> (RigConfig, PhoneConfig) {
        let mut made = nominal();
        values.apply(&mut made.0, &mut made.1);
        made
    }

    #[test]
    fn each_range_changes_the_rig_and_the_nominal_ones_do_not() {
        let nominal = ModelValues::default();
        let usual = self::nominal();
        assert_eq!(made(&nominal), usual);
        for (place, range) in MODEL_RANGES.iter().enumerate() {
            let mut seen = vec![usual.clone()];
            for end in range.extremes() {
                let other = made(&nominal.with(place, end));
                assert!(!seen.contains(&other), "{} of {end}", range.name);
                seen.push(other);
            }
            assert!(seen.len() > 1, "{} has no range", range.name);
        }
    }

    #[test]
    fn the_nominal_rig_in_a_hand_differs_in_its_twists_alone() {
        let (mut rig, phone) = nominal();
        rig.motion = MotionSpec::always(Gesture::WeakTwist);
        assert_eq!(made(&ModelValues::nominal_by_hand()), (rig, phone));
    }

    #[test]
    fn a_seed_draws_from_the_whole_of_every_range() {
        let draws: Vec<ModelValues> = (0..4_000)
            .map(|seed| ModelValues::drawn(Seed(seed)))
            .collect();
        assert_eq!(draws[7], ModelValues::drawn(Seed(7)));
        for (place, range) in MODEL_RANGES.iter().enumerate() {
            let (least, most) = range.range;
            let values: Vec<f64> = draws.iter().filter_map(|d| d.value(place)).collect();
            let size = |value: &f64| match range.draw {
                Draw::EitherSign => value.abs(),
                _ => *value,
            };
            let (low, high) = values
                .iter()
                .map(size)
                .fold((most, least), |(low, high), v| {
                    assert!((least..=most).contains(&v), "{}: {v}", range.name);
                    (low.min(v), high.max(v))
                });
            // A twentieth of the range at both ends is reached.
            let share = |v: f64| match range.draw {
                Draw::Log | Draw::EitherSign => (v / least).ln() / (most / least).ln(),
                _ => (v - least) / (most - least),
            };
            assert!(share(low) < 0.05 && share(high) > 0.95, "{}", range.name);
        }
    }

    #[test]
    fn the_exposure_can_be_locked() {
        let locked = |seed| ModelValues::drawn(Seed(seed)).with_exposure_locked();
        let mut moved = Vec::new();
        for seed in 0..60 {
            let (drawn, locked) = (ModelValues::drawn(Seed(seed)), locked(seed));
            let differs = |place: &usize| locked.value(*place) != drawn.value(*place);
            moved.extend((0..MODEL_RANGES.len()).filter(differs));
        }
        moved.sort_unstable();
        moved.dedup();
        let names: Vec<&str> = moved
            .iter()
            .map(|&place| MODEL_RANGES[place].name)
            .collect();
        assert_eq!(names, OF_EXPOSURE);
    }

    #[test]
    fn each_value_but_one_is_that_of_the_rig() {
        let drawn = ModelValues::drawn(Seed(4));
        for (words, without) in drawn.each_without_one() {
            let differs = |place: &usize| without.value(*place) != drawn.value(*place);
            let moved: Vec<usize> = (0..MODEL_RANGES.len()).filter(differs).collect();
            let [place] = moved[..] else {
                panic!("{words}: {moved:?}");
            };
            assert!(words.starts_with(MODEL_RANGES[place].name), "{words}");
            assert_eq!(without.value(place), Some(MODEL_RANGES[place].nominal));
        }
    }
}
