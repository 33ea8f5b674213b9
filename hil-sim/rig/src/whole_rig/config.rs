//! Everything around the board: which parts there are, and how they behave.
//!
//! A [`RigConfig`] is plain data. [`RigConfig::build`] draws what it
//! stands for, and [`RigParts::wire`] wires it to the board.

use std::sync::Arc;

use crate::clocks::oscillator::{BoardTime, OscillatorConfig};
use crate::clocks::true_clock::TrueClock;
use crate::depth_camera::flash_log::FlashLog;
use crate::depth_camera::{DepthCamera, DepthCameraConfig};
use crate::imu::{SensorModel, SimImu, SimImuConfig};
use crate::led::{Led, LedConfig};
use crate::motion::{Motion, MotionSpec};
use crate::phone::Surroundings;
use crate::random::{Seed, Stream};
use crate::wiring::BoardKind;
use stm32f4_sim::shared::Shared;
use stm32f4_sim::sim::SimBuilder;

/// The parts around the board, as plain data.
#[derive(Clone, Debug, PartialEq)]
pub struct RigConfig {
    /// Seed of everything random.
    pub seed: Seed,
    /// The board.
    pub board: BoardKind,
    /// Motion of the rig.
    pub motion: MotionSpec,
    /// The board's crystal.
    pub board_clock: OscillatorConfig,
    /// The IMU on the board's I2C bus.
    pub imu: Option<SimImuConfig>,
    /// The depth camera on the trigger and strobe pins.
    pub depth_camera: Option<DepthCameraConfig>,
    /// The LED before the phone's lens.
    pub led: Option<LedConfig>,
}

impl RigConfig {
    /// The published rig at rest: an MPU-9150 and an Azure Kinect, with the
    /// tolerances of real parts drawn from the seed. The board's crystal is off
    /// by up to 30 ppm, the camera's clock by up to 400 ppm.
    #[must_use]
    pub fn published(seed: Seed) -> Self {
        let mut random = seed.stream(Stream::Rig);
        let board_clock = OscillatorConfig {
            offset_ns: 0,
            rate_ppm: random.uniform(-30.0, 30.0),
            wander: 1e-9,
            ..OscillatorConfig::default()
        };
        let camera_clock = OscillatorConfig {
            offset_ns: random.uniform(1e9, 600e9) as i64,
            rate_ppm: random.uniform(-400.0, 400.0),
            wander: 1e-9,
            ..OscillatorConfig::default()
        };
        Self {
            seed,
            board: BoardKind::default(),
            motion: MotionSpec::default(),
            board_clock,
            imu: Some(SimImuConfig::typical(seed)),
            depth_camera: Some(DepthCameraConfig {
                clock: camera_clock,
                ..DepthCameraConfig::default()
            }),
            led: None,
        }
    }

    /// Returns the same rig with another motion.
    #[must_use]
    pub fn with_motion(mut self, motion: MotionSpec) -> Self {
        self.motion = motion;
        self
    }

    /// From the trigger's edge to the centre of the depth exposure as the rig's owner
    /// measures it with the board, in the board's µs: the camera counts it on its own clock.
    #[must_use]
    pub fn center_offset_us(&self) -> Option<f64> {
        let camera = self.depth_camera?;
        let board = 1.0 + self.board_clock.rate_ppm * 1e-6;
        let rate = board / (1.0 + camera.clock.rate_ppm * 1e-6);
        Some(camera.center_delay_ns() * 1e-3 * rate)
    }

    /// Returns the same rig with another IMU.
    #[must_use]
    pub fn with_imu(mut self, model: SensorModel) -> Self {
        self.imu = self.imu.map(|imu| imu.with_model(model));
        self
    }

    /// Draws the parts.
    #[must_use]
    pub fn build(self) -> RigParts {
        let seed = self.seed;
        let motion = self.motion.build(seed.stream(Stream::Motion));
        let board = BoardTime::new(self.board_clock, seed.stream(Stream::BoardClock));
        let imu = self
            .imu
            .map(|config| SimImu::new(config, Arc::clone(&motion), board.clone(), seed).shared());
        let flashes = FlashLog::default();
        let depth_camera = self.depth_camera.map(|config| {
            let camera = DepthCamera::new(config, board.clone(), seed);
            Arc::new(std::sync::Mutex::new(
                camera.with_flash_log(flashes.clone()),
            ))
        });
        RigParts {
            config: self,
            motion,
            board,
            imu,
            depth_camera,
            flashes,
            led: FlashLog::default(),
        }
    }
}

/// The parts around the board. Clones are handles to the same parts.
#[derive(Clone, Debug)]
pub struct RigParts {
    /// Their configuration.
    pub config: RigConfig,
    /// Motion of the rig.
    pub motion: Arc<Motion>,
    /// Relation of the board's time to true time.
    pub board: BoardTime,
    /// The IMU.
    pub imu: Option<Shared<SimImu>>,
    /// The depth camera.
    pub depth_camera: Option<Shared<DepthCamera>>,
    /// The camera's flashes, for the cameras that see them.
    pub flashes: FlashLog,
    /// Those of the LED.
    pub led: FlashLog,
}

impl RigParts {
    /// Returns the surroundings of a phone on the rig, from power-on.
    pub(crate) fn surroundings(&self) -> Surroundings {
        Surroundings {
            clock: TrueClock::new(),
            motion: Arc::clone(&self.motion),
            light: [self.flashes.clone(), self.led.clone()],
        }
    }

    /// Wires all parts to the board, and gives it the seed.
    #[must_use]
    pub fn wire(&self, mut board: SimBuilder) -> SimBuilder {
        board = board.seed(self.config.seed);
        if let Some(imu) = &self.imu {
            board = board.model(Arc::clone(imu)).i2c_target(Arc::clone(imu));
        }
        if let Some(camera) = &self.depth_camera {
            board = board.model(Arc::clone(camera));
        }
        if let Some(config) = self.config.led {
            board = board.model(Led::new(config, self.board.clone(), self.led.clone()));
        }
        board
    }
}
