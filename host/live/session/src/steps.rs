//! The steps of a session, from the checks to the end of the recording.

pub mod close;
pub mod connect;
mod led;

use board::imu::{ImuLook, Scale};
use clock::{BoardToPhone, ClockRelation};
use protocol::{
    AlignTrigger, EdgeGrid, Output, Period, QueryImu, QueryTrigger, SetPeriod, StartTrigger,
    StopTrigger, TICK_HZ, Ticks, TrainState, TriggerStart, TriggerStatus,
};
use recording::error_budget::ErrorPart;
use recording::session_file::{Alignment, ImuInfo, Marker, Span, Twist, Video};
use recording::strobes::{ExposureFinder, StrobesRefused};

use crate::alignment::plan;
use crate::auxiliary;
use crate::checks::{Checks, IMU_TIME, TRIGGER_TIME};
use crate::devices::Wish;
use crate::error::{SessionError, Stop};
use crate::event::{Phase, SessionEvent, Step};
use crate::link::watch::Watch;
use crate::options::Options;
use crate::phones::REFERENCE;
use crate::phones::videos::{place_others, start_videos, watch_videos};
use crate::session::Session;
use crate::twist::first_twists;

/// Longest wait for the report of an arrival beyond its plan, ticks.
const ARRIVAL_MARGIN: u64 = 3 * TICK_HZ as u64;

/// Number of periods from the arrival on the grid to the beginning of the recorded span. After a
/// change of phase, the depth camera may take its next frames by its own clock, or mark them as
/// bad.
const SETTLING_PERIODS: u64 = 15;

/// Runs the session from the checks to the end of the recording. `checked` is the result of a
/// first call of `host_checks`, which checks the computer.
pub(crate) fn run(
    session: &mut Session<'_>,
    options: &Options,
    checked: Checks,
    host_checks: &mut dyn FnMut() -> Checks,
) -> Result<(), Stop> {
    session.enter(Phase::Checking);
    let mut checked = Some(checked);
    session.step(Step::Checks, |session| {
        check(session, checked.take().unwrap_or_else(&mut *host_checks))
    })?;
    first_twists(session, options)?;
    session.enter(Phase::StartingRecorder);
    session.step(Step::Recorder, |session| {
        let depth = &session.profile.depth;
        session.housekeeping.start_recorder(depth, &mut session.log)
    })?;
    session.enter(Phase::StartingTrigger);
    session.step(Step::Trigger, |session| {
        start_trigger(session)?;
        check_readback(session)
    })?;
    session.enter(Phase::StartingVideos);
    session.step(Step::Videos, start_videos)?;
    let video = session.file.phones[REFERENCE]
        .video
        .ok_or(SessionError::NoVideo)?;
    let clock = session.file.clock().ok_or(SessionError::NoClock)?;
    let led = if options.led > 0 {
        Some(led::output(session)?)
    } else {
        None
    };
    if let Some(output) = led.filter(|output| output.is_camera()) {
        led::flash(session, output, options.led)?;
    }
    session.enter(Phase::Aligning);
    let alignment = align(session, &clock, &video)?;
    place_others(session)?;
    confirm_arrival(session, &alignment)?;
    // A camera in step with the phone's frames flashes on the same rows of each: what light of its
    // flashes the phone sees stands still, and is not the LED's.
    if let Some(output) = led.filter(|output| !output.is_camera()) {
        led::flash(session, output, options.led)?;
    }
    auxiliary::start(session)?;
    record(session, options, &alignment)
}

/// Checks both sides as `doctor` does. The results are reported and kept in the session file.
fn check(session: &mut Session<'_>, mut checks: Checks) -> Result<(), Stop> {
    checks.firmware(&session.link.board, Some(session.profile));
    for phone in &session.file.phones {
        let version = phone.version.as_deref();
        checks.phone(version.unwrap_or("of unknown version"), &phone.address);
    }
    session.link.board.start_counting();
    let setup = checks.look_at_imu(|| {
        session.monitors.look = Some(ImuLook::default());
        let looked = session.pump_for(IMU_TIME);
        let look = session.monitors.look.take().unwrap_or_default();
        looked?;
        Ok::<_, Stop>((look, session.call(|board| board.call(QueryImu))?))
    })?;
    // The board may have been looking for the sensor until now.
    if let Some(scale) = Scale::from_setup(&setup) {
        session.link.set_scale(scale);
        session.log.publish(SessionEvent::ScaleChanged { scale });
        session.file.imu = Some(ImuInfo { setup, scale });
    }
    let conversation = session.link.board.conversation();
    checks.link(conversation.counts().lost(), conversation.damaged_frames());
    session.file.preflight.clear();
    report_checks(session, checks)
}

