//! The head of every report: a verdict in words, findings, and facts.
//!
//! It is made once from a result. The terminal prints it ([`Summary::text`]), the page begins
//! with it ([`crate::page::Page::new`]), and JSON has its verdict and findings beside the
//! result's own figures, from which the facts are made.

use std::fmt::Write as _;

use board::finding::{Finding, Severity};
use serde::Serialize;

/// Facts in the order of their lines: a name and its value in words.
pub type Facts = Vec<(&'static str, String)>;

/// Head of a report.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Summary {
    /// Title of the report.
    #[serde(skip)]
    pub title: String,
    /// Worst severity of the parts.
    pub severity: Severity,
    /// Verdict in a sentence or two.
    pub text: String,
    /// Findings, part by part.
    pub parts: Vec<Finding>,
    /// The most important figures.
    #[serde(skip)]
    pub facts: Facts,
}

impl Summary {
    /// Returns the verdict, one line for each finding, and one line for each fact.
    #[must_use]
    pub fn text(&self) -> String {
        let (parts, facts) = (findings_text(&self.parts), facts_text(&self.facts));
        format!("{}\n{parts}{facts}", self.text)
    }
}

/// Returns a report's title, which says so if the board with this serial number is simulated.
pub(crate) fn titled(title: String, board: Option<&str>) -> String {
    match board {
        Some(id) if protocol::usb::is_simulated(id) => format!("Simulated: {title}"),
        _ => title,
    }
}

/// Returns the begin of a finding's line.
const fn mark(severity: Severity) -> &'static str {
    match severity {
        Severity::Good => "good ",
        Severity::Check => "check",
        Severity::Bad => "BAD  ",
    }
}

/// Returns one line for each finding, with the next step below it.
pub fn findings_text<'a>(findings: impl IntoIterator<Item = &'a Finding>) -> String {
    let findings: Vec<&Finding> = findings.into_iter().collect();
    let kinds: Vec<String> = findings
        .iter()
        .map(|finding| finding.kind.to_string())
        .collect();
    let wide = width(kinds.iter().map(String::as_str));
    let mut text = String::new();
    for (finding, kind) in findings.into_iter().zip(&kinds) {
        let (mark, words) = (mark(finding.severity), finding.words());
        let _ = writeln!(text, "{mark}  {kind:<wide$} {words}");
        if let Some(step) = &finding.next_step {
            let _ = writeln!(text, "       {:<wide$} help: {step}", "");
        }
    }
    text
}

/// Returns one line for each fact.
#[must_use]
pub fn facts_text(facts: &[(&str, String)]) -> String {
    let wide = width(facts.iter().map(|(name, _)| *name));
    let line = |(name, value): &(&str, String)| format!("{name:<wide$} {value}\n");
    facts.iter().map(line).collect()
}

/// Returns the width of the column of names.
fn width<'a>(names: impl Iterator<Item = &'a str>) -> usize {
    names.map(|name| name.chars().count()).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_is_lines_in_columns() {
        let bad = Finding::bad("link", "it broke").next_step("plug it in");
        let summary = Summary {
            title: String::from("not in the text"),
            severity: Severity::Bad,
            text: String::from("Not usable."),
            parts: vec![Finding::good("phone", "there"), bad],
            facts: vec![("a", String::from("1")), ("long", String::from("2"))],
        };
        assert_eq!(
            summary.text(),
            "Not usable.\ngood   phone there\nBAD    link  it broke\n             help: plug it in\n\
             a    1\nlong 2\n"
        );
    }
}
