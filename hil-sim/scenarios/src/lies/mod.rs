//! A board or a phone that lies: `smartdepthsync record` on the running rig, with somebody
//! between it and one of them who changes what they say.
//!
//! One seed is one session. One to four lies are drawn: any number, text or flag of any
//! message of the [`board`] or of any answer of the [`phone`] becomes an extreme one, once,
//! for a while or always; or all of a message at once; or a message comes many times. Board
//! and phone themselves are as they should be, so the truth is known.
//!
//! Judged: the program ends by itself in time, with a documented exit code, without a
//! panic; phone and trigger are stopped at the end, or it says that they are not; every
//! frame that came over the link is in the recording, which can be read.

pub mod board;
mod phone;

use std::fmt;
use std::path::Path;
use std::time::Duration;

use ::board::Board;
use protocol::TrainState;
use recording::reader::{Item, Reader};
use recording::session_file::SessionFile;
use verify::verify;

use crate::faults::process::{Record, start_rig, stop_phone};
use crate::programs::{Programs, is_documented};
use crate::session::Session;
use crate::workers;
use rig::random::{Random, Seed, Stream};
use rig::running_rig::RunningRig;

/// The longest that a session may last, in real time: some 15 s without a lie.
const PATIENCE: Duration = Duration::from_secs(180);
/// Length of a recording, s.
const SECONDS: u64 = 3;
/// Sessions beside each other: they wait much of their time.
const BESIDE: usize = 2;

/// A session that passed.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Its seed.
    pub seed: u64,
    /// What was drawn.
    pub lies: String,
    /// The exit code.
    pub exit_code: i32,
    /// How many messages or answers were changed.
    pub told: u64,
    /// Frames of the link that were compared.
    pub frames: usize,
}

/// A session that did not pass.
#[derive(Clone, Debug)]
pub struct Finding {
    /// Its seed.
    pub seed: u64,
    /// What was drawn.
    pub lies: String,
    /// What should not be.
    pub what: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "seed {}: {}\n  {}", self.seed, self.lies, self.what)
    }
}

/// Runs seeds, two at a time, and tells of each as it ends; gives their results in order.
pub fn campaign(
    seeds: &[u64],
    programs: &Programs,
    folder: &Path,
    told: &(dyn Fn(&Result<Verdict, Finding>) + Sync),
) -> Vec<Result<Verdict, Finding>> {
    workers::each(seeds, BESIDE, |&seed| {
        let result = run(seed, programs, folder);
        told(&result);
        result
    })
}

/// Runs one seed in a folder of its own below `folder`, which is removed.
///
/// # Errors
///
/// Something was not as promised.
pub fn run(seed: u64, programs: &Programs, folder: &Path) -> Result<Verdict, Finding> {
    let mut random = Seed(seed).stream(Stream::Test);
    // The board, the phone, or both.
    let who = random.below(3);
    let board = if who == 1 {
        Vec::new()
    } else {
        board::draw(&mut random)
    };
    let phone = if who == 0 {
        Vec::new()
    } else {
        phone::draw(&mut random)
    };
    let lies = format!("board: {board:?}; phone: {phone:?}");
    let place = folder.join(format!("lies-{seed}"));
    let result = session(seed, programs, &place, (board, phone));
    // Otherwise it goes with the whole folder.
    let _ = std::fs::remove_dir_all(&place);
    match result {
        Ok((exit_code, told, frames)) => Ok(Verdict {
            seed,
            lies,
            exit_code,
            told,
            frames,
        }),
        Err(what) => Err(Finding { seed, lies, what }),
    }
}

/// Exit code, lies told, frames compared.
type Passed = (i32, u64, usize);

