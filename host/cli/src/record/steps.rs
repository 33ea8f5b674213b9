//! The steps of a session.

use indicatif::ProgressBar;
use protocol::{Output, Period, TICK_HZ, Ticks, TrainState, TriggerAlign, TriggerStart};

use super::connect::{check_readback, preflight};
use super::further;
use super::journal::Journal;
use super::operator::Choice;
use super::phones;
use super::preflight::Checks;
use super::rig::Rig;
use super::track;
use super::twist::first_twists;
use super::{Options, Stop, seconds};
use crate::arrival::PlannedArrival;
use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use board::Board;
use recording::finding::Finding;
use recording::session_file::{Alignment, Marker, Span, Twist, Video};
use session::alignment::{plan, stated_sigma_us_at};
use session::watch::{Grid, Watch};
use timebase::ClockModel;

/// The session from the twist to the end of the recording.
pub(super) fn session(rig: &mut Rig<'_>, options: &Options, checked: Checks) -> Result<(), Stop> {
    let mut checked = Some(checked);
    step(rig, "the checks", |rig| {
        preflight(rig, options, checked.take())
    })?;
    first_twists(rig, options)?;
    step(rig, "the depth recorder", |rig| {
        rig.rounds.start_recorder(&mut rig.journal)
    })?;
    step(rig, "the trigger", |rig| {
        start_trigger(rig)?;
        check_readback(rig)
    })?;
    let video = phone_video(rig)?;
    let Some(clock) = rig.journal.file.clock else {
        return Err(
            Failure::new(ExitStatus::Refused, "the clocks were not related")
                .next_step("the twist was skipped or refused: record again, and twist faster")
                .into(),
        );
    };
    let alignment = align(rig, &clock, &video)?;
    phones::place_others(&rig.phones, &mut rig.journal)?;
    confirm_arrival(rig, &alignment)?;
    further::start(rig)?;
    record(rig, options, &alignment)
}

/// Starts the train at the best period that is known so far.
fn start_trigger(rig: &mut Rig<'_>) -> Result<(), Stop> {
    let width = rig.profile.pulse_width();
    let nominal = Period::from_ticks(TICK_HZ / rig.profile.depth.fps);
    let period = match (&rig.profile.phone.learnt, rig.journal.file.clock) {
        (Some(learnt), Some(clock)) => {
            let picos = learnt.frame_period_ns * 1e3 / (1.0 + clock.skew)
                * f64::from(rig.profile.frame_ratio());
            Period::from_picos(picos.round() as u64)
                .filter(|period| period.in_bounds())
                .unwrap_or(nominal)
        }
        _ => nominal,
    };
    let status = rig.call(Board::trigger)?;
    if status.state != TrainState::Stopped {
        rig.call(|board| board.stop_trigger(Output::Camera))?;
    }
    rig.trigger_started = true;
    let start = TriggerStart {
        period,
        width,
        first_edge: None,
        first_fraction: 0,
    };
    rig.call(|board| board.start_trigger(Output::Camera, start))?;
    rig.journal.info(
        "trigger",
        &format!("the trigger runs with a period of {period}"),
    )
}

/// Starts the phones' videos; gives what the phone said that is aligned to.
fn phone_video(rig: &mut Rig<'_>) -> Result<Video, Stop> {
    let what = match rig.phones.places().len() {
        1 => "the phone's video",
        _ => "the phones' videos",
    };
    step(rig, what, phones::start_videos)?;
    rig.journal.file.video.ok_or_else(|| {
        Failure::new(ExitStatus::Phone, "the phone's video was skipped")
            .next_step("record again with the phone's video: the trigger is aligned to it")
            .into()
    })
}

