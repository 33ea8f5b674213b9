//! A rig on virtual time for the tests of sessions, and the states of a session.

use std::path::PathBuf;

use board::finding::FindingKind;
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};
use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::whole_rig::config::RigConfig;
use rig::wiring;
use scenarios::virtual_session::{Run, SessionBench};
use session::devices::Choice;
use session::event::{Phase, SessionEvent};
use session::options::{Options, seconds};
use stm32f4_sim::time::SimDuration;
use test_support::TestFolder;

/// Names of two phones.
pub(crate) const TWO: [&str; 2] = ["left", "right"];

/// A rig that somebody twists all the time, and the folder of its recordings.
pub(crate) struct Twisted {
    pub(crate) bench: SessionBench,
    pub(crate) folder: TestFolder,
}

impl Twisted {
    pub(crate) fn new(seed: u64) -> Self {
        Self::with(seed, |_, _| {})
    }

    pub(crate) fn with(seed: u64, edit: impl FnOnce(&mut RigConfig, &mut PhoneConfig)) -> Self {
        Self::with_phones(seed, &[], edit)
    }

    /// With phones of these names, of which only the first is edited; with one if there is no
    /// name.
    pub(crate) fn with_phones(
        seed: u64,
        names: &[&str],
        edit: impl FnOnce(&mut RigConfig, &mut PhoneConfig),
    ) -> Self {
        let folder = TestFolder::new();
        let motion = MotionSpec::always(Gesture::Twist);
        let mut config = RigConfig::published(Seed(seed)).with_motion(motion);
        let mut phones: Vec<PhoneConfig> = (0..names.len().max(1) as u64)
            .map(|number| {
                let mut phone = PhoneConfig::draw(Seed(seed + 1_000 * number));
                // A small picture: videos are not what is tested here.
                (phone.camera.rows, phone.camera.columns) = (120, 16);
                phone
            })
            .collect();
        edit(&mut config, &mut phones[0]);
        let board = wiring::board_of(config.board, None).tolerate_failures();
        let mut bench = SessionBench::new(config, board, phones, names, folder.path()).unwrap();
        bench.hurry();
        // Half the default: the campaign and the whole chain are for the full load.
        bench.profile.imu.rate_hz = 250;
        Self { bench, folder }
    }

    /// Returns the options for a recording of some seconds.
    pub(crate) fn options(&self, name: &str, length: u64) -> Options {
        Options {
            duration: Some(seconds(length)),
            ..self.bench.options(name)
        }
    }

    /// Records for some seconds; the session must end well.
    pub(crate) fn record(&mut self, name: &str, length: u64) {
        let options = self.options(name, length);
        self.bench.run(&options).good().unwrap();
        self.readable(name, SessionOutcome::Good);
        self.all_is_stopped(name);
    }

    pub(crate) fn recording(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Right after `is_it`, something happens to the rig.
    pub(crate) fn soon_after(
        &mut self,
        is_it: impl FnMut(&SessionEvent) -> bool + 'static,
        what: impl FnOnce(&mut rig::whole_rig::virtual_rig::VirtualRig) + 'static,
    ) {
        self.bench.on(is_it, ms(100), what);
    }

    /// The person answers the next prompt that `asks`.
    pub(crate) fn answer_on(
        &mut self,
        asks: impl FnMut(&SessionEvent) -> bool + 'static,
        choice: Choice,
    ) {
        let hands = self.bench.hands();
        self.soon_after(asks, move |_| hands.answer(choice));
    }

    /// The person presses Ctrl-C right after `is_it`.
    pub(crate) fn interrupt_on(&mut self, is_it: impl FnMut(&SessionEvent) -> bool + 'static) {
        let hands = self.bench.hands();
        self.soon_after(is_it, move |_| hands.interrupt());
    }

    /// The train is stopped, and the phone records nothing.
    pub(crate) fn all_is_stopped(&self, state: &str) {
        let (records, edges) = self.bench.with(|rig| {
            let before = rig.sim.edge_count(wiring::TRIGGER);
            rig.pass(ms(300));
            let edges = rig.sim.edge_count(wiring::TRIGGER) - before;
            (rig.phones[0].app.is_recording(), edges)
        });
        assert!(!records, "{state}: the phone records");
        assert_eq!(edges, 0, "{state}: the trigger runs");
    }

    /// A phone that was left recording is stopped by its owner.
    pub(crate) fn stop_phone(&self) {
        self.bench.with(|rig| {
            while rig.phones[0].app.is_recording() {
                rig.phones[0].app.press_record();
                rig.pass(ms(100));
            }
        });
    }

    /// The files of a recording can be read, and say how it ended.
    pub(crate) fn readable(&self, name: &str, outcome: SessionOutcome) -> SessionFile {
        let folder = self.recording(name);
        let session = SessionFile::load(&folder).unwrap();
        assert_eq!(
            session.outcome,
            Some(outcome),
            "{name}: {:?}",
            session.problems
        );
        let mut reader = Reader::open(&folder).unwrap();
        let samples = reader
            .by_ref()
            .filter(|entry| matches!(entry.as_ref().unwrap().item, Item::Imu(_)))
            .count();
        assert!(samples > 0, "{name} has no samples");
        assert!(!reader.broken_off(), "{name}");
        session
    }
}

pub(crate) const fn ms(ms: u64) -> SimDuration {
    SimDuration::from_millis(ms)
}

pub(crate) fn problems(session: &SessionFile) -> Vec<FindingKind> {
    let problems = session.problems.iter();
    problems.map(|problem| problem.kind.clone()).collect()
}

/// Outcome of a session that has a folder.
pub(crate) fn outcome(run: &Run) -> SessionOutcome {
    match &run.ended {
        Ok(Some(ended)) => ended.file.outcome.unwrap(),
        other => panic!("{other:?}"),
    }
}

/// True if an event is of a kind.
pub(crate) type IsIt = fn(&SessionEvent) -> bool;

/// The states of a session, each with the event that begins it.
pub(crate) const STATES: [(&str, IsIt); 6] = [
    ("connected", |event| {
        matches!(event, SessionEvent::Connected { .. })
    }),
    ("twist", |event| {
        matches!(event, SessionEvent::TwistStarted { number: 1, .. })
    }),
    ("trigger", |event| {
        matches!(event, SessionEvent::TriggerStarted { .. })
    }),
    ("video", |event| {
        matches!(event, SessionEvent::VideoStarted { .. })
    }),
    ("aligning", |event| {
        matches!(event, SessionEvent::Aligning { .. })
    }),
    ("recording", is_recording),
];

pub(crate) fn is_recording(event: &SessionEvent) -> bool {
    matches!(event, SessionEvent::RecordingStarted { .. })
}

pub(crate) fn is_second_twist(event: &SessionEvent) -> bool {
    matches!(event, SessionEvent::TwistStarted { number: 2, .. })
}

pub(crate) fn is_fetching(event: &SessionEvent) -> bool {
    let phase = Phase::Fetching;
    matches!(event, SessionEvent::Phase { phase: begun } if *begun == phase)
}

/// The event with this number, from 0, of those for which `is_it`.
pub(crate) fn nth(
    number: usize,
    is_it: impl Fn(&SessionEvent) -> bool,
) -> impl FnMut(&SessionEvent) -> bool {
    let mut seen = 0;
    move |event| {
        let is_one = is_it(event);
        seen += usize::from(is_one);
        is_one && seen == number + 1
    }
}
