//! Extraction judged against the ground truth, on synthetic recordings: ten virtual
//! minutes of hand-held motion, clocks that wander, a depth camera 300 ppm off
//! that drops frames. All figures here are of simulated recordings.

use crate::extract_vendor::Case;
use crate::synthetic::{DepthTruth, Synthetic, Truth};
use extract::layout::Format;
use extract::options::Options;
use extract::report::ExtractReport;
use test_support::browser;

/// Largest error and root mean square, µs.
fn errors(pairs: impl Iterator<Item = (i64, i64)>) -> (f64, f64) {
    let (mut largest, mut squares, mut count) = (0.0_f64, 0.0, 0_u32);
    for (found, true_time) in pairs {
        let error = (found - true_time) as f64 / 1000.0;
        largest = largest.max(error.abs());
        squares += error * error;
        count += 1;
    }
    (largest, (squares / f64::from(count.max(1))).sqrt())
}

fn check_depth(case: &Case, truth: &Truth) -> (f64, f64) {
    let rows = case.table("out/depth_frames.csv", &[2, 5]);
    let delivered: Vec<_> = truth.depth.iter().filter(|frame| frame.delivered).collect();
    assert_eq!(rows.len(), delivered.len());
    for (row, frame) in rows.iter().zip(&delivered) {
        assert_eq!(
            row[1],
            Some(frame.pulse as i64),
            "a depth frame has the wrong pulse"
        );
    }
    errors(
        rows.iter()
            .zip(&delivered)
            .map(|(row, frame)| (row[0].unwrap(), frame.center_ns)),
    )
}

// One recording, judged from all sides: it is too dear to be made for each.
#[test]
fn ten_minutes_are_within_ten_microseconds_of_the_truth() {
    let (case, truth) = Case::new(&Synthetic {
        seed: 7,
        seconds: 600,
        ..Synthetic::default()
    });
    let report = case.extract(None, "out", Options::default());
    let color = case.table("out/phone_frames.csv", &[2, 3]);
    assert_eq!(color.len(), truth.color_start_ns.len());
    let of = |column: usize, truth: &[i64]| {
        let found = color.iter().map(|row| row[column].unwrap());
        errors(found.zip(truth.iter().copied()))
    };
    let start = of(0, &truth.color_start_ns);
    let middle = of(1, &truth.color_middle_ns);
    let depth = check_depth(&case, &truth);
    println!(
        "simulated, 10 min: phone frames at most {:.2} µs (rms {:.2}), middles {:.2} (rms {:.2}), depth frames at most {:.2} µs (rms {:.2})",
        start.0, start.1, middle.0, middle.1, depth.0, depth.1
    );
    assert!(
        start.0 <= 10.0 && middle.0 <= 10.0,
        "phone frames: {start:?} {middle:?}"
    );
    assert!(depth.0 <= 6.0, "depth frames: {depth:?}");

    // All dropped frames are named, and nothing else.
    let found = report.depth.as_ref().unwrap();
    let is_there = |frame: &&DepthTruth| frame.delivered;
    let depth_of: Vec<_> = truth.depth.iter().filter(is_there).collect();
    let span = depth_of[0].pulse..depth_of[depth_of.len() - 1].pulse;
    let dropped = truth.depth.iter().filter(|frame| !frame.delivered);
    let dropped = dropped.map(|frame| frame.pulse);
    let dropped: Vec<u64> = dropped.filter(|pulse| span.contains(pulse)).collect();
    assert!(dropped.len() > 100);
    assert_eq!(found.missing, dropped);
    assert_eq!(found.matched, depth_of.len());
    let (rate, sigma) = found.rate_ppm.unwrap();
    assert!((rate - 300.0).abs() < 40.0 && sigma < 0.1, "{rate} {sigma}");

    // Every pair is the true one: middles that were aligned to each other.
    let pairs = case.table("out/pairs.csv", &[0, 2, 4]);
    let mut expected = Vec::new();
    for (index, frame) in depth_of.iter().enumerate() {
        let place = truth
            .color_middle_ns
            .partition_point(|&at| at < frame.center_ns - 16_665_000);
        if let Some(&at) = truth.color_middle_ns.get(place)
            && (at - frame.center_ns).abs() < 16_665_000
        {
            expected.push((place as i64, index as i64));
        }
    }
    let found: Vec<(i64, i64)> = pairs
        .iter()
        .map(|row| (row[0].unwrap(), row[1].unwrap()))
        .collect();
    assert_eq!(found, expected);
    for row in &pairs {
        let true_difference = depth_of[row[1].unwrap() as usize].center_ns
            - truth.color_middle_ns[row[0].unwrap() as usize];
        assert!((row[2].unwrap() - true_difference).abs() < 15_000);
    }

    // What the report says about itself.
    let clock = report.clock.as_ref().unwrap();
    assert_eq!(clock.source, "gyroscopes");
    assert!(
        clock.used > 40,
        "{} of {} windows",
        clock.used,
        clock.windows
    );
    assert!(
        (clock.skew_ppm - truth.skew_ppm).abs() < 0.5,
        "{} {}",
        clock.skew_ppm,
        truth.skew_ppm
    );
    let (period, sigma) = clock.frame_period_ns.unwrap();
    assert!(
        (period - truth.frame_period_ns).abs() < 5.0 * sigma.max(0.001),
        "{period} {sigma}"
    );
    assert!(clock.sigma_us.unwrap()[1] < 10.0, "{:?}", clock.sigma_us);

    // And as people see it.
    let pairs = format!("{} pairs of frames", expected.len());
    report::extraction::write(&case.path("out"), &report, &case.path("recording")).unwrap();
    browser::check(
        &case.path("out").join(report::REPORT_FILE),
        "extract",
        &[
            "Extraction of recording",
            &pairs,
            "Missing or damaged: ",
            "Time difference of the pairs",
            "depth − phone, µs",
            "The same over time, as measured",
            "Clock of the phone",
            "course, 1-sigma",
            "Settings: constants",
        ],
    );
}

