//! The phone's clock in board time: from both gyroscopes over the whole
//! recording; else from what the session found; else from the recorded offset of
//! the published system.
//!
//! Where the board was reset, each run has a relation of its own, which also says where
//! the run lies ([`super::later_runs`]).

use std::path::Path;

use super::board_data::BoardInput;
use super::gyro_clock::{self, residual_rms, window_results};
use super::inputs::PhoneInput;
use super::later_runs::{Joint, Moves, joints, moves};
use super::progress::Progress;
use super::report::{ClockReport, Constants, TrackedReport};
use super::streams::{self, Stopped};
use super::survey::Survey;
use super::tables::ColorFrame;
use super::time::{BoardNanos, PhoneNanos, PiecewiseMap, SECOND};
use session::train::frame_period;
use timebase::ClockModel;
use twist_sync::tracker::{Asked, Exchange, followed};
use twist_sync::{ClockCourse, Options, Prior, RecordingClock};

/// How far a recorded offset may be off, s.
const RECORDED_MARGIN: f64 = 0.5;
/// How far the relation is laid out beyond the recording, s.
const BEYOND: i64 = 60;

/// Source of a relation that there is none of.
const NONE: &str = "none";

/// A relation of phone and board.
#[derive(Clone, Debug)]
pub(crate) struct PhoneClock {
    /// Phone time to board time, the runs of the board being where
    /// the moves put them.
    pub(crate) map: PiecewiseMap<PhoneNanos, BoardNanos>,
    /// Worth knowing.
    pub(crate) remarks: Vec<String>,
    runs: Vec<RunClock>,
    /// Of each run; nothing if the runs stay where they are.
    pub(crate) joints: Vec<Joint>,
    pub(crate) moves: Moves,
    middle: BoardNanos,
}

/// The relation in one run of the board.
#[derive(Clone, Debug)]
struct RunClock {
    /// From here on, as the recording has it.
    from: BoardNanos,
    /// Until here.
    to: BoardNanos,
    source: &'static str,
    gyros: Option<RecordingClock>,
    course: Option<ClockCourse>,
    /// Of exchanges with both clocks: how many, and the course without them.
    followed: Option<(usize, ClockCourse)>,
    /// Without a course: phone less board, ns.
    offset: i64,
}

/// What is known of a phone's clock before it is looked for, for each run of the
/// board.
///
/// Of a further phone it is what was said of that phone alone: the recording's own
/// clock models and pairs of times are of the one that the trigger was aligned to.
/// `moved` is how much later the last run is in `survey` than in the session, ns.
fn priors(input: &PhoneInput, survey: &Survey, moved: i64) -> Vec<Option<Prior>> {
    let known = survey.clocks_of(input.other_name());
    let latest = known.last().copied().flatten().map(gyro_clock::prior);
    // The session's relation is that of the last run.
    let said = input.rig.prior.map(|prior| match prior {
        Prior::Relation(model) => Prior::Relation(model.with_a_later(moved as f64 * 1e-9)),
        Prior::Offset(offset, margin) => Prior::Offset(offset - moved as f64 * 1e-9, margin),
    });
    let otherwise = if input.is_other() {
        said
    } else {
        recorded_offset(survey)
    };
    let last = known.len().saturating_sub(1);
    let own = |(index, known): (usize, Option<ClockModel>)| {
        let own = if index == last {
            said
        } else {
            known.map(gyro_clock::prior)
        };
        own.or(latest).or(otherwise)
    };
    known.into_iter().enumerate().map(own).collect()
}

