//! Files and ports that are made to cost time or memory, read by whole commands with limits.

use std::ffi::OsString;
use std::fs;
use std::io::{Read as _, Write as _};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use mcap::records::MessageHeader;
use protocol::HostToDevice;
use rand::{RngExt as _, SeedableRng as _};
use recording::profile::DEFAULT;
use recording::rosbag2::options;
use recording::session_file::SessionFile;
use recording::{MCAP_FILE, SESSION_FILE, Topic};

use super::hostile_files::{command, limited, limited_to, recording_with_video, utf8};
use super::phone_command::endless;
use crate::support::synthetic::{self, Wrong};
use crate::support::{self, StandIn, code, text};
use test_support::TestFolder;
use test_support::processes::{Ran, run, worked_s};

/// An MCAP file of `chunks` chunks of 16 MiB, each of the same message over and over but
/// for `noise` bytes that cannot be packed.
fn bomb(folder: &Path, topic: Topic, message: &[u8], chunks: usize, noise: usize) {
    // With no place in it that says where in the file it is: it can be repeated.
    let options = options()
        .emit_message_indexes(false)
        .emit_summary_records(false)
        .emit_summary_offsets(false)
        .calculate_data_section_crc(false);
    let mut writer = options
        .create(mcap::write::NoSeek::new(Vec::new()))
        .unwrap();
    let schema = writer
        .add_schema(topic.message_type(), "ros2msg", topic.schema().as_bytes())
        .unwrap();
    let channel = writer
        .add_channel(schema, topic.name(), "cdr", &Default::default())
        .unwrap();
    let header = MessageHeader {
        channel_id: channel,
        sequence: 0,
        log_time: 1_000_000_000,
        publish_time: 1_000_000_000,
    };
    let beside = writer.add_channel(schema, "/noise", "cdr", &Default::default());
    let noise_header = MessageHeader {
        channel_id: beside.unwrap(),
        ..header
    };
    let mut random = rand_pcg::Pcg64::seed_from_u64(1);
    let noise: Vec<u8> = (0..noise).map(|_| random.random()).collect();
    let each = ((16 << 20) - noise.len()) / (31 + message.len());
    if !noise.is_empty() {
        writer
            .write_to_known_channel(&noise_header, &noise)
            .unwrap();
    }
    for _ in 0..each {
        writer.write_to_known_channel(&header, message).unwrap();
    }
    writer.flush().unwrap();
    writer.finish().unwrap();
    let bytes = writer.into_inner().into_inner();

    let mut begin = mcap::MAGIC.len();
    let end = loop {
        let length = u64::from_le_bytes(bytes[begin + 1..begin + 9].try_into().unwrap());
        let end = begin + 9 + length as usize;
        if bytes[begin] == mcap::records::op::CHUNK {
            break end;
        }
        begin = end;
    };
    fs::create_dir_all(folder).unwrap();
    let mut file = fs::File::create(folder.join(MCAP_FILE)).unwrap();
    file.write_all(&bytes[..begin]).unwrap();
    for _ in 0..chunks {
        file.write_all(&bytes[begin..end]).unwrap();
    }
    file.write_all(&bytes[end..]).unwrap();
}

/// A time reference: stamp, empty names, time.
const TIMES: &[u8] = &[
    0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0,
    0,
];

#[test]
fn a_small_recording_that_unpacks_to_much_takes_little_memory() {
    let parent = TestFolder::new();
    for (name, topic) in [("marks", Topic::Marker), ("pairs", Topic::Gnss)] {
        let folder = parent.path().join(name);
        // Within what a recording may unpack to.
        bomb(&folder, topic, TIMES, 20, (16 << 20) / 15);
        let output = limited(&["extract", utf8(&folder)]);
        assert_eq!(code(&output), 4, "{output:?}");
        let output = limited(&["verify", utf8(&folder)]);
        assert_eq!(code(&output), 4, "{output:?}");
    }
}

