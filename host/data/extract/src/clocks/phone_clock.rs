//! Relation of the phone's clock to the board's: from both gyroscopes over the whole
//! recording, otherwise from the session, otherwise from the offset that
//! the published system recorded.

use std::path::Path;

use crate::clocks::gyro_clock::{self, residual_rms, window_results};
use crate::clocks::streams::{self, OtherGyro, Span, related};
use crate::error::ExtractError;
use crate::frames::ColorFrame;
use crate::inputs::PhoneInput;
use crate::inputs::board_data::Reference;
use crate::inputs::survey::Survey;
use crate::report::{ClockReport, ClockSource};
use crate::time::{BoardNanos, PhoneNanos, PiecewiseMap, SECOND};
use clock::ClockRelation;
use clock::frames::frame_period;
use clock::tracker::{Asked, Exchange, followed};
use system::ReadMonitor;
use twist_sync::{ClockCourse, Options, Prior, RecordingClock};

/// Largest error of a recorded offset, s.
const RECORDED_MARGIN: f64 = 0.5;
/// Span of the relation beyond either end of the recording, s.
const BEYOND: i64 = 60;

/// Relation of a phone's clock to the board's.
#[derive(Clone, Debug)]
pub(crate) struct PhoneClock {
    /// Map from phone time to board time.
    pub(crate) map: PiecewiseMap<PhoneNanos, BoardNanos>,
    /// Remarks for the report.
    pub(crate) remarks: Vec<String>,
    source: ClockSource,
    gyros: Option<RecordingClock>,
    /// Offset over time; `None` if only one offset is known.
    course: Option<ClockCourse>,
    /// Number of exchanges with both clocks that went into the relation.
    exchanges: Option<usize>,
    middle: BoardNanos,
}

/// Returns the knowledge about a phone's clock before the gyroscopes are compared.
///
/// For another phone, only what the recording says about that phone counts: pairs of times
/// belong to the phone that the trigger was aligned to.
fn prior(input: &PhoneInput, survey: &Survey) -> Option<Prior> {
    let name = input.other_name().map(str::to_owned);
    let recorded = survey.clocks.get(&name).copied();
    let known = input.constants.prior.or(recorded.map(Prior::Relation));
    if input.is_other() {
        known
    } else {
        known.or_else(|| recorded_offset(survey))
    }
}

/// Finds the relation of a phone's clock to the board's.
///
/// # Errors
///
/// Fails if there is no relation, if reading was stopped, or if the board's recording cannot be
/// read.
pub(crate) fn find(
    board: &Path,
    input: &PhoneInput,
    survey: &Survey,
    monitor: &ReadMonitor,
) -> Result<PhoneClock, ExtractError> {
    let (first, last) = (survey.imu.first_ns, survey.imu.last_ns);
    let span = Span {
        from: BoardNanos(first.saturating_sub(BEYOND * SECOND)),
        to: BoardNanos(last.saturating_add(BEYOND * SECOND)),
    };
    let prior = prior(input, survey);
    let gyro = input.files.as_ref().and_then(|files| files.gyro.as_deref());
    let found = match gyro {
        None => missing("there is no gyroscope file of the phone"),
        Some(_) if survey.imu.samples == 0 => missing("the board's recording has no IMU samples"),
        Some(gyro) => {
            let phone = OtherGyro {
                open: &|| streams::phone(gyro, monitor),
                options: Options {
                    a_delay_s: input.constants.board_imu_delay_ns as f64 * 1e-9,
                    b_delay_s: input.constants.phone_imu_delay_ns as f64 * 1e-9,
                    ..Options::for_windows()
                },
                prior,
            };
            related(board, span, &phone, monitor)
        }
    };
    let mut clock = match found {
        Ok(gyros) => PhoneClock {
            course: Some(gyros.course.clone()),
            gyros: Some(gyros),
            ..PhoneClock::new(ClockSource::Gyroscopes)
        },
        Err(error) if error.is_fatal() => return Err(error),
        Err(error) => PhoneClock::from_prior(prior, &error)?,
    };
    clock.middle = BoardNanos(first.midpoint(last));
    // Another phone's clock is not read during a recording.
    if !input.is_other() {
        clock.follow(&survey.exchanges, prior);
    }
    clock.map = PiecewiseMap::from_knots(match (&clock.course, prior) {
        (Some(course), _) => gyro_clock::knots(course, span.from, span.to),
        (None, Some(Prior::Offset(offset, _))) => {
            let offset = (offset * 1e9).round() as i64;
            let knot = |at: BoardNanos| (PhoneNanos(at.0.saturating_add(offset)), at);
            vec![knot(span.from), knot(span.to)]
        }
        (None, _) => Vec::new(),
    });
    Ok(clock)
}

