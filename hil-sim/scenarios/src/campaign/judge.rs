//! Judges a run by what is promised.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use board::finding::{EventKind, FindingKind, Severity};
use protocol::{DeviceToHost, ImuFlags, ImuState, ResetCause, TICK_HZ, Ticks};
use recording::MCAP_FILE;
use recording::reader::{Item, Reader};
use recording::session_file::{Alignment, SessionFile, SessionOutcome};
use recording::verify::verify;
use rig::wiring::{self, UNITS_PER_TICK};
use session::event::{Phase, SessionEvent};
use session::run::Ended as EndedSession;
use stm32f4_sim::pin::{Level, Pin};
use stm32f4_sim::sim::{FailureKind, ResetCause as ChipReset};
use stm32f4_sim::time::{SimDuration, SimTime};
use system::ReadMonitor;

use super::plan::{Fault, Plan};
use super::{Ended, Verdict};
use crate::board_truth::{BoardTruth, Compared, Train};
use crate::virtual_session::POWER_ON_S;

/// Most that a kill may cost, as the recording promises.
const KILL_COSTS: SimDuration = SimDuration::from_millis(1_000);
/// A status comes every second: the last one before the end is no older.
const STATUS: SimDuration = SimDuration::from_millis(1_500);
/// Time in which a sensor is to run again after the end of its fault, and between two samples.
const RECOVERY_US: u64 = 1_000_000;
const SAMPLE_US: u64 = 2_000;
/// Accuracy of a time of day in board time, s: it is recorded once a second.
const HOST_TIME_S: f64 = 1.5;

/// An edge of a pin.
pub(super) type PinEdge = (Pin, Level, SimTime);

/// A message that the session was given.
struct Delivered<'a> {
    at: SimTime,
    message: &'a DeviceToHost,
    is_recorded: bool,
}

pub(super) fn judge(plan: &Plan, ended: &Ended) -> Result<Verdict> {
    let session = match &ended.run.ended {
        Ok(Some(session)) => session,
        other => bail!("no session came about: {other:?}"),
    };
    let zero = ended.truth.zero.context("the board's zero is not known")?;
    let reset = reset(plan, ended)?;
    let outcome = judge_end(plan, ended, session)?;
    let delivered = delivered(ended);
    let compared = compare(ended, session, zero, reset, &delivered)?;
    let pulses_lost = judge_losses(&session.file, &delivered)?;
    judge_samples(plan, &session.file, &compared, &delivered)?;
    contains(&session.folder, &delivered, SimTime::NEVER).context("the recording")?;
    judge_time_of_day(plan, ended, &session.folder, zero)?;
    no_false_alarm(&session.folder, outcome)?;
    if let Some(killed) = ended.happened.killed {
        let promised = killed.units().saturating_sub(KILL_COSTS.units());
        contains(&ended.killed, &delivered, SimTime::from_units(promised))
            .context("the killed recording")?;
    }
    let file = &session.file;
    let mut problems = BTreeMap::new();
    for problem in &file.problems {
        *problems.entry(problem.kind.to_string()).or_default() += 1;
    }
    Ok(Verdict {
        plan: plan.clone(),
        outcome,
        virtual_s: ended.truth.end.as_secs_f64(),
        pulses: compared.pulses,
        delivered: compared.reports + compared.samples + compared.captures,
        disturbed: compared.disturbed,
        period_changes: compared.period_changes,
        pulses_lost,
        samples_lost: file.counts.imu.lost,
        captures_lost: file.counts.captures.lost,
        damaged_frames: file.damaged_frames,
        reconnects: file.reconnects,
        problems,
        digest: crc32fast::hash(&std::fs::read(session.folder.join(MCAP_FILE))?),
    })
}

/// The check of a recording that holds what was delivered finds no damage, and no loss unless the session
/// had one.
fn no_false_alarm(folder: &Path, outcome: SessionOutcome) -> Result<()> {
    let verification = verify(folder, &ReadMonitor::default())?;
    let most = if outcome == SessionOutcome::Good {
        Severity::Good
    } else {
        Severity::Check
    };
    let mut alarms = verification.findings.iter();
    let alarm = alarms.find(|finding| finding.severity > most);
    ensure!(alarm.is_none(), "false alarm of verify: {alarm:?}");
    Ok(())
}

