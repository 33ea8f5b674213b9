//! Findings and their severity: one scale from the checks before a recording to the report over
//! a data set.

use protocol::Ticks;
use serde::{Deserialize, Serialize};

mod kind;

pub use kind::{EventKind, FindingKind};

/// Severity of a finding, from good to bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// As it should be, or just information.
    Good,
    /// Usable; something is missing, or less good than it could be.
    Check,
    /// Damaged, broken or not usable.
    Bad,
}

impl Severity {
    /// Returns its name.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Check => "check",
            Self::Bad => "bad",
        }
    }
}

/// Something that was checked or noticed, once or often.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    /// Its kind, or the name of what was checked.
    pub kind: FindingKind,
    /// Severity.
    pub severity: Severity,
    /// Text of the finding; of several, the first.
    pub text: String,
    /// Advice for the user.
    pub next_step: Option<String>,
    /// Board time of the first, where it has one.
    pub at: Option<Ticks>,
    /// Number of occurrences.
    #[serde(default = "once")]
    pub count: u64,
}

const fn once() -> u64 {
    1
}

impl Finding {
    /// Creates a finding without a next step.
    #[must_use]
    pub fn new(severity: Severity, kind: impl Into<FindingKind>, text: impl Into<String>) -> Self {
        Self {
            kind: kind.into(),
            severity,
            text: text.into(),
            next_step: None,
            at: None,
            count: 1,
        }
    }

    /// Creates a good finding.
    #[must_use]
    pub fn good(kind: impl Into<FindingKind>, text: impl Into<String>) -> Self {
        Self::new(Severity::Good, kind, text)
    }

    /// Creates a finding of something missing, or less good than it could be.
    #[must_use]
    pub fn check(kind: impl Into<FindingKind>, text: impl Into<String>) -> Self {
        Self::new(Severity::Check, kind, text)
    }

    /// Creates a finding of something broken.
    #[must_use]
    pub fn bad(kind: impl Into<FindingKind>, text: impl Into<String>) -> Self {
        Self::new(Severity::Bad, kind, text)
    }

    /// Sets the board time.
    #[must_use]
    pub fn at(self, at: Ticks) -> Self {
        Self {
            at: Some(at),
            ..self
        }
    }

    /// Sets the next step.
    #[must_use]
    pub fn next_step(self, step: impl Into<String>) -> Self {
        Self {
            next_step: Some(step.into()),
            ..self
        }
    }

    /// Returns the text with the number of occurrences and the time of the first.
    #[must_use]
    pub fn words(&self) -> String {
        let mut words = self.text.clone();
        if self.count > 1 {
            words += &format!(" (and {} more of this kind)", self.count - 1);
        }
        if let Some(at) = self.at {
            words += &format!(" [{:.3} s]", at.as_secs_f64());
        }
        words
    }

    /// Returns the finding in one line, with its next step.
    #[must_use]
    pub fn line(&self) -> String {
        let next = self.next_step.as_deref().unwrap_or_default();
        let arrow = if next.is_empty() { "" } else { " -> " };
        format!("{}: {}{arrow}{next}", self.kind, self.words())
    }
}
