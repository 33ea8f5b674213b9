//! A rig of several sensors: two phones, the depth camera, other cameras on the
//! trigger outputs 2 to 4, and a lidar. One session records all, one extraction puts
//! all into board time, and each is judged against the ground truth: the phones' frames and
//! the depth frames in µs, the pulses and the seconds of the lidar to the tick.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use ::session::options::seconds;
use anyhow::{Context, Result, ensure};
use protocol::TICK_HZ;
use recording::profile::Profile;
use serde::Serialize;
use serde_json::Value;

use super::extraction::{DEPTH_LIMIT_US, Errors, depth_frames, phone_frames};
use super::extraction::{table, whole};
use super::{Recorded, new_folder, session};
use crate::judge::{OtherVerdict, Verdict};
use crate::programs::{Programs, ask};
use crate::virtual_session::SessionBench;
use rig::lidar::{Lidar, LidarConfig, LidarFaults};
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use rig::wiring;
use rig::wiring::pin_log::PinLog;
use stm32f4_sim::pin::Pin;
use stm32f4_sim::shared::lock;

/// Largest error of a phone frame's time after a strong twist, µs.
const PHONE_LIMIT_US: f64 = 10.0;

/// Names of the phones; the trigger is aligned to the first.
pub(crate) const PHONES: [&str; 2] = ["left phone", "right phone"];

/// Names, pins and settings of the cameras on the auxiliary outputs: number, pulses of
/// the trigger to one, µs later.
const CAMERAS: [(&str, Pin, u8, u32, f64); 3] = [
    ("slow", wiring::OUTPUTS[0], 2, 6, 0.0),
    ("side", wiring::OUTPUTS[1], 3, 1, 160.0),
    ("top", wiring::OUTPUTS[2], 4, 2, 8_000.5),
];

/// Time after the recorded span at which the depth recorder has stopped, ticks.
const RECORDER_STOPS: u64 = TICK_HZ as u64;

/// Difference between the phones' seeds.
const NEXT_SEED: u64 = 1_000;

/// One rig and how long it records.
#[derive(Clone, Debug)]
pub struct SeveralPlan {
    /// The one seed of all randomness.
    pub seed: u64,
    /// Seconds of board time to record.
    pub seconds: u32,
    /// Small pictures, where videos are not what is looked at.
    pub small: bool,
}

/// A phone against the ground truth.
#[derive(Clone, Debug, Serialize)]
pub struct PhoneFigures {
    /// Its name in the profile.
    pub name: String,
    /// Starts of exposure of its frames.
    pub start: Errors,
    /// Middles of exposure of their middle rows.
    pub middle: Errors,
    /// Largest 1-sigma that the report states for its times, µs.
    pub sigma_us: f64,
    /// Depth images minus its frames at the beginning, as extracted, µs.
    pub grid_offset_us: f64,
    /// The same minus the true value, µs.
    pub grid_error_us: f64,
    /// Their drift, as extracted, µs/min.
    pub grid_drift_us_per_min: f64,
}

/// A camera on an auxiliary output against the ground truth.
#[derive(Clone, Debug, Serialize)]
pub struct OutputFigures {
    /// Its name in the profile.
    pub name: String,
    /// Its pulses, each of which was compared with the edge at the pin.
    pub pulses: usize,
    /// Pulses that are not at the tick of their edge.
    pub off: usize,
    /// Edges between the first and the last pulse that are not in the file.
    pub missing: usize,
}

/// The lidar against the ground truth.
#[derive(Clone, Debug, Serialize)]
pub struct LidarFigures {
    /// Seconds in the file.
    pub seconds: usize,
    /// Those that are not at the tick of their edge at the lidar's pin.
    pub off: usize,
    /// Those with another UTC than the lidar was sent.
    pub other_utc: usize,
    /// Errors on the lidar's inputs.
    pub faults: LidarFaults,
}

