//! Bad input of every command: the exit code, a message that names what is wrong, and
//! a next step that fits.

use std::ffi::OsStr;
use std::fmt::Debug;
use std::fs;
use std::os::unix::ffi::OsStrExt as _;
use std::path::Path;
use std::process::{Command, Output};

use clap::CommandFactory as _;
use serde_json::Value;
use smartdepthsync::cli::Cli;

/// A command line, its exit code, and a word of the message and of the next step.
type Case = (&'static str, i32, &'static str, &'static str);

/// In a folder with the files that [`files`] makes.
const CASES: &[Case] = &[
    // Boards that are not there, and ports that are none.
    (
        "info --port /no/such/port",
        5,
        "/no/such/port",
        "smartdepthsync ports",
    ),
    ("info --port text.txt", 8, "text.txt", "serial port"),
    (
        "bring-up --port /no/such/port",
        5,
        "/no/such/port",
        "smartdepthsync ports",
    ),
    (
        "bring-up --clock-time soon",
        2,
        "90s, 5m or 1h",
        "help COMMAND",
    ),
    (
        "imu --port /no/such/port",
        5,
        "/no/such/port",
        "smartdepthsync ports",
    ),
    (
        "monitor --port /no/such/port",
        5,
        "/no/such/port",
        "smartdepthsync ports",
    ),
    (
        "monitor --foxglove 192.0.2.1:1",
        1,
        "192.0.2.1",
        "an address of this computer",
    ),
    (
        "trigger start --port /no/such/port",
        5,
        "/no/such/port",
        "smartdepthsync ports",
    ),
    (
        "trigger start --first-edge 9 --first-fraction 5",
        2,
        "outputs 2 to 4",
        "--output",
    ),
    (
        "trigger align --anchor 5 --port /no/such/port",
        5,
        "/no/such/port",
        "ports",
    ),
    ("trigger period", 2, "--fps", "trigger period --fps 30"),
    (
        "trigger latency --output 2",
        2,
        "output 1",
        "leave --output out",
    ),
    (
        "trigger stop --port /no/such/port",
        5,
        "/no/such/port",
        "ports",
    ),
    (
        "trigger status --port /no/such/port",
        5,
        "/no/such/port",
        "ports",
    ),
    (
        "gnss start --port /no/such/port",
        5,
        "/no/such/port",
        "ports",
    ),
    (
        "gnss stop --port /no/such/port",
        5,
        "/no/such/port",
        "ports",
    ),
    (
        "gnss status --port /no/such/port",
        5,
        "/no/such/port",
        "ports",
    ),
    // Phones.
    (
        "phone imu --phone 127.0.0.1:1",
        12,
        "127.0.0.1:1",
        "remote control",
    ),
    (
        "phone imu --phone 127.0.0.1:1 --no-gyro",
        2,
        "sensor",
        "help phone",
    ),
    (
        "phone start --phone 127.0.0.1:1",
        12,
        "127.0.0.1:1",
        "remote control",
    ),
    (
        "phone stop --phone 127.0.0.1:port",
        2,
        "127.0.0.1:port",
        "<host>:<port>",
    ),
    (
        "phone get-video --phone 127.0.0.1:1",
        2,
        "--recorded",
        "help phone",
    ),
    (
        "phone get-video --recorded --phone 127.0.0.1:1",
        12,
        "127.0.0.1:1",
        "remote control",
    ),
    ("phone get-files --phase word", 2, "--phase", "help COMMAND"),
    // Sessions.
    ("record --port /no/such/port", 5, "/no/such/port", "ports"),
    ("record --track --no-track", 2, "--no-track", "help COMMAND"),
    (
        "record --profile nothing.toml",
        13,
        "nothing.toml",
        "profile init",
    ),
    ("record --profile text.txt", 2, "text.txt", "profile check"),
    (
        "record --profile wrong.toml",
        2,
        "line 2: unknown field `no_such_key`",
        "profile check wrong.toml",
    ),
    ("record --twists 9", 2, "1..=5", "help COMMAND"),
    (
        "record --twist-gap soon",
        2,
        "90s, 5m or 1h",
        "help COMMAND",
    ),
    // Files of two gyroscopes.
    (
        "offset --mcu nothing.csv --phone gyro.csv",
        13,
        "nothing.csv",
        "check the path",
    ),
    (
        "offset --mcu gyro.csv --phone folder",
        13,
        "folder",
        "this is a folder",
    ),
    (
        "offset --mcu gyro.csv --phone text.txt",
        2,
        "text.txt",
        "x,y,z,nanoseconds",
    ),
    (
        "offset --mcu gyro.csv --phone binary.bin",
        2,
        "no text",
        "x,y,z,nanoseconds",
    ),
    (
        "offset --mcu empty.csv --phone gyro.csv",
        2,
        "empty.csv",
        "CSV",
    ),
    (
        "sync gyro.csv nothing.csv",
        13,
        "nothing.csv",
        "check the path",
    ),
    ("sync gyro.csv text.txt", 2, "text.txt", "x,y,z,nanoseconds"),
    ("sync gyro.csv", 2, "2 values required", "help COMMAND"),
    (
        "sync gyro.csv gyro.csv --delay-us 1,2,3",
        2,
        "3 values for 2 recordings",
        "one for each",
    ),
    ("imu --rate 4", 2, "from 5 to 1000", "help COMMAND"),
    (
        "profile init new.toml --camera azure-kinect-dk --depth-exposure-us 5000",
        2,
        "cannot be set",
        "leave the option out",
    ),
    // Videos.
    (
        "evaluate precision nothing.mp4",
        13,
        "nothing.mp4",
        "check the path",
    ),
    ("evaluate precision text.txt", 2, "text.txt", "give a video"),
    (
        "evaluate precision folder --region 1,2",
        2,
        "X,Y,WIDTH,HEIGHT",
        "help COMMAND",
    ),
    (
        "evaluate precision text.txt --calibrate nothing.toml",
        2,
        "nothing.toml",
        "profile check",
    ),
    (
        "evaluate drift nothing.mp4",
        13,
        "nothing.mp4",
        "check the path",
    ),
    ("evaluate drift text.txt", 2, "text.txt", "give a video"),
    ("evaluate drift folder", 2, "no images", "png"),
    // Profiles.
    ("profile init text.txt", 13, "text.txt", "not taken"),
    (
        "profile init no/such/folder/rig.toml",
        13,
        "no/such",
        "check the path",
    ),
    (
        "profile init new.toml --camera kinect",
        2,
        "expected azure-kinect-dk, femto-bolt",
        "help",
    ),
    (
        "profile init new.toml --camera oak --depth-mode NFOV_UNBINNED",
        2,
        "800P",
        "another --camera",
    ),
    (
        "profile check nothing.toml",
        13,
        "nothing.toml",
        "profile init",
    ),
    (
        "profile check wrong.toml",
        2,
        "no_such_key",
        "profile check",
    ),
    (
        "profile learn folder --profile nothing.toml --timestamps gyro.csv",
        13,
        "nothing.toml",
        "check the path",
    ),
    (
        "profile learn nothing --profile wrong.toml --timestamps gyro.csv",
        13,
        "nothing",
        "check the",
    ),
    (
        "profile import-kalibr nothing.toml wrong.toml",
        13,
        "nothing.toml",
        "check the path",
    ),
    // Recordings.
    ("extract nothing", 13, "nothing", "a bag"),
    ("extract folder", 2, "recording.mcap", "`record` made"),
    ("extract broken.mcap", 13, "broken.mcap", "copied in full"),
    (
        "extract broken.mcap --out folder/text",
        2,
        "not empty",
        "--out",
    ),
    ("verify nothing", 13, "nothing", "check the"),
    ("verify folder", 2, "recording.mcap", "`record` made"),
    ("verify broken.mcap", 13, "broken.mcap", "repair"),
    ("report nothing", 13, "nothing", "check the"),
    ("report folder", 2, "recording.mcap", "`record` made"),
    ("repair nothing new", 13, "nothing", "check the"),
    ("repair broken.mcap text.txt", 13, "text.txt", "not taken"),
    ("repair broken.mcap new.mcap", 13, "broken.mcap", "verify"),
    // Which recording.
    ("verify", 2, "which recording", "smartdepthsync record"),
    ("verify many", 2, "2 recordings", "many/"),
    ("extract many", 2, "2 recordings", "many/"),
    (
        "verify wrong.toml",
        2,
        "another kind of file",
        "`record` made",
    ),
    (
        "extract wrong.toml",
        2,
        "another kind of file",
        "`record` made",
    ),
    (
        "report wrong.toml",
        2,
        "another kind of file",
        "`record` made",
    ),
    // What is there is not overwritten.
    ("imu --csv text.txt", 13, "not overwritten", "--overwrite"),
    (
        "evaluate precision folder --report text.txt",
        13,
        "not overwritten",
        "--overwrite",
    ),
    (
        "evaluate drift folder --plot text.txt",
        13,
        "not overwritten",
        "--overwrite",
    ),
    // Profiles that are made and taught.
    ("setup --yes", 2, "address", "help setup"),
    (
        "setup --yes --phone x --profile text.txt",
        13,
        "text.txt",
        "--overwrite",
    ),
    (
        "setup --yes --phone x --depth-mode WFOV_UNBINNED --fps 30",
        2,
        "15, 5",
        "--depth-mode",
    ),
    (
        "record --calibrate",
        2,
        "no rig profile",
        "smartdepthsync setup",
    ),
    (
        "record --calibrate --profile plain.toml --duration 30s",
        2,
        "a minute",
        "60s or more",
    ),
    // The rest.
    ("man text.txt/man1", 13, "text.txt", "give a folder"),
];

/// Commands that cannot fail by what they are given, beyond the command line.
const HARMLESS: [&str; 3] = ["ports", "completions", "doctor"];

fn files(folder: &Path) {
    let write = |name: &str, text: &[u8]| fs::write(folder.join(name), text).unwrap();
    write("text.txt", b"This is a text.\nIt has two lines.\n");
    write("binary.bin", &[0xFF, 0xFE, 0, 1, 2, 3, 0x80]);
    write("empty.csv", b"");
    write("broken.mcap", b"this is no recording at all");
    write("wrong.toml", b"[phone]\nno_such_key = 1\n");
    write("plain.toml", b"[phone]\naddress = \"127.0.0.1:1\"\n");
    for name in ["many/one", "many/two"] {
        fs::create_dir_all(folder.join(name)).unwrap();
        write(&format!("{name}/recording.mcap"), b"");
    }
    let mut gyro = String::from("t,x,y,z\n");
    for k in 0..400 {
        gyro.push_str(&format!("{},0.1,0.2,0.3\n", f64::from(k) * 0.002));
    }
    write("gyro.csv", gyro.as_bytes());
    fs::create_dir_all(folder.join("folder/text")).unwrap();
    write("folder/text/notes", b"notes");
}

fn run<A: AsRef<OsStr> + Debug>(folder: &Path, arguments: &[A]) -> Output {
    let output = Command::new(env!("CARGO_BIN_EXE_smartdepthsync"))
        .args(arguments)
        .current_dir(folder)
        // No profile of whoever runs the tests.
        .env("HOME", folder)
        .env_remove("XDG_CONFIG_HOME")
        .env_remove("SMARTDEPTHSYNC_PROFILE")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!said.contains("panicked"), "{arguments:?}: {said}");
    output
}

