//! `smartdepthsync phone …` as a process against a phone with a script. The faults of a phone
//! are those of the client's own tests; a whole phone is the simulator's.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::process::Command;
use test_support::TestFolder;

/// Serves one client until it leaves, by a script. As the app does, it answers an empty line
/// with an error; its sensors are free.
fn serve(mut stream: &TcpStream, mut script: impl FnMut(&mut TcpStream)) {
    let mut writer = stream.try_clone().unwrap();
    for line in BufReader::new(&mut stream).lines() {
        let Ok(line) = line else { break };
        if line.is_empty() {
            let _ = writer.write_all(b"ERROR\nv.0.1.1\nInvalid request\nend\n");
        } else if line.contains("&accel=1&") {
            let _ = writer.write_all(b"SUCCESS\nv.0.1.1\nend\n");
        } else {
            script(&mut writer);
        }
    }
}

/// The address of a phone whose video never ends, for any number of clients.
pub(crate) fn endless() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for client in listener.incoming() {
            serve(&client.unwrap(), |stream| {
                let head = format!("{HEAD}{}\nVID.mp4\nend\n", 1_u64 << 35);
                let mut going = stream.write_all(head.as_bytes());
                while going.is_ok() {
                    going = stream.write_all(&[0; 1 << 20]);
                }
            });
        }
    });
    address
}

const HEAD: &str = "SUCCESS\nv.0.1.1\n";

#[test]
fn nothing_is_overwritten_unless_asked() {
    let folder = TestFolder::new();
    let path = folder.path().join("x.mp4");
    std::fs::write(&path, "precious").unwrap();
    let get = |more: &[&str]| {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let video = [
            format!("{HEAD}5\nx.mp4\nend\n").as_bytes(),
            &[0, 1, 2, 3, 4],
        ]
        .concat();
        let phone = std::thread::spawn(move || {
            serve(&listener.accept().unwrap().0, |stream| {
                let _ = stream.write_all(&video);
            });
        });
        // A program that hangs is ended, with exit code 124.
        let output = Command::new("timeout")
            .args(["30", env!("CARGO_BIN_EXE_smartdepthsync"), "phone"])
            .args(["get-video", "--recorded"])
            .args(more)
            .args(["--phone", &address, "--timeout", "20s"])
            .current_dir(folder.path())
            .output()
            .unwrap();
        phone.join().unwrap();
        output
    };
    let refused = get(&[]);
    assert_eq!(refused.status.code(), Some(13), "{refused:?}");
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    let done = get(&["--overwrite"]);
    assert_eq!(done.status.code(), Some(0), "{done:?}");
    assert_eq!(std::fs::read(&path).unwrap(), [0, 1, 2, 3, 4]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}
