//! Sessions in one thread on virtual time: a seed is one recording, to the byte.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rig::motion::MotionSpec;
use rig::motion::gesture::Gesture;
use rig::phone::PhoneConfig;
use rig::random::Seed;
use rig::rig_config::RigConfig;
use rig::wiring;
use scenarios::virtual_session::Bench;
use session::options::seconds;

/// A rig whose person twists it all the time, with a phone of small pictures.
fn twisted(seed: u64, out: &Path) -> Bench {
    let config = RigConfig::published(Seed(seed)).with_motion(MotionSpec::always(Gesture::Twist));
    let mut phone = PhoneConfig::draw(Seed(seed));
    phone.camera.rows = 120;
    phone.camera.columns = 16;
    let board = wiring::board_of(config.board, None);
    let mut bench = Bench::new(config, board, vec![phone], &[], out).unwrap();
    bench.hurry();
    bench
}

/// All files below a folder.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false => {
                    let name = path.strip_prefix(folder).unwrap().to_owned();
                    found.insert(name, std::fs::read(path).unwrap());
                }
            }
        }
    }
    found
}

#[test]
fn a_seed_is_one_recording_to_the_byte() {
    // The recording's log names its folder.
    let out = tempfile::tempdir().unwrap();
    let record = || {
        let mut bench = twisted(1, out.path());
        bench.has_recorder = true;
        let mut options = bench.options("recording");
        options.duration = Some(seconds(5));
        options.fetch_video = true;
        let run = bench.run(&options);
        let ended = run.good().unwrap();
        let files = files(&ended.folder);
        std::fs::remove_dir_all(ended.folder).unwrap();
        files
    };
    let (first, second) = (record(), record());
    assert!(first.keys().eq(second.keys()));
    for (name, bytes) in &first {
        assert!(second[name] == *bytes, "{}", name.display());
    }
    assert!(first.keys().any(|name| name.ends_with("depth.mkv")));
}
