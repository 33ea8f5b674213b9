//! `hil-sim bench`: figures of the simulator and of the firmware in it.
//!
//! Wall-clock figures are those of this machine and its load; all others are
//! simulated and the same on every machine.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use protocol::{
    Baud, GnssSettings, MIN_OUTPUT_WIDTH, MIN_PULSE_WIDTH, Output, Period, SendFiller, Sentences,
    StartGnss, StartTrigger, StopTrigger, TICK_HZ, TriggerStart,
};
use rig::depth_camera::DepthCameraConfig;
use rig::oscillator::OscillatorConfig;
use rig::random::Seed;
use rig::rig_config::RigConfig;
use rig::wiring::{self, BoardKind};
use serde::Serialize;
use stm32f4_sim::cpu::{CpuStats, IrqStats};
use stm32f4_sim::sim::{Sim, SimBuilder};
use stm32f4_sim::time::SimDuration;

use super::board_link::BoardLink;

/// Options of `bench`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The firmware's ELF; without this, what `cargo xtask build` made.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// Print the figures as JSON.
    #[arg(long)]
    json: bool,
}

/// One load of the board.
#[derive(Serialize)]
struct Load {
    name: &'static str,
    virtual_seconds: f64,
    /// Virtual seconds a wall second.
    speed: f64,
    /// Share of core cycles awake.
    cpu: f64,
    /// Bytes a second from the board.
    bytes_per_second: f64,
    /// Share of core cycles in TIM2's handler (trigger and captures).
    trigger_cpu: f64,
    /// Longest wait of TIM2's handler and longest run, in microseconds.
    trigger_latency_us: f64,
    trigger_run_us: f64,
    /// Longest time from an edge of the trigger to the end of its handling, as
    /// the firmware measures it since its reset; without edges, none.
    edge_to_end_us: Option<f64>,
    /// The same of the auxiliary outputs.
    output_edge_to_end_us: Option<f64>,
}

#[derive(Serialize)]
struct Figures {
    flash_bytes: usize,
    ram_bytes: usize,
    /// Virtual milliseconds from power-on.
    attach_ms: f64,
    hello_ms: f64,
    loads: Vec<Load>,
    /// Shortest period that the board takes, and the worst time from an edge to
    /// the end of its handling in all loads.
    shortest_period_us: f64,
    edge_to_end_us: f64,
    /// Share of core cycles for sampling the IMU.
    sampling_cpu: f64,
}

/// Names of loads that figures are worked out from.
const IDLE: &str = "idle";
const IMU: &str = "IMU at 500 Hz";
const RIG: &str = "IMU, trigger and strobe at 30 fps";

/// Exception number of TIM2's interrupt.
const TIM2: usize = 16 + 28;
const SEED: Seed = Seed(1);

pub(crate) fn run(args: &Args) -> Result<()> {
    let figures = measure(args)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&figures)?);
        return Ok(());
    }
    println!(
        "firmware: {} bytes of flash, {} bytes of RAM (statics)",
        figures.flash_bytes, figures.ram_bytes
    );
    println!(
        "boot (simulated): USB attached {:.2} ms, Hello at the host {:.1} ms after power-on",
        figures.attach_ms, figures.hello_ms
    );
    println!(
        "{:<34} {:>12} {:>8} {:>11} {:>9} {:>10} {:>9} {:>11}",
        "load", "x real time", "CPU", "bytes/s", "TIM2 CPU", "TIM2 wait", "TIM2 run", "edge to end"
    );
    for l in &figures.loads {
        println!(
            "{:<34} {:>12.1} {:>7.2}% {:>11.0} {:>8.3}% {:>7.2} us {:>6.2} us {:>11}",
            l.name,
            l.speed,
            l.cpu * 100.0,
            l.bytes_per_second,
            l.trigger_cpu * 100.0,
            l.trigger_latency_us,
            l.trigger_run_us,
            l.edge_to_end_us
                .map_or("-".to_owned(), |us| format!("{us:.2} us")),
        );
    }
    println!(
        "trigger: an edge is handled {:.2} us after it at the latest, {:.2} % of the shortest \
         period of {} us; a pulse must be {} us long",
        figures.edge_to_end_us,
        100.0 * figures.edge_to_end_us / figures.shortest_period_us,
        figures.shortest_period_us,
        MIN_PULSE_WIDTH / (TICK_HZ / 1_000_000),
    );
    let outputs = figures.loads.iter().filter_map(|l| l.output_edge_to_end_us);
    println!(
        "auxiliary outputs: an edge is handled {:.2} us after it at the latest; a pulse must be {} us \
         long",
        outputs.fold(0.0, f64::max),
        MIN_OUTPUT_WIDTH / (TICK_HZ / 1_000_000),
    );
    println!(
        "sampling the IMU and sending its samples takes {:.2} % of the core",
        100.0 * figures.sampling_cpu
    );
    println!("CPU, bytes/s and TIM2 figures are simulated; the speed is this machine's.");
    Ok(())
}

