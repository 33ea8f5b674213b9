//! Failures of a firmware, and their reports.

use super::{ResetCause, Sim};
use crate::backtrace;
use crate::chip::rules::End;
use crate::rtt::LogLine;
use crate::shared::lock;
use crate::time::{SimDuration, SimTime};

/// Time given to a firmware that panicked, to log its message and reset.
const LAST_WORDS: SimDuration = SimDuration::from_millis(500);

/// Kind of a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FailureKind {
    /// It panicked.
    Panic,
    /// It took a HardFault.
    HardFault,
    /// It locked up: a fault within the fault handler.
    LockUp,
    /// It was reset, and not from outside.
    Reset(ResetCause),
    /// It touched a register that is not modelled.
    Unmodelled,
    /// It did what the chip's manuals forbid.
    Forbidden,
}

/// A failure of the firmware.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// Its kind.
    pub kind: FailureKind,
    /// When, in virtual time.
    pub at: SimTime,
    /// The last lines of its log.
    pub log: Vec<String>,
    /// Its call stack, innermost first.
    pub backtrace: Vec<String>,
    /// Fault registers, if it was a fault; the register that is not modelled; the rule
    /// that was broken.
    pub detail: String,
}

impl core::fmt::Display for Failure {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let what = match self.kind {
            FailureKind::Panic => "the firmware panicked".to_owned(),
            FailureKind::HardFault => "the firmware took a HardFault".to_owned(),
            FailureKind::LockUp => "the firmware locked up".to_owned(),
            FailureKind::Unmodelled => "the simulator does not know what comes next".to_owned(),
            FailureKind::Forbidden => "the firmware does what the manual forbids".to_owned(),
            FailureKind::Reset(cause) => format!("the firmware was reset ({cause:?})"),
        };
        writeln!(f, "{what} at {} s of virtual time", self.at)?;
        if !self.detail.is_empty() {
            writeln!(f, "{}", self.detail)?;
        }
        if !self.log.is_empty() {
            writeln!(f, "its last log lines:")?;
            for line in &self.log {
                writeln!(f, "  {line}")?;
            }
        }
        if !self.backtrace.is_empty() {
            writeln!(f, "its call stack:")?;
            for line in &self.backtrace {
                writeln!(f, "  {line}")?;
            }
        }
        Ok(())
    }
}

/// Why a run ended early.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// The ELF cannot be used.
    #[error("{0}")]
    Firmware(String),
    /// The board cannot be set up.
    #[error("the simulated board cannot be set up: {0}")]
    Setup(String),
    /// The firmware failed.
    #[error("{0}")]
    Failed(Box<Failure>),
}

impl Sim {
    pub(super) fn begin_failure(&mut self, kind: FailureKind) {
        if self.failing.is_some() {
            return;
        }
        let failure = self.describe_failure(kind);
        let until = failure.at + LAST_WORDS;
        self.failing = Some((failure, until));
    }

    fn describe_failure(&mut self, kind: FailureKind) -> Failure {
        let (mut regs, _) = self.cpu.registers();
        let psp = self.cpu.process_stack();
        let soc = lock(&self.soc);
        let read = |addr: u32| soc.mem.read32(addr);
        let mut detail = String::new();
        if kind == FailureKind::HardFault {
            let [cfsr, hfsr, mmfar, bfar] = self.cpu.fault_status();
            detail = format!(
                "CFSR {cfsr:#010x}, HFSR {hfsr:#010x}, MMFAR {mmfar:#010x}, BFAR {bfar:#010x}"
            );
            if let Some(faulting) = backtrace::exception_frame(regs, psp, &read) {
                regs = faulting;
            }
        }
        let stack = backtrace::unwind(&self.firmware, regs, psp, read);
        let at = soc.now();
        drop(soc);
        Failure {
            kind,
            at,
            log: Vec::new(),
            backtrace: backtrace::describe(&self.firmware, &stack),
            detail,
        }
    }

    /// Ends the run with the failure that was begun, or notes it.
    pub(super) fn fail_now(&mut self) -> Result<(), SimError> {
        let Some((mut failure, _)) = self.failing.take() else {
            return Ok(());
        };
        let from = self.log.len().saturating_sub(10);
        failure.log = self.log[from..].iter().map(LogLine::to_string).collect();
        self.failures.push(failure.clone());
        if self.tolerate_failures {
            Ok(())
        } else {
            Err(SimError::Failed(Box::new(failure)))
        }
    }

    /// A reset that the firmware made or did not prevent.
    pub(super) fn firmware_reset(&mut self, cause: ResetCause) -> Result<(), SimError> {
        self.poll_log();
        if self.failing.is_none() {
            let mut failure = self.describe_failure(FailureKind::Reset(cause));
            if cause == ResetCause::IndependentWatchdog {
                failure.detail = "the watchdog was not fed; the stack is where the core was".into();
            }
            self.failing = Some((failure, SimTime::NEVER));
        }
        self.reset(cause);
        self.fail_now()
    }

    /// An end that nobody tolerates, for whatever the firmware does next is not what it
    /// does on the chip.
    pub(super) fn end(&mut self, end: &End) -> Result<(), SimError> {
        self.poll_log();
        let mut failure = self.describe_failure(match end {
            End::Unmodelled { .. } | End::Absent { .. } => FailureKind::Unmodelled,
            End::Forbidden(_) => FailureKind::Forbidden,
        });
        failure.detail = end.to_string();
        self.failing = Some((failure, SimTime::NEVER));
        self.fail_now()?;
        let failure = self.failures.last().cloned().map(Box::new);
        failure.map_or(Ok(()), |failure| Err(SimError::Failed(failure)))
    }
}
