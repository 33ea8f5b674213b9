//! The program against a phone that is as rude as the app: `phone …`, each
//! case with what is said, how it ends, and what runs on the phone then.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use clock::PhoneNanos;
use phone::adb::copy_command;
use rig::phone::{LinkFault, PhoneConfig, StorageAccess, VideoMode};
use test_support::processes::{Ran, run};

use crate::phone_bench::PhoneBench;
use crate::support::{smartdepthsync, tool};
use crate::whole_rig::Session;

const PHONE: i32 = 12;

fn small(c: &mut PhoneConfig) {
    c.camera.rows = 64;
    c.camera.columns = 16;
}

fn wait_s(bench: &PhoneBench, seconds: f64) {
    let until = bench.clock.now().as_secs_f64() + seconds;
    while bench.clock.now().as_secs_f64() < until {
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_video_begun_by_hand_is_left_alone() {
    let bench = PhoneBench::new(70, 5.0, |c| c.video = VideoMode::Never);
    let folder = tempfile::tempdir().unwrap();
    bench.phone.app.press_record();
    wait_s(&bench, 5.0);
    let output = bench.command(&["start"], folder.path());
    output.ended_with(PHONE, &["refused imu", "phone stop"]);
    assert!(bench.phone.app.is_recording());
}

#[test]
fn a_missing_video_is_reported_as_deleted() {
    // The app finds no file of its last video.
    let bench = PhoneBench::new(77, 10.0, |c| c.video = VideoMode::Never);
    let folder = tempfile::tempdir().unwrap();
    for action in ["start", "stop"] {
        bench.command(&[action], folder.path()).ended_with(0, &[]);
    }
    let output = bench.command(&["get-video", "--recorded"], folder.path());
    output.ended_with(PHONE, &["refused get_video", "was deleted"]);
}

#[test]
fn an_answer_before_its_frames_is_not_an_answer() {
    use phone::{PhoneClient, PhoneError, Settings};
    for (seed, known) in [(71, true), (72, false)] {
        // Without the phone's clock, the time of this computer counts: in step with it.
        let bench = PhoneBench::new(seed, if known { 10.0 } else { 1.0 }, |c| {
            c.video = VideoMode::Never;
        });
        let mut client = PhoneClient::connect(&bench.address(), Settings::default()).unwrap();
        let clock = client.clock().unwrap();
        assert!(clock.is_some());
        bench.phone.app.press_record();
        wait_s(&bench, 4.0);
        let now = bench.phone.app.oscillator.nanos_at(bench.clock.now());
        let error = client
            .start_video(known.then_some(PhoneNanos(now).into()))
            .unwrap_err();
        assert!(matches!(error, PhoneError::StalePhase { .. }), "{error}");
        let error = client.undo_start(error);
        assert!(error.to_string().contains("asked to stop"), "{error}");
        assert!(!bench.phone.app.is_recording());
        // And the next one is one.
        wait_s(&bench, 2.5);
        client.reconnect().unwrap();
        let now = bench.phone.app.oscillator.nanos_at(bench.clock.now());
        client
            .start_video(known.then_some(PhoneNanos(now).into()))
            .unwrap();
        assert!(bench.phone.app.is_recording());
    }
}

#[test]
fn a_request_that_waited_for_another_client_is_not_carried_out_later() {
    let bench = PhoneBench::new(73, 10.0, |c| c.video = VideoMode::Never);
    let folder = tempfile::tempdir().unwrap();
    let other = bench.occupy();
    let output = bench.command(&["start", "--timeout", "0.5s"], folder.path());
    output.ended_with(PHONE, &["an empty request", "one at a time"]);
    drop(other);
    wait_s(&bench, 15.0);
    assert!(bench.phone.app.videos().is_empty());
}

#[test]
fn a_start_that_fails_or_is_cancelled_leaves_nothing_running() {
    let folder = tempfile::tempdir().unwrap();
    // Frames too slow for the app's own patience.
    let bench = PhoneBench::new(74, 10.0, |c| {
        c.video = VideoMode::Never;
        c.camera.frame_period_ns = 200e6;
    });
    let output = bench.command(&["start"], folder.path());
    output.ended_with(PHONE, &["poll limit", "asked to stop", "Camera2"]);
    assert_eq!(bench.phone.app.videos().len(), 1);
    assert!(!bench.phone.app.is_recording());

    // Ctrl-C while the phone has begun and not answered.
    let bench = PhoneBench::new(75, 1.0, |c| c.video = VideoMode::Never);
    let mut command = tool();
    command.args(["phone", "start", "--phone", &bench.address()]);
    let session = Session::start(&mut command);
    while !bench.phone.app.is_recording() {
        std::thread::sleep(Duration::from_millis(5));
    }
    session.signal(rustix::process::Signal::INT);
    let said = session.ends_with(130);
    assert!(said.contains("asked to stop"), "{said}");
    assert!(!bench.phone.app.is_recording());

    // The answer is lost on the way.
    let bench = PhoneBench::new(76, 5.0, |c| {
        c.video = VideoMode::Never;
        // The answer comes after the 60th of them, at most 10 s after it was asked for.
        c.camera.frame_period_ns = 140e6;
    });
    let (bench, phone) = (&bench, &bench.phone);
    std::thread::scope(|scope| {
        scope.spawn(move || {
            while !phone.app.is_recording() {
                std::thread::sleep(Duration::from_millis(5));
            }
            phone.set_fault(Some(LinkFault::CutAfter(20)));
            wait_s(bench, 12.0);
            phone.set_fault(None);
        });
        let output = bench.command(&["start"], folder.path());
        output.ended_with(PHONE, &["closed the connection", "asked to stop"]);
    });
    assert!(!bench.phone.app.is_recording());
}

#[test]
fn sensors_requested_right_after_a_stop_are_tried_again() {
    let bench = PhoneBench::new(77, 1.0, |c| {
        c.video = VideoMode::Never;
        c.app.stop_ms = 2_000.0;
    });
    let folder = tempfile::tempdir().unwrap();
    bench
        .command(&["start"], folder.path())
        .ended_with(0, &["phase: "]);
    bench.command(&["stop"], folder.path()).ended_with(0, &[]);
    let output = bench.command(&["imu", "--duration", "1s"], folder.path());
    output.ended_with(0, &["samples: ", "rate: "]);
}

#[test]
fn a_video_is_fetched_only_when_the_app_can_send_it() {
    let bench = PhoneBench::new(78, 2.0, |c| {
        small(c);
        c.app.storage = StorageAccess::Documents;
        c.app.stop_ms = 2_000.0;
    });
    let folder = tempfile::tempdir().unwrap();
    let get = [
        "get-video",
        "--recorded",
        "--ready",
        "20s",
        "--timeout",
        "10s",
    ];
    // Without any video it is not asked by default, and named if it is all the same.
    bench
        .command(&["get-video"], folder.path())
        .ended_with(2, &["--recorded"]);
    bench.command(&["stop"], folder.path()).ended_with(0, &[]);
    let output = bench.command(&get, folder.path());
    output.ended_with(PHONE, &["closed the connection", "open the app again"]);
    bench.phone.reopen_app().unwrap();
    // Right after a stop, and with storage access: it waits until the app is free.
    bench.command(&["start"], folder.path()).ended_with(0, &[]);
    bench.command(&["stop"], folder.path()).ended_with(0, &[]);
    bench.command(&get, folder.path()).ended_with(0, &["VID_"]);
    // Without the sync recording nothing tells that a video runs: the app hangs.
    let bench = PhoneBench::new(79, 2.0, |c| {
        small(c);
        c.app.storage = StorageAccess::Documents;
        c.camera.reports_frames = false;
    });
    bench.phone.app.press_record();
    let soon = [
        "get-video",
        "--recorded",
        "--ready",
        "4s",
        "--timeout",
        "4s",
    ];
    let output = bench.command(&soon, folder.path());
    output.ended_with(PHONE, &["hangs", "force the app to stop"]);
}

#[test]
fn a_gyroscope_without_a_file_is_an_error() {
    let bench = PhoneBench::new(80, 10.0, |c| c.app.ticked = [true, false, true]);
    let folder = tempfile::tempdir().unwrap();
    let output = bench.command(&["imu", "--duration", "2s"], folder.path());
    output.ended_with(PHONE, &["no file of its gyroscope", "Enabled sensors"]);
    // Two recordings within one second have other names, and are taken.
    let bench = PhoneBench::new(80, 10.0, |c| c.app.storage = StorageAccess::Documents);
    for _ in 0..3 {
        let output = bench.command(&["imu", "--duration", "0.01s"], folder.path());
        output.ended_with(0, &[]);
    }
}

#[test]
fn a_long_answer_on_a_slow_network_is_waited_for() {
    // 30 s of the gyroscope are 0.8 MB: 16 s at this rate, with 3 s of patience.
    let bench = PhoneBench::new(82, 30.0, |_| ());
    bench.phone.set_fault(Some(LinkFault::Slow(50_000)));
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["imu", "--duration", "30s", "--timeout", "3s"];
    let output = bench.command(&arguments, folder.path());
    output.ended_with(0, &["samples: 15"]);
}

/// A program named `adb` that has one phone, whose storage is the simulated one's.
fn stand_in_adb(folder: &Path, storage: &Path, pulls: &str) -> std::ffi::OsString {
    use std::os::unix::fs::PermissionsExt as _;
    let script = format!(
        "#!/bin/sh\n\
         here() {{ printf %s \"$1\" | sed 's#/sdcard/DCIM/OpenCamera#{storage}#g'; }}\n\
         case \"$1\" in\n\
         devices) printf 'List of devices attached\\nAB12\\tdevice\\n' ;;\n\
         -s) case \"$3\" in\n\
         shell) sh -c \"$(here \"$4\")\" | sed 's#{storage}#/sdcard/DCIM/OpenCamera#g' ;;\n\
         pull) {pulls} ;;\n\
         esac ;;\n\
         esac\n",
        storage = storage.display()
    );
    let program = folder.join("adb");
    std::fs::write(&program, script).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    let mut path = std::ffi::OsString::from(folder);
    path.push(":");
    path.push(std::env::var_os("PATH").unwrap());
    path
}

const PULL: &str = "cp \"$(here \"$4\")\" \"$5\"";

#[test]
fn files_come_by_adb_or_there_is_a_line_that_copies_them() {
    let bench = PhoneBench::new(83, 10.0, small);
    let folder = tempfile::tempdir().unwrap();
    let start = |name: &str| {
        let output = bench.command(&["start", "--json"], folder.path());
        output.ended_with(0, &[]);
        bench.command(&["stop"], folder.path()).ended_with(0, &[]);
        wait_s(&bench, 4.0);
        let printed = output.json();
        let out = folder.path().join(name);
        std::fs::create_dir(&out).unwrap();
        (printed["phase_ns"].as_i64().unwrap(), out)
    };
    // Two videos: the phase tells which.
    let (_, _) = start("first");
    let (phase, out) = start("second");
    bench.phone.app.wait_saved().unwrap();
    let tools = folder.path().join("tools");
    std::fs::create_dir(&tools).unwrap();
    let get = |path: &std::ffi::OsStr, phase: i64| {
        let mut command = Command::new(smartdepthsync());
        command
            .args(["phone", "get-files", "--phase", &phase.to_string(), "--out"])
            .arg(&out)
            .env("PATH", path);
        Ran::new(&mut command)
    };
    let storage = bench.phone.app.storage();
    let path = stand_in_adb(&tools, storage, PULL);
    get(&path, phase).ended_with(0, &["_imu_timestamps.csv"]);
    let video = bench.phone.app.videos()[1].clone();
    let whole = phone::video_files::of_video(&out.join(video.path.file_name().unwrap()));
    let whole = whole.unwrap().unwrap();
    assert_eq!(whole.missing(), ["video (.mp4)"]);
    let read = |path: &Path| std::fs::read(path).unwrap();
    assert!(read(&whole.frames.unwrap()) == read(&video.timestamps));
    // Again, and they are there.
    get(&path, phase).ended_with(0, &[]);
    get(&path, phase + 1).ended_with(PHONE, &["AB12", "by MTP", "extract --phone"]);

    // A copy that is cut short is not left.
    std::fs::remove_dir_all(&out).unwrap();
    let path = stand_in_adb(&tools, storage, "head -c 10 \"$(here \"$4\")\" > \"$5\"");
    get(&path, phase).ended_with(PHONE, &["10 bytes were copied"]);
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 0);

    // Without adb there is a line, and it does what it says.
    let nothing = folder.path().join("nothing");
    let output = get(nothing.as_os_str(), phase);
    output.ended_with(PHONE, &["`adb` is not on the PATH"]);
    let line = copy_command(PhoneNanos(phase), &out);
    output.ended_with(PHONE, &[&line]);
    let mounted = folder.path().join("gvfs/mtp:host=Phone/Internal/DCIM");
    std::fs::create_dir_all(&mounted).unwrap();
    std::os::unix::fs::symlink(storage, mounted.join("OpenCamera")).unwrap();
    // Also the files of a second video of a name.
    let path = stand_in_adb(&tools, storage, PULL);
    for number in ["", "_1", " (1)"] {
        number_files(storage, number);
        let mut copy = Command::new("sh");
        copy.env("XDG_RUNTIME_DIR", folder.path());
        run(copy.args(["-c", &line]));
        let come = || {
            let found = phone::video_files::find(&out, None).unwrap().unwrap();
            assert_eq!(found.missing(), ["video (.mp4)"]);
            assert!(found.name.ends_with(number), "{found:?}");
            std::fs::remove_dir_all(&out).unwrap();
        };
        come();
        get(&path, phase).ended_with(0, &["_imu_timestamps"]);
        come();
        std::fs::create_dir(&out).unwrap();
    }
}

/// Puts a number at the end of the names of all of the app's files, in the place of `_1`.
fn number_files(storage: &Path, number: &str) {
    for entry in std::fs::read_dir(storage).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            number_files(&path, number);
            continue;
        }
        let stem = path.file_stem().unwrap().to_str().unwrap();
        let stem = stem.trim_end_matches("_1");
        let extension = path.extension().unwrap().to_str().unwrap();
        let to = path.with_file_name(format!("{stem}{number}.{extension}"));
        std::fs::rename(&path, to).unwrap();
    }
}