/// A gigabyte in less than the 20 s of processor time that a command has here.
#[test]
fn what_a_small_file_unpacks_to_is_bounded() {
    let parent = TestFolder::new();
    let folder = parent.path().join("walk");
    bomb(&folder, Topic::Marker, TIMES, 60, 0);
    let length = fs::metadata(folder.join(MCAP_FILE)).unwrap().len();
    assert!(length < 5 << 20, "{length}");
    SessionFile::save(&synthetic::session(), &folder).unwrap();
    for command in ["verify", "extract"] {
        let output = limited(&[command, utf8(&folder)]);
        assert_eq!(code(&output), 4, "{command}: {output:?}");
    }
}

/// A file that may grow no more is a full disk, and no reason to be ended by a signal.
#[test]
fn the_largest_file_size_is_as_a_full_disk() {
    let parent = TestFolder::new();
    let folder = synthetic::make(parent.path(), Wrong::default());
    // The runner of the tests may ignore the signal.
    let output = Command::new("env")
        .args(["--default-signal=XFSZ", "prlimit", "--fsize=4096"])
        .args(["--core=0", env!("CARGO_BIN_EXE_smartdepthsync")])
        .args(["extract", utf8(&folder)])
        .output()
        .unwrap();
    assert_eq!(code(&output), 13, "{output:?}");
}

/// A port that gives zeros, or nonsense, as fast as it is read.
#[test]
fn a_port_that_never_ends_costs_little() {
    for bytes in [[0; 2], [7, 7], [1, 0]] {
        let board = Flood(bytes);
        let board = StandIn::new(board);
        let output = limited(&["board", "info", "--port", &board.path]);
        assert_eq!(code(&output), 8, "{bytes:?}: {output:?}");
    }
}

/// Sends the same bytes over and over.
struct Flood([u8; 2]);

impl support::Behaviour for Flood {
    fn command(&mut self, _command: HostToDevice) -> Vec<u8> {
        Vec::new()
    }

    fn tick(&mut self) -> Vec<u8> {
        self.0.repeat(64 << 10)
    }
}

/// A search path on which ffmpeg is this line of the shell, and ffprobe announces so many frames.
fn stand_ins(folder: &Path, frames: u64, ffmpeg: &str) -> OsString {
    let answer = format!(
        r#"{{"streams": [{{"width": 320, "height": 240, "pix_fmt": "gray", "nb_frames": "{frames}"}}]}}"#
    );
    let probe = format!("case \"$*\" in *packet*) exit 1;; esac; echo '{answer}'");
    let version = "[ \"$1\" = -version ] && { echo ffmpeg version 7.0; exit; }";
    for (name, lines) in [
        ("ffprobe", probe),
        ("ffmpeg", format!("{version}\n{ffmpeg}")),
    ] {
        support::script(&folder.join(name), &format!("#!/bin/sh\n{lines}\n"));
    }
    let mut path = folder.as_os_str().to_owned();
    path.push(":");
    path.push(std::env::var_os("PATH").unwrap());
    path
}

#[test]
fn a_decoder_that_never_ends_is_ended_and_named() {
    let parent = TestFolder::new();
    let folder = recording_with_video(parent.path());
    let video = folder.join("VID_20260131_140327.mp4");
    for (line, why) in [
        ("exec cat /dev/zero", "more than 160 frames"),
        ("yes >&2 & exec sleep 1000", "bytes of messages"),
    ] {
        let path = stand_ins(parent.path(), 30, line);
        let run = |args: &[&str]| command(args).env("PATH", &path).output().unwrap();
        let output = run(&["evaluate", "precision", utf8(&video)]);
        assert_eq!(code(&output), 2, "{line}: {output:?}");
        let said = text(&output.stderr);
        assert!(
            said.contains("ffmpeg was ended") && said.contains(why),
            "{said}"
        );
        let out = TestFolder::new();
        let output = run(&["extract", utf8(&folder), "--out", utf8(out.path())]);
        assert_eq!(code(&output), 4, "{line}: {output:?}");
        assert!(text(&output.stdout).contains(why), "{line}: {output:?}");
    }
}

/// Makes a video of one grey frame of this size.
fn grey(size: &str, video: &Path) {
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-v", "error", "-y", "-f", "lavfi", "-i"]);
    ffmpeg.arg(format!("color=gray:s={size}"));
    run(ffmpeg.args(["-frames:v", "1", "-c:v", "mjpeg"]).arg(video));
}

