//! Synthetic recordings with a ground truth: a recording's folder written from the
//! rig's models directly, without booting the board.
//!
//! The models are those of the rig (motion, clocks that wander, gyroscopes with
//! their filters, noise and quantisation); the board's file and the session are
//! written by the host's own writer, the phone's files as the app saves them, the
//! depth recording as the camera's recorder does. What is left out against the
//! whole chain: the firmware, the link and the session's steps.
#![allow(dead_code, reason = "the tests and an example each use a part of it")]

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

use board::imu::Sample;
use clock::{ClockRelation, Wander};
use protocol::{EdgeGrid, ImuFlags, Period, Pulse, TICK_HZ, Ticks};
use recording::contents::TopicContents;
use recording::profile::Profile;
use recording::session_file::{Marker, SessionFile, SessionOutcome, Span};
use recording::writer::Writer;
use rig::clocks::oscillator::{BoardTime, Oscillator, OscillatorConfig, TrueTime};
use rig::depth_camera::k4a_mkv::{K4aImu, K4aMkvWriter, K4aSettings, device_us};
use rig::motion::gesture::Gesture;
use rig::motion::inertial_channel::{Channel, ChannelConfig, LowPass};
use rig::motion::{Motion, MotionSpec, MotionView, Step};
use rig::random::{Random, Seed, Stream, rotation};
use rig::wiring::UNITS_PER_TICK;
use stm32f4_sim::time::{SimTime, UNITS_PER_NANO, UNITS_PER_SECOND};
use system::ReadMonitor;

/// Low-pass of the board's gyroscope (MPU-9150, DLPF 188 Hz).
const BOARD_PASS: LowPass = LowPass {
    bandwidth_hz: 188.0,
    delay_s: 1.9e-3,
};
/// Low-pass of the phone's gyroscope; the profile knows its delay.
const PHONE_PASS: LowPass = LowPass {
    bandwidth_hz: 150.0,
    delay_s: 2.2e-3,
};
/// Counts of the board's gyroscope at ±500 °/s.
const GYRO_LSB: f64 = 65.5;
/// From a pulse to the first infrared flash, in the camera's time.
const FLASH_DELAY_NS: f64 = 500_000.0;
/// From the first flash to the centre of exposure, in the camera's time.
const HALF_TRAIN_NS: f64 = 6_362_500.0;
/// Exposure and readout of the phone.
const EXPOSURE_NS: f64 = 4_000_000.0;
const READOUT_NS: f64 = 11_005_800.0;

/// Settings of a recording.
#[derive(Clone, Debug)]
pub(crate) struct Synthetic {
    pub(crate) seed: u64,
    /// Length in seconds of true time.
    pub(crate) seconds: u64,
    /// The phase of the trigger moves within the recording.
    pub(crate) slew: bool,
    /// Probability that a depth frame is lost.
    pub(crate) drop_probability: f64,
    /// The depth recording has an IMU track.
    pub(crate) camera_imu: bool,
    /// True if there is a depth recording at all.
    pub(crate) depth: bool,
    /// True if there are the phone's files.
    pub(crate) phone: bool,
    /// Size of the depth images.
    pub(crate) image: (u32, u32),
    /// The depth recorder was killed.
    pub(crate) crashed: bool,
    /// Pixels of the depth images; a cheap pattern unless given.
    pub(crate) pixels: fn(u64, &mut [u16]),
    /// Marks, in seconds of board time.
    pub(crate) marks: Vec<u64>,
}

impl Default for Synthetic {
    fn default() -> Self {
        Self {
            seed: 1,
            seconds: 60,
            slew: true,
            drop_probability: 0.01,
            camera_imu: false,
            depth: true,
            phone: true,
            image: (32, 18),
            crashed: false,
            pixels: pattern,
            marks: Vec::new(),
        }
    }
}

