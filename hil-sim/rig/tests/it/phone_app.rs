//! The simulated phone behaves as the app does, line by line.

use std::sync::Arc;
use std::time::Duration;

use rig::flash_log::Dark;
use rig::oscillator::TrueTime;
use rig::phone::{LinkFault, VideoMode};
use rig::true_clock::TrueClock;

use crate::phone_bench::Bench;

fn seconds(s: f64) -> TrueTime {
    TrueTime::from_nanos((s * 1e9) as u64)
}

#[test]
fn anything_else_is_an_invalid_request() {
    let bench = Bench::new(1, 20.0, |_| ());
    let mut phone = bench.connect();
    for request in ["", "hello", "VIDEO_START", "imu?duration=10", " video_stop"] {
        let answer = phone.ask(request);
        assert_eq!(
            answer,
            ["ERROR", "v.0.1.1", "Invalid request"],
            "{request:?}"
        );
    }
    // A carriage return and a line feed end one line; each alone ends one too.
    phone.send("a\r\nb\rc\n");
    for _ in 0..3 {
        assert_eq!(phone.answer(), ["ERROR", "v.0.1.1", "Invalid request"]);
    }
    assert!(phone.is_silent(Duration::from_millis(200)));
}

#[test]
fn an_imu_request_is_answered_after_its_duration_with_the_sensors_in_order() {
    let bench = Bench::held(2, |_| ());
    let mut phone = bench.connect();
    phone.send("imu?duration=3000&accel=1&gyro=1&magnetic=1\n");
    bench.wait_for_waiter();
    // Its clock is off by less than 100 ppm.
    bench.pass(3.0 * 0.9999);
    assert!(phone.is_silent(Duration::from_millis(100)));
    bench.pass(0.001);
    let answer = phone.answer();
    assert_eq!(answer[..2], ["SUCCESS", "v.0.1.1"]);
    let ends: Vec<usize> = (0..answer.len())
        .filter(|&i| answer[i] == "sensor_end")
        .collect();
    assert_eq!(ends.len(), 3);
    let mut at = 2;
    for (end, suffix, rate) in [
        (ends[0], "accel.csv", 500.0),
        (ends[1], "gyro.csv", 500.0),
        (ends[2], "magnetic.csv", 100.0),
    ] {
        assert!(answer[at].ends_with(suffix), "{}", answer[at]);
        let count = (end - at - 1) as f64;
        assert!(
            (count - 3.0 * rate).abs() < 0.03 * rate,
            "{suffix}: {count}"
        );
        for line in &answer[at + 1..end] {
            let fields: Vec<&str> = line.split(',').collect();
            assert_eq!(fields.len(), 4);
            for value in &fields[..3] {
                value.parse::<f32>().unwrap();
                assert!(
                    value.contains('.'),
                    "{value} is not a number as Java prints it"
                );
            }
            fields[3].parse::<i64>().unwrap();
        }
        // The same lines are saved on the phone.
        let name = &answer[at];
        let date = name.get(4..19).unwrap();
        let saved = std::fs::read_to_string(bench.phone.storage().join(date).join(name)).unwrap();
        assert!(saved.lines().eq(answer[at + 1..end].iter()));
        at = end + 1;
    }
    assert_eq!(at, answer.len());
}

#[test]
fn the_answer_to_an_empty_line_comes_behind() {
    let bench = Bench::new(3, 20.0, |_| ());
    let mut phone = bench.connect();
    phone.send("imu?duration=500&accel=0&gyro=1&magnetic=0\n\n");
    let answer = phone.answer();
    assert_eq!(answer[0], "SUCCESS");
    assert_eq!(answer.last().unwrap(), "sensor_end");
    assert_eq!(phone.answer(), ["ERROR", "v.0.1.1", "Invalid request"]);
    assert!(phone.is_silent(Duration::from_millis(200)));
}

#[test]
fn a_video_is_answered_with_the_phase_of_frame_sixty() {
    let bench = Bench::new(4, 10.0, |c| {
        c.video = VideoMode::Never;
        c.app.stop_ms = 0.0;
    });
    let mut phone = bench.connect();
    let asked = bench.clock.now();
    let answer = phone.ask("video_start");
    let answered = bench.phone.oscillator().nanos_at(bench.clock.now());
    assert!(bench.phone.is_recording());
    assert_eq!(answer[..2], ["SUCCESS", "v.0.1.1"]);
    assert_eq!(answer.len(), 5);
    let phase: i64 = answer[2].parse().unwrap();
    let duration: f64 = answer[3].parse().unwrap();
    assert!(answer[3].ends_with("E7"), "{}", answer[3]);
    assert_eq!(
        answer[4],
        bench.phone.config().camera.exposure_ns.to_string()
    );

    let video = &bench.phone.videos()[0];
    assert!(video.start_ns >= bench.phone.oscillator().nanos_at(asked));
    // 1 µs of jitter on the stamp, 1.4 / 59 µs on the mean.
    assert!((phase - video.frames.start_ns(60)).abs() < 6_000);
    let period = bench.phone.config().camera.frame_period_ns;
    assert!((duration - period).abs() < 150.0, "{}", duration - period);
    // Not before the frame was there.
    assert!(answered > video.frames.start_ns(60));

    // The sensors are busy for as long as the video runs.
    let imu = "imu?duration=100&accel=0&gyro=1&magnetic=0";
    assert_eq!(
        phone.ask(imu),
        ["ERROR", "v.0.1.1", "Error in IMU recording"]
    );
    assert_eq!(phone.ask("video_stop"), ["SUCCESS", "v.0.1.1"]);
    assert!(!bench.phone.is_recording());
    assert_eq!(phone.ask(imu)[0], "SUCCESS");
    // A stop without a video is a success all the same.
    assert_eq!(phone.ask("video_stop"), ["SUCCESS", "v.0.1.1"]);
}