/// A measurement and an extraction refuse the video of a recording for this reason.
fn video_is_refused(folder: &Path, video: &Path, expected: &str) {
    let output = limited_to(3, &["evaluate", "precision", utf8(video)]);
    assert_eq!(code(&output), 2, "{output:?}");
    assert!(text(&output.stderr).contains(expected), "{output:?}");
    let out = TestFolder::new();
    let output = limited_to(3, &["extract", utf8(folder), "--out", utf8(out.path())]);
    assert_eq!(code(&output), 4, "{output:?}");
    assert!(text(&output.stdout).contains(expected), "{output:?}");
}

/// A video of one frame, whose index states ten million.
#[test]
fn a_video_that_states_more_frames_than_it_holds_is_refused() {
    const FRAMES: u32 = 10_000_000;
    let parent = TestFolder::new();
    let folder = recording_with_video(parent.path());
    let video = folder.join("VID_20260131_140327.mp4");
    grey("64x64", &video);
    let mut bytes = fs::read(&video).unwrap();
    // The number of samples of the tables of sizes and of times: 12 bytes after each box's name.
    for table in [b"stsz", b"stts"] {
        let at = bytes.windows(4).position(|name| name == table).unwrap() + 12;
        bytes[at..at + 4].copy_from_slice(&FRAMES.to_be_bytes());
    }
    fs::write(&video, bytes).unwrap();
    video_is_refused(&folder, &video, &format!("it states {FRAMES} frames"));
}

/// Its pictures would take a gigabyte of memory.
#[test]
fn a_small_video_of_huge_pictures_is_refused() {
    let parent = TestFolder::new();
    let folder = recording_with_video(parent.path());
    let video = folder.join("VID_20260131_140327.mp4");
    grey("8192x8192", &video);
    assert!(fs::metadata(&video).unwrap().len() < 2_000_000);
    video_is_refused(&folder, &video, "pictures of 8192x8192 pixels, which");
}

/// Files of a megabyte in place of all that a person or another program writes.
#[test]
fn a_megabyte_of_brackets_keys_or_aliases_is_refused_at_little_cost() {
    const SIZE: usize = 1 << 20;
    let parent = TestFolder::new();
    let whole = synthetic::make(parent.path(), Wrong::default());
    let repeated = |text: &str| text.repeat(SIZE / text.len());
    let line = |from: char, to: char| {
        let names = [to; 10].map(|name| format!("*{name}")).join(",");
        format!("{from}: &{from} [{names}]\n")
    };
    let aliases: String = ('b'..='j')
        .zip('a'..='i')
        .map(|(from, to)| line(from, to))
        .collect();
    for content in [
        repeated("["),
        repeated("{\"a\":"),
        repeated("[[a.b]]\n"),
        format!("a{} = 1\n", repeated(".a")),
        format!("a: &a [x,x,x,x,x,x,x,x,x,x]\n{aliases}"),
        repeated("9"),
    ] {
        let recording = |name: &str| {
            fs::write(whole.join(name), &content).unwrap();
            vec![String::from("verify"), utf8(&whole).into()]
        };
        let file = parent.path().join("file");
        fs::write(&file, &content).unwrap();
        let profile = parent.path().join("rig.toml");
        fs::write(&profile, DEFAULT).unwrap();
        let [file, profile] = [&file, &profile].map(|path| utf8(path).to_owned());
        for args in [
            recording("metadata.yaml"),
            recording(SESSION_FILE),
            ["profile", "check", &file].map(str::to_owned).to_vec(),
            ["profile", "import-kalibr", &profile, &file]
                .map(str::to_owned)
                .to_vec(),
            ["board", "flash", "--image", &file]
                .map(str::to_owned)
                .to_vec(),
        ] {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            let output = limited_to(3, &args);
            assert_ne!(code(&output), 0, "{args:?}: {output:?}");
            assert!(output.stderr.len() < 4_000, "{args:?}");
        }
    }
}

