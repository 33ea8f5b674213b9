//! Collects the findings of a check, one entry a kind.

use board::finding::{Finding, Severity};
use protocol::Ticks;

use super::fault::Fault;

/// Findings, one entry a kind, in order of appearance.
#[derive(Default)]
pub(super) struct Findings(Vec<Finding>);

impl Findings {
    /// Adds a fault, with its board time if it has one.
    pub(super) fn add(&mut self, fault: &Fault, at: Option<Ticks>) {
        self.add_many(fault, at, 1);
    }

    /// Adds `count` faults of a kind; text and time are those of the first.
    pub(super) fn add_many(&mut self, fault: &Fault, at: Option<Ticks>, count: u64) {
        let kind = fault.kind();
        match self.0.iter_mut().find(|finding| finding.kind == kind) {
            Some(known) => known.count = known.count.saturating_add(count),
            None => self.0.push(Finding {
                at,
                count,
                next_step: fault.next_step().map(str::to_owned),
                ..Finding::new(fault.severity(), kind, fault.to_string())
            }),
        }
    }

    /// Adds a remark.
    pub(super) fn note(&mut self, remark: Finding) {
        self.0.push(remark);
    }

    /// Returns the severity of the worst finding; good if there is none.
    pub(super) fn worst(&self) -> Severity {
        let severities = self.0.iter().map(|finding| finding.severity);
        severities.max().unwrap_or(Severity::Good)
    }

    pub(super) fn into_vec(self) -> Vec<Finding> {
        self.0
    }
}
