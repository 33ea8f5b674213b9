//! The client against phones that do not keep to the protocol: each fault ends soon, with
//! its own error, and leaves no file behind.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::time::{Duration, Instant};

use phone::answer::MalformedAnswer;
use phone::task::{Phone as _, PhoneTask};
use phone::{PhoneClient, PhoneError, Settings};

const HEAD: &str = "SUCCESS\nv.0.1.1\n";
const DONE: &[u8] = b"SUCCESS\nv.0.1.1\nend\n";
const PATIENCE: Duration = Duration::from_secs(5);

/// A phone that answers each request with a script. As the app does, it answers an empty
/// line with an error, and its sensors are free for the shortest recording.
fn fake(script: impl Fn(&mut TcpStream) -> Then + Send + Sync + Clone + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        while let Ok((stream, _)) = listener.accept() {
            serve(stream, &script);
        }
    });
    address
}

/// Behaviour of a phone after an answer.
#[derive(Clone, Copy, PartialEq)]
enum Then {
    Stay,
    Leave,
}

fn serve(stream: TcpStream, script: impl Fn(&mut TcpStream) -> Then) {
    let mut writer = stream.try_clone().unwrap();
    let mut reader = BufReader::new(stream);
    let mut line = String::new();
    while reader.read_line(&mut line).is_ok_and(|count| count > 0) {
        if line == "\n" {
            let _ = writer.write_all(b"ERROR\nv.0.1.1\nInvalid request\nend\n");
        } else if line.contains("&accel=1&gyro=1&magnetic=0") || line == "video_stop\n" {
            let _ = writer.write_all(DONE);
        } else if script(&mut writer) == Then::Leave {
            return;
        }
        line.clear();
    }
}

fn answers(bytes: impl Into<Vec<u8>>, then: Then) -> String {
    let bytes = bytes.into();
    fake(move |stream| {
        let _ = stream.write_all(&bytes);
        then
    })
}

fn client(address: &str, margin: Duration) -> PhoneClient {
    let settings = Settings {
        margin,
        busy: Duration::ZERO,
        video_ready: margin,
        ..Settings::default()
    };
    PhoneClient::connect(address, settings).unwrap()
}

fn imu(address: &str, margin: Duration) -> PhoneError {
    let duration = Duration::from_millis(100);
    client(address, margin).gyroscope(duration).unwrap_err()
}

/// The error of a download, which leaves no file behind.
fn download(address: &str, margin: Duration) -> PhoneError {
    let folder = tempfile::tempdir().unwrap();
    let mut client = client(address, margin);
    let result = client.get_video(folder.path(), false, &mut |_, _| {});
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    result.unwrap_err()
}

fn video(size: usize, name: &str, bytes: usize) -> Vec<u8> {
    let mut all = format!("{HEAD}{size}\n{name}\nend\n").into_bytes();
    all.extend((0..bytes).map(|i| (i % 251) as u8));
    all
}

#[test]
fn a_cancelled_request_ends_though_another_follows() {
    // Connections are accepted, and nothing is answered.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let task = PhoneTask::start(listener.local_addr().unwrap().to_string()).unwrap();
    let cancelled = task.probe();
    cancelled.cancel();
    let _other = task.probe();
    let begun = Instant::now();
    let answer = loop {
        match cancelled.answer() {
            Some(answer) => break answer,
            None => assert!(begun.elapsed() < PATIENCE),
        }
        std::thread::sleep(Duration::from_millis(10));
    };
    assert!(matches!(answer, Err(PhoneError::Cancelled { .. })));
}

#[test]
fn another_app_or_version_is_recognised() {
    let http = answers("HTTP/1.1 400 Bad Request\r\n\r\n", Then::Stay);
    assert!(matches!(
        imu(&http, PATIENCE),
        PhoneError::Malformed {
            source: MalformedAnswer::Line { .. },
            ..
        }
    ));
    let newer = answers("SUCCESS\nv.0.1.2\nend\n", Then::Stay);
    assert!(matches!(
        imu(&newer, PATIENCE),
        PhoneError::UnsupportedVersion { found } if found == "v.0.1.2"
    ));
}

#[test]
fn an_answer_that_breaks_off_is_a_closed_connection() {
    for answer in [
        "",
        "SUCC",
        "SUCCESS\nv.0.1.1\nen",
        "SUCCESS\nv.0.1.1\nxgyro.csv\n1,2,3,4\n1,2",
        "ERROR\nv.0.1.1\nError in",
    ] {
        let error = imu(&answers(answer, Then::Leave), PATIENCE);
        assert!(
            matches!(error, PhoneError::Closed { received, .. } if received == answer.len() as u64),
            "{error}"
        );
    }
    let error = download(&answers(format!("{HEAD}100\n"), Then::Leave), PATIENCE);
    assert!(matches!(error, PhoneError::Closed { .. }), "{error}");
}

