//! `smartdepthsync monitor`: look at the board while it runs.

use std::time::Duration;

use protocol::{DeviceToHost, QueryImu, TICK_HZ, Ticks};
use serde::Serialize;

use crate::advice::imu_scale;
use crate::context::{Context, is_stdout_closed};
use crate::decimal::parse_length;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};
use crate::rig_profile::ProfileArg;
use crate::view::plain::line;
use crate::view::screen::{Key, PERIOD, Screen, SharedState, lock};
use crate::view::state::{Losses, Rates, Sensor, State, Trigger};
use board::finding::{EventKind, Finding};
use board::imu::Scale;
use board::transport::LinkError;
use board::{Board, BoardError, Event};
use session::devices::Connector as _;
use session::devices::hardware::SerialConnector;
use session::event::{SessionEvent, Stamped};
use session::link::watch;

/// Interval of the plain lines where there is no terminal, board time.
const LINE_TICKS: u64 = TICK_HZ as u64;

/// Watch the board: trigger, gyroscope, rates, losses. Changes nothing and records nothing.
///
/// Shows a live view on a terminal (h lists its keys), and a line per second elsewhere. With
/// --json, prints the state at the end.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync monitor --duration 1m")]
pub(crate) struct MonitorArgs {
    #[command(flatten)]
    port: PortArg,
    /// Duration in board time, such as 90s, 5m or 1h [default: until stopped]
    #[arg(long, value_name = "TIME", value_parser = parse_length)]
    duration: Option<u64>,
    #[command(flatten)]
    profile: ProfileArg,
    /// Print plain lines even on a terminal
    #[arg(long)]
    plain: bool,
}

/// The object of `--json`.
#[derive(Debug, Serialize)]
struct PrintedState<'a> {
    state: String,
    board: &'a str,
    now: Ticks,
    trigger: &'a Trigger,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    sensors: Vec<Sensor>,
    rates: Rates,
    losses: Losses,
    warnings: Vec<&'a Finding>,
}

/// Runs the command.
///
/// # Errors
///
/// The board cannot be reached, or does not come back.
pub(crate) fn run(args: &MonitorArgs, context: &Context) -> Result<ExitStatus, Failure> {
    let (profile, _) = args.profile.load()?;
    let mut board = args.port.open_of(Some(&profile))?;
    let scale = imu_scale(&board.call(QueryImu)?)?;
    let id = protocol::usb::serial_number(&board.hello().board_id).to_string();
    let state = SharedState::new(State::of_board(id.clone(), Some(&profile)).into());
    let wants_screen = !args.plain && !context.global.json;
    let mut screen = wants_screen
        .then(|| Screen::open(&state, &context.interrupt))
        .flatten();
    let keys = screen.as_mut().and_then(Screen::take_keys);
    let mut monitor = Monitor {
        context,
        connector: SerialConnector {
            port: args.port.path(Some(&profile)),
        },
        scale,
        id,
        state,
        begun: None,
        last_line: None,
    };
    while !context.interrupt.requested() && !is_stdout_closed() {
        monitor.handle_events(&mut board)?;
        let now = lock(&monitor.state).now;
        if screen.is_none() {
            monitor.line(now)?;
        }
        let is_left = keys
            .as_ref()
            .is_some_and(|keys| keys.try_iter().any(|key| key == Key::Quit));
        if is_left || monitor.is_over(now, args.duration) {
            break;
        }
    }
    drop(screen);
    let state = lock(&monitor.state);
    context.print_json(&PrintedState {
        state: state.doing(),
        board: &state.board,
        now: state.now,
        trigger: &state.trigger,
        sensors: state.sensors(),
        rates: state.rates(),
        losses: state.losses,
        warnings: state.warnings.iter().collect(),
    })?;
    let losses = state.losses;
    Ok(ExitStatus::of_loss(losses.messages + losses.damaged > 0))
}

/// A board that is monitored.
struct Monitor<'a> {
    context: &'a Context,
    connector: SerialConnector,
    scale: Scale,
    id: String,
    state: SharedState,
    /// The first board time that was shown, since the board's last reset.
    begun: Option<Ticks>,
    last_line: Option<Ticks>,
}

impl Monitor<'_> {
    /// Handles the board's events, waiting for them at most until the next picture.
    fn handle_events(&mut self, board: &mut Board) -> Result<(), Failure> {
        let mut wait = PERIOD;
        // Bounded, so that keys stay alive under full load.
        for _ in 0..2_000 {
            match board.next_event(wait) {
                Ok(Some(event)) => self.handle(board.conversation().latest(), event)?,
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

    fn handle(&mut self, at: Ticks, event: Event) -> Result<(), Failure> {
        match event {
            Event::Message(message) => {
                let sample = match &message {
                    DeviceToHost::Imu(raw) => Some(self.scale.apply(raw)),
                    _ => None,
                };
                self.show(at, SessionEvent::Board { message, sample });
            }
            Event::Lost { stream, count } => {
                if let Some(finding) = watch::lost(stream, count) {
                    self.show(at, SessionEvent::Found { finding });
                }
                let stream = stream.to_string();
                self.show(at, SessionEvent::Lost { stream, count });
            }
            Event::Disordered { stream } => {
                let finding = watch::disordered(stream);
                self.show(at, SessionEvent::Found { finding });
            }
            Event::Damaged(error) => {
                let reason = error.to_string();
                let finding = Finding::check(EventKind::Damaged, reason.as_str());
                self.show(at, SessionEvent::Found { finding });
                self.show(at, SessionEvent::Damaged { reason });
            }
            Event::Restarted { .. } => {
                let finding = Finding::check(EventKind::Restarted, "the board was reset");
                self.show(at, SessionEvent::Found { finding });
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

    fn show(&self, at: Ticks, event: SessionEvent) {
        lock(&self.state).take(&Stamped { at, event });
    }

    /// Waits until the board is back, or the user stops.
    fn relink(&self, board: &mut Board, error: &LinkError) {
        let at = lock(&self.state).now;
        let reason = error.to_string();
        let patience_s = None;
        self.show(at, SessionEvent::LinkLost { reason, patience_s });
        let mut connector = self.connector.clone();
        while !self.context.interrupt.requested() {
            let link = connector.connect(Some(&self.id));
            if link.and_then(|link| board.reconnect(link)).is_ok() {
                let away_s = 0.0;
                self.show(at, SessionEvent::LinkBack { away_s });
                break;
            }
            std::thread::sleep(Duration::from_millis(300));
        }
    }

    /// A plain line, if it is time for one.
    fn line(&mut self, now: Ticks) -> Result<(), Failure> {
        let is_due = self
            .last_line
            .is_none_or(|last| now.0.saturating_sub(last.0) >= LINE_TICKS);
        if is_due && now > Ticks::ZERO {
            self.last_line = Some(now);
            self.context.print_text(|| line(&lock(&self.state)))?;
        }
        Ok(())
    }

    /// Returns true if `duration` ticks have passed since the first board time.
    fn is_over(&mut self, now: Ticks, duration: Option<u64>) -> bool {
        if now == Ticks::ZERO && self.begun.is_none() {
            return false;
        }
        let from = *self.begun.get_or_insert(now);
        duration.is_some_and(|ticks| now.0.saturating_sub(from.0) >= ticks)
    }
}
