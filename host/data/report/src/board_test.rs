//! The report of a board test.

use board::bring_up::BoardTestReport;
use serde_json::json;

use crate::page::Page;
use crate::session::board_fact;
use crate::summary::{Summary, titled};
use board::finding::{Finding, Severity};

/// Returns the summary of a board test: each check with its limit.
#[must_use]
pub fn summary(report: &BoardTestReport) -> Summary {
    let count = |severity| report.count(severity);
    let (failed, skipped) = (count(Severity::Bad), count(Severity::Check));
    let (passed, all) = (count(Severity::Good), report.checks.len());
    let (severity, text) = match (failed, skipped) {
        (0, 0) => (Severity::Good, format!("All {passed} checks passed.")),
        (0, _) => (
            Severity::Check,
            format!("{passed} checks passed; {skipped} could not be made."),
        ),
        _ => (
            Severity::Bad,
            format!("{failed} of {all} checks failed, {skipped} could not be made."),
        ),
    };
    let parts = report.checks.iter().map(|check| {
        let finding = &check.finding;
        let text = match check.limit.as_str() {
            "" => finding.text.clone(),
            limit => format!("{} (must be: {limit})", finding.text),
        };
        // The next step after a failure is of no use if the check has passed.
        let is_good = finding.severity == Severity::Good;
        let next_step = finding.next_step.clone().filter(|_| !is_good);
        Finding {
            text,
            next_step,
            ..finding.clone()
        }
    });
    Summary {
        title: titled(String::from("Board test"), Some(&report.board.id)),
        severity,
        text,
        parts: parts.collect(),
        facts: vec![("board", board_fact(&report.board))],
    }
}

/// Returns the report of a board test as a self-contained HTML page.
#[must_use]
pub fn page(report: &BoardTestReport) -> String {
    let mut page = Page::new(&summary(report));
    let intervals = &report.intervals;
    if !intervals.counts.is_empty() {
        page.section("Data-ready");
        page.histogram(
            ["interval, ticks of 20.83 ns", "samples"],
            (intervals.first as f64, intervals.bin as f64),
            &intervals.counts,
            "Intervals of the IMU's data-ready.",
        );
    }
    page.settings("Everything, as JSON", &json!(report));
    page.html()
}
