//! The head of every report: a verdict in words, what was found, and facts.
//!
//! It is made once of a result; the terminal prints it ([`Summary::text`]), the page begins
//! with it ([`crate::page::Page::new`]), and JSON has verdict and findings of it beside the
//! result's own figures, of which the facts are made.

use std::fmt::Write as _;

use board::finding::{Finding, Severity};
use serde::Serialize;

/// Names with their values in words.
pub type Facts = Vec<(&'static str, String)>;

/// The head of a report.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Summary {
    /// What the report is about.
    #[serde(skip)]
    pub title: String,
    /// The worst that was found.
    pub severity: Severity,
    /// The meaning of that, in a sentence or two.
    pub text: String,
    /// What was found, part by part.
    pub parts: Vec<Finding>,
    /// What matters most, in figures.
    #[serde(skip)]
    pub facts: Facts,
}

impl Summary {
    /// The verdict, a line a finding, and a line a fact.
    #[must_use]
    pub fn text(&self) -> String {
        let (parts, facts) = (findings_text(&self.parts), facts_text(&self.facts));
        format!("{}\n{parts}{facts}", self.text)
    }
}

/// What a finding's line begins with.
const fn mark(severity: Severity) -> &'static str {
    match severity {
        Severity::Good => "good ",
        Severity::Check => "check",
        Severity::Bad => "BAD  ",
    }
}

/// A line a finding, and what to do below it.
pub fn findings_text<'a>(findings: impl IntoIterator<Item = &'a Finding>) -> String {
    let findings: Vec<&Finding> = findings.into_iter().collect();
    let kinds: Vec<String> = findings.iter().map(|it| it.kind.to_string()).collect();
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

/// A line a fact.
#[must_use]
pub fn facts_text(facts: &[(&str, String)]) -> String {
    let wide = width(facts.iter().map(|(name, _)| *name));
    let line = |(name, value): &(&str, String)| format!("{name:<wide$} {value}\n");
    facts.iter().map(line).collect()
}

/// Width of the column of names.
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
