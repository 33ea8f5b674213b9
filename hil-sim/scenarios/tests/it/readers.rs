//! One recording of the whole simulated chain, with depth of full size by the camera maker's
//! own library, in the field's own readers: bags of images and samples,
//! registered depth.
//!
//! Its depth pictures are made up: a wall that comes nearer by a millimetre a frame.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::json;

use crate::extract_vendor::{Case, NFOV_UNBINNED, said};
use crate::support::smartdepthsync;
use extract::geometry::View;
use extract::layout::Format;
use extract::options::Options;
use recording::kalibr::into_profile;
use recording::profile::{DEFAULT, Pose};
use recording::session_file::SessionFile;
use scenarios::whole_chain::Plan;
use test_support::calibrations::{self, CHAIN};
use test_support::{browser, python, target};

fn check(script: &str, arguments: &[&Path]) {
    check_with(&python::python(), script, arguments);
}

fn check_with(python: &Path, script: &str, arguments: &[&Path]) {
    let scripts = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python");
    let printed = python::run_script_with(python, &scripts.join(script), arguments);
    // Ray says on standard output which nodes were lost.
    assert_eq!(printed.lines().last(), Some("ok"), "{printed}");
}

/// Converts a ROS 2 bag for ROS 1, as the book tells its users to.
fn convert(bag: &Path, converted: &Path) {
    let program = python::python().with_file_name("rosbags-convert");
    let status = Command::new(program)
        .arg("--src")
        .arg(bag)
        .arg("--dst")
        .arg(converted)
        .args(["--dst-typestore", "ros1_noetic"])
        .status();
    assert!(status.unwrap().success());
}

/// Longest time in which pip finds what fits together, once the files are on this computer.
const RESOLVED: Duration = Duration::from_secs(120);

/// pip by itself, without a lock, finds packages for each extra, and for all of them at once.
#[test]
#[ignore = "loads gigabytes from PyPI the first time"]
fn pip_resolves_each_extra_of_the_data_package() {
    let folder = tempfile::tempdir().unwrap();
    let venv = folder.path().join("venv");
    let made = Command::new("python3")
        .args(["-m", "venv"])
        .arg(&venv)
        .status();
    assert!(made.unwrap().success());
    let package = test_support::root().join("host/data/smartdepthsync-data");
    for extras in ["torch", "fleet", "s3", "lerobot", "lerobot,fleet,s3"] {
        let wanted = format!("{}[{extras}]", package.display());
        let resolve = || {
            let begun = Instant::now();
            let install = ["-m", "pip", "install", "--quiet", "--dry-run"];
            let ran = Command::new(venv.join("bin/python3"))
                .args(install)
                .arg(&wanted)
                .output();
            let ran = ran.unwrap();
            assert!(ran.status.success(), "{extras}: {ran:?}");
            begun.elapsed()
        };
        // The first time it loads.
        resolve();
        let took = resolve();
        println!("{extras}: {took:?}");
        assert!(took < RESOLVED, "{extras}: {took:?}");
    }
}

/// Depth frames of full size: each takes its time.
const FRAMES: usize = 36;
/// LeRobot's doctor asks for 100 pairs.
const MANY: usize = 120;

/// A recording of the whole chain, and a depth recording of full size for it.
struct Chain {
    case: Case,
    depth: PathBuf,
    /// Number of its frames, and of the video's.
    frames: usize,
    video: usize,
    options: Options,
}

fn record(frames: usize) -> Chain {
    let plan = Plan {
        ball: true,
        ..Plan::new(12, 6)
    };
    let case = Case::of_chain(&plan);
    // With the small pictures of the chain's own depth recording.
    case.extract(None, "times", Options::default());
    let begin = case.table("times/phone_frames.csv", &[3])[0][0];
    let rows = case.table("times/depth_frames.csv", &[1, 2, 3]);
    // The video's part is enough to read. It may not have the pattern of the pulses.
    let rows: Vec<_> = rows.iter().filter(|row| row[1] >= begin).collect();
    let times = rows.iter().map(|row| row[0].unwrap() / 1000);
    let device: Vec<i64> = times.take(frames).collect();
    let depth = full_size(&case, &device);
    let options = Options {
        all_pairs: true,
        first_pulse: rows[0][2].map(|pulse| pulse as usize),
        ..Options::default()
    };
    let video = case.table("times/phone_frames.csv", &[0]).len();
    Chain {
        case,
        depth,
        frames,
        video,
        options,
    }
}

