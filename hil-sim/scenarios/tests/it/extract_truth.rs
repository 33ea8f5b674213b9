//! Extraction judged against the ground truth, on synthetic recordings: ten virtual
//! minutes of hand-held motion, clocks that wander, a depth camera 300 ppm off
//! that drops frames. All figures here are of simulated recordings.

use std::sync::OnceLock;

use crate::extract_vendor::Case;
use crate::synthetic::{DepthTruth, Synthetic, Truth};
use extract::layout::Format;
use extract::options::Options;
use extract::report::{ClockSource, Decision, ExtractReport, HintSource, LossPart, MatchError};
use recording::session_file::SessionFile;
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

/// Ten minutes of a recording, and the data set that was extracted from it.
struct TenMinutes {
    case: Case,
    truth: Truth,
    report: ExtractReport,
}

impl TenMinutes {
    fn delivered(&self) -> Vec<&DepthTruth> {
        let depth = self.truth.depth.iter();
        depth.filter(|frame| frame.delivered).collect()
    }

    /// Pairs of a phone frame and a depth frame whose middles are nearest to each other.
    fn true_pairs(&self) -> Vec<(i64, i64)> {
        const HALF_PERIOD_NS: i64 = 16_665_000;
        let middles = &self.truth.color_middle_ns;
        let pair = |(index, frame): (usize, &&DepthTruth)| {
            let place = middles.partition_point(|&at| at < frame.center_ns - HALF_PERIOD_NS);
            let away = (middles.get(place)? - frame.center_ns).abs();
            (away < HALF_PERIOD_NS).then_some((place as i64, index as i64))
        };
        self.delivered()
            .iter()
            .enumerate()
            .filter_map(pair)
            .collect()
    }
}

/// Returns the recording of all tests about ten minutes: it is too expensive to make for each.
fn ten_minutes() -> &'static TenMinutes {
    static MADE: OnceLock<TenMinutes> = OnceLock::new();
    let made = MADE.get_or_init(|| {
        let settings = Synthetic {
            seed: 7,
            seconds: 600,
            ..Synthetic::default()
        };
        let (case, truth) = Case::lasting("ten_minutes", &settings);
        let report = case.extract(None, "out", Options::default());
        TenMinutes {
            case,
            truth,
            report,
        }
    });
    println!("recording and data set: {}", made.case.path("").display());
    made
}

#[test]
fn phone_frames_are_within_ten_microseconds_of_the_ground_truth() {
    let TenMinutes { case, truth, .. } = ten_minutes();
    let color = case.table("out/phone_frames.csv", &[2, 3]);
    assert_eq!(color.len(), truth.color_start_ns.len());
    for (column, true_times) in [&truth.color_start_ns, &truth.color_middle_ns]
        .into_iter()
        .enumerate()
    {
        let found = color.iter().map(|row| row[column].unwrap());
        let (largest, rms) = errors(found.zip(true_times.iter().copied()));
        println!("simulated, 10 min: phone frames at most {largest:.2} µs (rms {rms:.2})");
        assert!(largest <= 10.0, "column {column}");
    }
}

#[test]
fn depth_frames_have_their_pulses_and_are_within_six_microseconds() {
    let TenMinutes { case, truth, .. } = ten_minutes();
    let (largest, rms) = check_depth(case, truth);
    println!("simulated, 10 min: depth frames at most {largest:.2} µs (rms {rms:.2})");
    assert!(largest <= 6.0);
}

#[test]
fn depth_frames_that_were_lost_are_named_and_no_others() {
    let made = ten_minutes();
    let delivered = made.delivered();
    let span = delivered[0].pulse..delivered[delivered.len() - 1].pulse;
    let lost = made.truth.depth.iter().filter(|frame| !frame.delivered);
    let lost: Vec<u64> = lost
        .map(|frame| frame.pulse)
        .filter(|pulse| span.contains(pulse))
        .collect();
    assert!(lost.len() > 100);
    let found = made.report.depth.as_ref().unwrap();
    assert_eq!(found.missing, lost);
    assert_eq!(found.matched, delivered.len());
    let (rate, sigma) = found.rate_ppm.unwrap();
    assert!((rate - 300.0).abs() < 40.0 && sigma < 0.1, "{rate} {sigma}");
}

