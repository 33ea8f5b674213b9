//! A small recording of four seconds, made here, in every format.
//!
//! Times and a few rows are spelt out. Everything that is written is compared with
//! `small_recording.txt`: short files as they are, of longer ones the first and last rows,
//! of images the pixels, of bags the messages of each topic, with a checksum over what is not
//! shown. With SMARTDEPTHSYNC_BLESS in the environment that file is written again.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use board::imu::Sample;
use clock::{BoardToPhone, ClockRelation, PhoneNanos, Wander};
use extract::error::ExtractError;
use extract::layout::Format;
use extract::options::Options;
use extract::output::folder::OutputDirError;
use extract::report::{ExtractReport, LossPart};
use extract::run::{Job, run};
use protocol::{Output, Pps, Pulse, TICK_HZ, Ticks};
use recording::messages::camera::Image;
use recording::messages::{Header, Time, to_cdr};
use recording::profile::Profile;
use recording::rosbag2::{Bag, METADATA_FILE};
use recording::session_file::{Marker, SessionFile, SessionOutcome, Span};
use recording::walk::{Event, Walk};
use recording::writer::Writer;
use system::ReadMonitor;

const SECONDS: u64 = 4;
const SECOND_NS: i64 = 1_000_000_000;
const FIRST: u64 = 48_000_011;
/// Phone − board.
const OFFSET_NS: i64 = 900_000 * SECOND_NS;
/// From the pulse to the centre of exposure of the published rig's depth camera.
const CENTER_NS: i64 = 6_362_500;

/// The trigger's edges: a second on its grid, then a move by 100 µs a pulse, then on a grid
/// again, so that the depth frames tell which pulse is whose.
fn edges() -> Vec<Ticks> {
    let step = |number: u64| 1_600_000 + if (30..60).contains(&number) { 4_800 } else { 0 };
    let mut at = FIRST;
    let mut next = |number| {
        let edge = Ticks(at);
        at += step(number);
        edge
    };
    (0..SECONDS * 30).map(&mut next).collect()
}

fn nanos(at: Ticks) -> i64 {
    i64::try_from(at.as_nanos()).unwrap()
}

fn relation() -> ClockRelation {
    ClockRelation {
        reference: 2.0,
        offset: 900_000.0,
        skew: 0.0,
        covariance: [[1e-12, 0.0], [0.0, 1e-14]],
        wander: Wander::default(),
    }
}

fn write_board(folder: &Path) -> SessionFile {
    let mut writer = Writer::create(folder).unwrap();
    let edges = edges();
    let mut pulses = (0..).zip(edges.iter().copied()).peekable();
    for number in 0..SECONDS * 250 {
        let at = Ticks(FIRST - 5_000 + number * 192_000);
        while let Some((number, at)) = pulses.next_if(|(_, edge)| *edge <= at) {
            let pulse = Pulse {
                seq: number as u32,
                train: 1,
                number,
                at,
                aligned: true,
                ..Pulse::default()
            };
            writer.pulse(&pulse).unwrap();
            if number % 30 == 0 {
                let pulse = Pulse {
                    output: Output::Two,
                    seq: (number / 30) as u32,
                    at: Ticks(at.0 + 4_800),
                    ..pulse
                };
                writer.output_pulse(&pulse, "left").unwrap();
                let second = number / 30;
                let pps = Pps {
                    seq: second as u32,
                    at: Ticks((second + 2) * u64::from(TICK_HZ)),
                    utc: 1_800_000_000 + second as i64,
                };
                writer.pps(&pps, "VLP-16").unwrap();
            }
        }
        if number == 250 {
            let clock = relation();
            writer.clock_model(at, None, &clock, "twist 1").unwrap();
        }
        if number == 500 {
            writer.marker(at, None, "door").unwrap();
        }
        let wave = (number % 50) as f64 * 1e-4;
        let sample = Sample {
            at,
            gyro: [wave, -wave, 1e-3],
            accel: [0.0, wave, 9.81],
            temperature: 36.5,
            ..Sample::default()
        };
        writer.imu(&sample, number as u32).unwrap();
    }
    let topics = writer.finish().unwrap();
    let mut profile = Profile::published().unwrap();
    profile.phone.gyro_delay_us = 0.0;
    profile.phone.readout_us = 11_006.0;
    profile.phone.readout_sigma_us = 3_000.0;
    let mut session = SessionFile::new("walk".into(), profile);
    session.phones[0].clock = Some(relation());
    session.recorded = edges.first().zip(edges.last()).map(|(first, last)| Span {
        from: *first,
        to: *last,
    });
    session.markers.push(Marker {
        at: Ticks(FIRST - 5_000 + 500 * 192_000),
        label: String::from("door"),
    });
    session.close(SessionOutcome::Good, Some(topics));
    session
}

