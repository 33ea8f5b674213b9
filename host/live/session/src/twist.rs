//! The twists, which relate the clock of each phone to the board's.

use std::sync::Arc;
use std::time::Duration;

use clock::{ClockRelation, phone_track};
use phone::PhoneSample;
use protocol::TICK_HZ;
use recording::error_budget::micros_text;
use recording::session_file::Twist;
use twist_sync::{LeftOut, Options as EstimateOptions, Report, Stream, Warning, estimate_offset};

use crate::alignment::skew_prior;
use crate::devices::Choice;
use crate::error::{SessionError, Stop};
use crate::event::{Phase, PhoneName, Prompt, SessionEvent, Step, TwistEstimate};
use crate::link::monitors::BoardGyro;
use crate::log::Log;
use crate::options::Options;
use crate::phones::REFERENCE;
use crate::session::Session;
use clock::rates::Course;
use clock::twists::{KnownSkew, Twists};

/// Number of tries of a twist when nobody is present to decide.
const TRIES: usize = 3;

/// Additional length of the board's recording beyond the phone's, ticks.
const MARGIN: u64 = TICK_HZ as u64 / 4;

/// Expected 1-sigma with which a twist suffices, as a part of the gate's limit: the
/// phase then depends on the profile's constants more than on the twist.
const ENOUGH: f64 = 0.1;

/// 1-sigma of the offset from which an accepted twist is weak, as a part of the gate's limit.
const WEAK: f64 = 0.3;

/// 1-sigma of the skew from which an accepted twist is weak, ppm: a drift of half a millisecond a
/// minute.
const WEAK_PPM: f64 = 8.0;

/// Makes the twists before a recording, each until it passes the gates for every phone. Two
/// with some time between them give the present rate, more of them its change.
pub(crate) fn first_twists(session: &mut Session<'_>, options: &Options) -> Result<(), Stop> {
    let mut known = vec![None; session.phones.places().len()];
    for round in 0..options.twists {
        if round > 0 {
            session.enter(Phase::BetweenTwists);
            let seconds = options.twist_gap as f64 / f64::from(TICK_HZ);
            session.log.report(SessionEvent::TwistDueIn { seconds })?;
            session.pump_for(options.twist_gap)?;
        }
        known = good_twist(session, &known)?;
    }
    Ok(())
}

/// Twists until one passes the gates for every phone. Returns the earlier twists of each phone,
/// `before`, joined with this one.
fn good_twist(
    session: &mut Session<'_>,
    before: &[Option<Twists>],
) -> Result<Vec<Option<Twists>>, Stop> {
    let mut known = vec![None; before.len()];
    for attempt in 1.. {
        let clocks = match twist(session, false) {
            Ok(clocks) => clocks.unwrap_or_default(),
            Err(Stop::Failed(error)) if error.is_repeatable() && session.operator.is_present() => {
                session.log.publish(SessionEvent::StepFailed {
                    step: Step::Twist,
                    error: Arc::new(error),
                });
                vec![None]
            }
            Err(stop) => return Err(stop),
        };
        let weak = weak_twist(session, &clocks);
        if let Some((number, phone, offset_us, skew_ppm)) = weak.clone() {
            session.log.report(SessionEvent::TwistRemark {
                number,
                phone,
                remark: format!(
                    "weak: it relates the clocks to ± {} and their rate to ± {skew_ppm:.1} ppm only; \
                     twist again, faster, about all three axes, for the whole time",
                    micros_text(offset_us)
                ),
            })?;
        }
        for (place, clock) in clocks.iter().enumerate() {
            if let Some(clock) = clock {
                let joined = joined(session, place, before[place].as_ref(), clock)?;
                known[place] = Some(joined);
                take_over(session, place, &joined)?;
            }
        }
        session.save()?;
        if !session.operator.is_present() {
            // Phones may have theirs from different twists. The last try is accepted as it is.
            if known.iter().all(Option::is_some) && (weak.is_none() || attempt >= TRIES) {
                return Ok(known);
            }
            if attempt >= TRIES {
                return Err(SessionError::Twists { tries: TRIES }.into());
            }
        } else if clocks.iter().all(Option::is_some) {
            let prompt = match weak {
                Some(_) => Prompt::TwistWeak,
                None => Prompt::TwistGood,
            };
            match session.ask(prompt)? {
                Choice::Repeat => {}
                Choice::Quit => return Err(Stop::Interrupted),
                Choice::Continue | Choice::Skip => return Ok(known),
            }
        } else if ask_for_twist(session, Prompt::TwistAgain, false)? == Choice::Quit {
            return Err(Stop::Interrupted);
        }
    }
    Ok(known)
}