/// A pattern that names its frame.
pub(crate) fn pattern(frame: u64, pixels: &mut [u16]) {
    for (index, pixel) in (0_u64..).zip(pixels.iter_mut()) {
        *pixel = ((frame * 131 + index * 7) % 13_000) as u16;
    }
}

/// A scene as a depth camera sees it: smooth surfaces, millimetres of noise, holes.
pub(crate) fn scene(frame: u64, pixels: &mut [u16]) {
    let mut random = Seed(frame).stream(Stream::Test);
    for (index, pixel) in pixels.iter_mut().enumerate() {
        let noise = random.bits() >> 61;
        let (x, y) = ((index % 640) as u64, (index / 640) as u64);
        let surface = 900 + (x * 3 + frame) % 1500 / 2 + y * 2;
        let hole = (x / 40 + y / 36 + frame / 30).is_multiple_of(11);
        *pixel = if hole { 0 } else { (surface + noise) as u16 };
    }
}

/// The ground truth of one depth frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DepthTruth {
    /// Number of its pulse.
    pub(crate) pulse: u64,
    /// Centre of exposure in board time, ns.
    pub(crate) center_ns: i64,
    /// True if it is in the file.
    pub(crate) delivered: bool,
}

/// The ground truth of a recording.
#[derive(Clone, Debug, Default)]
pub(crate) struct Truth {
    /// Start of exposure of the first row of each phone frame in board time, ns.
    pub(crate) color_start_ns: Vec<i64>,
    /// Middle of exposure of the middle row, ns.
    pub(crate) color_middle_ns: Vec<i64>,
    /// Every depth frame that was exposed.
    pub(crate) depth: Vec<DepthTruth>,
    /// Edges of all pulses, ns of board time.
    pub(crate) pulses_ns: Vec<i64>,
    /// Samples of the board's IMU.
    pub(crate) imu_samples: u64,
    /// Frame period of the phone in its own time, ns.
    pub(crate) frame_period_ns: f64,
    /// Phone against board: rate in ppm at the middle.
    pub(crate) skew_ppm: f64,
}

struct Rig {
    seed: Seed,
    board: BoardTime,
    phone: Oscillator,
    camera: Oscillator,
    motion: Arc<Motion>,
    dice: Random,
}

impl Rig {
    fn new(config: &Synthetic) -> Self {
        let seed = Seed(config.seed);
        let mut dice = seed.stream(Stream::Rig);
        let mut clock = |offset_ns, most_ppm: f64, stream| {
            let config = OscillatorConfig {
                offset_ns,
                rate_ppm: dice.uniform(-most_ppm, most_ppm),
                wander: 1e-9,
                ..OscillatorConfig::default()
            };
            Oscillator::new(config, seed.stream(stream))
        };
        let phone = clock(949_113_000_000_000, 50.0, Stream::PhoneClock);
        let board = OscillatorConfig {
            offset_ns: 0,
            rate_ppm: dice.uniform(-30.0, 30.0),
            wander: 1e-9,
            ..OscillatorConfig::default()
        };
        let camera = OscillatorConfig {
            offset_ns: 2_500_000_000,
            rate_ppm: 300.0,
            wander: 1e-9,
            ..OscillatorConfig::default()
        };
        let step = |gesture, seconds| Step { gesture, seconds };
        let spec = MotionSpec(vec![
            step(Gesture::Rest, Some(3.0)),
            step(Gesture::Twist, Some(9.0)),
            step(Gesture::Rest, Some(2.0)),
            step(Gesture::Walk, None),
        ]);
        Self {
            seed,
            board: BoardTime::new(board, seed.stream(Stream::BoardClock)),
            phone,
            camera: Oscillator::new(camera, seed.stream(Stream::CameraClock)),
            motion: spec.build(seed.stream(Stream::Motion)),
            dice,
        }
    }

