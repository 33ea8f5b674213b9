//! The sentences of the program: bad input of every command ends with its exit code, a
//! message that names what is wrong, and a next step that fits. No other test compares
//! sentences.

use std::ffi::OsStr;
use std::fmt::Debug;
use std::fs;
use std::os::unix::ffi::OsStrExt as _;
use std::path::Path;
use std::process::Command;

use clap::CommandFactory as _;
use protocol::{Answer, DeviceToHost, HostToDevice, Refusal};
use serde_json::Value;
use smartdepthsync::cli::Cli;

use crate::support::{self, StandIn, polite};
use test_support::TestFolder;
use test_support::board::frame;
use test_support::processes::Ran;

/// Command lines, in a folder with the files that [`files`] makes: exit code, command line,
/// a word of the message, a word of the next step.
const CASES: &str = "\
2 | board list --no-such-option | --no-such-option | help COMMAND
# Boards that are not there, and ports that are none.
5 | board info --port /no/such/port | /no/such/port | smartdepthsync board list
8 | board info --port text.txt | text.txt | serial port
5 | board test --port /no/such/port | /no/such/port | smartdepthsync board list
2 | board test --clock-time soon | 90s, 5m or 1h | help COMMAND
5 | board imu --port /no/such/port | /no/such/port | smartdepthsync board list
5 | monitor --port /no/such/port | /no/such/port | smartdepthsync board list
5 | board trigger start --port /no/such/port | /no/such/port | board list
5 | board trigger align --anchor 5 --port /no/such/port | /no/such/port | board list
2 | board trigger period | --fps | board trigger period --fps 30
2 | board trigger start --period 999us | 1 ms and 1 s | help COMMAND
2 | board trigger start --period 33333 | 33330.652us | help COMMAND
2 | board trigger start --fps fast | a decimal number | help COMMAND
2 | board trigger start --fps 30 --period 33333us | cannot be used with | help COMMAND
2 | board imu --duration soon | 90s, 5m or 1h | help COMMAND
5 | board trigger stop --port /no/such/port | /no/such/port | board list
5 | board trigger status --port /no/such/port | /no/such/port | board list
5 | board pps start --port /no/such/port | /no/such/port | board list
5 | board pps stop --port /no/such/port | /no/such/port | board list
5 | board pps status --port /no/such/port | /no/such/port | board list
# Phones.
12 | phone imu --phone 127.0.0.1:1 | 127.0.0.1:1 | remote control
12 | phone start --phone 127.0.0.1:1 | 127.0.0.1:1 | remote control
2 | phone stop --phone 127.0.0.1:port | 127.0.0.1:port | <host>:<port>
2 | phone get-video --phone 127.0.0.1:1 | --recorded | help phone
12 | phone get-video --recorded --phone 127.0.0.1:1 | 127.0.0.1:1 | remote control
2 | phone get-files --phase word | --phase | help COMMAND
# Sessions.
5 | record --port /no/such/port | /no/such/port | board list
2 | record --track often | always | help COMMAND
13 | record --profile nothing.toml | nothing.toml | profile init
2 | record --profile text.txt | text.txt | profile check
2 | record --profile wrong.toml | line 2: unknown field `no_such_key` | profile check wrong.toml
2 | record --twists 9 | 1..=5 | help COMMAND
2 | record --duration 0s | more than 0 s | help COMMAND
2 | record --marker soon | 90s, 5m or 1h | help COMMAND
# Files of two gyroscopes.
2 | profile init new.toml --camera azure-kinect-dk --exposure 5ms | cannot be set | option out
# Videos.
13 | evaluate precision nothing.mp4 | nothing.mp4 | check the path
2 | evaluate precision text.txt | text.txt | give a video
2 | evaluate precision folder --region 1,2 | X,Y,WIDTH,HEIGHT | help COMMAND
2 | evaluate precision --train x folder | nfov | help COMMAND
2 | evaluate precision --rotation 45 folder | 90 | help COMMAND
2 | evaluate drift --from 3s --to 2s folder | before the end | help evaluate
2 | evaluate drift --row-time nan folder | 33330.652us | help COMMAND
13 | evaluate precision text.txt --calibrate nothing.toml | nothing.toml | smartdepthsync setup
13 | evaluate drift nothing.mp4 | nothing.mp4 | check the path
2 | evaluate drift text.txt | text.txt | give a video
2 | evaluate drift folder | no video in this folder | the phone's video itself
# The board.
2 | board flash --board nucleo | black-pill | help COMMAND
# Profiles.
13 | profile init text.txt | text.txt | not taken
13 | profile init no/such/folder/rig.toml | no/such | check the path
2 | profile init new.toml --camera kinect | expected azure-kinect-dk, femto-bolt | help
2 | profile init new.toml --camera oak --depth-mode NFOV_UNBINNED | 800P | another --camera
13 | profile check nothing.toml | nothing.toml | profile init
2 | profile check wrong.toml | no_such_key | profile check
13 | profile learn folder --profile nothing.toml --timestamps gyro.csv | nothing.toml | the path
13 | profile learn nothing --profile wrong.toml --timestamps gyro.csv | nothing | check the
13 | profile import-kalibr nothing.toml wrong.toml | nothing.toml | the path
# Recordings.
13 | extract nothing | nothing | folder of a recording
2 | extract folder | recording.mcap | `record` made
13 | extract broken.mcap | broken.mcap | copied in full
2 | extract broken.mcap --out folder/text | not empty | --out
13 | verify nothing | nothing | check the
2 | verify folder | recording.mcap | `record` made
13 | verify broken.mcap | broken.mcap | verify
# Which recording.
2 | verify | which recording | smartdepthsync record
2 | verify wrong.toml | found neither | `record` made
2 | extract wrong.toml | found neither | `record` made
# What is there is not overwritten.
13 | evaluate precision folder --out text.txt | not overwritten | --overwrite
13 | evaluate drift folder --out text.txt | not overwritten | --overwrite
# Profiles that are made and taught.
2 | setup --yes | address | help setup
2 | setup --yes --phone my/phone | not a host name | <host>:<port>
13 | setup --yes --phone x --profile text.txt | text.txt | --overwrite
2 | setup --yes --phone x --depth-mode NFOV | WFOV_UNBINNED | another --camera
2 | record --calibrate | no rig profile | smartdepthsync setup
2 | record --calibrate --profile plain.toml --duration 30s | a minute | 60s or more
# The rest.
13 | man text.txt/man1 | text.txt | give a folder
";

