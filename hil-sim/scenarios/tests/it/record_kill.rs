//! A session that is killed at any moment leaves a file that opens and lacks at
//! most the last second, and a rig on which the next session simply starts.

use crate::whole_rig::{SPEED, Session, WholeRig};
use recording::reader::{Item, Reader};
use recording::session_file::SessionFile;
use rig::random::{Seed, Stream};
use rustix::process::Signal;

const TRIALS: usize = 50;

/// On rigs beside each other.
const RIGS: usize = 2;

/// The last moment before a kill, ms: longer than a chunk of the file is open. It passes as
/// fast as real time: the higher the speed, the more board time passes in the milliseconds
/// that a sample needs from the board to the file.
const LAST_MS: u64 = 600;

/// Most board time that may be missing at the end, s.
const MOST_MISSING: f64 = 1.0;

#[test]
fn a_kill_loses_at_most_a_second() {
    let mut random = Seed(11).stream(Stream::Test);
    // A whole session to its first seconds of recording takes 14 s of board time.
    let moments: Vec<f64> = (0..TRIALS).map(|_| random.uniform(0.0, 16.0)).collect();
    let (worst, recorded) = std::thread::scope(|scope| {
        let rigs: Vec<_> = moments
            .chunks(TRIALS / RIGS)
            .zip(11..)
            .map(|(moments, seed)| scope.spawn(move || kills(seed, moments)))
            .collect();
        let found = rigs.into_iter().map(|rig| rig.join().unwrap());
        found.fold((0.0, 0), |(worst, recorded), (missing, more)| {
            (missing.max(worst), recorded + more)
        })
    });
    println!("{TRIALS} kills, {recorded} while recording: at most {worst:.3} s missing");
    assert!(recorded >= 3, "only {recorded} kills came while recording");
}

/// Kills sessions so many seconds after their beginnings: most board time that was missing,
/// s, and how many were recording.
fn kills(seed: u64, moments: &[f64]) -> (f64, usize) {
    let rig = WholeRig::with(seed, SPEED, |_, phone| {
        // The app's wait for its 60th frame is 2 s; a faster camera saves time.
        phone.camera.first_frame_ms = (20.0, 50.0);
    });
    let mut worst = 0.0f64;
    let mut recorded = 0;
    for (trial, moment) in moments.iter().enumerate() {
        let name = format!("trial_{trial}");
        let mut session = Session::start(&mut rig.record(&name, &["--duration", "600s"]));
        session.wait_for("recording into");
        let begun = rig.rig.now();
        let moment_ms = (moment * 1e3) as u64;
        let last_ms = moment_ms.min(LAST_MS);
        rig.wait_ms(moment_ms - last_ms);
        rig.rig.set_speed(1.0);
        rig.wait_ms(last_ms);
        let killed = rig.rig.now();
        session.signal(Signal::KILL);
        let (status, said) = session.end();
        rig.rig.set_speed(SPEED);
        assert_eq!(status.code(), None, "trial {trial}: {said}");
        recorded += usize::from(said.contains("recording for"));
        // The phone's owner stops what the session could not.
        rig.stop_phone();

        let folder = rig.recording(&name);
        SessionFile::load(&folder).unwrap_or_else(|e| panic!("trial {trial}: {e}"));
        // Without a sample yet, all since the beginning is missing.
        let last = last_sample(&folder).max(begun.as_secs_f64());
        let missing = killed.as_secs_f64() - last;
        assert!(
            missing < MOST_MISSING,
            "trial {trial}, killed after {moment:.1} s: {missing:.3} s are missing; {said}"
        );
        worst = worst.max(missing);
    }
    // The last one left a train that runs: the next session takes it over.
    Session::start(&mut rig.record("after", &["--duration", "2s"])).ends_with(0);
    (worst, recorded)
}

/// Board time of the last sample, s; 0 without any.
fn last_sample(folder: &std::path::Path) -> f64 {
    let mut last = 0.0;
    for entry in Reader::open(folder).unwrap() {
        let entry = entry.unwrap();
        if matches!(entry.item, Item::Imu(_)) {
            last = entry.at.as_secs_f64();
        }
    }
    last
}
