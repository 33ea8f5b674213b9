//! Malicious files, read by whole commands with limits of memory and time.

use std::fs;
use std::os::unix::fs::symlink;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use board::finding::Finding;
use board::imu::Sample;
use protocol::{HostToDevice, ImuFlags, Pulse, Ticks};
use recording::SESSION_FILE;
use recording::session_file::with_checksum;
use recording::writer::Writer;
use serde_json::Value;

use crate::support::synthetic::{self, Wrong};
use crate::support::{self, StandIn, code, text};
use test_support::board::hello;
use test_support::processes::PATIENCE;
use test_support::processes::Ran;
use test_support::{TestFolder, below, contents};

/// Limits of a command: address space in bytes, processor time in seconds.
const MEMORY: u64 = 1 << 30;
const SECONDS: u64 = 20;

/// Runs the program with its limits, and checks that it ends with an exit code.
pub(crate) fn limited(args: &[&str]) -> Ran {
    limited_to(SECONDS, args)
}

/// Runs the program with its limits, and `seconds` of processor time.
pub(crate) fn limited_to(seconds: u64, args: &[&str]) -> Ran {
    let output = Ran::new(&mut command_in(seconds, args));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!said.contains("panicked"), "{args:?}: {said}");
    let signal = output.status.signal();
    assert_eq!(signal, None, "{args:?}: ended by a signal: {said}");
    output
}

pub(crate) fn command(args: &[&str]) -> Command {
    command_in(SECONDS, args)
}

fn command_in(seconds: u64, args: &[&str]) -> Command {
    let mut command = Command::new("prlimit");
    command
        .arg(format!("--as={MEMORY}"))
        .arg(format!("--cpu={seconds}"))
        .arg("--core=0")
        .arg(env!("CARGO_BIN_EXE_smartdepthsync"))
        .args(args);
    command
}

pub(crate) fn utf8(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A whole recording, whose session file is changed as a text.
fn with_session(parent: &Path, change: impl FnOnce(&mut Value)) -> PathBuf {
    let folder = synthetic::make(parent, Wrong::default());
    let path = folder.join(SESSION_FILE);
    let mut session: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut session);
    session.as_object_mut().unwrap().remove("checksum");
    fs::write(&path, with_checksum(&session.to_string())).unwrap();
    folder
}

#[test]
fn names_in_a_session_lead_nowhere() {
    type Change = fn(&mut Value);
    let changes: [(&str, Change); 2] = [
        ("phone", |session| {
            let mut phone = session["profile"]["phone"].clone();
            phone["name"] = "../../outside".into();
            session["profile"]["phones"] = vec![phone].into();
        }),
        ("file", |session| {
            session["files"] = vec![Value::from("../outside/other.mp4")].into();
        }),
    ];
    for (what, change) in changes {
        let parent = TestFolder::new();
        let folder = with_session(parent.path(), change);
        fs::create_dir(folder.join("phones")).unwrap();
        let outside = parent.path().join("outside");
        fs::create_dir(&outside).unwrap();
        fs::write(outside.join("VID_1_timestamps.csv"), "1000000000\n").unwrap();
        fs::write(outside.join("VID_1gyro.csv"), "0,0,0,1000000000\n").unwrap();
        let before = contents(&outside);
        let out = parent.path().join("deep/er/out");
        let output = limited(&["extract", utf8(&folder), "--out", utf8(&out)]);
        assert_eq!(code(&output), 4, "{what}: {output:?}");
        let said = text(&output.stdout);
        assert_eq!(contents(&outside), before, "{what}");
        let mut strays = below(&parent.path().join("deep"));
        strays.retain(|path| !path.starts_with(&out));
        assert_eq!(strays.len(), 1, "{what}: only `er`: {strays:?}");
        assert!(!said.contains("VID_1"), "{what}: nothing was read: {said}");
        assert_eq!(code(&limited(&["verify", utf8(&folder)])), 4, "{what}");
    }
}

/// A recording with a file that stands for the phone's video of a second.
pub(crate) fn recording_with_video(parent: &Path) -> PathBuf {
    let folder = with_session(parent, |session| {
        session["phones"][0]["clock"] = session["alignment"]["plan"]["clock"].clone();
    });
    fs::write(folder.join("VID_20260131_140327.mp4"), "a video").unwrap();
    let stamps: String = (0..30)
        .map(|row| format!("{}\n", 94_002_000_000_000_i64 + row * 33_333_333))
        .collect();
    fs::write(folder.join("VID_20260131_140327_timestamps.csv"), stamps).unwrap();
    folder
}

