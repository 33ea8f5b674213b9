//! `hil-sim serve`: the rig, with its board behind a pseudo-terminal and, if
//! asked for, its phone behind a TCP port. Commands of `smartdepthsync` can be
//! typed against it as against hardware.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::imu::{Fault, SensorModel, SimImu};
use crate::jumpers::Jumpers;
use crate::motion::MotionSpec;
use crate::owner_profile::owner_profile;
use crate::phone::{PhoneConfig, SimPhone, Surroundings, VideoMode};
use crate::random::Seed;
use crate::rig_config::{RigConfig, RigParts};
use crate::running_rig::{BOOT_LIMIT, PATIENCE, Pacer, Port};
use crate::table::Table;
use crate::true_clock::{BoardClockwork, TrueClock};
use crate::truth_recorder::TruthRecorder;
use crate::wiring;
use anyhow::{Context, Result};
use jiff::SignedDuration;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use stm32f4_sim::pin::Pin;
use stm32f4_sim::rtt::LogLine;
use stm32f4_sim::shared::{Shared, lock};
use stm32f4_sim::sim::Sim;
use stm32f4_sim::time::{SimDuration, SimTime};
use stm32f4_sim::vcd_trace::VcdTrace;

/// Virtual time between two looks at what the models have noted.
const NOTE_STEP: SimDuration = SimDuration::from_millis(100);

/// Options of `serve`.
#[derive(clap::Args)]
pub struct Args {
    /// The firmware's ELF; without this, what `cargo xtask build` made.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// Pace virtual time by the wall clock, whether or not a program takes what the board
    /// sends. Otherwise the board runs as fast as it can, and stands still for a program
    /// that has not taken it.
    #[arg(long, conflicts_with = "speed")]
    realtime: bool,
    /// Virtual time passes at most so many times as fast as real time.
    #[arg(long, value_name = "TIMES", value_parser = speed)]
    speed: Option<f64>,
    /// Once booted, let the board stand still until a program opens its port.
    #[arg(long)]
    wait_for_host: bool,
    /// Stop after so much virtual time, for example 10s or 5min.
    #[arg(long = "for", value_name = "DURATION", value_parser = duration)]
    length: Option<Duration>,
    /// The one seed of all randomness.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How the rig moves: rest, twist, walk, a sequence such as
    /// rest:5,twist:12,walk (seconds), or a CSV file (time in s, rate x, y, z in
    /// rad/s, optionally specific force x, y, z in m/s²).
    #[arg(long, value_name = "MOTION", default_value = "rest")]
    motion: MotionSpec,
    /// The board.
    #[arg(long, value_enum, default_value_t)]
    board: wiring::BoardKind,
    /// The IMU on the board.
    #[arg(long, value_enum, default_value_t)]
    imu: SensorModel,
    /// Switch the phone on; its app listens on this port of 127.0.0.1 (0: a free one).
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "6969")]
    phone: Option<u16>,
    /// Folder of the phone's files; a temporary one that goes with the phone if
    /// not given.
    #[arg(long, value_name = "DIR", requires = "phone")]
    phone_files: Option<PathBuf>,
    /// Write the rig profile of this rig's owner to this file, offer the depth camera to the
    /// recorder that it names and the phone's files to a stand-in for `adb`, and print the
    /// commands of a session.
    #[arg(long, value_name = "FILE", requires = "phone")]
    profile: Option<PathBuf>,
    /// Wire the board for `smartdepthsync bring-up` instead of a camera. Lines on standard
    /// input move the wires: `strobe PE11`, `strobe PA5`, `readback off`, `readback on`,
    /// `sda low`, `sda free`.
    #[arg(long, conflicts_with = "phone")]
    bring_up: bool,
    /// Write what really happened to this file, as JSON lines.
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
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
    (wiring::TRIGGER, "trigger"),
    (wiring::IMU_READY, "imu_ready"),
    (wiring::STROBE, "strobe"),
    (wiring::READBACK, "readback"),
    (wiring::SCL, "scl"),
    (wiring::SDA, "sda"),
    (wiring::PPS, "pps"),
    (wiring::LED_IMU, "led_imu"),
    (wiring::LED_PULSE, "led_pulse"),
    (wiring::LED_FAULT, "led_fault"),
    (wiring::LED_LINK, "led_link"),
];

/// How many times as fast as real time virtual time may pass, on a command line.
///
/// # Errors
///
/// If it is not a number from 0.1 to 1000.
pub fn speed(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|s| (0.1..=1000.0).contains(s))
        .ok_or_else(|| "expected a number from 0.1 to 1000".to_owned())
}

/// A time span on a command line, such as 10s or 5min.
///
/// # Errors
///
/// If it is none, or negative.
pub fn duration(text: &str) -> Result<Duration, jiff::Error> {
    text.parse::<SignedDuration>()?.try_into()
}

/// Becomes true at Ctrl-C and at termination signals.
pub(crate) fn stopped_by_signal() -> Result<Arc<AtomicBool>> {
    let stopped = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&stopped))
            .context("cannot watch for Ctrl-C")?;
    }
    Ok(stopped)
}

