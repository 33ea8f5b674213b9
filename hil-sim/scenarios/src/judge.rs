//! Compares what a session decided with the ground truth.

use std::path::Path;

use anyhow::{Context, Result, bail};
use clock::BoardSeconds;
use clock::ClockRelation;
use protocol::Ticks;
use recording::reader::{Item, Reader};
use recording::session_file::{PhoneRecord, SessionFile, Span, Twist};
use serde::Serialize;

use crate::frame_phase::{PhaseError, PhaseSummary, phase_errors, summarise};
use rig::clocks::oscillator::{BoardTime, Oscillator};
use rig::depth_camera::{FrameRecord, Source};
use rig::phone::VideoTruth;
use rig::whole_rig::running_rig::RunTruth;
use stm32f4_sim::clock::{Clock, Rate};
use stm32f4_sim::time::SimTime;

/// Ticks of the board in a second of its time.
const TICK_HZ: u64 = protocol::TICK_HZ as u64;

/// The ground truth of a run.
#[derive(Clone, Debug)]
pub struct Truth {
    /// The board's crystal.
    pub board: BoardTime,
    /// The phone's clock.
    pub phone: Oscillator,
    /// The phone's videos.
    pub videos: Vec<VideoTruth>,
    /// Clocks and videos of other phones.
    pub others: Vec<(Oscillator, Vec<VideoTruth>)>,
    /// All frames of the depth camera, in order.
    pub depth: Vec<FrameRecord>,
    /// When the board's tick count was zero.
    pub timebase: Timebase,
}

/// An error with its stated 1-sigma, µs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct OffsetError {
    /// Stated minus true, µs.
    pub error_us: f64,
    /// Stated 1-sigma, µs.
    pub sigma_us: f64,
}

/// Errors of a twist's relation, at its own reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct TwistVerdict {
    /// The offset.
    pub offset: OffsetError,
    /// Skew, stated minus true, ppm.
    pub skew_error_ppm: f64,
    /// Its stated 1-sigma, ppm.
    pub skew_sigma_ppm: f64,
}

/// A session judged.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// The last twist before the recorded span, without what a profile knew.
    pub twist: TwistVerdict,
    /// The relation of the clocks that the trigger was aligned by, at the
    /// beginning of the recorded span.
    pub offset_start: OffsetError,
    /// The relation that was best known in the end, at the end of the span.
    pub offset_end: OffsetError,
    /// Phase of the frames over the recorded span.
    pub phase: PhaseSummary,
    /// Its stated 1-sigma at the start, µs, with that of the constant between the exposures.
    pub phase_sigma_us: f64,
    /// True if the session states that the cameras expose together.
    pub is_sure: bool,
    /// The same, frame by frame.
    pub phases: Vec<PhaseError>,
    /// Pulses in the recording's whole span.
    pub pulses: u64,
    /// IMU samples likewise.
    pub imu_samples: u64,
    /// Pulses and samples that the recording says are missing, and frames of the
    /// phone without a depth frame within half a frame.
    pub lost: u64,
    /// Length of the recorded span, seconds of board time.
    pub recorded_s: f64,
    /// Errors of the session's statements about the other phones.
    pub others: Vec<OtherVerdict>,
}

/// Errors of a session's statements about another phone.
#[derive(Clone, Debug, Serialize)]
pub struct OtherVerdict {
    /// Its name.
    pub name: String,
    /// Its relation from the last twist before the recording, at the beginning of
    /// the recorded span.
    pub offset_start: OffsetError,
    /// The relation that was best known in the end, at the end of the span.
    pub offset_end: OffsetError,
    /// Position of its frames at the beginning of the recorded span: stated minus true.
    pub placement: OffsetError,
    /// Stated drift of its frames minus the true one, µs/min.
    pub drift_error_us_per_min: f64,
    /// Stated 1-sigma of it, µs/min.
    pub drift_sigma_us_per_min: f64,
}

/// Relation of the board's tick count to its time.
#[derive(Clone, Copy, Debug)]
pub struct Timebase {
    clock: Clock,
}

impl Timebase {
    /// The tick count that was zero at `zero`.
    #[must_use]
    pub fn new(zero: SimTime) -> Self {
        Self {
            clock: Clock::new(Rate::hz(TICK_HZ), zero, 0),
        }
    }