#[test]
fn a_playlist_reads_no_other_file() {
    let hls = "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n../secret.mp4\n#EXT-X-ENDLIST\n";
    let concat = "ffconcat version 1.0\nfile ../secret.mp4\n";
    let sdp = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\n\
               m=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n";
    let dash = "<?xml version=\"1.0\"?><MPD xmlns=\"urn:mpeg:dash:schema:mpd:2011\" type=\"static\" \
        mediaPresentationDuration=\"PT1S\" profiles=\"urn:mpeg:dash:profile:isoff-on-demand:2011\">\
        <Period><AdaptationSet mimeType=\"video/mp4\"><Representation id=\"1\" bandwidth=\"1000\" \
        width=\"64\" height=\"48\"><BaseURL>../secret.mp4</BaseURL></Representation></AdaptationSet>\
        </Period></MPD>";
    for (name, list) in [
        ("HLS", hls),
        ("concat", concat),
        ("SDP", sdp),
        ("DASH", dash),
    ] {
        let parent = TestFolder::new();
        let folder = recording_with_video(parent.path());
        let fragments = ["-movflags", "+frag_keyframe+empty_moov"];
        support::test_video(&parent.path().join("secret.mp4"), 30, &fragments);
        let video = folder.join("VID_20260131_140327.mp4");
        fs::write(&video, list).unwrap();
        let output = limited(&["--json", "extract", utf8(&folder)]);
        assert_eq!(code(&output), 4, "{name}: {output:?}");
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        let losses = report["losses"].as_array().unwrap();
        assert!(losses.iter().any(|loss| loss["part"] == "video"), "{name}");
        let images = below(&parent.path().join("walk-euroc"));
        let is_image = |path: &Path| path.extension().is_some_and(|ending| ending == "png");
        assert!(!images.iter().any(|path| is_image(path)), "{name}");
        let output = limited(&["evaluate", "precision", utf8(&video)]);
        assert_eq!(code(&output), 2, "{name}: {output:?}");
    }
}

#[test]
fn numbers_beyond_all_reason_are_left_out_of_a_report() {
    let parent = TestFolder::new();
    let folder = parent.path().join("walk");
    fs::create_dir(&folder).unwrap();
    let mut writer = Writer::create(&folder).unwrap();
    for number in 0..1_000_u64 {
        let wild = [1e308, -1e308, 0.1][(number % 3) as usize];
        let sample = Sample {
            at: Ticks(48_000_000 + number * 96_000),
            flags: ImuFlags::default(),
            gyro: [if number < 300 { wild } else { 0.2 }, 1e-320, 1e30],
            accel: [0.0, 0.0, 9.8],
            temperature: 1e308,
        };
        writer.imu(&sample, number as u32).unwrap();
    }
    writer.finish().unwrap();
    let mut session = synthetic::session();
    if let Some(alignment) = &mut session.alignment {
        // As large as is accepted.
        alignment.plan.clock.covariance = [[9e19, 0.0], [0.0, 9e19]];
        alignment.plan.frames.period_ns = 1e-300;
        session.phones[0].clock = Some(alignment.plan.clock);
    }
    session.save(&folder).unwrap();
    let output = limited(&["verify", utf8(&folder)]);
    assert!(matches!(code(&output), 0 | 4), "{output:?}");
    assert!(folder.join("report.html").exists());
}

/// A head of a chunk that fits the length of its record.
fn chunk_head(length: u64, name: &[u8]) -> Vec<u8> {
    let mut head = vec![6];
    head.extend((length + 40 + name.len() as u64).to_le_bytes());
    head.extend([0; 28]);
    head.extend((name.len() as u32).to_le_bytes());
    head.extend(name);
    head.extend(length.to_le_bytes());
    head
}

#[test]
fn false_heads_of_chunks_cost_a_time_that_grows_as_the_file() {
    const LENGTH: usize = 64 << 20;
    let parent = TestFolder::new();
    // Heads whose record reaches to the end of the file, and heads after which another
    // record does.
    for (kind, name, claim) in [("names", &b"\xff\xfe"[..], true), ("records", b"", false)] {
        let mut bytes = mcap::MAGIC.to_vec();
        while bytes.len() < LENGTH {
            let rest = (LENGTH - bytes.len()) as u64;
            if claim {
                bytes.extend(chunk_head(rest.saturating_sub(60).min(19 << 20), name));
            } else {
                bytes.extend(chunk_head(0, name));
                bytes.push(3);
                bytes.extend(rest.saturating_sub(80).min(19 << 20).to_le_bytes());
            }
            bytes.resize(bytes.len() + 3_000, 0xA5);
        }
        let file = parent.path().join(format!("{kind}.mcap"));
        fs::write(&file, bytes).unwrap();
        let output = limited(&["verify", utf8(&file)]);
        assert!([4, 13].contains(&code(&output)), "{kind}: {output:?}");
    }
}

