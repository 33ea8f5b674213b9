//! The board is reset while a session records: the session goes on behind a mark,
//! and the extraction puts both runs on one axis of time, by the truth. All figures
//! are simulated.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use crate::turn;
use crate::whole_rig::{Session, WholeRig};
use extract::inputs::Options;
use extract::layout::Format;
use extract::progress::Silent;
use extract::report::BoardRunReport;
use extract::run::{Job, run};
use protocol::ResetCause;
use recording::reader::{Item, Reader};
use recording::session_file::{SessionFile, SessionOutcome};
use rig::depth_camera::{FrameRecord, Source};
use rig::k4a_mkv::{K4aSettings, write_frames};
use rig::oscillator::Oscillator;
use rig::phone::VideoTruth;
use rig::running_rig::RunTruth;
use stm32f4_sim::time::{SimTime, UNITS_PER_NANO};
use verify::{Verdict, verify};

/// Virtual time against real time. The host's clock then says little about how long
/// the board was away, and the session must know that.
const SPEED: f64 = 4.0;

/// Largest error of a time, µs: two relations of a quarter of a minute of twisting
/// each.
const LIMIT_US: f64 = 25.0;

/// Cells of a table as integers, a row for each line but the first.
fn table(path: &Path, columns: &[usize]) -> Vec<Vec<Option<i64>>> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            columns.iter().map(|&c| cells[c].parse().ok()).collect()
        })
        .collect()
}

/// The largest error of times found against the truth, µs.
fn largest(errors: impl Iterator<Item = i64>) -> f64 {
    errors
        .map(|e| e as f64 * 1e-3)
        .fold(0.0, |a, e| e.abs().max(a))
}

/// Board time from the first run's zero, ns.
fn nanos(truth: &RunTruth, at: SimTime) -> i64 {
    let units = i128::from(at.units()) - i128::from(truth.zero.unwrap().units());
    (units / i128::from(UNITS_PER_NANO)) as i64
}

/// The largest error of the frames of a phone's video, those in the gap left out, µs.
fn frames_off(
    table_of: &Path,
    reset: &BoardRunReport,
    truth: &RunTruth,
    (clock, videos): (&Oscillator, &[VideoTruth]),
) -> f64 {
    let rows = table(table_of, &[2]);
    let is_it = |video: &&VideoTruth| video.count == Some(rows.len());
    let video = videos.iter().rev().find(is_it).unwrap();
    let of_phone = |at: i64| {
        let at = clock.when_nanos(at).unwrap();
        nanos(truth, truth.parts.board.board_at(at))
    };
    largest(rows.iter().enumerate().filter_map(|(n, row)| {
        let at = row[0]?;
        let known = at < reset.last_before_ns || at > reset.from_ns;
        known.then(|| at - of_phone(video.frames.start_ns(n)))
    }))
}

fn write_depth(path: &Path, frames: &[FrameRecord]) {
    let file = BufWriter::new(File::create(path).unwrap());
    write_frames(file, K4aSettings::small(), frames, |_, pixels| {
        pixels.fill(700)
    })
    .unwrap();
}

#[test]
fn a_reset_is_marked_and_both_runs_are_extracted() {
    let _turn = turn::beside_others();
    over_a_reset(12);
}

/// Other cameras, hosts and twists. Slow: run by hand.
#[test]
#[ignore = "minutes of simulation; the seed above is run always"]
fn many_resets_are_extracted() {
    let _turn = turn::beside_others();
    for seed in 100..120 {
        println!("seed {seed}");
        over_a_reset(seed);
    }
}