    /// The tick count at a board time.
    #[must_use]
    pub fn ticks(&self, at: SimTime) -> Ticks {
        Ticks(self.clock.edge_at(at))
    }

    /// The board time of a tick.
    #[must_use]
    pub fn time(&self, ticks: Ticks) -> SimTime {
        self.clock.time_of(ticks.0)
    }
}

/// All pulses of a recording, in order, and the number of its IMU samples.
pub(crate) fn read_streams(folder: &Path) -> Result<(Vec<Ticks>, u64)> {
    let mut pulses = Vec::new();
    let mut samples = 0;
    for entry in Reader::open(folder)? {
        match entry?.item {
            Item::Pulse(pulse) => pulses.push(Ticks(pulse.ticks)),
            Item::Imu(_) => samples += 1,
            _ => {}
        }
    }
    pulses.sort_unstable();
    Ok((pulses, samples))
}

impl Truth {
    /// Files of a run.
    ///
    /// # Errors
    ///
    /// The board's timer never ran, or there was no phone.
    pub fn from_run(run: RunTruth) -> Result<Self> {
        let zero = run.zero.context("the board's timer never ran")?;
        let mut phones = run.phones.into_iter();
        let (phone, videos) = phones.next().context("the rig has no phone")?;
        Ok(Self {
            board: run.parts.board,
            phone,
            videos,
            others: phones.collect(),
            depth: run.depth,
            timebase: Timebase::new(zero),
        })
    }

    /// True reading of the phone's clock at a tick, minus the board's time, in
    /// nanoseconds.
    fn offset_ns(&self, phone: &Oscillator, at: Ticks) -> f64 {
        let true_time = self.board.true_at(self.timebase.time(at));
        let phone = i128::from(phone.nanos_at(true_time));
        // 125 / 6 ns a tick: whole nanoseconds and the remainder apart.
        let scaled = i128::from(at.0) * 125;
        (phone - scaled / 6) as f64 - (scaled % 6) as f64 / 6.0
    }

    /// Error of a stated relation at a tick.
    fn error_of(&self, phone: &Oscillator, model: &ClockRelation, at: Ticks) -> OffsetError {
        let stated = model.offset_at(at.as_secs_f64());
        OffsetError {
            error_us: stated.value * 1e6 - self.offset_ns(phone, at) * 1e-3,
            sigma_us: stated.sigma * 1e6,
        }
    }

    /// Error of a twist's relation where it is known best, and of its skew.
    fn judge_twist(&self, phone: &Oscillator, clock: &ClockRelation) -> TwistVerdict {
        /// Half of the distance over which the true skew is taken, seconds: the
        /// clock is read in whole nanoseconds.
        const REACH_S: f64 = 1.0;
        let error_at = |from_reference: f64| {
            let at = BoardSeconds(clock.reference + from_reference);
            self.error_of(phone, clock, at.ticks())
        };
        let apart_us = error_at(REACH_S).error_us - error_at(-REACH_S).error_us;
        TwistVerdict {
            offset: error_at(0.0),
            skew_error_ppm: apart_us / (2.0 * REACH_S),
            skew_sigma_ppm: clock.skew_sigma_at(clock.reference) * 1e6,
        }
    }

    /// Checks that the edges that the depth camera saw while these pulses came are pulses of
    /// the recording, each at its tick.
    fn check_edges(&self, pulses: &[Ticks]) -> Result<()> {
        let near = |pulse: Option<&Ticks>| pulse.copied().context("there are no pulses");
        // Edges before and after are those of other sessions.
        let range = near(pulses.first())?..=near(pulses.last())?;
        let edges = self.depth.iter().filter_map(|frame| match frame.source {
            Source::Pulse { edge, .. } => Some(self.timebase.ticks(edge)),
            Source::FreeRun => None,
        });
        let edges: Vec<Ticks> = edges.filter(|at| range.contains(at)).collect();
        let strange = edges.iter().filter(|at| pulses.binary_search(at).is_err());
        match (edges.len(), strange.count()) {
            (0, _) => bail!("the depth camera has seen no pulse"),
            (_, 0) => Ok(()),
            (all, strange) => bail!(
                "{strange} of {all} edges that the depth camera saw are not pulses of the recording"
            ),
        }
    }