/// Returns the worst relation of an accepted twist that is weak, several times worse than a
/// twist of nine seconds usually gives: its number, its phone, and its 1-sigma, µs and ppm.
fn weak_twist(
    session: &Session<'_>,
    clocks: &[Option<ClockRelation>],
) -> Option<(usize, PhoneName, f64, f64)> {
    let limit_us = session.profile.align.max_offset_sigma_us * WEAK;
    let number = session.file.phones[REFERENCE].twists.len();
    let accepted = clocks.iter().enumerate();
    accepted
        .filter_map(|(place, clock)| {
            let [[offset, _], [_, skew]] = clock.as_ref()?.covariance;
            let [offset_us, skew_ppm] =
                [offset, skew].map(|variance| variance.max(0.0).sqrt() * 1e6);
            let is_weak = offset_us > limit_us || skew_ppm > WEAK_PPM;
            is_weak.then(|| (number, session.phones.name(place), offset_us, skew_ppm))
        })
        .max_by(|a, b| a.2.total_cmp(&b.2))
}

/// Joins the earlier twists of the phone at a place with one more.
fn joined(
    session: &mut Session<'_>,
    place: usize,
    before: Option<&Twists>,
    clock: &ClockRelation,
) -> Result<Twists, Stop> {
    let alone = Twists::new(*clock);
    let Some(before) = before else {
        return Ok(alone);
    };
    let phone = session.phones.name(place);
    let Some(joined) = before.with(clock) else {
        session
            .log
            .report(SessionEvent::TwistsContradict { phone })?;
        return Ok(alone);
    };
    let Course { clock, change } = joined.course();
    session.log.report(SessionEvent::TwistsJoined {
        phone,
        clock,
        change,
    })?;
    Ok(joined)
}

/// Sets the relation of the phone at a place, from its twists and the learnt skew.
fn take_over(session: &mut Session<'_>, place: usize, twists: &Twists) -> Result<(), Stop> {
    let phone = session.phones.profile(place);
    let temperature = session.monitors.temperature;
    let now = session.clock.wall_clock().timestamp();
    let learnt = skew_prior(phone, session.link.id(), now, temperature);
    let course = match learnt {
        Some(learnt) => sharpen(&mut session.log, twists, &learnt)?,
        None => twists.course(),
    };
    session.phones.set_change(place, course.change);
    let source = format!("twist {}", session.file.phones[REFERENCE].twists.len());
    let phone = session.phones.name(place);
    session.set_clock(place, phone, course.clock, &source)
}

/// Joins the twists with the learnt skew, unless that contradicts them.
fn sharpen(log: &mut Log<'_>, twists: &Twists, learnt: &KnownSkew) -> Result<Course, Stop> {
    let sharper = twists.with_known(learnt);
    if sharper.is_none() {
        log.report(SessionEvent::LearntSkewUnfit {
            learnt_ppm: learnt.rate.skew * 1e6,
            sigma_ppm: learnt.rate.sigma * 1e6,
            found_ppm: twists.course().clock.skew * 1e6,
        })?;
    }
    Ok(sharper.unwrap_or(*twists).course())
}

/// Asks for a twist. If it cannot be skipped and the user tries to, says so and asks again.
fn ask_for_twist(
    session: &mut Session<'_>,
    prompt: Prompt,
    can_skip: bool,
) -> Result<Choice, Stop> {
    loop {
        match session.ask(prompt)? {
            Choice::Skip if !can_skip => session.log.publish(SessionEvent::Prompt {
                prompt: Prompt::CannotSkip,
            }),
            choice => return Ok(choice),
        }
    }
}

