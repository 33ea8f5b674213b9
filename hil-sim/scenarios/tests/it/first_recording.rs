//! The commands that `hil-sim serve` and then each other print, followed to a data set with
//! pictures.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, Stdio};

use crate::support;
use clock::BoardToPhone;
use protocol::Ticks;
use recording::session_file::SessionFile;
use test_support::{TestFolder, processes};

/// A rig that waits for commands, and what it said at first.
struct Served {
    child: Child,
    search_path: String,
    commands: Vec<String>,
}

impl Served {
    fn start(folder: &Path) -> Self {
        let mut child = processes::bound(env!("CARGO_BIN_EXE_hil-sim"))
            .args([
                "serve", "--speed", "12", "--motion", "twist", "--seed", "3", "--quiet",
            ])
            .args(["--wait-for-host", "--tolerate-failures"])
            .args(["--phone", "0", "--profile", "owner.toml"])
            .args(["--truth", "truth.csv"])
            .current_dir(folder)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut commands: Vec<String> = Vec::new();
        for line in lines.map_while(Result::ok) {
            let is_last = line.starts_with("Each command");
            commands.push(line);
            if is_last {
                break;
            }
        }
        let path = commands
            .iter()
            .find_map(|line| line.strip_prefix("export PATH="));
        let path = path.unwrap().strip_suffix(":$PATH").unwrap();
        let search_path = format!("{path}:{}", std::env::var("PATH").unwrap());
        Self {
            child,
            search_path,
            commands,
        }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The phone's clock as the session knows it against what the rig wrote of it, within five
/// times what is stated.
fn is_near_truth(session: &SessionFile, truth: &Path) {
    let (span, clock) = (session.recorded.unwrap(), session.clock().unwrap());
    let text = std::fs::read_to_string(truth).unwrap();
    let lines = text.lines().filter_map(|line| line.split_once(','));
    let delay_s = session.profile.phone.gyro_delay_sigma_us * 1e-6;
    let mut compared = 0;
    for (ticks, phone_ns) in lines {
        let (Ok(ticks), Ok(phone_ns)) = (ticks.parse(), phone_ns.parse::<i64>()) else {
            continue;
        };
        let at = Ticks(ticks);
        if (span.from..=span.to).contains(&at) {
            let error_s = (clock.ticks_to_phone(at).0 - phone_ns) as f64 * 1e-9;
            let sigma_s = clock.offset_at(at.as_secs_f64()).sigma.hypot(delay_s);
            assert!(error_s.abs() < 5.0 * sigma_s, "{error_s} {sigma_s}");
            compared += 1;
        }
    }
    assert!(compared > 4, "{text}");
}

/// Types a command as a person does, with Enter at each question; gives what it printed.
fn typed(command: &str, place: &Path, search_path: &str) -> String {
    let mut child = processes::bound("sh")
        // In the shell's place, so that it ends with the test as the shell would.
        .args(["-c", &format!("exec {command}")])
        .current_dir(place)
        .env("PATH", search_path)
        .env("HOME", place)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut keys = child.stdin.take().unwrap();
    let questions = BufReader::new(child.stderr.take().unwrap());
    let asked = std::thread::spawn(move || {
        let mut said = String::new();
        for line in questions.lines().map_while(Result::ok) {
            if line.contains("[Enter]") {
                // One that has ended asks no more.
                let _ = keys.write_all(b"\n");
            }
            said += &line;
            said.push('\n');
        }
        said
    });
    let output = child.wait_with_output().unwrap();
    let asked = asked.join().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{command}: {asked}{text}");
    text
}

/// From `serve` on, nothing but the last line that was printed, with less than its minutes: it
/// calibrates, records, and ends in a data set.
#[test]
fn each_command_that_is_printed_last_leads_on_to_a_data_set() {
    let folder = TestFolder::new();
    let place = folder.path();
    support::smartdepthsync();
    let mut rig = Served::start(place);
    let search_path = std::mem::take(&mut rig.search_path);
    let is_command = |line: &&str| line.trim_start().starts_with("smartdepthsync ");
    let commands = rig.commands.iter().map(String::as_str);
    let mut next = commands.rev().find(is_command).map(str::to_owned);
    let mut typed_commands = Vec::new();
    // The last command needs it no more.
    let mut rig = Some(rig);
    while let Some(command) = next.filter(|_| typed_commands.len() < 8) {
        if command.contains(" extract ") {
            drop(rig.take());
        }
        // It is two minutes by default; then one is printed.
        let shorter = command.trim().replace("--duration 1m", "--duration 20s");
        let shorter = shorter.replace("--calibrate", "--calibrate --duration 60s");
        let said = typed(&shorter, place, &search_path);
        let lines = said.lines().count();
        if command.contains(" record ") {
            assert!(lines <= 16, "{lines} lines: {said}");
        }
        next = said
            .lines()
            .next_back()
            .filter(is_command)
            .map(str::to_owned);
        typed_commands.push(command.trim().to_owned());
    }
    let words = |command: &String| command.split(' ').nth(1).unwrap().to_owned();
    let order: Vec<String> = typed_commands.iter().map(words).collect();
    assert_eq!(
        order,
        ["doctor", "record", "record", "extract"],
        "{typed_commands:?}"
    );
    assert!(typed_commands[1].contains("--calibrate"));
    let recording = typed_commands[3].split(' ').nth(2).unwrap();
    let data = place.join(format!("{recording}-euroc/mav0"));
    for camera in ["cam0", "depth0"] {
        let images = std::fs::read_dir(data.join(camera).join("data")).unwrap();
        assert!(images.count() > 200, "{camera}: {typed_commands:?}");
    }
    let session = SessionFile::load(&place.join(recording)).unwrap();
    assert!(
        session
            .profile
            .phone
            .learnt
            .as_ref()
            .unwrap()
            .skew
            .is_some()
    );
    is_near_truth(&session, &place.join("truth.csv"));
}