fn session(
    seed: u64,
    programs: &Programs,
    place: &Path,
    (board, phone): (Vec<board::Lie>, Vec<phone::Lie>),
) -> Result<Passed, String> {
    std::fs::create_dir_all(place).map_err(|error| error.to_string())?;
    let rig = start_rig(seed, programs, place)?;
    let own_phone = rig.phone().ok_or("the rig has no phone")?;
    let (board, phone) = (
        board::Liar::before(rig.port(), board)?,
        phone::Liar::before(own_phone.address(), phone)?,
    );
    let profile = rig.profile().map_err(|error| format!("{error:#}"))?;
    let (true_one, false_one) = (own_phone.address().to_string(), phone.address().to_string());
    let record = Record {
        port: board.port(),
        profile: &profile.replace(&true_one, &false_one),
        seconds: SECONDS,
        place,
        name: "session",
    };
    let mut command = record.command(programs)?;
    command.args(["--link-patience", "5s"]);
    let mut session = Session::start(&mut command)?;
    let status = session.wait(PATIENCE, || rig.is_running())?;
    let said = session.all_said();
    let told = board.told() + phone.told();
    let sent = board.end();
    drop(phone);
    let bad = |what: String| Err(format!("{what}; it said: {}", said.trim()));
    let Some(code) = status.code().filter(|code| is_documented(*code)) else {
        return bad(format!("it ended with {status}"));
    };
    if said.contains("panicked") {
        return bad(String::from("it panicked"));
    }
    if own_phone.is_recording() {
        stop_phone(own_phone);
        if !said.contains("stop it on the phone") && !said.contains("could not be stopped") {
            return bad(format!(
                "exit code {code}, and the phone was left recording"
            ));
        }
    }
    if !trigger_is_stopped(&rig)? && !said.contains("trigger could not be stopped") {
        return bad(format!(
            "exit code {code}, and the trigger was left running"
        ));
    }
    let recording = place.join("session");
    if !recording.exists() {
        return Ok((code, told, 0));
    }
    if let Err(error) = verify(&recording, &|| false) {
        return bad(format!("the recording cannot be read: {error}"));
    }
    match frames_are_there(&recording, &sent) {
        Ok(frames) => Ok((code, told, frames)),
        Err(what) => bad(what),
    }
}

/// By the board itself.
fn trigger_is_stopped(rig: &RunningRig) -> Result<bool, String> {
    let port = rig.port().to_string_lossy();
    let mut board = Board::open(Some(&port)).map_err(|error| error.to_string())?;
    let status = board.trigger().map_err(|error| error.to_string())?;
    Ok(status.state == TrainState::Stopped)
}

/// Every frame from the first that was recorded to the last, in the order in which they
/// came; how many. Where the link was taken up again, some may have been left out.
fn frames_are_there(recording: &Path, sent: &[Vec<u8>]) -> Result<usize, String> {
    let file = SessionFile::load(recording).map_err(|error| error.to_string())?;
    let recorded: Vec<Vec<u8>> = Reader::open(recording)
        .map_err(|error| error.to_string())?
        .filter_map(|entry| match entry.ok()?.item {
            Item::Link(frame) => Some(frame.data),
            _ => None,
        })
        .collect();
    let is_there = file.reconnects > 0
        || recorded.is_empty()
        || sent
            .windows(recorded.len())
            .any(|window| window == recorded);
    is_there.then_some(recorded.len()).ok_or_else(|| {
        format!(
            "the {} frames in the recording are no stretch of the {} that came",
            recorded.len(),
            sent.len()
        )
    })
}

/// Which messages or answers of a kind are changed.
#[derive(Clone, Copy, Debug)]
struct Turn {
    from: u64,
    count: u64,
}

impl Turn {
    /// From which message or answer of its kind on, and for how many.
    fn draw(random: &mut Random, firsts: &[u64]) -> Self {
        Self {
            from: *random.one_of(firsts),
            count: *random.one_of(&[1, 1, 50, u64::MAX]),
        }
    }

    const fn has(self, number: u64) -> bool {
        number >= self.from && number - self.from < self.count
    }
}
