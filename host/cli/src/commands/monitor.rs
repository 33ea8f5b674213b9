//! `smartdepthsync monitor`: look at the board while it runs.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use protocol::{DeviceToHost, TICK_HZ, Ticks};

use super::PortArg;
use super::record::parse_duration;
use crate::advice::imu_scale;
use crate::cli::Context;
use crate::live_data::{FoxgloveArg, LiveData};
use crate::outcome::{Failure, Outcome};
use crate::record::{Connector as _, SerialConnector};
use crate::view::gauge::Gauge;
use crate::view::lines::line;
use crate::view::screen::{Key, Screen};
use crate::view::{PERIOD, Snapshot};
use board::BoardError;
use board::imu::Scale;
use board::session::Event;
use recording::RecordingError;
use recording::profile::Profile;
use recording::writer::Publisher;

/// How often a plain line is written where there is no terminal, board time.
const LINE_TICKS: u64 = TICK_HZ as u64;

/// Look at the board: trigger, gyroscope, rates, losses. Nothing is changed and
/// nothing is recorded.
///
/// On a terminal a live view (h shows its keys), else a line a second. With --json
/// the state at the end.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// How long, in board time: 90s, 5m, 1h; until stopped if not given
    #[arg(long, value_parser = parse_duration)]
    duration: Option<u64>,
    /// The rig profile, for the names of the sensors on further outputs
    #[arg(long, value_name = "FILE")]
    profile: Option<PathBuf>,
    /// Plain lines even on a terminal
    #[arg(long)]
    plain: bool,
    #[command(flatten)]
    foxglove: FoxgloveArg,
}

/// Runs the command.
///
/// # Errors
///
/// The board cannot be reached, or does not come back.
pub fn run(args: &Args, context: &Context) -> anyhow::Result<Outcome> {
    let onlookers = args.foxglove.open(context)?;
    let mut board = args.port.open()?;
    let setup = board.imu().map_err(Failure::from)?;
    let scale = imu_scale(&setup)?;
    let id = protocol::usb::serial_number(&board.hello().board_id).to_string();
    let mut connector = SerialConnector {
        port: args.port.port.clone(),
    };
    let mut gauge = Gauge::default();
    gauge.state = String::from("monitor");
    gauge.board.clone_from(&id);
    let mut topics = onlookers.clone().map(Publisher::new);
    let profile = match &args.profile {
        Some(path) => Some(Profile::load(path).map_err(Failure::from)?),
        None => None,
    };
    if let Some(profile) = &profile {
        gauge.name_sensors(profile);
    }
    let wants_screen = !args.plain && !context.global.json;
    let mut screen = wants_screen
        .then(|| Screen::open(&context.interrupt))
        .flatten();
    let keys = screen.as_mut().and_then(Screen::take_keys);
    let mut begun: Option<Ticks> = None;
    let mut last_line: Option<Ticks> = None;
    let mut shown = Instant::now();
    let mut snapshot = Snapshot::default();
    let outcome = loop {
        if context.interrupt.requested() {
            break Outcome::Good;
        }
        // Bounded, so that keys stay alive under full load.
        let mut wait = PERIOD;
        for _ in 0..2_000 {
            match board.next_event(wait) {
                Ok(Some(Event::Message(message))) => {
                    gauge.take(&message, Some(&scale));
                    if let Some(topics) = &mut topics {
                        show_live(topics, &message, &scale, &id, profile.as_ref())
                            .map_err(Failure::from)?;
                    }
                }
                Ok(Some(Event::Lost { stream, count })) => {
                    gauge.lost(count);
                    gauge.warning("pulse_messages_lost", &format!("{count} {stream} lost"));
                }
                Ok(Some(Event::Damaged(error))) => {
                    gauge.damaged();
                    gauge.warning("damaged", &error.to_string());
                }
                Ok(Some(Event::Restarted { .. })) => {
                    gauge.warning("restarted", "the board was reset");
                    begun = None;
                    last_line = None;
                }
                Ok(Some(Event::OtherVersion { found })) => {
                    return Err(Failure::from(BoardError::OtherVersion { found }).into());
                }
                Ok(Some(_)) => {}
                Ok(None) => break,
                Err(BoardError::Link(error)) => {
                    gauge.warning("link_lost", &error.to_string());
                    gauge.reconnects += 1;
                    gauge.state = String::from("link lost");
                    if let Some(screen) = &screen {
                        screen.show(gauge.snapshot(None, None));
                    }
                    while !context.interrupt.requested() {
                        let again = connector
                            .connect(Some(&id))
                            .and_then(|link| board.reconnect(link));
                        if again.is_ok() {
                            break;
                        }
                        std::thread::sleep(Duration::from_millis(300));
                    }
                    gauge.state = String::from("monitor");
                    break;
                }
                Err(other) => return Err(Failure::from(other).into()),
            }
            wait = Duration::ZERO;
        }
        if shown.elapsed() >= PERIOD {
            shown = Instant::now();
            snapshot = gauge.snapshot(None, None);
            if let Some(onlookers) = &onlookers {
                onlookers.state(&snapshot);
            }
            if let Some(screen) = &screen {
                screen.show(snapshot.clone());
            }
        }
        let now = snapshot.now;
        let from = *begun.get_or_insert(now);
        if screen.is_none()
            && !context.global.json
            && last_line.is_none_or(|last| now.0.saturating_sub(last.0) >= LINE_TICKS)
            && now > Ticks::ZERO
        {
            last_line = Some(now);
            context.print(&snapshot, || line(&snapshot))?;
        }
        let asked = keys
            .as_ref()
            .is_some_and(|keys| keys.try_iter().any(|key| key == Key::Quit));
        let over = args
            .duration
            .is_some_and(|ticks| from > Ticks::ZERO && now.0.saturating_sub(from.0) >= ticks);
        if asked || over {
            break Outcome::Good;
        }
        if from == Ticks::ZERO {
            begun = None;
        }
    };
    drop(screen);
    let snapshot = gauge.snapshot(None, None);
    if context.global.json {
        context.print(&snapshot, String::new)?;
    }
    Ok(match outcome {
        Outcome::Good if snapshot.losses.messages + snapshot.losses.damaged > 0 => Outcome::Loss,
        other => other,
    })
}

/// A message of the board, for those who look on from elsewhere; sensors by the names
/// of the profile, if there is one.
fn show_live(
    topics: &mut Publisher<LiveData>,
    message: &DeviceToHost,
    scale: &Scale,
    board: &str,
    profile: Option<&Profile>,
) -> Result<(), RecordingError> {
    match message {
        DeviceToHost::Imu(raw) => topics.imu(&scale.apply(raw)),
        DeviceToHost::Pulse(pulse) => topics.pulse(pulse, None),
        DeviceToHost::Capture(capture) => topics.capture(capture, None),
        DeviceToHost::OutputPulse(output) => {
            let name = profile.map_or_else(
                || format!("output {}", output.output.number()),
                |profile| profile.output_name(output.output),
            );
            topics.output_pulse(&output.pulse, &name)
        }
        DeviceToHost::Pps(pps) => topics.pps(pps, profile.map_or("gnss", Profile::lidar_name)),
        DeviceToHost::Status(status) => topics.status(status, board),
        DeviceToHost::Hello(_)
        | DeviceToHost::Answer(_)
        | DeviceToHost::Arrived(_)
        | DeviceToHost::OutputArrived(_)
        | DeviceToHost::Filler(_) => Ok(()),
    }
}
