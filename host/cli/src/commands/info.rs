//! `smartdepthsync info`: who the board is and how it fares.

use std::fmt::Write as _;
use std::time::Duration;

use protocol::{
    BoardModel, DeviceToHost, Hello, ImuSetup, LinkCounters, ResetCause, Status, TICK_HZ,
};
use serde::Serialize;

use crate::context::Context;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};
use crate::record::preflight::firmware_version;
use crate::rig_profile::{Place, ProfileArg};
use board::imu::describe;
use board::{Board, Event, reset_cause};

/// Options of `info`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    port: PortArg,
    #[command(flatten)]
    profile: ProfileArg,
    /// Then print the board's status messages for this many seconds of board time
    #[arg(long, value_name = "SECONDS", default_value_t = 0)]
    watch: u32,
}

/// What `info --json` prints.
#[derive(Debug, Serialize)]
struct PrintedInfo {
    board_id: String,
    board_model: BoardModel,
    /// Outputs 2 to 4, and the pulse per second.
    has_outputs: bool,
    firmware_version: String,
    git_revision: Option<String>,
    git_dirty: bool,
    protocol_version: u16,
    tick_hz: u32,
    now_ticks: u64,
    uptime_s: f64,
    epoch: u32,
    reset_cause: ResetCause,
    last_panic: Option<String>,
    round_trip_us: f64,
    imu: ImuSetup,
    /// The rig profile that `record` and `doctor` would use.
    profile: Place,
    status: Vec<PrintedStatus>,
}

/// One status message.
#[derive(Debug, Serialize)]
struct PrintedStatus {
    at_ticks: u64,
    uptime_s: f64,
    cpu_percent: f64,
    stack_used: u32,
    stack_size: u32,
    /// Since the board's reset; without a host everything is dropped.
    dropped: protocol::Dropped,
    link: LinkCounters,
    connects: u32,
    trigger_latency_us: f64,
    strobe_overcaptures: u32,
    imu: protocol::ImuStatus,
}

/// Prints who the board is.
///
/// # Errors
///
/// The board cannot be reached.
pub(crate) fn run(args: &Args, context: &Context) -> Result<ExitStatus, Failure> {
    let mut board = args.port.open()?;
    let (_, round_trip) = board.ping()?;
    let imu = board.imu()?;
    let mut info = PrintedInfo::new(board.hello(), round_trip, imu, args.profile.place());
    context.print_text(|| info.text())?;
    let is_complete = args.watch == 0 || watch(args.watch, &mut board, context, &mut info.status)?;
    context.print_json(&info)?;
    if !is_complete {
        return Ok(ExitStatus::Interrupted);
    }
    let link = board.conversation();
    Ok(ExitStatus::of_loss(
        link.counts().lost() > 0 || link.damaged_frames() > 0,
    ))
}

/// Prints and keeps status messages; whether the time was up before somebody stopped it.
fn watch(
    seconds: u32,
    board: &mut Board,
    context: &Context,
    reports: &mut Vec<PrintedStatus>,
) -> Result<bool, Failure> {
    let end = board.hello().now.0 + u64::from(seconds) * u64::from(TICK_HZ);
    let mut before = None;
    let stop = context.interrupt.question();
    let watched = board.listen("status message", &stop, |board, event| {
        if let Some(Event::Message(DeviceToHost::Status(status))) = event {
            let report = PrintedStatus::from(&status);
            context.print_text(|| report.text(before))?;
            before.get_or_insert(report.dropped.total());
            reports.push(report);
        }
        let is_over = board.conversation().latest().0 >= end;
        Ok::<_, Failure>(is_over.then_some(()))
    })?;
    Ok(watched.is_some())
}

impl PrintedInfo {
    fn new(hello: &Hello, round_trip: Duration, imu: ImuSetup, profile: Place) -> Self {
        Self {
            board_model: hello.board,
            has_outputs: hello.board.has_outputs(),
            board_id: protocol::usb::serial_number(&hello.board_id).to_string(),
            firmware_version: firmware_version(hello),
            git_revision: (!hello.git_revision.is_empty()).then(|| hello.git_revision.to_string()),
            git_dirty: hello.git_dirty,
            protocol_version: hello.protocol_version,
            tick_hz: hello.tick_hz,
            now_ticks: hello.now.0,
            uptime_s: hello.now.as_secs_f64(),
            epoch: hello.epoch,
            reset_cause: hello.reset_cause,
            last_panic: hello.last_panic.as_ref().map(ToString::to_string),
            round_trip_us: round_trip.as_secs_f64() * 1e6,
            imu,
            profile,
            status: Vec::new(),
        }
    }

    fn text(&self) -> String {
        let dirty = if self.git_dirty {
            ", with uncommitted changes"
        } else {
            ""
        };
        let mut text = String::new();
        let _ = writeln!(text, "board       {}", self.board_id);
        let outputs = if self.has_outputs {
            "four trigger outputs, and a pulse per second for a lidar"
        } else {
            "the camera's trigger output alone, no outputs 2 to 4 and nothing for a lidar"
        };
        let _ = writeln!(text, "model       {}: {outputs}", self.board_model.name());
        let _ = writeln!(
            text,
            "firmware    {} ({}{dirty}), protocol {}",
            self.firmware_version,
            self.git_revision.as_deref().unwrap_or("revision unknown"),
            self.protocol_version
        );
        let _ = writeln!(
            text,
            "time        {:.6} s since reset ({} ticks of {} Hz)",
            self.uptime_s, self.now_ticks, self.tick_hz
        );
        let _ = writeln!(text, "last reset  {}", reset_cause(self.reset_cause));
        if let Some(panic) = &self.last_panic {
            let _ = writeln!(text, "last panic  {panic}");
        }
        let _ = writeln!(text, "round trip  {:.0} µs", self.round_trip_us);
        let _ = writeln!(text, "IMU         {}", describe(&self.imu));
        let _ = writeln!(text, "profile     {}", self.profile);
        text
    }
}

impl From<&Status> for PrintedStatus {
    fn from(status: &Status) -> Self {
        Self {
            at_ticks: status.at.0,
            uptime_s: status.at.as_secs_f64(),
            cpu_percent: f64::from(status.cpu_permille) / 10.0,
            stack_used: status.stack_used,
            stack_size: status.stack_size,
            dropped: status.dropped,
            link: status.link,
            connects: status.connects,
            trigger_latency_us: f64::from(status.trigger_latency) * 1e6 / f64::from(TICK_HZ),
            strobe_overcaptures: status.strobe_overcaptures,
            imu: status.imu,
        }
    }
}

impl PrintedStatus {
    /// In words. `before` is what had been dropped by the first status: all that
    /// was made while no host was connected, which is no loss to this one.
    fn text(&self, before: Option<u64>) -> String {
        let dropped = self.dropped.total();
        let dropped = match before {
            Some(before) => format!("dropped {}", dropped.saturating_sub(before)),
            None if dropped == 0 => String::from("dropped 0"),
            None => format!("dropped 0 ({dropped} before)"),
        };
        format!(
            "{:>10.3} s  CPU {:>4.1} %  stack {}/{} bytes  {dropped}  IMU {:?}, {} samples",
            self.uptime_s,
            self.cpu_percent,
            self.stack_used,
            self.stack_size,
            self.imu.state,
            self.imu.samples
        )
    }
}