/// Depth frames from the fourth pulse on, without three, on a clock that is 300 ppm fast.
fn depth_frames() -> Vec<(usize, i64)> {
    let edges = edges();
    let stamp = |edge: Ticks| {
        let since = nanos(edge) - nanos(edges[0]);
        let stamp = 1_600_000_000 * SECOND_NS + since + since * 3 / 10_000;
        stamp - stamp % 11_111
    };
    let numbered = edges.iter().enumerate().skip(3);
    let kept = numbered.filter(|(number, _)| ![20, 21, 75].contains(number));
    kept.map(|(number, &edge)| (number, stamp(edge))).collect()
}

fn write_depth(folder: &Path) {
    fs::create_dir(folder).unwrap();
    let file = fs::File::create(folder.join("depth_0.mcap")).unwrap();
    let mut bag = Bag::create(file).unwrap();
    bag.add_topic::<Image>("/camera/depth/image_raw").unwrap();
    for (number, stamp) in depth_frames() {
        let pixels = (0..6 * 4_u16).map(|pixel| 1_000 + 7 * number as u16 + pixel);
        let image = Image {
            header: Header {
                stamp: Time::from_nanos(stamp),
                frame_id: String::from("depth"),
            },
            height: 4,
            width: 6,
            encoding: String::from("16UC1"),
            is_bigendian: 0,
            step: 12,
            data: pixels.flat_map(u16::to_le_bytes).collect(),
        };
        let cdr = to_cdr(&image).unwrap();
        bag.put(0, None, stamp.unsigned_abs(), &cdr).unwrap();
    }
    let metadata = bag.finish("depth_0.mcap").unwrap();
    fs::write(folder.join(METADATA_FILE), metadata).unwrap();
}

fn write_phone(folder: &Path) {
    fs::create_dir_all(folder).unwrap();
    let rows = |first: i64, step: i64, count: i64, row: &dyn Fn(i64) -> String| -> String {
        let times = (0..count).map(|number| OFFSET_NS + first + number * step);
        times.map(|at| format!("{}{at}\n", row(at))).collect()
    };
    let name = "VID_20260131_140327";
    let path = |ending: &str| folder.join(format!("{name}{ending}.csv"));
    let frames = rows(SECOND_NS, 33_333_333, 110, &|_| String::new());
    fs::write(path("_imu_timestamps"), frames).unwrap();
    let gyro = rows(SECOND_NS, 10_000_000, 350, &|_| "0.001,0,-0.5,".into());
    fs::write(path("gyro"), gyro).unwrap();
    let accel = rows(SECOND_NS, 25_000_000, 140, &|at| {
        format!("0.5,{},9.75,", at % 7)
    });
    fs::write(path("accel"), accel).unwrap();
}

/// The recording's folder, in `parent`.
fn make(parent: &Path) -> PathBuf {
    let folder = parent.join("walk");
    fs::create_dir(&folder).unwrap();
    let mut session = write_board(&folder);
    write_depth(&folder.join("depth"));
    write_phone(&folder.join("20260131_140327"));
    session
        .close_files(&folder, &ReadMonitor::default())
        .unwrap();
    session.save(&folder).unwrap();
    folder
}

fn extract(recording: &Path, format: Format) -> (ExtractReport, PathBuf) {
    let job = job(recording, format);
    (run(&job).unwrap(), job.out)
}