/// When the board was reset; the firmware failed in no other way.
fn reset(plan: &Plan, ended: &Ended) -> Result<Option<SimTime>> {
    let mut reset = ended.happened.reset;
    for failure in &ended.failures {
        let is_watchdog = failure.kind == FailureKind::Reset(ChipReset::IndependentWatchdog);
        ensure!(
            is_watchdog && plan.has(Fault::WatchdogReset) && reset.is_none(),
            "{failure}"
        );
        reset = Some(failure.at);
    }
    Ok(reset)
}

/// The session went on, or ended as it should.
fn judge_end(plan: &Plan, ended: &Ended, session: &EndedSession) -> Result<SessionOutcome> {
    let file = &session.file;
    let kinds: Vec<&FindingKind> = file.problems.iter().map(|p| &p.kind).collect();
    let outcome = match &session.result {
        Ok(outcome @ (SessionOutcome::Good | SessionOutcome::Loss)) => *outcome,
        other => bail!("the session ended with {other:?}; {kinds:?}"),
    };
    let stopping = |event: &SessionEvent| {
        let phase = Phase::Stopping;
        matches!(event, SessionEvent::Phase { phase: begun } if *begun == phase)
    };
    let stopped = ended.run.time_of(stopping).context("it never stopped")?;
    // Only a phone that was away when it was to be stopped may be given up, and only that
    // may be left recording.
    let is_missed = kinds.iter().any(|&kind| *kind == EventKind::PhoneLost);
    let was_away = ended.happened.phone_away.is_some_and(|at| at >= stopped);
    ensure!(
        !is_missed || was_away,
        "the phone was there and is missed: {kinds:?}"
    );
    ensure!(
        !ended.phone_records || is_missed,
        "the phone was left recording"
    );
    let events = || ended.run.events.iter().map(|seen| &seen.stamped.event);
    if plan.resets() {
        // The recording ends there.
        let cause = events().find_map(|event| match event {
            SessionEvent::BoardReset { cause, .. } => Some(*cause),
            _ => None,
        });
        let expected = plan.events.iter().find_map(|event| match event.fault {
            Fault::ResetPressed => Some(ResetCause::Pin),
            Fault::WatchdogReset => Some(ResetCause::Watchdog),
            Fault::SupplyReset => Some(ResetCause::PowerOn),
            _ => None,
        });
        ensure!(
            cause == expected && outcome == SessionOutcome::Loss,
            "reset by {expected:?}, but {cause:?} is reported, and {outcome:?}; {kinds:?}"
        );
        return Ok(outcome);
    }
    let is_harmless = plan.events.iter().all(|event| event.fault.is_harmless());
    ensure!(
        !is_harmless || is_missed || outcome == SessionOutcome::Good,
        "loss without a reason: {kinds:?}"
    );
    // It was whole again by the end.
    let statuses = ended.run.events.iter().rev();
    let last =
        statuses
            .filter(|seen| seen.at <= stopped)
            .find_map(|seen| match &seen.stamped.event {
                SessionEvent::Board {
                    message: DeviceToHost::Status(status),
                    ..
                } => Some((seen.at, status)),
                _ => None,
            });
    let (at, status) = last.context("no status ever came")?;
    ensure!(
        status.imu.state == ImuState::Running,
        "the IMU did not come back: {:?}",
        status.imu
    );
    ensure!(
        stopped.since(at) <= STATUS,
        "the link did not come back; {kinds:?}"
    );
    Ok(outcome)
}

/// The board's messages that the session was given, in order.
fn delivered(ended: &Ended) -> Vec<Delivered<'_>> {
    let mut is_recorded = false;
    let mut delivered = Vec::new();
    for seen in &ended.run.events {
        match &seen.stamped.event {
            SessionEvent::Phase { phase } => {
                is_recorded = matches!(phase, Phase::Recording { .. });
            }
            SessionEvent::Board { message, .. } => delivered.push(Delivered {
                at: seen.at,
                message,
                is_recorded,
            }),
            _ => {}
        }
    }
    delivered
}