/// Makes one twist with all phones. Returns, in the order of the phones, the relation of each
/// clock that passes the gates; `None` if the user skips the twist.
fn twist(
    session: &mut Session<'_>,
    can_skip: bool,
) -> Result<Option<Vec<Option<ClockRelation>>>, Stop> {
    let length_s = session.profile.phone.twist_s;
    let number = session.file.phones[REFERENCE].twists.len() + 1;
    session.enter(Phase::Twisting { number });
    session.operator.forget_typed();
    let prompt = Prompt::Twist { length_s, can_skip };
    match ask_for_twist(session, prompt, can_skip)? {
        Choice::Quit => return Err(Stop::Interrupted),
        Choice::Skip => return Ok(None),
        Choice::Continue | Choice::Repeat => {}
    }
    session.log.report(SessionEvent::TwistStarted {
        number,
        length_s,
        enough_us: session.profile.align.max_offset_sigma_us * ENOUGH,
    })?;
    session.monitors.gyro = Some(BoardGyro::default());
    let asked = twist_samples(session, length_s);
    let board = session.monitors.gyro.take().unwrap_or_default();
    session.log.report(SessionEvent::TwistFinished { number })?;
    let samples = asked?;
    if board.marked > 0 {
        let remark = format!(
            "{} samples of the board's IMU were late or at the end of its range, and are left out",
            board.marked
        );
        session.log.report(SessionEvent::TwistRemark {
            number,
            phone: session.phones.name(REFERENCE),
            remark,
        })?;
    }
    let board = BoardMotion {
        number,
        gyro: &board,
        temperature_c: session.monitors.temperature,
    };
    let places = samples.iter().enumerate();
    places
        .map(|(place, samples)| relate(session, place, &board, samples))
        .collect::<Result<_, _>>()
        .map(Some)
}

/// The board's samples of a twist.
struct BoardMotion<'a> {
    number: usize,
    gyro: &'a BoardGyro,
    temperature_c: Option<f64>,
}

/// Relates the clock of one phone to the board's by a twist.
fn relate(
    session: &mut Session<'_>,
    place: usize,
    board: &BoardMotion<'_>,
    samples: &[PhoneSample],
) -> Result<Option<ClockRelation>, Stop> {
    let Session {
        phones, log, file, ..
    } = session;
    let number = board.number;
    let (profile, phone) = (phones.profile(place), phones.name(place));
    let folder = file.phone_folder(&profile.name);
    let name = folder.join(format!("twist_{number}_phone_gyro.csv"));
    let name = name.to_string_lossy().into_owned();
    phone::save_samples(&log.folder.join(&name), samples, true).map_err(SessionError::Samples)?;
    let phone_track = phone_track(samples.iter().map(|sample| (sample.time, sample.xyz)));
    let imu = file.imu.as_ref();
    let delay_us = imu.map_or(0, |imu| imu.scale.gyro_delay_us);
    let options = EstimateOptions {
        a_delay_s: f64::from(delay_us) * 1e-6,
        b_delay_s: profile.gyro_delay_us * 1e-6,
        b_jump_s: seen_jump_s(&file.phones[place].twists),
        sigma_limit_s: file.profile.align.max_offset_sigma_us * 1e-6,
        ..EstimateOptions::default()
    };
    let result = estimate_offset(&board.gyro.track, &phone_track, &options);
    let report = match &result {
        Ok(estimate) => &estimate.report,
        Err(refusal) => &refusal.report,
    };
    let estimate = result.as_ref().ok();
    let twist = Twist {
        phone_gyro: Some(name.clone()),
        span: board.gyro.span,
        accepted: estimate.is_some(),
        clock: estimate.map(|estimate| estimate.clock),
        offset_sigma_us: estimate.map(|estimate| estimate.offset_sigma_s() * 1e6),
        skew_sigma_ppm: estimate.map(|estimate| estimate.skew_sigma() * 1e6),
        board_temperature_c: board.temperature_c,
        report: Some(report.clone()),
    };
    file.phones[place].twists.push(twist);
    file.files.push(name);
    // The motion of the hands comes first: that is what a further twist can change.
    let mut remarks: Vec<_> = together(report).into_iter().collect();
    remarks.extend(report.left_out.iter().map(LeftOut::to_string));
    if result.is_ok() {
        remarks.extend(report.warnings.iter().map(with_devices));
    }
    let result = match result {
        Ok(estimate) => Ok(estimate.clock),
        Err(refusal) => Err(refusal.to_string()),
    };
    for remark in remarks {
        let phone = phone.clone();
        log.report(SessionEvent::TwistRemark {
            number,
            phone,
            remark,
        })?;
    }
    match result {
        Ok(clock) => {
            log.report(SessionEvent::TwistAccepted(TwistEstimate {
                number,
                phone,
                clock,
            }))?;
            Ok(Some(clock))
        }
        Err(reason) => {
            log.report(SessionEvent::TwistRefused {
                number,
                phone,
                reason,
            })?;
            Ok(None)
        }
    }
}

