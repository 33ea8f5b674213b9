//! `board trigger latency`: from the trigger's edge to the centre of exposure.

use protocol::{DeviceToHost, TICK_HZ, Ticks, TrainState};

use crate::context::Context;
use crate::outcome::{ExitStatus, Failure};
use board::{Board, Event};
use evaluate::latency::latency;
use evaluate::train::TrainGeometry;

/// How long, in board time, pulses may stay away before what came is all there is.
const PATIENCE_TICKS: i64 = 20 * TICK_HZ as i64;

/// Collects pulses and strobes, and says how they lie to each other.
pub(super) fn measure(
    board: &mut Board,
    context: &Context,
    train: &TrainGeometry,
    wanted: usize,
) -> Result<ExitStatus, Failure> {
    if board.trigger()?.state == TrainState::Stopped {
        return Err(Failure::new(
            ExitStatus::Refused,
            "the trigger is stopped: there is nothing to measure",
        )
        .next_step(
            "start it with `smartdepthsync board trigger start --fps 30`, and the depth camera",
        ));
    }
    let (mut pulses, mut captures) = (Vec::new(), Vec::new());
    let mut last_sign = board.conversation().latest();
    let stop = context.interrupt.question();
    let listened = board.listen("pulses", &stop, |board, event| {
        match event {
            Some(Event::Message(DeviceToHost::Pulse(pulse))) if pulse.output.is_camera() => {
                pulses.push(pulse.at);
                last_sign = pulse.at;
            }
            Some(Event::Message(DeviceToHost::Capture(capture))) => captures.push(capture),
            // The board's time begins again.
            Some(Event::Restarted { .. }) => last_sign = Ticks::ZERO,
            _ => {}
        }
        let is_quiet = (board.conversation().latest() - last_sign).0 > PATIENCE_TICKS;
        // The last pulse only ends the one before it.
        Ok::<_, Failure>((pulses.len() > wanted || is_quiet).then_some(()))
    })?;
    if listened.is_none() {
        return Ok(ExitStatus::Interrupted);
    }
    let Some(found) = latency(&pulses, &captures, train) else {
        return Err(Failure::new(
            ExitStatus::Refused,
            format!(
                "no pulse has a whole train of {} flashes: {} strobe edges came with {} pulses, {} a pulse are expected",
                train.count,
                captures.len(),
                pulses.len(),
                2 * train.count
            ),
        )
        .next_step("check that the depth camera runs on the trigger, that the photodiode on PA2 sees its flashes and nothing else, and that --train is the depth mode's"));
    };
    context.show(&found)?;
    Ok(ExitStatus::of_loss(found.left_out > 0))
}
