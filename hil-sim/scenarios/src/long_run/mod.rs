//! Hours of trigger, IMU and strobe in one run, every edge and sample compared.
//!
//! The firmware runs on the simulated board with its IMU and a depth camera
//! whose photodiode is wired to the strobe input. The host's end of the link is
//! the host tool's own [`Session`]. Part of the time the link is filled up with
//! as much as USB takes, on top of the streams. The first difference ends the
//! run with an error that says what and when.
//!
//! Flat memory is judged where memory can grow: the board has no heap, so its
//! stack is looked at; of the host's end (session, decoder and this program's
//! comparison, in one process) it is the resident memory, from the end of the
//! first tenth on, when every buffer has found its size.

mod bench;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, ensure};
use serde::Serialize;

use bench::{Bench, STEPS_A_SECOND};
use rig::random::Seed;
use stm32f4_sim::time::SimTime;

/// Most growth of the resident memory, in bytes: pages that the allocator
/// has not given back.
const GROWTH_ALLOWED: i64 = 2 << 20;

/// Virtual seconds of a slice with or without a full link.
const SLICE_S: u64 = 10;

/// Settings of a run.
#[derive(Clone, Debug)]
pub struct Options {
    /// The firmware's ELF; without this, the default one.
    pub elf: Option<PathBuf>,
    /// The one seed of all randomness.
    pub seed: Seed,
    /// Virtual seconds.
    pub seconds: u64,
    /// Share of the time in which the link is filled up, in percent: so many of
    /// every hundred slices of 10 s.
    pub full_link_percent: u64,
    /// True if the camera's photodiode is on the strobe input: 540 edges a second.
    pub strobe: bool,
}

/// Waits and runs of one interrupt, in microseconds.
#[derive(Clone, Debug, Serialize)]
pub struct Interrupt {
    /// Whose.
    pub name: &'static str,
    /// Number of times that its handler ran.
    pub entries: u64,
    /// Longest time from the request to the handler's first instruction; none
    /// for a handler that only the firmware itself requests.
    pub longest_wait_us: Option<f64>,
    /// Mean of that time.
    pub mean_wait_us: Option<f64>,
    /// Longest run of the handler, without those that interrupted it.
    pub longest_run_us: f64,
}

/// Bytes that a number took on the wire at the begin and at the end: postcard
/// writes seven bits a byte.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Growth {
    /// The number.
    pub field: &'static str,
    /// Its value at the end.
    pub last: u64,
    /// Bytes at the begin.
    pub from_bytes: u32,
    /// Bytes at the end.
    pub to_bytes: u32,
}

/// Result of a run. Everything but wall time and memory is simulated, and the
/// same on every machine.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// The seed.
    pub seed: u64,
    /// Git revision of the firmware.
    pub firmware: String,
    /// Virtual seconds.
    pub virtual_s: f64,
    /// Wall seconds.
    pub wall_s: f64,
    /// Virtual seconds with a full link.
    pub full_link_s: u64,
    /// Pulses at the pin, each equal to the arithmetic.
    pub pulses: u64,
    /// Pulses reported, each equal to the pin.
    pub pulses_reported: u64,
    /// Samples, each equal to its data-ready edge and the sensor's registers.
    pub samples: u64,
    /// Edges of the strobe, each equal to the pin.
    pub captures: u64,
    /// Status messages, a second apart each.
    pub statuses: u64,
    /// Messages of filler.
    pub fillers: u64,
    /// Bytes that came over the link.
    pub link_bytes: u64,
    /// Messages lost on any stream.
    pub lost: u64,
    /// Times the 32-bit counter wrapped.
    pub wraps: u64,
    /// Numbers that grew over the wire's size boundaries.
    pub growth: Vec<Growth>,
    /// Bytes of stack used after the first tenth.
    pub stack_used_early: u32,
    /// Bytes of stack used at the end.
    pub stack_used: u32,
    /// Bytes of stack there are.
    pub stack_size: u32,
    /// Resident memory of this process in bytes, after each tenth; 0 where the
    /// system does not tell.
    pub resident: Vec<u64>,
    /// The board's own worst time from a trigger edge to the end of its handler,
    /// in microseconds.
    pub trigger_latency_us: f64,
    /// Highest load in any second, in percent of the core.
    pub worst_load_percent: f64,
    /// The interrupts, from the core's own record.
    pub interrupts: Vec<Interrupt>,
}

impl Report {
    /// Growth of the resident memory from the end of the first tenth to the end.
    #[must_use]
    pub fn resident_growth(&self) -> i64 {
        let at = |index: usize| {
            self.resident
                .get(index)
                .map_or(0, |bytes| i64::try_from(*bytes).unwrap_or(i64::MAX))
        };
        at(self.resident.len().saturating_sub(1)) - at(0)
    }
}

/// Progress of a run.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Virtual time.
    pub at: SimTime,
    /// Pulses compared.
    pub pulses: u64,
    /// Samples compared.
    pub samples: u64,
}

/// Runs, and calls `progress` every virtual minute.
///
/// # Errors
///
/// The firmware failed, or anything differs from what it should be.
pub fn run(options: &Options, mut progress: impl FnMut(&Progress)) -> Result<Report> {
    let mut bench = Bench::new(options)?;
    bench.start()?;
    let begun = Instant::now();
    let mut resident = Vec::new();
    let tenth = options.seconds.div_ceil(10).max(1);
    let mut full_link_s = 0;
    let mut full = false;
    let mut stack_used_early = 0;
    for second in 0..options.seconds {
        let slice = second / SLICE_S % 100;
        // Spread evenly: every n-th slice.
        let before = slice * options.full_link_percent / 100;
        let wanted = (slice + 1) * options.full_link_percent / 100 > before;
        if wanted != full {
            full = wanted;
            bench.fill(full)?;
        }
        full_link_s += u64::from(full);
        for _ in 0..STEPS_A_SECOND {
            bench.step()?;
        }
        if (second + 1) % tenth == 0 {
            if resident.is_empty() {
                stack_used_early = bench.stack_used();
            }
            resident.push(resident_bytes());
        }
        if second % 60 == 59 {
            let compared = bench.compared();
            progress(&Progress {
                at: bench.now(),
                pulses: compared.pulses,
                samples: compared.samples,
            });
        }
    }
    bench.fill(false)?;
    bench.stop()?;
    let report = bench.report(Report {
        seed: options.seed.0,
        virtual_s: options.seconds as f64,
        wall_s: begun.elapsed().as_secs_f64(),
        full_link_s,
        stack_used_early,
        resident,
        ..Report::default()
    })?;
    ensure!(
        report.resident_growth() <= GROWTH_ALLOWED,
        "the host's memory grew by {} bytes: {:?}",
        report.resident_growth(),
        report.resident
    );
    Ok(report)
}

/// Resident memory of this process, from Linux's `/proc`; 0 elsewhere.
fn resident_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|text| text.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap_or(0) * 1024
}