/// One session, judged from all sides: it is too dear to be recorded for each.
fn over_a_reset(seed: u64) {
    let rig = WholeRig::with(seed, SPEED, |config, _| {
        config.depth_camera.as_mut().unwrap().drop_probability = 0.01;
    });
    let arguments = ["--duration", "48s", "--fetch-video"];
    // A camera that is led faster than its tolerance leaves the pulses and comes a pulse
    // late, which looks like frames that are one pulse off.
    let profile = rig
        .full_rate_profile()
        .replace("slew_us = 1000", "slew_us = 150");
    let mut session = Session::start(&mut rig.record_with("reset", &profile, &arguments));
    session.wait_for("recording for");
    rig.wait_ms(16_000);
    rig.rig.press_reset();
    session.wait_for("on its former grid again");
    let said = session.ends_with(4);
    assert!(said.contains("the board was reset (reset pin)"), "{said}");
    assert!(!rig.phone().is_recording());

    let folder = rig.recording("reset");
    let file = SessionFile::load(&folder).unwrap();
    assert_eq!(file.outcome, Some(SessionOutcome::Loss));
    let [mark] = file.runs.as_slice() else {
        panic!("{:?}", file.runs);
    };
    assert_eq!(mark.reset_cause, ResetCause::Pin);
    assert!(mark.from > mark.last && mark.anchor.unwrap() > mark.from);
    // A host whose clock does not go like the board's says so.
    assert!(mark.shift_sigma_us > 10_000.0, "{mark:?}");
    let checked = verify(&folder, &|| false).unwrap();
    assert_eq!(checked.verdict, Verdict::Incomplete, "{checked:?}");
    assert_eq!(checked.board_runs, 2);
    let grid = checked.grid.unwrap();
    assert!(grid.checked > 900 && grid.off == 0, "{grid:?}");

    let WholeRig { rig, folder: all } = rig;
    let truth = rig.stop().unwrap();
    write_depth(&folder.join("depth.mkv"), &truth.depth);
    let out = all.path().join("data");
    let job = Job {
        recording: folder,
        phone: Some(all.path().join("phone")),
        depth: None,
        format: Format::Euroc,
        out: out.clone(),
        options: Options::default(),
        overwrite: false,
    };
    let report = run(&job, &Silent).unwrap();
    let [run] = report.board.runs.as_slice() else {
        panic!("{:?}", report.board.runs);
    };
    assert_eq!(run.by, "gyroscopes", "{:?}", report.remarks);
    assert!(run.sigma_us < 20.0, "{run:?}");
    // The session knew only roughly where the run belongs.
    assert!(run.moved_ns.abs() > 100_000, "{run:?}");

    // Each run has a grid of its own, on which the frames lie evenly.
    let (Some(before), [behind]) = (report.grid, report.later_grids.as_slice()) else {
        panic!("{:?} {:?}", report.grid, report.later_grids);
    };
    for grid in [before, *behind] {
        assert!(grid.pulses > 300 && grid.residual_us < 20.0, "{grid:?}");
    }
    println!("{before:?}\n{behind:?}");

    let nanos = |at: SimTime| nanos(&truth, at);
    // The board's samples, each at the edge next to it.
    let edges: Vec<i64> = truth
        .imu
        .iter()
        .filter(|record| record.edge)
        .map(|record| nanos(record.at))
        .collect();
    let delay = report.constants.board_imu_delay_ns;
    let rows = table(&out.join("mav0/imu0/data.csv"), &[0]);
    let errors: Vec<(i64, i64)> = rows
        .iter()
        .map(|row| {
            let at = row[0].unwrap() + delay;
            let next = edges.partition_point(|&edge| edge < at);
            let near = [next.saturating_sub(1), next.min(edges.len() - 1)];
            let error = near.map(|n| at - edges[n]);
            (at, error[usize::from(error[1].abs() < error[0].abs())])
        })
        .collect();
    let first = largest(errors.iter().filter(|e| e.0 < run.from_ns).map(|e| e.1));
    let second = largest(errors.iter().filter(|e| e.0 >= run.from_ns).map(|e| e.1));
    let later = errors.iter().filter(|e| e.0 >= run.from_ns).count();
    assert!(later > 8_000 && errors.len() - later > 8_000);

    // The phone's frames, those in the gap left out.
    let clock = truth.phone_clock.as_ref().unwrap();
    let video = (clock, truth.videos.as_slice());
    let color = frames_off(&out.join("phone_frames.csv"), run, &truth, video);

    // The depth camera's: those of both runs' pulses, and between them its own.
    let told = report.depth.as_ref().unwrap();
    assert_eq!(told.not_matched, None);
    let delivered: Vec<_> = truth.depth.iter().filter(|f| f.delivered).collect();
    let rows = table(&out.join("depth_frames.csv"), &[2, 3]);
    assert_eq!(rows.len(), delivered.len());
    let in_gap = |at: i64| at > run.last_before_ns && at < run.from_ns;
    let (mut first_run, mut second_run, mut between) = (Vec::new(), Vec::new(), Vec::new());
    for (row, frame) in rows.iter().zip(&delivered) {
        let (at, center) = (row[0].unwrap(), nanos(frame.center));
        match (frame.source, row[1]) {
            // By the camera's clock, as those of pulses that nobody heard of.
            (_, None) => between.push(at - center),
            (Source::Pulse { .. }, Some(_)) if center < run.from_ns => first_run.push(at - center),
            (Source::Pulse { .. }, Some(_)) => second_run.push(at - center),
            // The camera's own, beside a pulse: while the trigger was moved, not here.
            (Source::FreeRun, Some(_)) => assert!(!in_gap(center), "{frame:?}"),
        }
    }
    assert!(first_run.len() > 400 && second_run.len() > 400 && between.len() > 10);
    let gap = between.len();
    let of_own_clock = largest(between.into_iter());
    let depth = largest(first_run.into_iter().chain(second_run));

    println!(
        "simulated: run moved by {:+.3} ms (session's sigma {:.1} ms) ± {:.1} µs; samples at most \
         {first:.3} µs off before and {second:.1} µs after the reset, phone frames {color:.1} µs, \
         depth frames {depth:.1} µs, {gap} of the gap {of_own_clock:.1} µs",
        run.moved_ns as f64 * 1e-6,
        mark.shift_sigma_us * 1e-3,
        run.sigma_us,
    );
    assert!(first < 0.1, "{first}");
    assert!(second < LIMIT_US && second < 5.0 * run.sigma_us + 0.1);
    assert!(color < LIMIT_US && depth < LIMIT_US);
    assert!(of_own_clock < 2.0 * LIMIT_US);
}