/// Sends the train onto the phone's frames.
fn align(rig: &mut Rig<'_>, clock: &ClockModel, video: &Video) -> Result<Alignment, Stop> {
    let course = rig.phones.course(0, *clock);
    let planned = plan(rig.profile, &course, video).map_err(|error| {
        Failure::new(ExitStatus::Refused, error.to_string())
            .next_step("set the profile's values to the camera's mode, or twist longer")
    })?;
    for remark in &planned.remarks {
        rig.journal.info("align", remark)?;
    }
    let alignment = planned.alignment;
    let align = TriggerAlign {
        anchor: alignment.anchor,
        anchor_fraction: 0,
        period: Period(alignment.period_q32),
        slew: rig.profile.slew(),
    };
    let plan = rig.call(|board| board.align(Output::Camera, align))?;
    let alignment = Alignment {
        arrival_pulse: Some(plan.arrival_pulse),
        arrival: Some(plan.arrival),
        phase_sigma_us: stated_sigma_us_at(&alignment, plan.arrival.into()),
        board_temperature_c: twist_temperature(&rig.journal.file.twists),
        ..alignment
    };
    rig.journal.file.alignment = Some(alignment);
    rig.journal.save()?;
    rig.journal.info(
        "align",
        &format!(
            "aligning: {:+.1} µs over {} frames; {}",
            plan.shift.as_secs_f64() * 1e6,
            plan.frames,
            alignment.promise()
        ),
    )?;
    Ok(alignment)
}

/// Waits until the board says that the train is on its grid.
fn confirm_arrival(rig: &mut Rig<'_>, alignment: &Alignment) -> Result<(), Stop> {
    let (Some(pulse), Some(at)) = (alignment.arrival_pulse, alignment.arrival) else {
        return Ok(());
    };
    let planned = PlannedArrival { pulse, at };
    let bar = rig.context.spinner();
    bar.set_message("waiting for the trigger to arrive on the phone's frames");
    let confirmed = rig.pump_until(|rig| match rig.observers.arrived {
        Some(arrived) if arrived.pulse >= pulse => Some(true),
        _ => planned.is_overdue(rig.now()).then_some(false),
    });
    bar.finish_and_clear();
    if confirmed? {
        return rig.journal.save();
    }
    let status = rig.call(Board::trigger)?;
    if planned.has_come(&status) {
        return rig.journal.problem(Finding::check(
            "arrival_unconfirmed",
            "the board did not report the arrival, but its train runs on the grid",
        ));
    }
    let state = status.state;
    Err(Failure::new(
        ExitStatus::NoAnswer,
        format!("the trigger did not arrive at pulse {pulse} ({state:?})"),
    )
    .next_step("look at `smartdepthsync trigger status`, then record again")
    .into())
}

/// Periods from the arrival on the grid to the begin of the recorded span: the depth
/// camera may make its next frames by its own clock, or mark them as bad, after the
/// phase was moved.
const SETTLING_PERIODS: u64 = 15;

/// Records, until the time is up or somebody stops it.
fn record(rig: &mut Rig<'_>, options: &Options, alignment: &Alignment) -> Result<(), Stop> {
    let period = Period(alignment.period_q32);
    let settled = alignment.arrival.map(|arrival| {
        let wait = u64::from(period.ticks()) * SETTLING_PERIODS;
        Ticks(arrival.0.saturating_add(wait))
    });
    // What is counted lies in the span.
    rig.pump_until(|rig| (rig.now() >= settled.unwrap_or_default()).then_some(()))?;
    let from = rig.now();
    rig.link.board.start_counting();
    rig.observers.watch = Some(Watch::new(
        Grid {
            anchor: alignment.anchor,
            fraction: 0,
            period,
        },
        rig.now(),
    ));
    rig.journal.file.recorded = Some(Span { from, to: from });
    rig.journal.save()?;
    let end = options.duration.map(|ticks| from.0.saturating_add(ticks));
    let how_long = options.duration.map_or(String::new(), |ticks| {
        format!(" for {:.0} s", ticks as f64 / f64::from(TICK_HZ))
    });
    let keys = if rig.context.said.is_diverted() {
        "m sets a mark, q stops"
    } else {
        "Enter sets a mark, Ctrl-C stops"
    };
    let text = format!("recording{how_long}; {keys}");
    rig.journal.info("recording", &text)?;
    rig.operator.forget_typed();
    track::follow(rig);
    let bar = recording_bar(rig.context, options.duration);
    let mut due_twist_told = false;
    let mut due: Vec<u64> = options.markers.clone();
    due.sort_unstable_by(|a, b| b.cmp(a));
    let mut look = |rig: &mut Rig<'_>| {
        bar.set_position((rig.now().0.saturating_sub(from.0)) / u64::from(TICK_HZ));
        while let Some(&next) = due.last()
            && rig.now().0 >= from.0.saturating_add(next)
        {
            due.pop();
            mark(&mut rig.journal, Ticks(from.0 + next), None)?;
        }
        rig.watch_videos()?;
        track::steer(rig)?;
        if !due_twist_told && is_twist_due(rig) {
            due_twist_told = true;
            tell_due_twist(rig)?;
        }
        match rig.operator.mark() {
            Some(Some(label)) => {
                let label = (!label.is_empty()).then_some(label);
                let now = rig.now();
                mark(&mut rig.journal, now, label)?;
            }
            Some(None) => return Ok(Some(())),
            None => {}
        }
        let now = rig.link.overdue(rig.now());
        Ok(end.is_some_and(|end| now.0 >= end).then_some(()))
    };
    let result = rig.pump_until(|rig| look(rig).transpose());
    bar.finish_and_clear();
    result?
}

