//! `smartdepthsync record` as a process whose disk is full.

use std::process::Command;

use crate::whole_rig::{SPEED, Session, WholeRig};
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};

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
