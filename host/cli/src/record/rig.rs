//! Everything that is alive in a session: board, phone, files, watch; and the
//! one place through which every message of the board goes ([`Rig::pump`]).
//!
//! Whatever a session waits for, it waits by pumping: messages are recorded and
//! watched, the link is taken up again if it breaks, Ctrl-C is noticed.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use protocol::{Arrived, ImuSetup, Ticks};

use super::live::{Live, Step};
use super::operator::Operator;
use super::phone_task::PhoneTask;
use super::phones::Other;
use super::preflight::{Checks, ImuLook};
use super::recorder::DepthRecorder;
use super::restart::{NextScale, Pending};
use super::runs::{Axis, Pair};
use super::watch::{Finding, Watch};
use super::{Connector, Stop};
use crate::cli::Context;
use crate::outcome::{ExitStatus, Failure};
use board::Event;
use board::imu::Scale;
use board::transport::LinkError;
use board::{self, Board, BoardError};
use recording::profile::Profile;
use recording::session_file::{Problem, SessionFile};
use recording::writer::{Severity, Writer};
use timebase::ClockModel;

/// A link on which nothing at all comes for so long is as good as lost: a status
/// comes every second.
const SILENCE: Duration = Duration::from_secs(10);

/// How often disk and depth recorder are looked at.
const ROUND: Duration = Duration::from_secs(1);

/// Below this much free space a warning is given, bytes. An hour of recording is
/// about 150 MB, and videos go to the phone.
const DISK_LOW: u64 = 1_000_000_000;

/// Below this much free space the session is stopped while it still can be
/// closed well, bytes.
const DISK_FULL: u64 = 20_000_000;

/// A twist is enough when its expected 1-sigma is this part of the gate's: the
/// phase then depends on the profile's constants more than on the twist.
const ENOUGH: f64 = 0.1;

/// The most problems that are kept one by one.
const MAX_PROBLEMS: usize = 1_000;

/// All that is alive in a session.
pub struct Rig<'a> {
    /// Options of the program.
    pub context: &'a Context,
    /// The rig profile.
    pub profile: &'a Profile,
    /// Finds the board again.
    pub connector: &'a mut dyn Connector,
    /// The board.
    pub board: Board,
    /// Its ID in hex.
    pub board_id: String,
    /// The run that the board is in: another one is a reset.
    pub(super) epoch: u32,
    /// Its runs on one axis of time: all times outside of calls to the board are
    /// on it.
    pub(super) axis: Axis,
    /// Both clocks when a new run was met, until it begins on the axis.
    pub(super) met: Option<Pair>,
    /// What is to be done after a reset.
    pub(super) pending: Option<Pending>,
    /// The phone that the trigger is aligned to.
    pub phone: PhoneTask,
    /// Further phones, in the profile's order.
    pub others: Vec<Other>,
    /// The person.
    pub operator: Operator,
    /// What is shown to the person.
    pub live: Live,
    /// The depth recorder, while it runs.
    pub depth: Option<DepthRecorder>,
    /// The MCAP file, until it is finished or has failed.
    pub writer: Option<Writer>,
    /// The recording's folder.
    pub folder: PathBuf,
    /// What is decided.
    pub file: SessionFile,
    /// Latest board time that was handled.
    pub now: Ticks,
    /// The relation of the clocks that is best known.
    pub clock: Option<ClockModel>,
    /// Set while recording.
    pub watch: Option<Watch>,
    /// What was looked at before the board was listened to.
    pub checked: Checks,
    /// The IMU's samples, while it is checked.
    pub look: Option<ImuLook>,
    /// Gyroscope samples, while a twist is taken.
    pub gyro: Option<Vec<(Ticks, [f64; 3])>>,
    /// The last arrival that was reported.
    pub arrived: Option<Arrived>,
    /// The phone may be recording a video.
    pub video_may_run: bool,
    /// The trigger was started by this session.
    pub trigger_started: bool,
    /// The session is being closed: interrupts are no reason to stop any more.
    pub closing: bool,
    pub(super) link_patience: Duration,
    pub(super) scale: Scale,
    pub(super) next_scale: Option<NextScale>,
    problem_seen: bool,
    pub(super) last_sign: Duration,
    last_round: Instant,
    disk_warned: bool,
    pub(super) findings: Vec<Finding>,
}