#[test]
fn a_regular_train_is_settled_by_the_cameras_gyroscope_or_said_to_be_ambiguous() {
    let config = Synthetic {
        seed: 11,
        seconds: 60,
        slew: false,
        camera_imu: true,
        ..Synthetic::default()
    };
    let (case, truth) = Case::new(&config);
    let report = case.extract(None, "out", Options::default());
    let (largest, _) = check_depth(&case, &truth);
    assert!(largest <= 6.0, "{largest}");
    let decided = report.depth.unwrap().decided_by;
    assert!(decided.starts_with("the camera's gyroscope"), "{decided}");

    // The same without the camera's IMU: not guessed.
    let (case, truth) = Case::new(&Synthetic {
        camera_imu: false,
        ..config
    });
    let report = case.extract(None, "out", Options::default());
    let depth = report.depth.unwrap();
    let why = depth.not_matched.unwrap();
    assert!(
        why.contains("ambiguous") && why.contains("camera's IMU on"),
        "{why}"
    );
    assert_eq!(depth.images, 0);
    assert!(!case.path("out/mav0/depth0").exists());
    let loss = report
        .losses
        .iter()
        .find(|loss| loss.part == "depth")
        .unwrap();
    assert!(loss.what.contains("--first-pulse"), "{}", loss.what);

    // The user knows it: frame 0 was made by pulse 2.
    std::fs::remove_dir_all(case.path("out")).unwrap();
    let first = truth
        .depth
        .iter()
        .find(|frame| frame.delivered)
        .unwrap()
        .pulse;
    let report = case.extract(
        None,
        "out",
        Options {
            first_pulse: Some(first as usize),
            ..Options::default()
        },
    );
    assert!(report.depth.unwrap().decided_by.starts_with("the user"));
    check_depth(&case, &truth);
}

#[test]
fn damaged_and_missing_parts_leave_the_rest() {
    let (case, truth) = Case::new(&Synthetic {
        seed: 3,
        seconds: 40,
        crashed: true,
        marks: vec![20, 30],
        ..Synthetic::default()
    });
    let recording = case.path("recording");
    let whole = case.extract(None, "out", Options::default());
    let said = |report: &ExtractReport, part: &str, what: &str| {
        let found = report
            .losses
            .iter()
            .any(|loss| loss.part == part && loss.what.contains(what));
        assert!(found, "{part}: {what}\n{:#?}", report.losses);
    };
    // A depth recorder that was killed, a phone without its video.
    said(&whole, "depth", "did not close the file");
    said(&whole, "phone", "video");
    assert!(whole.depth.as_ref().unwrap().images > 1000);
    check_depth(&case, &truth);
    let folders: Vec<&str> = whole
        .sequences
        .iter()
        .map(|part| part.folder.as_str())
        .collect();
    assert_eq!(folders, ["seq_0", "seq_1", "seq_2"]);
    assert!(case.path("out/seq_1/mav0/depth0/data.csv").exists());

    // The board's file cut off in the middle, and a chunk of it damaged.
    let mcap = recording.join("recording.mcap");
    let bytes = std::fs::read(&mcap).unwrap();
    let mut damaged = bytes[..bytes.len() * 3 / 5].to_vec();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0xFF;
    std::fs::write(&mcap, &damaged).unwrap();
    std::fs::remove_file(recording.join("depth.mkv")).unwrap();
    std::fs::remove_dir_all(case.path("out")).unwrap();
    let part = case.extract(None, "out", Options::default());
    said(&part, "board", "was not closed");
    said(&part, "board", "the chunk at byte");
    said(&part, "depth", "there is no depth recording");
    let (all, left) = (whole.board.imu.samples, part.board.imu.samples);
    assert!(left > all / 2 && left < all * 2 / 3, "{left} of {all}");
    assert!(case.path("out/seq_1/mav0/imu1/data.csv").exists());

    // Without the phone's gyroscope the session's relation has to do.
    let gyro = recording.join("phone/20260131_140327/VID_20260131_140327gyro.csv");
    std::fs::remove_file(gyro).unwrap();
    std::fs::remove_dir_all(case.path("out")).unwrap();
    let session = case.extract(None, "out", Options::default());
    assert_eq!(session.clock.as_ref().unwrap().source, "session");
    said(&session, "phone", "gyroscope");
    let color = case.table("out/phone_frames.csv", &[2]);
    let worst = errors(
        color
            .iter()
            .map(|row| row[0].unwrap())
            .zip(truth.color_start_ns.iter().copied()),
    );
    assert!(worst.0 < 100.0, "{worst:?}");

    // Nothing of the board: an error that says what was expected.
    std::fs::remove_file(&mcap).unwrap();
    std::fs::remove_dir_all(case.path("out")).unwrap();
    let tum = case.try_extract(Format::Tum, None, "out", Options::default());
    let error = tum.unwrap_err().to_string();
    assert!(
        error.contains("expected a folder with recording.mcap"),
        "{error}"
    );
}