#[test]
fn a_silent_phone_and_one_that_trickles_are_waited_for_no_longer_than_said() {
    let margin = Duration::from_millis(300);
    for address in [
        answers("", Then::Stay),
        fake(|stream| {
            while stream.write_all(b"S").is_ok() {
                std::thread::sleep(Duration::from_millis(20));
            }
            Then::Leave
        }),
    ] {
        let begun = Instant::now();
        let error = imu(&address, margin);
        // The recording's own 100 ms and the margin.
        assert!(
            matches!(error, PhoneError::Timeout { waited, .. } if waited == margin * 4 / 3),
            "{error}"
        );
        assert!(begun.elapsed() >= margin, "{error}");
    }
}

#[test]
fn an_endless_answer_is_given_up() {
    let lines = fake(|stream| {
        let _ = stream.write_all(format!("{HEAD}xgyro.csv\n").as_bytes());
        while stream.write_all(&b"1,2,3,4\n".repeat(1000)).is_ok() {}
        Then::Leave
    });
    assert!(matches!(
        imu(&lines, PATIENCE),
        PhoneError::Malformed {
            source: MalformedAnswer::TooLarge { .. },
            ..
        }
    ));
}

#[test]
fn videos_that_are_short_long_or_crawl_are_not_saved() {
    let short = download(&answers(video(1000, "x.mp4", 999), Then::Leave), PATIENCE);
    assert!(
        matches!(
            short,
            PhoneError::VideoTooShort {
                received: 999,
                size: 1000
            }
        ),
        "{short}"
    );
    let long = download(&answers(video(1000, "x.mp4", 1001), Then::Stay), PATIENCE);
    assert!(
        matches!(long, PhoneError::VideoTooLong { size: 1000 }),
        "{long}"
    );
    let huge = download(&answers(video(1 << 40, "x.mp4", 0), Then::Stay), PATIENCE);
    assert!(matches!(huge, PhoneError::VideoTooLarge { .. }), "{huge}");
    let margin = Duration::from_millis(300);
    let stops = download(&answers(video(1000, "x.mp4", 900), Then::Stay), margin);
    assert!(matches!(stops, PhoneError::Timeout { .. }), "{stops}");
    let crawls = fake(|stream| {
        let _ = stream.write_all(&video(100_000, "x.mp4", 10));
        while stream.write_all(b"x").is_ok() {
            std::thread::sleep(Duration::from_millis(20));
        }
        Then::Leave
    });
    // A busy machine may pause for as long as the phone; it is given up after twice that.
    let crawls = download(&crawls, Duration::from_secs(2));
    assert!(matches!(crawls, PhoneError::TooSlow { .. }), "{crawls}");
}

#[test]
fn names_from_the_phone_stay_in_the_folder() {
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
        let folder = outer.path().join("a/b");
        std::fs::create_dir_all(&folder).unwrap();
        let address = answers(video(10, name, 10), Then::Stay);
        let saved = client(&address, PATIENCE).get_video(&folder, false, &mut |_, _| {});
        assert_eq!(
            saved.unwrap().path.parent(),
            Some(folder.as_path()),
            "{name}"
        );
        let entries = |folder: &Path| std::fs::read_dir(folder).unwrap().count();
        let counts = [&folder, &outer.path().join("a"), outer.path()].map(|at: &Path| entries(at));
        assert_eq!(counts, [1, 1, 1], "{name}");
    }
}

/// Its port is closed with it.
#[test]
fn an_app_that_dies_while_it_starts_is_told_within_three_seconds() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let (stream, _) = listener.accept().unwrap();
        serve(stream, |_| Then::Leave);
    });
    let mut client = client(&address, PATIENCE);
    let begun = Instant::now();
    let error = client.start_video(None).unwrap_err();
    assert!(matches!(error, PhoneError::Closed { .. }), "{error}");
    let error = client.undo_start(error);
    assert!(begun.elapsed() < Duration::from_secs(3));
    match error {
        PhoneError::MayRecord { why, .. } => assert!(why.is_app_gone(), "{why}"),
        other => panic!("{other}"),
    }
}

/// Sooner than the frames can be.
#[test]
fn a_phase_that_comes_at_once_is_of_another_video_which_is_stopped() {
    let answer = format!("{HEAD}949113215987860\n3.3330652542372882E7\n1000000\nend\n");
    let mut client = client(&answers(answer, Then::Stay), PATIENCE);
    let error = client.start_video(None).unwrap_err();
    assert!(matches!(error, PhoneError::StalePhase { .. }), "{error}");
    let error = client.undo_start(error);
    assert!(matches!(error, PhoneError::StartUndone { .. }), "{error}");
}