fn missing<T>(what: &str) -> Result<T, ExtractError> {
    Err(ExtractError::Missing(what.to_owned()))
}

/// Returns the offset of the last pair of times of the published system's `/mcu_s10_ts`.
fn recorded_offset(survey: &Survey) -> Option<Prior> {
    let mut pairs = survey.times.iter().rev();
    let pair = pairs.find(|pair| pair.of == Reference::Phone)?;
    let offset = pair.other.checked_sub(pair.stamp.0)?;
    Some(Prior::Offset(offset as f64 * 1e-9, RECORDED_MARGIN))
}

impl PhoneClock {
    fn new(source: ClockSource) -> Self {
        Self {
            map: PiecewiseMap::from_knots([]),
            remarks: Vec::new(),
            source,
            gyros: None,
            course: None,
            exchanges: None,
            middle: BoardNanos(0),
        }
    }

    /// Returns the relation without the gyroscopes, which failed with `reason`.
    fn from_prior(prior: Option<Prior>, reason: &ExtractError) -> Result<Self, ExtractError> {
        match prior {
            None => missing(&format!(
                "phone time cannot be related to board time: {reason}"
            )),
            Some(Prior::Relation(model)) => {
                let Some(course) = ClockCourse::from_estimates(&[model], model.wander) else {
                    return missing("the session's clock model is not usable");
                };
                Ok(Self {
                    course: Some(course),
                    remarks: vec![format!(
                        "the clock relation is the session's, from the twist alone, and not from \
                         the whole recording: {reason}"
                    )],
                    ..Self::new(ClockSource::Session)
                })
            }
            Some(Prior::Offset(..)) => Ok(Self {
                remarks: vec![format!(
                    "the clock relation is the one offset that was recorded, without the drift of \
                     the clocks: {reason}"
                )],
                ..Self::new(ClockSource::Bag)
            }),
        }
    }

    /// Refines the relation by exchanges with both clocks, between windows of motion or from the
    /// session's relation on.
    fn follow(&mut self, exchanges: &[(Asked, Exchange)], prior: Option<Prior>) {
        let known = match (&self.gyros, prior) {
            (Some(gyros), _) => gyros.estimates.clone(),
            (None, Some(Prior::Relation(relation))) => vec![relation],
            (None, _) => return,
        };
        let knots = followed(exchanges, &known);
        if let Some(plain) = self.course.take_if(|_| !knots.is_empty()) {
            self.course = Some(plain.with_followed(&knots));
            self.exchanges = Some(exchanges.len());
        }
    }

    /// Returns the relation at a board time, with its uncertainty; `None` if only one offset is
    /// known.
    pub(crate) fn model_at(&self, at: BoardNanos) -> Option<ClockRelation> {
        Some(self.course.as_ref()?.at(at.0 as f64 * 1e-9))
    }

