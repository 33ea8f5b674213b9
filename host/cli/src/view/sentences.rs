//! The sentences that are said to the person of a session's events.

use board::finding::Severity;
use session::event::{Prompt, SessionEvent, Step};

use crate::outcome::Failure;

/// Gives the sentence that is said of an event, if one is.
pub(crate) fn sentence(event: &SessionEvent) -> Option<String> {
    match event {
        SessionEvent::Prompt { prompt } => Some(question(prompt)),
        SessionEvent::StepFailed { error, .. } => {
            let failure = Failure::from(error.as_ref());
            Some(format!("error: {failure}\n  -> {}", failure.what_to_do()))
        }
        SessionEvent::ClockFollowed { .. }
        | SessionEvent::ClockNotFollowed { .. }
        | SessionEvent::StopRetried { .. } => Some(event.to_string()),
        // Counted, and reported where they are missed.
        SessionEvent::Lost { .. } | SessionEvent::Damaged { .. } | SessionEvent::Hello => None,
        _ => event.kind().map(|_| match event.severity() {
            Severity::Good => event.to_string(),
            Severity::Check => format!("warning: {event}"),
            Severity::Bad => format!("ERROR: {event}"),
        }),
    }
}

fn question(prompt: &Prompt) -> String {
    let text = match *prompt {
        Prompt::Repeat { step, can_skip } => {
            let skip = if can_skip { ", [s] skip" } else { "" };
            let name = step_name(step);
            return format!("{name}: [Enter] or [r] try again{skip}, [q] quit");
        }
        Prompt::Twist { length_s, can_skip } => {
            let skip = match can_skip {
                true => ", [s] to leave it out",
                false => "",
            };
            return format!(
                "Twist the rig for {length_s} s about all axes. [Enter] to begin{skip}, [q] to quit"
            );
        }
        Prompt::TwistWeak => "[r] twist again, faster; [Enter] go on all the same, [q] quit",
        Prompt::TwistGood => "[Enter] go on, [r] twist again, [q] quit",
        Prompt::TwistAgain => "[Enter] or [r] twist again, [q] quit",
        Prompt::CannotSkip => {
            "this twist cannot be left out: without it nothing relates the clocks"
        }
    };
    text.to_owned()
}

const fn step_name(step: Step) -> &'static str {
    match step {
        Step::Connect => "board and phones",
        Step::Checks => "the checks",
        Step::Twist => "the twist",
        Step::Recorder => "the depth recorder",
        Step::Trigger => "the trigger",
        Step::Videos => "the phones' videos",
        Step::SecondTwist => "the second twist",
        Step::Download => "the download",
    }
}
