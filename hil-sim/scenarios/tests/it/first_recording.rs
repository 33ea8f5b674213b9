//! `docs/first-recording.md`, followed command by command on `hil-sim serve`: from its first
//! to a data set with pictures.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use crate::support;
use protocol::Ticks;
use recording::finding::Severity;
use recording::profile::Profile;
use recording::session_file::SessionFile;
use test_support::documents::Code;
use test_support::root;

/// A rig that waits for commands, and what it said at first.
struct Served {
    child: Child,
    port: String,
    phone: String,
    search_path: String,
    commands: Vec<String>,
}

impl Served {
    fn start(folder: &Path) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_hil-sim"))
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
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut value = |name: &str| {
            let line = lines.next().unwrap().unwrap();
            line.strip_prefix(name)
                .unwrap_or_else(|| panic!("{line}"))
                .to_owned()
        };
        let (port, phone) = (value("port: "), value("phone: "));
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
            port,
            phone,
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

/// Adds what the documented commands cannot know of this rig, and a shorter recording.
fn on_this_rig(command: &str, rig: &Served, recorder: &str) -> Vec<String> {
    let mut words: Vec<String> = command.split_whitespace().map(str::to_owned).collect();
    let mut add = |more: &[&str]| words.extend(more.iter().map(|word| (*word).to_owned()));
    match command.split_whitespace().nth(1).unwrap() {
        "setup" => {
            // What is found by itself on hardware, and the answers.
            add(&[
                "--port",
                &rig.port,
                "--phone",
                &rig.phone,
                "--recorder",
                recorder,
            ]);
            add(&["--name", "simulated", "--yes"]);
        }
        "record" if command.contains("--calibrate") => {
            add(&["--yes", "--duration", "60s"]);
        }
        "record" => add(&["--yes"]),
        _ => {}
    }
    words
        .iter()
        .map(|word| {
            if word == "5m" {
                "8s".to_owned()
            } else {
                word.clone()
            }
        })
        .collect()
}

#[test]
fn the_page_is_followed_to_a_data_set() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    // Built if need be.
    support::smartdepthsync();
    let rig = Served::start(place);
    let owner = Profile::load(&place.join("owner.toml")).unwrap();
    let recorder = owner.depth.recorder.command.join(" ");

    let page = root().join("docs/first-recording.md");
    let page = std::fs::read_to_string(page).unwrap();
    let code = Code::of(&page);
    let commands: Vec<&str> = code.lines.iter().map(String::as_str).collect();
    assert_eq!(commands.len(), 5, "{commands:?}");
    let mut said = String::new();
    for command in commands {
        let words = on_this_rig(command, &rig, &recorder);
        let output = Command::new(&words[0])
            .args(&words[1..])
            .current_dir(place)
            .env("PATH", &rig.search_path)
            .env("HOME", place)
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        assert_eq!(output.status.code(), Some(0), "{words:?}: {text}");
        said += &text;
    }
    // `setup` names the next command, `record` what it learnt and the next one.
    assert!(said.contains("smartdepthsync record --calibrate"), "{said}");
    assert!(said.contains("frame period"), "{said}");
    let profile = Profile::load(&place.join("rig.toml")).unwrap();
    assert!(profile.phone.learnt.unwrap().skew.is_some());

    let recordings = place.join("recordings");
    let mut found: Vec<PathBuf> = std::fs::read_dir(&recordings)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    found.sort();
    let [_, recording, data] = found.as_slice() else {
        panic!("{found:?}");
    };
    assert!(
        said.contains(&format!(
            "smartdepthsync extract recordings/{}",
            name(recording)
        )),
        "{said}"
    );
    assert_eq!(name(data), format!("{}-euroc", name(recording)));
    for camera in ["cam0", "depth0"] {
        let images = std::fs::read_dir(data.join("mav0").join(camera).join("data"));
        let count = images
            .unwrap_or_else(|error| panic!("{camera}: {error}; {said}"))
            .count();
        assert!(count > 200, "{count} pictures of {camera}");
    }

    // The verdict: all is there; what nobody has measured is said, in the same words
    // everywhere.
    let session = SessionFile::load(recording).unwrap();
    let judged = report::session::summary(recording, &session);
    let verdicts: Vec<Severity> = judged.parts.iter().map(|part| part.severity).collect();
    assert_eq!(verdicts[0], Severity::Good, "{judged:?}");
    assert_eq!(verdicts[1], Severity::Check, "{judged:?}");
    let bias = &judged.parts[1];
    assert!(
        bias.text.contains("constant bias: not measured"),
        "{bias:?}"
    );
    is_near_truth(&session, &place.join("truth.csv"));
    let html = std::fs::read_to_string(recording.join("report.html")).unwrap();
    assert!(
        said.contains(&bias.text) && html.contains(&bias.text),
        "{said}"
    );
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
            let sigma_s = clock.offset_at(at.into()).sigma.hypot(delay_s);
            assert!(error_s.abs() < 5.0 * sigma_s, "{error_s} {sigma_s}");
            compared += 1;
        }
    }
    assert!(compared > 4, "{text}");
}

/// Types a command as a person does, with Enter at each question; gives what it printed.
fn typed(command: &str, place: &Path, rig: &Served) -> String {
    let mut child = Command::new("sh")
        .args(["-c", command])
        .current_dir(place)
        .env("PATH", &rig.search_path)
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

/// From `serve` on, nothing but the last line that was printed: it calibrates, records, and
/// ends in a data set.
#[test]
fn what_is_printed_last_leads_to_a_data_set() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    support::smartdepthsync();
    let rig = Served::start(place);
    let is_command = |line: &&str| line.trim_start().starts_with("smartdepthsync ");
    let commands = rig.commands.iter().map(String::as_str);
    let mut next = commands.rev().find(is_command).map(str::to_owned);
    let mut typed_commands = Vec::new();
    while let Some(command) = next.filter(|_| typed_commands.len() < 8) {
        let said = typed(command.trim(), place, &rig);
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
    let last = &typed_commands[3];
    let data = place.join(format!("{}-euroc", last.split(' ').nth(2).unwrap()));
    let images = std::fs::read_dir(data.join("mav0/cam0/data")).unwrap();
    assert!(images.count() > 200, "{typed_commands:?}");
}

fn name(path: &Path) -> String {
    path.file_name().unwrap().to_string_lossy().into_owned()
}
