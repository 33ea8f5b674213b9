//! The whole rig as it stands on a table, running in a thread of its own: the
//! board with its firmware behind a pseudo-terminal, its IMU and the depth
//! camera, and the phone behind a TCP port, on one true time and one motion.
//!
//! True time passes as fast as the machine can, at most [`Pace::speed`] times
//! real time, and pauses while the program that has the port open does
//! not take what the board sends: how fast a machine is has no part in what a
//! program at the other end sees of the board. It does have a part in *when*
//! that program's commands arrive, so two runs of one seed are alike but not
//! equal to the byte; a rig that is driven step by step ([`Sim`]) is.
//!
//! # Use
//!
//! ```no_run
//! use rig::motion::MotionSpec;
//! use rig::motion::gesture::Gesture;
//! use rig::phone::PhoneConfig;
//! use rig::random::Seed;
//! use rig::whole_rig::config::RigConfig;
//! use rig::whole_rig::running_rig::{Pace, RunningRig};
//! use rig::wiring;
//!
//! # fn main() -> anyhow::Result<()> {
//! let seed = Seed(1);
//! let config = RigConfig::published(seed).with_motion(MotionSpec::always(Gesture::Twist));
//! let phone = PhoneConfig::draw(seed);
//! let pace = Pace { speed: Some(15.0), wait_for_host: true };
//! // Board, IMU, depth camera and phone, wired together and running.
//! let rig = RunningRig::start(config, wiring::board(), Some((phone, 0)), pace)?;
//! // What a rig's owner knows, and where its port is: enough for a session.
//! std::fs::write("rig.toml", rig.profile()?)?;
//! println!("smartdepthsync record --port {} --profile rig.toml", rig.port().display());
//! // … run the session …
//! let truth = rig.stop()?;
//! println!("{} depth frames", truth.depth.len());
//! # Ok(())
//! # }
//! ```

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};

use crate::clocks::true_clock::{BoardClockwork, TrueClock};
use crate::motion::gesture::Gesture;
use crate::phone::{PhoneConfig, SimPhone};
use crate::random::Stream;
use crate::whole_rig::config::{RigConfig, RigParts};
use crate::whole_rig::ground_truth::Noted;
pub use crate::whole_rig::ground_truth::RunTruth;
use crate::whole_rig::owner_profile::owner_profile;
use crate::whole_rig::pty::Pty;
use stm32f4_sim::shared::lock;
use stm32f4_sim::sim::{Sim, SimBuilder};
use stm32f4_sim::time::{SimDuration, SimTime};
use stm32f4_sim::usb::UsbState;

/// Board time between two looks at the pseudo-terminal at the speed of real time. A faster
/// rig looks as often by the computer's clock: a look costs what it costs.
const STEP: SimDuration = SimDuration::from_millis(1);

/// The most [`STEP`]s between two looks: USB and its drivers delay what passes as long.
const MOST_STEPS: f64 = 10.0;

/// Bytes that wait for the program at the other end before the host's driver
/// stops asking the board for more, as an operating system does.
const BUFFER: usize = 64 * 1024;

/// Board time from power-on within which the serial port must be there.
pub(crate) const BOOT_LIMIT: SimDuration = SimDuration::from_secs(5);

/// Wall time for which the board pauses while the program reads slowly,
/// or has not yet opened the port.
pub(crate) const PATIENCE: Duration = Duration::from_micros(200);

/// Longest stretch of true time that is made up for after the computer stood still, because a
/// real board would have gone on meanwhile. After a longer one the rig would race.
const CATCH_UP: Duration = Duration::from_millis(500);

/// Speed of true time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Multiple of real time, at most; as fast as the machine can if not given.
    pub speed: Option<f64>,
    /// Once booted, the board pauses until a program opens its port.
    pub wait_for_host: bool,
}

/// Time from a request for a motion to its begin, s: sensors look ahead by less.
const MOMENT_S: f64 = 1.0;

/// A request to the running board.
enum Order {
    Unplug,
    Plug,
    Stop,
}

/// State that the thread of the board shares.
#[derive(Debug, Default)]
struct Shared {
    now: AtomicU64,
    plugged: AtomicBool,
    noted: Mutex<Noted>,
}

