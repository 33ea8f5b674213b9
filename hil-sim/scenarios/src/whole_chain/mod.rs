//! Checks of the whole chain: real firmware, phone, depth camera and a session
//! of `smartdepthsync record` on the simulated rig; then `extract` or `evaluate`
//! on what it has left, as processes; and every result against the truth.
//!
//! Nothing is handed from the simulator to the programs but what a real rig
//! gives: the board's port, the phone's port and files, the depth recorder's
//! file, and the owner's profile. The depth recording is written after the
//! session from the frames that the camera delivered, as its recorder would
//! have written it had it been started before the board was powered.
//!
//! All figures that come out of here are of simulated recordings.

pub mod believed;
pub mod calibration;
mod cameras;
pub mod evaluation;
pub mod extraction;
pub mod several;

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use protocol::Ticks;
use recording::session_file::SessionFile;
use serde_json::Value;

use crate::demo::judge::{Timebase, Truth, read_streams};
use crate::programs::{Programs, said};
use rig::depth_camera::Family;
use rig::imu::SensorModel;
use rig::k4a_mkv::{self, K4aSettings};
use rig::model_ranges::ModelValues;
use rig::motion::gesture::Gesture;
use rig::motion::{MotionSpec, Step};
use rig::oscillator::{BoardTime, Oscillator, TrueTime};
use rig::owner_profile::owner_profile;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::rig_config::RigConfig;
use rig::running_rig::RunningRig;
use rig::wiring::{self, BoardKind};
use stm32f4_sim::time::{SimDuration, SimTime, UNITS_PER_NANO};

/// How long the rig is twisted at first, seconds: the session connects, and
/// then needs 9 s of it.
const TWIST_S: f64 = 45.0;
/// Between two twists of a session, and how much longer it is twisted for each, seconds.
const GAP_S: u32 = 20;
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
    /// By how much the camera flashes later than the owner's profile says.
    pub hidden_delay: SimDuration,
    /// Twists before the recording.
    pub twists: u32,
    /// Which board.
    pub board: BoardKind,
    /// Which IMU on it.
    pub imu: SensorModel,
    /// Which depth camera.
    pub camera: Family,
    /// What is true of the rig.
    pub beliefs: ModelValues,
    /// Whether a [`ball`](rig::ball) swings before the phone's camera.
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
            beliefs: ModelValues::default(),
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
            *camera = self.camera.of(*camera, seed);
        }
        let mut phone = PhoneConfig::draw(seed);
        self.beliefs.apply(&mut rig, &mut phone);
        if self.ball {
            phone.camera.show_ball();
        }
        (rig, phone)
    }
}

/// A recording of the whole chain, with its truth.
#[derive(Debug)]
pub struct Recorded {
    /// Its folder.
    pub folder: PathBuf,
    /// Folder of the phone's files.
    pub phone: PathBuf,
    /// The profile that it was made with.
    pub profile: PathBuf,
    /// What the session says.
    pub session: SessionFile,
    /// The truth.
    pub truth: Truth,
    /// The relation of board time to the recording's ticks, exact.
    pub base: Timebase,
    /// All pulses of the recording, in order.
    pub pulses: Vec<Ticks>,
}

impl Recorded {
    /// What a session has left in `folder`.
    pub(crate) fn of(
        folder: PathBuf,
        phone: PathBuf,
        profile: PathBuf,
        truth: Truth,
    ) -> Result<Self> {
        let (pulses, _) = read_streams(&folder)?;
        Ok(Self {
            session: SessionFile::load(&folder)?,
            base: truth.timebase.refined(&pulses, &truth.depth)?,
            folder,
            phone,
            profile,
            truth,
            pulses,
        })
    }

    /// Writes the depth recording of the frames in the truth, as small images that
    /// name their frame: what is in them is tested elsewhere.
    fn write_depth(&self) -> Result<()> {
        let path = self.folder.join("depth.mkv");
        let cannot = || format!("cannot write {}", path.display());
        let file = BufWriter::new(File::create(&path).with_context(cannot)?);
        let frames = &self.truth.depth;
        k4a_mkv::write_frames(file, K4aSettings::small(), frames, |number, pixels| {
            for (index, pixel) in (0_u64..).zip(pixels.iter_mut()) {
                *pixel = (500 + (number * 131 + index * 7) % 12_000) as u16;
            }
        })
        .with_context(cannot)?;
        Ok(())
    }
}

/// Makes a recording under `out`.
///
/// A session's patience with the phone is real time, and virtual time stands still
/// with a machine that is busy with other things: a session that fails is tried
/// once more, and said.
///
/// # Errors
///
/// The rig cannot be built, the session fails twice, or its recording cannot be
/// read.
pub fn record(plan: &Plan, programs: &Programs, out: &Path) -> Result<Recorded> {
    match attempt(plan, programs, out) {
        Ok(recorded) => Ok(recorded),
        Err(error) => {
            eprintln!("{}: once more, after {error:#}", plan.name);
            attempt(plan, programs, out)
        }
    }
}

