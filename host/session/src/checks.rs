//! The checks before a recording.

use recording::session_file::{Check, Verdict};
use serde::Serialize;

use crate::error::SessionError;

/// Where that lies which a check found bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The rig, its wiring or its profile.
    Rig,
    /// The program that records the depth camera.
    Recorder,
}

/// Checks, in the order in which they were made.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Checks {
    /// All of them.
    pub checks: Vec<Check>,
    /// Where the first bad one lies.
    #[serde(skip)]
    fault: Option<Fault>,
}

impl Checks {
    /// Adds one that is as it should be.
    pub fn good(&mut self, name: &str, found: impl Into<String>) {
        self.add(name, Verdict::Good, found.into(), None);
    }

    /// Adds one that could be better; `next` says what to do.
    pub fn warn(&mut self, name: &str, found: impl Into<String>, next: &str) {
        self.add(name, Verdict::Warning, found.into(), Some(next));
    }

    /// Adds one with which a recording will not work; `next` says what to do.
    pub fn bad(&mut self, fault: Fault, name: &str, found: impl Into<String>, next: &str) {
        self.fault.get_or_insert(fault);
        self.add(name, Verdict::Bad, found.into(), Some(next));
    }

    fn add(&mut self, name: &str, verdict: Verdict, found: String, next: Option<&str>) {
        self.checks.push(Check {
            name: name.to_owned(),
            verdict,
            found,
            next_step: next.map(str::to_owned),
        });
    }

    /// The first bad one as an error.
    ///
    /// # Errors
    ///
    /// There is one.
    pub fn result(&self) -> Result<(), SessionError> {
        let bad = self.checks.iter().find(|c| c.verdict == Verdict::Bad);
        match (bad, self.fault) {
            (Some(bad), Some(fault)) => Err(SessionError::Check {
                name: bad.name.clone(),
                found: bad.found.clone(),
                next_step: bad.next_step.clone(),
                fault,
            }),
            _ => Ok(()),
        }
    }
}
