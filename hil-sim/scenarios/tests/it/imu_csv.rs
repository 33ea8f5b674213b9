//! A simulated twist through the whole chain: rig, firmware, pseudo-terminal,
//! `smartdepthsync board imu --out`, and pandas.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use crate::support;
use crate::whole_rig::run_python;

/// Virtual time against real time: a program that is slow to start, by 2 s, must not miss
/// the rest before the twist.
const SPEED: &str = "3";

/// Seconds of the CSV: the rest, and 8 s of the twist after it.
const DURATION: &str = "18s";

/// `hil-sim serve` with its port; ends with the test.
struct Serve {
    child: Child,
    port: String,
}

impl Serve {
    fn start(arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_hil-sim"))
            .arg("serve")
            .args(arguments)
            .args(["--wait-for-host", "--quiet", "--speed", SPEED])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        let port = line
            .trim()
            .strip_prefix("port: ")
            .unwrap_or_else(|| panic!("no port: {line:?}"))
            .to_owned();
        Self { child, port }
    }
}

impl Drop for Serve {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

#[test]
fn pandas_sees_the_twist_in_the_csv() {
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("twist.csv");
    let rig = Serve::start(&["--seed", "5", "--motion", "rest:10,twist:10,rest"]);
    let output = Command::new(support::smartdepthsync())
        .args([
            "board",
            "imu",
            "--port",
            &rig.port,
            "--duration",
            DURATION,
            "--out",
        ])
        .arg(&csv)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    println!("{}", run_python("twist_csv.py", &[&csv]).trim());
}