/// What a new [`Rig`] is made of.
pub struct Parts<'a> {
    /// See [`Rig`].
    pub context: &'a Context,
    /// See [`Rig`].
    pub profile: &'a Profile,
    /// See [`Rig`].
    pub connector: &'a mut dyn Connector,
    /// See [`Rig`].
    pub board: Board,
    /// The IMU's setup.
    pub imu: ImuSetup,
    /// From counts to SI units.
    pub scale: Scale,
    /// How long a lost link is waited for.
    pub link_patience: Duration,
    /// See [`Rig`].
    pub phone: PhoneTask,
    /// See [`Rig`].
    pub operator: Operator,
    /// See [`Rig`].
    pub live: Live,
    /// See [`Rig`].
    pub writer: Writer,
    /// See [`Rig`].
    pub folder: PathBuf,
    /// See [`Rig`].
    pub file: SessionFile,
}

impl<'a> Rig<'a> {
    /// Puts the parts together.
    #[must_use]
    pub fn new(parts: Parts<'a>) -> Self {
        let mut board = parts.board;
        board.keep_frames(true);
        Self {
            context: parts.context,
            profile: parts.profile,
            connector: parts.connector,
            board_id: protocol::usb::serial_number(&board.hello().board_id).to_string(),
            epoch: board.hello().epoch,
            axis: Axis::default(),
            met: None,
            pending: None,
            now: board.hello().now,
            last_sign: board.now(),
            board,
            phone: parts.phone,
            others: Vec::new(),
            operator: parts.operator,
            live: parts.live,
            depth: None,
            writer: Some(parts.writer),
            folder: parts.folder,
            file: parts.file,
            clock: None,
            watch: None,
            checked: Checks::default(),
            look: None,
            gyro: None,
            arrived: None,
            video_may_run: false,
            trigger_started: false,
            closing: false,
            scale: parts.scale,
            link_patience: parts.link_patience,
            next_scale: None,
            problem_seen: false,
            last_round: Instant::now(),
            disk_warned: false,
            findings: Vec::new(),
        }
    }

    /// Takes what the board has sent; waits at most for `wait` if that is nothing.
    ///
    /// # Errors
    ///
    /// The user wants to stop, the link is lost for good, or the disk is full.
    pub fn pump(&mut self, wait: Duration) -> Result<(), Stop> {
        if self.context.interrupt.requested() && !self.closing {
            return Err(Stop::Interrupted);
        }
        self.compare_clocks();
        let mut wait = wait;
        // Bounded, so that prompts stay alive even under full load.
        for _ in 0..2_000 {
            match self.board.next_event(wait) {
                Ok(Some(event)) => {
                    // That an answer does not come is no sign of life.
                    if !matches!(event, Event::Expired { .. }) {
                        self.last_sign = self.board.now();
                    }
                    self.take(event)?;
                }
                Ok(None) => {
                    self.idle()?;
                    break;
                }
                Err(BoardError::Link(error)) => {
                    self.take_up_link(&error)?;
                    break;
                }
                Err(other) => return Err(Failure::from(other).into()),
            }
            wait = Duration::ZERO;
        }
        self.tell_findings()?;
        self.restore()?;
        if let Some(writer) = &mut self.writer {
            writer.tick(self.board.now()).map_err(Failure::from)?;
        }
        self.show();
        if self.last_round.elapsed() >= ROUND {
            self.last_round = Instant::now();
            self.round()?;
        }
        Ok(())
    }

    /// Puts the latest state before the person's eyes; never waits for that.
    fn show(&mut self) {
        let step = if self.closing {
            Step::Closing
        } else if self.gyro.is_some() {
            Step::Twist(self.file.twists.len() + 1)
        } else if let (Some(_), Some(span)) = (&self.watch, self.file.recorded) {
            Step::Recording(span.from)
        } else if self.trigger_started {
            Step::Aligning
        } else {
            Step::Preparing
        };
        let length = f64::from(self.profile.phone.twist_s);
        let enough = self.profile.align.max_offset_sigma_us * ENOUGH;
        self.live.step(step, (length, enough));
        self.live.gauge.reconnects = self.file.reconnects;
        self.live.gauge.know_phones(&self.file.phones);
        self.live.show(
            self.now,
            &self.folder,
            self.clock.as_ref(),
            self.file.alignment.as_ref(),
            self.operator.is_present(),
        );
    }

    /// Pumps until `done` says so.
    ///
    /// # Errors
    ///
    /// As [`Rig::pump`].
    pub fn pump_until<T>(
        &mut self,
        mut done: impl FnMut(&mut Self) -> Option<T>,
    ) -> Result<T, Stop> {
        loop {
            if let Some(result) = done(self) {
                return Ok(result);
            }
            self.pump(Duration::from_millis(20))?;
        }
    }

