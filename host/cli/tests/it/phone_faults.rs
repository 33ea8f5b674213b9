//! `smartdepthsync phone …` as a process against phones that do not keep to the
//! protocol: each fault must end soon, with its own clear error, the phone's
//! exit code, and nothing left on the disk.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::mpsc::channel;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use assert_cmd::Command;

use crate::support::interrupts::PATIENCE;

/// A phone that answers requests on one connection with a script. Like the app, it
/// answers an empty line with an error; its sensors are free (the program asks for 1 and
/// 300 ms of them), and whoever comes later is told that the video is stopped.
struct Fake {
    address: String,
    thread: JoinHandle<String>,
}

const INVALID: &[u8] = b"ERROR\nv.0.1.1\nInvalid request\nend\n";
const DONE: &[u8] = b"SUCCESS\nv.0.1.1\nend\n";

impl Fake {
    fn new(mut script: impl FnMut(&mut TcpStream) -> Then + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let thread = std::thread::spawn(move || {
            let (stream, _) = listener.accept().unwrap();
            let mut asked = String::new();
            serve(stream, |request, stream| {
                if asked.is_empty() {
                    asked.push_str(request);
                }
                script(stream)
            });
            std::thread::spawn(move || {
                while let Ok((stream, _)) = listener.accept() {
                    serve(stream, |_, stream| {
                        let _ = stream.write_all(DONE);
                        Then::Stay
                    });
                }
            });
            asked
        });
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
            Then::Stay
        })
    }

    /// As [`Fake::answers`], but the connection is closed behind the bytes.
    fn answers_and_leaves(bytes: impl Into<Vec<u8>>) -> Self {
        let bytes = bytes.into();
        Self::new(move |stream| {
            let _ = stream.write_all(&bytes);
            Then::Leave
        })
    }
}

/// What a phone does behind an answer.
#[derive(PartialEq)]
enum Then {
    Stay,
    Leave,
}

/// Serves one client until it leaves, or `answer` does.
fn serve(stream: TcpStream, mut answer: impl FnMut(&str, &mut TcpStream) -> Then) {
    let mut writer = stream.try_clone().unwrap();
    // The client leaves first where it has seen enough.
    let _ = stream.set_read_timeout(Some(Duration::from_secs(8)));
    let mut reader = BufReader::new(stream);
    let mut line = String::new();
    while reader.read_line(&mut line).is_ok_and(|count| count > 0) {
        let then = if line == "\n" {
            let _ = writer.write_all(INVALID);
            Then::Stay
        } else if line.contains("&accel=1&gyro=1&magnetic=0") && !line.contains("=100&") {
            let _ = writer.write_all(DONE);
            Then::Stay
        } else {
            answer(&line, &mut writer)
        };
        if then == Then::Leave {
            return;
        }
        line.clear();
    }
}

struct Run {
    code: Option<i32>,
    stdout: String,
    stderr: String,
    request: String,
    took: Duration,
}

fn run(fake: Fake, arguments: &[&str], folder: &Path) -> Run {
    run_patiently(fake, arguments, folder, "20")
}

fn run_patiently(fake: Fake, arguments: &[&str], folder: &Path, patience: &str) -> Run {
    let begin = Instant::now();
    let output = Command::cargo_bin("smartdepthsync")
        .unwrap()
        .arg("phone")
        .args(arguments)
        .args(["--phone", &fake.address, "--timeout", patience])
        .current_dir(folder)
        .timeout(Duration::from_secs(30))
        .output()
        .unwrap();
    let took = begin.elapsed();
    Run {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
        request: fake.thread.join().unwrap(),
        took,
    }
}

/// The run fails as a phone's fault, says `words`, and leaves nothing behind.
fn fails(fake: Fake, arguments: &[&str], words: &[&str]) -> Run {
    fails_within(fake, arguments, words, "20")
}

/// As [`fails`], with a patience of so many seconds.
fn fails_within(fake: Fake, arguments: &[&str], words: &[&str], patience: &str) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let run = run_patiently(fake, arguments, folder.path(), patience);
    assert_eq!(run.code, Some(12), "{}", run.stderr);
    for word in words {
        assert!(run.stderr.contains(word), "{word:?} not in: {}", run.stderr);
    }
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");
    assert!(run.took < Duration::from_secs(10), "{:?}", run.took);
    run
}

const HEAD: &str = "SUCCESS\nv.0.1.1\n";

#[test]
fn a_good_answer_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let answer = format!("{HEAD}949113215987860\n3.3330652542372882E7\n1000000\nend\n");
    let fake = Fake::answers_after(answer.clone(), Duration::from_secs(2));
    let run = run(fake, &["start", "--json"], folder.path());
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(run.request, "video_start\n");
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(json["phase_ns"], 949_113_215_987_860_i64);
    let duration = json["frame_duration_ns"].as_f64().unwrap();
    assert!(
        (duration - 33_330_652.542_372_882).abs() < 1e-6,
        "{duration}"
    );
    assert_eq!(json["exposure_ns"], 1_000_000);
    assert_eq!(json["app_version"], "v.0.1.1");

    // Sooner than the frames can be, it is of another video.
    let words = ["of another video", "told to stop", "run it again"];
    fails(Fake::answers(answer), &["start"], &words);
}

