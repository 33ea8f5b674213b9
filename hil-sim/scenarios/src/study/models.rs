//! A session on the models alone: no board, no link, no app. Twists, estimator, learning
//! and alignment are the product's; a pulse is where the alignment puts it, to the tick, as
//! tests of the board show that it is. Jitter of single flashes is left out: the phase is
//! that of the grid.

use anyhow::{Context, Result, bail};
use clock::frames::{LearntFrames, frame_period};
use clock::rates::Course;
use clock::twists::Twists;
use clock::{BoardSeconds, ClockRelation, PhoneNanos, board_track, phone_track};
use jiff::Timestamp;
use protocol::mpu9150::ADDRESS;
use protocol::{GyroRange, LowPass, TICK_HZ, Ticks};
use recording::profile::Profile;
use recording::session_file::{Alignment, Video};
use rig::clocks::oscillator::{BoardTime, Oscillator, TrueTime};
use rig::imu::SimImu;
use rig::imu::mpu::address;
use rig::model_ranges::ModelValues;
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::{FrameTimes, PhoneConfig, gyroscope_samples};
use rig::random::{Seed, Stream};
use rig::whole_rig::config::{RigConfig, RigParts};
use rig::wiring::{self, UNITS_PER_TICK};
use serde::Serialize;
use session::alignment::{plan, skew_prior};
use session::learn::{Origin, learnt};
use stm32f4_sim::clock::Rate;
use stm32f4_sim::model_bench::ModelBench;
use stm32f4_sim::shared::lock;
use stm32f4_sim::sim::INPUT_SYNCHRONISER;
use stm32f4_sim::time::{SimTime, UNITS_PER_SECOND};
use twist_sync::{Options, estimate_offset};

use super::Figure;

/// Length of a twist, and how much longer the board listens, seconds.
const TWIST_S: f64 = 9.0;
const MARGIN_S: f64 = 0.25;

/// From the end of a twist to the next of a session, and to the request of the video.
pub const GAP_S: f64 = 60.0;
const TO_VIDEO_S: f64 = 1.0;

/// From the request of a video to a train that has arrived.
const TO_ARRIVAL_S: f64 = 6.0;

/// Length of a recording.
const RECORDED_S: f64 = 300.0;

/// Time before and after over which the true skew is taken, s: half a twist.
const SKEW_OVER_S: f64 = 4.5;

/// Number of times that a twist is tried.
const TRIES: u32 = 3;

/// Errors of a session.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Judged {
    /// Error of the phase when the train has arrived, µs.
    pub phase_us: f64,
    /// Its stated 1-sigma.
    pub phase_sigma_us: f64,
    /// Drift over five minutes, µs/min.
    pub drift_us_per_min: f64,
    /// Its stated 1-sigma.
    pub drift_sigma_us_per_min: f64,
    /// Error of the clocks' offset then, µs.
    pub offset_us: f64,
    /// Its stated 1-sigma.
    pub offset_sigma_us: f64,
    /// Error of the clocks' skew then, ppm.
    pub skew_ppm: f64,
    /// Its stated 1-sigma.
    pub skew_sigma_ppm: f64,
}

/// The sessions of one rig, each since it was switched on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sessions {
    /// Offset and skew of each twist by itself.
    pub twists: Vec<Figure>,
    /// One twist, nothing learnt.
    pub fresh: Judged,
    /// One twist, by what the session before it has taught, minutes ago.
    pub learnt: Judged,
    /// Two twists, and a frame period that was learnt on another day.
    pub two_twists: Judged,
    /// Three twists.
    pub three_twists: Judged,
    /// Three twists, with twice the time between them.
    pub wide_twists: Judged,
}

impl Sessions {
    /// All figures of them, by name.
    #[must_use]
    pub fn figures(&self) -> Vec<Figure> {
        let sessions = [
            ("one twist, nothing learnt", self.fresh),
            ("one twist, learnt minutes ago", self.learnt),
            ("two twists, cold rig", self.two_twists),
            ("three twists, cold rig", self.three_twists),
            ("three twists, 2 min apart, cold rig", self.wide_twists),
        ];
        let figures = sessions.map(|(session, j)| {
            let figures = [
                ("phase at the start (µs)", j.phase_us, j.phase_sigma_us),
                (
                    "drift (µs/min)",
                    j.drift_us_per_min,
                    j.drift_sigma_us_per_min,
                ),
                ("clock offset (µs)", j.offset_us, j.offset_sigma_us),
                ("skew (ppm)", j.skew_ppm, j.skew_sigma_ppm),
            ];
            figures.map(|(name, error, sigma)| Figure {
                name: format!("{session}: {name}"),
                error,
                sigma: Some(sigma),
            })
        });
        let mut all = self.twists.clone();
        all.extend(figures.into_iter().flatten());
        all
    }
}