/// Too little memory for a thread, or a short stack, is an error in words and not a panic.
#[test]
fn a_system_without_threads_or_stack_is_named() {
    let parent = TestFolder::new();
    let folder = synthetic::make(parent.path(), Wrong::default());
    let run = |limit: &str| {
        let out = TestFolder::new();
        let mut command = Command::new("prlimit");
        command.args([limit, "--core=0", env!("CARGO_BIN_EXE_smartdepthsync")]);
        let args = ["extract", utf8(&folder), "--out", utf8(out.path())];
        Ran::new(command.args(args))
    };
    assert_eq!(code(&run("--stack=65536")), 4);
    let mut named = 0;
    for megabytes in (20..44).step_by(4) {
        let output = run(&format!("--as={}", megabytes << 20));
        let said = text(&output.stderr);
        assert!(!said.contains("panicked"), "{megabytes} MiB: {said}");
        named += u32::from(said.contains("thread") && said.contains("ulimit"));
    }
    assert!(named > 0);
}

/// A file that begins like this, ends like that, and was never written between for a terabyte.
fn sparse(path: &Path, begin: &[u8], end: &[u8]) {
    let file = fs::File::create(path).unwrap();
    file.write_all_at(begin, 0).unwrap();
    file.write_all_at(end, 1 << 40).unwrap();
    file.set_len((1 << 40) + (1 << 20)).unwrap();
}

/// Within a gigabyte of memory and three seconds of the processor.
#[test]
fn a_terabyte_that_was_never_written_costs_nothing() {
    const EBML: &[u8] = b"\x1a\x45\xdf\xa3\x8b\x42\x82\x88matroska";
    const SEGMENT: &[u8] = b"\x18\x53\x80\x67\x01\xff\xff\xff\xff\xff\xff\xff";
    const CLUSTER: &[u8] = b"\x1f\x43\xb6\x75\x84\xe7\x82\x00\x01";
    let parent = TestFolder::new();
    let place = |name: &str| parent.path().join(name);
    let whole = synthetic::make(parent.path(), Wrong::default());
    let board = fs::read(whole.join(MCAP_FILE)).unwrap();
    let (begin, end) = board.split_at(board.len() / 2);
    let [empty, holed, torn] = ["empty.mcap", "holed", "torn.bag"].map(place);
    fs::create_dir(&holed).unwrap();
    fs::copy(whole.join(SESSION_FILE), holed.join(SESSION_FILE)).unwrap();
    sparse(&empty, b"", b"");
    sparse(&torn, b"#ROSBAG V2.0\n", b"");
    sparse(&holed.join(MCAP_FILE), begin, end);
    let [depth, video, times] = ["depth.mkv", "VID.mp4", "times.csv"].map(place);
    sparse(&depth, &[EBML, SEGMENT].concat(), CLUSTER);
    sparse(&video, b"\0\0\0\x18ftypmp42\0\0\0\0mp42isom", b"");
    sparse(&times, b"1000000000\n", b"2000000000\n");
    // Next to the recording, where the app leaves it.
    let stamps = holed.join("VID_20260131_140327_timestamps.csv");
    sparse(&stamps, b"94002000000000\n", b"94002033333333\n");
    let profile = place("rig.toml");
    fs::write(&profile, DEFAULT).unwrap();
    let [out, out2] = ["out", "out2"].map(place);
    let (holed, whole) = (utf8(&holed), utf8(&whole));
    let learn = ["profile", "learn", whole, "--profile", utf8(&profile)];
    for (args, expected) in [
        (vec!["verify", utf8(&empty)], 13),
        (vec!["verify", utf8(&torn)], 2),
        (vec!["verify", holed], 4),
        (vec!["extract", utf8(&empty)], 13),
        (vec!["extract", holed, "--out", utf8(&out)], 4),
        (
            vec![
                "extract",
                whole,
                "--depth",
                utf8(&depth),
                "--out",
                utf8(&out2),
            ],
            4,
        ),
        (vec!["evaluate", "precision", utf8(&video)], 2),
        (vec!["evaluate", "precision", utf8(&depth)], 2),
        (vec!["evaluate", "drift", utf8(&video)], 2),
        ([&learn[..], &["--timestamps", utf8(&times)]].concat(), 2),
    ] {
        let output = limited_to(3, &args);
        assert_eq!(code(&output), expected, "{args:?}: {output:?}");
    }
}