    /// Judges the recording in `folder`.
    ///
    /// # Errors
    ///
    /// The recording cannot be read, or a part that is judged is missing in it.
    pub fn judge(&self, folder: &Path) -> Result<Verdict> {
        let session = SessionFile::load(folder)?;
        let (pulses, imu_samples) = read_streams(folder)?;
        self.check_edges(&pulses)?;
        let alignment = session
            .alignment
            .context("the session has aligned nothing")?;
        let reference = session.reference().context("the session has no phone")?;
        let clock = reference
            .clock
            .context("the session knows no relation of the clocks")?;
        let span = session
            .recorded
            .context("the session has recorded nothing")?;
        let phase_ns = reference
            .video
            .context("the session has started no video")?
            .on_boot_clock()
            .0;
        let twist = last_twist(&reference.twists, span).context("no twist related the clocks")?;
        let video = video_at(&self.videos, phase_ns)?;
        let phases = self.phases(&self.phone, video, span);
        let phase = summarise(&phases).context("the recorded span has no frames")?;
        // Frames further apart than a quarter of a period are not a pair.
        let quarter_us = video.frames.period_ns() * 0.25e-3;
        let unpaired = phases
            .iter()
            .filter(|p| p.error_us.abs() > quarter_us)
            .count();
        let lost = session.counts.lost() + unpaired as u64;
        Ok(Verdict {
            others: self.judge_others(&session, span)?,
            twist: self.judge_twist(&self.phone, &twist),
            offset_start: self.error_of(&self.phone, &alignment.plan.clock, span.from),
            offset_end: self.error_of(&self.phone, &clock, span.to),
            phase,
            phase_sigma_us: alignment.phase_sigma_us,
            is_sure: alignment.is_sure(),
            phases,
            pulses: pulses.len() as u64,
            imu_samples,
            lost,
            recorded_s: (span.to - span.from).as_secs_f64(),
        })
    }

    /// Phase errors of a phone's frames in the recorded span.
    fn phases(&self, phone: &Oscillator, video: &VideoTruth, span: Span) -> Vec<PhaseError> {
        let phone_ns = |at: Ticks| phone.nanos_at(self.board.true_at(self.timebase.time(at)));
        let from = phone_ns(span.from);
        // A frame that had begun before may belong to the way to the grid.
        let mut first = video.frames.complete_at(from);
        while video.frames.start_ns(first) < from {
            first += 1;
        }
        let count = video
            .frames
            .complete_at(phone_ns(span.to))
            .min(video.count.unwrap_or(usize::MAX));
        phase_errors(&video.frames, first..count, phone, &self.depth)
    }

    /// Judges the session's statements about the other phones.
    fn judge_others(&self, session: &SessionFile, span: Span) -> Result<Vec<OtherVerdict>> {
        let others = session.other_phones().iter().zip(&self.others);
        others
            .map(|(said, (clock, videos))| {
                self.judge_other(said, (clock, videos), span)
                    .with_context(|| format!("phone {}", said.name))
            })
            .collect()
    }

    fn judge_other(
        &self,
        said: &PhoneRecord,
        (phone, videos): (&Oscillator, &[VideoTruth]),
        span: Span,
    ) -> Result<OtherVerdict> {
        let before = last_twist(&said.twists, span).context("no twist related its clock")?;
        let clock = said.clock.context("its clock is not related")?;
        let placed = said.placement.context("its frames are not placed")?;
        let phase_ns = said.video.context("it has started no video")?;
        let phase_ns = phase_ns.on_boot_clock().0;
        let video = video_at(videos, phase_ns)?;
        let mut phases = self.phases(phone, video, span);
        let period_us = video.frames.period_ns() * 1e-3;
        let near = |value: f64| value - (value / period_us).round() * period_us;
        // A frame that falls behind is paired with the next depth frame some time.
        let mut last = phases.first().map_or(0.0, |phase| phase.error_us);
        for phase in &mut phases {
            last += near(phase.error_us - last);
            phase.error_us = last;
        }
        let truth = summarise(&phases).context("the recorded span has no frames")?;
        let first = phases.first().context("the recorded span has no frames")?;
        let began = phone
            .when_nanos(phase_ns)
            .context("a time before power-on")?;
        let minutes = (first.at_s - began.as_secs_f64()) / 60.0;
        let stated = placed.offset_us + placed.drift_us_per_min * minutes;
        Ok(OtherVerdict {
            name: said.name.clone(),
            offset_start: self.error_of(phone, &before, span.from),
            offset_end: self.error_of(phone, &clock, span.to),
            // The ground truth is depth minus phone.
            placement: OffsetError {
                error_us: near(stated + truth.start_us),
                sigma_us: placed
                    .offset_sigma_us
                    .hypot(placed.drift_sigma_us_per_min * minutes),
            },
            drift_error_us_per_min: placed.drift_us_per_min + truth.drift_us_per_min,
            drift_sigma_us_per_min: placed.drift_sigma_us_per_min,
        })
    }
}

