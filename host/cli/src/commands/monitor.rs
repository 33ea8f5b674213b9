//! `smartdepthsync monitor`: look at the board while it runs.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use protocol::{TICK_HZ, Ticks};

use crate::advice::imu_scale;
use crate::context::Context;
use crate::decimal::parse_duration;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};
use crate::record::{Connector as _, SerialConnector};
use crate::view::gauge::Gauge;
use crate::view::lines::line;
use crate::view::screen::{Key, Screen};
use crate::view::{PERIOD, Snapshot};
use board::Event;
use board::imu::Scale;
use board::transport::LinkError;
use board::{Board, BoardError};
use recording::profile::Profile;

/// How often a plain line is written where there is no terminal, board time.
const LINE_TICKS: u64 = TICK_HZ as u64;

/// What the state is called.
const STATE: &str = "monitor";

/// Look at the board: trigger, gyroscope, rates, losses. Nothing is changed and
/// nothing is recorded.
///
/// On a terminal a live view (h shows its keys), else a line a second. With --json
/// the state at the end.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
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
}

/// Runs the command.
///
/// # Errors
///
/// The board cannot be reached, or does not come back.
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    let mut board = args.port.open()?;
    let scale = imu_scale(&board.imu()?)?;
    let id = protocol::usb::serial_number(&board.hello().board_id).to_string();
    let profile = args.profile.as_deref().map(Profile::load).transpose()?;
    let mut gauge = Gauge::default();
    gauge.latest.state = String::from(STATE);
    gauge.latest.board.clone_from(&id);
    if let Some(profile) = &profile {
        gauge.know_rig(profile);
    }
    let wants_screen = !args.plain && !context.global.json;
    let mut screen = wants_screen
        .then(|| Screen::open(&context.interrupt))
        .flatten();
    let keys = screen.as_mut().and_then(Screen::take_keys);
    let mut monitor = Monitor {
        context,
        connector: SerialConnector {
            port: args.port.port.clone(),
        },
        scale,
        id,
        gauge,
        screen,
        begun: None,
        last_line: None,
    };
    let mut shown = Instant::now();
    let mut snapshot = Snapshot::default();
    while !context.interrupt.requested() {
        monitor.take_events(&mut board)?;
        if shown.elapsed() >= PERIOD {
            shown = Instant::now();
            snapshot = monitor.gauge.snapshot(None, None);
            if let Some(screen) = &monitor.screen {
                screen.show(snapshot.clone());
            }
        }
        monitor.line(&snapshot)?;
        let asked = keys
            .as_ref()
            .is_some_and(|keys| keys.try_iter().any(|key| key == Key::Quit));
        if asked || monitor.is_over(snapshot.now, args.duration) {
            break;
        }
    }
    monitor.screen = None;
    let snapshot = monitor.gauge.snapshot(None, None);
    context.print_json(&snapshot)?;
    let losses = &snapshot.losses;
    Ok(ExitStatus::of_loss(losses.messages + losses.damaged > 0))
}

/// A board that is looked at.
struct Monitor<'a> {
    context: &'a Context,
    connector: SerialConnector,
    scale: Scale,
    id: String,
    gauge: Gauge,
    screen: Option<Screen>,
    /// The first board time that was shown, since the board's last reset.
    begun: Option<Ticks>,
    last_line: Option<Ticks>,
}

impl Monitor<'_> {
    /// Takes what the board has sent; waits for the next picture at most.
    fn take_events(&mut self, board: &mut Board) -> Result<(), Failure> {
        let mut wait = PERIOD;
        // Bounded, so that keys stay alive under full load.
        for _ in 0..2_000 {
            match board.next_event(wait) {
                Ok(Some(event)) => self.take(event)?,
                Ok(None) => break,
                Err(BoardError::Link(error)) => {
                    self.relink(board, &error);
                    break;
                }
                Err(other) => return Err(other.into()),
            }
            wait = Duration::ZERO;
        }
        Ok(())
    }

    fn take(&mut self, event: Event) -> Result<(), Failure> {
        match event {
            Event::Message(message) => {
                self.gauge.take(&message, Some(&self.scale));
            }
            Event::Lost { stream, count } => {
                self.gauge.lost(count);
                let text = format!("{count} {stream} lost");
                self.gauge.warning("pulse_messages_lost", &text);
            }
            Event::Disordered { stream } => {
                let text = format!("{stream} came twice, or with numbers that do not follow");
                self.gauge.warning("numbers_disordered", &text);
            }
            Event::Damaged(error) => {
                self.gauge.damaged();
                self.gauge.warning("damaged", &error.to_string());
            }
            Event::Restarted { .. } => {
                self.gauge.warning("restarted", "the board was reset");
                self.begun = None;
                self.last_line = None;
            }
            Event::OtherVersion { found } => {
                return Err(BoardError::OtherVersion { found }.into());
            }
            Event::Frame(_) | Event::Answer(_) | Event::Expired { .. } => {}
        }
        Ok(())
    }

    /// Waits until the board is back, or the user stops.
    fn relink(&mut self, board: &mut Board, error: &LinkError) {
        self.gauge.warning("link_lost", &error.to_string());
        self.gauge.latest.losses.reconnects += 1;
        self.gauge.latest.state = String::from("link lost");
        if let Some(screen) = &self.screen {
            screen.show(self.gauge.snapshot(None, None));
        }
        while !self.context.interrupt.requested() {
            let link = self.connector.connect(Some(&self.id));
            if link.and_then(|link| board.reconnect(link)).is_ok() {
                break;
            }
            std::thread::sleep(Duration::from_millis(300));
        }
        self.gauge.latest.state = String::from(STATE);
    }

    /// A plain line, where there is no view and it is time for one.
    fn line(&mut self, snapshot: &Snapshot) -> Result<(), Failure> {
        let now = snapshot.now;
        let is_due = self
            .last_line
            .is_none_or(|last| now.0.saturating_sub(last.0) >= LINE_TICKS);
        if self.screen.is_none() && is_due && now > Ticks::ZERO {
            self.last_line = Some(now);
            self.context.print_text(|| line(snapshot))?;
        }
        Ok(())
    }

    /// Whether so many ticks have passed since the first board time.
    fn is_over(&mut self, now: Ticks, duration: Option<u64>) -> bool {
        if now == Ticks::ZERO && self.begun.is_none() {
            return false;
        }
        let from = *self.begun.get_or_insert(now);
        duration.is_some_and(|ticks| now.0.saturating_sub(from.0) >= ticks)
    }
}
