//! What `trigger` prints, as JSON and as text.

use std::fmt::Write as _;

use protocol::{AlignPlan, Arrived, Readback, TICK_HZ, TrainState, TriggerStatus};
use serde::Serialize;

/// What `--json` prints.
#[derive(Debug, Serialize)]
pub(super) struct PrintedTrain {
    state: TrainState,
    train: u32,
    period_ns: String,
    period_ticks: u32,
    period_fraction: u32,
    fps: f64,
    phase_step_ns: f64,
    width_us: f64,
    pulses: u64,
    next_edge_ticks: u64,
    next_edge_fraction: u32,
    late: u32,
    pub(super) readback: PrintedReadback,
}

#[derive(Debug, Serialize)]
pub(super) struct PrintedReadback {
    /// "not wired", "ok", "missing n", or "stray n".
    pub(super) state: String,
    seen: u32,
    missing: u32,
    stray: u32,
    delay_ticks: Option<i32>,
    delay_ns: Option<f64>,
}

#[derive(Debug, Serialize)]
pub(super) struct PrintedMove {
    shift_ticks: i64,
    shift_us: f64,
    frames: u32,
    arrival_pulse: u64,
    arrival_ticks: u64,
    pub(super) arrived: Option<PrintedArrival>,
}

#[derive(Debug, Serialize)]
pub(super) struct PrintedArrival {
    pulse: u64,
    at_ticks: u64,
    remaining_ticks: i64,
}

fn micros(ticks: f64) -> f64 {
    ticks * 1e6 / f64::from(TICK_HZ)
}

impl From<&TriggerStatus> for PrintedTrain {
    fn from(status: &TriggerStatus) -> Self {
        let period = status.period;
        let seconds = period.as_secs_f64();
        Self {
            state: status.state,
            train: status.train,
            period_ns: period.to_string().trim_end_matches(" ns").to_owned(),
            period_ticks: period.ticks(),
            period_fraction: period.fraction(),
            fps: if seconds > 0.0 { 1.0 / seconds } else { 0.0 },
            phase_step_ns: 1e9 / f64::from(TICK_HZ),
            width_us: micros(f64::from(status.width)),
            pulses: status.pulses,
            next_edge_ticks: status.next_edge.0,
            next_edge_fraction: status.next_fraction,
            late: status.late,
            readback: PrintedReadback::from(&status.readback),
        }
    }
}

impl PrintedTrain {
    pub(super) fn text(&self, status: &TriggerStatus) -> String {
        let mut text = String::new();
        let state = match self.state {
            TrainState::Stopped => "stopped",
            TrainState::Waiting => "waiting for its first edge",
            TrainState::Running => "running",
            TrainState::Slewing => "slewing to another phase",
        };
        let _ = writeln!(text, "state       {state}");
        if self.train > 0 {
            let _ = writeln!(text, "train       {}, {} pulses", self.train, self.pulses);
            let _ = writeln!(
                text,
                "period      {} ns ({} + {}/2^32 ticks, {:.6} fps)",
                self.period_ns, self.period_ticks, self.period_fraction, self.fps
            );
            let _ = writeln!(text, "pulse       {:.3} µs wide", self.width_us);
        }
        if self.state != TrainState::Stopped {
            let _ = writeln!(
                text,
                "next edge   {} ({:.6} s)",
                status.next_edge,
                status.next_edge.as_secs_f64()
            );
        }
        let _ = writeln!(text, "phase step  {:.2} ns", self.phase_step_ns);
        if self.late > 0 {
            let _ = writeln!(
                text,
                "late edges  {}: they came later than asked for",
                self.late
            );
        }
        let _ = write!(text, "read-back   {}", self.readback.state);
        if let Some(delay) = self.readback.delay_ticks {
            let _ = write!(
                text,
                ", delay {delay} ticks ({:.0} ns)",
                self.readback.delay_ns.unwrap_or_default()
            );
        }
        text
    }
}

impl From<&Readback> for PrintedReadback {
    fn from(readback: &Readback) -> Self {
        let state = match (readback.seen, readback.missing, readback.stray) {
            (0, 0, 0) => String::from("not wired"),
            (_, 0, 0) => String::from("ok"),
            (_, 0, stray) => format!("stray {stray}"),
            (_, missing, _) => format!("missing {missing}"),
        };
        Self {
            state,
            seen: readback.seen,
            missing: readback.missing,
            stray: readback.stray,
            delay_ticks: readback.delay,
            delay_ns: readback
                .delay
                .map(|ticks| f64::from(ticks) * 1e9 / f64::from(TICK_HZ)),
        }
    }
}

impl From<&AlignPlan> for PrintedMove {
    fn from(plan: &AlignPlan) -> Self {
        Self {
            shift_ticks: plan.shift.0,
            shift_us: micros(plan.shift.0 as f64),
            frames: plan.frames,
            arrival_pulse: plan.arrival_pulse,
            arrival_ticks: plan.arrival.0,
            arrived: None,
        }
    }
}

impl PrintedMove {
    pub(super) fn text(&self) -> String {
        format!(
            "moving by {:+} ticks ({:+.3} µs) over {} frames; on the grid from pulse {} on",
            self.shift_ticks, self.shift_us, self.frames, self.arrival_pulse
        )
    }
}

impl From<&Arrived> for PrintedArrival {
    fn from(arrived: &Arrived) -> Self {
        Self {
            pulse: arrived.pulse,
            at_ticks: arrived.at.0,
            remaining_ticks: arrived.remaining.0,
        }
    }
}

impl PrintedArrival {
    pub(super) fn text(&self) -> String {
        format!(
            "arrived at pulse {} ({} ticks), {} ticks from the grid",
            self.pulse, self.at_ticks, self.remaining_ticks
        )
    }
}
