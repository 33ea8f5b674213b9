//! Bags of images and samples, and LeRobot's tables, read by the field's own libraries.

use std::path::Path;

use serde_json::json;

use crate::browser;
use crate::extract_vendor::{Case, calibration};
use crate::python;
use crate::synthetic::Synthetic;
use crate::turn;
use extract::inputs::Options;
use extract::layout::Format;
use recording::profile::{DistortionModel, Intrinsics};
use recording::session_file::SessionFile;

#[test]
fn bags_hold_what_the_folders_of_files_hold() {
    let _turn = turn::beside_others();
    let case = Case::new(&Synthetic {
        seed: 12,
        seconds: 25,
        ..Synthetic::default()
    });
    case.extract(None, "times", Options::default());
    let begin = case.table("times/phone_frames.csv", &[3])[0][0];
    let frames = case.table("times/depth_frames.csv", &[1, 2, 3]);
    // Seven seconds of the video are enough to read. They may not have the pattern of the
    // pulses.
    let frames: Vec<_> = frames
        .iter()
        .filter(|row| row[1] >= begin)
        .take(200)
        .collect();
    let device: Vec<i64> = frames.iter().map(|row| row[0].unwrap() / 1000).collect();
    let options = Options {
        first_pulse: frames[0][2].map(|pulse| pulse as usize),
        ..Options::default()
    };
    let jpeg = case.test_picture("color.jpg", "1280x720", 1);
    let more = json!({
        "color": jpeg, "size": [320, 288], "calibration": calibration().to_string(),
    });
    let depth = case.vendor("depth", &device, more);
    let stamps = case.table("times/phone_frames.csv", &[0]).len();
    case.test_picture("recording/phone/VID_20260131_140327.mp4", "64x48", stamps);
    let mut session = SessionFile::load(&case.path("recording")).unwrap();
    session.profile.phone.cameras = vec![Intrinsics {
        width: 64,
        height: 48,
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
        assert_eq!(phone.images, stamps as u64, "{:#?}", report.losses);
        let colored = report.depth.unwrap().color;
        let has_place = format != Format::Lerobot;
        assert_eq!(colored, if has_place { device.len() as u64 } else { 0 });
    }
    let check = |script: &str, outs: &[&Path]| {
        let scripts = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python");
        assert_eq!(python::run_script(&scripts.join(script), outs).trim(), "ok");
    };
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
        .try_extract(Format::Ros1, Some(&depth), "one", options)
        .unwrap_err()
        .to_string();
    assert!(error.contains("--overwrite"), "{error}");
}

/// A bag of a driver's, written by `rosbags`, gives what the camera's own file gives.
#[test]
fn depth_of_a_driver_s_bag_finds_its_pulses() {
    let _turn = turn::beside_others();
    let case = Case::new(&Synthetic {
        seed: 13,
        seconds: 20,
        slew: true,
        ..Synthetic::default()
    });
    case.extract(None, "own", Options::default());
    let own = case.table("own/depth_frames.csv", &[0, 1, 3]);
    let stamps: String = own
        .iter()
        .map(|row| format!("{}\n", row[1].unwrap()))
        .collect();
    std::fs::write(case.path("stamps.txt"), stamps).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/make_depth_bag.py");
    for storage in ["mcap", "sqlite3"] {
        let bag = case.path(storage);
        python::run_script(
            &script,
            &[&case.path("stamps.txt"), &bag, Path::new(storage)],
        );
        let out = format!("of_{storage}");

        // The same pulses for the same frames; only the start of the file may be undecided.
        let report = case.extract(Some(&bag), &out, Options::default());
        let of_bag = case.table(&format!("{out}/depth_frames.csv"), &[0, 1, 3]);
        assert_eq!(of_bag, own, "{:#?}", report.losses);
        let depth = report.depth.unwrap();
        assert_eq!(
            depth.images,
            own.iter().filter(|row| row[2].is_some()).count() as u64
        );

        // Each picture is the one of its frame.
        let folder = case.path(&format!("{out}/mav0/depth0/data"));
        let mut pictures: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|f| f.unwrap().path())
            .collect();
        pictures.sort();
        let frames: Vec<usize> = (0..own.len())
            .filter(|&frame| own[frame][2].is_some())
            .collect();
        assert_eq!(pictures.len(), frames.len());
        for (frame, picture) in frames.iter().zip(&pictures).step_by(37) {
            let pixels = image::open(picture).unwrap().into_luma16().into_raw();
            let expected: Vec<u16> = (0..24).map(|n| (1000 + 7 * frame + n) as u16).collect();
            assert_eq!(pixels, expected, "{}", picture.display());
        }
    }

    let topic = Options {
        depth_topic: Some(String::from("/camera/color/depth")),
        ..Options::default()
    };
    let losses = case
        .extract(Some(&case.path("sqlite3")), "none", topic)
        .losses;
    assert!(
        losses
            .iter()
            .any(|loss| format!("{loss:?}").contains("--depth-topic")),
        "{losses:?}"
    );
}
