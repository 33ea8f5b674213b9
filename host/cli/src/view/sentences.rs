//! The sentences that the operator is shown about a session's events.

use board::finding::Severity;
use session::event::{Notice, Prompt, SessionEvent, Step};

use crate::outcome::Failure;

/// Returns the sentence that is shown about an event, if there is one. `notice` is the event's.
pub(crate) fn sentence(event: &SessionEvent, notice: Option<&Notice>) -> Option<String> {
    if let SessionEvent::Prompt { prompt } = event {
        return Some(question(prompt));
    }
    if let SessionEvent::StepFailed { error, .. } = event {
        let failure = Failure::from(error.as_ref());
        return Some(format!("error: {failure}\n  -> {}", failure.what_to_do()));
    }
    let finding = &notice.filter(|notice| notice.is_shown)?.finding;
    Some(match finding.severity {
        Severity::Good => finding.text.clone(),
        Severity::Check => format!("warning: {}", finding.text),
        Severity::Bad => format!("ERROR: {}", finding.text),
    })
}

fn question(prompt: &Prompt) -> String {
    let text = match *prompt {
        Prompt::Repeat { step, can_skip } => {
            let skip = if can_skip { ", [s] skip" } else { "" };
            let name = step_name(step);
            return format!("{name}: [Enter] or [r] try again{skip}, [q] quit");
        }
        Prompt::Twist { length_s, can_skip } => {
            let skip = if can_skip {
                ", [s] to leave it out"
            } else {
                ""
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