fn job(recording: &Path, format: Format) -> Job {
    let out = recording.with_file_name(format.name());
    Job {
        recording: recording.to_owned(),
        phone: None,
        depth: None,
        format,
        out: out.clone(),
        options: Options::default(),
        overwrite: false,
        monitor: ReadMonitor::default(),
    }
}

fn lines(path: &Path) -> Vec<String> {
    let text = fs::read_to_string(path).unwrap();
    text.lines().map(str::to_owned).collect()
}

#[test]
fn times_are_those_of_the_edges() {
    let parent = tempfile::tempdir().unwrap();
    let recording = make(parent.path());
    let (report, out) = extract(&recording, Format::Euroc);
    assert_eq!(report.board.pulses, 120);
    assert_eq!(report.board.imu.samples, 1_000);
    assert_eq!(report.board.marks_ns.len(), 1);
    let depth = report.depth.unwrap();
    assert_eq!((depth.frames, depth.matched), (114, 114), "{depth:?}");
    assert_eq!(depth.missing, [20, 21, 75]);
    let parts: Vec<_> = report.losses.iter().map(|loss| loss.part).collect();
    assert_eq!(
        parts,
        [LossPart::Phone, LossPart::Depth],
        "{:#?}",
        report.losses
    );

    // Depth: edge and centre, to the nanosecond, each picture its own.
    let centres: Vec<i64> = depth_frames()
        .iter()
        .map(|&(number, _)| nanos(edges()[number]) + CENTER_NS)
        .collect();
    let listed: Vec<String> = ["seq_0", "seq_1"]
        .iter()
        .flat_map(|part| lines(&out.join(part).join("mav0/depth0/data.csv")).split_off(1))
        .collect();
    let expected: Vec<String> = centres
        .iter()
        .map(|at| format!("{at:019},{at:019}.png"))
        .collect();
    assert_eq!(listed, expected);
    let picture = out.join(format!("seq_0/mav0/depth0/data/{:019}.png", centres[0]));
    let pixels = image::open(picture).unwrap().into_luma16().into_raw();
    assert_eq!(pixels, Vec::from_iter(1_021..1_045));

    // The phone: half of the profile's exposure and readout after the timestamp.
    let middle = (10_000_000 + 11_006_000) / 2;
    let frames = lines(&out.join("phone_frames.csv"));
    let row: Vec<&str> = frames[1].split(',').take(4).collect();
    let expected = [0, OFFSET_NS + SECOND_NS, SECOND_NS, SECOND_NS + middle];
    assert_eq!(row, expected.map(|at| at.to_string()));

    // Sensors that the board triggers.
    let left = lines(&out.join("seq_0/mav0/outputs/left.csv"));
    assert_eq!(left[1], (nanos(edges()[0]) + 100_000).to_string());
    let lidar = lines(&out.join("seq_0/mav0/outputs/gnss.csv"));
    assert_eq!(lidar[1], "2000000000,1800000000000000000");

    // In the published layout each pulse has the phone's time, from when that was known.
    let (_, out) = extract(&recording, Format::Topics);
    let times: Vec<String> = ["seq_0", "seq_1"]
        .iter()
        .flat_map(|part| lines(&out.join(part).join("_mcu_cameras_ts/time_ref.csv")))
        .collect();
    let row = |number: usize, phone: i64| format!("{number},{},{phone}", nanos(edges()[number]));
    assert_eq!(times.len(), 120);
    assert_eq!(times[0], row(0, 0));
    let PhoneNanos(phone) = relation().ticks_to_phone(edges()[100]);
    assert_eq!(times[100], row(100, phone));
}

