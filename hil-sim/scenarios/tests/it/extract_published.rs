//! A bag of the published system, written by public tools from the real gyroscope
//! recordings, converted by the command that its refusal names, extracted and read back by
//! public tools.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::support::run_python;
use extract::error::ExtractError;
use extract::layout::Format;
use extract::options::Options;
use extract::report::{ClockSource, ExtractReport, LossPart};
use extract::run::{Job, run};
use recording::profile::Profile;
use system::{Cancel, ReadMonitor};
use test_support::{contents, python};

fn twist() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../host/sync/twist-sync-python/python/twist_sync/example")
}

fn make_bag(folder: &Path, compression: &str) {
    let arguments = [&twist(), folder, Path::new(compression)];
    run_python("make_published_bag.py", &arguments);
    let mut refused = job(folder, Format::Euroc);
    refused.recording = folder.join("published.bag");
    let error = run(&refused).unwrap_err().to_string();
    assert!(error.contains("is a ROS 1 bag"), "{error}");
    python::run_conversion(&error);
}

fn job(folder: &Path, format: Format) -> Job {
    let mut profile = Profile::published().unwrap();
    profile.phone.gyro_delay_us = 0.0;
    if format == Format::Topics {
        // The published layout has the stamps of the pulses.
        profile.depth.center_offset_us = 0.0;
    }
    Job {
        recording: folder.join("published-mcap"),
        phone: Some(folder.join("phone")),
        depth: None,
        format,
        out: folder.join(format!("out-{}", format.name())),
        options: Options {
            profile: Some(profile),
            ..Options::default()
        },
        overwrite: false,
        monitor: ReadMonitor::default(),
    }
}

fn extract(folder: &Path, format: Format) -> (ExtractReport, PathBuf) {
    let job = job(folder, format);
    (run(&job).unwrap(), job.out)
}

/// Cancels at the read from the beginning of a file that follows on this number of them.
fn cancel_after(reads: usize) -> ReadMonitor {
    let begun = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&begun);
    let cancel = Cancel::when(move || begun.load(Ordering::Relaxed) > reads);
    ReadMonitor::new(cancel, move |progress| {
        counted.fetch_add(usize::from(progress.position == 0), Ordering::Relaxed);
    })
}

#[test]
fn the_bag_extracts_to_the_same_numbers() {
    let folder = tempfile::tempdir().unwrap();
    make_bag(folder.path(), "bz2");
    let (topics_report, topics) = extract(folder.path(), Format::Topics);
    let (report, euroc) = extract(folder.path(), Format::Euroc);
    let (_, tum) = extract(folder.path(), Format::Tum);
    let (_, kalibr) = extract(folder.path(), Format::Kalibr);
    let printed = run_python(
        "check_published.py",
        &[folder.path(), &topics, &euroc, &tum, &kalibr],
    );
    assert_eq!(printed.trim(), "ok");

    // What is missing is said: there is no video, and the camera dropped frames.
    let parts: Vec<LossPart> = report.losses.iter().map(|loss| loss.part).collect();
    assert_eq!(
        parts,
        [LossPart::Phone, LossPart::Depth],
        "{:#?}",
        report.losses
    );
    assert_eq!(topics_report.board.imu.samples, 4883);

    // The clocks by the gyroscopes, against the sync math on the whole files.
    let clock = report.clock.unwrap();
    assert_eq!(clock.source, ClockSource::Gyroscopes);
    let expected = whole_twist();
    assert!(
        (clock.offset_s - expected).abs() < 30e-6,
        "{} and {expected}",
        clock.offset_s
    );
}

/// Phone − board of the real twist by the sync math, in the middle of the data.
fn whole_twist() -> f64 {
    use twist_sync::{GyroTrack, Options, estimate_offset};
    let read = |name: &str| {
        let text = std::fs::read_to_string(twist().join(name)).unwrap();
        let mut times = Vec::new();
        let mut rates = Vec::new();
        for line in text.lines().skip(1) {
            let row: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            times.push(row[0]);
            rates.push([row[1], row[2], row[3]]);
        }
        GyroTrack::from_seconds(&times, rates)
    };
    let options = Options {
        a_delay_s: 1.9e-3,
        ..Options::default()
    };
    let mcu = read("mcu_gyro_data.csv");
    let phone = read("smartphone_gyro_data.csv");
    let estimate = estimate_offset(&mcu, &phone, &options).unwrap();
    let middle = mcu.epoch_s + 0.5 * mcu.t[mcu.t.len() - 1];
    estimate.clock.offset_at(middle).value
}

#[test]
fn a_second_run_changes_nothing_and_inputs_are_not_touched() {
    let folder = tempfile::tempdir().unwrap();
    make_bag(folder.path(), "none");
    let before = contents(folder.path());
    let (first, out) = extract(folder.path(), Format::Euroc);
    let written = contents(&out);
    let (second, _) = extract(folder.path(), Format::Euroc);
    assert_eq!(first, second);
    assert_eq!(written, contents(&out));
    // A run that was stopped in the middle of the images: the next one ends alike.
    let is_image = |path: &&PathBuf| path.extension().is_some_and(|ending| ending == "png");
    for image in written.keys().filter(is_image).step_by(3) {
        std::fs::remove_file(out.join(image)).unwrap();
    }
    std::fs::remove_file(out.join("report.json")).unwrap();
    std::fs::remove_file(out.join(".extraction/depth.json")).unwrap();
    let (third, _) = extract(folder.path(), Format::Euroc);
    assert_eq!(first, third);
    assert_eq!(written, contents(&out));
    // One that is stopped at many places, later each time, and taken up again.
    std::fs::remove_dir_all(&out).unwrap();
    let mut stops = 0;
    let last = loop {
        let job = Job {
            monitor: cancel_after(stops),
            ..job(folder.path(), Format::Euroc)
        };
        match run(&job) {
            Err(ExtractError::Cancelled) => stops += 1 + stops / 8,
            end => break end.unwrap(),
        }
    };
    assert!(stops > 3, "{stops}");
    assert_eq!(first, last);
    assert_eq!(written, contents(&out));
    std::fs::remove_dir_all(&out).unwrap();
    assert_eq!(before, contents(folder.path()));
}