/// Checks that the train that was just started appears on the wire.
fn check_readback(session: &mut Session<'_>) -> Result<(), Stop> {
    session.pump_for(TRIGGER_TIME)?;
    let mut checks = Checks::default();
    checks.readback(&session.call(|board| board.call(QueryTrigger(Output::Camera)))?);
    report_checks(session, checks)
}

/// Reports and keeps the results of checks, and fails with the first bad one.
fn report_checks(session: &mut Session<'_>, checks: Checks) -> Result<(), Stop> {
    for check in &checks.checks {
        session.log.report(SessionEvent::Checked {
            check: check.clone(),
        })?;
    }
    let result = checks.result();
    session.file.preflight.extend(checks.checks);
    session.save()?;
    Ok(result?)
}

/// Starts the train with the best period that is known so far.
fn start_trigger(session: &mut Session<'_>) -> Result<(), Stop> {
    let profile = session.profile;
    let nominal = Period::from_ticks(TICK_HZ / profile.depth.fps);
    let period = match (&profile.phone.learnt, session.file.clock()) {
        (Some(learnt), Some(clock)) => {
            let picos = learnt.frame_period_ns * 1e3 / (1.0 + clock.skew)
                * f64::from(profile.frame_ratio());
            Period::from_picos(picos.round() as u64)
                .filter(|period| period.in_bounds())
                .unwrap_or(nominal)
        }
        _ => nominal,
    };
    let status = session.call(|board| board.call(QueryTrigger(Output::Camera)))?;
    if status.state != TrainState::Stopped {
        session.call(|board| board.call(StopTrigger(Output::Camera)))?;
    }
    session.trigger_started = true;
    let start = TriggerStart {
        period,
        width: profile.pulse_width(),
        first_edge: None,
    };
    let output = Output::Camera;
    session.monitors.exposures = Some(ExposureFinder::new(profile.depth.train()));
    session.call(|board| board.call(StartTrigger { output, start }))?;
    session.log.report(SessionEvent::TriggerStarted {
        period_s: period.as_secs_f64(),
    })
}

/// Moves the train onto the phone's frames.
fn align(
    session: &mut Session<'_>,
    clock: &ClockRelation,
    video: &Video,
) -> Result<Alignment, Stop> {
    let course = session.phones.course(REFERENCE, *clock);
    use_seen_exposures(session)?;
    forget_other_app(session)?;
    let planned = plan(&session.file.profile, &course, video).map_err(SessionError::Alignment)?;
    for remark in planned.remarks {
        session
            .log
            .report(SessionEvent::AlignmentRemark { remark })?;
    }
    let (output, to) = (Output::Camera, planned.command);
    let plan = session.call(|board| board.call(AlignTrigger { output, to }))?;
    let mut alignment = planned.alignment;
    alignment.arrival_pulse = Some(plan.arrival_pulse);
    alignment.arrival = Some(plan.arrival);
    alignment.phase_sigma_us = alignment.stated_sigma_us_at(plan.arrival.into());
    alignment.plan.board_temperature_c = twist_temperature(&session.file.phones[REFERENCE].twists);
    session.file.alignment = Some(alignment);
    session.save()?;
    session.log.report(SessionEvent::Aligning {
        shift_us: plan.shift.as_secs_f64() * 1e6,
        frames: plan.frames,
        alignment,
    })?;
    Ok(alignment)
}

