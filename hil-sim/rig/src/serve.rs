//! `hil-sim serve`: the rig, with its board behind a pseudo-terminal and, if
//! asked for, its phone behind a TCP port. Commands of `smartdepthsync` can be
//! typed against it as against hardware.

mod programs;

use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::imu::{Fault, SensorModel, SimImu};
use crate::interrupt;
use crate::led::LedConfig;
use crate::motion::MotionSpec;
use crate::motion::gesture::Gesture;
use crate::phone::{PhoneConfig, VideoMode};
use crate::random::Seed;
use crate::serve::programs::Table;
use crate::whole_rig::config::RigConfig;
use crate::whole_rig::running_rig::{Pace, RunningRig};
use crate::wiring;
use crate::wiring::jumpers::Jumpers;
use anyhow::{Context, Result};
use jiff::SignedDuration;
use stm32f4_sim::rtt::LogLine;
use stm32f4_sim::shared::{Shared, lock};
use stm32f4_sim::time::SimTime;

/// Interval between checks for a signal to end.
const POLL: Duration = Duration::from_millis(2);

/// Options of `serve`.
#[derive(clap::Args)]
pub struct ServeArgs {
    /// The firmware's ELF; without this, what `cargo xtask build` made.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// Speed of virtual time as a multiple of real time, at most; without this it passes as
    /// fast as the machine can.
    #[arg(long, value_name = "TIMES", value_parser = speed)]
    speed: Option<f64>,
    /// Once booted, keep the board paused until a program opens its port.
    #[arg(long)]
    wait_for_host: bool,
    /// Virtual time after which to stop, for example 10s or 5min.
    #[arg(long = "for", value_name = "DURATION", value_parser = duration)]
    length: Option<Duration>,
    /// Seed of all random numbers.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Motion of the rig.
    #[arg(long, value_enum, default_value = "rest")]
    motion: Gesture,
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
    /// Write a profile of this rig to this file, start what it names (a recorder of the depth
    /// camera, and a stand-in for `adb` with the phone's files), and print the commands of a
    /// session.
    #[arg(long, value_name = "FILE", requires = "phone")]
    profile: Option<PathBuf>,
    /// Write the ground truth to this file: the constants of phone and depth camera, and from
    /// second to second the board's count of ticks with the phone's clock.
    #[arg(long, value_name = "FILE", requires = "phone")]
    truth: Option<PathBuf>,
    /// Wire the board for `smartdepthsync board test` instead of a camera. Lines on standard
    /// input move the wires: `strobe PE11`, `strobe PC12 inverted`, `readback off`,
    /// `readback on`, `clock off`, `clock on`, `sda low`, `sda free`.
    #[arg(long, conflicts_with = "phone")]
    bring_up: bool,
    /// Let the firmware fail and restart, as the hardware would.
    #[arg(long)]
    tolerate_failures: bool,
    /// Do not print the firmware's log.
    #[arg(long)]
    quiet: bool,
}

/// Speed of virtual time against real time, on a command line.
///
/// # Errors
///
/// If it is not a number from 0.1 to 1000.
fn speed(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|s| (0.1..=1000.0).contains(s))
        .ok_or_else(|| "expected a number from 0.1 to 1000".to_owned())
}

/// A time span on a command line, such as 10s or 5min.
///
/// # Errors
///
/// It is not a time span, or a negative one.
fn duration(text: &str) -> Result<Duration, jiff::Error> {
    text.parse::<SignedDuration>()?.try_into()
}