/// Finds the relation, for each run of the board by itself. Each run is moved to where the
/// phone's clock has it behind the one before; with a further phone they stay where the
/// clock of the first has put them. The inner error says in words why there is none.
///
/// # Errors
///
/// Stopped, or the board's recording cannot be read.
pub(crate) fn find(
    board: &BoardInput,
    input: &PhoneInput,
    survey: &Survey,
    constants: &Constants,
    progress: &dyn Progress,
) -> Result<Result<PhoneClock, String>, Stopped> {
    let gyro = input.files.as_ref().and_then(|files| files.gyro.as_deref());
    let moved = match board {
        BoardInput::Mcap(_, moves) => moves.last(),
        BoardInput::Bag(_) => 0,
    };
    let priors = priors(input, survey, moved);
    let (first, last) = (survey.imu.first_ns, survey.imu.last_ns);
    let mut runs = Vec::new();
    let mut remarks = Vec::new();
    let mut from = BoardNanos(first.saturating_sub(BEYOND * SECOND));
    let ends = survey.runs.iter().map(|mark| mark.last);
    let ends = ends.chain([BoardNanos(last.saturating_add(BEYOND * SECOND))]);
    for (index, to) in ends.enumerate() {
        let own = priors.get(index).copied().flatten();
        let run = find_run(board, gyro, survey, own, constants, (from, to), progress)?;
        match run {
            Ok((run, remark)) => {
                runs.push(run);
                remarks.extend(remark);
            }
            Err(why) if survey.runs.is_empty() => return Ok(Err(why)),
            Err(why) => {
                remarks.push(why);
                runs.push(RunClock::new((from, to), NONE));
            }
        }
        if let Some(mark) = survey.runs.get(index) {
            from = mark.from;
        }
    }
    if runs.iter().all(|run| run.source == NONE) {
        return Ok(Err(remarks.join("; ")));
    }
    // Of a further phone, and behind a reset, no clock is followed.
    if let Some(first) = runs.first_mut().filter(|_| !input.is_other()) {
        first.follow(&survey.exchanges, priors.first().copied().flatten());
    }
    let courses: Vec<_> = runs.iter().map(RunClock::by_gyros).collect();
    let joints = match input.is_other() {
        true => Vec::new(),
        false => joints(&courses, &survey.runs),
    };
    let moves = moves(&joints);
    let knots = runs.iter().enumerate();
    let knots = knots.flat_map(|(index, run)| run.knots(moves.of(index)));
    Ok(Ok(PhoneClock {
        map: PiecewiseMap::from_knots(knots),
        remarks,
        runs,
        joints,
        moves,
        middle: BoardNanos(first.midpoint(last)),
    }))
}

/// The relation within one run; with it, what is worth knowing.
fn find_run(
    board: &BoardInput,
    gyro: Option<&Path>,
    survey: &Survey,
    prior: Option<Prior>,
    constants: &Constants,
    span: (BoardNanos, BoardNanos),
    progress: &dyn Progress,
) -> Result<Result<(RunClock, Option<String>), String>, Stopped> {
    let Some(gyro) = gyro else {
        return Ok(from_prior(
            prior,
            span,
            "there is no gyroscope file of the phone",
        ));
    };
    if survey.imu.samples == 0 {
        return Ok(from_prior(
            prior,
            span,
            "the board's recording has no IMU samples",
        ));
    }
    let options = Options {
        a_delay_s: constants.board_imu_delay_ns as f64 * 1e-9,
        b_delay_s: constants.phone_imu_delay_ns as f64 * 1e-9,
        ..Options::of_windows()
    };
    let related = streams::related(
        "relating the phone's clock",
        (board, span),
        (&|| streams::phone(gyro), &options),
        prior,
        1,
        progress,
    );
    Ok(match related? {
        Ok(gyros) => Ok((
            RunClock {
                course: Some(gyros.course.clone()),
                gyros: Some(gyros),
                ..RunClock::new(span, "gyroscopes")
            },
            None,
        )),
        Err(why) => from_prior(prior, span, &why),
    })
}

/// The published system's `/mcu_s10_ts`: the last pair of times.
fn recorded_offset(survey: &Survey) -> Option<Prior> {
    let is_it = |topic: &str| topic.ends_with("mcu_s10_ts");
    let pair = survey.times.iter().rev().find(|pair| is_it(&pair.topic))?;
    let offset = pair.other.checked_sub(pair.stamp.0)?;
    Some(Prior::Offset(offset as f64 * 1e-9, RECORDED_MARGIN))
}

fn from_prior(
    prior: Option<Prior>,
    span: (BoardNanos, BoardNanos),
    why: &str,
) -> Result<(RunClock, Option<String>), String> {
    match prior {
        None => Err(format!("phone time cannot be related to board time: {why}")),
        Some(Prior::Relation(model)) => {
            let course = ClockCourse::from_estimates(&[model], model.wander)
                .ok_or_else(|| "the session's clock model is not usable".to_owned())?;
            let run = RunClock {
                course: Some(course),
                ..RunClock::new(span, "session")
            };
            let remark = format!(
                "the clock relation is the session's, from the twist alone, and not from the whole \
                 recording: {why}"
            );
            Ok((run, Some(remark)))
        }
        Some(Prior::Offset(offset, _)) => {
            let run = RunClock {
                offset: (offset * 1e9).round() as i64,
                ..RunClock::new(span, "bag")
            };
            let remark = format!(
                "the clock relation is the one offset that was recorded, without the drift of the \
                 clocks: {why}"
            );
            Ok((run, Some(remark)))
        }
    }
}

