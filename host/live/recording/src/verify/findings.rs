//! Collects the findings of a check, one entry a kind.

use board::finding::{Finding, Severity};
use protocol::Ticks;

use crate::damage::Damage;

/// Findings, one entry a kind, in order of appearance.
#[derive(Default)]
pub(super) struct Findings(Vec<Finding>);

impl Findings {
    /// Adds `count` findings of a kind; text and time are those of the first.
    pub(super) fn add(
        &mut self,
        severity: Severity,
        kind: &'static str,
        (at, count): (Option<Ticks>, u64),
        text: impl FnOnce() -> String,
    ) {
        match self.0.iter_mut().find(|finding| finding.kind == kind) {
            Some(known) => known.count = known.count.saturating_add(count),
            None => self.0.push(Finding {
                at,
                count,
                ..Finding::new(severity, kind, text())
            }),
        }
    }

    /// Adds damage or a contradiction.
    pub(super) fn bad(
        &mut self,
        kind: &'static str,
        at: Option<Ticks>,
        text: impl FnOnce() -> String,
    ) {
        self.add(Severity::Bad, kind, (at, 1), text);
    }

    /// Adds a known loss.
    pub(super) fn check(
        &mut self,
        kind: &'static str,
        at: Option<Ticks>,
        text: impl FnOnce() -> String,
    ) {
        self.add(Severity::Check, kind, (at, 1), text);
    }

    /// Adds damage of the file as bytes.
    pub(super) fn damage(&mut self, damage: &Damage) {
        let severity = match damage {
            Damage::CutOff { .. } | Damage::TopicsAssumed => Severity::Check,
            _ => Severity::Bad,
        };
        let at = (damage.at(), 1);
        self.add(severity, damage.kind(), at, || damage.to_string());
    }

    /// Adds a remark.
    pub(super) fn note(&mut self, kind: &'static str, text: impl FnOnce() -> String) {
        self.add(Severity::Good, kind, (None, 1), text);
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
