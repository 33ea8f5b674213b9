//! Sessions in one thread, on virtual time: [`session::run`] on a [`VirtualRig`], which the
//! part that waits steps. There is no wall clock, thread, pseudo-terminal or socket in
//! it, so a seed gives the same recording to the byte on any machine.
//!
//! A [`SessionBench`] is a rig with a folder for its recordings. What happens to the rig or what
//! the person does is given before the session as a [cue](SessionBench::on): an event of the
//! session, and what is done after it.

mod clock;
mod link;
mod phone;
mod recorder;

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use ::session::checks::Checks;
use ::session::devices::{Choice, DepthRecorder, NoRecorder, Operator, Phone, Wish};
use ::session::error::SessionError;
use ::session::event::{Phase, SessionEvent, Stamped};
use ::session::options::Options;
use ::session::run::{Devices, Ended, run};
use anyhow::{Context, Result, anyhow, ensure};
use protocol::HostToDevice;
use recording::profile::Profile;
use recording::session_file::SessionOutcome;
use rig::clocks::link_delay::LinkRanges;
use rig::depth_camera::FrameRecord;
use rig::phone::PhoneConfig;
use rig::whole_rig::config::RigConfig;
use rig::whole_rig::running_rig::RunTruth;
use rig::whole_rig::virtual_rig::VirtualRig;
use stm32f4_sim::sim::SimBuilder;
use stm32f4_sim::time::{SimDuration, SimTime};

use clock::ClockReader;
use phone::VirtualPhone;
pub use recorder::RecorderFate;
use recorder::VirtualRecorder;
pub(crate) use recorder::{naming_pixel, write_frames};

/// The longest that a board may take from power-on to its serial port.
const BOOT: Duration = Duration::from_secs(5);

/// The computer's time of day when the board was powered on, s since 1970.
pub const POWER_ON_S: i64 = 1_800_000_000;

/// A rig in the hands of all its devices.
#[derive(Clone)]
pub struct SharedRig {
    rig: Rc<RefCell<VirtualRig>>,
    /// Virtual time as the computer's clock counts it, for parts without a rig, ns.
    now_ns: Arc<AtomicI64>,
    hands: Rc<Hands>,
    /// Commands of the host.
    commands: Rc<RefCell<Vec<HostToDevice>>>,
}

impl SharedRig {
    /// Lets a rig boot until its board's serial port is there.
    ///
    /// # Errors
    ///
    /// The port does not come.
    pub fn boot(mut rig: VirtualRig) -> Result<Self> {
        let booted = rig.pass_until(BOOT, |rig| rig.is_plugged());
        ensure!(booted, "the board's serial port does not come");
        Ok(Self {
            rig: Rc::new(RefCell::new(rig)),
            now_ns: Arc::default(),
            hands: Rc::default(),
            commands: Rc::default(),
        })
    }

    /// Does something with the rig.
    pub fn with<T>(&self, work: impl FnOnce(&mut VirtualRig) -> T) -> T {
        let mut rig = self.rig.borrow_mut();
        let done = work(&mut rig);
        let now = i64::try_from(rig.now().as_nanos()).unwrap_or(i64::MAX);
        self.now_ns.store(now, Ordering::Relaxed);
        done
    }

    fn now(&self) -> Duration {
        Duration::from_nanos(self.rig.borrow().now().as_nanos())
    }
}

/// The person at the rig, and at the computer's clock.
#[derive(Debug, Default)]
pub struct Hands {
    is_present: Cell<bool>,
    interrupted: Cell<bool>,
    answers: RefCell<VecDeque<Choice>>,
    wishes: RefCell<VecDeque<Wish>>,
    clock_step_s: Arc<AtomicI64>,
}

impl Hands {
    /// Presses Ctrl-C.
    pub fn interrupt(&self) {
        self.interrupted.set(true);
    }

    /// Answers a prompt.
    pub fn answer(&self, choice: Choice) {
        self.answers.borrow_mut().push_back(choice);
    }

    /// Presses a key while it records.
    pub fn wish(&self, wish: Wish) {
        self.wishes.borrow_mut().push_back(wish);
    }

    /// Sets the computer's clock, so that the rig was powered on at the present time of day.
    pub fn set_clock_to_now(&self) {
        let now = jiff::Timestamp::now().as_second();
        self.set_clock_by(now - POWER_ON_S);
    }

    /// Moves the computer's time of day by a number of seconds.
    pub fn set_clock_by(&self, seconds: i64) {
        self.clock_step_s.store(seconds, Ordering::Relaxed);
    }
}

/// The hands as a session sees them.
struct Person(Rc<Hands>);

