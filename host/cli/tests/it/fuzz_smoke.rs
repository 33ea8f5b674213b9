//! A short, repeatable run of every fuzz target: over its corpus, and over a few
//! hundred mutations of it. No nightly compiler is needed. With
//! `SMARTDEPTHSYNC_FUZZ_SECONDS` in the environment each target runs for so long
//! instead, on inputs of its own (see the book, "Developing", also for `cargo fuzz`).
//!
//! A finding of a long run goes into `host/dev/fuzz/corpus/<target>/`, and is tried
//! here from then on.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use protocol::{
    Command, DeviceToHost, HostToDevice, ImuFlags, ImuSample, MAX_FRAME, Output, Period, Pulse,
    SayHello, SendFiller, SetPeriod, StopTrigger, Ticks, encode,
};
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use test_support::TestFolder;
use test_support::calibrations::{self, CHAIN};
use test_support::root;

use crate::support::synthetic;

/// Bytes of one kind that are right, to be changed.
fn corpus(target: &str) -> Vec<Vec<u8>> {
    let folder = root().join("host/dev/fuzz/corpus").join(target);
    let mut files: Vec<PathBuf> = fs::read_dir(&folder)
        .map(|entries| entries.map(|entry| entry.unwrap().path()).collect())
        .unwrap_or_default();
    files.sort();
    files.iter().map(|file| fs::read(file).unwrap()).collect()
}

/// Changes some bytes, cuts, doubles or joins: what lines and disks do, and worse.
fn mutate(rng: &mut Pcg64, seeds: &[Vec<u8>]) -> Vec<u8> {
    let mut data = seeds[rng.random_range(0..seeds.len())].clone();
    for _ in 0..rng.random_range(1..8) {
        if data.is_empty() {
            data.push(rng.random());
        }
        let at = rng.random_range(0..data.len());
        match rng.next_u32() % 7 {
            0 => data[at] ^= 1 << (rng.next_u32() % 8),
            1 => data[at] = [0, 1, 0x7F, 0x80, 0xFF][rng.random_range(0..5)],
            2 => data.truncate(at),
            3 => {
                let part = data[at..data.len().min(at + 64)].to_vec();
                data.splice(at..at, part);
            }
            4 => {
                let other = &seeds[rng.random_range(0..seeds.len())];
                let from = rng.random_range(0..=other.len());
                data.extend_from_slice(&other[from..]);
            }
            5 => {
                // A length that is far too large.
                let end = data.len().min(at + 8);
                data[at..end].fill(0xFF);
            }
            _ => {
                let end = data.len().min(at + 1 + rng.random_range(0..32));
                data.drain(at..end);
            }
        }
        // Small inputs find as much, sooner.
        data.truncate(1 << 20);
    }
    data
}

fn run(target: &str, body: fn(&[u8]), mut seeds: Vec<Vec<u8>>, rounds: u32) {
    seeds.extend(corpus(target));
    assert!(!seeds.is_empty(), "{target} has no corpus");
    for seed in &seeds {
        body(seed);
    }
    let seconds = std::env::var("SMARTDEPTHSYNC_FUZZ_SECONDS").ok();
    let seconds = seconds.map(|text| Duration::from_secs(text.parse().unwrap()));
    let begun = Instant::now();
    // Another start for every long run, printed so that it can be repeated.
    let start = match seconds {
        Some(_) => u64::from(std::process::id()) << 20 ^ 0x5eed,
        None => 0x5eed,
    };
    println!("{target}: starts from {start}");
    let mut rng = Pcg64::seed_from_u64(start);
    let mut round = 0_u64;
    while seconds.map_or(round < rounds.into(), |long| begun.elapsed() < long) {
        let data = mutate(&mut rng, &seeds);
        let result = std::panic::catch_unwind(|| body(&data));
        if result.is_err() {
            let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("finding_{target}"));
            fs::write(&kept, &data).unwrap();
            panic!("{target}, input {round}: kept in {}", kept.display());
        }
        round += 1;
    }
    println!("{target}: {round} inputs in {:.0?}", begun.elapsed());
}