#[test]
fn pairs_are_of_frames_that_were_aligned_to_each_other() {
    let made = ten_minutes();
    let delivered = made.delivered();
    let rows = made.case.table("out/pairs.csv", &[0, 2, 4]);
    let pair = |row: &Vec<Option<i64>>| (row[0].unwrap(), row[1].unwrap());
    assert_eq!(rows.iter().map(pair).collect::<Vec<_>>(), made.true_pairs());
    for row in &rows {
        let (phone, depth) = pair(row);
        let true_difference =
            delivered[depth as usize].center_ns - made.truth.color_middle_ns[phone as usize];
        assert!((row[2].unwrap() - true_difference).abs() < 15_000);
    }
}

#[test]
fn the_reported_clock_is_within_its_own_errors() {
    let TenMinutes { truth, report, .. } = ten_minutes();
    let clock = report.clock.as_ref().unwrap();
    assert_eq!(clock.source, ClockSource::Gyroscopes);
    assert!(clock.used > 40, "{} of {}", clock.used, clock.windows);
    let skew_error_ppm = clock.skew_ppm - truth.skew_ppm;
    assert!(skew_error_ppm.abs() < 0.5, "{skew_error_ppm}");
    let (period, sigma) = clock.frame_period_ns.unwrap();
    let period_error = period - truth.frame_period_ns;
    assert!(
        period_error.abs() < 5.0 * sigma.max(0.001),
        "{period} {sigma}"
    );
    assert!(clock.sigma_us.unwrap()[1] < 10.0, "{:?}", clock.sigma_us);
}

#[test]
fn the_page_shows_pairs_losses_and_the_clock() {
    let made = ten_minutes();
    let out = made.case.path("out");
    let pairs = format!("{} pairs of frames", made.true_pairs().len());
    let recording = made.case.path("recording");
    let session = SessionFile::load(&recording).ok();
    report::extraction::write(&out, &made.report, &recording, session.as_ref()).unwrap();
    browser::check(
        &out.join(report::REPORT_FILE),
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

/// Origin of the hint that decided which pulse made which frame.
fn hint_source(report: &ExtractReport) -> Option<HintSource> {
    match report.depth.as_ref()?.decided_by? {
        Decision::Hint { source, .. } => Some(source),
        Decision::Pattern { .. } => None,
    }
}

#[test]
fn a_regular_train_is_settled_by_the_cameras_gyroscope_or_is_ambiguous() {
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
    assert_eq!(hint_source(&report), Some(HintSource::CameraGyroscope));

    // The same without the camera's IMU: not guessed.
    let (case, truth) = Case::new(&Synthetic {
        camera_imu: false,
        ..config
    });
    let report = case.extract(None, "out", Options::default());
    let depth = report.depth.unwrap();
    let reason = depth.not_matched.unwrap();
    assert!(
        matches!(&reason, MatchError::Ambiguous(left) if !left.has_imu),
        "{reason}"
    );
    assert!(reason.to_string().contains("camera's IMU on"), "{reason}");
    assert_eq!(depth.images, 0);
    assert!(!case.path("out/mav0/depth0").exists());
    let loss = report
        .losses
        .iter()
        .find(|loss| loss.part == LossPart::Depth)
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
    assert_eq!(hint_source(&report), Some(HintSource::User));
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
    let said = |report: &ExtractReport, part: LossPart, what: &str| {
        let found = report
            .losses
            .iter()
            .any(|loss| loss.part == part && loss.what.contains(what));
        assert!(found, "{part:?}: {what}\n{:#?}", report.losses);
    };
    // A depth recorder that was killed, a phone without its video.
    said(&whole, LossPart::Depth, "did not close the file");
    said(&whole, LossPart::Phone, "video");
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
    said(&part, LossPart::Board, "was not closed");
    said(&part, LossPart::Board, "the chunk at byte");
    said(&part, LossPart::Depth, "there is no depth recording");
    let (all, left) = (whole.board.imu.samples, part.board.imu.samples);
    assert!(left > all / 2 && left < all * 2 / 3, "{left} of {all}");
    assert!(case.path("out/seq_1/mav0/imu1/data.csv").exists());

    // Without the phone's gyroscope the session's relation has to do.
    let gyro = recording.join("phone/20260131_140327/VID_20260131_140327gyro.csv");
    std::fs::remove_file(gyro).unwrap();
    std::fs::remove_dir_all(case.path("out")).unwrap();
    let session = case.extract(None, "out", Options::default());
    let clock = session.clock.as_ref().unwrap();
    assert_eq!(clock.source, ClockSource::Session);
    said(&session, LossPart::Phone, "gyroscope");
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