#[test]
fn a_further_phone_is_related_anew_and_extracted_over_the_reset() {
    let _turn = turn::beside_others();
    let rig = WholeRig::with_phones(14, SPEED, 2, |_, _| {});
    let profile = rig.profile_of(&["left", "right"]);
    let arguments = ["--duration", "48s", "--second-twist", "--fetch-video"];
    let mut command = rig.record_with("reset", &profile, &arguments);
    let mut session = Session::start(&mut command);
    session.wait_for("recording for");
    rig.wait_ms(16_000);
    rig.rig.press_reset();
    session.wait_for("on its former grid again");
    session.ends_with(4);

    let folder = rig.recording("reset");
    let file = SessionFile::load(&folder).unwrap();
    let [mark] = file.runs.as_slice() else {
        panic!("{:?}", file.runs);
    };
    let right = &file.phones[0];
    // Where its frames lie is known as badly as the run, its clock as well as the
    // last twist.
    let placed = right.placement.unwrap();
    assert!(placed.offset_sigma_us >= mark.shift_sigma_us, "{placed:?}");
    let clock = right.clock.unwrap();
    assert!(clock.reference.0 > mark.from.as_secs_f64(), "{clock:?}");
    assert!(clock.covariance[0][0].sqrt() < 50e-6, "{clock:?}");
    let mut sources = Vec::new();
    for entry in Reader::open(&folder).unwrap() {
        if let Item::PhoneClock(clock) = entry.unwrap().item {
            assert_eq!(clock.header.frame_id, "right");
            sources.push(clock.source);
        }
    }
    let expected = [
        "twist 1",
        "after a reset of the board",
        "twist at the end, after a reset of the board",
    ];
    assert_eq!(sources, expected);

    let WholeRig { rig, folder: all } = rig;
    let truth = rig.stop().unwrap();
    write_depth(&folder.join("depth.mkv"), &truth.depth);
    let out = all.path().join("data");
    let place = |name: &str, storage: &str| (String::from(name), all.path().join(storage));
    let job = Job {
        recording: folder,
        phone: None,
        depth: None,
        format: Format::Euroc,
        out: out.clone(),
        options: Options {
            phones: vec![place("left", "phone"), place("right", "phone_1")],
            ..Options::default()
        },
        overwrite: false,
    };
    let report = run(&job, &Silent).unwrap();
    let [run] = report.board.runs.as_slice() else {
        panic!("{:?}", report.board.runs);
    };
    assert_eq!(run.by, "gyroscopes", "{:?}", report.remarks);
    // What the session knew is far off where the run was put.
    assert!(run.moved_ns.abs() > 100_000, "{run:?}");
    let clock = report.phones[0].clock.as_ref().unwrap();
    assert_eq!(clock.source, "gyroscopes", "{:?}", report.remarks);
    let clock = truth.phone_clock.as_ref().unwrap();
    let left = (clock, truth.videos.as_slice());
    let left = frames_off(&out.join("phone_frames.csv"), run, &truth, left);
    let (clock, videos) = &truth.others[0];
    let table = out.join("phones/right/phone_frames.csv");
    let right = frames_off(&table, run, &truth, (clock, videos));
    println!(
        "simulated: run moved by {:+.3} ms ± {:.1} µs; frames of the first phone at most {left:.1} µs \
         off, of the further one {right:.1} µs",
        run.moved_ns as f64 * 1e-6,
        run.sigma_us,
    );
    assert!(left < LIMIT_US && right < LIMIT_US);
}
