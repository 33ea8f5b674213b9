//! The twist: it relates the clock of each phone to the board's.

use std::time::{Duration, Instant};

use protocol::{TICK_HZ, Ticks};

use super::journal::Journal;
use super::operator::Choice;
use super::phones::Phones;
use super::rig::Rig;
use super::steps::{ask, is_repeatable};
use super::{Options as SessionOptions, Stop};
use crate::outcome::{ExitStatus, Failure};
use crate::view::lacking_motion;
use phone::PhoneSample;
use phone::task::PhoneTask;
use recording::finding::Severity;
use recording::session_file::{Span, Twist};
use session::alignment::{skew_prior, with_known_skew};
use session::rates::Course;
use session::twist_report::{TwistReport, report_of};
use session::twists::{KnownSkew, Twists};
use timebase::ClockModel;
use timebase::{board_track, phone_track};
use twist_sync::{GyroTrack, Options, estimate_offset};

/// How often a twist is tried when nobody is there to decide.
const TWIST_TRIES: usize = 3;

/// How much longer than the phone's recording the board's is taken, ticks.
const TWIST_MARGIN: u64 = TICK_HZ as u64 / 4;

/// The twists before a recording: each until it passes the gates, of every phone. Two at a
/// distance know the rate of today; more of them, how it changes.
pub(super) fn first_twists(rig: &mut Rig<'_>, options: &SessionOptions) -> Result<(), Stop> {
    let mut courses = vec![None; rig.phones.places().len()];
    for round in 0..options.twists {
        if round > 0 {
            let wait_s = options.twist_gap as f64 / f64::from(TICK_HZ);
            let text = format!("the next twist begins in {wait_s:.0} s");
            rig.journal.info("twist", &text)?;
            rig.pump_for(options.twist_gap)?;
        }
        courses = good_twist(rig, &courses)?;
    }
    Ok(())
}

/// Twists until one passes the gates, of every phone. `before` is what the earlier ones
/// say; gives it with this one.
fn good_twist(rig: &mut Rig<'_>, before: &[Option<Twists>]) -> Result<Vec<Option<Twists>>, Stop> {
    let mut courses = vec![None; before.len()];
    for attempt in 1.. {
        let clocks = match twist(rig, Leave::Refused) {
            Ok(clocks) => clocks.unwrap_or_default(),
            Err(Stop::Failed(failure)) if is_repeatable(&failure) && rig.operator.is_present() => {
                rig.context.say(format!("error: {failure}"));
                vec![None]
            }
            Err(stop) => return Err(stop),
        };
        for (place, clock) in clocks.iter().enumerate() {
            if let Some(clock) = clock {
                let known = joined(rig, place, before[place].as_ref(), clock)?;
                courses[place] = Some(known);
                know(rig, place, &known)?;
            }
        }
        rig.journal.save()?;
        // With nobody there, phones may have got theirs from different twists.
        if courses.iter().all(Option::is_some) && !rig.operator.is_present() {
            return Ok(courses);
        }
        if clocks.iter().all(Option::is_some) {
            match ask(rig, "[Enter] go on, [r] twist again, [q] quit")? {
                Choice::Repeat => continue,
                Choice::Quit => return Err(Stop::Interrupted),
                Choice::Continue | Choice::Skip => return Ok(courses),
            }
        }
        if rig.operator.is_present() {
            if ask_for_twist(rig, "[Enter] or [r] twist again, [q] quit", Leave::Refused)?
                == Choice::Quit
            {
                return Err(Stop::Interrupted);
            }
        } else if attempt >= TWIST_TRIES {
            return Err(Failure::new(
                ExitStatus::Refused,
                format!("none of {TWIST_TRIES} twists gave a trustworthy relation of the clocks"),
            )
            .next_step(
                "twist faster, about all three axes, with phone and board fixed to each other",
            )
            .into());
        }
    }
    Ok(courses)
}

/// What the earlier twists say of the phone at a place, with one more.
fn joined(
    rig: &mut Rig<'_>,
    place: usize,
    before: Option<&Twists>,
    clock: &ClockModel,
) -> Result<Twists, Stop> {
    let alone = Twists::of(*clock);
    let Some(before) = before else {
        return Ok(alone);
    };
    let Some(joined) = before.with(clock) else {
        let text = format!(
            "this twist contradicts the earlier ones{}: it alone is used",
            rig.phones.whose(place)
        );
        rig.journal
            .tell(Severity::Check, "twists_contradict", &text)?;
        return Ok(alone);
    };
    let course = joined.course();
    let text = format!(
        "twists so far{}: skew {:+.4} ± {:.4} ppm, changing by {:+.3} ± {:.3} ppm/min",
        rig.phones.whose(place),
        course.clock.skew * 1e6,
        course.clock.covariance[1][1].max(0.0).sqrt() * 1e6,
        course.change.per_s * 60e6,
        course.change.variance.max(0.0).sqrt() * 60e6
    );
    rig.journal.info("twist", &text)?;
    Ok(joined)
}