/// The figures.
#[derive(Clone, Debug, Serialize)]
pub struct SeveralFigures {
    /// Simulated: always true.
    pub simulated: bool,
    /// The seed.
    pub seed: u64,
    /// Seconds of board time that were recorded.
    pub recorded_s: f64,
    /// The phones, the reference first.
    pub phones: Vec<PhoneFigures>,
    /// The session's statements about the other phones.
    pub session: Vec<OtherVerdict>,
    /// Frame sync of the reference phone: depth minus phone at the beginning, µs.
    pub phase_us: f64,
    /// Centres of exposure of the depth frames.
    pub depth: Errors,
    /// The cameras on the auxiliary outputs.
    pub outputs: Vec<OutputFigures>,
    /// The lidar.
    pub lidar: LidarFigures,
    /// Messages lost on the link, and frames without a partner.
    pub lost: u64,
    /// The recording.
    #[serde(skip)]
    pub recording: PathBuf,
    /// The data set.
    #[serde(skip)]
    pub data: PathBuf,
}

impl SeveralFigures {
    /// Returns true if all errors are within the limits: phones and depth camera in µs, what the
    /// board itself makes to the tick.
    #[must_use]
    pub fn good(&self) -> bool {
        let phones = self.phones.iter().all(|phone| {
            phone.start.largest_us <= PHONE_LIMIT_US && phone.middle.largest_us <= PHONE_LIMIT_US
        });
        let outputs = self
            .outputs
            .iter()
            .all(|output| output.pulses > 0 && output.off == 0 && output.missing == 0);
        let lidar = &self.lidar;
        phones
            && outputs
            && self.depth.largest_us <= DEPTH_LIMIT_US
            && lidar.seconds > 0
            && lidar.off + lidar.other_utc == 0
            && lidar.faults == LidarFaults::default()
    }

    /// As text.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = format!(
            "Several sensors, simulated: seed {}, {:.0} s recorded, {} lost\n",
            self.seed, self.recorded_s, self.lost
        );
        for phone in &self.phones {
            text += &format!(
                "{:<14} {:>5} frames, middle of exposure rms {:.2} µs, at most {:.2} µs \
                 (limit {PHONE_LIMIT_US} µs; stated {:.2} µs, 1 σ)\n{:<14} depth minus phone {:+.1} µs \
                 (error {:+.2} µs), drifting by {:+.1} µs/min\n",
                phone.name,
                phone.middle.count,
                phone.middle.rms_us,
                phone.middle.largest_us,
                phone.sigma_us,
                "",
                phone.grid_offset_us,
                phone.grid_error_us,
                phone.grid_drift_us_per_min,
            );
        }
        text += &format!(
            "{:<14} {:>5} frames, centre of exposure rms {:.2} µs, at most {:.2} µs (limit \
             {DEPTH_LIMIT_US} µs)\n",
            "depth camera", self.depth.count, self.depth.rms_us, self.depth.largest_us
        );
        for output in &self.outputs {
            text += &format!(
                "{:<14} {:>5} pulses compared with the pin, {} not at their tick, {} missing\n",
                output.name, output.pulses, output.off, output.missing
            );
        }
        text += &format!(
            "{:<14} {:>5} seconds compared with the lidar, {} not at their tick, {} with another \
             UTC, {}\n",
            "lidar",
            self.lidar.seconds,
            self.lidar.off,
            self.lidar.other_utc,
            if self.lidar.faults == LidarFaults::default() {
                String::from("no fault on its inputs")
            } else {
                format!("{:?}", self.lidar.faults)
            }
        );
        text
    }
}