/// A rig that is switched on, as its models.
struct Rig {
    parts: RigParts,
    phone: PhoneConfig,
    oscillator: Oscillator,
    imu: ModelBench<SimImu>,
    profile: Profile,
    twists: Vec<Figure>,
}

/// The sessions on the rig of a seed with these values of the models.
///
/// # Errors
///
/// Twists are refused, nothing can be learnt, or nothing can be aligned.
pub fn sessions(seed: u64, values: &ModelValues) -> Result<Sessions> {
    let mut rig = Rig::new(Seed(seed), values)?;
    // Five twists of the cold rig; sessions use one, two or three of them.
    let mut at = 15.0;
    let mut twists: Vec<ClockRelation> = Vec::new();
    let mut ends = Vec::new();
    for _ in 0..5 {
        let (clock, end) = rig.twist(at)?;
        twists.push(clock);
        ends.push(end);
        at = end + GAP_S;
    }
    let fresh_profile = rig.profile.clone();
    let one = Twists::new(twists[0]).course();
    let begun = ends[0] + TO_VIDEO_S;
    let fresh = rig.record(&fresh_profile, &one, 0, begun)?;

    // A recording teaches: its frames, and its twists at both ends.
    let stop = begun + TO_ARRIVAL_S + RECORDED_S;
    let (last, end) = rig.twist(stop.max(ends[4]) + 2.0)?;
    let joined = twists[0].joined(&last);
    let sigma = joined.covariance[1][1].max(0.0).sqrt();
    let now = Timestamp::UNIX_EPOCH;
    let origin = Origin {
        board_id: None,
        time: now,
        board_temperature_c: None,
    };
    // Nothing is learnt from frames without a period, and the sessions continue without it.
    let frames = rig.learnt_frames(begun).ok();
    let taught = frames.map(|frames| learnt(&frames, Some((joined.skew, sigma)), &origin));
    let mut profile = fresh_profile;
    profile.phone.learnt = taught;

    let (clock, end) = rig.twist(end + 20.0)?;
    let later = now + jiff::SignedDuration::from_secs(360);
    let known = skew_prior(&profile.phone, "", later, None);
    let alone = Twists::new(clock);
    let both = known.and_then(|known| alone.with_known(&known));
    let course = both.unwrap_or(alone).course();
    let learnt = rig.record(&profile, &course, 1, end + TO_VIDEO_S)?;

    // On a cold rig the frame period of another day, and no skew.
    let joined = |places: &[usize]| {
        let others = places.iter().map(|&place| &twists[place]);
        let first = Twists::new(twists[0]);
        let joined = others.fold(first, |known, twist| {
            known.with(twist).unwrap_or(Twists::new(*twist))
        });
        joined.course()
    };
    let two_twists = rig.record(&profile, &joined(&[1]), 2, ends[1] + TO_VIDEO_S)?;
    let three_twists = rig.record(&profile, &joined(&[1, 2]), 3, ends[2] + TO_VIDEO_S)?;
    let wide_twists = rig.record(&profile, &joined(&[2, 4]), 4, ends[4] + TO_VIDEO_S)?;
    Ok(Sessions {
        twists: rig.twists,
        fresh,
        learnt,
        two_twists,
        three_twists,
        wide_twists,
    })
}

fn true_time(seconds: f64) -> TrueTime {
    TrueTime::from_nanos((seconds * 1e9) as u64)
}

impl Rig {
    fn new(seed: Seed, values: &ModelValues) -> Result<Self> {
        let mut config = RigConfig::published(seed).with_motion(MotionSpec::always(Gesture::Twist));
        let mut phone = PhoneConfig::draw(seed);
        values.apply(&mut config, &mut phone);
        let parts = config.build();
        let settings = parts.config.imu.context("the rig has no IMU")?;
        let motion = std::sync::Arc::clone(&parts.motion);
        let mut imu = ModelBench::new(SimImu::new(settings, motion, parts.board.clone(), seed));
        imu.set_clock(wiring::IMU_CLOCK, Some(Rate::hz(19_200_000)));
        imu.run_until(SimTime::from_nanos(100_000_000));
        // 500 Hz, 188 Hz, 500 °/s, and asleep: samples are only made of twists.
        for (register, value) in [
            (address::SMPLRT_DIV, 1),
            (address::CONFIG, 1),
            (address::GYRO_CONFIG, 1 << 3),
        ] {
            write(&mut imu, register, value)?;
        }
        let mut profile = Profile::published()?;
        profile.phone.rows = u32::try_from(phone.camera.rows)?;
        profile.phone.readout_us = phone.camera.readout_ns() * 1e-3;
        profile.phone.gyro_delay_us = phone.gyroscope.low_pass.delay_s * 1e6;
        profile.phone.exposure_locked = phone.camera.is_exposure_locked();
        profile.phone.readout_sigma_us = 0.0;
        profile.phone.gyro_delay_sigma_us = 0.0;
        profile.depth.center_offset_sigma_us = 0.0;
        let center = parts.config.center_offset_us();
        profile.depth.center_offset_us = center.context("the rig has no depth camera")?;
        Ok(Self {
            oscillator: Oscillator::new(phone.clock, seed.stream(Stream::PhoneClock)),
            parts,
            phone,
            imu,
            profile,
            twists: Vec::new(),
        })
    }