/// Relation from the last accepted twist before a span.
fn last_twist(twists: &[Twist], span: Span) -> Option<ClockRelation> {
    twists
        .iter()
        .rfind(|twist| twist.accepted && twist.span.to < span.from)
        .and_then(|twist| twist.clock)
}

/// The video that was being recorded at a time of the phone.
fn video_at(videos: &[VideoTruth], phone_ns: i64) -> Result<&VideoTruth> {
    videos
        .iter()
        .find(|v| (v.start_ns..v.stop_ns.unwrap_or(i64::MAX)).contains(&phone_ns))
        .context("the phone has recorded no video in this session")
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig::clocks::oscillator::{OscillatorConfig, TrueTime};

    fn frame(edge: SimTime) -> FrameRecord {
        FrameRecord {
            number: 0,
            source: Source::Pulse { number: 0, edge },
            first_flash: edge,
            center: edge,
            center_true: TrueTime::ZERO,
            device_ticks: 0,
            bad: false,
            delivered: true,
        }
    }

    fn truth(depth: Vec<FrameRecord>) -> Truth {
        let config = |offset_ns, rate_ppm| OscillatorConfig {
            offset_ns,
            rate_ppm,
            wander: 0.0,
            ..OscillatorConfig::default()
        };
        let random = || rig::random::Seed(1).stream(rig::random::Stream::Test);
        Truth {
            board: BoardTime::new(config(0, 20.0), random()),
            phone: Oscillator::new(config(4_000_000_000_000, -30.0), random()),
            videos: Vec::new(),
            others: Vec::new(),
            depth,
            timebase: Timebase::new(SimTime::from_nanos(1_000_000)),
        }
    }

    #[test]
    fn edges_that_the_camera_saw_are_looked_for_among_the_pulses() {
        let base = truth(Vec::new()).timebase;
        let pulses: Vec<Ticks> = (0..300u64)
            .map(|k| Ticks(5_000_000_000 + k * 1_600_000))
            .collect();
        let frames = pulses[2..290].iter().map(|&p| frame(base.time(p)));
        let seen = truth(frames.collect());
        assert!(seen.check_edges(&pulses).is_ok());
        // Pulses that the camera saw and the recording lacks.
        let gap = [&pulses[..50], &pulses[55..]].concat();
        assert!(seen.check_edges(&gap).is_err());
        // Frames of another session do not matter.
        assert!(seen.check_edges(&pulses[5..100]).is_ok());
        assert!(truth(Vec::new()).check_edges(&pulses).is_err());
    }

    #[test]
    fn a_true_relation_has_no_error() {
        let truth = truth(Vec::new());
        let at = Ticks(48_000_000 * 100);
        let skew = (1.0 - 30e-6) / (1.0 + 20e-6) - 1.0;
        let model = ClockRelation {
            reference: 40.0,
            offset: truth.offset_ns(&truth.phone, Ticks(48_000_000 * 40)) * 1e-9 + 3e-6,
            skew,
            covariance: [[1e-12, 0.0], [0.0, 0.0]],
            wander: clock::Wander(0.0),
        };
        let error = truth.error_of(&truth.phone, &model, at);
        // 3 µs of error were put in.
        assert!((error.error_us - 3.0).abs() < 0.01, "{error:?}");
        assert!((error.sigma_us - 1.0).abs() < 1e-6, "{error:?}");
    }
}
