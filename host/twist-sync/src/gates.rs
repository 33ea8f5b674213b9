//! The quality gates: what an estimate must pass, each with its reason.

use serde::Serialize;

/// One gate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Gate {
    /// Short stable name.
    pub name: &'static str,
    /// Whether it was passed.
    pub passed: bool,
    /// What was measured, in `unit`.
    pub value: f64,
    /// What it is compared with, in `unit`.
    pub limit: f64,
    /// Unit of value and limit.
    pub unit: &'static str,
    /// What a failure means and what to do.
    pub reason: &'static str,
}

impl Gate {
    /// Passed if `value` is at least `limit`.
    #[must_use]
    pub fn at_least(
        name: &'static str,
        value: f64,
        limit: f64,
        unit: &'static str,
        reason: &'static str,
    ) -> Self {
        Self {
            name,
            passed: value >= limit,
            value,
            limit,
            unit,
            reason,
        }
    }

    /// Passed if `value` is at most `limit`.
    #[must_use]
    pub fn at_most(
        name: &'static str,
        value: f64,
        limit: f64,
        unit: &'static str,
        reason: &'static str,
    ) -> Self {
        Self {
            name,
            passed: value <= limit,
            value,
            limit,
            unit,
            reason,
        }
    }
}
