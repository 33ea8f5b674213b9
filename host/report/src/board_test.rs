//! The report of a board test.

use bring_up::Report;
use serde_json::json;

use crate::chart;
use crate::page::Page;
use recording::finding::Severity;

/// The report as a self-contained HTML page.
#[must_use]
pub fn page(report: &Report) -> String {
    let failed = report.count(Severity::Bad);
    let skipped = report.count(Severity::Check);
    let passed = report.count(Severity::Good);
    let (level, verdict) = match (failed, skipped) {
        (0, 0) => (Severity::Good, format!("All {passed} checks passed.")),
        (0, _) => (
            Severity::Check,
            format!("{passed} checks passed; {skipped} could not be made."),
        ),
        _ => (
            Severity::Bad,
            format!("{failed} of {} checks failed.", report.checks.len()),
        ),
    };
    let mut page = Page::new("Bring-up of a board", level, &verdict);
    page.facts(&[
        ("board", report.board.id.as_str()),
        ("firmware", report.board.firmware.as_str()),
        ("revision", report.board.revision.as_str()),
        ("last reset", report.board.reset_cause),
    ]);
    page.section("Checks");
    let rows = report.checks.iter().map(|check| {
        [
            check.finding.severity.word().to_owned(),
            check.finding.kind.clone(),
            check.finding.text.clone(),
            check.limit.clone(),
            check.finding.next_step.clone().unwrap_or_default(),
        ]
    });
    page.table(["", "check", "measured", "limit", "a miss points at"], rows);
    let intervals = &report.intervals;
    if !intervals.counts.is_empty() {
        page.section("Data-ready");
        let svg = chart::histogram(
            "interval [ticks of 20.83 ns]",
            "number",
            intervals.first as f64,
            intervals.bin as f64,
            &intervals.counts,
        );
        page.figure(&svg, "Intervals of the IMU's data-ready.");
    }
    page.settings("Everything, as JSON", &json!(report));
    page.html()
}