/// Takes the middle of the depth exposure from the photodiode, if it sees the camera's light. A
/// bias that was measured as a whole includes the error of the profile's, which then stays.
fn use_seen_exposures(session: &mut Session<'_>) -> Result<(), Stop> {
    let Some(finder) = &session.monitors.exposures else {
        return Ok(());
    };
    let seen = match finder.statistics() {
        Ok(seen) => seen,
        Err(StrobesRefused::Dark) => return Ok(()),
        Err(refused) => {
            let remark = format!("{refused}; the profile's centre of the depth exposure is used");
            return session.log.report(SessionEvent::AlignmentRemark { remark });
        }
    };
    let profile = &mut session.file.profile;
    let (part, sigma_us) = profile.depth.center_part();
    let profile_us = profile.depth.center_offset_us;
    let disagrees = part == ErrorPart::MeasuredDepth && seen.disagree_with(profile_us, sigma_us);
    if profile.frame_sync.bias_measured.is_none() {
        let date = session.clock.wall_clock().date();
        profile.depth.set_measured(&seen, date);
    }
    session.log.report(SessionEvent::ExposuresSeen {
        seen,
        profile_us,
        disagrees,
    })
}

/// Takes a measurement that was made with another version of the app for none.
fn forget_other_app(session: &mut Session<'_>) -> Result<(), Stop> {
    let version = session.file.phones[REFERENCE].version.clone();
    let phone = &mut session.file.profile.phone;
    let Some(of) = phone.forget_if_other_app(version.as_deref()) else {
        return Ok(());
    };
    let remark = format!(
        "the phone's rows were measured with version {of} of the app; measure them again with \
         `smartdepthsync record --calibrate --led`"
    );
    session.log.report(SessionEvent::AlignmentRemark { remark })
}

/// The planned arrival of a train on its grid.
struct PlannedArrival {
    /// Number of the first pulse on the grid.
    pulse: u64,
    /// Time of that pulse.
    at: Ticks,
}

impl PlannedArrival {
    /// Returns true if the board should have reported the arrival by now.
    const fn is_overdue(&self, now: Ticks) -> bool {
        now.0 > self.at.0.saturating_add(ARRIVAL_MARGIN)
    }

    /// Returns true if the train is on its grid according to its state. The report of the arrival
    /// may have been lost on the link.
    fn has_occurred(&self, train: &TriggerStatus) -> bool {
        train.state == TrainState::Running && train.pulses > self.pulse
    }
}

/// Waits until the board reports that the train is on its grid.
fn confirm_arrival(session: &mut Session<'_>, alignment: &Alignment) -> Result<(), Stop> {
    let (Some(pulse), Some(at)) = (alignment.arrival_pulse, alignment.arrival) else {
        return Ok(());
    };
    let planned = PlannedArrival { pulse, at };
    let is_confirmed = session.pump_until(|session| match session.monitors.arrived {
        Some(arrived) if arrived.pulse >= pulse => Some(true),
        _ => planned.is_overdue(session.now()).then_some(false),
    })?;
    if is_confirmed {
        return Ok(session.save()?);
    }
    let status = session.call(|board| board.call(QueryTrigger(Output::Camera)))?;
    if planned.has_occurred(&status) {
        return session.log.report(SessionEvent::ArrivalUnconfirmed);
    }
    let state = status.state;
    Err(SessionError::NotArrived { pulse, state }.into())
}

