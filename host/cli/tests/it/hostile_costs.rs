//! What files and ports may cost that somebody made to cost much: whole commands in
//! limits of their own.

use std::fs;
use std::io::BufWriter;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use mcap::records::MessageHeader;
use protocol::HostToDevice;
use recording::rosbag2::options;
use recording::session_file::SessionFile;
use recording::{MCAP_FILE, Topic};

use super::hostile_files::{command, limited, utf8};
use crate::support::synthetic::{self, Wrong};
use crate::support::{self, StandIn, code};
use test_support::interrupts::worked_s;

/// An MCAP file of `chunks` chunks of 16 MiB, each of the same message over and over but
/// for `noise` bytes that cannot be packed.
fn bomb(folder: &Path, topic: Topic, message: &[u8], chunks: usize, noise: usize) {
    fs::create_dir_all(folder).unwrap();
    let file = BufWriter::new(fs::File::create(folder.join(MCAP_FILE)).unwrap());
    let options = options().emit_message_indexes(false);
    let mut writer = options.create(mcap::write::NoSeek::new(file)).unwrap();
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
    let mut state = 1_u32;
    let noise: Vec<u8> = (0..noise)
        .map(|_| {
            // Numerical Recipes' generator: good enough not to be packed.
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        })
        .collect();
    let each = ((16 << 20) - noise.len()) / (31 + message.len());
    for _ in 0..chunks {
        if !noise.is_empty() {
            writer
                .write_to_known_channel(&noise_header, &noise)
                .unwrap();
        }
        for _ in 0..each {
            writer.write_to_known_channel(&header, message).unwrap();
        }
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
}

/// A time reference: stamp, empty names, time.
const TIMES: &[u8] = &[
    0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0,
    0,
];

#[test]
fn a_small_recording_that_unpacks_to_much_takes_little_memory() {
    let parent = tempfile::tempdir().unwrap();
    for (name, topic) in [("marks", Topic::Marker), ("pairs", Topic::Gnss)] {
        let folder = parent.path().join(name);
        // Within what a recording may unpack to.
        bomb(&folder, topic, TIMES, 20, (16 << 20) / 15);
        let output = limited(&["extract", utf8(&folder)]);
        assert_eq!(code(&output), 4, "{output:?}");
        let output = limited(&["verify", utf8(&folder)]);
        assert_eq!(code(&output), 13, "there is no session: {output:?}");
    }
}

/// A gigabyte in less than the 20 s of processor time that a command has here.
#[test]
fn what_a_small_file_unpacks_to_is_bounded() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("walk");
    bomb(&folder, Topic::Marker, TIMES, 60, 0);
    let length = fs::metadata(folder.join(MCAP_FILE)).unwrap().len();
    assert!(length < 5 << 20, "{length}");
    SessionFile::save(&synthetic::session(), &folder).unwrap();
    let out = parent.path().join("out");
    for (args, expected) in [
        (vec!["verify", utf8(&folder)], 4),
        (vec!["extract", utf8(&folder)], 4),
        (vec!["verify", utf8(&folder), "--repair", utf8(&out)], 4),
    ] {
        let output = limited(&args);
        assert_eq!(code(&output), expected, "{args:?}: {output:?}");
    }
}

/// A file that may grow no more is a full disk, and no reason to be ended by a signal.
#[test]
fn the_largest_file_size_is_as_a_full_disk() {
    let parent = tempfile::tempdir().unwrap();
    let folder = synthetic::make(parent.path(), Wrong::default());
    let (out, repaired) = (parent.path().join("out"), parent.path().join("repaired"));
    for args in [
        vec!["extract", utf8(&folder), "--out", utf8(&out)],
        vec!["verify", utf8(&folder), "--repair", utf8(&repaired)],
    ] {
        // Whoever runs the tests may have switched the signal off.
        let output = Command::new("env")
            .args([
                "--default-signal=XFSZ",
                "prlimit",
                "--fsize=4096",
                "--core=0",
            ])
            .arg(env!("CARGO_BIN_EXE_smartdepthsync"))
            .args(&args)
            .output()
            .unwrap();
        assert_eq!(code(&output), 13, "{args:?}: {output:?}");
    }
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

#[test]
fn the_first_ctrl_c_stops_every_command_that_reads_long() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("walk");
    bomb(&folder, Topic::Marker, TIMES, 100, (16 << 20) / 15);
    SessionFile::save(&synthetic::session(), &folder).unwrap();
    let out = parent.path().join("out");
    for args in [
        vec!["verify", utf8(&folder)],
        vec!["verify", utf8(&folder), "--repair", utf8(&out)],
        vec!["extract", utf8(&folder)],
    ] {
        let mut command = command(&args);
        let mut child = command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let pid = rustix::process::Pid::from_child(&child);
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
        let (status, asked_at) = ended_at(0.5);
        assert_eq!(status, None, "{args:?} ended by itself");
        rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
        let (status, _) = ended_at(asked_at + 3.0);
        assert_eq!(status.and_then(|s| s.code()), Some(130), "{args:?}");
    }
}
