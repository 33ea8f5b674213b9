//! The hostile campaign, a few seeds of it. `cargo xtask hil-sim hostile` runs more.

use std::cell::OnceCell;
use std::io::Write as _;

use crate::support;
use crate::turn;
use scenarios::hostile::{bag, campaign, limits};

#[test]
fn absurd_values_in_valid_files_do_no_harm() {
    let _turn = turn::beside_others();
    let seeds: Vec<u64> = (1..=24).collect();
    let outcome = campaign(support::smartdepthsync(), &seeds, &|_, _| {}).unwrap();
    let failed: Vec<String> = outcome.failed.iter().map(ToString::to_string).collect();
    assert!(failed.is_empty(), "{}", failed.join("\n"));
    assert!(outcome.by_command().len() >= 5, "most commands were drawn");
}

/// 64 MiB of one pair of times over and over, packed to a few kB, many times: in memory
/// and time bounded by the file's length, and told.
#[test]
fn a_small_bag_that_unpacks_to_much_costs_little() {
    let _turn = turn::beside_others();
    let place = tempfile::tempdir().unwrap();
    let work = place.path().canonicalize().unwrap().join("work");
    std::fs::create_dir(&work).unwrap();
    let one = bag::time_reference("/mcu_cameras_ts", 1, 1_000_000_000, 2_000_000_000);
    let messages = vec![one; (30 << 20) / 100];
    // The same bytes both times.
    let packed = OnceCell::new();
    let pack = |bytes: &[u8]| {
        let packed = packed.get_or_init(|| {
            let mut packer = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
            packer.write_all(bytes).unwrap();
            packer.finish().unwrap()
        });
        packed.clone()
    };
    for times in [1, 1_000] {
        let file = bag::bag(&messages, ("bz2", &pack), times);
        assert!(file.len() < 20 << 20, "{}", file.len());
        std::fs::write(work.join("bomb.bag"), file).unwrap();
        let out = format!("out-{times}");
        let arguments = [
            "extract",
            "bomb.bag",
            "--out",
            &out,
            "--exposure-us",
            "4000",
        ];
        let arguments = arguments.map(std::ffi::OsString::from);
        let program = support::smartdepthsync();
        let ended = limits::run(program, &arguments, &work, place.path()).unwrap();
        assert_eq!(ended.code, Some(4), "{times}: {} {}", ended.how, ended.said);
        assert!(ended.peak < 500_000_000, "{times}: {} bytes", ended.peak);
        assert_eq!(ended.strays, Vec::<String>::new());
    }
}