/// Records until the time is up or the operator stops it.
fn record(session: &mut Session<'_>, options: &Options, alignment: &Alignment) -> Result<(), Stop> {
    let grid = alignment.plan.grid();
    let settled = alignment.arrival.map(|arrival| {
        let wait = u64::from(grid.period.ticks()) * SETTLING_PERIODS;
        Ticks(arrival.0.saturating_add(wait))
    });
    let settled = settled.unwrap_or_default();
    session.pump_until(|session| (session.now() >= settled).then_some(()))?;
    // Counting begins with the span.
    let from = session.now();
    session.begin_recording(grid);
    session.save()?;
    let end = options.duration.map(|ticks| from.0.saturating_add(ticks));
    session.log.report(SessionEvent::RecordingStarted {
        length_s: options.duration.map(|ticks| Ticks(ticks).as_secs_f64()),
    })?;
    session.operator.forget_typed();
    let now = session.link.board.now();
    if let Some(tracking) = &mut session.tracking {
        tracking.follow(&mut session.file, now);
    }
    let mut is_twist_due_reported = false;
    let mut due: Vec<u64> = options.markers.clone();
    due.sort_unstable_by(|a, b| b.cmp(a));
    let mut look = |session: &mut Session<'_>| {
        while let Some(&next) = due.last()
            && session.now().0 >= from.0.saturating_add(next)
        {
            due.pop();
            mark(session, Ticks(from.0 + next), None)?;
        }
        for place in watch_videos(&mut session.phones, &mut session.log)? {
            let label = format!("{}: video ended", session.phones.name(place));
            let now = session.now();
            mark(session, now, Some(label))?;
        }
        steer(session)?;
        let sigma_us = clocks_sigma_us(session, alignment);
        if let Some(stored) = &mut session.file.alignment {
            stored.note_sigma_us(sigma_us);
        }
        // A twist at the end relates the clocks again.
        let is_twist_due = sigma_us > session.profile.align.max_offset_sigma_us;
        if !is_twist_due_reported && !options.second_twist && is_twist_due {
            is_twist_due_reported = true;
            session.log.report(SessionEvent::TwistDue {
                limit_us: session.profile.align.max_offset_sigma_us,
            })?;
        }
        match session.operator.wish() {
            Some(Wish::Mark(label)) => {
                let now = session.now();
                mark(session, now, label)?;
            }
            Some(Wish::Stop) => {
                session.file.asked_s = None;
                return Ok(Some(()));
            }
            None => {}
        }
        let now = session.link.overdue(session.now());
        Ok(end.is_some_and(|end| now.0 >= end).then_some(()))
    };
    session.pump_until(|session| look(session).transpose())?
}

impl Session<'_> {
    /// Begins the recorded span, in which pulses are checked against this grid.
    pub fn begin_recording(&mut self, grid: EdgeGrid) {
        let from = self.now();
        self.link.board.start_counting();
        self.monitors.watch = Some(Watch::new(grid, from));
        self.file.recorded = Some(Span { from, to: from });
        self.enter(Phase::Recording { since: from });
    }
}

/// Changes the period if it is time to and the clocks are known.
fn steer(session: &mut Session<'_>) -> Result<(), Stop> {
    let now = session.link.board.now();
    let Some(tracking) = &mut session.tracking else {
        return Ok(());
    };
    let Some(period) = tracking.due(&mut session.file, &mut session.log, now)? else {
        return Ok(());
    };
    // A broken link is reopened here: messages wait in the board's queue until their grid is
    // known.
    let output = Output::Camera;
    let answer = session.try_call(|board| board.call(SetPeriod { output, period }))?;
    match &mut session.tracking {
        Some(tracking) => {
            let watch = session.monitors.watch.as_mut();
            tracking.stepped(answer, watch, &mut session.file, &mut session.log)
        }
        None => Ok(()),
    }
}

/// Returns the temperature of the board at the last accepted twist, °C.
fn twist_temperature(twists: &[Twist]) -> Option<f64> {
    let last = twists.iter().rfind(|twist| twist.accepted)?;
    last.board_temperature_c
}

/// Returns the present 1-sigma of the phase by clocks and frame period, µs.
fn clocks_sigma_us(session: &Session<'_>, alignment: &Alignment) -> f64 {
    let tracked = session.tracking.as_ref().and_then(|t| t.sigma_us());
    let untracked = || {
        let (now, temperature) = (session.now().into(), session.monitors.temperature);
        alignment.plan.phase_sigma_us_now(now, temperature)
    };
    tracked.unwrap_or_else(untracked)
}

/// Sets a mark; without a label it is numbered.
fn mark(session: &mut Session<'_>, at: Ticks, label: Option<String>) -> Result<(), Stop> {
    let label = label.unwrap_or_else(|| format!("marker {}", session.file.markers.len() + 1));
    let phone = session.file.clock().map(|clock| clock.ticks_to_phone(at));
    session
        .log
        .write(|writer, _| writer.marker(at, phone, &label))?;
    session.file.markers.push(Marker {
        at,
        label: label.clone(),
    });
    session.save()?;
    session.log.report(SessionEvent::Marked {
        marked_at: at,
        label,
    })
}