fn attempt(plan: &Plan, programs: &Programs, out: &Path) -> Result<Recorded> {
    let run = out.join(&plan.name);
    if run.exists() {
        std::fs::remove_dir_all(&run)
            .with_context(|| format!("cannot remove the former {}", run.display()))?;
    }
    std::fs::create_dir_all(&run).with_context(|| format!("cannot make {}", run.display()))?;
    // What the owner has measured; what is hidden from him comes on top.
    let (known, mut phone) = plan.parts();
    let mut config = known.clone();
    if let Some(camera) = &mut config.depth_camera {
        camera.flash_delay = camera.flash_delay + plan.hidden_delay;
    }
    let storage = run.join("phone");
    phone.storage = Some(storage.clone());
    let board = wiring::board_of(plan.board, programs.elf.as_deref());
    let rig = RunningRig::start(config, board, Some((phone, 0)), programs.pace())?;
    let text = owner_profile(
        &known,
        &[rig.phone().context("the rig has no phone")?.handset()],
    )?;
    let text = match &plan.profile {
        None => text + &cameras::profile_lines(plan.camera, programs, &run)?,
        Some(path) => moved(path, &text)?,
    };
    let length = Length {
        seconds: plan.seconds,
        twists: plan.twists,
    };
    let recorded = session(rig, programs, &text, &run, storage, length)
        .with_context(|| format!("seed {}", plan.seed))?;
    match plan.camera.writes_mkv() {
        true => recorded.write_depth()?,
        false => cameras::write_bag(&recorded.folder.join("depth"), &recorded.truth.depth)?,
    }
    Ok(recorded)
}

/// How long a session is.
struct Length {
    /// Seconds of board time to record.
    seconds: u32,
    /// Twists before that.
    twists: u32,
}

/// Runs one session of a rig, with `profile` as its profile and `phone` as the folder
/// of the phone's files, into the folder `recording` under `out`. The depth recording
/// is not written yet.
fn session(
    rig: RunningRig,
    programs: &Programs,
    profile: &str,
    out: &Path,
    phone: PathBuf,
    length: Length,
) -> Result<Recorded> {
    let path = out.join("rig.toml");
    std::fs::write(&path, profile).with_context(|| format!("cannot write {}", path.display()))?;
    let mut command = programs.record(rig.port(), &path, out, "recording");
    command
        .arg("--fetch-video")
        .args(["--duration", &format!("{}s", length.seconds)])
        .args(["--twists", &length.twists.to_string()])
        .args(["--twist-gap", &format!("{GAP_S}s")]);
    let output = programs.output(&mut command)?;
    if !output.status.success() {
        // A board that has died is the reason for whatever the session says.
        rig.stop().context("the simulated rig")?;
        bail!("the session failed: {}", said(&output));
    }
    let folder = out.join("recording");
    let truth = Truth::of(rig.stop().context("the simulated rig")?)?;
    Recorded::of(folder, phone, path, truth)
}

/// The profile at `path` with the phone's address of the new profile: a phone is
/// given another one each day.
fn moved(path: &Path, new: &str) -> Result<String> {
    let old =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let is_address = |line: &&str| line.starts_with("address");
    let address = new
        .lines()
        .find(is_address)
        .context("the new profile has no address")?;
    let mut text = String::new();
    for line in old.lines() {
        text += if is_address(&line) { address } else { line };
        text.push('\n');
    }
    Ok(text)
}

/// Runs `smartdepthsync` with `--json` and gives what it prints. Exit code 4,
/// finished with loss, is an answer too.
pub(crate) fn ask(programs: &Programs, arguments: &[&str], paths: &[&Path]) -> Result<Value> {
    let mut command = programs.tool();
    let output = programs.output(command.arg("--json").args(arguments).args(paths))?;
    if !matches!(output.status.code(), Some(0 | 4)) {
        bail!("smartdepthsync {arguments:?} failed: {}", said(&output));
    }
    serde_json::from_slice(&output.stdout)
        .with_context(|| format!("smartdepthsync {arguments:?} printed no JSON"))
}

/// A number of a JSON answer.
fn number(json: &Value, key: &str) -> Result<f64> {
    json[key]
        .as_f64()
        .with_context(|| format!("the answer has no number {key}"))
}

impl Recorded {
    /// Board time as the recording counts it, ns, of an instant of board time.
    fn nanos(&self, at: SimTime) -> i64 {
        let zero = self.base.time(Ticks(0));
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