/// Runs the command.
///
/// # Errors
///
/// The rig cannot be put together, the firmware has failed, or a file cannot be written.
pub fn run(args: &ServeArgs) -> Result<()> {
    let stopped = interrupt::watch()?;
    let mut config = RigConfig::published(Seed(args.seed))
        .with_motion(MotionSpec::always(args.motion))
        .with_imu(args.imu);
    config.board = args.board;
    // On the Black Pill it would take the camera's place.
    if args.board == wiring::BoardKind::Discovery {
        config.led = Some(LedConfig::nominal(args.board));
    }
    let mut board = wiring::board_of(args.board, args.elf.as_deref());
    let jumpers = Arc::new(Mutex::new(Jumpers::default()));
    if args.bring_up {
        config.depth_camera = None;
    } else {
        // The photodiode is there, and the read-back is wired as its owner would.
        lock(&jumpers).strobe = None;
    }
    board = board.model(Arc::clone(&jumpers));
    if !args.quiet {
        board = board.on_log(|line: &LogLine| eprintln!("{line}"));
    }
    if args.tolerate_failures {
        board = board.tolerate_failures();
    }
    let phone = args.phone.map(|port| (phone(args), port));
    let pace = Pace {
        speed: args.speed,
        wait_for_host: args.wait_for_host,
    };
    let rig = RunningRig::start(config, board, phone, pace)?;
    let (sender, typed) = channel();
    // Ends with the input, or with this program.
    std::thread::spawn(move || {
        let mut lines = std::io::stdin().lines().map_while(Result::ok);
        lines.try_for_each(|line| sender.send(line))
    });

    println!("port: {}", rig.port().display());
    if let Some(phone) = rig.phone() {
        println!("phone: {}", phone.address());
    }
    let _table = match (&args.profile, rig.phone()) {
        (Some(path), Some(phone)) => {
            let own = std::env::current_exe().context("where is this program?")?;
            let table = Table::new(rig.parts(), phone, &own)?;
            let port = format!("port = \"{}\"\n", rig.port().display());
            let fresh = port + &rig.profile()? + &table.of_recorder()?;
            let before = std::fs::read_to_string(path).unwrap_or_default();
            std::fs::write(path, served_again(&before, &fresh).unwrap_or(fresh))
                .with_context(|| format!("cannot write {}", path.display()))?;
            println!("recorder: {}", table.recorder.join(" "));
            println!("\nHere, while it runs: {WORDS}.");
            print!("{}", table.commands(path));
            Some(table)
        }
        _ => None,
    };
    std::io::stdout().flush()?;
    let truth = args.truth.as_deref();
    let mut truth = truth.map(|path| Truth::create(path, &rig)).transpose()?;

    let end = args.length.map_or(SimTime::NEVER, |length| {
        SimTime::from_nanos(u64::try_from(length.as_nanos()).unwrap_or(u64::MAX))
    });
    while rig.is_running() && rig.now() < end && !stopped.load(Ordering::Relaxed) {
        rig.forget();
        for line in typed.try_iter() {
            let imu = rig.parts().imu.as_ref().filter(|_| args.bring_up);
            let obeyed = match imu {
                Some(imu) => move_wires(&line, &jumpers, imu),
                None => obey(&line, &rig, &jumpers),
            };
            if let Err(expected) = obeyed {
                eprintln!("{expected}");
            }
        }
        if let Some(truth) = &mut truth {
            truth.note(&rig)?;
        }
        std::thread::sleep(POLL);
    }
    let ended = rig.stop();
    ended.map(drop)
}

/// The file of the ground truth.
struct Truth {
    file: File,
    /// Ticks of the next line.
    next: u64,
}

impl Truth {
    fn create(path: &Path, rig: &RunningRig) -> Result<Self> {
        let cannot = || format!("cannot write {}", path.display());
        let mut file = File::create(path).with_context(cannot)?;
        for line in rig.profile()?.lines() {
            writeln!(file, "# {line}")?;
        }
        writeln!(file, "board_ticks,phone_ns")?;
        Ok(Self { file, next: 0 })
    }

    /// Writes a line once a second of board time.
    fn note(&mut self, rig: &RunningRig) -> Result<()> {
        if let Some((ticks, phone_ns)) = rig.clocks_now().filter(|now| now.0 >= self.next) {
            writeln!(self.file, "{ticks},{phone_ns}")?;
            self.next = ticks + u64::from(protocol::TICK_HZ);
        }
        Ok(())
    }
}

/// Returns the earlier profile of the same rig with today's port, address and command: what was
/// learnt and measured stays. `None` if it is of another rig.
fn served_again(before: &str, fresh: &str) -> Option<String> {
    const MOVED: [&str; 3] = ["port = ", "address = ", "command = "];
    let named = |text: &str| {
        text.lines()
            .find(|line| line.starts_with("name = "))
            .map(str::to_owned)
    };
    if before.is_empty() || named(before) != named(fresh) {
        return None;
    }
    let places = |text: &str, key: &str| -> Vec<String> {
        let lines = text.lines().filter(|line| line.starts_with(key));
        lines.map(str::to_owned).collect()
    };
    let mut kept = before.to_owned();
    for key in MOVED {
        let (old, new) = (places(before, key), places(fresh, key));
        if old.len() != new.len() {
            return None;
        }
        for (old, new) in old.iter().zip(&new) {
            kept = kept.replacen(old.as_str(), new, 1);
        }
    }
    Some(kept)
}