    fn board(&self) -> &BoardTime {
        &self.parts.board
    }

    /// Twists at a true time until a twist passes the gates: the relation from it alone,
    /// and the true time of its end.
    fn twist(&mut self, at: f64) -> Result<(ClockRelation, f64)> {
        let mut at = at;
        let mut refusal = String::new();
        for _ in 0..TRIES {
            let (board, phone) = (self.board_samples(at)?, self.phone_samples(at));
            let end = at + TWIST_S + MARGIN_S;
            let options = Options {
                a_delay_s: f64::from(LowPass::Hz188.gyro_delay_us()) * 1e-6,
                b_delay_s: self.profile.phone.gyro_delay_us * 1e-6,
                sigma_limit_s: self.profile.align.max_offset_sigma_us * 1e-6,
                ..Options::default()
            };
            match estimate_offset(&board_track(board), &phone_track(phone), &options) {
                Ok(estimate) => {
                    let clock = estimate.clock;
                    self.judge(&clock);
                    return Ok((clock, end));
                }
                Err(refused) => refusal = refused.to_string(),
            }
            at = end + 2.0;
        }
        bail!("{TRIES} twists were refused, the last one: {refusal}");
    }

    /// The true relation at a time of the board: offset in seconds, and skew.
    fn truth(&self, at: BoardSeconds) -> (f64, f64) {
        let ahead = |seconds: f64| {
            let board = SimTime::from_nanos((seconds * 1e9).round() as u64);
            let phone = self.oscillator.nanos_at(self.board().true_at(board));
            phone as f64 * 1e-9 - board.as_secs_f64()
        };
        let (before, after) = (ahead(at.0 - SKEW_OVER_S), ahead(at.0 + SKEW_OVER_S));
        (ahead(at.0), (after - before) / (2.0 * SKEW_OVER_S))
    }

    /// Notes the errors of a twist by itself.
    fn judge(&mut self, clock: &ClockRelation) {
        let (offset, skew) = self.truth(BoardSeconds(clock.reference));
        let sigma = |k: usize| clock.covariance[k][k].sqrt() * 1e6;
        let figures = [
            ("clock offset (µs)", clock.offset - offset, sigma(0)),
            ("skew (ppm)", clock.skew - skew, sigma(1)),
        ];
        self.twists
            .extend(figures.map(|(name, error, sigma)| Figure {
                name: format!("each twist by itself: {name}"),
                error: error * 1e6,
                sigma: Some(sigma),
            }));
    }

    /// The board's gyroscope in a twist that begins at a true time.
    fn board_samples(&mut self, at: f64) -> Result<Vec<(Ticks, [f64; 3])>> {
        let board = self.board().clone();
        let of = |seconds| board.board_at(true_time(seconds));
        // It wakes up for 30 ms.
        self.imu.run_until(of(at - 0.05));
        write(&mut self.imu, address::PWR_MGMT_1, CLOCKED)?;
        self.imu.run_until(of(at));
        self.imu.model.take_log();
        self.imu.run_until(of(at + TWIST_S + MARGIN_S));
        let records = self.imu.model.take_log();
        write(&mut self.imu, address::PWR_MGMT_1, CLOCKED | ASLEEP)?;
        let lsb = f64::from(GyroRange::Dps500.lsb_per_dps_times_10()) / 10.0;
        let sample = |record: &rig::imu::SampleRecord| {
            let tick = record.at.units() / UNITS_PER_TICK + INPUT_SYNCHRONISER;
            let rate = record
                .values
                .gyro
                .map(|raw| (f64::from(raw) / lsb).to_radians());
            (Ticks(tick), rate)
        };
        Ok(records.iter().map(sample).collect())
    }

    /// The phone's in the same twist, as the app answers.
    fn phone_samples(&self, at: f64) -> Vec<(PhoneNanos, [f64; 3])> {
        let from = self.oscillator.nanos_at(true_time(at));
        let to = from.saturating_add((TWIST_S * 1e9) as i64);
        let motion = std::sync::Arc::clone(&self.parts.motion);
        let samples = gyroscope_samples(&self.phone, &self.oscillator, motion, from..to);
        let sample = |(time, rate): (i64, [f32; 3])| (PhoneNanos(time), rate.map(f64::from));
        samples.into_iter().map(sample).collect()
    }

