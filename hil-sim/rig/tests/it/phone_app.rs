//! The simulated phone behaves as the app does, line by line.

use rig::phone::VideoMode;

use crate::phone_bench::Bench;

const INVALID: [&str; 3] = ["ERROR", "v.0.1.1", "Invalid request"];

#[test]
fn anything_else_is_an_invalid_request() {
    let mut bench = Bench::new(1, |_| ());
    for request in ["", "hello", "VIDEO_START", "imu?duration=10", " video_stop"] {
        assert_eq!(bench.ask(request), INVALID, "{request:?}");
    }
}

#[test]
fn an_imu_request_is_answered_after_its_duration_with_the_sensors_in_order() {
    let mut bench = Bench::new(2, |_| ());
    let asked = bench
        .phone
        .ask("imu?duration=3000&accel=1&gyro=1&magnetic=1");
    // Its clock is off by less than 100 ppm.
    bench.pass(3.0 * 0.9999);
    assert!(bench.take(asked).is_none());
    bench.pass(0.001);
    let answer = bench.take(asked).unwrap();
    assert_eq!(answer[..2], ["SUCCESS", "v.0.1.1"]);
    let sensors: Vec<&[String]> = answer[2..].split(|line| line == "sensor_end").collect();
    assert_eq!(sensors.len(), 4);
    assert!(sensors[3].is_empty());
    for (lines, suffix, rate) in [
        (sensors[0], "accel.csv", 500.0),
        (sensors[1], "gyro.csv", 500.0),
        (sensors[2], "magnetic.csv", 100.0),
    ] {
        let (name, lines) = lines.split_first().unwrap();
        assert!(name.ends_with(suffix), "{name}");
        let count = lines.len() as f64;
        assert!(
            (count - 3.0 * rate).abs() < 0.03 * rate,
            "{suffix}: {count}"
        );
        for line in lines {
            let fields: Vec<&str> = line.split(',').collect();
            assert_eq!(fields.len(), 4);
            for value in &fields[..3] {
                value.parse::<f32>().unwrap();
                assert!(value.contains('.'), "{value}: Java prints a point");
            }
            fields[3].parse::<i64>().unwrap();
        }
        // The same lines are saved on the phone.
        let date = name.get(4..19).unwrap();
        let saved = std::fs::read_to_string(bench.phone.storage().join(date).join(name)).unwrap();
        assert!(saved.lines().eq(lines.iter()));
    }
}

#[test]
fn a_video_is_answered_with_the_phase_of_frame_sixty() {
    let mut bench = Bench::new(4, |c| {
        c.video = VideoMode::Never;
        c.app.stop_ms = 0.0;
    });
    let asked = bench.clock.now();
    let answer = bench.ask("video_start");
    let answered = bench.phone.oscillator().nanos_at(bench.clock.now());
    assert!(bench.phone.is_recording());
    assert_eq!(answer[..2], ["SUCCESS", "v.0.1.1"]);
    assert_eq!(answer.len(), 5);
    let phase: i64 = answer[2].parse().unwrap();
    let duration: f64 = answer[3].parse().unwrap();
    assert!(answer[3].ends_with("E7"), "{}", answer[3]);
    let camera = bench.phone.handset().config.camera.clone();
    assert_eq!(answer[4], camera.exposure_ns.to_string());

    let video = &bench.phone.videos()[0];
    assert!(video.start_ns >= bench.phone.oscillator().nanos_at(asked));
    // 1 µs of jitter on the stamp, 1.4 / 59 µs on the mean.
    assert!((phase - video.frames.start_ns(60)).abs() < 6_000);
    let period = camera.frame_period_ns;
    assert!((duration - period).abs() < 150.0, "{}", duration - period);
    // Not before the frame was there.
    assert!(answered > video.frames.start_ns(60));

    // The sensors are busy for as long as the video runs.
    let imu = "imu?duration=100&accel=0&gyro=1&magnetic=0";
    assert_eq!(
        bench.ask(imu),
        ["ERROR", "v.0.1.1", "Error in IMU recording"]
    );
    assert_eq!(bench.ask("video_stop"), ["SUCCESS", "v.0.1.1"]);
    assert!(!bench.phone.is_recording());
    assert_eq!(bench.ask(imu)[0], "SUCCESS");
    // A stop without a video is a success all the same.
    assert_eq!(bench.ask("video_stop"), ["SUCCESS", "v.0.1.1"]);
}