/// Records, extracts and judges; everything lies below `out` then. What is done next
/// is reported with `progress`.
///
/// # Errors
///
/// A step fails, or a frame has a wrong pulse.
pub fn run(
    plan: &SeveralPlan,
    programs: &Programs,
    out: &Path,
    progress: impl Fn(&str),
) -> Result<SeveralFigures> {
    new_folder(out)?;
    let motion = MotionSpec::always(Gesture::Twist);
    let config = RigConfig::published(Seed(plan.seed)).with_motion(motion);
    let phones = (0_u64..).zip(PHONES).map(|(number, name)| {
        let mut phone = PhoneConfig::draw(Seed(plan.seed + NEXT_SEED * number));
        if plan.small {
            phone.camera.rows = 120;
            phone.camera.columns = 16;
        }
        phone.storage = Some(out.join("phones").join(name));
        phone
    });
    let lidar = Arc::new(Mutex::new(Lidar::new(LidarConfig::default())));
    let pins = Arc::new(Mutex::new(PinLog::new(&CAMERAS.map(|camera| camera.1))));
    let board = wiring::board_of(config.board, programs.elf.as_deref())
        .model(Arc::clone(&lidar))
        .model(Arc::clone(&pins));
    let mut bench = SessionBench::new(config, board, phones.collect(), &PHONES, out)?;
    add_sensors(&mut bench.profile)?;
    let mut options = bench.options("recording");
    options.duration = Some(seconds(plan.seconds.into()));
    options.fetch_video = true;
    progress(&format!(
        "recording {} s with two phones, four cameras and a lidar, and fetching the videos",
        plan.seconds
    ));
    let mut recorded = session(bench, &options, out.join("phones"))?;
    // As its recorder would have been stopped with the session.
    let span = recorded.session.recorded.context("nothing was recorded")?;
    let end = span.to.0 + RECORDER_STOPS;
    let base = recorded.truth.timebase;
    recorded
        .truth
        .depth
        .retain(|frame| base.ticks(frame.center).0 <= end);
    recorded.write_depth()?;
    progress("extracting everything in board time");
    let data = out.join("data");
    let mut arguments = vec![
        "extract".to_owned(),
        "--out".to_owned(),
        data.display().to_string(),
    ];
    for name in PHONES {
        let files = recorded.phone.join(name);
        arguments.push("--phone".to_owned());
        arguments.push(format!("{name}={}", files.display()));
    }
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let report = ask(programs, &arguments, &[&recorded.folder])?;
    progress("comparing with the ground truth");
    let verdict = recorded.truth.judge(&recorded.folder)?;
    let figures = Judge {
        recorded: &recorded,
        data: &data,
        report: &report,
    };
    Ok(SeveralFigures {
        simulated: true,
        seed: plan.seed,
        recorded_s: verdict.recorded_s,
        phones: figures.phones(&verdict)?,
        session: verdict.others,
        phase_us: verdict.phase.start_us,
        depth: Errors::from_pairs(depth_frames(&recorded, &data)?.0.into_iter()),
        outputs: figures.outputs(&lock(&pins))?,
        lidar: figures.lidar(&mut lock(&lidar))?,
        lost: verdict.lost,
        recording: recorded.folder.clone(),
        data: data.clone(),
    })
}

/// Names all sensors in the owner's profile.
fn add_sensors(profile: &mut Profile) -> Result<()> {
    let mut text = String::from("[lidar]\nname = \"VLP-16\"\n");
    for (name, _, output, every, delay) in CAMERAS {
        text += &format!(
            "\n[[outputs]]\noutput = {output}\nname = \"{name}\"\nevery = {every}\n\
             delay_us = {delay:?}\n"
        );
    }
    let named = Profile::parse(&text, None)?;
    profile.outputs = named.outputs;
    profile.lidar = named.lidar;
    Ok(())
}

struct Judge<'a> {
    recorded: &'a Recorded,
    data: &'a Path,
    report: &'a Value,
}