#[test]
fn depth_recordings() {
    run(
        "depth_recording",
        fuzz_bodies::depth_recording,
        Vec::new(),
        3_000,
    );
}

#[test]
fn csv_of_the_phone() {
    run("phone_csv", fuzz_bodies::phone_csv, Vec::new(), 5_000);
}

#[test]
fn answers_of_the_phone() {
    run("phone_answer", fuzz_bodies::phone_answer, Vec::new(), 5_000);
}

#[test]
fn profiles() {
    let seeds = vec![recording::profile::DEFAULT.as_bytes().to_vec()];
    run("profile", fuzz_bodies::profile, seeds, 1_000);
}

#[test]
fn chains_of_kalibr() {
    let seed = CHAIN.as_bytes();
    run(
        "camchain",
        fuzz_bodies::camchain,
        vec![seed.to_vec()],
        1_000,
    );
}

#[test]
fn calibrations_of_depth_cameras() {
    let seed = calibrations::k4a().to_string().into_bytes();
    extract::geometry::check_calibration(&seed, "NFOV_UNBINNED", Some((1280, 720))).unwrap();
    run("calibration", fuzz_bodies::calibration, vec![seed], 2_000);
}

#[test]
fn bytes_of_the_link() {
    let mut stream = vec![7];
    let mut buffer = [0; MAX_FRAME];
    for number in 0..20_u32 {
        let sample = DeviceToHost::Imu(ImuSample {
            seq: number,
            at: Ticks(u64::from(number) * 96_000),
            flags: ImuFlags(0),
            accel: [1, -2, 8_192],
            temperature: 3,
            gyro: [4, 5, -6],
        });
        let pulse = DeviceToHost::Pulse(Pulse {
            output: Output::Camera,
            seq: number,
            train: 1,
            number: number.into(),
            at: Ticks(u64::from(number) * 1_600_000),
            aligned: true,
            readback: Some(4),
        });
        for message in [sample, pulse] {
            stream.extend_from_slice(encode(&message, &mut buffer).unwrap());
        }
    }
    run("link", fuzz_bodies::link, vec![stream], 3_000);
}

#[test]
fn recordings() {
    let parent = TestFolder::new();
    let folder = synthetic::make(parent.path(), synthetic::Wrong::default());
    let mut seed = fs::read(folder.join("recording.mcap")).unwrap();
    // The first two chunks and what belongs to them.
    seed.truncate(64 << 10);
    run("recording", fuzz_bodies::recording, vec![seed], 150);
}

#[test]
fn session_files() {
    let parent = TestFolder::new();
    let folder = synthetic::make(parent.path(), synthetic::Wrong::default());
    let seed = fs::read(folder.join("session.json")).unwrap();
    run("session_file", fuzz_bodies::session_file, vec![seed], 500);
}

#[test]
fn commands_to_the_board() {
    let mut stream = vec![5];
    let mut buffer = [0; MAX_FRAME];
    for id in 0..20 {
        let output = Output::Camera;
        let period = Period::from_ticks(1_600_000);
        for command in [
            Command::from(SayHello),
            SendFiller(id % 2 == 0).into(),
            SetPeriod { output, period }.into(),
            StopTrigger(output).into(),
        ] {
            let sent = HostToDevice { id, command };
            stream.extend_from_slice(encode(&sent, &mut buffer).unwrap());
        }
    }
    run("commands", fuzz_bodies::commands, vec![stream], 3_000);
}

#[test]
fn what_is_known_of_a_video() {
    let seeds = [
        r#"{"streams":[{"width":1920,"height":1080,"pix_fmt":"yuvj420p","color_range":"pc",
"avg_frame_rate":"485000/16167","nb_frames":"485","duration":"16.167"}]}"#,
        "1/90000\n0\n6006\n3003\n9009,\n",
        "timestamp\n1093470123456\n1093503456789,7\n",
    ];
    let seeds = seeds.iter().map(|seed| seed.as_bytes().to_vec()).collect();
    run("video_metadata", fuzz_bodies::video_metadata, seeds, 2_000);
}