#[test]
fn bad_input_of_every_command_has_a_next_step_that_fits() {
    let folder = tempfile::tempdir().unwrap();
    files(folder.path());
    let mut wrong = Vec::new();
    for &(line, code, message, step) in CASES {
        let mut arguments = vec!["--json"];
        arguments.extend(line.split(' '));
        let output = run(folder.path(), &arguments);
        let error = serde_json::from_slice::<Value>(&output.stdout).unwrap_or_default();
        let error = &error["error"];
        let text = |key: &str| error[key].as_str().unwrap_or_default().to_owned();
        let unknown = unknown_options(&text("next_step"), line);
        if !unknown.is_empty() {
            wrong.push(format!("{line} has no {unknown:?}, which it advises"));
        }
        if output.status.code() != Some(code)
            || !text("message").contains(message)
            || !text("next_step").contains(step)
            || error["exit_code"] != code
        {
            wrong.push(format!(
                "{line}\n  expected {code}: …{message}… / …{step}…\n  found {:?}: {error}",
                output.status.code()
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_path_that_is_no_text_is_written_to_all_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = OsStr::from_bytes(b"\xff");
    for command in [["profile", "init"].as_slice(), &["man"]] {
        let command = command.iter().map(OsStr::new);
        let command: Vec<&OsStr> = command.chain([path]).collect();
        let output = run(folder.path(), &command);
        assert!(output.status.success(), "{output:?}");
        let path = folder.path().join(path);
        let removed = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
        assert!(removed.is_ok(), "{command:?} wrote nothing");
    }
}

/// Options in an advice, outside of commands that are quoted, which the command of this
/// line does not have.
fn unknown_options(advice: &str, line: &str) -> Vec<String> {
    let mut command = Cli::command();
    command.build();
    for word in line.split(' ') {
        match command.find_subcommand(word) {
            Some(below) => command = below.clone(),
            None => break,
        }
    }
    let known: Vec<&str> = command
        .get_arguments()
        .filter_map(|a| a.get_long())
        .collect();
    let outside = advice.split('`').step_by(2);
    let is_part = |c: char| c.is_ascii_lowercase() || c == '-';
    outside
        .flat_map(|text| text.split(|c| !is_part(c)))
        .filter_map(|word| word.strip_prefix("--"))
        .filter(|option| !option.is_empty() && !known.contains(option))
        .map(str::to_owned)
        .collect()
}

#[test]
fn no_command_is_left_out_and_a_wrong_option_names_the_help() {
    let folder = tempfile::tempdir().unwrap();
    let mut cli = Cli::command();
    cli.build();
    let mut leaves = Vec::new();
    leaf_commands(&cli, &mut Vec::new(), &mut leaves);
    assert!(leaves.len() > 20, "{leaves:?}");
    for leaf in &leaves {
        let tried = CASES.iter().any(|(line, ..)| {
            line.strip_prefix(leaf.as_str())
                .is_some_and(|rest| rest.is_empty() || rest.starts_with(' '))
        });
        assert!(
            tried || HARMLESS.contains(&leaf.as_str()),
            "no bad input of `{leaf}`"
        );
        let mut arguments: Vec<&str> = leaf.split(' ').collect();
        arguments.push("--no-such-option");
        let output = run(folder.path(), &arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{leaf}: {said}");
        assert!(
            said.contains("--no-such-option") && said.contains("--help"),
            "{said}"
        );
    }
}

fn leaf_commands(command: &clap::Command, path: &mut Vec<String>, found: &mut Vec<String>) {
    let below: Vec<_> = command
        .get_subcommands()
        .filter(|below| below.get_name() != "help")
        .collect();
    if below.is_empty() {
        found.push(path.join(" "));
    }
    for command in below {
        path.push(command.get_name().to_owned());
        leaf_commands(command, path, found);
        path.pop();
    }
}

#[test]
fn doctor_says_what_to_do_about_each_check_that_is_not_good() {
    let folder = tempfile::tempdir().unwrap();
    files(folder.path());
    let output = run(
        folder.path(),
        &[
            "--json",
            "doctor",
            "--port",
            "/no/such/port",
            "--phone",
            "127.0.0.1:1",
        ],
    );
    assert_eq!(output.status.code(), Some(5), "{output:?}");
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let checks = found["checks"].as_array().unwrap();
    let bad: Vec<_> = checks
        .iter()
        .filter(|check| check["verdict"] != "good")
        .collect();
    assert!(bad.len() >= 2, "{found:#}");
    for check in bad {
        let step = check["next_step"].as_str().unwrap_or_default();
        assert!(step.len() > 10, "{check}");
        assert!(unknown_options(step, "doctor").is_empty(), "{check}");
    }
}