/// Returns a sentence with the stretches in which the two moved as one body; `None` without any.
fn together(report: &Report) -> Option<String> {
    let stretches = report.together.iter();
    let stretches = stretches.map(|(from, to)| format!("from {from:.1} s to {to:.1} s"));
    let stretches = stretches.collect::<Vec<_>>().join(", ");
    (!stretches.is_empty()).then(|| format!("board and phone moved as one body {stretches}"))
}

/// Returns the sentence of a warning with the names of the two devices.
fn with_devices(warning: &Warning) -> String {
    warning.named("the board's stream", "the phone's stream")
}

/// Jump of the sawtooth in the phone's timestamps, s, by the last twist that showed one; 0 if none
/// did. In a twist without a jump, its drift cannot be distinguished from the clock's.
fn seen_jump_s(twists: &[Twist]) -> f64 {
    let jump = |twist: &Twist| twist.report.as_ref()?.sawtooth_s(Stream::B);
    twists.iter().rev().find_map(jump).unwrap_or(0.0)
}

/// Receives the phones' samples of one twist, in the order of the phones. Meanwhile the monitors
/// collect the board's.
fn twist_samples(session: &mut Session<'_>, length_s: u32) -> Result<Vec<Vec<PhoneSample>>, Stop> {
    let length = Duration::from_secs(length_s.into());
    let places = session.phones.places();
    let answers = session.ask_phones(places, |_, phone| phone.gyroscope(length), |_| {})?;
    let mut samples = Vec::new();
    for (place, answer) in answers {
        samples.push(answer.map_err(|error| session.phones.failure(place, error))?);
    }
    // The board's samples of the last moment are still on their way.
    session.pump_for(MARGIN)?;
    Ok(samples)
}

/// Twists once more, after the recording, and joins each phone's relation with its first.
pub(crate) fn second_twist(
    session: &mut Session<'_>,
    first: &[Option<ClockRelation>],
) -> Result<(), Stop> {
    // The phones' sensors are free only when their videos are closed.
    let places = session.phones.places();
    session.ask_phones(places, |_, phone| phone.await_closed(), |_| {})?;
    let Some(second) = twist(session, true)? else {
        return session.log.report(SessionEvent::SecondTwistLeftOut);
    };
    let mut is_refused = false;
    for (place, clocks) in first.iter().zip(&second).enumerate() {
        let (Some(first), Some(second)) = clocks else {
            is_refused = true;
            continue;
        };
        let clock = first.joined(second);
        let phone = session.phones.name(place);
        session.log.report(SessionEvent::SecondTwistJoined {
            phone: phone.clone(),
            clock,
        })?;
        session.set_clock(place, phone, clock, "twists at begin and end")?;
    }
    if is_refused {
        return Err(SessionError::SecondTwist.into());
    }
    Ok(())
}