fn builder(args: &Args) -> SimBuilder {
    wiring::board_of(BoardKind::default(), args.elf.as_deref()).seed(SEED)
}

fn measure(args: &Args) -> Result<Figures> {
    let mut rig = builder(args).build()?;
    let mut link = BoardLink::open(&mut rig)?;
    let hello_ms = rig.now().as_secs_f64() * 1e3;
    let attach_ms = rig
        .usb_log()
        .iter()
        .rfind(|(_, what)| what == "device attached")
        .map(|(at, _)| at.as_secs_f64() * 1e3)
        .context("the device never attached")?;
    let mut figures = Figures {
        flash_bytes: rig.firmware().flash_size(),
        ram_bytes: rig.firmware().ram_size(),
        attach_ms,
        hello_ms,
        loads: Vec::new(),
        shortest_period_us: Period::MIN.as_secs_f64() * 1e6,
        edge_to_end_us: 0.0,
        sampling_cpu: 0.0,
    };
    figures.loads.push(load(IDLE, &mut rig, &mut link, 60)?);
    start(&mut rig, &mut link, Period::MIN, MIN_PULSE_WIDTH)?;
    let name = "trigger at 1 kHz";
    figures.loads.push(load(name, &mut rig, &mut link, 10)?);
    link.request(&mut rig, StopTrigger(Output::Camera))?;
    filler(&mut rig, &mut link)?;
    figures.loads.push(load(
        "streaming as much as USB takes",
        &mut rig,
        &mut link,
        10,
    )?);

    // The whole rig: IMU at 500 Hz, trigger and camera at 30 fps.
    let config = RigConfig {
        board_clock: OscillatorConfig::default(),
        depth_camera: Some(DepthCameraConfig::default()),
        ..RigConfig::published(SEED)
    };
    let mut rig = config.build()?.wire(builder(args)).build()?;
    let mut link = BoardLink::open(&mut rig)?;
    rig.run_for(SimDuration::from_secs(1))?;
    figures.loads.push(load(IMU, &mut rig, &mut link, 20)?);
    let period = Period::from_ticks(TICK_HZ / 30);
    start(&mut rig, &mut link, period, 12 * (TICK_HZ / 1_000_000))?;
    figures.loads.push(load(RIG, &mut rig, &mut link, 20)?);
    start_outputs(&mut rig, &mut link)?;
    let name = "the same, three more trains, lidar";
    figures.loads.push(load(name, &mut rig, &mut link, 20)?);
    filler(&mut rig, &mut link)?;
    figures
        .loads
        .push(load("all of it, and USB full", &mut rig, &mut link, 10)?);
    let edges = figures.loads.iter().filter_map(|load| load.edge_to_end_us);
    figures.edge_to_end_us = edges.fold(0.0, f64::max);
    figures.sampling_cpu = figures.cpu(IMU) - figures.cpu(IDLE);
    Ok(figures)
}

impl Figures {
    /// Share of core cycles awake under a load.
    fn cpu(&self, name: &str) -> f64 {
        let load = self.loads.iter().find(|load| load.name == name);
        load.map_or(0.0, |load| load.cpu)
    }
}