impl Operator for Person {
    fn is_present(&self) -> bool {
        self.0.is_present.get()
    }

    fn forget_typed(&mut self) {
        self.0.answers.borrow_mut().clear();
        self.0.wishes.borrow_mut().clear();
    }

    fn answer(&mut self) -> Option<Choice> {
        self.0.answers.borrow_mut().pop_front()
    }

    fn wish(&mut self) -> Option<Wish> {
        self.0.wishes.borrow_mut().pop_front()
    }

    fn interrupted(&self) -> bool {
        self.0.interrupted.get()
    }

    fn heed_interrupt(&mut self) -> bool {
        self.0.interrupted.take()
    }
}

/// Something that is done to the rig at an event of a session.
struct Cue {
    when: Box<dyn FnMut(&SessionEvent) -> bool>,
    after: SimDuration,
    what: Box<dyn FnOnce(&mut VirtualRig)>,
}

/// An event, and the virtual time at which the session gave it.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Virtual time.
    pub at: SimTime,
    /// The event, with its board time.
    pub stamped: Stamped,
}

/// A session that is over.
#[derive(Debug)]
pub struct Run {
    /// Result of the session.
    pub ended: Result<Option<Ended>, SessionError>,
    /// Its events, without the board's messages unless they were asked for.
    pub events: Vec<Seen>,
    /// Frames that the depth recorder has written.
    pub frames: Vec<FrameRecord>,
}

impl Run {
    /// The session, if it came to have a folder.
    ///
    /// # Errors
    ///
    /// It did not.
    pub fn ended(self) -> Result<Ended> {
        match self.ended {
            Ok(ended) => ended.context("it was interrupted before anything was recorded"),
            Err(error) => Err(anyhow!("the session failed: {error}")),
        }
    }

    /// The session, if it ended well.
    ///
    /// # Errors
    ///
    /// It failed, was interrupted, or finished with loss.
    pub fn good(self) -> Result<Ended> {
        let ended = self.ended()?;
        let problems = &ended.file.problems;
        match &ended.result {
            Ok(SessionOutcome::Good) => Ok(ended),
            Ok(outcome) => Err(anyhow!("the session ended with {outcome:?}: {problems:?}")),
            Err(error) => Err(anyhow!("the session failed: {error}; {problems:?}")),
        }
    }

    /// When the session first gave an event for which `is_it`.
    pub fn time_of(&self, is_it: impl Fn(&SessionEvent) -> bool) -> Option<SimTime> {
        let found = self.events.iter().find(|seen| is_it(&seen.stamped.event));
        found.map(|seen| seen.at)
    }
}

/// A rig with a folder for recordings.
pub struct SessionBench {
    rig: SharedRig,
    cues: Vec<Cue>,
    /// The owner's profile.
    pub profile: Profile,
    /// The folder of recordings.
    pub out: PathBuf,
    /// True if a recorder of the depth camera is there.
    pub has_recorder: bool,
    /// True if the depth pictures show the [`ball`](rig::picture::ball); they name their frame otherwise.
    pub shows_ball: bool,
    fate: Rc<RecorderFate>,
    /// Link over which the phone's clock is read, if it can be.
    pub phone_link: Option<LinkRanges>,
    /// True if a cable reaches the phones' files too.
    pub copies_files: bool,
    /// True if the board's messages are kept among the events of a run.
    pub keeps_messages: bool,
}

impl SessionBench {
    /// Builds a rig and powers it on; its phones have names if there are several. `board`
    /// may have further models wired to it.
    ///
    /// # Errors
    ///
    /// A part cannot be built, or the board's serial port does not come.
    pub fn new(
        config: RigConfig,
        board: SimBuilder,
        phones: Vec<PhoneConfig>,
        names: &[&str],
        out: &Path,
    ) -> Result<Self> {
        let rig = SharedRig::boot(VirtualRig::new(config, board, phones)?)?;
        let profile = Profile::parse(&rig.with(|rig| rig.profile(names))?, None)?;
        Ok(Self {
            rig,
            cues: Vec::new(),
            profile,
            out: out.to_owned(),
            has_recorder: false,
            shows_ball: false,
            fate: Rc::default(),
            phone_link: None,
            copies_files: false,
            keeps_messages: false,
        })
    }

    /// Makes twists short and the way to the grid fast, where they are not looked at.
    pub fn hurry(&mut self) {
        self.profile.phone.twist_s = 6;
        self.profile.align.slew_us = 1_000.0;
    }

