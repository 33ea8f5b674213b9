//! Checks of the whole chain: real firmware, phone, depth camera and a session
//! on virtual time ([`crate::virtual_session`]); then `extract` or `evaluate`
//! on what it has left, as processes; and every result against the ground truth.
//!
//! Nothing is handed from the simulator to session and programs but what a real rig
//! gives: the board's link, the phone's answers and files, the depth recorder's
//! file, and the owner's profile. The depth recording is written after the
//! session from the frames that the camera delivered, as its recorder would
//! have written it had it been started before the board was powered.
//!
//! All figures that come out of here are of simulated recordings.

mod cameras;
pub mod evaluation;
pub mod extraction;
pub mod ranges;
pub mod several;

use std::path::{Path, PathBuf};

use ::session::options::{Options, seconds};
use anyhow::{Context, Result};
use protocol::Ticks;
use recording::profile::Profile;
use recording::session_file::SessionFile;
use serde_json::Value;

use crate::judge::{Truth, read_streams};
use crate::programs::Programs;
use crate::virtual_session::{SessionBench, write_frames};
use rig::clocks::oscillator::{BoardTime, Oscillator, TrueTime};
use rig::depth_camera::Family;
use rig::imu::SensorModel;
use rig::model_ranges::ModelValues;
use rig::motion::gesture::Gesture;
use rig::motion::{MotionSpec, Step};
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use rig::wiring::{self, BoardKind};
use stm32f4_sim::time::{SimDuration, SimTime, UNITS_PER_NANO};

/// Length of the first twist, seconds: the session connects, and
/// then needs 9 s of it.
const TWIST_S: f64 = 45.0;
/// Between two twists of a session, and how much longer it is twisted for each, seconds.
const GAP_S: u64 = 20;
const MORE_TWIST_S: f64 = 35.0;

/// One recording that is to be made.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The one seed of all randomness.
    pub seed: u64,
    /// Seconds of board time to record.
    pub seconds: u32,
    /// Name of its folder.
    pub name: String,
    /// Share of the depth frames that get lost on the way to the computer.
    pub drop_probability: f64,
    /// By how much the camera flashes later than the owner's profile says. No photodiode is there
    /// to show it.
    pub hidden_delay: SimDuration,
    /// Twists before the recording.
    pub twists: u32,
    /// The board.
    pub board: BoardKind,
    /// The IMU on it.
    pub imu: SensorModel,
    /// The depth camera.
    pub camera: Family,
    /// Values of the rig's models.
    pub values: ModelValues,
    /// True if a [`ball`](rig::picture::ball) swings before the phone's camera.
    pub ball: bool,
    /// A profile of the same rig from an earlier session, with what was learnt
    /// and calibrated since; the owner's first one if not given.
    pub profile: Option<PathBuf>,
}

impl Plan {
    /// A recording with nothing wrong.
    #[must_use]
    pub fn new(seed: u64, seconds: u32) -> Self {
        Self {
            seed,
            seconds,
            name: format!("seed_{seed}"),
            drop_probability: 0.0,
            hidden_delay: SimDuration::ZERO,
            twists: 1,
            board: BoardKind::default(),
            imu: SensorModel::default(),
            camera: Family::default(),
            values: ModelValues::default(),
            ball: false,
            profile: None,
        }
    }

    /// The rig, without what is hidden from its owner, and the phone on it.
    fn parts(&self) -> (RigConfig, PhoneConfig) {
        let seed = Seed(self.seed);
        let step = |gesture, seconds| Step { gesture, seconds };
        let twisted = TWIST_S + f64::from(self.twists.saturating_sub(1)) * MORE_TWIST_S;
        let motion = MotionSpec(vec![
            step(Gesture::Twist, Some(twisted)),
            step(Gesture::Walk, None),
        ]);
        let mut rig = RigConfig::published(seed)
            .with_motion(motion)
            .with_imu(self.imu);
        rig.board = self.board;
        if let Some(camera) = &mut rig.depth_camera {
            camera.drop_probability = self.drop_probability;
            *camera = self.camera.specimen(*camera, seed);
        }
        let mut phone = PhoneConfig::draw(seed);
        self.values.apply(&mut rig, &mut phone);
        if self.ball {
            phone.camera.show_ball();
        }
        (rig, phone)
    }
}

/// A recording of the whole chain, with its ground truth.
#[derive(Debug)]
pub struct Recorded {
    /// Its folder.
    pub folder: PathBuf,
    /// Folder of the phone's files.
    pub phone: PathBuf,
    /// The profile that it was made with.
    pub profile: PathBuf,
    /// The session's file.
    pub session: SessionFile,
    /// The ground truth.
    pub truth: Truth,
    /// All pulses of the recording, in order.
    pub pulses: Vec<Ticks>,
}