/// The phone: its video shows something where a session is to be extracted.
fn phone(args: &ServeArgs) -> PhoneConfig {
    let mut config = PhoneConfig::draw(Seed(args.seed));
    config.storage.clone_from(&args.phone_files);
    if args.profile.is_some() {
        config.camera.show_ball();
        config.video = VideoMode::OnStop;
    }
    config
}

/// Words that a rig takes while it runs, and what they do to it.
const WORDS: &str = "unplug, plug (the board's USB); phone off, phone on (its network); readback off, \
                     readback on; twist, knock; lamp on, lamp off (the light of strobes and LED in \
                     place of the ball, in the next video)";

/// Does to the rig what a line on standard input says.
///
/// # Errors
///
/// The line has another word, in words for the user.
fn obey(line: &str, rig: &RunningRig, jumpers: &Shared<Jumpers>) -> Result<(), String> {
    let no_phone = || String::from("the rig has no phone: serve it with --phone");
    let phone = || rig.phone().ok_or_else(no_phone);
    let words: Vec<&str> = line.split_whitespace().collect();
    match words.as_slice() {
        [] => {}
        ["unplug"] => rig.unplug(),
        ["plug"] => rig.plug(),
        ["phone", "off"] => phone()?.leave_network(),
        ["phone", "on"] => phone()?.join_network().map_err(|error| error.to_string())?,
        ["readback", "off"] => lock(jumpers).readback = false,
        ["readback", "on"] => lock(jumpers).readback = true,
        ["twist"] => rig.perform(Gesture::Twist, TWIST_S),
        ["knock"] => rig.perform(Gesture::Twist, KNOCK_S),
        ["lamp", "on"] => phone()?.app.set_lamp(true),
        ["lamp", "off"] => phone()?.app.set_lamp(false),
        _ => return Err(format!("expected one of: {WORDS}")),
    }
    Ok(())
}

/// Lengths of motions that are asked for, s: more than a session's twist needs, and little more than
/// a gesture takes to fade in and out.
const TWIST_S: f64 = 15.0;
const KNOCK_S: f64 = 1.6;

/// Moves wires of a bring-up as a line on standard input says.
///
/// # Errors
///
/// The line has another word, in words for the user.
fn move_wires(line: &str, jumpers: &Shared<Jumpers>, imu: &Shared<SimImu>) -> Result<(), String> {
    let sensor = |fault| lock(imu).schedule(SimTime::ZERO, fault);
    let words: Vec<&str> = line.split_whitespace().collect();
    match words.as_slice() {
        ["strobe", pin, gate @ ..] => {
            let pin = pin.parse()?;
            let mut jumpers = lock(jumpers);
            jumpers.strobe = Some(pin);
            jumpers.inverted = gate == ["inverted"];
        }
        ["readback", to] => lock(jumpers).readback = *to == "on",
        ["clock", to] => sensor(Fault::ClockCut(*to == "off")),
        ["sda", "low"] => sensor(Fault::HoldSda(None)),
        ["sda", "free"] => sensor(Fault::ReleaseSda),
        _ => {
            return Err(String::from(
                "unknown wire; expected strobe PE11, strobe PC12 inverted, readback off, clock off, \
                 sda low, sda free",
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rig_that_is_served_again_keeps_what_was_learnt() {
        let fresh = |port: u8| {
            format!(
                "port = \"{port}\"\nname = \"rig, seed 1\"\n\n[phone]\naddress = \"x:{port}\"\n\
                 \n[depth.recorder]\ncommand = [\"{port}\"]\n"
            )
        };
        let learnt = format!("{}\n[phone.learnt]\nskew = 1e-5\n", fresh(1));
        let again = served_again(&learnt, &fresh(2)).unwrap();
        assert_eq!(
            again,
            format!("{}\n[phone.learnt]\nskew = 1e-5\n", fresh(2))
        );
        assert_eq!(served_again("", &fresh(2)), None);
        let other = learnt.replace("seed 1", "seed 2");
        assert_eq!(served_again(&other, &fresh(2)), None);
    }
}