    /// Calls the board; takes up the link once if it breaks meanwhile.
    ///
    /// # Errors
    ///
    /// The board refuses or does not answer; or as [`Rig::pump`].
    pub fn call<T>(
        &mut self,
        mut call: impl FnMut(&mut Board) -> board::Result<T>,
    ) -> Result<T, Stop> {
        match call(&mut self.board) {
            Err(BoardError::Link(error)) => {
                self.take_up_link(&error)?;
                call(&mut self.board)
            }
            other => other,
        }
        .map_err(|error| Failure::from(error).into())
    }

    /// Says something, and keeps it in the recording.
    ///
    /// # Errors
    ///
    /// The recording cannot be written.
    pub fn tell(&mut self, severity: Severity, kind: &str, text: &str) -> Result<(), Stop> {
        match severity {
            Severity::Info => self.context.say(text),
            Severity::Warning => self.context.say(format!("warning: {text}")),
            Severity::Error => self.context.say(format!("ERROR: {text}")),
        }
        match &mut self.writer {
            Some(writer) => writer
                .log(self.now, severity, kind, text)
                .map_err(|error| Failure::from(error).into()),
            None => Ok(()),
        }
    }

    /// Something went wrong: says it, and keeps it in the session file too. It
    /// makes the outcome "with loss".
    ///
    /// # Errors
    ///
    /// The recording cannot be written.
    pub fn problem(&mut self, finding: Finding) -> Result<(), Stop> {
        self.problem_seen = true;
        self.live.gauge.warning(finding.kind, &finding.text);
        let count = self.file.problems.len();
        if count < MAX_PROBLEMS {
            self.file.problems.push(Problem {
                at: self.now,
                kind: finding.kind.to_owned(),
                text: finding.text.clone(),
            });
        } else if count == MAX_PROBLEMS {
            self.file.problems.push(Problem {
                at: self.now,
                kind: String::from("more"),
                text: String::from("further problems are in /session/log only"),
            });
        }
        self.tell(finding.severity, finding.kind, &finding.text)
    }

    /// Whether anything went wrong so far.
    #[must_use]
    pub const fn has_problems(&self) -> bool {
        self.problem_seen
    }

    /// Writes the session file.
    ///
    /// # Errors
    ///
    /// It cannot be written.
    pub fn save(&mut self) -> Result<(), Stop> {
        self.file
            .save(&self.folder)
            .map_err(|error| Failure::from(error).into())
    }

    /// A new relation of the clocks.
    ///
    /// # Errors
    ///
    /// The recording cannot be written.
    pub fn set_clock(&mut self, clock: ClockModel, source: &str) -> Result<(), Stop> {
        self.clock = Some(clock);
        self.file.clock = Some(clock);
        match &mut self.writer {
            Some(writer) => writer
                .clock_model(self.now, &clock, source)
                .map_err(|error| Failure::from(error).into()),
            None => Ok(()),
        }
    }

    /// All that had come is taken.
    fn idle(&mut self) -> Result<(), Stop> {
        if let Some(watch) = &mut self.watch {
            watch.time(self.now, &mut self.findings);
        }
        if self.board.now().saturating_sub(self.last_sign) > SILENCE {
            let error = LinkError::Gone {
                reason: String::from("nothing came for 10 s"),
            };
            self.take_up_link(&error)?;
        }
        Ok(())
    }

    fn tell_findings(&mut self) -> Result<(), Stop> {
        for finding in std::mem::take(&mut self.findings) {
            if finding.severity == Severity::Info {
                self.tell(finding.severity, finding.kind, &finding.text)?;
            } else {
                self.problem(finding)?;
            }
        }
        Ok(())
    }

    /// Once a second: depth recorder and disk.
    fn round(&mut self) -> Result<(), Stop> {
        if let Some(text) = self.depth.as_mut().and_then(DepthRecorder::gone) {
            self.problem(Finding::error("depth_recorder_gone", text))?;
        }
        let Some(free) = free_space(&self.folder) else {
            return Ok(());
        };
        if free < DISK_FULL && !self.closing {
            return Err(Failure::new(
                ExitStatus::Storage,
                format!("the disk is full: {} MB are left", free / 1_000_000),
            )
            .next_step("free some space; what was recorded is kept")
            .into());
        }
        if free < DISK_LOW && !self.disk_warned {
            self.disk_warned = true;
            let text = format!("the disk is nearly full: {} MB are left", free / 1_000_000);
            self.tell(Severity::Warning, "disk_nearly_full", &text)?;
        }
        Ok(())
    }
}

/// Free space for this user on the disk of a folder, bytes; `None` where it
/// cannot be told.
#[must_use]
pub fn free_space(folder: &std::path::Path) -> Option<u64> {
    #[cfg(unix)]
    {
        let stat = rustix::fs::statvfs(folder).ok()?;
        Some(stat.f_bavail.saturating_mul(stat.f_frsize))
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        None
    }
}
