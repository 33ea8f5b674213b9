//! The program as a process, against ports of all kinds: what `board info` and
//! `board list` print, and how each way to fail ends.
#![cfg(unix)]

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;
use std::sync::mpsc::channel;

use crate::support::{self, StandIn, code, polite, run};
use protocol::{DeviceToHost, HostToDevice, usb};
use test_support::TestFolder;
use test_support::board::{frame, hello};
use test_support::processes::PATIENCE;

#[test]
fn info_says_who_the_board_is() {
    let board = StandIn::new(polite);
    let output = run(&["board", "info", "--port", &board.path, "--json"]);
    assert_eq!(code(&output), 0, "{output:?}");
    let info = output.json();
    assert_eq!(info["id"], "AB0102030405060708090A0B");
    assert_eq!(info["firmware"], "1.2.3");
    assert_eq!(info["git_revision"], "0123456789ab");
    assert_eq!(info["git_dirty"], true);
    assert_eq!(info["now_ticks"], 4_320_000_000_u64);
    assert_eq!(info["reset_cause"], "Watchdog");
    assert_eq!(info["last_panic"], "trigger.rs:12: odd");
    assert_eq!(info["model"], "BlackPill");
    assert_eq!(info["has_outputs"], false);
    assert_eq!(info["imu"]["sensor"]["model"], "Icm42688P");

    assert_eq!(info["imu"]["sensor"]["gyro_bandwidth_hz_times_10"], 2_467);
}

#[test]
fn a_silent_port_and_another_device_are_not_this_board() {
    for (says, expected) in [(&b""[..], 10), (b"\r\nERROR\r\n\0", 8)] {
        let other = StandIn::new(|_: HostToDevice| says.to_vec());
        let output = run(&["board", "info", "--port", &other.path]);
        assert_eq!(code(&output), expected, "{output:?}");
    }
}

#[test]
fn another_protocol_version_has_its_own_code_and_nothing_is_recorded() {
    let newer = StandIn::new(|_: HostToDevice| {
        let mut hello = hello();
        hello.protocol_version = 900;
        frame(&DeviceToHost::Hello(hello))
    });
    let folder = TestFolder::new();
    let out = folder.path().join("recordings");
    let out = out.to_str().unwrap();
    for arguments in [&["board", "info"][..], &["record", "--yes", "--out", out]] {
        let output = run(&[arguments, &["--port", &newer.path]].concat());
        assert_eq!(code(&output), 9, "{output:?}");
    }
    assert!(!folder.path().join("recordings").exists());
}

#[test]
fn a_port_in_use_is_busy() {
    let board = StandIn::new(polite);
    let _holder = serialport::new(&board.path, 115_200).open().unwrap();
    let output = run(&["board", "info", "--port", &board.path, "--json"]);
    assert_eq!(code(&output), 7, "{output:?}");
    let error = output.json();
    assert_eq!(error["error"]["exit_code"], 7);
    assert_eq!(error["error"]["name"], "Busy");
    assert!(error["error"]["next_step"].is_string());
}

#[test]
fn a_port_without_permission_has_its_own_code() {
    let board = StandIn::new(polite);
    std::fs::set_permissions(&board.path, Permissions::from_mode(0o000)).unwrap();
    // Root may open anything, so root runs a copy of the program as nobody.
    let place = TestFolder::new();
    std::fs::set_permissions(place.path(), Permissions::from_mode(0o755)).unwrap();
    let copy = place.path().join("smartdepthsync");
    std::fs::copy(env!("CARGO_BIN_EXE_smartdepthsync"), &copy).unwrap();
    let mut command = if rustix::process::geteuid().is_root() {
        let mut command = Command::new("setpriv");
        command.args(["--reuid", "65534", "--regid", "65534", "--clear-groups"]);
        command.arg(copy);
        command
    } else {
        Command::new(copy)
    };
    let output = command
        .args(["board", "info", "--port", &board.path])
        .output()
        .unwrap();
    assert_eq!(code(&output), 6, "{output:?}");
}

#[test]
fn a_board_that_goes_away_is_a_lost_link() {
    let mut left = 2;
    let (asks, asked) = channel();
    let board = StandIn::new(move |command: HostToDevice| {
        left -= 1;
        if left < 0 {
            let _ = asks.send(());
            Vec::new()
        } else {
            polite(command)
        }
    });
    let child = support::program(&["board", "info", "--port", &board.path])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    asked.recv_timeout(PATIENCE).unwrap();
    drop(board);
    let output = child.wait_with_output().unwrap();
    assert_eq!(code(&output), 11, "{output:?}");
}

#[test]
fn the_udev_rule_names_this_board() {
    let rule = include_str!("../../../live/udev/60-smartdepthsync.rules");
    let rule: Vec<&str> = rule.lines().filter(|line| !line.starts_with('#')).collect();
    // The board's, and that of the loader in its ROM.
    assert_eq!(rule.len(), 2);
    for part in [
        format!("ATTRS{{manufacturer}}==\"{}\"", usb::MANUFACTURER),
        format!("ATTRS{{product}}==\"{}\"", usb::PRODUCT),
    ] {
        assert!(rule[0].contains(&part), "the rule lacks {part}");
    }
    // AN2606: "STM Device in DFU Mode".
    for part in ["idVendor}==\"0483\"", "idProduct}==\"df11\""] {
        assert!(rule[1].contains(part), "the loader's rule lacks {part}");
    }
}
