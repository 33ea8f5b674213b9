//! Checks in words: what `doctor` prints, and the verdict over a recording.

use std::fmt::Write as _;

use recording::finding::{Finding, Severity};
use report::session::Judgement;

/// What stands at the beginning of a check's line.
pub(crate) const MARKS: [&str; 3] = ["good ", "check", "BAD  "];

pub(crate) const fn mark(severity: Severity) -> &'static str {
    let [good, warning, bad] = MARKS;
    match severity {
        Severity::Good => good,
        Severity::Check => warning,
        Severity::Bad => bad,
    }
}

/// A line a check, and what to do below it.
pub(crate) fn text<'a>(checks: impl IntoIterator<Item = &'a Finding>) -> String {
    let mut text = String::new();
    for check in checks {
        let _ = writeln!(
            text,
            "{}  {:<18} {}",
            mark(check.severity),
            check.kind,
            check.text
        );
        if let Some(step) = &check.next_step {
            let _ = writeln!(text, "       {:<18} -> {step}", "");
        }
    }
    text
}

/// The verdict over a recording with its parts.
pub(crate) fn text_of_judgement(judged: &Judgement) -> String {
    format!("{}\n{}", judged.text, text(&judged.parts))
}