/// A running rig. It is switched off when dropped.
pub struct RunningRig {
    parts: RigParts,
    clock: TrueClock,
    /// Dropped before the board's thread is joined, which waits for true time.
    phone: Option<SimPhone>,
    port: PathBuf,
    orders: Sender<Order>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<Result<()>>>,
    _folder: tempfile::TempDir,
}

impl RunningRig {
    /// Builds a rig and lets it run. `board` may have an ELF, a sink for the log
    /// and more; the parts are wired to it here. The phone listens on
    /// `phone_port` of the loopback interface; 0 takes a free one.
    ///
    /// # Errors
    ///
    /// A part cannot be built, or the system has no pseudo-terminal or port left.
    pub fn start(
        config: RigConfig,
        board: SimBuilder,
        phone: Option<(PhoneConfig, u16)>,
        pace: Pace,
    ) -> Result<Self> {
        let parts = config.build();
        let surroundings = parts.surroundings();
        let clock = surroundings.clock.clone();
        let phone = phone.map(|(config, port)| SimPhone::start(config, surroundings, port));
        let phone = phone.transpose()?;
        let folder = tempfile::Builder::new()
            .prefix("simulated-rig-")
            .tempdir()
            .context("no folder for the rig's port")?;
        let port = folder.path().join("board");
        let rig = parts
            .wire(board)
            .model(BoardClockwork::new(parts.board.clone(), clock.clone()));
        let (orders, inbox) = channel();
        let shared = Arc::new(Shared::default());
        let runner = Runner {
            link: port.clone(),
            parts: parts.clone(),
            shared: Arc::clone(&shared),
            pace,
            inbox,
        };
        let (ready, started) = channel();
        let thread = std::thread::spawn(move || {
            // A rig cannot be sent between threads, so it is built where it runs.
            match runner.boot(rig) {
                Ok((rig, port)) => {
                    let _ = ready.send(Ok(()));
                    runner.run(rig, port)
                }
                Err(error) => {
                    let _ = ready.send(Err(error));
                    Ok(())
                }
            }
        });
        let begun = started
            .recv()
            .unwrap_or_else(|_| Err(anyhow!("the board's thread ended at once")));
        let rig = Self {
            parts,
            clock,
            phone,
            port,
            orders,
            shared,
            thread: Some(thread),
            _folder: folder,
        };
        begun?;
        Ok(rig)
    }

    /// The board's serial port: a link that leads to the pseudo-terminal and is
    /// gone while the board is unplugged.
    #[must_use]
    pub fn port(&self) -> &Path {
        &self.port
    }

    /// The phone.
    #[must_use]
    pub fn phone(&self) -> Option<&SimPhone> {
        self.phone.as_ref()
    }

    /// The profile that this rig's owner would have, for
    /// `smartdepthsync record --profile`.
    ///
    /// # Errors
    ///
    /// The rig has no phone or no depth camera.
    pub fn profile(&self) -> Result<String> {
        let phones = self.phone.iter();
        let phones = phones.map(|phone| (phone.address().to_string(), &phone.app.config));
        owner_profile(&self.parts.config, phones, &[])
    }

    /// Returns the parts and their clocks.
    #[must_use]
    pub fn parts(&self) -> &RigParts {
        &self.parts
    }

    /// Returns the present board time.
    #[must_use]
    pub fn now(&self) -> SimTime {
        SimTime::from_units(self.shared.now.load(Ordering::Relaxed))
    }

    /// Discards the ground truth so far, in a long run that does not need it.
    pub(crate) fn forget(&self) {
        lock(&self.shared.noted).forget();
    }

    /// The board's tick count and the phone's boot clock, ns, at one instant by the ground
    /// truth; `None` without a phone, or where the count is not known.
    pub(crate) fn clocks_now(&self) -> Option<(u64, i64)> {
        let now = self.now();
        let ticks = lock(&self.shared.noted).ticks(now)?;
        let phone = &self.phone.as_ref()?.app.oscillator;
        Some((ticks, phone.nanos_at(self.parts.board.true_at(now))))
    }

