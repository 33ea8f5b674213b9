//! Properties of one simulated phone.

use std::path::PathBuf;

use crate::clocks::oscillator::OscillatorConfig;
use crate::motion::inertial_channel::{ChannelConfig, LowPass};
use crate::random::{Random, Seed, Stream, rotation};

/// Everything about one phone. [`PhoneConfig::draw`] gives a specimen.
#[derive(Clone, Debug, PartialEq)]
pub struct PhoneConfig {
    /// Seed of all that is random in it.
    pub seed: Seed,
    /// Version that the app's server states.
    pub version: String,
    /// The boot clock against true time.
    pub clock: OscillatorConfig,
    /// The gyroscope; values in rad/s.
    pub gyroscope: SensorConfig,
    /// The accelerometer; values in m/s².
    pub accelerometer: SensorConfig,
    /// The camera.
    pub camera: CameraConfig,
    /// The app's settings, and how long it takes for things.
    pub app: AppConfig,
    /// When a video is rendered.
    pub video: VideoMode,
    /// Folder of the app's files; a temporary one if not given.
    pub storage: Option<PathBuf>,
    /// The name that `get_video` gives its file, instead of the true one.
    pub video_name: Option<String>,
    /// Time that it has slept since it was started, ns: `CLOCK_MONOTONIC` stood still then.
    pub slept_ns: i64,
}

/// One copy of the app: its settings, and what its phone takes time for. The lines that
/// it follows are of the app's source: `ExtendedAppInterface.java` is EAI,
/// `RemoteRpcRequestHandler.java` RRH.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AppConfig {
    /// From a stop to the closed capture session, milliseconds. Until then the app counts
    /// as recording, and the sensors run (`CameraController2.java`:5277, EAI:237). How
    /// long that takes is the phone's; [`PhoneConfig::draw`] takes 0 to 2 s.
    pub stop_ms: f64,
    /// The sensors that are ticked in the settings: accelerometer, gyroscope,
    /// magnetometer. They alone get files (EAI:297).
    pub ticked: [bool; 3],
    /// Access to the storage.
    pub storage: StorageAccess,
}

/// Access of the app to its files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StorageAccess {
    /// As files. A second one of a name ends in `_1` (`StorageUtils.java`:640).
    Files,
    /// Through the storage access framework. A second one of a name ends in ` (1)`, and
    /// nobody hears when a video is there (`Preview.java`:1072).
    Documents,
}

/// When a video is rendered and encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VideoMode {
    /// Never; `get_video` is answered as if its file could not be read.
    Never,
    /// When it is asked for.
    OnRequest,
    /// In the background as soon as a recording is stopped, as the app has its
    /// file then.
    OnStop,
}

/// One three-axis motion sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorConfig {
    /// Samples per second of the phone's clock. Sensors have oscillators of
    /// their own: a nominal 500 Hz is rarely that.
    pub rate_hz: f64,
    /// Mounting, scale, bias, noise.
    pub channel: ChannelConfig,
    /// The low-pass before sampling. Its delay is *not* taken off the
    /// timestamps, as on real phones.
    pub low_pass: LowPass,
    /// Step of the values.
    pub step: f64,
    /// White noise on the timestamps, standard deviation in nanoseconds.
    pub timestamp_jitter_ns: f64,
    /// Other errors of the timestamps.
    pub stamps: StampErrors,
}

/// Errors of timestamps that are not white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampErrors {
    /// Height of a sawtooth, nanoseconds, and its period, seconds: a clock that is steered in
    /// steps.
    pub sawtooth_ns: f64,
    pub sawtooth_s: f64,
    /// Standard deviation of a wander, nanoseconds, and the time over which it is correlated,
    /// seconds.
    pub wander_ns: f64,
    pub wander_s: f64,
    /// Step to which they are cut, nanoseconds; 0: to none.
    pub step_ns: f64,
}

impl Default for StampErrors {
    /// None, with the times that they would have.
    fn default() -> Self {
        Self {
            sawtooth_ns: 0.0,
            sawtooth_s: 1.0,
            wander_ns: 0.0,
            wander_s: 0.5,
            step_ns: 0.0,
        }
    }
}

/// The rolling-shutter camera and its video.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraConfig {
    /// Frame period, in nanoseconds of the phone's clock.
    pub frame_period_ns: f64,
    /// Exposure of each row, nanoseconds.
    pub exposure_ns: u64,
    /// From the start of exposure of one row to that of the next, nanoseconds.
    pub row_time_ns: f64,
    /// Sensor rows that are read.
    pub rows: usize,
    /// Pixels in a rendered row. Few are enough where light falls evenly, and
    /// they are cheap.
    pub columns: usize,
    /// Longest exposure, nanoseconds: each recording has one between
    /// [`CameraConfig::exposure_ns`] and this, even in its logarithm, as the light is.
    pub longest_exposure_ns: u64,
    /// Share of a longer exposure by which the frame period grows.
    pub period_of_exposure: f64,
    /// Share of the frames that get lost before the app, 0 to 1, and the number lost at a time.
    pub lost: f64,
    pub lost_at_once: u32,
    /// The exposure swings by this share of itself, to and fro in [`EXPOSURE_SWING`] frames.
    pub exposure_swing: f64,
    /// Period of the frames while it is dark, nanoseconds, where the rate is automatic: for
    /// [`DARK`] frames of each [`DARK_EVERY`]. 0: it is not.
    pub dark_period_ns: f64,
    /// Share of the frames that the app gets twice, with one timestamp.
    pub doubled: f64,
    /// The frames are stamped with `CLOCK_MONOTONIC`, as by most cameras whose
    /// `SENSOR_INFO_TIMESTAMP_SOURCE` is `UNKNOWN`.
    pub is_on_monotonic: bool,
    /// White noise on the frame timestamps, standard deviation in nanoseconds.
    pub timestamp_jitter_ns: f64,
    /// Shortest and longest time from the start of a recording to its first
    /// frame, milliseconds.
    pub first_frame_ms: (f64, f64),
    /// True if the app gets timestamps of frames at all (its sync recording is
    /// switched on). Without them `video_start` fails after 10 s.
    pub reports_frames: bool,
    /// True if a [`ball`](crate::picture::ball) swings before the camera.
    pub ball: bool,
}

