//! `smartdepthsync board info`: who the board is.

use protocol::{BoardSettings, ImuSetup, QueryBoard, QueryImu};
use serde::Serialize;

use crate::context::Context;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};
use crate::rig_profile::{Place, ProfileArg};
use board::BoardInfo;

/// The result.
#[derive(Debug, Serialize)]
struct PrintedInfo {
    #[serde(flatten)]
    board: BoardInfo,
    /// Outputs 2 to 4, and the pulse per second.
    has_outputs: bool,
    now_ticks: u64,
    uptime_s: f64,
    last_panic: Option<String>,
    /// Panics and faults of all runs, and the newest of them: both outlive power-off.
    panics: u32,
    kept_panic: Option<String>,
    settings: BoardSettings,
    round_trip_us: f64,
    /// Messages that the board could not send, and frames that arrived damaged, in this exchange.
    lost_messages: u64,
    damaged_frames: u32,
    imu: ImuSetup,
    /// The rig profile that `record` and `doctor` would use.
    profile: Place,
}

/// Prints who the board is.
///
/// # Errors
///
/// The board cannot be reached.
pub(crate) fn run(port: &PortArg, context: &Context) -> Result<ExitStatus, Failure> {
    let mut board = port.open()?;
    let (_, round_trip) = board.ping()?;
    let imu = board.call(QueryImu)?;
    let settings = board.call(QueryBoard)?;
    let hello = board.hello();
    let link = board.conversation();
    let info = PrintedInfo {
        board: BoardInfo::new(hello),
        has_outputs: hello.board.has_outputs(),
        now_ticks: hello.now.0,
        uptime_s: hello.now.as_secs_f64(),
        last_panic: hello.last_panic.as_ref().map(ToString::to_string),
        panics: hello.panics,
        kept_panic: hello.kept_panic.as_ref().map(ToString::to_string),
        settings,
        round_trip_us: round_trip.as_secs_f64() * 1e6,
        lost_messages: link.counts().lost(),
        damaged_frames: link.damaged_frames(),
        imu,
        profile: ProfileArg::default().place(),
    };
    context.show(&info)?;
    Ok(ExitStatus::of_loss(
        info.lost_messages > 0 || info.damaged_frames > 0,
    ))
}
