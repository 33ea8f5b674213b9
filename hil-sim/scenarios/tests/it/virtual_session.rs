//! Sessions in one thread on virtual time: a seed is one recording, to the byte.

use test_support::contents;

use crate::bench::Twisted;

#[test]
fn a_seed_is_one_recording_to_the_byte() {
    // The recording's log names its folder.
    let mut folder = None;
    let mut record = || {
        let mut rig = Twisted::new(1);
        let place = folder.get_or_insert_with(|| tempfile::tempdir().unwrap());
        rig.bench.out = place.path().to_owned();
        rig.bench.has_recorder = true;
        let mut options = rig.options("recording", 5);
        options.fetch_video = true;
        let ended = rig.bench.run(&options).good().unwrap();
        let files = contents(&ended.folder);
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
