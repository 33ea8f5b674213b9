//! `hil-sim serve`: the board behind a pseudo-terminal, with its IMU at rest.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use hil_sim::i2c::lock;
use hil_sim::motion::Motion;
use hil_sim::mpu9150::{Mpu9150, Mpu9150Config};
use hil_sim::oscillator::{BoardTime, OscillatorConfig};
use hil_sim::pin::Pin;
use hil_sim::pty::Pty;
use hil_sim::random::{Seed, Stream};
use hil_sim::rig::Rig;
use hil_sim::rtt::LogLine;
use hil_sim::time::{SimDuration, SimTime};
use hil_sim::vcd_trace::VcdTrace;

/// Virtual time between two looks at the pseudo-terminal.
const STEP: SimDuration = SimDuration::from_millis(1);
/// Bytes that wait for the program at the other end before the host stops
/// asking the board for more, as an operating system does.
const BUFFER: usize = 64 * 1024;

/// Options of `serve`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The firmware's ELF; without this, what `cargo xtask build` made.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// Pace virtual time by the wall clock; otherwise it runs as fast as it can.
    #[arg(long)]
    realtime: bool,
    /// Stop after so much virtual time, for example 10s or 5min.
    #[arg(long = "for", value_name = "DURATION", value_parser = humantime::parse_duration)]
    length: Option<Duration>,
    /// The one seed of all randomness.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the edges of the board's pins to this file, for a wave viewer.
    #[arg(long, value_name = "FILE")]
    vcd: Option<PathBuf>,
    /// Let the firmware fail and restart, as the hardware would.
    #[arg(long)]
    tolerate_failures: bool,
    /// Do not print the firmware's log.
    #[arg(long)]
    quiet: bool,
}

/// The pins of a trace and the names of their wires.
const TRACED: [(Pin, &str); 11] = [
    (Pin::PA5, "trigger"),
    (Pin::PA1, "imu_ready"),
    (Pin::PA2, "strobe"),
    (Pin::PA3, "readback"),
    (Pin::PB6, "scl"),
    (Pin::PB7, "sda"),
    (Pin::PE9, "pps"),
    (Pin::PD12, "led_imu"),
    (Pin::PD13, "led_pulse"),
    (Pin::PD14, "led_fault"),
    (Pin::PD15, "led_link"),
];

pub(crate) fn run(args: &Args) -> Result<()> {
    let seed = Seed(args.seed);
    let board_time = BoardTime::new(OscillatorConfig::default(), seed.stream(Stream::BoardClock));
    let config = Mpu9150Config::typical(seed);
    let sensor = Mpu9150::new(config, Motion::rest(), board_time, seed).shared();
    let mut builder = Rig::builder()
        .seed(seed)
        .model(sensor.clone())
        .i2c_target(sensor);
    if let Some(elf) = &args.elf {
        builder = builder.elf(elf);
    }
    if !args.quiet {
        builder = builder.on_log(|line: &LogLine| eprintln!("{line}"));
    }
    if args.tolerate_failures {
        builder = builder.tolerate_failures();
    }
    let mut trace = None;
    if let Some(path) = &args.vcd {
        let file =
            File::create(path).with_context(|| format!("cannot write {}", path.display()))?;
        let vcd = VcdTrace::new(BufWriter::new(file), &TRACED)
            .with_context(|| format!("cannot write {}", path.display()))?;
        let shared = std::sync::Arc::new(std::sync::Mutex::new(vcd));
        builder = builder.model(std::sync::Arc::clone(&shared));
        trace = Some(shared);
    }
    let mut rig = builder.build()?;
    let pty = Pty::new().context("cannot make a pseudo-terminal")?;
    println!("port: {}", pty.path().display());
    std::io::stdout().flush()?;

    let result = pump(args, &mut rig, &pty);
    if let Some(trace) = trace {
        lock(&trace)
            .flush()
            .context("the trace could not be written")?;
    }
    result
}

fn pump(args: &Args, rig: &mut Rig, pty: &Pty) -> Result<()> {
    rig.usb_set_buffer_limit(BUFFER);
    rig.usb_open(false);
    let end = args
        .length
        .map(|d| SimTime::from_nanos(u64::try_from(d.as_nanos()).unwrap_or(u64::MAX)));
    let begun = Instant::now();
    let mut open = false;
    let mut waiting: Vec<u8> = Vec::new();
    let mut buffer = [0; 4096];
    while end.is_none_or(|end| rig.now() < end) {
        let is_open = pty.is_open()?;
        if is_open != open {
            open = is_open;
            rig.usb_open(open);
        }
        // A serial port's driver takes a few kilobytes ahead of the device.
        if rig.usb_unsent() < buffer.len() {
            let n = pty.read(&mut buffer)?;
            rig.usb_write(buffer.get(..n).unwrap_or(&[]));
        }
        rig.run_for(STEP)?;
        if waiting.is_empty() {
            waiting = rig.usb_read();
        }
        if !waiting.is_empty() {
            if open {
                let n = pty.write(&waiting)?;
                waiting.drain(..n);
            } else {
                waiting.clear();
            }
        }
        if args.realtime {
            let ahead = Duration::from_nanos(rig.now().as_nanos()).saturating_sub(begun.elapsed());
            if !ahead.is_zero() {
                std::thread::sleep(ahead);
            }
        }
    }
    Ok(())
}