    fn channel(&mut self, density: f64, pass: LowPass, tick_s: f64, stream: Stream) -> Channel {
        let mut each = |most: f64| [0; 3].map(|_| self.dice.uniform(-most, most));
        let config = ChannelConfig {
            scale_error: each(0.01),
            bias: each(0.01),
            bias_walk: 1e-5,
            noise_density: density,
            rotation: rotation(&mut self.dice),
        };
        Channel::new(config, pass, tick_s, self.seed.stream(stream))
    }

    /// Board time in ns of a reading of the phone's clock.
    fn board_of_phone(&self, phone_ns: f64) -> f64 {
        let config = self.phone.config();
        let elapsed = (phone_ns - config.offset_ns as f64) * UNITS_PER_NANO as f64;
        self.board_ns(self.phone.when_elapsed(elapsed.max(0.0) as u64))
    }

    fn board_ns(&self, at: TrueTime) -> f64 {
        self.board.board_at(at).units() as f64 / UNITS_PER_NANO as f64
    }

    /// True time at a tick of the board.
    fn true_of(&self, at: Ticks) -> TrueTime {
        self.board
            .true_at(SimTime::from_units(at.0 * UNITS_PER_TICK))
    }

    /// The end of the recording in ticks.
    fn end(&self, seconds: u64) -> u64 {
        let end = TrueTime::from_units(seconds * UNITS_PER_SECOND);
        self.board.board_at(end).units() / UNITS_PER_TICK
    }
}

/// Makes a recording in `folder` (which must be empty): `recording.mcap`,
/// `session.json`, `phone/`, `depth.mkv`.
pub(crate) fn make(folder: &Path, config: &Synthetic) -> Truth {
    let mut rig = Rig::new(config);
    let mut truth = Truth::default();
    let frame_period = 33_330_652.54 + rig.dice.uniform(-2_000.0, 2_000.0);
    truth.frame_period_ns = frame_period;
    // The phone's video begins after the twist.
    let first_frame = 949_113_000_000_000.0 + 15.3e9 + rig.dice.uniform(0.0, 33e6);
    let end_ticks = rig.end(config.seconds);
    let train = make_train(&rig, config, first_frame, frame_period, end_ticks);
    truth.pulses_ns = train
        .iter()
        .map(|pulse| pulse.at.as_nanos() as i64)
        .collect();

    let topics = write_board(folder, config, &mut rig, &train, end_ticks, &mut truth);
    if config.phone {
        write_phone(
            folder,
            &mut rig,
            config,
            first_frame,
            frame_period,
            &mut truth,
        );
    }
    if config.depth {
        write_depth(folder, &mut rig, config, &train, &mut truth);
    }
    write_session(folder, config, &rig, &train, topics);
    let second = |rig: &Rig, at: u64| rig.board_of_phone(949_113e9 + at as f64 * 1e9);
    let (from, to) = (second(&rig, 1), second(&rig, config.seconds - 1));
    truth.skew_ppm = ((config.seconds - 2) as f64 * 1e9 / (to - from) - 1.0) * 1e6;
    truth
}

/// The pulses: at the phone's frame rate, from any phase at first, then aligned so
/// that the middles of exposure meet.
fn make_train(
    rig: &Rig,
    config: &Synthetic,
    first_frame: f64,
    period: f64,
    end: u64,
) -> Vec<Pulse> {
    let frame_board = |n: f64| rig.board_of_phone(first_frame + n * period);
    // What the session would know of the period: right at the video's beginning.
    let period_board = (frame_board(300.0) - frame_board(0.0)) / 300.0;
    let period = Period::from_picos((period_board * 1000.0).round() as u64).unwrap();
    let middle = 0.5 * (EXPOSURE_NS + READOUT_NS) - FLASH_DELAY_NS - HALF_TRAIN_NS;
    let anchor = frame_board(0.0) + middle;
    // The train begins 1 s after the reset, away from the grid if it is to move.
    let back = ((anchor - 1e9) / period_board).floor();
    let on_grid = anchor - back * period_board;
    let off = if config.slew { 9_000_000.0 } else { 0.0 };
    let start = Ticks(((on_grid - off) * 6.0 / 125.0).round() as u64);
    let (mut moved, total, step) = (0_i64, (off * 6.0 / 125.0) as i64, 4_800_i64);
    let grid = EdgeGrid::new(start, period);
    let mut train = Vec::new();
    for number in 0.. {
        if number >= 200 {
            moved += (total - moved).clamp(-step, step);
        }
        let at = Ticks(grid.edge(number).ticks.0.saturating_add_signed(moved));
        if at.0 + 48_000 >= end {
            break;
        }
        train.push(Pulse {
            seq: number as u32,
            train: 1,
            number: number as u64,
            at,
            aligned: moved == total,
            ..Pulse::default()
        });
    }
    train
}