#[test]
fn the_older_version_leaves_the_exposure_out() {
    let bench = Bench::new(5, 20.0, |c| {
        c.version = "v.0.1".to_owned();
        c.video = VideoMode::Never;
    });
    let answer = bench.connect().ask("video_start");
    assert_eq!(answer[..2], ["SUCCESS", "v.0.1"]);
    assert_eq!(answer.len(), 4);
}

#[test]
fn starting_twice_stops_and_fails_after_ten_seconds() {
    let bench = Bench::new(6, 40.0, |c| {
        c.video = VideoMode::Never;
        c.app.stop_ms = 500.0;
    });
    let mut phone = bench.connect();
    assert_eq!(phone.ask("video_start")[0], "SUCCESS");
    let begin = bench.clock.now().as_secs_f64();
    let answer = phone.ask("video_start");
    assert!(bench.clock.now().as_secs_f64() - begin >= 10.0);
    assert_eq!(answer[0], "ERROR");
    assert!(answer[2].contains("phase info"), "{}", answer[2]);
    assert!(!bench.phone.is_recording());
    // So does a phone whose app gets no frame timestamps; its video runs.
    let bench = Bench::new(6, 40.0, |c| {
        c.video = VideoMode::Never;
        c.camera.reports_frames = false;
    });
    assert_eq!(bench.connect().ask("video_start")[0], "ERROR");
    assert!(bench.phone.is_recording());
}

#[test]
fn the_files_of_a_video_are_saved_by_date() {
    let bench = Bench::new(7, 10.0, |c| {
        c.video = VideoMode::Never;
        c.app.stop_ms = 0.0;
    });
    let mut phone = bench.connect();
    phone.ask("video_start");
    phone.ask("video_stop");
    bench.phone.wait_saved().unwrap();
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
fn one_client_at_a_time() {
    let bench = Bench::new(8, 20.0, |_| ());
    let mut first = bench.connect();
    assert_eq!(first.ask("x")[0], "ERROR");
    let mut second = bench.connect();
    second.send("y\n");
    assert!(second.is_silent(Duration::from_millis(300)));
    drop(first);
    assert_eq!(second.answer()[0], "ERROR");
}

#[test]
fn get_video_waits_while_the_video_is_recorded() {
    let bench = Bench::new(10, 20.0, |c| {
        c.camera.rows = 64;
        c.camera.columns = 16;
    });
    let mut phone = bench.connect();
    phone.ask("video_start");
    phone.send("get_video\n");
    assert!(phone.is_silent(Duration::from_millis(500)));
    bench.phone.press_record();
    let head = phone.answer();
    assert_eq!(head[..2], ["SUCCESS", "v.0.1.1"]);
    let video = phone.bytes(head[2].parse().unwrap());
    assert_eq!(&video[4..8], b"ftyp");
    assert_eq!(
        head[3],
        bench.phone.videos()[0]
            .path
            .file_name()
            .unwrap()
            .to_str()
            .unwrap()
    );
    // The connection is in step behind the bytes.
    assert_eq!(phone.ask("x")[0], "ERROR");
}

/// The same seed, asked at the same true times, answers the same bytes.
#[test]
fn the_same_seed_and_times_give_the_same_answers() {
    let run = |seed| {
        let clock = TrueClock::new();
        let bench = Bench::with(seed, clock.clone(), Arc::new(Dark), |c| {
            c.video = VideoMode::Never;
            c.app.stop_ms = 0.0;
        });
        let mut phone = bench.connect();
        let mut answers = Vec::new();
        for (at, request) in [
            (5.0, "imu?duration=2000&accel=1&gyro=1&magnetic=1"),
            (10.0, "video_start"),
            (20.0, "video_stop"),
            (21.0, "imu?duration=1000&accel=0&gyro=1&magnetic=0"),
        ] {
            clock.publish(seconds(at));
            phone.send(&format!("{request}\n"));
            // Time goes on only when the phone has taken the request.
            if request != "video_stop" {
                bench.wait_for_waiter();
                clock.publish(seconds(at + 4.0));
            }
            answers.push(phone.answer());
        }
        bench.phone.wait_saved().unwrap();
        let video = bench.phone.videos()[0].clone();
        let stem = video.path.file_stem().unwrap().to_str().unwrap().to_owned();
        let folder = bench
            .phone
            .storage()
            .join(stem.strip_prefix("VID_").unwrap());
        answers.push(vec![
            std::fs::read_to_string(folder.join(format!("{stem}gyro.csv"))).unwrap(),
        ]);
        answers
    };
    let first = run(11);
    assert!(first[0].len() > 2000);
    assert!(first == run(11), "two runs of one seed differ");
    assert!(first != run(12), "two seeds are the same");
}

#[test]
fn the_link_can_fail_in_all_ways() {
    let bench = Bench::new(13, 20.0, |_| ());
    bench.phone.set_fault(Some(LinkFault::CutAfter(10)));
    let mut phone = bench.connect();
    phone.send("x\n");
    assert_eq!(phone.bytes(10), b"ERROR\nv.0.");
    assert!(bench.connect().is_silent(Duration::from_millis(100)));
    bench.phone.set_fault(Some(LinkFault::Silent));
    let mut phone = bench.connect();
    phone.send("x\n");
    assert!(phone.is_silent(Duration::from_millis(300)));
    bench.phone.set_fault(None);
    assert_eq!(phone.ask("x")[0], "ERROR");
    drop(phone);

    bench.phone.leave_network();
    assert!(std::net::TcpStream::connect(bench.phone.address()).is_err());
    bench.phone.join_network().unwrap();
    assert_eq!(bench.connect().ask("x")[0], "ERROR");
}