    /// Writes the profile into `rig.toml` in the folder of the recordings, for programs.
    ///
    /// # Errors
    ///
    /// It cannot be written.
    pub fn write_profile(&self) -> Result<PathBuf> {
        let path = self.out.join("rig.toml");
        std::fs::write(&path, self.profile.to_toml()?)
            .with_context(|| format!("cannot write {}", path.display()))?;
        Ok(path)
    }

    /// Somebody is there to be asked.
    pub fn seat_person(&self) {
        self.rig.hands.is_present.set(true);
    }

    /// The person, for cues.
    #[must_use]
    pub fn hands(&self) -> Rc<Hands> {
        Rc::clone(&self.rig.hands)
    }

    /// Fate of the depth recorder, for cues.
    #[must_use]
    pub fn recorder(&self) -> Rc<RecorderFate> {
        Rc::clone(&self.fate)
    }

    /// The commands that were sent to the board, in order.
    #[must_use]
    pub fn commands(&self) -> Vec<HostToDevice> {
        self.rig.commands.borrow().clone()
    }

    /// Does something with the rig between two sessions.
    pub fn with<T>(&self, work: impl FnOnce(&mut VirtualRig) -> T) -> T {
        self.rig.with(work)
    }

    /// Lets something happen a while after the next event of the session for which `when`.
    pub fn on(
        &mut self,
        when: impl FnMut(&SessionEvent) -> bool + 'static,
        after: SimDuration,
        what: impl FnOnce(&mut VirtualRig) + 'static,
    ) {
        self.cues.push(Cue {
            when: Box::new(when),
            after,
            what: Box::new(what),
        });
    }

    /// The same when a phase begins.
    pub fn in_phase(
        &mut self,
        phase: impl Fn(&Phase) -> bool + 'static,
        after: SimDuration,
        what: impl FnOnce(&mut VirtualRig) + 'static,
    ) {
        let when = move |event: &SessionEvent| match event {
            SessionEvent::Phase { phase: begun } => phase(begun),
            _ => false,
        };
        self.on(when, after, what);
    }

    /// The wishes for a session of this name, to be changed.
    #[must_use]
    pub fn options(&self, name: &str) -> Options {
        Options {
            name: Some(name.to_owned()),
            first_command: Some(1),
            ..Options::into_folder(self.out.clone())
        }
    }

    /// Runs a session to its end. Cues that did not come are forgotten.
    pub fn run(&mut self, options: &Options) -> Run {
        self.rig.hands.interrupted.set(false);
        let mut cues = std::mem::take(&mut self.cues);
        let mut seen = Vec::new();
        let (rig, keeps_messages) = (self.rig.clone(), self.keeps_messages);
        let mut events = |stamped: &Stamped| {
            let now = rig.with(|rig| rig.now());
            let is_frequent = matches!(
                stamped.event,
                SessionEvent::Board { .. } | SessionEvent::Downloading { .. }
            );
            if keeps_messages || !is_frequent {
                seen.push(Seen {
                    at: now,
                    stamped: stamped.clone(),
                });
            }
            for place in (0..cues.len()).rev() {
                if (cues[place].when)(&stamped.event) {
                    let Cue { after, what, .. } = cues.remove(place);
                    rig.with(|rig| rig.at(now + after, what));
                }
            }
        };
        let places = 0..self.rig.with(|rig| rig.phones.len());
        let phones = places.map(|place| {
            let phone = VirtualPhone::new(self.rig.clone(), place, self.copies_files);
            Box::new(phone) as Box<dyn Phone>
        });
        let mut recorder = VirtualRecorder::new(self.rig.clone(), self.recorder(), self.shows_ball);
        let mut no_recorder = NoRecorder;
        let recording: &mut dyn DepthRecorder = if self.has_recorder {
            &mut recorder
        } else {
            &mut no_recorder
        };
        let ended = run(
            options,
            &self.profile,
            Devices {
                connector: &mut self.rig.clone(),
                phones: phones.collect(),
                phone_clock: &mut ClockReader::new(self.rig.clone(), self.phone_link),
                recorder: recording,
                host_checks: &mut Checks::default,
                clock: &self.rig,
                operator: &mut Person(self.hands()),
                events: &mut events,
            },
        );
        Run {
            ended,
            events: seen,
            frames: recorder.into_frames(),
        }
    }

    /// Switches the rig off; gives what really happened.
    ///
    /// # Errors
    ///
    /// The firmware has failed.
    pub fn stop(self) -> Result<RunTruth> {
        let rig = Rc::try_unwrap(self.rig.rig);
        let rig = rig.map_err(|_| anyhow!("a session still holds the rig"))?;
        rig.into_inner().stop().context("the simulated rig")
    }
}