#[test]
fn the_older_version_leaves_the_exposure_out() {
    let mut bench = Bench::new(5, |c| {
        c.version = "v.0.1".to_owned();
        c.video = VideoMode::Never;
    });
    let answer = bench.ask("video_start");
    assert_eq!(answer[..2], ["SUCCESS", "v.0.1"]);
    assert_eq!(answer.len(), 4);
}

#[test]
fn starting_twice_stops_and_fails_after_ten_seconds() {
    let mut bench = Bench::new(6, |c| {
        c.video = VideoMode::Never;
        c.app.stop_ms = 500.0;
    });
    assert_eq!(bench.ask("video_start")[0], "SUCCESS");
    let begin = bench.clock.now().as_secs_f64();
    let answer = bench.ask("video_start");
    assert!(bench.clock.now().as_secs_f64() - begin >= 10.0);
    assert_eq!(answer[0], "ERROR");
    assert!(answer[2].contains("phase info"), "{}", answer[2]);
    assert!(!bench.phone.is_recording());
    // So does a phone whose app gets no frame timestamps; its video runs.
    let mut bench = Bench::new(6, |c| {
        c.video = VideoMode::Never;
        c.camera.reports_frames = false;
    });
    assert_eq!(bench.ask("video_start")[0], "ERROR");
    assert!(bench.phone.is_recording());
}

#[test]
fn the_files_of_a_video_are_saved_by_date() {
    let mut bench = Bench::new(7, |c| {
        c.video = VideoMode::Never;
        c.app.stop_ms = 0.0;
    });
    bench.ask("video_start");
    bench.ask("video_stop");
    bench.pass(0.0);
    let video = &bench.phone.videos()[0];
    let stem = video.path.file_stem().unwrap().to_str().unwrap();
    let folder = bench
        .phone
        .storage()
        .join(stem.strip_prefix("VID_").unwrap());
    let lines = |suffix: &str| -> Vec<String> {
        let path = folder.join(format!("{stem}{suffix}"));
        let text = std::fs::read_to_string(path).unwrap();
        text.lines().map(str::to_owned).collect()
    };
    let stamps: Vec<i64> = lines("_imu_timestamps.csv")
        .iter()
        .map(|l| l.parse().unwrap())
        .collect();
    assert_eq!(stamps.len(), video.count.unwrap());
    assert!(stamps.len() > 60);
    assert_eq!(stamps, video.frames.stamps(stamps.len()));
    // All sensors over the whole video.
    let length = (video.stop_ns.unwrap() - video.start_ns) as f64 * 1e-9;
    for (suffix, rate) in [
        ("gyro.csv", 500.0),
        ("accel.csv", 500.0),
        ("magnetic.csv", 100.0),
    ] {
        let count = lines(suffix).len() as f64;
        assert!(
            (count / length / rate - 1.0).abs() < 0.02,
            "{suffix}: {count}"
        );
    }
}

#[test]
fn get_video_waits_while_the_video_is_recorded() {
    let mut bench = Bench::new(10, |c| {
        c.camera.rows = 64;
        c.camera.columns = 16;
    });
    bench.ask("video_start");
    let asked = bench.phone.ask("get_video");
    bench.pass(5.0);
    assert!(bench.take(asked).is_none());
    bench.phone.press_record();
    let head = bench.answer(asked);
    assert_eq!(head[..2], ["SUCCESS", "v.0.1.1"]);
    let path = &bench.phone.videos()[0].path;
    let video = std::fs::read(path).unwrap();
    assert_eq!(head[2], video.len().to_string());
    assert_eq!(head[3], path.file_name().unwrap().to_str().unwrap());
    assert_eq!(&video[4..8], b"ftyp");
}

/// The same seed, asked at the same true times, answers the same bytes.
#[test]
fn the_same_seed_and_times_give_the_same_answers() {
    let run = |seed| {
        let mut bench = Bench::new(seed, |c| {
            c.video = VideoMode::Never;
            c.app.stop_ms = 0.0;
        });
        let answers = [
            "imu?duration=2000&accel=1&gyro=1&magnetic=1",
            "video_start",
            "video_stop",
            "imu?duration=1000&accel=0&gyro=1&magnetic=0",
        ]
        .map(|request| {
            bench.pass(5.0);
            bench.ask(request)
        });
        let timestamps = std::fs::read_to_string(&bench.phone.videos()[0].timestamps).unwrap();
        (answers, timestamps)
    };
    let first = run(11);
    assert!(first.0[0].len() > 2000);
    assert!(first.1.len() > 1000);
    assert!(first == run(11), "two runs of one seed differ");
    assert!(first != run(12), "two seeds are the same");
}
