//! Between the board's port and the program: messages are decoded, changed as values of
//! any kind (their fields are not named here), and encoded again.

use std::io::{Read as _, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use protocol::{Decoder, DeviceToHost, MAX_FRAME, encode};
use rig::pty::Pty;
use rig::random::Random;
use rustix::fs::OFlags;
use serde_json::{Value, json};
use stm32f4_sim::shared::lock;

use super::Turn;

/// Kinds of messages; those that come once or decide something more often.
const KINDS: [&str; 10] = [
    "Hello", "Hello", "Answer", "Answer", "Answer", "Status", "Pulse", "Arrived", "Imu", "Capture",
];

/// The first message of a kind that is changed.
const FIRSTS: [u64; 7] = [0, 1, 2, 4, 8, 100, 9_000];

/// Pause when nothing comes.
const PAUSE: Duration = Duration::from_millis(1);

/// A lie of the board.
#[derive(Clone, Debug)]
pub(super) struct Lie {
    kind: &'static str,
    turn: Turn,
    what: What,
}

#[derive(Clone, Debug)]
enum What {
    /// One field, by its number among all, and the first of [`extremes`] that is tried.
    Field(usize, usize),
    /// All fields.
    All(usize),
    /// An answer becomes another one: that to another command, or a refusal.
    Answer(&'static str),
    /// The message so many times.
    Repeat(usize),
    /// What a test asks for.
    Other(Change),
}

/// What becomes of a message.
pub type Change = fn(&DeviceToHost) -> Vec<DeviceToHost>;

pub(super) fn draw(random: &mut Random) -> Vec<Lie> {
    let count = random.below(4) + 1;
    (0..count)
        .map(|_| {
            let extreme = random.below(extremes().len());
            let what = match random.below(8) {
                0..=4 => What::Field(random.below(1_000), extreme),
                5 => What::All(extreme),
                6 => What::Repeat(*random.one_of(&[2, 50])),
                _ => {
                    let instead = *random.one_of(&["WrongKey", "TriggerStopped", "SayHello"]);
                    What::Answer(instead)
                }
            };
            let kind = if matches!(what, What::Answer(_)) {
                "Answer"
            } else {
                *random.one_of(&KINDS)
            };
            let turn = Turn::draw(random, &FIRSTS);
            Lie { kind, turn, what }
        })
        .collect()
}

/// What a field may become, of whatever kind it is.
fn extremes() -> [Value; 18] {
    [
        json!(0),
        json!(1),
        json!(-1),
        json!(u8::MAX),
        json!(i16::MIN),
        json!(i16::MAX),
        json!(u16::MAX),
        json!(i32::MIN),
        json!(i32::MAX),
        json!(1_u64 << 31),
        json!(u32::MAX),
        json!(i64::MIN),
        json!(i64::MAX),
        json!(u64::MAX),
        json!("\u{1b}]0;owned\u{7}"),
        json!("x".repeat(48)),
        json!(true),
        json!(false),
    ]
}

/// The message with one field changed as far as it takes one of the values.
fn with(message: &DeviceToHost, place: &str, first: usize) -> DeviceToHost {
    let extremes = extremes();
    let changed = (0..extremes.len()).find_map(|step| {
        let mut value = serde_json::to_value(message).ok()?;
        *value.pointer_mut(place)? = extremes[(first + step) % extremes.len()].clone();
        let changed: DeviceToHost = serde_json::from_value(value).ok()?;
        (changed != *message).then_some(changed)
    });
    changed.unwrap_or_else(|| message.clone())
}

impl What {
    fn apply(&self, message: &DeviceToHost) -> Vec<DeviceToHost> {
        let places = || {
            let value = serde_json::to_value(message).unwrap_or_default();
            let mut places = Vec::new();
            fields(&value, "", &mut places);
            places
        };
        let one = match self {
            Self::Other(change) => return change(message),
            Self::Repeat(times) => return vec![message.clone(); *times],
            Self::Field(which, extreme) => {
                let places = places();
                with(message, &places[which % places.len().max(1)], *extreme)
            }
            Self::All(extreme) => {
                let all = places().into_iter();
                all.fold(message.clone(), |message, place| {
                    with(&message, &place, *extreme)
                })
            }
            Self::Answer(instead) => {
                let result = match *instead {
                    "SayHello" => json!({"Ok": {"SayHello": null}}),
                    refusal => json!({"Err": refusal}),
                };
                let mut value = serde_json::to_value(message).unwrap_or_default();
                value["Answer"]["result"] = result;
                serde_json::from_value(value).unwrap_or_else(|_| message.clone())
            }
        };
        vec![one]
    }
}

/// The places of all single values.
fn fields(value: &Value, place: &str, all: &mut Vec<String>) {
    match value {
        Value::Object(map) => {
            for (name, value) in map {
                fields(value, &format!("{place}/{name}"), all);
            }
        }
        Value::Array(list) => {
            for (index, value) in list.iter().enumerate() {
                fields(value, &format!("{place}/{index}"), all);
            }
        }
        _ => all.push(place.to_owned()),
    }
}

/// Whoever stands between.
pub struct Liar {
    port: PathBuf,
    stop: Arc<AtomicBool>,
    plan: Arc<Mutex<Plan>>,
    thread: Option<JoinHandle<Vec<Vec<u8>>>>,
}

/// What is told, and was.
#[derive(Default)]
struct Plan {
    lies: Vec<Lie>,
    /// Messages so far, by the place of their kind.
    seen: [u64; KINDS.len()],
    /// How many were changed.
    told: u64,
}

impl Liar {
    /// Takes the place of a port, and lies nothing yet.
    ///
    /// # Errors
    ///
    /// The port cannot be opened, or there is no pseudo-terminal.
    pub fn honest(port: &Path) -> Result<Self, String> {
        Self::before(port, Vec::new())
    }

    pub(super) fn before(port: &Path, lies: Vec<Lie>) -> Result<Self, String> {
        let flags = OFlags::NOCTTY | OFlags::NONBLOCK;
        let board = std::fs::File::options()
            .read(true)
            .write(true)
            .custom_flags(flags.bits() as i32)
            .open(port)
            .map_err(|error| format!("cannot open the board's port: {error}"))?;
        let pty = Pty::new().map_err(|error| error.to_string())?;
        let stop = Arc::new(AtomicBool::new(false));
        let plan = Arc::new(Mutex::new(Plan {
            lies,
            ..Plan::default()
        }));
        let own = pty.path().to_owned();
        let between = Between {
            plan: Arc::clone(&plan),
            sent: Vec::new(),
            pending: Vec::new(),
        };
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || between.pass(board, &pty, &stopped));
        Ok(Self {
            port: own,
            stop,
            plan,
            thread: Some(thread),
        })
    }

    /// The port that it offers.
    #[must_use]
    pub fn port(&self) -> &Path {
        &self.port
    }

    /// Changes the next `count` messages of a kind, which is the name of a variant of
    /// [`DeviceToHost`].
    pub fn tell(&self, kind: &'static str, count: u64, change: Change) {
        let mut plan = lock(&self.plan);
        let place = KINDS.iter().position(|known| *known == kind);
        let from = place.map_or(0, |place| plan.seen[place]);
        plan.lies.push(Lie {
            kind,
            turn: Turn { from, count },
            what: What::Other(change),
        });
    }

    /// How many messages were changed so far.
    pub(super) fn told(&self) -> u64 {
        lock(&self.plan).told
    }

    /// Goes; gives all frames that it passed on, without their delimiters.
    pub(super) fn end(mut self) -> Vec<Vec<u8>> {
        self.stop.store(true, Ordering::Relaxed);
        let thread = self.thread.take();
        thread
            .and_then(|thread| thread.join().ok())
            .unwrap_or_default()
    }
}

impl Drop for Liar {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Between {
    plan: Arc<Mutex<Plan>>,
    sent: Vec<Vec<u8>>,
    /// On its way to the program.
    pending: Vec<u8>,
}

impl Between {
    fn pass(mut self, mut board: std::fs::File, pty: &Pty, stop: &AtomicBool) -> Vec<Vec<u8>> {
        let (mut frame, mut commands) = (Vec::new(), Vec::new());
        let mut buffer = [0; 4096];
        while !stop.load(Ordering::Relaxed) {
            let mut is_idle = true;
            // A program that does not read makes the board wait, as its own port does.
            if self.pending.is_empty() {
                let count = board.read(&mut buffer).unwrap_or(0);
                for &byte in &buffer[..count] {
                    if byte == 0 {
                        self.frame(&std::mem::take(&mut frame));
                    } else {
                        frame.push(byte);
                    }
                }
                is_idle &= count == 0;
            }
            if !pty.is_open().unwrap_or(false) {
                self.pending.clear();
            }
            let count = pty.write(&self.pending).unwrap_or(0);
            self.pending.drain(..count);
            is_idle &= count == 0;
            let count = pty.read(&mut buffer).unwrap_or(0);
            commands.extend_from_slice(&buffer[..count]);
            is_idle &= count == 0;
            let count = board.write(&commands).unwrap_or(0);
            commands.drain(..count);
            if is_idle {
                std::thread::sleep(PAUSE);
            }
        }
        self.sent
    }

    /// A frame of the board, without its delimiter.
    fn frame(&mut self, frame: &[u8]) {
        let whole = [frame, &[0]].concat();
        let message = Decoder::<DeviceToHost>::new().next(&mut whole.as_slice());
        let Some(Ok(message)) = message else {
            return self.send(frame);
        };
        let value = serde_json::to_value(&message).unwrap_or_default();
        let kind = value.as_object().and_then(|map| map.keys().next());
        let Some(place) = KINDS
            .iter()
            .position(|known| kind.is_some_and(|kind| kind == known))
        else {
            return self.send(frame);
        };
        let mut plan = lock(&self.plan);
        let number = plan.seen[place];
        plan.seen[place] += 1;
        let mut messages = vec![message.clone()];
        for lie in &plan.lies {
            if lie.kind == KINDS[place] && lie.turn.has(number) {
                messages = messages.iter().flat_map(|m| lie.what.apply(m)).collect();
            }
        }
        if messages == [message] {
            drop(plan);
            return self.send(frame);
        }
        plan.told += 1;
        drop(plan);
        for message in messages {
            let mut buffer = [0; MAX_FRAME];
            if let Ok(bytes) = encode(&message, &mut buffer) {
                self.send(&bytes[..bytes.len() - 1]);
            }
        }
    }

    fn send(&mut self, frame: &[u8]) {
        self.sent.push(frame.to_vec());
        self.pending.extend_from_slice(frame);
        self.pending.push(0);
    }
}