    /// The frames of a recording that is asked for at a true time.
    fn frames(&self, recording: u32, begun: f64) -> FrameTimes {
        let request = self.oscillator.nanos_at(true_time(begun));
        FrameTimes::new(&self.phone, recording, request)
    }

    /// Frame period that the timestamps of the first recording teach.
    fn learnt_frames(&self, begun: f64) -> Result<LearntFrames> {
        let frames = self.frames(0, begun);
        let count = (RECORDED_S * 1e9 / frames.period_ns()) as usize;
        let stamps: Vec<PhoneNanos> = frames.stamps(count).into_iter().map(PhoneNanos).collect();
        let period = frame_period(&stamps)?;
        Ok(LearntFrames {
            period_ns: period.period_ns,
            sigma_ns: period.sigma_ns,
            jitter_ns: Some(period.jitter_ns),
            exposure_us: Some(frames.exposure_ns() as f64 * 1e-3),
        })
    }

    /// Aligns and records, from the request of the video at a true time on.
    fn record(
        &self,
        profile: &Profile,
        course: &Course,
        recording: u32,
        begun: f64,
    ) -> Result<Judged> {
        let frames = self.frames(recording, begun);
        let (phase, frame_duration_ns) = frames.phase();
        let video = Video {
            phase: PhoneNanos(phase),
            frame_duration_ns,
            exposure_ns: Some(frames.exposure_ns()),
            boot_minus_frames_ns: 0,
        };
        let alignment = plan(profile, course, &video)?.alignment;
        let first = (TO_ARRIVAL_S * 1e9 / frames.period_ns()) as usize;
        let after = |minutes: f64| first + (minutes * 60e9 / frames.period_ns()) as usize;
        let error = |frame| self.phase_us(&alignment, &frames, frame);
        let (start, five) = (error(first)?, error(after(5.0))?);
        let arrived = self.middle(&frames, first)?;
        let at = self.board().board_at(arrived);
        let at = BoardSeconds(at.as_secs_f64());
        let stated = alignment.plan.clock.offset_at(at.0);
        let (offset, skew) = self.truth(at);
        let relation = alignment.plan.clock;
        Ok(Judged {
            phase_us: start,
            phase_sigma_us: alignment.stated_sigma_us_at(at),
            drift_us_per_min: (five - start) / 5.0,
            drift_sigma_us_per_min: alignment.drift_sigma_us_per_min,
            offset_us: (stated.value - offset) * 1e6,
            offset_sigma_us: stated.sigma * 1e6,
            skew_ppm: (relation.skew - skew) * 1e6,
            skew_sigma_ppm: relation.skew_sigma_at(at.0) * 1e6,
        })
    }

    /// True time of the middle of one of the phone's frames.
    fn middle(&self, frames: &FrameTimes, frame: usize) -> Result<TrueTime> {
        let middle = self.oscillator.when_nanos(frames.middle_ns(frame));
        middle.context("a frame before the phone was on")
    }

    /// Middle of the depth image nearest to one of the phone's frames less its own, µs.
    fn phase_us(&self, alignment: &Alignment, frames: &FrameTimes, frame: usize) -> Result<f64> {
        let middle = self.middle(frames, frame)?;
        let tick = self.board().board_at(middle).units() / UNITS_PER_TICK;
        let lead = (alignment.center_offset_us * 1e-6 * f64::from(TICK_HZ)) as u64;
        let tick = Ticks(tick.saturating_sub(lead));
        let nearest = tick - alignment.plan.grid().phase_error(tick);
        let edge = self
            .board()
            .true_at(SimTime::from_units(nearest.0 * UNITS_PER_TICK));
        // The camera counts the delay by its own clock.
        let camera = self.parts.depth_camera.as_ref();
        let camera = camera.context("the rig has no depth camera")?;
        let camera = lock(camera);
        let delay_us = camera.config().center_delay_ns() * 1e-3;
        let rate = camera.clock().fraction_at(edge);
        let apart = i128::from(edge.units()) - i128::from(middle.units());
        let apart_us = apart as f64 / UNITS_PER_SECOND as f64 * 1e6;
        Ok(apart_us + delay_us / (1.0 + rate))
    }
}

/// PWR_MGMT_1: the clock is that on CLKIN; and asleep.
const CLOCKED: u8 = 5;
const ASLEEP: u8 = 1 << 6;

fn write(imu: &mut ModelBench<SimImu>, register: u8, value: u8) -> Result<()> {
    match imu.write(ADDRESS, register, &[value]) {
        Ok(()) => Ok(()),
        Err(byte) => bail!("the IMU does not acknowledge byte {byte} of register {register:#x}"),
    }
}