    /// Reports the relation over the phone's frames.
    pub(crate) fn report(&self, frames: &[ColorFrame]) -> ClockReport {
        let middle = self.model_at(self.middle);
        let some = frames.iter().step_by(30);
        let mut sigmas = some
            .filter_map(|frame| self.model_at(frame.at))
            .map(|model| model.covariance[0][0].max(0.0).sqrt() * 1e6);
        let sigma_us = sigmas.next().map(|first| {
            sigmas.fold([first; 2], |[low, high], sigma| {
                [low.min(sigma), high.max(sigma)]
            })
        });
        let phone: Vec<PhoneNanos> = frames.iter().map(|frame| frame.phone).collect();
        let frame_period = frame_period(&phone).ok();
        let gyros = self.gyros.as_ref();
        let count = |field: fn(&RecordingClock) -> usize| gyros.map_or(0, field);
        let course = gyros.map_or_else(Vec::new, window_results);
        ClockReport {
            source: self.source,
            windows: count(|gyros| gyros.windows),
            used: count(|gyros| gyros.course.used),
            contradicting: count(|gyros| gyros.course.contradicting),
            offset_s: middle.map_or(0.0, |model| model.offset),
            skew_ppm: middle.map_or(0.0, |model| model.skew * 1e6),
            skew_sigma_ppm: middle
                .map_or(0.0, |model| model.covariance[1][1].max(0.0).sqrt() * 1e6),
            sigma_us,
            residual_us: (!course.is_empty()).then(|| residual_rms(&course) * 1e6),
            frame_period_ns: frame_period.map(|found| (found.period_ns, found.sigma_ns)),
            frame_jitter_ns: frame_period.map(|found| found.jitter_ns),
            course,
            exchanges: self.exchanges,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::constants::Constants;
    use crate::inputs::board_data::TimePair;
    use crate::inputs::survey::PhoneClocks;
    use clock::Wander;

    fn model(offset: f64) -> ClockRelation {
        ClockRelation {
            reference: 10.0,
            offset,
            skew: 1e-6,
            covariance: [[1e-12, 0.0], [0.0, 1e-14]],
            wander: Wander(1e-8),
        }
    }

    fn known(offset: f64) -> Option<Prior> {
        Some(Prior::Relation(model(offset)))
    }

    fn input(name: &str, folder: &str, prior: Option<Prior>) -> PhoneInput {
        PhoneInput {
            name: Some(String::from(name)),
            constants: Constants {
                prior,
                ..Constants::default()
            },
            folder: PathBuf::from(folder),
            ..PhoneInput::default()
        }
    }

    #[test]
    fn a_wrong_timestamp_does_not_move_the_frame_period_and_few_have_none() {
        let clock = PhoneClock::new(ClockSource::Session);
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
    fn exchanges_with_the_clocks_extend_the_relation_of_a_twist() {
        let offset = |at: f64| 102.0 + 1e-6 * (at - 10.0) + 2e-9 * (at - 10.0).powi(2);
        let mut exchanges = Vec::new();
        for place in 0..30_000 {
            let sent = 0.02 * f64::from(place);
            // Not in step with the windows; the way there always takes 200 µs longer.
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
        let board = Path::new("none");
        let clock = |survey: &Survey| {
            let phone = input("left", "", known(102.0));
            find(board, &phone, survey, &ReadMonitor::default()).unwrap()
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
        assert_eq!(report.exchanges, Some(60_000));
        assert!(most < 20.0, "{report:?}");
        survey.exchanges.clear();
        let plain = clock(&survey);
        assert!(error_us(&plain).abs() > 500.0);
        let report = plain.report(&frames);
        assert!(report.sigma_us.unwrap()[1] > 2.0 * most, "{report:?}");
        assert_eq!(report.exchanges, None);
    }

    #[test]
    fn another_phone_never_gets_the_clock_of_the_reference() {
        let right = Some(String::from("right"));
        let mut survey = Survey {
            times: vec![TimePair {
                of: Reference::Phone,
                seq: 0,
                stamp: BoardNanos(0),
                other: 7 * SECOND,
            }],
            clocks: PhoneClocks::from([(None, model(102.0)), (right, model(202.0))]),
            ..Survey::default()
        };
        let first = |known| input("left", "", known);
        let other = |known| input("right", "phones/right", known);
        // The session's final relation takes precedence over the recorded one.
        assert_eq!(prior(&first(known(103.0)), &survey), known(103.0));
        assert_eq!(prior(&first(None), &survey), known(102.0));
        assert_eq!(prior(&other(None), &survey), known(202.0));
        survey.clocks.pop_last();
        assert_eq!(prior(&other(None), &survey), None);
        // The reference falls back to the pair of times.
        survey.clocks.clear();
        let pair = Some(Prior::Offset(7.0, RECORDED_MARGIN));
        assert_eq!(prior(&first(None), &survey), pair);
        assert_eq!(prior(&other(None), &survey), None);
    }
}