fn write_board(
    folder: &Path,
    config: &Synthetic,
    rig: &mut Rig,
    train: &[Pulse],
    end: u64,
    truth: &mut Truth,
) -> BTreeMap<String, TopicContents> {
    let mut writer = Writer::create(folder).unwrap();
    let mut gyro = rig.channel(8.7e-5, BOARD_PASS, 1e-3, Stream::ImuGyro);
    let mut accel = rig.channel(3.9e-3, BOARD_PASS, 1e-3, Stream::ImuAccel);
    let mut view = MotionView::new(Arc::clone(&rig.motion));
    let mut pulses = train.iter().peekable();
    let mut marks = config.marks.iter().peekable();
    let lsb = (1.0 / GYRO_LSB).to_radians();
    // 500 Hz: every 96,000 ticks.
    for tick in (24_000_017..end).step_by(96_000) {
        let at = Ticks(tick);
        while let Some(pulse) = pulses.next_if(|pulse| pulse.at <= at) {
            writer.pulse(pulse).unwrap();
        }
        while let Some(mark) = marks.next_if(|mark| **mark * u64::from(TICK_HZ) <= tick) {
            writer
                .marker(Ticks(*mark * u64::from(TICK_HZ)), None, "sequence")
                .unwrap();
        }
        let time = rig.true_of(at).as_secs_f64();
        let number = tick / 48_000;
        let rate = gyro.sample(time, number, 1e-3, |t| view.angular_rate(t));
        let force = accel.sample(time, number, 1e-3, |t| view.specific_force(t));
        let quantised = |value: f64, lsb: f64| (value / lsb).round() * lsb;
        let sample = Sample {
            at,
            flags: ImuFlags::default(),
            gyro: rate.map(|value| quantised(value, lsb)),
            accel: force.map(|value| quantised(value, 9.806_65 / 8192.0)),
            temperature: 35.0,
        };
        writer.imu(&sample, truth.imu_samples as u32).unwrap();
        truth.imu_samples += 1;
    }
    for pulse in pulses {
        writer.pulse(pulse).unwrap();
    }
    writer.finish().unwrap()
}