/// A phone that slept stamps its frames with a clock that stood still, and the trigger was
/// shifted on purpose: frames come back onto the sensors' clock, depth onto its own times.
#[test]
fn frames_on_another_clock_and_a_shifted_trigger_keep_their_times() {
    const SLEPT_NS: i64 = 3_600 * SECOND_NS + 17;
    let parent = tempfile::tempdir().unwrap();
    let recording = make(parent.path());
    let stamps = recording.join("20260131_140327/VID_20260131_140327_imu_timestamps.csv");
    let behind = lines(&stamps)
        .iter()
        .map(|stamp| format!("{}\n", stamp.parse::<i64>().unwrap() - SLEPT_NS))
        .collect::<String>();
    let (_, out) = extract(&recording, Format::Euroc);
    let own = |path: &Path| -> Vec<String> {
        let rows = lines(path).split_off(1);
        let board = |row: &String| row.splitn(3, ',').nth(2).unwrap().to_owned();
        rows.iter().map(board).collect()
    };
    let expected = own(&out.join("phone_frames.csv"));
    fs::write(&stamps, behind).unwrap();
    let mut session = SessionFile::load(&recording).unwrap();
    session.phones[0].video = serde_json::from_value(serde_json::json!({
        "phase": OFFSET_NS + SECOND_NS - SLEPT_NS, "frame_duration_ns": 33_333_333.0,
        "exposure_ns": null, "boot_minus_frames_ns": SLEPT_NS,
    }))
    .unwrap();
    session.alignment = serde_json::from_value(serde_json::json!({
        "exposure_us": 10_000.0, "middle_row_us": 5_503.0, "center_offset_us": 6_362.5,
        "bias_us": 20.0, "shift_us": 400.0,
        "plan": {
            "frames": {"period_ns": 33e6, "sigma_ns": null, "source": "learnt"},
            "clock": {"reference": 0.0, "offset": 0.0, "skew": 0.0,
                "covariance": [[0.0, 0.0], [0.0, 0.0]], "wander": 0.0},
            "anchor": 0, "period_q32": 1_u64 << 32,
        },
        "phase_sigma_us": 1.0,
        "drift_sigma_us_per_min": 1.0, "arrival_pulse": null, "arrival": null,
    }))
    .unwrap();
    session.save(&recording).unwrap();
    fs::remove_dir_all(&out).unwrap();
    let (report, out) = extract(&recording, Format::Euroc);
    assert_eq!(own(&out.join("phone_frames.csv")), expected);
    // The bias belongs to the depth image's time, the shift does not.
    assert_eq!(report.constants.depth_center_ns, CENTER_NS + 20_000);
    let said = report
        .remarks
        .iter()
        .any(|remark| remark.contains("+400.0 µs earlier"));
    assert!(said, "{:?}", report.remarks);
}

/// Returns true if a loss of a part has these words.
fn lacks(report: &ExtractReport, part: LossPart, words: &str) -> bool {
    let mut losses = report.losses.iter();
    losses.any(|loss| loss.part == part && loss.what.contains(words))
}

#[test]
fn a_data_set_is_of_one_session_file() {
    let parent = tempfile::tempdir().unwrap();
    let recording = make(parent.path());
    let (before, out) = extract(&recording, Format::Euroc);
    // Taught again: all depth times would be others, and the images keep their names.
    let session = SessionFile::load(&recording).unwrap();
    let other = SessionFile {
        profile: {
            let mut profile = session.profile.clone();
            profile.depth.center_offset_us += 1_000.0;
            profile
        },
        ..session
    };
    other.save(&recording).unwrap();
    let refused = run(&job(&recording, Format::Euroc));
    assert!(
        matches!(
            refused,
            Err(ExtractError::OutputDir(OutputDirError::Other { .. }))
        ),
        "{refused:?}"
    );
    let again = Job {
        overwrite: true,
        ..job(&recording, Format::Euroc)
    };
    let after = run(&again).unwrap();
    assert_ne!(after.constants, before.constants);
    for part in ["seq_0", "seq_1"] {
        let camera = out.join(part).join("mav0/depth0");
        let listed = lines(&camera.join("data.csv")).split_off(1);
        assert!(!listed.is_empty());
        for row in listed {
            let name = row.split(',').nth(1).unwrap().to_owned();
            assert!(camera.join("data").join(&name).exists(), "{name}");
        }
    }
    // Gone, cut, edited: constants that are not known are a loss.
    let path = recording.join("session.json");
    let whole = fs::read_to_string(&path).unwrap();
    for text in [
        None,
        Some(String::from("{\"format\":")),
        Some(whole[..whole.len() / 2].to_owned()),
        Some(whole.replacen("center_offset_us\": 7", "center_offset_us\": 8", 1)),
    ] {
        match text {
            None => fs::remove_file(&path).unwrap(),
            Some(text) => {
                assert_ne!(text, whole);
                fs::write(&path, text).unwrap();
            }
        }
        let report = run(&again).unwrap();
        assert!(
            lacks(&report, LossPart::Board, "session.json"),
            "{:#?}",
            report.losses
        );
    }
}