impl RunClock {
    fn new((from, to): (BoardNanos, BoardNanos), source: &'static str) -> Self {
        Self {
            from,
            to,
            source,
            gyros: None,
            course: None,
            followed: None,
            offset: 0,
        }
    }

    /// Joins what is known of the clocks, from windows of motion or else from the session,
    /// by exchanges with them.
    fn follow(&mut self, exchanges: &[(Asked, Exchange)], prior: Option<Prior>) {
        let known = match (&self.gyros, prior) {
            (Some(gyros), _) => gyros.estimates.clone(),
            (None, Some(Prior::Relation(relation))) => vec![relation],
            (None, _) => return,
        };
        let knots = followed(exchanges, &known);
        let Some(plain) = self.course.take_if(|_| !knots.is_empty()) else {
            return;
        };
        self.course = Some(plain.clone().with_followed(&knots));
        self.followed = Some((exchanges.len(), plain));
    }

    /// What the gyroscopes found.
    fn by_gyros(&self) -> Option<&ClockCourse> {
        self.gyros.as_ref().map(|gyros| &gyros.course)
    }

    /// Pairs of times, the run being later by `moved` (ns) than the recording has it.
    fn knots(&self, moved: i64) -> Vec<(PhoneNanos, BoardNanos)> {
        let plain = |at: BoardNanos| (PhoneNanos(at.0.saturating_add(self.offset)), at);
        if self.source == NONE {
            return Vec::new();
        }
        let knots = match &self.course {
            Some(course) => gyro_clock::knots(course, self.from, self.to),
            None => vec![plain(self.from), plain(self.to)],
        };
        let later =
            |(phone, at): (PhoneNanos, BoardNanos)| (phone, BoardNanos(at.0.saturating_add(moved)));
        knots.into_iter().map(later).collect()
    }
}

impl PhoneClock {
    /// The relation at a board time, with its uncertainty.
    pub(crate) fn model_at(&self, at: BoardNanos) -> Option<ClockModel> {
        self.model_by(|run| run.course.as_ref(), at)
    }

    /// The same without what exchanges have added.
    fn plain_model_at(&self, at: BoardNanos) -> Option<ClockModel> {
        self.model_by(
            |run| {
                let plain = run.followed.as_ref().map(|(_, plain)| plain);
                plain.or(run.course.as_ref())
            },
            at,
        )
    }

    fn model_by<'a>(
        &'a self,
        course: impl Fn(&'a RunClock) -> Option<&'a ClockCourse>,
        at: BoardNanos,
    ) -> Option<ClockModel> {
        let runs = self.runs.iter().enumerate();
        let (index, run) = runs
            .rev()
            .find(|(index, run)| run.from.0.saturating_add(self.moves.of(*index)) <= at.0)
            .or(self.runs.first().map(|run| (0, run)))?;
        let moved = self.moves.of(index) as f64 * 1e-9;
        let model = course(run)?.at(at.0 as f64 * 1e-9 - moved);
        Some(model.with_a_later(moved).into())
    }

