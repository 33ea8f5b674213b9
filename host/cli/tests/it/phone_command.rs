//! `smartdepthsync phone …` as a process against a phone with a script: what is asked,
//! printed and saved. The faults of a phone are those of the client's own tests.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::Command;
use std::sync::mpsc::channel;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::support;
use test_support::interrupts::PATIENCE;

/// A phone that answers requests on one connection with a script. As the app does, it
/// answers an empty line with an error; its sensors are free.
struct Fake {
    address: String,
    /// Ends with the first request that the script was asked for.
    thread: JoinHandle<String>,
}

impl Fake {
    fn new(script: impl FnMut(&mut TcpStream) + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let thread = std::thread::spawn(move || serve(&listener.accept().unwrap().0, script));
        Self { address, thread }
    }

    fn answers(bytes: impl Into<Vec<u8>>) -> Self {
        Self::answers_after(bytes, Duration::ZERO)
    }

    fn answers_after(bytes: impl Into<Vec<u8>>, time: Duration) -> Self {
        let bytes = bytes.into();
        Self::new(move |stream| {
            std::thread::sleep(time);
            let _ = stream.write_all(&bytes);
        })
    }
}

/// Serves one client until it leaves.
fn serve(mut stream: &TcpStream, mut script: impl FnMut(&mut TcpStream)) -> String {
    let mut writer = stream.try_clone().unwrap();
    let mut asked = String::new();
    for line in BufReader::new(&mut stream).lines() {
        let Ok(line) = line else { break };
        if line.is_empty() {
            let _ = writer.write_all(b"ERROR\nv.0.1.1\nInvalid request\nend\n");
        } else if line.contains("&accel=1&") {
            let _ = writer.write_all(b"SUCCESS\nv.0.1.1\nend\n");
        } else {
            if asked.is_empty() {
                asked = line;
            }
            script(&mut writer);
        }
    }
    asked
}

/// The address of a phone whose video never ends, for any number of clients.
pub(crate) fn endless() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for client in listener.incoming() {
            serve(&client.unwrap(), |stream| {
                let head = format!("{HEAD}{}\nVID.mp4\nend\n", 1_u64 << 35);
                let mut going = stream.write_all(head.as_bytes());
                while going.is_ok() {
                    going = stream.write_all(&[0; 1 << 20]);
                }
            });
        }
    });
    address
}

struct Run {
    code: Option<i32>,
    stdout: String,
    stderr: String,
    request: String,
}

fn run(fake: Fake, arguments: &[&str], folder: &Path) -> Run {
    // A program that hangs is ended, with exit code 124.
    let output = Command::new("timeout")
        .args(["30", env!("CARGO_BIN_EXE_smartdepthsync"), "phone"])
        .args(arguments)
        .args(["--phone", &fake.address, "--timeout", "20s"])
        .current_dir(folder)
        .output()
        .unwrap();
    Run {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
        request: fake.thread.join().unwrap(),
    }
}

const HEAD: &str = "SUCCESS\nv.0.1.1\n";

#[test]
fn a_good_answer_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let answer = format!("{HEAD}949113215987860\n3.3330652542372882E7\n1000000\nend\n");
    let fake = Fake::answers_after(answer, Duration::from_secs(2));
    let run = run(fake, &["start", "--json"], folder.path());
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(run.request, "video_start");
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(json["phase_ns"], 949_113_215_987_860_i64);
    let duration = json["frame_duration_ns"].as_f64().unwrap();
    assert!(
        (duration - 33_330_652.542_372_882).abs() < 1e-6,
        "{duration}"
    );
    assert_eq!(json["exposure_ns"], 1_000_000);
    assert_eq!(json["app_version"], "v.0.1.1");
}

fn video(size: usize, name: &str, bytes: usize) -> Vec<u8> {
    let mut all = format!("{HEAD}{size}\n{name}\nend\n").into_bytes();
    all.extend((0..bytes).map(|i| (i % 251) as u8));
    all
}

#[test]
fn a_whole_video_is_saved() {
    let folder = tempfile::tempdir().unwrap();
    let run = run(
        Fake::answers(video(300_000, "VID_1.mp4", 300_000)),
        &["get-video", "--recorded", "--json"],
        folder.path(),
    );
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    let saved = std::fs::read(folder.path().join("VID_1.mp4")).unwrap();
    let expected: Vec<u8> = (0..300_000).map(|i| (i % 251) as u8).collect();
    assert!(saved == expected);
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(json["bytes"], 300_000);
}

#[test]
fn nothing_is_overwritten_unless_asked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mp4");
    std::fs::write(&path, "precious").unwrap();
    let get = |arguments: &[&str]| {
        run(
            Fake::answers(video(5, "x.mp4", 5)),
            arguments,
            folder.path(),
        )
    };
    let refused = get(&["get-video", "--recorded"]);
    assert_eq!(refused.code, Some(13), "{}", refused.stderr);
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    let done = get(&["get-video", "--recorded", "--overwrite"]);
    assert_eq!(done.code, Some(0), "{}", done.stderr);
    assert_eq!(std::fs::read(&path).unwrap(), [0, 1, 2, 3, 4]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn imu_recordings_are_saved_as_they_came() {
    let folder = tempfile::tempdir().unwrap();
    let answer = format!("{HEAD}agyro.csv\n1,2,-1.0E-4,4\n1,2,3,2000004\nsensor_end\nend\n");
    let arguments = ["imu", "--duration", "0.1s", "--out", "gyro.csv", "--json"];
    let run = run(Fake::answers(answer), &arguments, folder.path());
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    let saved = std::fs::read_to_string(folder.path().join("gyro.csv")).unwrap();
    assert_eq!(saved, "1,2,-0.0001,4\n1,2,3,2000004\n");
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(json["rate_hz"], 500.0);
}

#[test]
fn interrupt_ends_a_request() {
    let (asks, asked) = channel();
    let fake = Fake::new(move |_| {
        let _ = asks.send(());
    });
    let child = support::program(&[
        "phone",
        "imu",
        "--duration",
        "60s",
        "--phone",
        &fake.address,
    ])
    .spawn()
    .unwrap();
    asked.recv_timeout(PATIENCE).unwrap();
    let killed = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .unwrap();
    assert!(killed.success());
    let begin = Instant::now();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    // Of a minute.
    assert!(begin.elapsed() < Duration::from_secs(20));
}
