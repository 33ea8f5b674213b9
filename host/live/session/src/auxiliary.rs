//! The auxiliary outputs of a rig: cameras on the trigger outputs 2 to 4, and a lidar
//! that takes the board for a GNSS receiver.
//!
//! They start when the camera's train is on its grid. An output runs at a multiple
//! of the train's period, with a fixed delay after its pulses; phase and period are
//! exact to 2⁻³² ticks, so the output does not drift against the train.

use board::BoardError;
use board::gnss::{self, parse_baud};
use protocol::{
    EdgeGrid, Output, Period, QueryTrigger, Refusal, StartTrigger, StopGnss, StopTrigger, TICK_HZ,
    TrainState, TriggerStart, TriggerStatus,
};
use recording::profile::{Lidar, TriggerOutput};

use crate::error::{SessionError, Stop};
use crate::event::SessionEvent;
use crate::session::Session;

/// Time to the first pulse in the first attempt, ticks: the command must arrive before it.
const LEAD: u64 = TICK_HZ as u64 / 2;

/// Number of attempts to start an output, each with twice the time to the first pulse: 16 s at last.
const ATTEMPTS: u32 = 6;

/// Starts the outputs and the lidar of the profile.
///
/// # Errors
///
/// The board cannot be reached or refuses; the period of an output is longer than a second.
pub(crate) fn start(session: &mut Session<'_>) -> Result<(), Stop> {
    let profile = session.profile;
    for sensor in &profile.outputs {
        start_output(session, sensor)?;
    }
    match &profile.lidar {
        Some(lidar) => start_lidar(session, lidar),
        None => Ok(()),
    }
}

/// Stops the outputs and the lidar of the profile. Tries all, and returns the first failure.
///
/// # Errors
///
/// The board cannot be reached.
pub(crate) fn stop(session: &mut Session<'_>) -> Result<(), Stop> {
    let profile = session.profile;
    let mut result = Ok(());
    for sensor in &profile.outputs {
        if let Some(output) = Output::from_number(sensor.output) {
            let stopped = session.call(|board| board.call(StopTrigger(output)));
            result = result.and(stopped.map(drop));
        }
    }
    if profile.lidar.is_some() {
        result = result.and(session.call(|board| board.call(StopGnss)).map(drop));
    }
    result
}

fn start_output(session: &mut Session<'_>, sensor: &TriggerOutput) -> Result<(), Stop> {
    let too_slow = || SessionError::OutputTooSlow {
        name: sensor.name.clone(),
        every: sensor.every,
    };
    let output = Output::from_number(sensor.output).ok_or_else(too_slow)?;
    let status = session.call(|board| board.call(QueryTrigger(output)))?;
    if status.state != TrainState::Stopped {
        session.call(|board| board.call(StopTrigger(output)))?;
    }
    // Over a slow link, or on a simulated rig that runs faster than time, the first pulse may be
    // past when the command arrives: then try again with more time.
    for attempt in 0..ATTEMPTS {
        let camera = session.call(|board| board.call(QueryTrigger(Output::Camera)))?;
        let start = joined(sensor, &camera, LEAD << attempt).ok_or_else(too_slow)?;
        let started = session.call(|board| match board.call(StartTrigger { output, start }) {
            Err(BoardError::Refused {
                refusal: Refusal::TimeOutOfRange { .. },
                ..
            }) if attempt + 1 < ATTEMPTS => Ok(false),
            other => other.map(|_| true),
        })?;
        if started {
            break;
        }
    }
    session.log.report(SessionEvent::OutputStarted {
        name: sensor.name.clone(),
        output: sensor.output,
        rule: sensor.rule(),
    })
}

/// The train of an output that joins the camera's, `lead` ticks from now at least;
/// none if its period is out of bounds.
fn joined(sensor: &TriggerOutput, camera: &TriggerStatus, lead: u64) -> Option<TriggerStart> {
    let ticks_per_us = f64::from(TICK_HZ / 1_000_000);
    let period = camera.period.0.checked_mul(sensor.every.into())?;
    let period = Some(Period(period)).filter(|period| period.in_bounds())?;
    let pulses = lead.div_ceil(u64::from(camera.period.ticks().max(1)));
    let pulse = EdgeGrid::new(camera.next_edge, camera.period).edge(i64::try_from(pulses).ok()?);
    // A delay has the resolution of a period.
    let delay = Period::from_ticks_f64(sensor.delay_us * ticks_per_us);
    Some(TriggerStart {
        period,
        width: (sensor.width_us * ticks_per_us).round() as u32,
        first_edge: Some(pulse + delay),
    })
}

fn start_lidar(session: &mut Session<'_>, lidar: &Lidar) -> Result<(), Stop> {
    let baud = parse_baud(&lidar.baud.to_string()).map_err(SessionError::Lidar)?;
    let clock = session.clock;
    let utc_at_zero = session
        .call(|board| gnss::utc_at_zero_by(board, clock.time_of_day()()))?
        .ok_or(SessionError::ClockBefore1970)?;
    let settings = gnss::settings(utc_at_zero, baud, lidar.idle_high, lidar.zda);
    let running = session.call(|board| gnss::start(board, settings))?.settings;
    session.log.report(SessionEvent::LidarStarted {
        name: lidar.name.clone(),
        utc_at_zero: running.unwrap_or(settings).utc_at_zero,
    })
}

#[cfg(test)]
mod tests {
    use protocol::{EdgeTime, Ticks};

    use super::*;

    #[test]
    fn a_joined_train_falls_on_pulses_of_the_cameras() {
        let period = Period::from_picos(33_330_652_540).unwrap();
        let camera = TriggerStatus {
            state: TrainState::Running,
            train: 1,
            period,
            width: 576,
            pulses: 77,
            next_edge: EdgeTime {
                ticks: Ticks(123_456_789),
                fraction: 0x1234_5678,
            },
            ..TriggerStatus::default()
        };
        let sensor = TriggerOutput {
            output: 2,
            name: "left".to_owned(),
            every: 6,
            delay_us: 0.0,
            width_us: 100.0,
        };
        let start = joined(&sensor, &camera, LEAD).unwrap();
        assert_eq!(start.period.0, 6 * period.0);
        assert_eq!(start.width, 4_800);
        let first = start.first_edge.unwrap();
        let grid = EdgeGrid::new(camera.next_edge, period);
        assert_eq!(grid.since_edge(first), Some(0));
        assert!((first.ticks - camera.next_edge.ticks).unsigned_abs() >= LEAD);

        let later = TriggerOutput {
            delay_us: 160.5,
            ..sensor.clone()
        };
        let later = joined(&later, &camera, LEAD).unwrap();
        let later = later.first_edge.unwrap();
        assert_eq!(later, first + Period::from_ticks(7_704));

        let slow = TriggerOutput {
            every: 31,
            ..sensor
        };
        assert_eq!(joined(&slow, &camera, LEAD), None);
    }
}
