//! `smartdepthsync record` as a process whose disk is full, or that is killed.

use std::cell::Cell;
use std::path::Path;
use std::process::Command;

use crate::support;
use crate::whole_rig::{SPEED, Session, WholeRig};
use mcap::read::Options;
use recording::MCAP_FILE;
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};
use test_support::processes::{Ran, run};
use test_support::{contents, kills};

/// As docs/troubleshooting.md has it.
const STORAGE: i32 = 13;

#[test]
fn a_full_disk_ends_the_session_and_what_was_written_can_be_read() {
    let rig = WholeRig::new(8, SPEED);
    // The system refuses to let a file grow beyond 512 kB, as a full disk does.
    let wanted = rig.record("full", &["--duration", "600s"]);
    let mut command = Command::new("sh");
    command
        .args([
            "-c",
            "ulimit -f 1024; exec env --default-signal=XFSZ \"$0\" \"$@\"",
        ])
        .arg(wanted.get_program())
        .args(wanted.get_args());
    Session::start(&mut command).ends_with(STORAGE);
    let folder = rig.recording("full");
    let session = SessionFile::load(&folder).unwrap();
    assert_eq!(session.outcome, Some(SessionOutcome::Failed));
    let samples = Reader::open(&folder)
        .unwrap()
        .filter(|entry| matches!(entry.as_ref().map(|e| &e.item), Ok(Item::Imu(_))))
        .count();
    assert!(samples > 500, "{samples}");
    assert!(!rig.phone().app.is_recording());
}

/// Returns the number of samples of the board's IMU in a file, as the library of MCAP reads it up to its
/// first incomplete record.
fn samples_by_library(mcap: &Path) -> usize {
    let bytes = std::fs::read(mcap).unwrap();
    let messages = mcap::MessageStream::new_with_options(&bytes, Options::IgnoreEndMagic.into());
    let messages = messages.into_iter().flatten().map_while(Result::ok);
    let is_sample = |message: &mcap::Message<'_>| message.channel.topic == "/board/imu";
    messages.filter(is_sample).count()
}

/// Each kill is followed by another session on the same board and phone; the last one ends well.
#[test]
#[ignore = "takes minutes, and needs strace"]
fn a_kill_at_any_write_of_a_recording_leaves_what_can_be_read() {
    let rig = WholeRig::new(12, SPEED);
    let address = rig.phone().address().to_string();
    let number = Cell::new(0);
    let name = || format!("killed_{}", number.get());
    let record = || {
        // A killed session leaves the phone recording, which the next one says.
        if rig.phone().app.is_recording() {
            run(support::tool().args(["phone", "stop", "--phone", &address]));
        }
        number.set(number.get() + 1);
        let mut command = Command::new(support::smartdepthsync());
        command.args(rig.recording_of(&name(), &rig.profile()));
        command.args(["--yes", "--duration", "2s"]);
        command
    };
    let (mut with_samples, mut closed) = (0, 0);
    let killed = kills::at_writes(20, record, |call, write| {
        let folder = rig.recording(&name());
        let mcap = folder.join(MCAP_FILE);
        // Without its first bytes it is no file of this format yet.
        if mcap.metadata().map_or(0, |file| file.len()) < 8 {
            return;
        }
        let at = format!("{call} {write}, {}", folder.display());
        let entries = Reader::open(&folder).unwrap().map(Result::unwrap);
        let samples = entries.filter(|entry| matches!(entry.item, Item::Imu(_)));
        let samples = samples.count();
        assert_eq!(samples, samples_by_library(&mcap), "{at}");
        with_samples += usize::from(samples > 0);
        let of_it = |words: &[&str]| Ran::new(support::tool().args(words).arg(&folder));
        let checked = of_it(&["verify"]);
        let is_whole = checked.status.success();
        closed += usize::from(is_whole);
        checked.ended_with(if is_whole { 0 } else { 4 }, &[]);
        // What is there makes a data set, and the same one again.
        let out = rig.out().join("data");
        let words = ["extract", "--overwrite", "--out", &out.to_string_lossy()];
        let made = || {
            let ran = of_it(&words);
            // The phone's files are still on it.
            ran.ended_with(4, &["written to"]);
            contents(&out)
        };
        let first = made();
        assert!(first == made(), "{at}");
        std::fs::remove_dir_all(&folder).unwrap();
    });
    println!("{killed} kills, {with_samples} with samples, {closed} of closed recordings");
    assert!(killed > 100 && with_samples > 20 && closed > 2);
    Ran::new(&mut record()).ended_with(0, &[]);
}