/// Starts the outputs 2 to 4 at 30, 30 and 5 fps and the pulse per second, as a
/// lidar wants it.
fn start_outputs(rig: &mut Sim, link: &mut BoardLink) -> Result<()> {
    for (output, fps) in Output::AUXILIARY.into_iter().zip([30, 30, 5]) {
        let start = TriggerStart {
            period: Period::from_ticks(TICK_HZ / fps),
            width: 100 * (TICK_HZ / 1_000_000),
            first_edge: None,
            first_fraction: 0,
        };
        link.request(rig, StartTrigger { output, start })?;
    }
    let settings = GnssSettings {
        utc_at_zero: 1_800_000_000,
        baud: Baud::B9600,
        line_inverted: true,
        sentences: Sentences::Rmc,
        delay_ms: 50,
        pulse_width: TICK_HZ / 50,
        pulse_inverted: false,
    };
    link.request(rig, StartGnss(settings))?;
    rig.run_for(SimDuration::from_secs(1))?;
    Ok(())
}

/// Starts a train.
fn start(rig: &mut Sim, link: &mut BoardLink, period: Period, width: u32) -> Result<()> {
    let start = TriggerStart {
        period,
        width,
        first_edge: None,
        first_fraction: 0,
    };
    let output = Output::Camera;
    link.request(rig, StartTrigger { output, start })?;
    rig.run_for(SimDuration::from_secs(1))?;
    Ok(())
}

/// Switches the filler on at full rate.
fn filler(rig: &mut Sim, link: &mut BoardLink) -> Result<()> {
    link.request(
        rig,
        SendFiller {
            bytes_per_second: u32::MAX,
        },
    )?;
    rig.run_for(SimDuration::from_millis(500))?;
    Ok(())
}

fn load(name: &'static str, rig: &mut Sim, link: &mut BoardLink, seconds: u64) -> Result<Load> {
    let before = rig.cpu_stats();
    let traffic = rig.usb_traffic().bytes_in;
    let begun = Instant::now();
    let mut statuses = Vec::new();
    for _ in 0..seconds * 20 {
        rig.run_for(SimDuration::from_millis(50))?;
        statuses.extend(link.take_statuses(rig));
    }
    let wall = begun.elapsed().as_secs_f64();
    if (statuses.len() as u64) + 1 < seconds {
        bail!("{name}: {} status messages in {seconds} s", statuses.len());
    }
    let latency = statuses.last().map_or(0, |status| status.trigger_latency);
    let output_latency = statuses.last().map_or(0, |status| status.output_latency);
    if let Some(late) = statuses.iter().find(|status| status.trigger.late > 0) {
        bail!("{name}: {} edges came late", late.trigger.late);
    }
    let after = rig.cpu_stats();
    let cycles = (after.awake - before.awake) + (after.asleep - before.asleep);
    let tim2 = |s: &CpuStats| s.exceptions.get(TIM2).copied().unwrap_or_default();
    let (t0, t1): (IrqStats, IrqStats) = (tim2(&before), tim2(&after));
    let core_mhz = rig.core_rate().hz_rounded() as f64 / 1e6;
    Ok(Load {
        name,
        virtual_seconds: seconds as f64,
        speed: seconds as f64 / wall,
        cpu: (after.awake - before.awake) as f64 / cycles as f64,
        bytes_per_second: (rig.usb_traffic().bytes_in - traffic) as f64 / seconds as f64,
        trigger_cpu: (t1.cycles - t0.cycles) as f64 / cycles as f64,
        trigger_latency_us: t1.max_latency as f64 / core_mhz,
        trigger_run_us: t1.max_cycles as f64 / core_mhz,
        edge_to_end_us: (latency > 0).then(|| f64::from(latency) * 1e6 / f64::from(TICK_HZ)),
        output_edge_to_end_us: (output_latency > 0)
            .then(|| f64::from(output_latency) * 1e6 / f64::from(TICK_HZ)),
    })
}