#[test]
fn no_phone() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    drop(listener);
    let output = Command::cargo_bin("smartdepthsync")
        .unwrap()
        .args(["phone", "stop", "--phone", &address])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(12));
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(stderr.contains("same network"), "{stderr}");
}

#[test]
fn bad_command_lines() {
    for arguments in [
        &["phone", "stop"][..],
        &["phone", "stop", "--phone", "http://x"],
        &["phone", "imu", "--seconds", "0", "--phone", "127.0.0.1"],
        &["phone", "imu", "--no-gyro", "--phone", "127.0.0.1:1"],
        // The app may end at this request.
        &["phone", "get-video", "--phone", "127.0.0.1:1"],
    ] {
        let output = Command::cargo_bin("smartdepthsync")
            .unwrap()
            .args(arguments)
            .output()
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {stderr}");
    }
}

#[test]
fn not_the_app() {
    let http = "HTTP/1.1 400 Bad Request\r\n\r\n";
    fails(
        Fake::answers(http),
        &["stop"],
        &["SUCCESS or ERROR", "HTTP/1.1"],
    );
    let noise: Vec<u8> = (0..100_000u32).map(|i| ((i * 7919) >> 3) as u8).collect();
    fails(Fake::answers(noise), &["stop"], &["damaged"]);
}

#[test]
fn another_version() {
    let answer = "SUCCESS\nv.0.1.2\nend\n";
    fails(
        Fake::answers(answer),
        &["stop"],
        &["v.0.1.2", "v.0.1.1", "install"],
    );
    // Before versions were sent, the body came at once.
    fails(Fake::answers("SUCCESS\nend\n"), &["stop"], &["\"end\""]);
}

#[test]
fn a_refusal_is_given_in_the_phone_s_words() {
    let busy = "ERROR\nv.0.1\nError in IMU recording\nend\n";
    let run = fails(
        Fake::answers(busy),
        &["imu", "--seconds", "0.1"],
        &["Error in IMU recording", "stop the video"],
    );
    assert_eq!(run.request, "imu?duration=100&accel=0&gyro=1&magnetic=0\n");
}

#[test]
fn cut_in_the_middle() {
    for (answer, request) in [
        ("", &["stop"][..]),
        ("SUCC", &["stop"]),
        ("SUCCESS\nv.0.1.1\nen", &["stop"]),
        ("SUCCESS\nv.0.1.1\nxgyro.csv\n1,2,3,4\n1,2", &["imu"]),
        ("ERROR\nv.0.1.1\nError in", &["imu"]),
        ("SUCCESS\nv.0.1.1\n100\n", &["get-video", "--recorded"]),
    ] {
        let mut arguments = request.to_vec();
        if request == ["imu"] {
            arguments.extend(["--seconds", "0.1"]);
        }
        fails(
            Fake::answers_and_leaves(answer),
            &arguments,
            &["closed the connection"],
        );
    }
}