    /// Returns true while the board runs: a firmware that fails ends it.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|t| !t.is_finished())
    }

    /// Pulls the board's USB plug, and waits until the port is gone.
    pub fn unplug(&self) {
        if self.orders.send(Order::Unplug).is_ok() {
            while self.is_running() && self.shared.plugged.load(Ordering::SeqCst) {
                std::thread::sleep(PATIENCE);
            }
        }
    }

    /// Puts the board's USB plug back.
    pub fn plug(&self) {
        // The rig has ended if this fails.
        let _ = self.orders.send(Order::Plug);
    }

    /// Moves the rig besides what moves it already, from in a moment on.
    pub fn perform(&self, gesture: Gesture, seconds: f64) {
        let now = self.parts.board.true_at(self.now()).as_secs_f64();
        let mut random = self.parts.config.seed.stream(Stream::Motion);
        // What sensors have looked at stays as it was.
        let from = now + MOMENT_S;
        self.parts.motion.add(gesture, from, seconds, &mut random);
    }

    /// Switches the rig off and returns the ground truth.
    ///
    /// # Errors
    ///
    /// The firmware has failed, or the phone could not save a file.
    pub fn stop(mut self) -> Result<RunTruth> {
        let ended = self.end();
        let mut phones = Vec::new();
        if let Some(phone) = &self.phone {
            phone
                .app
                .wait_saved()
                .map_err(|e| anyhow!("the simulated phone: {e}"))?;
            phones.push((phone.app.oscillator.clone(), phone.app.videos()));
        }
        ended?;
        let noted = std::mem::take(&mut *lock(&self.shared.noted));
        Ok(noted.into_truth(self.parts.clone(), phones, self.now()))
    }

    /// Ends the board's thread and true time.
    fn end(&mut self) -> Result<()> {
        let _ = self.orders.send(Order::Stop);
        self.clock.stop();
        match self.thread.take().map(JoinHandle::join) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(_)) => bail!("the board's thread has panicked"),
        }
    }
}

impl Drop for RunningRig {
    fn drop(&mut self) {
        // Its result was returned by `stop`, or nobody needs it.
        let _ = self.end();
    }
}

/// The thread of the board.
struct Runner {
    link: PathBuf,
    parts: RigParts,
    shared: Arc<Shared>,
    pace: Pace,
    inbox: Receiver<Order>,
}

/// Limits the speed of true time.
pub(crate) struct Pacer {
    speed: Option<f64>,
    began: SimTime,
    begun: Instant,
}

impl Pacer {
    /// Sets the pace from `now` on.
    pub(crate) fn new(speed: Option<f64>, now: SimTime) -> Self {
        Self {
            speed: speed.map(|speed| speed.max(1e-3)),
            began: now,
            begun: Instant::now(),
        }
    }

    /// Returns the board time between two looks at the pseudo-terminal.
    pub(crate) fn step(&self) -> SimDuration {
        let steps = self.speed.unwrap_or(MOST_STEPS).clamp(1.0, MOST_STEPS);
        SimDuration::from_nanos((STEP.as_nanos() as f64 * steps) as u64)
    }

    /// Waits until `now` is due.
    pub(crate) fn wait(&mut self, now: SimTime) {
        let Some(speed) = self.speed else { return };
        let due = Duration::from_nanos(now.as_nanos() - self.began.as_nanos()).div_f64(speed);
        let passed = self.begun.elapsed();
        if passed > due + CATCH_UP.div_f64(speed) {
            // The machine is slower, or stood still: lost time is not made up for.
            *self = Self::new(self.speed, now);
        } else if let Some(ahead) = due.checked_sub(passed)
            && ahead > Duration::from_millis(1)
        {
            // A call takes as long as a shorter wait.
            std::thread::sleep(ahead);
        }
    }
}

/// The board's port as the host sees it.
pub(crate) struct Port {
    pub(crate) pty: Pty,
    open: bool,
    /// Bytes from the board that the program has not read yet.
    waiting: Vec<u8>,
}

impl Runner {
    /// A pseudo-terminal under the rig's name for it.
    fn new_port(&self, rig: &mut Sim) -> Result<Port> {
        let port = Port::new(rig)?;
        let _ = std::fs::remove_file(&self.link);
        std::os::unix::fs::symlink(port.pty.path(), &self.link)
            .with_context(|| format!("cannot make {}", self.link.display()))?;
        self.shared.plugged.store(true, Ordering::SeqCst);
        Ok(port)
    }

