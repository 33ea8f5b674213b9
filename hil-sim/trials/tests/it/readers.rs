//! One recording of the whole simulated chain, with depth of full size by the camera maker's
//! own library, in the field's own readers: bags of images and samples, LeRobot's tables,
//! registered depth.
//!
//! Its depth pictures are made up: a wall that comes nearer by a millimetre a frame.

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::browser;
use crate::extract_vendor::{Case, NFOV_UNBINNED, calibration, said};
use crate::python;
use crate::turn;
use extract::geometry::View;
use extract::inputs::Options;
use extract::layout::Format;
use recording::profile::{DistortionModel, Intrinsics, Pose};
use recording::session_file::SessionFile;
use trials::whole_chain::Plan;

fn check(script: &str, arguments: &[&Path]) {
    let scripts = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python");
    let printed = python::run_script(&scripts.join(script), arguments);
    assert_eq!(printed.trim(), "ok");
}

#[test]
fn a_recording_of_the_whole_chain_is_what_its_readers_find() {
    let _turn = turn::beside_others();
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
    let device: Vec<i64> = rows.iter().map(|row| row[0].unwrap() / 1000).collect();
    let options = Options {
        first_pulse: rows[0][2].map(|pulse| pulse as usize),
        ..Options::default()
    };
    let video = case.table("times/phone_frames.csv", &[0]).len();
    bags_and_tables(&case, &device, video, &options);
    registered(&case, &device[..120], video, &options);
}

/// A depth recording of full size with these device times, beside colour.
fn full_size(case: &Case, name: &str, device: &[i64]) -> PathBuf {
    let jpeg = case.test_picture(&format!("{name}.jpg"), "1280x720", 1);
    let more = json!({
        "depth_mode": NFOV_UNBINNED, "size": [640, 576], "color": jpeg,
        "calibration": calibration().to_string(),
    });
    case.vendor(name, device, more)
}

fn bags_and_tables(case: &Case, device: &[i64], video: usize, options: &Options) {
    let depth = full_size(case, "depth", device);
    let mut session = SessionFile::load(&case.path("recording")).unwrap();
    session.profile.phone.cameras = vec![Intrinsics {
        width: 320,
        height: 180,
        focal: [50.0, 51.0],
        center: [31.5, 23.5],
        distortion: DistortionModel::Radtan,
        coefficients: vec![0.1, -0.2, 0.001, 0.002],
    }];
    session.save(&case.path("recording")).unwrap();

    let formats = [
        (Format::Euroc, "euroc"),
        (Format::Ros2, "two"),
        (Format::Ros1, "one"),
        (Format::Lerobot, "lerobot"),
    ];
    for (format, out) in formats {
        let report = case.extract_as(format, Some(&depth), out, options.clone());
        let phone = report.phone.unwrap();
        assert_eq!(phone.images, video as u64, "{:#?}", report.losses);
        let colored = report.depth.unwrap().color;
        let has_place = format != Format::Lerobot;
        assert_eq!(colored, if has_place { device.len() as u64 } else { 0 });
    }
    let outs = ["euroc", "two", "one", "lerobot"].map(|out| case.path(out));
    let [euroc, two, one, lerobot] = &outs;
    check("check_ros.py", &[euroc, two, one]);
    check("check_lerobot.py", &[euroc, lerobot]);

    // A second run changes nothing, and a bag that is gone cannot come back by itself.
    let bag = case.path("one/data.bag");
    let written = || bag.metadata().unwrap().modified().unwrap();
    let before = written();
    case.extract_as(Format::Ros1, Some(&depth), "one", options.clone());
    assert_eq!(written(), before);
    for out in [one, two, lerobot] {
        assert!(!out.join(".parts").exists());
    }
    // Sample pairs stay in the report when their images are gone.
    let samples = std::fs::read_to_string(euroc.join("sample_pairs.svg")).unwrap();
    assert_eq!(samples.matches("<image ").count(), 12);
    let page = one.join("report.html");
    assert!(std::fs::read_to_string(&page).unwrap().contains(&samples));
    browser::check(&page, "sample_pairs", &["Some pairs from the middle"]);
    std::fs::remove_file(&bag).unwrap();
    let error = case
        .try_extract(Format::Ros1, Some(&depth), "one", options.clone())
        .unwrap_err()
        .to_string();
    assert!(error.contains("--overwrite"), "{error}");
}

/// Depth registered to colour and to the phone, as the maker's library has it.
fn registered(case: &Case, device: &[i64], video: usize, options: &Options) {
    // Without registration the two images do not lie over one another: no associations.
    let plain = case.extract_as(Format::Tum, None, "plain", Options::default());
    said(&plain, "no associations.txt");
    assert!(!case.path("plain/associations.txt").exists());
    let depth = full_size(case, "part", device);
    let to = |view| Options {
        view: Some(view),
        ..options.clone()
    };
    let report = case.extract_as(Format::Tum, Some(&depth), "color", to(View::Color));
    let images = report.depth.as_ref().unwrap().images;
    assert_eq!(images, device.len() as u64, "{:#?}", report.losses);
    let path = case.path("calibration.json");
    std::fs::write(&path, calibration().to_string()).unwrap();
    check("check_registered.py", &[&path, &case.path("color")]);

    // To the phone it takes the profile, for the size of its images.
    let session = SessionFile::load(&case.path("recording")).unwrap();
    let of_phone = session.files.iter().find(|file| file.ends_with(".mp4"));
    let of_phone = format!("recording/{}", of_phone.unwrap());
    std::fs::remove_file(case.path(&of_phone)).unwrap();
    case.test_picture(&of_phone, "1280x720", video);
    let refused = case.extract_as(Format::Euroc, Some(&depth), "refused", to(View::Phone));
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
    let report = case.extract_as(Format::Euroc, Some(&depth), "phone", to(View::Phone));
    assert_eq!(report.depth.unwrap().images, device.len() as u64);
    let phone = case.path("phone/mav0/depth0/data");
    check("check_registered.py", &[&path, &case.path("color"), &phone]);
    let yaml = std::fs::read_to_string(case.path("phone/mav0/cam0/sensor.yaml")).unwrap();
    assert!(yaml.contains("distortion_model: rational"), "{yaml}");
    // The camera in the frame of the board's IMU: the inverse of from_imu.
    assert!(yaml.contains("data: [0, 0, 1, 0.1"), "{yaml}");
    assert!(yaml.contains("direction: down}"), "{yaml}");
}