/// Keeps what is known of the phone at a place: its twists, and what was learnt before.
fn know(rig: &mut Rig<'_>, place: usize, twists: &Twists) -> Result<(), Stop> {
    let phone = rig.phones.profile(place);
    let temperature = rig.observers.temperature;
    let learnt = skew_prior(phone, &rig.link.id, jiff::Timestamp::now(), temperature);
    let known = match learnt {
        Some(learnt) => sharpen(&mut rig.journal, twists, &learnt)?,
        None => twists.course(),
    };
    rig.phones.set_change(place, known.change);
    let number = rig.journal.file.twists.len();
    rig.journal
        .set_clock(place, known.clock, &format!("twist {number}"))
}

/// Whether a twist can be left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Leave {
    /// Nothing can be aligned without it.
    Refused,
    Allowed,
}

/// Asks; where the twist cannot be left out, says so and asks again.
fn ask_for_twist(rig: &mut Rig<'_>, prompt: &str, leave: Leave) -> Result<Choice, Stop> {
    loop {
        match ask(rig, prompt)? {
            Choice::Skip if leave == Leave::Refused => {
                let text = "this twist cannot be left out: without it nothing relates the clocks";
                rig.context.say(text);
            }
            choice => return Ok(choice),
        }
    }
}

/// One twist, of all phones. Gives the relation of each phone's clock if it passes
/// the gates, by the phone's place; nothing if it was left out.
fn twist(rig: &mut Rig<'_>, leave: Leave) -> Result<Option<Vec<Option<ClockModel>>>, Stop> {
    let length = rig.profile.phone.twist_s;
    rig.operator.forget_typed();
    if rig.operator.is_present() {
        let skip = match leave {
            Leave::Refused => "",
            Leave::Allowed => ", [s] to leave it out",
        };
        let prompt = format!(
            "Twist the rig for {length} s about all axes. [Enter] to begin{skip}, [q] to quit"
        );
        match ask_for_twist(rig, &prompt, leave)? {
            Choice::Quit => return Err(Stop::Interrupted),
            Choice::Skip => return Ok(None),
            Choice::Continue | Choice::Repeat => {}
        }
    }
    let number = rig.journal.file.twists.len() + 1;
    rig.journal.info(
        "twist",
        &format!("twist {number}: twist now, for {length} s"),
    )?;
    rig.observers.gyro = Some(Vec::new());
    let asked = twist_samples(rig, length);
    let board = rig.observers.gyro.take().unwrap_or_default();
    let samples = asked?;
    let (times, rates): (Vec<Ticks>, Vec<[f64; 3]>) = board.into_iter().unzip();
    let span = Span {
        from: times.first().copied().unwrap_or_default(),
        to: times.last().copied().unwrap_or_default(),
    };
    let mcu = board_track(&times, rates);
    let board = Seen {
        number,
        track: &mcu,
        span,
        temperature_c: rig.observers.temperature,
    };
    let (phones, journal) = (&rig.phones, &mut rig.journal);
    let places = samples.iter().enumerate();
    places
        .map(|(place, samples)| relate(phones, journal, place, &board, samples))
        .collect::<Result<_, _>>()
        .map(Some)
}

/// What the board has seen of a twist.
struct Seen<'a> {
    number: usize,
    track: &'a GyroTrack,
    span: Span,
    temperature_c: Option<f64>,
}

/// Relates the clock of one phone to the board's by a twist.
fn relate(
    phones: &Phones<'_>,
    journal: &mut Journal<'_>,
    place: usize,
    board: &Seen<'_>,
    samples: &[PhoneSample],
) -> Result<Option<ClockModel>, Stop> {
    let number = board.number;
    let phone = phones.profile(place);
    let folder = journal.file.phone_folder(&phone.name);
    let name = folder.join(format!("twist_{number}_phone_gyro.csv"));
    let name = name.to_string_lossy().into_owned();
    let label = format!("twist {number}{}", phones.whose(place));
    phone::save_samples(&journal.folder.join(&name), samples, true)?;
    let phone_times: Vec<_> = samples.iter().map(|sample| sample.time).collect();
    let phone_rates = samples.iter().map(|sample| sample.xyz).collect();
    let phone_track = phone_track(&phone_times, phone_rates);
    let imu = journal.file.imu.as_ref();
    let delay_us = imu.map_or(0, |imu| imu.scale.gyro_delay_us);
    let options = Options {
        a_delay_s: f64::from(delay_us) * 1e-6,
        b_delay_s: phone.gyro_delay_us * 1e-6,
        sigma_limit_s: journal.file.profile.align.max_offset_sigma_us * 1e-6,
        ..Options::default()
    };
    let result = estimate_offset(board.track, &phone_track, &options);
    let report = TwistReport::from(report_of(&result));
    let estimate = result.as_ref().ok();
    let twist = Twist {
        phone_gyro: Some(name.clone()),
        span: board.span,
        accepted: estimate.is_some(),
        clock: estimate.map(|estimate| estimate.clock.into()),
        offset_sigma_us: estimate.map(|estimate| estimate.offset_sigma_s() * 1e6),
        skew_sigma_ppm: estimate.map(|estimate| estimate.skew_sigma() * 1e6),
        board_temperature_c: board.temperature_c,
        report: serde_json::to_value(&report).unwrap_or(serde_json::Value::Null),
    };
    journal.keep_twist(place, twist);
    journal.file.files.push(name);
    // First what the hands did: that is what a further twist can change.
    if let Some(together) = report.together_text() {
        journal.info("twist", &format!("{label}: {together}"))?;
    }
    for stretch in &report.left_out {
        journal.info("twist", &format!("{label}: {}", stretch.text))?;
    }
    match result {
        Ok(estimate) => {
            let text = format!(
                "{label}: offset {:.6} s ± {:.2} µs, skew {:+.3} ± {:.3} ppm",
                estimate.clock.offset,
                estimate.offset_sigma_s() * 1e6,
                estimate.clock.skew * 1e6,
                estimate.skew_sigma() * 1e6
            );
            journal.info("twist", &text)?;
            for warning in &report.warnings {
                journal.info("twist", warning)?;
            }
            Ok(Some(estimate.clock.into()))
        }
        Err(refusal) => {
            let text = format!("{label} refused: {refusal}");
            journal.tell(Severity::Check, "twist_refused", &text)?;
            Ok(None)
        }
    }
}

