//! Live data for Foxglove: a viewer sees what is recorded, one that does not read
//! costs nothing, and nothing listens unless it is asked for.

use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpStream};
use std::process::Command;
use std::sync::mpsc::channel;
use std::time::Duration;

use crate::support;
use crate::turn;
use crate::whole_rig::{Session, WholeRig};
use board::imu::Sample;
use protocol::{ImuFlags, Ticks};
use recording::Topic;
use recording::messages::{Imu, Pulse, from_cdr};
use recording::reader::{Item, Reader, ticks_of_nanos};
use recording::session_file::SessionFile;
use recording::writer::Publisher;
use serde_json::{Value, json};
use smartdepthsync::live_data::{LiveData, STATE_TOPIC};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::http::HeaderValue;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket, connect};

/// The longest that is waited, for what takes a moment.
const PATIENCE: Duration = Duration::from_secs(60);

/// What Foxglove does: connects, reads which channels there are, subscribes.
struct Viewer {
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    /// The channels as they were advertised, by their topics.
    channels: BTreeMap<String, Value>,
}

impl Viewer {
    fn connect(url: &str) -> Self {
        let mut request = url.into_client_request().unwrap();
        request.headers_mut().insert(
            "Sec-WebSocket-Protocol",
            HeaderValue::from_static("foxglove.sdk.v1"),
        );
        let (socket, _) = connect(request).unwrap();
        let mut viewer = Self {
            socket,
            channels: BTreeMap::new(),
        };
        let info = viewer.text("serverInfo");
        assert_eq!(info["name"], "smartdepthsync");
        // Who looks on may not do anything.
        assert_eq!(info["capabilities"], json!([]), "{info}");
        for channel in viewer.text("advertise")["channels"].as_array().unwrap() {
            let topic = channel["topic"].as_str().unwrap().to_owned();
            viewer.channels.insert(topic, channel.clone());
        }
        viewer
    }

    /// The next message of a kind.
    fn text(&mut self, op: &str) -> Value {
        loop {
            if let Message::Text(text) = self.socket.read().unwrap() {
                let value: Value = serde_json::from_str(&text).unwrap();
                if value["op"] == op {
                    return value;
                }
            }
        }
    }

    /// Subscribes to topics, each under its place in the list.
    fn subscribe(&mut self, topics: &[&str]) {
        let subscriptions: Vec<Value> = topics
            .iter()
            .enumerate()
            .map(|(id, &topic)| json!({"id": id, "channelId": self.channels[topic]["id"]}))
            .collect();
        let text = json!({"op": "subscribe", "subscriptions": subscriptions}).to_string();
        self.socket.send(Message::text(text)).unwrap();
    }

    /// The next message: place of its topic in the list, time, data. None at the
    /// server's end.
    fn next(&mut self) -> Option<(usize, Ticks, Vec<u8>)> {
        loop {
            if let Message::Binary(bytes) = self.socket.read().ok()? {
                assert_eq!(bytes[0], 1, "a message's data");
                let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                let nanos = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                let at = ticks_of_nanos(nanos);
                return Some((id.try_into().unwrap(), at, bytes[13..].to_vec()));
            }
        }
    }
}