/// Runs the rig until its time is over or Ctrl-C is pressed.
///
/// # Errors
///
/// If the firmware fails, a part of the rig cannot be set up, or a file cannot be
/// written.
pub fn run(args: &Args) -> Result<()> {
    let mut config = RigConfig::published(Seed(args.seed))
        .with_motion(args.motion.clone())
        .with_imu(args.imu);
    config.board = args.board;
    if args.bring_up {
        config.depth_camera = None;
    }
    let parts = config.build()?;
    let mut builder = parts.wire(wiring::board_of(args.board, args.elf.as_deref()));
    if args.bring_up {
        let jumpers = Arc::new(Mutex::new(Jumpers::default()));
        builder = builder.model(Arc::clone(&jumpers));
        let imu = parts.imu.clone();
        std::thread::spawn(move || move_wires(&jumpers, imu.as_ref()));
    }
    let clock = TrueClock::new();
    let phone = match args.phone {
        None => None,
        Some(port) => {
            builder = builder.model(BoardClockwork::new(parts.board.clone(), clock.clone()));
            Some(start_phone(args, &parts, &clock, port)?)
        }
    };
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
        let shared = Arc::new(Mutex::new(vcd));
        builder = builder.model(Arc::clone(&shared));
        trace = Some(shared);
    }
    let mut rig = builder.build()?;
    let mut port = Port::new(&mut rig)?;
    println!("port: {}", port.pty.path().display());
    if let Some(phone) = &phone {
        println!("phone: {}", phone.address());
    }
    let table = match (&args.profile, &phone) {
        (Some(path), Some(phone)) => {
            let own = std::env::current_exe().context("where is this program?")?;
            let table = Table::new(&parts, phone, &own)?;
            let text = owner_profile(&parts.config, &phone.handset())? + &table.recorder();
            std::fs::write(path, text)
                .with_context(|| format!("cannot write {}", path.display()))?;
            print!("{}", table.commands(port.pty.path(), path));
            Some(table)
        }
        _ => None,
    };
    std::io::stdout().flush()?;

    let stopped = stopped_by_signal()?;

    let mut truth = match &args.truth {
        None => None,
        Some(path) => {
            let cannot = || format!("cannot write {}", path.display());
            let file = BufWriter::new(File::create(path).with_context(cannot)?);
            Some(TruthRecorder::new(file, &mut rig, &parts).with_context(cannot)?)
        }
    };

    let result = pump(args, &mut rig, &mut port, &stopped, |rig| {
        match &mut truth {
            Some(truth) => truth.poll(rig).context("the truth could not be written")?,
            // Nobody wants it.
            None => drop(parts.take_records()),
        }
        Ok(())
    });
    let noted = truth.map_or(Ok(()), |mut truth| {
        truth.poll(&mut rig)?;
        truth.flush()
    });
    // Whoever waits for true time waits in vain now.
    clock.stop();
    drop(phone);
    drop(table);
    if let Some(trace) = trace {
        lock(&trace)
            .flush()
            .context("the trace could not be written")?;
    }
    result?;
    noted.context("the truth could not be written")
}

/// Moves wires of a bring-up as the lines on standard input say.
fn move_wires(jumpers: &Shared<Jumpers>, imu: Option<&Shared<SimImu>>) {
    let sensor = |fault| {
        if let Some(imu) = imu {
            lock(imu).schedule(SimTime::ZERO, fault);
        }
    };
    for line in std::io::stdin().lines().map_while(Result::ok) {
        match line.trim() {
            "strobe PE11" => lock(jumpers).strobe = Some(Pin::PE11),
            "strobe PA5" => lock(jumpers).strobe = Some(Pin::PA5),
            "readback off" => lock(jumpers).readback = false,
            "readback on" => lock(jumpers).readback = true,
            "sda low" => sensor(Fault::HoldSda(None)),
            "sda free" => sensor(Fault::ReleaseSda),
            other => eprintln!(
                "no wire is called {other:?}: strobe PE11, strobe PA5, readback off, readback on, \
                 sda low, sda free"
            ),
        }
    }
}

/// Switches the phone on.
fn start_phone(args: &Args, parts: &RigParts, clock: &TrueClock, port: u16) -> Result<SimPhone> {
    let mut config = PhoneConfig::draw(parts.config.seed);
    config.storage.clone_from(&args.phone_files);
    if args.profile.is_some() {
        config.camera.show_ball();
        // The app has its file when the recording is stopped.
        config.video = VideoMode::OnStop;
    }
    let surroundings = Surroundings {
        clock: clock.clone(),
        motion: Arc::clone(&parts.motion),
        light: Arc::new(parts.flashes.clone()),
    };
    SimPhone::start(config, surroundings, port)
}

/// Runs the board and moves bytes; calls `note` every now and then.
fn pump(
    args: &Args,
    rig: &mut Sim,
    port: &mut Port,
    stopped: &AtomicBool,
    mut note: impl FnMut(&mut Sim) -> Result<()>,
) -> Result<()> {
    let end = args
        .length
        .map(|d| SimTime::from_nanos(u64::try_from(d.as_nanos()).unwrap_or(u64::MAX)));
    let stopped = || stopped.load(Ordering::Relaxed);
    if args.wait_for_host {
        rig.run_until_usb_ready(BOOT_LIMIT)?;
    }
    while args.wait_for_host && !port.pty.is_open()? && !stopped() {
        std::thread::sleep(PATIENCE);
    }
    let speed = args.speed.or(args.realtime.then_some(1.0));
    let mut pacer = Pacer::new(speed, rig.now());
    let mut next_note = rig.now();
    while end.is_none_or(|end| rig.now() < end) && !stopped() {
        if !port.move_bytes(rig)? && !args.realtime {
            std::thread::sleep(PATIENCE);
            continue;
        }
        pacer.wait(rig.now());
        rig.run_for(pacer.step())?;
        if rig.now() >= next_note {
            note(rig)?;
            next_note = rig.now() + NOTE_STEP;
        }
    }
    // What came of the last step.
    port.move_bytes(rig)?;
    Ok(())
}
