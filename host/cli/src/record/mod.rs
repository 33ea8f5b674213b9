//! A session, from the twist to an aligned recording.
//!
//! Steps, each of which can be repeated or left: connect, with the checks of
//! [`preflight`] ([`connect`]), twist, start the trigger, start the phone's video,
//! align, confirm the arrival, record ([`steps`]), stop, second twist, fetch the video,
//! summary ([`close`](mod@close)). From the connect on, all that the board sends is recorded
//! ([`rig`]), so the twist is in the file too.
//!
//! However a session ends (well, by Ctrl-C, by an error in any step), it is
//! closed in the same way: the phone's video is stopped, the depth recorder is
//! asked to stop, the trigger is stopped, the files are finished.
//!
//! - [`track`]: the phone's clock, followed while it records.
//! - [`link`], `resume`: the link to the board, and going on after it was lost or the
//!   board was reset.
//! - [`observers`]: who looks at its messages, such as the [watch](session::watch).
//! - [`journal`]: what is kept and told; [`live`]: what is shown; [`operator`]: the person.
//! - [`phones`], `video_watch`, `depth_recorder`: phones, their videos, depth recorder.
//! - `preflight`: what is looked at before.

pub mod close;
mod connect;
mod depth_recorder;
mod further;
pub mod journal;
pub mod link;
pub mod live;
pub mod observers;
pub mod operator;
pub mod phones;
pub(crate) mod preflight;
mod resume;
pub mod rig;
mod rounds;
mod steps;
pub mod track;
mod twist;
mod video_watch;

use std::path::PathBuf;
use std::time::Duration;

use protocol::TICK_HZ;

use crate::context::Context;
use crate::decimal::{parse_duration, parse_real_time};
use crate::outcome::{ExitStatus, Failure};
use crate::recordings;
use crate::rig_profile::Place;
use board::BoardError;
use board::transport::serial::SerialLink;
use board::transport::{Link, ports};
use recording::folder::check_name;
use recording::profile::Profile;
use recording::session_file::SessionFile;

/// What a session is asked to do. Times are ticks of board time.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Folder in which the recording's folder is made
    #[arg(long, value_name = "FOLDER", default_value = recordings::FOLDER)]
    pub out: PathBuf,
    /// Name of the recording's folder [default: date and time]
    #[arg(long, value_parser = check_name)]
    pub name: Option<String>,
    /// How long to record, in board time: 90s, 5m, 1h; until stopped if not given
    #[arg(long, value_parser = parse_duration)]
    pub duration: Option<u64>,
    /// Where the profile is from.
    #[arg(skip)]
    pub profile: Place,
    /// Never prompt; stop at the first failure
    #[arg(long)]
    pub yes: bool,
    /// How long to wait for a lost USB link to come back, in real time
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = parse_real_time)]
    pub link_patience: Duration,
    /// Plain lines instead of the live view
    #[arg(long)]
    pub plain: bool,
    /// Set a mark this long after the start; may be given more than once
    #[arg(long = "marker", value_name = "AFTER", value_parser = parse_duration)]
    pub markers: Vec<u64>,
    /// Whether the phone's clock is to be followed.
    #[arg(skip)]
    pub track: track::Track,
    /// Twists before the recording: two know the rate of the clocks today, three and more
    /// how it changes while the rig warms up
    #[arg(long, value_name = "NUMBER", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=5))]
    pub twists: u32,
    /// Between two of these twists, in board time
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = parse_duration)]
    pub twist_gap: u64,
    /// Twist again at the end: a far better skew, and `profile learn` needs it
    #[arg(long)]
    pub second_twist: bool,
    /// Download the phone's video at the end
    #[arg(long)]
    pub fetch_video: bool,
}

/// Opens links to the board, the first time and after a loss.
pub trait Connector {
    /// A link to the board; to the one with this ID, if it is given.
    ///
    /// # Errors
    ///
    /// It cannot be opened (now).
    fn connect(&mut self, board_id: Option<&str>) -> board::Result<Box<dyn Link>>;
}

/// The board on a serial port, found again under whatever name it comes back.
#[derive(Clone, Debug)]
pub(crate) struct SerialConnector {
    /// As the user gave it.
    pub(crate) port: Option<String>,
}

impl Connector for SerialConnector {
    fn connect(&mut self, board_id: Option<&str>) -> board::Result<Box<dyn Link>> {
        // A board that was unplugged may come back under another name.
        let renamed = board_id.and_then(|id| {
            ports::list().ok()?.into_iter().find_map(|port| {
                let serial = port.usb.as_ref()?.serial_number.as_deref()?;
                (port.board && serial == id).then_some(port.path)
            })
        });
        let path = match renamed {
            Some(path) => path,
            None => board::choose_port(self.port.as_deref())?,
        };
        Ok(Box::new(SerialLink::open(&path).map_err(BoardError::from)?))
    }
}

/// Why a step does not go on.
#[derive(Debug)]
pub enum Stop {
    /// The user wants it.
    Interrupted,
    /// Something failed.
    Failed(Failure),
}

impl<E: Into<Failure>> From<E> for Stop {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

/// A session that has ended, with whatever it left.
#[derive(Debug)]
pub(crate) struct Ended {
    /// How it ended.
    pub(crate) result: Result<ExitStatus, Failure>,
    /// The recording's folder.
    pub(crate) folder: PathBuf,
    /// What was decided.
    pub(crate) file: SessionFile,
}

/// Runs a session.
///
/// # Errors
///
/// It failed before there was a folder: board or phone cannot be reached, or no
/// folder can be made. Later failures are in [`Ended::result`].
pub(crate) fn run(
    options: &Options,
    profile: &Profile,
    context: &Context,
    connector: &mut dyn Connector,
) -> Result<Ended, Failure> {
    let (mut rig, checked) = match connect::connect(options, profile, context, connector) {
        Ok(connected) => connected,
        Err(Stop::Interrupted) => {
            return Err(Failure::new(
                ExitStatus::Interrupted,
                "stopped before anything was recorded",
            )
            .next_step("start it again when you are ready"));
        }
        Err(Stop::Failed(failure)) => return Err(failure),
    };
    let result = steps::session(&mut rig, options, checked);
    let result = close::close(&mut rig, options, result);
    let journal = &mut rig.journal;
    let ended = journal.outcome_of(&result);
    let outcome = match result {
        Err(Stop::Failed(failure)) => Err(failure),
        Err(Stop::Interrupted) => Ok(ExitStatus::Interrupted),
        Ok(()) => Ok(ExitStatus::of_loss(journal.has_problems())),
    };
    journal.file.outcome = Some(ended);
    let saved = journal.file.save(&journal.folder);
    let folder = journal.folder.clone();
    let file = journal.file.clone();
    drop(rig);
    let result = outcome.and_then(|outcome| Ok(saved.map(|()| outcome)?));
    Ok(Ended {
        result,
        folder,
        file,
    })
}

/// Seconds of board time as ticks.
pub(crate) const fn seconds(seconds: u64) -> u64 {
    seconds.saturating_mul(TICK_HZ as u64)
}