/// Where a program says that it serves.
fn served(session: &mut Session) -> String {
    session.wait_for("ws://127.0.0.1:");
    // The line may come in parts.
    loop {
        let said = session.said();
        let at = said.find("ws://").unwrap();
        if let Some((url, _)) = said[at..].split_once(char::is_whitespace) {
            return url.to_owned();
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn a_viewer_sees_what_is_recorded_and_one_that_does_not_read_costs_nothing() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(61, 3.0);
    let mut command = rig.record("live", &["--duration", "12s", "--foxglove", "127.0.0.1:0"]);
    let mut session = Session::start(&mut command);
    let url = served(&mut session);
    let mut viewer = Viewer::connect(&url);
    let mut idle = Viewer::connect(&url);
    let everything: Vec<String> = idle.channels.keys().cloned().collect();
    idle.subscribe(&everything.iter().map(String::as_str).collect::<Vec<_>>());
    // No message of the raw link; all others of a recording, and the state.
    assert!(!viewer.channels.contains_key(Topic::Link.name()));
    assert_eq!(viewer.channels.len(), 18, "{:?}", viewer.channels.keys());
    let imu = &viewer.channels[Topic::Imu.name()];
    assert_eq!(imu["encoding"], "cdr");
    assert_eq!(imu["schemaEncoding"], "ros2msg");
    assert_eq!(imu["schemaName"], "sensor_msgs/msg/Imu");
    let schema = imu["schema"].as_str().unwrap();
    assert!(schema.contains("geometry_msgs/Vector3 angular_velocity"));

    viewer.subscribe(&[Topic::Imu.name(), Topic::Pulse.name(), STATE_TOPIC]);
    let mut samples: BTreeMap<Ticks, Imu> = BTreeMap::new();
    let mut pulses: BTreeMap<Ticks, Pulse> = BTreeMap::new();
    let mut states = Vec::new();
    while let Some((topic, at, data)) = viewer.next() {
        match topic {
            0 => drop(samples.insert(at, from_cdr(&data).unwrap())),
            1 => drop(pulses.insert(at, from_cdr(&data).unwrap())),
            _ => states.push(serde_json::from_slice::<Value>(&data).unwrap()),
        }
    }
    drop(idle);
    session.ends_with(0);

    let file = SessionFile::load(&rig.recording("live")).unwrap();
    assert_eq!(file.counts.lost(), 0);
    let seen = |word: &str| states.iter().any(|state| state["state"] == word);
    assert!(seen("recording"), "{:?}", states.last());
    assert!(
        states
            .iter()
            .any(|state| state["clock"]["sigma_us"].is_f64())
    );
    // To the tick and the bit what is in the recording.
    let (mut same_samples, mut same_pulses) = (0, 0);
    for entry in Reader::open(&rig.recording("live")).unwrap() {
        let entry = entry.unwrap();
        match entry.item {
            Item::Imu(recorded) => {
                if let Some(shown) = samples.remove(&entry.at) {
                    assert_eq!(shown, recorded);
                    same_samples += 1;
                }
            }
            Item::Pulse(recorded) => {
                if let Some(shown) = pulses.remove(&entry.at) {
                    assert_eq!(shown, recorded);
                    same_pulses += 1;
                }
            }
            _ => {}
        }
    }
    assert!(samples.is_empty() && pulses.is_empty(), "not recorded");
    assert!(same_samples > 500, "{same_samples}");
    assert!(same_pulses > 30, "{same_pulses}");
}

#[test]
fn the_monitor_serves_too_and_only_if_it_is_asked_to() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(62, 4.0);
    let monitor = |options: &[&str]| {
        let mut command = Command::new(support::smartdepthsync());
        command.args(["monitor", "--port"]).arg(rig.rig.port());
        command.args(options);
        command
    };
    let mut session = Session::start(&mut monitor(&["--foxglove", "127.0.0.1:0"]));
    let url = served(&mut session);
    assert!(!listeners(session.id()).is_empty());
    let mut viewer = Viewer::connect(&url);
    viewer.subscribe(&[Topic::Imu.name(), STATE_TOPIC]);
    let mut seen = [0; 2];
    while seen.contains(&0) {
        let (topic, _, data) = viewer.next().unwrap();
        seen[topic] += 1;
        if topic == 1 {
            let state: Value = serde_json::from_slice(&data).unwrap();
            assert_eq!(state["state"], "monitor");
        }
    }
    // The port is taken now; that is told before the board is looked for.
    let port = url.rsplit_once(':').unwrap().1;
    let output = Command::new(support::smartdepthsync())
        .args(["monitor", "--port", "/no/such/port", "--foxglove"])
        .arg(format!("127.0.0.1:{port}"))
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let taken = String::from_utf8(output.stderr).unwrap();
    assert!(taken.contains("cannot serve live data"), "{taken}");
    assert!(taken.contains("take another port"), "{taken}");
    session.signal(rustix::process::Signal::INT);
    session.ends_with(0);

    let mut session = Session::start(&mut monitor(&[]));
    session.wait_for("imu 500/s");
    assert_eq!(listeners(session.id()), Vec::<String>::new());
    session.signal(rustix::process::Signal::INT);
    session.ends_with(0);
}

/// Whoever connects cannot write into the log: what a client does wrong is the client's.
#[test]
fn nonsense_from_a_viewer_is_not_logged() {
    let _turn = turn::beside_others();
    let rig = WholeRig::new(63, 4.0);
    let mut command = Command::new(support::smartdepthsync());
    command.args(["monitor", "--foxglove", "127.0.0.1:0", "--port"]);
    let mut session = Session::start(command.arg(rig.rig.port()));
    let url = served(&mut session);
    let mut viewer = Viewer::connect(&url);
    for text in [
        "nonsense",
        "{\"op\": \"nonsense\"}",
        "{\"op\": \"getParameters\", \"parameterNames\": []}",
    ] {
        viewer.socket.send(Message::text(text)).unwrap();
    }
    let subscription = json!([{"id": 1, "channelId": 4_000_000_000_u32}]);
    let unknown = json!({"op": "subscribe", "subscriptions": subscription});
    viewer
        .socket
        .send(Message::text(unknown.to_string()))
        .unwrap();
    viewer.socket.send(Message::binary(vec![255; 99])).unwrap();
    let mut raw = TcpStream::connect(url.trim_start_matches("ws://")).unwrap();
    std::io::Write::write_all(&mut raw, &[7; 4_000]).unwrap();
    drop(raw);
    // It is served on, and so has read all that.
    viewer.subscribe(&[STATE_TOPIC]);
    viewer.next().unwrap();
    session.signal(rustix::process::Signal::INT);
    let said = session.ends_with(0);
    for word in ["ERROR", "WARN", "nvalid", "nonsense", "handshake"] {
        assert!(!said.contains(word), "{word}: {said}");
    }
}

/// The TCP sockets of a process that listen, by their local addresses.
fn listeners(process: u32) -> Vec<String> {
    let mut own = Vec::new();
    for entry in std::fs::read_dir(format!("/proc/{process}/fd")).unwrap() {
        let Ok(target) = std::fs::read_link(entry.unwrap().path()) else {
            continue;
        };
        let target = target.to_string_lossy().into_owned();
        if let Some(inode) = target.strip_prefix("socket:[") {
            own.push(inode.trim_end_matches(']').to_owned());
        }
    }
    let mut found = Vec::new();
    for table in ["tcp", "tcp6"] {
        let text = std::fs::read_to_string(format!("/proc/{process}/net/{table}"));
        for line in text.unwrap_or_default().lines().skip(1) {
            let fields: Vec<&str> = line.split_whitespace().collect();
            // 0A: it listens.
            if fields[3] == "0A" && own.contains(&fields[9].to_owned()) {
                found.push(fields[1].to_owned());
            }
        }
    }
    found
}

#[test]
fn nobody_waits_for_a_viewer_that_does_not_read() {
    let _turn = turn::beside_others();
    let live = LiveData::open(SocketAddr::from(([127, 0, 0, 1], 0))).unwrap();
    let mut viewer = Viewer::connect(&format!("ws://127.0.0.1:{}", live.port()));
    viewer.subscribe(&[Topic::Imu.name()]);
    let mut topics = Publisher::new(live);
    let mut sample = Sample {
        at: Ticks(0),
        flags: ImuFlags::default(),
        gyro: [0.1, 0.2, 0.3],
        accel: [0.0, 0.0, 9.81],
        temperature: 25.0,
    };
    // Until it is subscribed.
    let (sender, first) = channel();
    let reader = std::thread::spawn(move || {
        let got = viewer.next();
        sender.send(()).unwrap();
        (viewer, got)
    });
    while first.try_recv().is_err() {
        topics.imu(&sample).unwrap();
        std::thread::sleep(Duration::from_millis(1));
    }
    let (mut viewer, got) = reader.join().unwrap();
    assert!(got.is_some());
    // Far more than all buffers between the two hold, and nobody reads.
    let (sender, done) = channel();
    let writer = std::thread::spawn(move || {
        for number in 1..=200_000_u64 {
            sample.at = Ticks(number * 96_000);
            topics.imu(&sample).unwrap();
        }
        sender.send(()).unwrap();
        topics
    });
    done.recv_timeout(PATIENCE)
        .expect("it waits for the viewer");
    // It missed some, and is still there; what it gets is in order.
    let mut last = Ticks(0);
    let mut count = 0_u64;
    while last < Ticks(200_000 * 96_000) {
        let (_, at, _) = viewer.next().expect("it was sent away");
        assert!(at > last || at == Ticks(0), "{at:?} after {last:?}");
        last = at;
        count += 1;
    }
    assert!(count < 200_000, "it got all {count}");
    drop(writer.join().unwrap());
}