fn write_phone(
    folder: &Path,
    rig: &mut Rig,
    config: &Synthetic,
    first_frame: f64,
    period: f64,
    truth: &mut Truth,
) {
    let name = "VID_20260131_140327";
    let place = folder.join("phone").join("20260131_140327");
    std::fs::create_dir_all(&place).unwrap();
    let create =
        |ending: &str| BufWriter::new(File::create(place.join(format!("{name}{ending}"))).unwrap());
    let mut jitter = rig.seed.stream(Stream::PhoneTimestamps);
    // The gyroscope runs during the video, and a little before and after.
    let rate = 500.0 * (1.0 + rig.dice.uniform(-0.01, 0.01));
    let (density, pass) = (6.6e-5, PHONE_PASS);
    let mut gyro = rig.channel(density, pass, 1.0 / rate, Stream::PhoneGyro);
    let mut accel = rig.channel(9e-4, pass, 1.0 / rate, Stream::PhoneAccel);
    let mut view = MotionView::new(Arc::clone(&rig.motion));
    let (mut gyro_file, mut accel_file) = (create("gyro.csv"), create("accel.csv"));
    let from = first_frame - 0.5e9;
    let to = 949_113e9 + (config.seconds as f64 - 1.0) * 1e9;
    let count = ((to - from) * 1e-9 * rate) as u64;
    for number in 0..count {
        let phone_ns = from + number as f64 * 1e9 / rate;
        let at = rig
            .phone
            .when_nanos(phone_ns.round() as i64)
            .unwrap()
            .as_secs_f64();
        let stamp = (phone_ns + 1_000.0 * jitter.normal()).round() as i64;
        let row = |values: [f64; 3], step: f64| {
            let [x, y, z] = values.map(|value| ((value / step).round() * step) as f32);
            format!("{x},{y},{z},{stamp}")
        };
        let values = gyro.sample(at, number, 1.0 / rate, |t| view.angular_rate(t));
        writeln!(gyro_file, "{}", row(values, 0.07_f64.to_radians())).unwrap();
        let values = accel.sample(at, number, 1.0 / rate, |t| view.specific_force(t));
        writeln!(accel_file, "{}", row(values, 0.0024)).unwrap();
    }
    let mut frames = create("_imu_timestamps.csv");
    let middle = 0.5 * (EXPOSURE_NS + READOUT_NS);
    for frame in 0.. {
        let start = first_frame + f64::from(frame) * period;
        if start + 40e6 > to {
            break;
        }
        let stamp = (start + 1_000.0 * jitter.normal()).round() as i64;
        writeln!(frames, "{stamp}").unwrap();
        truth
            .color_start_ns
            .push(rig.board_of_phone(start).round() as i64);
        truth
            .color_middle_ns
            .push(rig.board_of_phone(start + middle).round() as i64);
    }
}

fn write_depth(
    folder: &Path,
    rig: &mut Rig,
    config: &Synthetic,
    train: &[Pulse],
    truth: &mut Truth,
) {
    let settings = K4aSettings {
        width: config.image.0,
        height: config.image.1,
        imu: config.camera_imu,
        infrared: false,
        ..K4aSettings::default()
    };
    let file = BufWriter::with_capacity(1 << 20, File::create(folder.join("depth.mkv")).unwrap());
    let mut writer = K4aMkvWriter::new(file, settings).unwrap();
    let mut dice = rig.seed.stream(Stream::DepthCamera);
    let mut pixels = vec![0; (config.image.0 * config.image.1) as usize];
    let mut imu = CameraImu::new(rig);
    let base = rig.camera.config().offset_ns as u64;
    for pulse in train.iter().skip(2) {
        // The delays pass on the camera's clock.
        let edge = rig.camera.elapsed_at(rig.true_of(pulse.at));
        let delay = ((FLASH_DELAY_NS + HALF_TRAIN_NS) * UNITS_PER_NANO as f64) as u64;
        let centre = rig.camera.when_elapsed(edge + delay);
        let own_ns = (edge + delay) / UNITS_PER_NANO + base;
        // 90 kHz ticks, rounded down, and then microseconds.
        let us = device_us((u128::from(own_ns) * 90_000 / 1_000_000_000) as u64);
        let delivered = !dice.chance(config.drop_probability);
        truth.depth.push(DepthTruth {
            pulse: pulse.number,
            center_ns: rig.board_ns(centre).round() as i64,
            delivered,
        });
        if config.camera_imu {
            imu.write_until(us, rig, &mut writer);
        }
        if delivered {
            (config.pixels)(pulse.number, &mut pixels);
            writer.write_capture(us, &pixels, None).unwrap();
        }
    }
    if config.crashed {
        writer.flush_clusters().unwrap();
        writer.into_inner().flush().unwrap();
    } else {
        writer.finish().unwrap().flush().unwrap();
    }
}