/// The phones' samples of one twist, by their places; the board's go into the rig
/// meanwhile.
fn twist_samples(rig: &mut Rig<'_>, length: u32) -> Result<Vec<Vec<PhoneSample>>, Stop> {
    let length = Duration::from_secs(length.into());
    let places = rig.phones.places();
    let record = |_, task: &PhoneTask| task.gyroscope(length);
    let bar = rig.context.spinner();
    let mut shown = Instant::now();
    let answers = rig.ask_phones(places, record, |rig| {
        if shown.elapsed() > Duration::from_millis(300) {
            shown = Instant::now();
            bar.set_message(motion_hint(rig.journal.live.gauge.twist_rms()));
        }
    });
    bar.finish_and_clear();
    let mut samples = Vec::new();
    for (place, answer) in answers? {
        samples.push(answer.map_err(|error| rig.phones.failure(place, error))?);
    }
    // The board's samples of the last moment are still on their way.
    rig.pump_for(TWIST_MARGIN)?;
    Ok(samples)
}

/// Whether the motion so far suffices, from the root mean square of each axis.
fn motion_hint(rms: [f64; 3]) -> String {
    let hint = lacking_motion(rms).unwrap_or("good");
    let [x, y, z] = rms;
    format!("x {x:.1}  y {y:.1}  z {z:.1} rad/s rms: {hint}")
}

/// Takes the skew that was learnt before into what the twists say.
fn sharpen(journal: &mut Journal<'_>, twists: &Twists, learnt: &KnownSkew) -> Result<Course, Stop> {
    let sharper = twists.with_known(learnt);
    if sharper.is_none() {
        let text = format!(
            "the learnt skew of {:+.3} ± {:.3} ppm does not fit this twist's {:+.3} ppm; it is \
             not used",
            learnt.rate.skew * 1e6,
            learnt.rate.sigma * 1e6,
            twists.course().clock.skew * 1e6
        );
        journal.tell(Severity::Check, "learnt_skew", &text)?;
    }
    Ok(sharper.unwrap_or(*twists).course())
}

/// Twists once more and joins what it says with the first; of each phone by itself.
pub(super) fn second_twist(rig: &mut Rig<'_>, first: &[Option<ClockModel>]) -> Result<(), Stop> {
    // The phones' sensors are free only when their videos are closed.
    let places = rig.phones.places();
    rig.ask_phones(places, |_, task| task.await_closed(), |_| {})?;
    let Some(second) = twist(rig, Leave::Allowed)? else {
        return rig.journal.info("twist", "the second twist was left out");
    };
    let mut refused = false;
    for (place, clocks) in first.iter().zip(&second).enumerate() {
        let (Some(first), Some(second)) = clocks else {
            refused = true;
            continue;
        };
        if !rig.journal.file.runs.is_empty() {
            // The first twist is of the run before the reset: its rate holds, its
            // offset is better known from this one.
            let sigma = first.covariance[1][1].max(0.0).sqrt();
            let clock = with_known_skew(second, first.skew, sigma).unwrap_or(*second);
            let source = "twist at the end, after a reset of the board";
            rig.journal.set_clock(place, clock, source)?;
            continue;
        }
        let joined = first.joined(second);
        let text = format!(
            "both twists{}: skew {:+.4} ± {:.4} ppm",
            rig.phones.whose(place),
            joined.skew * 1e6,
            joined.covariance[1][1].sqrt() * 1e6
        );
        rig.journal.info("twist", &text)?;
        rig.journal
            .set_clock(place, joined, "twists at begin and end")?;
    }
    if refused {
        return Err(
            Failure::new(ExitStatus::Refused, "the second twist was refused")
                .next_step("twist again, faster and about all axes")
                .into(),
        );
    }
    Ok(())
}