    /// Powers the board on and runs it until its serial port is there, as before a session.
    fn boot(&self, board: SimBuilder) -> Result<(Sim, Option<Port>)> {
        let mut rig = board.build()?;
        let port = if rig.usb_state() == UsbState::Unplugged {
            None
        } else if rig.run_until_usb_ready(BOOT_LIMIT)? {
            Some(self.new_port(&mut rig)?)
        } else {
            bail!(
                "the board's serial port is not there {} s after power-on ({:?})",
                BOOT_LIMIT.as_secs_f64(),
                rig.usb_state()
            );
        };
        self.note(&rig);
        Ok((rig, port))
    }

    /// The board's serial port is there while the host has the device enumerated.
    fn follow_usb(&self, rig: &mut Sim, port: &mut Option<Port>) -> Result<()> {
        let ready = rig.usb_state() == UsbState::Ready;
        if ready && port.is_none() {
            *port = Some(self.new_port(rig)?);
        } else if !ready && port.is_some() {
            // The name is removed first, so that no program opens a port that is about to end.
            let _ = std::fs::remove_file(&self.link);
            drop(port.take());
            self.shared.plugged.store(false, Ordering::SeqCst);
        }
        Ok(())
    }

    fn run(self, mut rig: Sim, mut port: Option<Port>) -> Result<()> {
        while let Some(waited_for) = port.as_ref()
            && self.pace.wait_for_host
            && !waited_for.pty.is_open()?
        {
            if matches!(
                self.inbox.try_recv(),
                Ok(Order::Stop) | Err(TryRecvError::Disconnected)
            ) {
                return Ok(());
            }
            std::thread::sleep(PATIENCE);
        }
        let mut pacer = Pacer::new(self.pace.speed, rig.now());
        loop {
            match self.inbox.try_recv() {
                Ok(Order::Stop) | Err(TryRecvError::Disconnected) => return Ok(()),
                Ok(Order::Unplug) => rig.usb_unplug(),
                Ok(Order::Plug) => rig.usb_plug(),
                Err(TryRecvError::Empty) => {}
            }
            self.follow_usb(&mut rig, &mut port)?;
            if let Some(port) = &mut port
                && !port.move_bytes(&mut rig)?
            {
                std::thread::sleep(PATIENCE);
                continue;
            }
            pacer.wait(rig.now());
            rig.run_for(pacer.step())?;
            self.note(&rig);
        }
    }

    /// Collects the records of the models, so that these stay small.
    fn note(&self, rig: &Sim) {
        self.shared.now.store(rig.now().units(), Ordering::Relaxed);
        lock(&self.shared.noted).take(rig, &self.parts);
    }
}

impl Port {
    /// A new one, that no program has opened.
    pub(crate) fn new(rig: &mut Sim) -> Result<Self> {
        rig.usb_set_buffer_limit(BUFFER);
        rig.usb_open(false);
        Ok(Self {
            pty: Pty::new().context("cannot make a pseudo-terminal")?,
            open: false,
            waiting: Vec::new(),
        })
    }

    /// Moves bytes in both directions; returns false if the program does not read its own.
    pub(crate) fn move_bytes(&mut self, rig: &mut Sim) -> Result<bool> {
        let open = self.pty.is_open()?;
        if open != self.open {
            self.open = open;
            self.waiting.clear();
            rig.usb_open(open);
        }
        let mut buffer = [0; 4096];
        // A serial port's driver takes a few kilobytes ahead of the device.
        if rig.usb_unsent() < buffer.len() {
            let count = self.pty.read(&mut buffer)?;
            rig.usb_write(buffer.get(..count).unwrap_or_default());
        }
        if self.waiting.is_empty() {
            self.waiting = rig.usb_read();
        }
        if !self.open {
            self.waiting.clear();
        }
        if !self.waiting.is_empty() {
            let count = self.pty.write(&self.waiting)?;
            self.waiting.drain(..count);
        }
        Ok(self.waiting.is_empty())
    }
}
