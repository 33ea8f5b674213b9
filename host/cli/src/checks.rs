//! Checks in words: what `doctor` prints, and the verdict over a recording.

use std::fmt::Write as _;

use recording::session_file::{Check, Verdict};
use report::session::Judgement;

/// What stands at the beginning of a check's line.
pub(crate) const MARKS: [&str; 3] = ["ok  ", "warn", "BAD "];

const fn mark(verdict: Verdict) -> &'static str {
    let [good, warning, bad] = MARKS;
    match verdict {
        Verdict::Good => good,
        Verdict::Warning => warning,
        Verdict::Bad => bad,
    }
}

/// A line a check, and what to do below it.
pub(crate) fn text<'a>(checks: impl IntoIterator<Item = &'a Check>) -> String {
    let mut text = String::new();
    for check in checks {
        let _ = writeln!(
            text,
            "{}  {:<18} {}",
            mark(check.verdict),
            check.name,
            check.found
        );
        if let Some(step) = &check.next_step {
            let _ = writeln!(text, "      {:<18} -> {step}", "");
        }
    }
    text
}

/// The verdict over a recording with its parts.
pub(crate) fn text_of_judgement(judged: &Judgement) -> String {
    format!("{}\n{}", judged.text, text(&judged.parts))
}