/// Temperature of the board at the last twist that was accepted.
fn twist_temperature(twists: &[Twist]) -> Option<f64> {
    let last = twists.iter().rfind(|twist| twist.accepted)?;
    last.board_temperature_c
}

/// Whether the phase is known less well by now than a twist must know it.
fn is_twist_due(rig: &Rig<'_>) -> bool {
    let (gauge, now) = (&rig.journal.live.gauge, rig.now().into());
    let alignment = rig.journal.file.alignment.as_ref();
    alignment.is_some_and(|known| gauge.phase_known(known, now).1)
}

fn tell_due_twist(rig: &mut Rig<'_>) -> Result<(), Stop> {
    let text = format!(
        "time for another twist: clocks wander and rigs warm up, and the phase is known to \
         {:.0} µs (1-sigma) no more; stop, and record again when it matters",
        rig.profile.align.max_offset_sigma_us
    );
    rig.journal.warn("twist_due", &text)
}

pub(super) fn mark(
    journal: &mut Journal<'_>,
    at: Ticks,
    label: Option<String>,
) -> Result<(), Stop> {
    let label = label.unwrap_or_else(|| format!("marker {}", journal.file.markers.len() + 1));
    let phone = journal.file.clock.map(|clock| clock.ticks_to_phone(at));
    journal.write(|writer, _| writer.marker(at, phone, &label))?;
    journal.live.gauge.marker(at, &label);
    let text = format!("mark: {label}");
    journal.file.markers.push(Marker { at, label });
    journal.save()?;
    journal.info("marker", &text)
}

/// Runs a step; if it fails in a way that may pass, and somebody is there, it
/// can be repeated or left out.
pub(super) fn step(
    rig: &mut Rig<'_>,
    name: &str,
    mut run: impl FnMut(&mut Rig<'_>) -> Result<(), Stop>,
) -> Result<(), Stop> {
    loop {
        let failure = match run(rig) {
            Err(Stop::Failed(failure)) if is_repeatable(&failure) => failure,
            other => return other,
        };
        if !rig.operator.is_present() {
            return Err(failure.into());
        }
        rig.context.say(format!("error: {failure}"));
        let prompt = format!("{name}: [Enter] or [r] try again, [s] skip, [q] quit");
        match ask(rig, &prompt)? {
            Choice::Continue | Choice::Repeat => {}
            Choice::Skip => return Ok(()),
            Choice::Quit => return Err(Stop::Interrupted),
        }
    }
}

/// Whether trying again may help.
pub(super) fn is_repeatable(failure: &Failure) -> bool {
    matches!(
        failure.status(),
        ExitStatus::Phone | ExitStatus::Refused | ExitStatus::DepthRecorder
    )
}

pub(super) fn ask(rig: &mut Rig<'_>, prompt: &str) -> Result<Choice, Stop> {
    rig.context.say(prompt);
    rig.pump_until(|rig| rig.operator.answer())
}

fn recording_bar(context: &Context, duration: Option<u64>) -> ProgressBar {
    let length = duration.map(|ticks| ticks / seconds(1));
    let template = if length.is_some() {
        "{bar:30} {pos}/{len} s"
    } else {
        "{spinner} {pos} s"
    };
    context.progress(length, template)
}