/// The depth camera's IMU at 1.6 kHz, with a low-pass of 2 ms that nobody knows of.
struct CameraImu {
    gyro: Channel,
    view: MotionView,
    number: u64,
}

impl CameraImu {
    const STEP_US: u64 = 625;

    fn new(rig: &mut Rig) -> Self {
        let pass = LowPass {
            bandwidth_hz: 200.0,
            delay_s: 2e-3,
        };
        Self {
            gyro: rig.channel(1.2e-4, pass, 625e-6, Stream::Test),
            view: MotionView::new(Arc::clone(&rig.motion)),
            number: 0,
        }
    }

    fn write_until<W: Write + std::io::Seek>(
        &mut self,
        us: u64,
        rig: &Rig,
        out: &mut K4aMkvWriter<W>,
    ) {
        let base = rig.camera.config().offset_ns as u64 / 1000;
        if self.number == 0 {
            self.number = us.saturating_sub(base) / Self::STEP_US;
        }
        while base + self.number * Self::STEP_US < us {
            let own = base + self.number * Self::STEP_US;
            let at = rig
                .camera
                .when_nanos((own * 1000) as i64)
                .unwrap()
                .as_secs_f64();
            let view = &mut self.view;
            let rate = self
                .gyro
                .sample(at, self.number, 625e-6, |t| view.angular_rate(t));
            out.write_imu(&K4aImu {
                accel_us: own,
                accel: [0.0, 0.0, 9.8],
                gyro_us: own,
                gyro: rate.map(|value| value as f32),
            })
            .unwrap();
            self.number += 1;
        }
    }
}

fn write_session(
    folder: &Path,
    config: &Synthetic,
    rig: &Rig,
    train: &[Pulse],
    topics: BTreeMap<String, TopicContents>,
) {
    let mut profile = Profile::published().unwrap();
    profile.phone.exposure_us = EXPOSURE_NS / 1000.0;
    profile.phone.readout_us = READOUT_NS / 1000.0;
    profile.phone.gyro_delay_us = PHONE_PASS.delay_s * 1e6;
    profile.depth.center_offset_us = (FLASH_DELAY_NS + HALF_TRAIN_NS) / 1000.0;
    let mut session = SessionFile::new("synthetic".into(), profile);
    // What a twist of 9 s gives: a few µs off, and the skew to 2 ppm.
    let offset_at = |board_s: u64| {
        let at = rig.true_of(Ticks(board_s * u64::from(TICK_HZ)));
        let phone = rig.phone.config().offset_ns as f64 * 1e-9
            + rig.phone.elapsed_at(at) as f64 / UNITS_PER_SECOND as f64;
        phone - board_s as f64
    };
    session.phones[0].clock = Some(ClockRelation {
        reference: 8.0,
        offset: offset_at(8) + 4e-6,
        skew: (offset_at(13) - offset_at(3)) / 10.0 + 1.5e-6,
        covariance: [[9e-12, 0.0], [0.0, 5.8e-12]],
        wander: Wander::default(),
    });
    session.imu = Some(imu_info());
    session.recorded = train.first().zip(train.last()).map(|(first, last)| Span {
        from: first.at,
        to: last.at,
    });
    let at = |second: u64| Ticks(second * u64::from(TICK_HZ));
    session.markers = config
        .marks
        .iter()
        .map(|mark| Marker {
            at: at(*mark),
            label: String::from("sequence"),
        })
        .collect();
    session.close(SessionOutcome::Good, Some(topics));
    session
        .close_files(folder, &ReadMonitor::default())
        .unwrap();
    session.save(folder).unwrap();
}

fn imu_info() -> recording::session_file::ImuInfo {
    let setup = protocol::ImuSetup {
        gyro_delay_us: 1900,
        accel_delay_us: 2000,
        sensor: protocol::ImuSensor::default(),
        ..test_support::board::imu_setup()
    };
    let scale = board::imu::Scale::from_setup(&setup).unwrap();
    recording::session_file::ImuInfo { setup, scale }
}
