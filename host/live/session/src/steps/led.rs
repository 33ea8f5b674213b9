//! Flashes the LED of a calibration at the phone, while its video runs and before anything is
//! recorded.
//!
//! The LED is on a trigger output, so the timer makes its edges and the board reports each by its
//! tick. Its code is runs of two periods, one longer and one shorter than a number of the phone's
//! frames, with pauses of differing length: the bands walk over the whole picture in both
//! directions, and no lamp does the same.

use protocol::{Output, Period, StartTrigger, StopTrigger, TICK_HZ, Ticks, TriggerStart};
use recording::session_file::{LedRun, Span};

use super::start_trigger;
use crate::error::{SessionError, Stop};
use crate::event::SessionEvent;
use crate::phones::REFERENCE;
use crate::session::Session;

/// Length of a flash, ticks: 2 ms.
const LENGTH: u32 = TICK_HZ / 500;

/// Shortest period that the code is made of, ns: room for a flash and the longest exposure that
/// is measured.
const SHORTEST_NS: f64 = 28e6;

/// Periods of the code, as parts of a whole number of frames.
const PERIODS: [f64; 2] = [1.0734, 0.9266];

const TICKS_PER_NS: f64 = TICK_HZ as f64 * 1e-9;

/// Length of a run, ticks.
const RUN: u64 = 5 * TICK_HZ as u64;

/// Pauses between runs, ticks: from the first to the sum of both, differing from run to run.
const PAUSE: [u64; 2] = [TICK_HZ as u64 * 2 / 5, TICK_HZ as u64 * 3 / 5];

/// Time in which somebody holds the LED to the phone, ticks.
const LEAD: u64 = 5 * TICK_HZ as u64;

/// Returns the output of the LED: the last one on which the profile has no sensor. On a board with
/// one output it is the camera's, whose cable is unplugged for this.
pub(super) fn output(session: &Session<'_>) -> Result<Output, SessionError> {
    let board = session.file.board.as_ref();
    if !board.is_some_and(|board| board.model.has_outputs()) {
        return Ok(Output::Camera);
    }
    let sensors = &session.profile.outputs;
    let is_free = |output: &&Output| sensors.iter().all(|s| s.output != output.number());
    let free = Output::AUXILIARY.iter().rev().find(is_free);
    free.copied().ok_or(SessionError::NoOutputForLed)
}

/// Flashes for this many ticks of board time. What it did is in the session file.
///
/// # Errors
///
/// The board refuses.
pub(super) fn flash(session: &mut Session<'_>, output: Output, length: u64) -> Result<(), Stop> {
    let phone = &session.file.phones[REFERENCE];
    let (Some(video), Some(clock)) = (phone.video, phone.clock) else {
        return Ok(());
    };
    let frame_ns = video.frame_duration_ns / (1.0 + clock.skew);
    let frames_ns = (SHORTEST_NS / frame_ns).ceil() * frame_ns;
    session.log.report(SessionEvent::LedFlashes {
        output,
        length_s: Ticks(length).as_secs_f64(),
    })?;
    if output.is_camera() {
        session.call(|board| board.call(StopTrigger(output)))?;
    }
    session.pump_for(LEAD)?;
    let from = session.now();
    session.file.led = Some(LedRun {
        output,
        length: LENGTH,
        span: Span { from, to: from },
    });
    let mut part = 0.0_f64;
    for run in 0.. {
        if session.now() >= Ticks(from.0.saturating_add(length)) {
            break;
        }
        let ticks = frames_ns * PERIODS[run % PERIODS.len()] * TICKS_PER_NS;
        let start = TriggerStart {
            period: Period::from_ticks_f64(ticks),
            width: LENGTH,
            first_edge: None,
        };
        session.call(|board| board.call(StartTrigger { output, start }))?;
        session.pump_for(RUN)?;
        session.call(|board| board.call(StopTrigger(output)))?;
        // Parts of the golden ratio come near no cycle.
        part = (part + 0.618).fract();
        session.pump_for(PAUSE[0] + (part * PAUSE[1] as f64) as u64)?;
    }
    let to = session.now();
    if let Some(led) = &mut session.file.led {
        led.span.to = to;
    }
    if output.is_camera() {
        start_trigger(session)?;
    }
    Ok(session.save()?)
}
