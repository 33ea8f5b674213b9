//! `smartdepthsync record` as a process: what only a process can show of a full disk and of
//! a depth recorder that is another process.

use std::process::Command;

use crate::whole_rig::{SPEED, Session, WholeRig};
use recording::reader::{Item, Reader};
use rustix::process::Signal;

// Exit codes, as docs/exit-codes.md has them.
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
    let said = Session::start(&mut command).ends_with(STORAGE);
    assert!(said.contains("File too large"), "{said}");
    let folder = rig.recording("full");
    let samples = Reader::open(&folder)
        .unwrap()
        .filter(|entry| matches!(entry.as_ref().map(|e| &e.item), Ok(Item::Imu(_))))
        .count();
    assert!(samples > 500, "{samples}");
    assert!(!rig.phone().is_recording());
}

/// Killed, the program can stop nothing any more: its guard does.
#[test]
fn a_kill_takes_the_depth_recorder_along() {
    let rig = WholeRig::new(15, SPEED);
    let profile = format!(
        "{}\n[depth.recorder]\nstop = \"terminate\"\ncommand = [\"sh\", \"-c\", \"echo $$ > \
         {{folder}}/pid; exec sleep 600\"]\n",
        rig.profile()
    );
    let session = Session::start(&mut rig.record_with("kill", &profile, &[]));
    let recorder = format!("/proc/{}", recorder_pid(&rig, "kill"));
    let recorder = std::path::PathBuf::from(recorder);
    assert!(recorder.exists());
    session.signal(Signal::KILL);
    session.end();
    let began = std::time::Instant::now();
    while recorder.exists() {
        assert!(began.elapsed().as_secs() < 60, "the recorder lives on");
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    rig.stop_phone();
}

/// The number that a depth recorder writes into its recording.
fn recorder_pid(rig: &WholeRig, name: &str) -> i32 {
    let file = rig.recording(name).join("pid");
    loop {
        match std::fs::read_to_string(&file) {
            Ok(pid) if pid.ends_with('\n') => return pid.trim().parse().unwrap(),
            _ => rig.wait_ms(10),
        }
    }
}