impl Judge<'_> {
    fn phones(&self, verdict: &Verdict) -> Result<Vec<PhoneFigures>> {
        let truth = &self.recorded.truth;
        let first = (&truth.phone, &truth.videos);
        let others = truth.others.iter().map(|(clock, videos)| (clock, videos));
        let mut figures = Vec::new();
        for (place, (name, (clock, videos))) in PHONES
            .iter()
            .zip(std::iter::once(first).chain(others))
            .enumerate()
        {
            let (said, folder) = match place.checked_sub(1) {
                None => (self.report, PathBuf::new()),
                Some(index) => (
                    &self.report["phones"][index],
                    Path::new("phones").join(name),
                ),
            };
            let called = if place == 0 { "reference" } else { "name" };
            ensure!(said[called] == *name, "the report has no phone {name}");
            let video = videos.last().context("no video")?;
            let frames = self.data.join(folder).join("phone_frames.csv");
            let (starts, middles) = phone_frames(self.recorded, clock, video, &frames)?;
            let number = |value: &Value, key: &str| {
                let number = value[key].as_f64();
                number.with_context(|| format!("the report states no {key} of phone {name}"))
            };
            let offset = number(&said["grid"], "offset_us")?;
            let true_offset = if place == 0 {
                verdict.phase.start_us
            } else {
                self.true_offset(&middles)?
            };
            figures.push(PhoneFigures {
                name: (*name).to_owned(),
                start: Errors::from_pairs(starts.into_iter()),
                middle: Errors::from_pairs(middles.into_iter()),
                sigma_us: said["clock"]["sigma_us"][1]
                    .as_f64()
                    .context("the report states no uncertainty of the phone's times")?,
                grid_offset_us: offset,
                grid_error_us: offset - true_offset,
                grid_drift_us_per_min: number(&said["grid"], "drift_us_per_min")?,
            });
        }
        Ok(figures)
    }

    /// Depth minus phone at the first pulse of the recorded span, by the ground truth, µs.
    fn true_offset(&self, middles: &[(i64, i64)]) -> Result<f64> {
        let span = self.recorded.session.recorded.context("nothing recorded")?;
        let from = i64::try_from(span.from.as_nanos())?;
        let centres = self.recorded.truth.depth.iter();
        let centre = centres
            .map(|frame| self.recorded.nanos(frame.center))
            .find(|&centre| centre >= from)
            .context("no depth frame in the recorded span")?;
        let distances = middles.iter().map(|middle| centre - middle.1);
        let nearest = distances.min_by_key(|distance| distance.abs());
        Ok(nearest.context("no frame")? as f64 * 1e-3)
    }

    fn outputs(&self, pins: &PinLog) -> Result<Vec<OutputFigures>> {
        let mut figures = Vec::new();
        for (name, pin, ..) in CAMERAS {
            let path = self.data.join(format!("mav0/outputs/{name}.csv"));
            let edges: Vec<i64> = pins
                .rising(pin)
                .into_iter()
                .map(|at| {
                    Ok(i64::try_from(
                        self.recorded.truth.timebase.ticks(at).as_nanos(),
                    )?)
                })
                .collect::<Result<_>>()?;
            let mut found = Vec::new();
            for row in table(&path, &[0])? {
                found.push(whole(row[0])?);
            }
            let off = found.iter().filter(|at| !edges.contains(at)).count();
            let range = found.first()..=found.last();
            let missing = edges
                .iter()
                .filter(|at| range.contains(&Some(at)) && !found.contains(at))
                .count();
            figures.push(OutputFigures {
                name: name.to_owned(),
                pulses: found.len(),
                off,
                missing,
            });
        }
        Ok(figures)
    }

    fn lidar(&self, lidar: &mut Lidar) -> Result<LidarFigures> {
        let seconds = lidar.take_all_seconds();
        let rows = table(&self.data.join("mav0/outputs/VLP_16.csv"), &[0, 1])?;
        let (mut off, mut other_utc) = (0, 0);
        for (index, row) in rows.iter().enumerate() {
            let (at, utc) = (whole(row[0])?, whole(row[1])?);
            let second = seconds.iter().find(|second| {
                i64::try_from(self.recorded.truth.timebase.ticks(second.pulse).as_nanos()) == Ok(at)
            });
            match second.map(|second| second.utc) {
                Some(Some(sent)) if sent * 1_000_000_000 == utc => {}
                // The last one may end with the session, before it was sent.
                Some(None) if index + 1 == rows.len() => {}
                Some(_) => other_utc += 1,
                None => off += 1,
            }
        }
        Ok(LidarFigures {
            seconds: rows.len(),
            off,
            other_utc,
            faults: lidar.faults(),
        })
    }
}
