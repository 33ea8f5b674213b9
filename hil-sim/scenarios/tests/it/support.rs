//! The program under test.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::SystemTime;

use test_support::{TestFolder, processes, python};

/// Free memory for a test's recordings, bytes: more than what `record` warns of.
const ENOUGH: u64 = 2_000_000_000;

/// A folder for recordings, in memory where there is enough: while a program waits for the
/// disk, a fast board makes seconds of data that it has not seen. Nothing may be started there.
pub(crate) fn folder_in_memory() -> TestFolder {
    let memory = Path::new("/dev/shm");
    let room = rustix::fs::statvfs(memory).map_or(0, |stat| stat.f_bavail * stat.f_frsize);
    if room > ENOUGH {
        return tempfile::tempdir_in(memory).unwrap().into();
    }
    TestFolder::new()
}

/// Returns a command of the program under test, which ends with the test.
pub(crate) fn tool() -> Command {
    processes::bound(smartdepthsync())
}

/// Cargo builds it with the whole workspace; with this
/// package alone it may be missing or old, and is built here.
pub(crate) fn smartdepthsync() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let test = std::env::current_exe().unwrap();
        let profile = test.parent().and_then(Path::parent).unwrap();
        let program = profile.join(format!("smartdepthsync{}", std::env::consts::EXE_SUFFIX));
        let built = program.metadata().and_then(|m| m.modified());
        let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../host");
        if built.is_ok_and(|built| built > newest(&sources)) {
            return program;
        }
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args(["build", "-p", "smartdepthsync", "--bin", "smartdepthsync"]);
        if profile.ends_with("release") {
            cargo.arg("--release");
        }
        let status = cargo.status().unwrap();
        assert!(status.success(), "smartdepthsync could not be built");
        program
    })
}

/// When the newest file of the program below `folder` was changed.
fn newest(folder: &Path) -> SystemTime {
    let mut newest = SystemTime::UNIX_EPOCH;
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        if ["tests", "dev"]
            .iter()
            .any(|other| entry.file_name() == *other)
        {
            continue;
        }
        let metadata = entry.metadata().unwrap();
        newest = newest.max(if metadata.is_dir() {
            self::newest(&entry.path())
        } else {
            metadata.modified().unwrap()
        });
    }
    newest
}

/// Runs a script beside the tests and returns its output.
pub(crate) fn run_python(script: &str, arguments: &[&Path]) -> String {
    let scripts = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python");
    python::run_script(&scripts.join(script), arguments)
}