#[test]
fn sensors_with_names_alike_lose_nothing() {
    let parent = TestFolder::new();
    let folder = parent.path().join("walk");
    fs::create_dir(&folder).unwrap();
    let mut writer = Writer::create(&folder).unwrap();
    let names = ["cam 1", "cam-1", "cam_1"];
    for number in 0..30_u64 {
        for (index, name) in (0..).zip(names) {
            let pulse = Pulse {
                output: protocol::Output::Two,
                seq: number as u32,
                train: 1,
                number,
                at: Ticks(48_000_000 + number * 1_600_000 + index),
                aligned: true,
                readback: None,
            };
            writer.output_pulse(&pulse, name).unwrap();
        }
    }
    writer.finish().unwrap();
    synthetic::session().save(&folder).unwrap();
    for (format, place) in [
        ("topics", "walk-topics/_output_cam_1"),
        ("euroc", "walk-euroc/mav0/outputs/cam_1"),
    ] {
        let output = limited(&["extract", utf8(&folder), "--format", format]);
        assert_eq!(code(&output), 4, "{output:?}");
        let said = text(&output.stdout);
        let mut starts = Vec::new();
        for longer in ["", "_", "__"] {
            let file = match format {
                "topics" => format!("{place}{longer}/time_ref.csv"),
                _ => format!("{place}{longer}.csv"),
            };
            let rows = fs::read_to_string(parent.path().join(&file)).unwrap();
            let rows: Vec<&str> = rows.lines().filter(|row| !row.starts_with('#')).collect();
            assert_eq!(rows.len(), 30, "{file}");
            starts.push(rows[0].to_owned());
            assert!(
                longer.is_empty() || said.contains(&format!("cam_1{longer}")),
                "{said}"
            );
        }
        starts.dedup();
        assert_eq!(starts.len(), 3, "each has its own: {starts:?}");
    }
}

#[test]
fn no_escape_sequence_reaches_the_terminal() {
    const WILD: &str = "\u{1b}]0;owned\u{7}\u{9b}2J\rdone\u{202e}";
    let is_harmless = |bytes: &[u8]| {
        let said = text(bytes);
        assert!(said.contains("owned"), "the text is there: {said:?}");
        let obeyed = |c: char| c.is_control() && c != '\n' || c == '\u{202e}';
        assert!(!said.contains(obeyed), "{said:?}");
    };
    let parent = TestFolder::new();
    let folder = with_session(parent.path(), |session| {
        let problem = Finding::check("imu_gap", WILD).at(Ticks(1));
        session["problems"] = serde_json::to_value([problem]).unwrap();
        session["outcome"] = "failed".into();
    });
    for args in [vec!["verify"], vec!["--json", "verify"]] {
        let mut args = args;
        args.push(utf8(&folder));
        is_harmless(&limited(&args).stdout);
    }
    let wild_file = parent.path().join(format!("{WILD}.mcap"));
    is_harmless(&limited(&["verify", utf8(&wild_file)]).stderr);

    let mut greeting = hello();
    greeting.last_panic = Some(WILD.try_into().unwrap());
    greeting.git_revision = "\u{1b}[2Jrev".try_into().unwrap();
    let board = StandIn::new(move |command: HostToDevice| match command.command {
        protocol::Command::SayHello(_) => support::greeting(command.id, greeting.clone()),
        _ => support::polite(command),
    });
    let output = support::run(&["board", "info", "--port", &board.path]);
    assert_eq!(code(&output), 0, "{output:?}");
    is_harmless(&output.stdout);
}

#[test]
fn pipes_and_devices_are_no_recordings() {
    let parent = TestFolder::new();
    let folder = synthetic::make(parent.path(), Wrong::default());
    let session = folder.join(SESSION_FILE);
    fs::remove_file(&session).unwrap();
    symlink("/dev/zero", &session).unwrap();
    let output = limited(&["verify", utf8(&folder)]);
    assert_eq!(code(&output), 4, "{output:?}");
    assert_eq!(code(&limited(&["profile", "check", "/dev/zero"])), 13);
    fs::remove_file(&session).unwrap();
    fs::write(&session, vec![b' '; 40 << 20]).unwrap();
    let output = limited(&["verify", utf8(&folder)]);
    assert_eq!(code(&output), 4, "{output:?}");

    let pipe = parent.path().join("pipe.mcap");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    for args in [["verify", utf8(&pipe)], ["extract", utf8(&pipe)]] {
        let mut child = command(&args).stderr(Stdio::piped()).spawn().unwrap();
        let began = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if began.elapsed() > PATIENCE {
                let _ = child.kill();
                panic!("{args:?} waits for a pipe");
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let output = child.wait_with_output().unwrap();
        assert_eq!(code(&output), 13, "{args:?}: {output:?}");
    }
}