#[test]
fn silent_or_slow() {
    let silent = Fake::answers("");
    let address = silent.address.clone();
    fails_within(silent, &["stop"], &["within 1s", &address], "1");
    // A byte now and then does not prolong the deadline.
    let trickle = Fake::new(|stream| {
        for _ in 0..100 {
            if stream.write_all(b"S").is_err() {
                break;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        Then::Leave
    });
    let run = fails_within(trickle, &["imu", "--seconds", "0.5"], &["within 1.5s"], "1");
    assert!(run.took >= Duration::from_millis(1400), "{:?}", run.took);
}

#[test]
fn endless() {
    fails(
        Fake::answers([HEAD.as_bytes(), &[b'x'; 4096]].concat()),
        &["stop"],
        &["longer than 1024 bytes"],
    );
    let lines = Fake::new(|stream| {
        let _ = stream.write_all(HEAD.as_bytes());
        while stream.write_all(&b"17\n".repeat(1000)).is_ok() {}
        Then::Leave
    });
    fails(lines, &["stop"], &["no end"]);
    let samples = Fake::new(|stream| {
        let _ = stream.write_all(format!("{HEAD}xgyro.csv\n").as_bytes());
        while stream.write_all(&b"1,2,3,4\n".repeat(1000)).is_ok() {}
        Then::Leave
    });
    fails(samples, &["imu", "--seconds", "0.1"], &["no end"]);
}

#[test]
fn damaged_bodies() {
    let imu = |body: &str| Fake::answers(format!("{HEAD}{body}end\n"));
    for (body, words) in [
        ("xgyro.csv\n1,2,NaN,4\nsensor_end\n", "x,y,z,timestamp_ns"),
        ("xgyro.csv\n1,2,3,4\n", "sensor_end"),
        ("xgyro.csv\n1,2,3,4\nyaccel.csv\n", "x,y,z,timestamp_ns"),
        ("", "gyroscope"),
        ("xaccel.csv\nsensor_end\n", "requested sensor"),
    ] {
        fails(imu(body), &["imu", "--seconds", "0.1"], &[words]);
    }
    for (body, words) in [
        ("x\n3.3E7\n", "phase"),
        ("17\nInfinity\n", "frame duration"),
        ("17\n", "frame duration"),
    ] {
        fails(imu(body), &["start"], &[words]);
    }
    for (body, words) in [
        ("-1\nx.mp4\n", "size"),
        ("0\nx.mp4\n", "size"),
        ("99999999999999999999999\nx.mp4\n", "size"),
        ("5\n", "name"),
        ("99999999999999\nx.mp4\n", "limit"),
    ] {
        fails(imu(body), &["get-video", "--recorded"], &[words]);
    }
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
fn hostile_names_stay_in_the_folder() {
    let long = "x".repeat(900);
    for name in [
        "../../escape.mp4",
        "/tmp/escape.mp4",
        "..\\escape.mp4",
        "",
        &long,
        "..",
    ] {
        let outer = tempfile::tempdir().unwrap();
        let folder = outer.path().join("a").join("b");
        std::fs::create_dir_all(&folder).unwrap();
        let run = run(
            Fake::answers(video(10, name, 10)),
            &["get-video", "--recorded"],
            &folder,
        );
        assert_eq!(run.code, Some(0), "{name}: {}", run.stderr);
        let files: Vec<_> = std::fs::read_dir(&folder).unwrap().collect();
        assert_eq!(files.len(), 1, "{name}");
        assert_eq!(std::fs::read_dir(outer.path()).unwrap().count(), 1);
        assert_eq!(
            std::fs::read_dir(outer.path().join("a")).unwrap().count(),
            1
        );
        assert!(!Path::new("/tmp/escape.mp4").exists());
    }
}

#[test]
fn short_long_and_crawling_videos_are_not_saved() {
    let short = Fake::answers_and_leaves(video(1000, "x.mp4", 999));
    fails(
        short,
        &["get-video", "--recorded"],
        &["999 of the video's 1000"],
    );
    fails_within(
        Fake::answers(video(1000, "x.mp4", 900)),
        &["get-video", "--recorded"],
        &["within 1s"],
        "1",
    );
    fails(
        Fake::answers(video(1000, "x.mp4", 1001)),
        &["get-video", "--recorded"],
        &["more than the 1000"],
    );
    let crawl = Fake::new(|stream| {
        let _ = stream.write_all(&video(100_000, "x.mp4", 10));
        while stream.write_all(b"x").is_ok() {
            std::thread::sleep(Duration::from_millis(50));
        }
        Then::Leave
    });
    // A busy machine may pause for as long as the phone; it is given up after twice that.
    fails_within(crawl, &["get-video", "--recorded"], &["crawl"], "3");
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
    assert!(refused.stderr.contains("--overwrite"), "{}", refused.stderr);
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    let done = get(&["get-video", "--recorded", "--overwrite"]);
    assert_eq!(done.code, Some(0), "{}", done.stderr);
    assert_eq!(std::fs::read(&path).unwrap(), [0, 1, 2, 3, 4]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn imu_recordings_are_saved_as_they_came() {
    let folder = tempfile::tempdir().unwrap();
    let answer = format!(
        "{HEAD}aaccel.csv\n0.1,9.81,-1.0E-4,5\nsensor_end\nagyro.csv\n1,2,3,4\n1,2,3,2000004\nsensor_end\nend\n"
    );
    // The folder is not there yet.
    let arguments = [
        "imu",
        "--seconds",
        "0.1",
        "--accel",
        "--out",
        "twist/",
        "--json",
    ];
    let run = run(Fake::answers(answer), &arguments, folder.path());
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    let read = |name| std::fs::read_to_string(folder.path().join("twist").join(name)).unwrap();
    assert_eq!(read("gyro.csv"), "1,2,3,4\n1,2,3,2000004\n");
    assert_eq!(read("accel.csv"), "0.1,9.81,-0.0001,5\n");
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(json["sensors"][1]["rate_hz"], 500.0);
}

#[cfg(unix)]
#[test]
fn interrupt_ends_a_request() {
    let (asks, asked) = channel();
    let fake = Fake::new(move |_| {
        let _ = asks.send(());
        Then::Stay
    });
    let child = std::process::Command::new(assert_cmd::cargo::cargo_bin("smartdepthsync"))
        .args(["phone", "imu", "--seconds", "60", "--phone", &fake.address])
        .spawn()
        .unwrap();
    asked.recv_timeout(PATIENCE).unwrap();
    let killed = std::process::Command::new("kill")
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