/// Frames in which an exposure that changes goes to and fro.
pub(super) const EXPOSURE_SWING: usize = 1_800;

/// Number of frames of which the last [`DARK`] are in the dark.
pub(super) const DARK_EVERY: usize = 900;
pub(super) const DARK: usize = 60;

impl PhoneConfig {
    /// A phone as in the published rig, with details drawn from `seed`: clock up
    /// to ±50 ppm and one to thirty hours after boot, gyroscope mounted at
    /// random, 1 µs of timestamp jitter.
    #[must_use]
    pub fn draw(seed: Seed) -> Self {
        let mut random = seed.stream(Stream::PhoneConfig);
        let r = &mut random;
        let clock = OscillatorConfig {
            offset_ns: r.uniform(3_600e9, 108_000e9) as i64,
            rate_ppm: r.uniform(-50.0, 50.0),
            wander: 1e-9,
            ..OscillatorConfig::default()
        };
        let rotation = rotation(r);
        let gyroscope = SensorConfig {
            rate_hz: 500.0 * (1.0 + r.uniform(-0.01, 0.01)),
            channel: ChannelConfig {
                rotation,
                scale_error: each(r, 0.01),
                bias: each(r, 0.02),
                bias_walk: 1e-5,
                // 3.8 mdps/√Hz: typical of the gyroscopes in phones.
                noise_density: 6.6e-5,
            },
            low_pass: LowPass {
                bandwidth_hz: 150.0,
                delay_s: 2.2e-3,
            },
            // 70 mdps: 2,000 deg/s full scale in 16 bits.
            step: 0.07_f64.to_radians(),
            timestamp_jitter_ns: 1_000.0,
            stamps: StampErrors::default(),
        };
        let accelerometer = SensorConfig {
            channel: ChannelConfig {
                rotation,
                scale_error: each(r, 0.01),
                bias: each(r, 0.1),
                bias_walk: 0.0,
                noise_density: 9e-4,
            },
            // 0.244 mg: 8 g full scale in 16 bits.
            step: 0.244e-3 * crate::motion::STANDARD_GRAVITY,
            ..gyroscope.clone()
        };
        // Unused, and drawn all the same: a seed keeps its phone.
        let _ = [0; 7].map(|_| r.bits());
        let camera = CameraConfig::draw(r);
        let app = AppConfig {
            stop_ms: r.uniform(0.0, 2_000.0),
            ticked: [true; 3],
            storage: StorageAccess::Files,
        };
        Self {
            seed,
            version: "v.0.1.1".to_owned(),
            clock,
            gyroscope,
            accelerometer,
            camera,
            app,
            video: VideoMode::OnRequest,
            storage: None,
            video_name: None,
            slept_ns: 0,
        }
    }

    /// Time of the sensors' clock minus that of the frames' clock, ns.
    pub(super) const fn frames_behind_ns(&self) -> i64 {
        if self.camera.is_on_monotonic {
            self.slept_ns
        } else {
            0
        }
    }
}

impl CameraConfig {
    fn draw(r: &mut Random) -> Self {
        Self {
            // The published rig's phone: 33,330,652.54 ns.
            frame_period_ns: 33_330_652.54 + r.uniform(-2_000.0, 2_000.0),
            exposure_ns: 500_000,
            longest_exposure_ns: 0,
            period_of_exposure: 0.0,
            lost: 0.0,
            lost_at_once: 1,
            exposure_swing: 0.0,
            dark_period_ns: 0.0,
            doubled: 0.0,
            is_on_monotonic: false,
            row_time_ns: 10_200.0,
            rows: 1080,
            columns: 64,
            timestamp_jitter_ns: 1_000.0,
            first_frame_ms: (250.0, 700.0),
            reports_frames: true,
            ball: false,
        }
    }

    /// The same camera at a size that is looked at, with something to look at: fewer rows,
    /// which take as long as all.
    pub fn show_ball(&mut self) {
        let readout = self.readout_ns();
        (self.columns, self.rows) = crate::picture::ball::PHONE_SIZE;
        self.row_time_ns = readout / (self.rows as f64 - 1.0);
        self.ball = true;
    }

    /// From the timestamp of a frame (start of exposure of its first row) to the
    /// middle of exposure of its middle row, nanoseconds of the phone's clock.
    #[must_use]
    pub fn middle_offset_ns(&self) -> f64 {
        0.5 * (self.rows as f64 - 1.0) * self.row_time_ns + 0.5 * self.exposure_ns as f64
    }

    /// The exposure is the same in all recordings and frames, and so is the rate of the frames.
    #[must_use]
    pub fn is_exposure_locked(&self) -> bool {
        let is_constant = self.longest_exposure_ns <= self.exposure_ns;
        is_constant && self.exposure_swing == 0.0 && self.dark_period_ns == 0.0
    }

    /// From the start of exposure of the first row to that of the last.
    #[must_use]
    pub fn readout_ns(&self) -> f64 {
        (self.rows as f64 - 1.0) * self.row_time_ns
    }
}

/// Three values between `-most` and `most`.
fn each(r: &mut Random, most: f64) -> [f64; 3] {
    [0; 3].map(|_| r.uniform(-most, most))
}
