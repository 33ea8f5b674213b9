//! The trigger outputs by their number, whichever timer makes them.

use firmware::pulser::{CompareOutput, Pulser};
use firmware::timebase::Timebase;
use protocol::{AlignPlan, Output, OutputStatus, Refusal, TickDelta, TriggerAlign, TriggerStatus};

use crate::hardware::outputs::{self, Line};
use crate::hardware::tim2;

/// Calls `work`, which must be short, on an output while no edge of its timer is due soon.
pub(crate) fn with_pulser<R>(
    output: Output,
    work: impl FnOnce(&mut Pulser, &mut dyn CompareOutput, &Timebase) -> R,
) -> R {
    match output {
        Output::Camera => tim2::with_pulser(|pulser, channel, time| work(pulser, channel, time)),
        Output::Two => outputs::with_line(Line::Two, work),
        Output::Three => outputs::with_line(Line::Three, work),
        Output::Four => outputs::with_line(Line::Four, work),
    }
}

/// Plans an align and puts it into force.
///
/// # Errors
///
/// As [`firmware::trigger::Train::align`]; no train runs.
pub(crate) fn align(output: Output, command: u32, to: &TriggerAlign) -> Result<AlignPlan, Refusal> {
    loop {
        let train = with_pulser(output, |pulser, _, _| pulser.running().copied());
        let train = train.ok_or(Refusal::TriggerStopped)?;
        let alignment = train.align(command, to, tim2::now())?;
        // Planned from an edge that has gone by meanwhile? Once more; edges are
        // a millisecond apart at least.
        if with_pulser(output, |pulser, _, _| pulser.adopt(&alignment))? {
            return Ok(alignment.plan);
        }
    }
}

/// Returns the short status of an output.
pub(crate) fn summary(output: Output) -> OutputStatus {
    with_pulser(output, |pulser, _, _| pulser.summary(tim2::now()))
}

/// Returns the status of an output's train, all of it at one moment.
pub(crate) fn status(output: Output) -> TriggerStatus {
    let (pulser, now) = with_pulser(output, |pulser, _, _| (*pulser, tim2::now()));
    pulser.status(now)
}

/// Returns true if an edge of any line is overdue by more than `by`.
pub(crate) fn is_overdue(by: TickDelta) -> bool {
    let now = tim2::now();
    is_any(|pulser| pulser.is_overdue(now, by))
}

/// Returns true if any line has a train.
pub(crate) fn is_any_running() -> bool {
    is_any(|pulser| pulser.running().is_some())
}

/// Returns true if `matches` returns true for the pulser of any line. The pulsers are not copied:
/// each copy takes 10 µs.
fn is_any(matches: impl Fn(&Pulser) -> bool) -> bool {
    let mut outputs = Output::ALL.into_iter();
    outputs.any(|output| with_pulser(output, |pulser, _, _| matches(pulser)))
        || outputs::with_line(Line::Pps, |pulser, _, _| matches(pulser))
}