#[test]
fn an_image_that_is_missing_or_damaged_is_written_again() {
    let parent = tempfile::tempdir().unwrap();
    let recording = make(parent.path());
    let (before, out) = extract(&recording, Format::Euroc);
    let folder = out.join("seq_0/mav0/depth0/data");
    let images = test_support::below(&folder);
    let contents = |paths: &[PathBuf]| -> Vec<Vec<u8>> {
        paths.iter().map(|path| fs::read(path).unwrap()).collect()
    };
    let whole = contents(&images);
    fs::remove_file(&images[0]).unwrap();
    fs::write(&images[1], "").unwrap();
    fs::write(&images[2], &whole[2][..whole[2].len() / 2]).unwrap();
    fs::write(&images[3], &whole[4]).unwrap();
    fs::write(&images[4], &whole[3]).unwrap();
    let (after, _) = extract(&recording, Format::Euroc);
    assert_eq!(after, before);
    assert!(contents(&images) == whole);
    // After a run that was killed within the images.
    fs::remove_file(out.join(".extraction/depth.json")).unwrap();
    fs::write(&images[5], "").unwrap();
    extract(&recording, Format::Euroc);
    assert!(contents(&images) == whole);
}

#[test]
fn a_sensor_of_the_phone_that_ends_early_is_a_loss() {
    let parent = tempfile::tempdir().unwrap();
    let recording = make(parent.path());
    for (name, what) in [("gyro", "gyroscope"), ("accel", "accelerometer")] {
        let path = recording.join(format!("20260131_140327/VID_20260131_140327{name}.csv"));
        let whole = fs::read_to_string(&path).unwrap();
        let rows: Vec<&str> = whole.split_inclusive('\n').collect();
        for part in [0, 1, 10, 50, 80] {
            fs::write(&path, rows[..rows.len() * part / 100].concat()).unwrap();
            let job = Job {
                out: parent.path().join(format!("{name}_{part}")),
                ..job(&recording, Format::Euroc)
            };
            let report = run(&job).unwrap();
            assert!(
                lacks(&report, LossPart::Phone, what),
                "{name} {part}: {:#?}",
                report.losses
            );
        }
        fs::write(&path, whole).unwrap();
    }
}

