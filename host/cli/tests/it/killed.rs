//! Programs that are killed, or that write at the same time: what they leave is whole, or the next run
//! makes it whole.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use recording::profile::DEFAULT;

use super::extract_command::{phone, recording};
use test_support::{TestFolder, kills};

const PROGRAM: &str = env!("CARGO_BIN_EXE_smartdepthsync");

/// The files of a data set that its reader sees, but for the page.
fn contents(out: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    for path in test_support::below(out) {
        let name = path.strip_prefix(out).unwrap().to_owned();
        let is_hidden = name
            .iter()
            .any(|part| part.to_string_lossy().starts_with('.'));
        if path.is_file() && !is_hidden && name != Path::new("report.html") {
            files.insert(name, fs::read(&path).unwrap());
        }
    }
    files
}

/// Returns the command that extracts a recording of a second, without output.
fn extract(folder: &Path, format: &str, out: &Path) -> Command {
    let mut command = Command::new(PROGRAM);
    command.arg("extract").arg(folder);
    command.arg("--phone").arg(folder.join("phone"));
    command.args(["--format", format, "--out"]).arg(out);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

fn code(mut command: Command) -> Option<i32> {
    command.status().unwrap().code()
}

/// A recording, what its extraction ends with, and what it writes.
fn alone(parent: &Path, format: &str) -> (PathBuf, Option<i32>, BTreeMap<PathBuf, Vec<u8>>) {
    let folder = recording(parent);
    phone(&folder, 20, 20);
    let out = parent.join("alone");
    let usual = code(extract(&folder, format, &out));
    let expected = contents(&out);
    assert!(expected.len() > 5, "{:?}", expected.keys());
    (folder, usual, expected)
}

/// Several programs on one output, half of them killed at any time: whoever ends says that another writes, or
/// what one alone says; and what is there then is what one alone writes. Returns the number that were killed.
fn several_at_once(format: &str, counts: &[usize], seed: u64) -> usize {
    let parent = TestFolder::new();
    let (folder, usual, expected) = alone(parent.path(), format);
    let mut random = Pcg64::seed_from_u64(seed);
    let mut wait = |most: u64| {
        std::thread::sleep(Duration::from_millis(random.random_range(0..most)));
        random.random_bool(0.5)
    };
    let mut killed = 0;
    for count in counts {
        let out = parent.path().join(format!("of_{count}"));
        let mut running = Vec::new();
        for _ in 0..*count {
            wait(30);
            running.push(extract(&folder, format, &out).spawn().unwrap());
        }
        let mut has_ended = false;
        for mut program in running {
            if wait(60) {
                program.kill().unwrap();
            }
            match program.wait().unwrap().code() {
                None => killed += 1,
                // Another writes.
                Some(2) => {}
                code => {
                    assert_eq!(code, usual);
                    has_ended = true;
                }
            }
        }
        assert!(!has_ended || contents(&out) == expected, "{count}");
        assert_eq!(code(extract(&folder, format, &out)), usual);
        assert!(contents(&out) == expected, "{count}");
    }
    killed
}

#[test]
fn several_extractions_at_once_leave_one_whole_data_set() {
    assert!(several_at_once("euroc", &[3], 61) > 0);
    several_at_once("ros2", &[2], 62);
}

#[test]
#[ignore = "takes minutes"]
fn many_extractions_at_once_leave_one_whole_data_set() {
    let mut killed = 0;
    for seed in 0..20 {
        let format = ["euroc", "ros2", "tum", "kalibr"][seed as usize % 4];
        killed += several_at_once(format, &[2, 3, 10], seed);
    }
    println!("300 extractions in 60 groups, {killed} killed");
}

/// Every file of a data set gone, empty, cut, or with a changed byte, each in another run, and what a killed
/// one leaves unfinished.
#[test]
fn the_next_run_writes_again_what_was_changed() {
    let parent = TestFolder::new();
    for format in ["euroc", "ros2"] {
        let own = parent.path().join(format);
        fs::create_dir(&own).unwrap();
        let (folder, usual, expected) = alone(&own, format);
        let out = own.join("alone");
        for kind in 0..4 {
            for (number, (name, whole)) in expected.iter().enumerate() {
                let path = out.join(name);
                let mut changed = whole.clone();
                match (number + kind) % 4 {
                    0 => {
                        fs::remove_file(path).unwrap();
                        continue;
                    }
                    1 => changed.clear(),
                    2 => changed.truncate(whole.len() / 2),
                    _ => changed[whole.len() / 2] ^= 1,
                }
                fs::write(path, changed).unwrap();
            }
            for left in ["contents.json.partial", "1.png.partial"] {
                fs::write(out.join(left), "").unwrap();
            }
            assert_eq!(code(extract(&folder, format, &out)), usual);
            assert!(contents(&out) == expected, "{format} {kind}");
        }
    }
}

#[test]
#[ignore = "takes minutes, and needs strace"]
fn a_kill_at_any_write_of_an_extraction_leaves_what_the_next_run_completes() {
    let mut killed = 0;
    for format in ["euroc", "ros2"] {
        let parent = TestFolder::new();
        let (folder, usual, expected) = alone(parent.path(), format);
        let out = parent.path().join("killed");
        killed += kills::at_writes(
            12,
            || extract(&folder, format, &out),
            |call, number| {
                let again = code(extract(&folder, format, &out));
                assert_eq!(again, usual, "{format} {call} {number}");
                assert!(contents(&out) == expected, "{format} {call} {number}");
                fs::remove_dir_all(&out).unwrap();
            },
        );
    }
    println!("{killed} kills");
    assert!(killed > 100, "{killed}");
}

#[test]
#[ignore = "takes a minute, and needs strace"]
fn a_kill_at_any_write_of_a_profile_leaves_the_old_one_or_the_new_one() {
    let parent = TestFolder::new();
    let folder = recording(parent.path());
    // As many timestamps as it takes to learn from.
    phone(&folder, 20, 400);
    let profile = parent.path().join("rig.toml");
    let learn = || {
        fs::write(&profile, DEFAULT).unwrap();
        let mut command = Command::new(PROGRAM);
        command.args(["profile", "learn"]).arg(&folder);
        command.arg("--profile").arg(&profile);
        command.stdout(Stdio::null()).stderr(Stdio::null());
        command
    };
    assert_eq!(code(learn()), Some(0));
    let learnt = fs::read_to_string(&profile).unwrap();
    assert_ne!(learnt, DEFAULT);
    let mut old = 0;
    let killed = kills::at_writes(100, learn, |call, number| {
        let found = fs::read_to_string(&profile).unwrap();
        assert!(
            found == DEFAULT || found == learnt,
            "{call} {number}: {found}"
        );
        old += usize::from(found == DEFAULT);
    });
    println!("{killed} kills, {old} with the old profile");
    assert!(old > 10 && killed > old, "{killed} {old}");
}