#[test]
fn a_recording_of_the_whole_chain_is_what_its_readers_find() {
    let chain = record(FRAMES);
    bags_and_tables(&chain);
    registered(&chain);
}

#[test]
#[ignore = "its readers take gigabytes: `cargo xtask readers` installs and runs them"]
fn large_readers_find_the_same() {
    let chain = record(MANY);
    let [euroc, ros2] = extracted(&chain);
    let (calibration, color) = in_color(&chain);
    let check_large = |reader: &str, script, arguments: &[&Path]| {
        let python = target().join(format!("readers/{reader}/bin/python3"));
        check_with(&python, script, arguments);
    };
    let recording = chain.case.path("recording/recording.mcap");
    let bag = ros2.join("ros2/data.mcap");
    check_large("rerun", "check_rerun.py", &[&recording, &euroc, &bag]);
    check_large("open3d", "check_open3d.py", &[&calibration, &color]);
    let debian = Path::new("/usr/bin/python3");
    let converted = chain.case.path("ros1.bag");
    convert(&ros2.join("ros2"), &converted);
    check_with(debian, "check_rosbag.py", &[&euroc, &converted]);
    check_large("lerobot", "check_lerobot.py", &[&euroc]);
    let recording = chain.case.path("recording");
    check_large("fleet", "check_fleet.py", &[&recording, smartdepthsync()]);
}

/// A depth recording of full size with these device times, beside colour.
fn full_size(case: &Case, device: &[i64]) -> PathBuf {
    let jpeg = case.test_picture("depth.jpg", "1280x720", 1);
    let more = json!({
        "depth_mode": NFOV_UNBINNED, "size": [640, 576], "color": jpeg,
        "calibration": calibrations::k4a().to_string(),
    });
    case.vendor("depth", device, more)
}

/// The extraction as EuRoC and ROS 2, with what Kalibr found of the phone.
fn extracted(chain: &Chain) -> [PathBuf; 2] {
    let Chain { case, depth, .. } = chain;
    let mut session = SessionFile::load(&case.path("recording")).unwrap();
    let cameras = CHAIN.replace("1920, 1080", "320, 180");
    let (_, found) = into_profile(DEFAULT, Path::new("rig.toml"), None, &cameras).unwrap();
    session.profile.phone.cameras = vec![found.camera];
    session.profile.phone.from_imu = Some(found.from_imu);
    session.profile.task = Some(String::from("walk past the wall"));
    session.save(&case.path("recording")).unwrap();

    let formats = [(Format::Euroc, "euroc"), (Format::Ros2, "ros2")];
    formats.map(|(format, out)| {
        let report = case.extract_as(format, Some(depth), out, chain.options.clone());
        let phone = report.phone.unwrap();
        assert_eq!(phone.images, chain.video as u64, "{:#?}", report.losses);
        assert_eq!(report.depth.unwrap().color, chain.frames as u64);
        case.path(out)
    })
}

fn bags_and_tables(chain: &Chain) {
    let Chain {
        case,
        depth,
        options,
        ..
    } = chain;
    let [euroc, ros2] = &extracted(chain);
    // ROS 1 takes the same bag, converted.
    let converted = case.path("ros1.bag");
    convert(&ros2.join("ros2"), &converted);
    check("check_ros.py", &[euroc, ros2, &converted]);
    let recording = case.path("recording");
    check(
        "check_data.py",
        &[euroc, ros2, &recording, smartdepthsync()],
    );
    // The camera in the frame of the board's IMU: the inverse of Kalibr's T_cam_imu.
    let yaml = std::fs::read_to_string(euroc.join("mav0/cam0/sensor.yaml")).unwrap();
    assert!(yaml.contains("data: [0, 0, 1, -0.0015"), "{yaml}");

    // A second run changes nothing, and writes again a bag that is gone or damaged.
    let bag = ros2.join("ros2/data.mcap");
    let written = || bag.metadata().unwrap().modified().unwrap();
    let before = written();
    let report = case.extract_as(Format::Ros2, Some(depth), "ros2", options.clone());
    assert_eq!(written(), before);
    assert!(!ros2.join(".parts").exists());
    // Sample pairs stay in the report when their images are gone.
    let samples = std::fs::read_to_string(euroc.join("sample_pairs.svg")).unwrap();
    assert_eq!(samples.matches("<image ").count(), 12);
    let recording = case.path("recording");
    let session = SessionFile::load(&recording).ok();
    report::extraction::write(ros2, &report, &recording, session.as_ref()).unwrap();
    let page = ros2.join("report.html");
    assert!(std::fs::read_to_string(&page).unwrap().contains(&samples));
    browser::check(&page, "sample_pairs", &["Some pairs from the middle"]);
    let whole = std::fs::read(&bag).unwrap();
    std::fs::write(&bag, &whole[..whole.len() / 2]).unwrap();
    case.extract_as(Format::Ros2, Some(depth), "ros2", options.clone());
    assert!(std::fs::read(&bag).unwrap() == whole);
}