    /// What the report says about it, over these frames.
    pub(crate) fn report(&self, frames: &[ColorFrame]) -> ClockReport {
        let middle = self.model_at(self.middle);
        let some = || frames.iter().step_by(30).map(|frame| frame.at);
        let range = |models: &mut dyn Iterator<Item = ClockModel>| {
            let mut sigmas = models.map(|model| model.covariance[0][0].max(0.0).sqrt() * 1e6);
            let first = sigmas.next()?;
            Some(sigmas.fold([first; 2], |[low, high], sigma| {
                [low.min(sigma), high.max(sigma)]
            }))
        };
        let exchanges = self.runs.iter().find_map(|run| run.followed.as_ref());
        let tracked = exchanges.map(|(exchanges, _)| {
            let moved = some().filter_map(|at| {
                let apart = self.model_at(at)?.offset - self.plain_model_at(at)?.offset;
                Some(apart.abs() * 1e6)
            });
            TrackedReport {
                exchanges: *exchanges,
                sigma_us_without: range(&mut some().filter_map(|at| self.plain_model_at(at))),
                moved_us: moved.fold(0.0, f64::max),
            }
        });
        let phone: Vec<PhoneNanos> = frames.iter().map(|frame| frame.phone).collect();
        let frame_period = frame_period(&phone).ok();
        let gyros = || self.runs.iter().filter_map(|run| run.gyros.as_ref());
        let sum = |of: fn(&RecordingClock) -> usize| gyros().map(of).sum();
        let course: Vec<_> = gyros().flat_map(window_results).collect();
        ClockReport {
            source: self.runs.first().map_or(NONE, |run| run.source),
            windows: sum(|gyros| gyros.windows),
            used: sum(|gyros| gyros.course.used),
            contradicting: sum(|gyros| gyros.course.contradicting),
            offset_s: middle.map_or(0.0, |model| model.offset),
            skew_ppm: middle.map_or(0.0, |model| model.skew * 1e6),
            skew_sigma_ppm: middle
                .map_or(0.0, |model| model.covariance[1][1].max(0.0).sqrt() * 1e6),
            sigma_us: range(&mut some().filter_map(|at| self.model_at(at))),
            residual_us: (!course.is_empty()).then(|| residual_rms(&course) * 1e6),
            frame_period_ns: frame_period.map(|found| (found.period_ns, found.sigma_ns)),
            frame_jitter_ns: frame_period.map(|found| found.jitter_ns),
            course,
            tracked,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::super::board_data::TimePair;
    use super::super::inputs::RigFacts;
    use super::super::later_runs::RunMark;
    use super::super::survey::PhoneClocks;
    use super::*;
    use timebase::{BoardSeconds, Wander};

    fn model(offset: f64) -> ClockModel {
        ClockModel {
            reference: BoardSeconds(10.0),
            offset,
            skew: 1e-6,
            covariance: [[1e-12, 0.0], [0.0, 1e-14]],
            wander: Wander(1e-8),
        }
    }

    fn prior(offset: f64) -> Option<Prior> {
        Some(gyro_clock::prior(model(offset)))
    }

    /// Two runs; of the phone that is aligned to all is known, of "right" as given.
    fn survey(right: [Option<f64>; 2]) -> Survey {
        let clocks = |first: f64, right: Option<f64>| {
            let right = right.map(|offset| (Some(String::from("right")), model(offset)));
            [(None, model(first))].into_iter().chain(right).collect()
        };
        Survey {
            times: vec![TimePair {
                topic: "/mcu_s10_ts".into(),
                seq: 0,
                stamp: BoardNanos(0),
                other: 7 * SECOND,
            }],
            runs: vec![RunMark {
                from: BoardNanos(20 * SECOND),
                last: BoardNanos(18 * SECOND),
                sigma_s: 1e-3,
            }],
            clocks: clocks(102.0, right[1]),
            former_clocks: vec![clocks(101.0, right[0])],
            ..Survey::default()
        }
    }

    fn input(name: &str, folder: &str, prior: Option<Prior>) -> PhoneInput {
        PhoneInput {
            name: Some(String::from(name)),
            rig: RigFacts {
                prior,
                ..RigFacts::default()
            },
            folder: PathBuf::from(folder),
            ..PhoneInput::default()
        }
    }

    #[test]
    fn a_wrong_timestamp_does_not_move_the_frame_period_and_few_have_none() {
        let clock = PhoneClock {
            map: PiecewiseMap::from_knots([]),
            remarks: Vec::new(),
            runs: Vec::new(),
            joints: Vec::new(),
            moves: Moves::default(),
            middle: BoardNanos(0),
        };
        let mut frames: Vec<ColorFrame> = (0..1_000)
            .map(|k| ColorFrame {
                phone: PhoneNanos(k * 33_330_652),
                start: BoardNanos(0),
                at: BoardNanos(0),
                image: None,
            })
            .collect();
        frames[900].phone.0 += 4_000_000;
        let (period, sigma) = clock.report(&frames).frame_period_ns.unwrap();
        assert!(
            (period - 33_330_652.0).abs() < 1e-6 && sigma < 1e-3,
            "{period} {sigma}"
        );
        assert_eq!(clock.report(&frames[..299]).frame_period_ns, None);
    }

    /// A phone that warms up by 2 ppm and was followed for ten minutes after its one twist.
    #[test]
    fn exchanges_with_the_clocks_carry_the_twists_relation_on() {
        let offset = |at: f64| 102.0 + 1e-6 * (at - 10.0) + 2e-9 * (at - 10.0).powi(2);
        let mut exchanges = Vec::new();
        for place in 0..30_000 {
            let sent = 0.02 * f64::from(place);
            // In no step with the windows; the way there is longer by 200 µs, always.
            let scatter = f64::from(place * 7_919 % 1_000) * 1e-7;
            let stamp = sent + 5e-4 + scatter;
            exchanges.push((Asked::A, stamp, stamp));
            exchanges.push((Asked::B, stamp, stamp + offset(stamp)));
        }
        let exchanges = exchanges.into_iter().map(|(asked, read, stamp)| {
            let (sent, received) = (read - 5e-4, read + 3e-4);
            let exchange = Exchange {
                sent,
                received,
                stamp,
            };
            (asked, exchange)
        });
        let mut survey = Survey {
            exchanges: exchanges.collect(),
            ..Survey::default()
        };
        survey.imu.last_ns = 600 * SECOND;
        let board = BoardInput::Mcap(PathBuf::from("none"), Moves::default());
        let clock = |survey: &Survey| {
            let phone = input("left", "", prior(102.0));
            let silent = crate::progress::Silent;
            let found = find(&board, &phone, survey, &Constants::default(), &silent);
            found.unwrap().unwrap()
        };
        let error_us = |clock: &PhoneClock| {
            let phone = PhoneNanos(((590.0 + offset(590.0)) * 1e9).round() as i64);
            (clock.map.apply(phone).unwrap().0 - 590 * SECOND) as f64 * 1e-3
        };
        let tracked = clock(&survey);
        assert!(error_us(&tracked).abs() < 10.0, "{}", error_us(&tracked));
        let frames: Vec<ColorFrame> = (20..590)
            .map(|k| ColorFrame {
                phone: PhoneNanos(0),
                start: BoardNanos(0),
                at: BoardNanos(k * SECOND),
                image: None,
            })
            .collect();
        let report = tracked.report(&frames);
        let [_, most] = report.sigma_us.unwrap();
        let added = report.tracked.unwrap();
        let [_, without] = added.sigma_us_without.unwrap();
        assert_eq!(added.exchanges, 60_000);
        assert!(most < 20.0 && without > 2.0 * most, "{report:?}");
        assert!((500.0..700.0).contains(&added.moved_us), "{added:?}");
        survey.exchanges.clear();
        let plain = clock(&survey);
        assert!(error_us(&plain).abs() > 500.0);
        assert_eq!(plain.report(&frames).tracked, None);
    }

    #[test]
    fn each_phone_has_its_own_priors_in_each_run() {
        let survey = survey([Some(201.0), Some(202.0)]);
        let left = input("left", "", prior(103.0));
        assert_eq!(priors(&left, &survey, 0), [prior(101.0), prior(103.0)]);
        let unsaid = input("left", "", None);
        assert_eq!(priors(&unsaid, &survey, 0), [prior(101.0), prior(102.0)]);
        let right = input("right", "phones/right", None);
        assert_eq!(priors(&right, &survey, 0), [prior(201.0), prior(202.0)]);
    }

    #[test]
    fn a_further_phone_never_takes_the_clock_of_the_first() {
        let survey = survey([None, None]);
        let right = input("right", "phones/right", None);
        assert_eq!(priors(&right, &survey, 0), [None, None]);
        // The first takes what there is.
        let bare = Survey {
            clocks: PhoneClocks::new(),
            former_clocks: vec![PhoneClocks::new()],
            ..survey
        };
        let pair = Some(Prior::Offset(7.0, RECORDED_MARGIN));
        assert_eq!(priors(&input("left", "", None), &bare, 0), [pair, pair]);
        assert_eq!(priors(&right, &bare, 0), [None, None]);
    }

    #[test]
    fn what_the_session_says_of_a_further_phone_moves_with_the_last_run() {
        let survey = survey([Some(201.0), None]);
        let right = input("right", "phones/right", prior(203.0));
        let [former, Some(Prior::Relation(last))] = priors(&right, &survey, 250_000_000)[..] else {
            panic!("two runs");
        };
        assert_eq!(former, prior(201.0));
        assert_eq!(last.reference, 10.25);
        assert_eq!(last.offset, 202.75);
        // The same instant of the phone is a quarter of a second later on the board.
        let phone = model(203.0).to_phone(BoardSeconds(30.0));
        assert!((last.b_to_a(phone.0) - 30.25).abs() < 1e-9);
    }
}