#[test]
fn every_format_is_as_it_was() {
    let parent = tempfile::tempdir().unwrap();
    let recording = make(parent.path());
    let mut text = String::new();
    let mut seen = BTreeMap::new();
    for format in [
        Format::Euroc,
        Format::Tum,
        Format::Topics,
        Format::Kalibr,
        Format::Ros2,
    ] {
        let (_, out) = extract(&recording, format);
        let name = format.name();
        text.push_str(&format!("{name}\n"));
        for (folder, description) in folders(&out) {
            text.push_str(&format!("  {folder}/\n"));
            match seen.get(&(folder.clone(), description.clone())) {
                Some(earlier) => text.push_str(&format!("    as in {earlier}\n")),
                None => text.push_str(&description),
            }
            seen.entry((folder, description)).or_insert(name);
        }
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/small_recording.txt");
    if std::env::var_os("SMARTDEPTHSYNC_BLESS").is_some() {
        fs::write(&path, &text).unwrap();
    }
    let expected = fs::read_to_string(&path).unwrap();
    for (number, (line, expected)) in text.lines().zip(expected.lines()).enumerate() {
        assert_eq!(line, expected, "line {} of {}", number + 1, path.display());
    }
    assert_eq!(text.lines().count(), expected.lines().count());
}

/// Describes the files in each folder, by the folder's path.
fn folders(out: &Path) -> BTreeMap<String, String> {
    let mut images = BTreeMap::<String, Vec<PathBuf>>::new();
    let mut folders = BTreeMap::<String, String>::new();
    for path in test_support::below(out) {
        let name = path.strip_prefix(out).unwrap();
        // The report describes the run, not the data; the bytes of images are those of a library.
        let own = ["report.json", "contents.json"].map(Path::new);
        let is_left_out = name.starts_with(".extraction") || own.contains(&name);
        if path.is_dir() || is_left_out {
            continue;
        }
        let folder = name.parent().unwrap().to_string_lossy().into_owned();
        let file = name.file_name().unwrap().to_string_lossy().into_owned();
        let description = match path.extension().and_then(|ending| ending.to_str()) {
            Some("png") => {
                images.entry(folder).or_default().push(path);
                continue;
            }
            Some("mcap") => bag(&path),
            _ => rows(&fs::read_to_string(&path).unwrap()),
        };
        let all = folders.entry(folder).or_default();
        all.push_str(&format!("    {file}\n{description}"));
    }
    for (folder, paths) in images {
        let all = folders.entry(folder).or_default();
        all.push_str(&pictures(&paths));
    }
    folders
}

/// A short text as it is; of a longer one the number of lines, their checksum, and the first
/// and last lines.
fn rows(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    let mut shown: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
    if lines.len() > 12 {
        let sum = crc32fast::hash(text.as_bytes());
        let last = shown.split_off(lines.len() - 2);
        shown.truncate(3);
        shown.push(format!("... {} lines, checksum {sum:08x}", lines.len()));
        shown.extend(last);
    }
    let shown = shown.iter().map(|line| format!("      {line}\n"));
    shown.collect()
}

/// The number of images, the names and the brightest and darkest pixel of the first and last,
/// and a checksum over all names and pixels.
fn pictures(paths: &[PathBuf]) -> String {
    let mut hasher = crc32fast::Hasher::new();
    let mut lines = Vec::new();
    for path in paths {
        let name = path.file_name().unwrap().to_str().unwrap();
        let image = image::open(path).unwrap();
        hasher.update(name.as_bytes());
        hasher.update(image.as_bytes());
        let pixels = image.to_luma16();
        let (dark, bright) = (pixels.iter().min().unwrap(), pixels.iter().max().unwrap());
        let (width, height) = (image.width(), image.height());
        lines.push(format!(
            "      {name} {width} x {height}, pixels {dark} to {bright}\n"
        ));
    }
    let (count, sum) = (paths.len(), hasher.finalize());
    let (first, last) = (&lines[0], &lines[count - 1]);
    format!("    *.png\n{first}      ... {count} images, checksum {sum:08x}\n{last}")
}

/// The number of messages on each topic, their first and last time, and a checksum over them.
fn bag(path: &Path) -> String {
    let mut topics = BTreeMap::<String, (u32, u64, u64, crc32fast::Hasher)>::new();
    let mut walk = Walk::open(path, &ReadMonitor::default()).unwrap();
    while walk
        .next_part(&mut |event| {
            if let Event::Message(message) = event {
                let at = message.header.log_time;
                let name = &message.channel.described.topic;
                let first = || (0, at, at, crc32fast::Hasher::new());
                let (count, _, last, hasher) = topics.entry(name.clone()).or_insert_with(first);
                *count += 1;
                *last = at;
                hasher.update(&at.to_le_bytes());
                hasher.update(message.data);
            }
        })
        .unwrap()
    {}
    let line = |(name, (count, first, last, hasher)): (String, (_, _, _, crc32fast::Hasher))| {
        let sum = hasher.finalize();
        let (first, last): (u64, u64) = (first, last);
        let count: u32 = count;
        format!("      {name} {count} messages, {first} to {last} ns, checksum {sum:08x}\n")
    };
    topics.into_iter().map(line).collect()
}