/// Compares what the session was given, and the pins, with the ground truth.
fn compare(
    ended: &Ended,
    session: &EndedSession,
    zero: SimTime,
    reset: Option<SimTime>,
    delivered: &[Delivered<'_>],
) -> Result<Compared> {
    let wrong = |what: String| anyhow!("{what}");
    let alignment = session.file.alignment.context("it was not aligned")?;
    let (train, first, arrival) = train(&alignment, session)?;
    let arrived = SimTime::from_units(zero.units() + arrival.0 * UNITS_PER_TICK);
    let reset = reset.unwrap_or(SimTime::NEVER);
    let mut truth = BoardTruth::at_zero(zero);
    for at in &ended.happened.disturbed {
        truth.disturbed(*at);
    }
    truth.started(train, first);
    truth.asked_for(ended.periods.clone());
    let on_grid = |(pin, _, at): &&PinEdge| *pin != wiring::TRIGGER || *at >= arrived;
    let edges = ended.edges.iter().filter(|edge| edge.2 < reset);
    truth
        .take(
            edges.filter(on_grid).copied(),
            ended.truth.imu.iter().copied(),
        )
        .map_err(wrong)?;
    let mut is_recorded = false;
    for Delivered {
        message,
        is_recorded: is_now,
        ..
    } in delivered
    {
        if *is_now && !std::mem::replace(&mut is_recorded, true) {
            truth.count_missing_from_here();
        }
        match message {
            // On the way to the grid.
            DeviceToHost::Pulse(pulse) if pulse.at < arrival => {}
            message => truth.message(message).map_err(wrong)?,
        }
    }
    Ok(truth.compared())
}

/// The train on the grid of an alignment, with its first pulse there and that one's time.
fn train(alignment: &Alignment, session: &EndedSession) -> Result<(Train, u64, Ticks)> {
    let number = alignment.arrival_pulse.context("no arrival was planned")?;
    let arrival = alignment.arrival.context("no arrival was planned")?;
    let grid = alignment.plan.grid();
    let (edges, _) = grid.first_from(arrival);
    let train = Train {
        grid,
        number: i64::try_from(number)? - i64::try_from(edges)?,
        width: session.file.profile.pulse_width(),
    };
    Ok((train, number, arrival))
}

/// Compares the counts of losses with what is missing, and returns the pulses.
fn judge_losses(file: &SessionFile, delivered: &[Delivered<'_>]) -> Result<u64> {
    let recorded = || delivered.iter().filter(|delivered| delivered.is_recorded);
    // By the board's numbers, from the first to the last that came.
    let missing = |pick: fn(&DeviceToHost) -> Option<u64>| {
        let numbers: Vec<u64> = recorded().filter_map(|d| pick(d.message)).collect();
        let span = match (numbers.first(), numbers.last()) {
            (Some(first), Some(last)) => last - first + 1,
            _ => 0,
        };
        span.saturating_sub(numbers.len() as u64)
    };
    let pulses = missing(|message| match message {
        DeviceToHost::Pulse(pulse) => Some(pulse.number),
        _ => None,
    });
    let samples = missing(|message| match message {
        DeviceToHost::Imu(sample) => Some(sample.seq.into()),
        _ => None,
    });
    let captures = missing(|message| match message {
        DeviceToHost::Capture(capture) => Some(capture.seq.into()),
        _ => None,
    });
    let counts = &file.counts;
    for (name, missing, counted) in [
        ("pulses", pulses, counts.pulses.lost),
        ("samples", samples, counts.imu.lost),
        ("captures", captures, counts.captures.lost),
    ] {
        ensure!(
            missing == counted,
            "{missing} {name} are missing, {counted} are counted as lost"
        );
    }
    Ok(pulses)
}

/// An edge of data-ready without a sample is, by the pin, a sample that was lost, and counted. The
/// edges of a sensor that is being set up again have no number. That it was is said by the first
/// sample after it, and where the link lost that one by the status.
fn judge_samples(
    plan: &Plan,
    file: &SessionFile,
    compared: &Compared,
    delivered: &[Delivered<'_>],
) -> Result<()> {
    if plan.resets() {
        return Ok(());
    }
    let is_marked = delivered.iter().any(|delivered| match delivered.message {
        DeviceToHost::Imu(sample) => delivered.is_recorded && sample.flags.has(ImuFlags::FIRST),
        _ => false,
    });
    let is_reported = file
        .problems
        .iter()
        .any(|p| p.kind == EventKind::ImuRecovered);
    let hits = plan.events.iter().filter(|event| event.fault.hits_imu());
    let without_number: u64 = if is_marked || is_reported {
        hits.map(|hit| (hit.for_us + RECOVERY_US) / SAMPLE_US).sum()
    } else {
        0
    };
    let (missing, counted) = (compared.samples_missing, file.counts.imu.lost);
    ensure!(
        (counted..=counted + without_number).contains(&missing),
        "{missing} samples are missing by the pin, {counted} are counted as lost, and \
         {without_number} at most are of a sensor that was set up again"
    );
    Ok(())
}

/// Checks that the time of day is recorded as it was, and that nothing else depends on it.
fn judge_time_of_day(plan: &Plan, ended: &Ended, folder: &Path, zero: SimTime) -> Result<()> {
    let step = plan
        .events
        .iter()
        .find(|e| e.fault == Fault::HostClockStepped);
    let step = step.map(|event| event.begins(ended.happened.began).as_secs_f64());
    let mut count = 0;
    for entry in Reader::open(folder)? {
        let entry = entry?;
        let Item::HostTime(time) = &entry.item else {
            continue;
        };
        count += 1;
        let at = zero.as_secs_f64() + entry.at.as_secs_f64();
        let recorded_s = time.time_ref.nanos() as f64 * 1e-9 - POWER_ON_S as f64;
        // While the host does not read, the board's messages grow old before it has them.
        let stalls = plan.events.iter().filter(|e| e.fault == Fault::HostStalled);
        let waited_s = stalls
            .map(|e| [e.begins(ended.happened.began), e.ends(ended.happened.began)])
            .map(|times| times.map(|time| time.as_secs_f64()))
            .filter(|[from, to]| (from - HOST_TIME_S..*to).contains(&at))
            .map(|[from, to]| to - from)
            .fold(0.0, f64::max);
        let is_near = |step_s: i64| {
            (-HOST_TIME_S..HOST_TIME_S + waited_s).contains(&(recorded_s - at - step_s as f64))
        };
        let before = step.is_none_or(|step| at < step + HOST_TIME_S) && is_near(0);
        let after = step.is_some_and(|step| at > step - HOST_TIME_S) && is_near(plan.clock_step_s);
        // While nothing comes from the board, its time is an old one.
        let is_old = ended
            .run
            .events
            .iter()
            .any(|seen| matches!(seen.stamped.event, SessionEvent::LinkLost { .. }));
        ensure!(
            before || after || is_old,
            "at {at:.1} s the time of day is recorded as {recorded_s:.1} s after power-on"
        );
    }
    let seconds = u64::from(TICK_HZ);
    let span = ended.run.ended.as_ref().ok().and_then(Option::as_ref);
    let span = span.and_then(|session| session.file.recorded);
    let recorded = span.map_or(0, |span| (span.to.0 - span.from.0) / seconds);
    ensure!(
        count > recorded / 4,
        "the time of day is recorded {count} times"
    );
    Ok(())
}

/// Each pulse and sample that was given until then is in the file once.
fn contains(folder: &Path, given: &[Delivered<'_>], until: SimTime) -> Result<()> {
    let mut pulses: BTreeMap<Ticks, i64> = BTreeMap::new();
    let mut samples: BTreeMap<Ticks, i64> = BTreeMap::new();
    for delivered in given.iter().filter(|delivered| delivered.at <= until) {
        match delivered.message {
            DeviceToHost::Pulse(pulse) => *pulses.entry(pulse.at).or_default() += 1,
            DeviceToHost::Imu(sample) => *samples.entry(sample.at).or_default() += 1,
            _ => {}
        }
    }
    let mut last = None;
    for entry in Reader::open(folder)? {
        let entry = entry?;
        if let Item::Imu(_) = &entry.item {
            ensure!(
                last.is_none_or(|last| entry.at > last),
                "time goes back to {:?}",
                entry.at
            );
            last = Some(entry.at);
        }
        let count = match &entry.item {
            Item::Pulse(_) => pulses.get_mut(&entry.at),
            Item::Imu(_) => samples.get_mut(&entry.at),
            _ => None,
        };
        if let Some(count) = count {
            *count -= 1;
        }
    }
    for (name, left) in [("pulses", &pulses), ("samples", &samples)] {
        let missing = left.values().filter(|&&count| count > 0).count();
        let twice = left.values().filter(|&&count| count < 0).count();
        let first = left.iter().find(|(_, count)| **count != 0);
        ensure!(
            missing + twice == 0,
            "{missing} {name} are missing and {twice} there twice, first {first:?}"
        );
    }
    Ok(())
}