/// A line of [`CASES`].
struct Case {
    code: i32,
    line: &'static str,
    message: &'static str,
    step: &'static str,
}

fn cases() -> impl Iterator<Item = Case> {
    let lines = CASES.lines().filter(|line| !line.starts_with('#'));
    lines.map(|row| match *row.split(" | ").collect::<Vec<_>>() {
        [code, line, message, step] => Case {
            code: code.parse().unwrap(),
            line,
            message,
            step,
        },
        _ => panic!("no case: {row}"),
    })
}

/// Commands that cannot fail by what they are given, beyond the command line.
const HARMLESS: [&str; 2] = ["completions", "doctor"];

fn files(folder: &Path) {
    let write = |name: &str, text: &[u8]| fs::write(folder.join(name), text).unwrap();
    write("text.txt", b"This is a text.\nIt has two lines.\n");
    write("binary.bin", &[0xFF, 0xFE, 0, 1, 2, 3, 0x80]);
    write("empty.csv", b"");
    write("broken.mcap", b"this is not a recording at all");
    write("wrong.toml", b"[phone]\nno_such_key = 1\n");
    write("plain.toml", b"[phone]\naddress = \"127.0.0.1:1\"\n");
    let mut gyro = String::from("t,x,y,z\n");
    for k in 0..400 {
        gyro.push_str(&format!("{},0.1,0.2,0.3\n", f64::from(k) * 0.002));
    }
    write("gyro.csv", gyro.as_bytes());
    fs::create_dir_all(folder.join("folder/text")).unwrap();
    write("folder/text/notes", b"notes");
}

fn run<A: AsRef<OsStr> + Debug>(folder: &Path, arguments: &[A]) -> Ran {
    let mut command = Command::new(env!("CARGO_BIN_EXE_smartdepthsync"));
    let output = Ran::new(command.args(arguments).current_dir(folder));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!said.contains("panicked"), "{output:?}");
    output
}

#[test]
fn bad_input_of_every_command_has_a_next_step_that_fits() {
    let folder = TestFolder::new();
    files(folder.path());
    let mut wrong = Vec::new();
    for Case {
        code,
        line,
        message,
        step,
    } in cases()
    {
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
    let folder = TestFolder::new();
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
fn no_command_is_left_out() {
    let mut cli = Cli::command();
    cli.build();
    let commands = support::commands(&cli, "");
    let leaves = commands.iter().filter(|(_, it)| !it.has_subcommands());
    for (leaf, _) in leaves {
        let of_leaf = |case: Case| format!("{} ", case.line).starts_with(&format!("{leaf} "));
        let tried = cases().any(of_leaf) || HARMLESS.contains(&leaf.as_str());
        assert!(tried, "no bad input of `{leaf}`");
    }
    assert!(commands.len() > 25, "{commands:?}");
}

/// The advice after a refusal of the board depends on its reason.
#[test]
fn a_refusal_names_the_bounds_or_the_command_that_changes_the_state() {
    for (refusal, arguments, message, step) in [
        (
            Refusal::WidthOutOfRange {
                min: 240,
                max: 47_760,
            },
            &["board", "trigger", "start", "--width", "2ms"][..],
            "5.000 µs to 995.000 µs",
            "within the bounds",
        ),
        (
            Refusal::TriggerRunning,
            &["board", "trigger", "start"],
            "",
            "`smartdepthsync board trigger stop`",
        ),
        (
            Refusal::TriggerStopped,
            &["board", "trigger", "align", "--anchor", "44", "--fps", "30"],
            "",
            "`smartdepthsync board trigger start`",
        ),
        (
            Refusal::GnssRunning,
            &["board", "pps", "start"],
            "",
            "`smartdepthsync board pps stop`",
        ),
        (
            Refusal::NotOnThisBoard,
            &["board", "trigger", "start", "--output", "2"],
            "no outputs 2 to 4",
            "STM32F4DISCOVERY",
        ),
    ] {
        let board = StandIn::new(move |command: HostToDevice| match command.command {
            protocol::Command::SayHello(_) => polite(command),
            _ => frame(&DeviceToHost::Answer(Answer {
                id: command.id,
                result: Err(refusal),
            })),
        });
        let line = [arguments, &["--json", "--port", &board.path]].concat();
        let output = support::run(&line);
        assert_eq!(output.status.code(), Some(3), "{line:?}: {output:?}");
        let error = &serde_json::from_slice::<Value>(&output.stdout).unwrap()["error"];
        let says = |key: &str, word: &str| error[key].as_str().unwrap().contains(word);
        assert!(
            says("message", message) && says("next_step", step),
            "{error}"
        );
    }
}