fn registered_to(chain: &Chain, view: View) -> Options {
    Options {
        view: Some(view),
        ..chain.options.clone()
    }
}

/// The camera's calibration, and the extraction as TUM with depth registered to colour.
fn in_color(chain: &Chain) -> (PathBuf, PathBuf) {
    let Chain { case, depth, .. } = chain;
    let options = registered_to(chain, View::Color);
    let report = case.extract_as(Format::Tum, Some(depth), "color", options);
    assert_eq!(
        report.depth.unwrap().images,
        chain.frames as u64,
        "{:#?}",
        report.losses
    );
    let path = case.path("calibration.json");
    std::fs::write(&path, calibrations::k4a().to_string()).unwrap();
    (path, case.path("color"))
}

/// Depth registered to colour and to the phone, as the maker's library has it.
fn registered(chain: &Chain) {
    let Chain { case, depth, .. } = chain;
    // Without registration the two images do not lie over one another: no associations.
    let plain = case.extract_as(Format::Tum, None, "plain", Options::default());
    said(&plain, "associations.txt is for registered depth alone");
    assert!(!case.path("plain/associations.txt").exists());
    let (path, color) = in_color(chain);
    check("check_registered.py", &[&path, &color]);

    // To the phone it takes the profile, for the size of its images.
    let session = SessionFile::load(&case.path("recording")).unwrap();
    let of_phone = session.files.iter().find(|file| file.ends_with(".mp4"));
    let of_phone = format!("recording/{}", of_phone.unwrap());
    std::fs::remove_file(case.path(&of_phone)).unwrap();
    case.test_picture(&of_phone, "1280x720", chain.frames);
    let to_phone = registered_to(chain, View::Phone);
    let refused = case.extract_as(Format::Euroc, Some(depth), "refused", to_phone.clone());
    said(&refused, "phone.cameras");
    assert_eq!(refused.depth.unwrap().images, 0);
    // A phone that sees what the colour camera sees, from the same place.
    let mut session = session;
    let cameras = std::fs::read(case.path("color/cameras.json")).unwrap();
    let cameras: serde_json::Value = serde_json::from_slice(&cameras).unwrap();
    let same = serde_json::from_value(cameras["color"]["intrinsics"].clone()).unwrap();
    let pose = Pose([
        [0.0, -1.0, 0.0, 0.02],
        [0.0, 0.0, -1.0, 0.03],
        [1.0, 0.0, 0.0, -0.1],
        [0.0, 0.0, 0.0, 1.0],
    ]);
    session.profile.phone.cameras = vec![same];
    session.profile.phone.from_imu = Some(pose);
    session.profile.depth.color_from_imu = Some(pose);
    session.save(&case.path("recording")).unwrap();
    let report = case.extract_as(Format::Euroc, Some(depth), "phone", to_phone);
    assert_eq!(report.depth.unwrap().images, chain.frames as u64);
    check(
        "check_registered.py",
        &[&path, &color, &case.path("phone/mav0")],
    );
    let yaml = std::fs::read_to_string(case.path("phone/mav0/cam0/sensor.yaml")).unwrap();
    assert!(yaml.contains("distortion_model: rational"), "{yaml}");
    // The camera in the frame of the board's IMU: the inverse of from_imu.
    assert!(yaml.contains("data: [0, 0, 1, 0.1"), "{yaml}");
    assert!(yaml.contains("direction: down}"), "{yaml}");
    // And with each image, how its rows follow one another.
    let phone = &session.profile.phone;
    let row_ns = (1e3 * phone.readout_us) as u32 / (phone.rows - 1);
    let frames = std::fs::read_to_string(case.path("phone/phone_frames.csv")).unwrap();
    let shutter = format!(",{row_ns},down");
    let mut rows = frames.lines().skip(1);
    assert!(rows.all(|row| row.ends_with(&shutter)), "{shutter}");
}
