//! The port of the simulated phone's app: its clients, its lines, and how it goes.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rig::flash_log::Dark;
use rig::phone::{LinkFault, PhoneConfig, SimPhone, VideoMode};
use rig::true_clock::TrueClock;

use crate::phone_bench::on_a_walk;

const INVALID: [&str; 3] = ["ERROR", "v.0.1.1", "Invalid request"];

/// A phone in true time that passes several times as fast as real time.
struct Bench {
    phone: SimPhone,
    clock: TrueClock,
}

impl Bench {
    fn new(seed: u64, edit: impl FnOnce(&mut PhoneConfig)) -> Self {
        let clock = TrueClock::run_at(20.0);
        let (config, surroundings) = on_a_walk(seed, &clock, Arc::new(Dark), edit);
        let phone = SimPhone::start(config, surroundings, 0).unwrap();
        Self { phone, clock }
    }

    fn stream(&self) -> TcpStream {
        TcpStream::connect(self.phone.address()).unwrap()
    }

    fn connect(&self) -> Client {
        let stream = self.stream();
        let patience = Some(Duration::from_secs(20));
        stream.set_read_timeout(patience).unwrap();
        Client(BufReader::new(stream))
    }

    fn listens(&self) -> bool {
        TcpStream::connect(self.phone.address()).is_ok()
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.clock.stop();
    }
}

/// A connection that is read and written as it is.
struct Client(BufReader<TcpStream>);

impl Client {
    fn send(&mut self, text: &str) {
        self.0.get_mut().write_all(text.as_bytes()).unwrap();
    }

    /// The lines of one answer, without `end`.
    fn answer(&mut self) -> Vec<String> {
        let lines = self.0.by_ref().lines().map(Result::unwrap);
        lines.take_while(|line| line != "end").collect()
    }

    fn ask(&mut self, request: &str) -> Vec<String> {
        self.send(&format!("{request}\n"));
        self.answer()
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        self.0.read_exact(&mut bytes).unwrap();
        bytes
    }

    /// True if nothing comes for a while.
    fn is_silent(&mut self) -> bool {
        let stream = self.0.get_ref();
        let patience = stream.read_timeout().unwrap();
        let short = Some(Duration::from_millis(200));
        stream.set_read_timeout(short).unwrap();
        let silent = self.0.buffer().is_empty() && stream.peek(&mut [0]).is_err();
        stream.set_read_timeout(patience).unwrap();
        silent
    }
}

fn until(what: &str, mut is: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is() {
        assert!(begun.elapsed() < Duration::from_secs(60), "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn each_line_has_its_answer_in_order_and_one_client_is_served_at_a_time() {
    let bench = Bench::new(8, |_| ());
    let mut first = bench.connect();
    // A carriage return and a line feed end one line; each alone ends one too.
    first.send("a\r\nb\rc\n");
    for _ in 0..3 {
        assert_eq!(first.answer(), INVALID);
    }
    first.send("imu?duration=500&accel=0&gyro=1&magnetic=0\n\n");
    assert_eq!(first.answer().last().unwrap(), "sensor_end");
    assert_eq!(first.answer(), INVALID);
    assert!(first.is_silent());
    let mut second = bench.connect();
    second.send("y\n");
    assert!(second.is_silent());
    drop(first);
    assert_eq!(second.answer(), INVALID);
}

#[test]
fn a_connection_is_in_step_behind_the_bytes_of_a_video() {
    let bench = Bench::new(10, |c| {
        c.camera.rows = 64;
        c.camera.columns = 16;
    });
    let mut phone = bench.connect();
    phone.ask("video_start");
    phone.ask("video_stop");
    let head = phone.ask("get_video");
    let video = phone.bytes(head[2].parse().unwrap());
    assert_eq!(&video[4..8], b"ftyp");
    assert_eq!(phone.ask("x"), INVALID);
}

#[test]
fn the_link_can_fail_in_all_ways() {
    let bench = Bench::new(13, |_| ());
    bench.phone.set_fault(Some(LinkFault::CutAfter(10)));
    let mut phone = bench.connect();
    phone.send("x\n");
    assert_eq!(phone.bytes(10), b"ERROR\nv.0.");
    bench.phone.set_fault(Some(LinkFault::Silent));
    let mut phone = bench.connect();
    phone.send("x\n");
    assert!(phone.is_silent());
    bench.phone.set_fault(None);
    assert_eq!(phone.ask("x"), INVALID);
    drop(phone);

    bench.phone.leave_network();
    assert!(!bench.listens());
    bench.phone.join_network().unwrap();
    assert_eq!(bench.connect().ask("x"), INVALID);
    // An app that has ended is opened again (RRH:208).
    let mut left = bench.stream();
    left.write_all(b"get_video\n").unwrap();
    assert_eq!(left.read(&mut [0]).unwrap(), 0);
    until("it listens", || !bench.listens());
    bench.phone.reopen_app().unwrap();
    assert_eq!(bench.connect().ask("x"), INVALID);
}

/// RSS:153: `readLine` gives the last line without its end; what a client has left is
/// carried out when its turn comes.
#[test]
fn requests_of_clients_that_have_gone_are_carried_out() {
    for request in ["video_start", "video_start\n"] {
        let bench = Bench::new(61, |c| c.video = VideoMode::Never);
        let mut first = bench.connect();
        assert_eq!(first.ask("x"), INVALID);
        bench.stream().write_all(request.as_bytes()).unwrap();
        assert!(first.is_silent());
        assert!(!bench.phone.is_recording());
        drop(first);
        until("it records", || bench.phone.is_recording());
    }
}

/// `MainActivity.java`, `onPause`: what runs ends, and so does the server; RSS:134 and 169:
/// a client that stays keeps the port from the next.
#[test]
fn in_the_background_recordings_and_server_end() {
    let bench = Bench::new(62, |c| {
        c.video = VideoMode::Never;
        c.app.background_ms = 500.0;
    });
    bench.phone.send_to_background();
    until("it listens", || !bench.listens());
    assert!(bench.phone.bring_to_foreground().unwrap());

    let mut phone = bench.connect();
    assert_eq!(phone.ask("video_start")[0], "SUCCESS");
    // The server looks whether it is to end once behind each answer: let it wait for the
    // next request first.
    assert!(phone.is_silent());
    bench.phone.send_to_background();
    until("the video ends", || !bench.phone.is_recording());
    // Held all the time: the new server does not get the port.
    assert!(!bench.phone.bring_to_foreground().unwrap());
    assert_eq!(phone.ask("x"), INVALID);
    until("it listens", || !bench.listens());
    bench.phone.send_to_background();
    assert!(bench.phone.bring_to_foreground().unwrap());
    assert_eq!(bench.connect().ask("x"), INVALID);
}

/// A Python client that reads as the app's published one does runs on the simulated phone
/// (`python/phone_client.py` says what is special about it).
#[test]
fn the_python_client_gets_all_it_asks_for() {
    for version in ["v.0.1", "v.0.1.1"] {
        let bench = Bench::new(30, |c| {
            c.version = version.to_owned();
            c.camera.rows = 120;
            c.camera.columns = 16;
            // It knows no sensors that still run, and relies on Nagle's algorithm.
            c.app.stop_ms = 0.0;
            c.app.gathers = true;
        });
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/phone_client.py");
        let address = bench.phone.address();
        let output = Command::new("python3")
            .arg(script)
            .args([address.ip().to_string(), address.port().to_string()])
            .arg(version)
            .output()
            .expect("python3 is needed for this test");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{said}");
    }
}