/// Inputs on which commands run for long.
struct Long {
    folder: PathBuf,
    video: PathBuf,
    times: PathBuf,
    profile: PathBuf,
    phone: String,
    path: OsString,
}

impl Long {
    fn new(parent: &Path) -> Self {
        let place = |name| parent.join(name);
        let [folder, video, times, profile] =
            ["walk", "VID.mp4", "times.csv", "rig.toml"].map(place);
        bomb(&folder, Topic::Marker, TIMES, 100, (16 << 20) / 15);
        SessionFile::save(&synthetic::session(), &folder).unwrap();
        fs::write(&profile, DEFAULT).unwrap();
        // As many bytes as its frames need.
        fs::write(&video, vec![b' '; 80 << 20]).unwrap();
        fs::write(&times, vec![b'\n'; 200 << 20]).unwrap();
        Self {
            phone: endless(),
            path: stand_ins(parent, 10_000_000, "exec cat /dev/zero"),
            folder,
            video,
            times,
            profile,
        }
    }

    fn commands(&self) -> Vec<Vec<&str>> {
        let [folder, video, times, profile] =
            [&self.folder, &self.video, &self.times, &self.profile].map(|path| utf8(path));
        let learn = ["profile", "learn", folder, "--profile", profile];
        vec![
            vec!["verify", folder],
            vec!["extract", folder],
            vec!["evaluate", "precision", video],
            vec!["evaluate", "drift", video],
            [&learn[..], &["--timestamps", times]].concat(),
            [
                &["phone", "get-video", "--recorded", "--out", folder][..],
                &["--phone", &self.phone],
            ]
            .concat(),
        ]
    }
}

#[test]
fn the_first_signal_stops_every_command_that_reads_long() {
    use rustix::process::{Pid, Signal, kill_process};
    let parent = TestFolder::new();
    let long = Long::new(parent.path());
    for (args, signal) in long
        .commands()
        .iter()
        .flat_map(|args| [(args, Signal::INT), (args, Signal::TERM)])
    {
        let mut command = command(args);
        let mut child = command
            .env("PATH", &long.path)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let pid = Pid::from_child(&child);
        // By its own processor time: on a busy machine it gets none for a while.
        let mut worked = 0.0;
        let mut ended_at = |most_s: f64| loop {
            let status = child.try_wait().unwrap();
            worked = worked_s(child.id()).map_or(worked, |now| now.max(worked));
            if status.is_some() || worked > most_s {
                return (status, worked);
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        let (status, asked_at) = ended_at(0.3);
        assert_eq!(status, None, "{args:?} ended by itself");
        kill_process(pid, signal).unwrap();
        let (status, _) = ended_at(asked_at + 1.0);
        assert_eq!(
            status.and_then(|s| s.code()),
            Some(130),
            "{args:?} {signal:?}"
        );
    }
}

/// On a terminal a bar names the file before the command has ended by itself.
#[test]
fn a_command_that_reads_long_shows_how_far_it_is() {
    let parent = TestFolder::new();
    let long = Long::new(parent.path());
    for args in long.commands() {
        let (mut master, slave) = support::terminal();
        let slave = fs::File::options().write(true).open(slave).unwrap();
        let mut child = command(&args)
            .env("PATH", &long.path)
            .env("TERM", "xterm")
            .stdout(Stdio::null())
            .stderr(slave)
            .spawn()
            .unwrap();
        let (mut seen, mut part) = (Vec::new(), [0; 4096]);
        // The read fails once nobody has the terminal open.
        while let Ok(read @ 1..) = master.read(&mut part) {
            seen.extend_from_slice(&part[..read]);
            let seen = String::from_utf8_lossy(&seen);
            // A download has a bar of its own.
            if seen.contains("reading ") || seen.contains("left") {
                let pid = rustix::process::Pid::from_child(&child);
                let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
            }
        }
        let status = child.wait().unwrap();
        assert_eq!(status.code(), Some(130), "{args:?}: no progress was shown");
    }
}
