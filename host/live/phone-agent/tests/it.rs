//! The program as it runs on phones, on an emulated processor of each kind.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::{Read as _, Write as _};
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::net::{SocketAddr, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use phone_agent::{ANSWER, Answer, question};
use test_support::processes::is_installed;

/// Silence after which the agent ends.
const PATIENCE: Duration = Duration::from_secs(3);

/// A running program of one instruction set, which is killed when it is dropped.
struct Agent {
    child: Child,
    file: PathBuf,
    address: SocketAddr,
    _folder: Folder,
}

struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

impl Drop for Agent {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Agent {
    fn start(emulator: &str, processor: &str, test: &str) -> Self {
        let target = match std::env::var_os("CARGO_TARGET_DIR") {
            Some(folder) => PathBuf::from(folder),
            None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../target"),
        };
        let built = target.join(format!("release/smartdepthsync-phone-agent-{processor}"));
        assert!(
            built.is_file(),
            "there is no {}: run `cargo xtask build`",
            built.display()
        );
        let size = built.metadata().unwrap().len();
        assert!(size < 20_000, "{} has {size} bytes", built.display());
        let name = format!("agent-{processor}-{test}-{}", std::process::id());
        let folder = Folder(std::env::temp_dir().join(&name));
        std::fs::create_dir(&folder.0).unwrap();
        let file = folder.0.join("agent");
        std::fs::copy(&built, &file).unwrap();
        let child = Command::new(emulator)
            .args([file.as_os_str(), name.as_ref()])
            .arg(PATIENCE.as_secs().to_string())
            .spawn();
        let child = child.unwrap();
        Self {
            child,
            file,
            address: SocketAddr::from_abstract_name(&name).unwrap(),
            _folder: folder,
        }
    }

    fn connect(&self) -> UnixStream {
        let begun = Instant::now();
        loop {
            match UnixStream::connect_addr(&self.address) {
                Ok(stream) => {
                    stream
                        .set_read_timeout(Some(Duration::from_secs(5)))
                        .unwrap();
                    return stream;
                }
                Err(error) => assert!(begun.elapsed() < Duration::from_secs(20), "{error}"),
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

fn ask(stream: &mut UnixStream, nonce: u64) -> Answer {
    stream.write_all(&question(nonce)).unwrap();
    let mut bytes = [0; ANSWER];
    stream.read_exact(&mut bytes).unwrap();
    Answer::read(&bytes).unwrap()
}

/// Returns Linux' boot clock in nanoseconds. Its file has a resolution of 10 ms.
fn boot_ns() -> i64 {
    let text = std::fs::read_to_string("/proc/uptime").unwrap();
    let seconds: f64 = text.split(' ').next().unwrap().parse().unwrap();
    (seconds * 1e9) as i64
}

fn answers_and_ends(emulator: &str, processor: &str) {
    let mut agent = Agent::start(emulator, processor, "clocks");
    let mut host = agent.connect();
    let mut last = Answer {
        nonce: 0,
        boot_ns: boot_ns() - 20_000_000,
        monotonic_ns: 0,
    };
    for nonce in [7, u64::MAX, 0] {
        let answer = ask(&mut host, nonce);
        assert_eq!(answer.nonce, nonce);
        assert!(answer.boot_ns >= last.boot_ns && answer.monotonic_ns > last.monotonic_ns);
        assert!(answer.boot_ns <= boot_ns() + 20_000_000);
        last = answer;
    }
    assert!(!agent.file.exists(), "it leaves its file");
    // Bytes that are not question end the connection, not the program.
    let mut other = host;
    other.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
    let mut rest = Vec::new();
    let _ = other.read_to_end(&mut rest);
    assert!(rest.is_empty(), "{rest:?}");
    let mut host = agent.connect();
    ask(&mut host, 1);
    // The host is silent, though its connection stays.
    let begun = Instant::now();
    let limit = PATIENCE + Duration::from_secs(10);
    while agent.child.try_wait().unwrap().is_none() {
        assert!(begun.elapsed() < limit, "it still runs");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(begun.elapsed() > PATIENCE / 2);
}

#[test]
fn on_aarch64_it_answers_and_ends_without_its_host() {
    if is_installed("qemu-aarch64", "qemu-user") {
        answers_and_ends("qemu-aarch64", "arm64-v8a");
    }
}

#[test]
fn on_armv7_it_answers_and_ends_without_its_host() {
    if is_installed("qemu-arm", "qemu-user") {
        answers_and_ends("qemu-arm", "armeabi-v7a");
    }
}