impl Recorded {
    /// The files of a session in `folder`.
    pub(crate) fn new(
        folder: PathBuf,
        phone: PathBuf,
        profile: PathBuf,
        truth: Truth,
    ) -> Result<Self> {
        let (pulses, _) = read_streams(&folder)?;
        Ok(Self {
            session: SessionFile::load(&folder)?,
            folder,
            phone,
            profile,
            truth,
            pulses,
        })
    }

    /// Writes the depth recording of the frames in the ground truth, as small images that
    /// name their frame: what is in them is tested elsewhere.
    fn write_depth(&self) -> Result<()> {
        let path = self.folder.join("depth.mkv");
        write_frames(&path, &self.truth.depth)
            .with_context(|| format!("cannot write {}", path.display()))
    }
}

/// Makes a recording under `out`.
///
/// # Errors
///
/// The rig cannot be built, the session fails or finishes with loss, or its recording cannot
/// be read.
pub fn record(plan: &Plan, programs: &Programs, out: &Path) -> Result<Recorded> {
    let run = new_folder(&out.join(&plan.name))?;
    let (known, mut phone) = plan.parts();
    let mut config = known.clone();
    if let Some(camera) = &mut config.depth_camera {
        camera.flash_delay = camera.flash_delay + plan.hidden_delay;
        camera.photodiode &= plan.hidden_delay == SimDuration::ZERO;
    }
    let storage = run.join("phone");
    phone.storage = Some(storage.clone());
    let board = wiring::board_of(plan.board, programs.elf.as_deref());
    let mut bench = SessionBench::new(config, board, vec![phone], &[], &run)?;
    match &plan.profile {
        Some(path) => bench.profile = Profile::load(path)?,
        None => {
            let depth = &mut bench.profile.depth;
            // What the owner has measured; what is hidden from him comes on top.
            depth.center_offset_us = known.center_offset_us().context("no depth camera")?;
            cameras::into_profile(depth, plan.camera, programs, &run)?;
        }
    }
    let mut options = bench.options("recording");
    options.duration = Some(seconds(plan.seconds.into()));
    options.fetch_video = true;
    options.twists = plan.twists;
    options.twist_gap = seconds(GAP_S);
    let recorded =
        session(bench, &options, storage).with_context(|| format!("seed {}", plan.seed))?;
    if plan.camera.writes_mkv() {
        recorded.write_depth()?
    } else {
        cameras::write_bag(&recorded.folder.join("depth"), &recorded.truth.depth)?
    }
    Ok(recorded)
}

/// A folder that is empty, in the place of a former one.
pub(crate) fn new_folder(path: &Path) -> Result<PathBuf> {
    if path.exists() {
        std::fs::remove_dir_all(path)
            .with_context(|| format!("cannot remove the former {}", path.display()))?;
    }
    std::fs::create_dir_all(path).with_context(|| format!("cannot make {}", path.display()))?;
    Ok(path.to_owned())
}

/// Runs one session of a rig, which is then switched off, with `phone` as the folder of the
/// phone's files. Its profile is in `rig.toml` beside the recording. The depth recording is
/// not written yet.
fn session(mut bench: SessionBench, options: &Options, phone: PathBuf) -> Result<Recorded> {
    let profile = bench.write_profile()?;
    let run = bench.run(options);
    // A board that has failed is the reason for all that the session reports.
    let truth = bench.stop()?;
    let ended = run.good()?;
    Recorded::new(ended.folder, phone, profile, Truth::from_run(truth)?)
}

/// A number of a JSON answer.
pub(crate) fn number(json: &Value, key: &str) -> Result<f64> {
    json[key]
        .as_f64()
        .with_context(|| format!("the answer has no number {key}"))
}

impl Recorded {
    /// Board time as the recording counts it, ns, of an instant of board time.
    fn nanos(&self, at: SimTime) -> i64 {
        let zero = self.truth.timebase.time(Ticks(0));
        let units = i128::from(at.units()) - i128::from(zero.units());
        i64::try_from(units / i128::from(UNITS_PER_NANO)).unwrap_or(i64::MAX)
    }

    /// The same of an instant of the phone's clock, ns.
    fn nanos_of_phone(&self, phone: &Oscillator, phone_ns: i64) -> Result<i64> {
        let at: TrueTime = phone
            .when_nanos(phone_ns)
            .context("a phone time before power-on")?;
        let board: &BoardTime = &self.truth.board;
        Ok(self.nanos(board.board_at(at)))
    }
}
