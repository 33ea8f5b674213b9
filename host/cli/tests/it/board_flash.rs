//! `board flash` with a board that answers and a stand-in for `dfu-util`, a script that keeps the
//! chip's flash in a file. What dfu-util and the chip's loader do with each other is not shown
//! here; the firmware's way into the ROM and back is (`hil-sim/rig/tests/it/board.rs`).
#![cfg(unix)]

use std::fs;
use std::path::Path;

use crate::support::{self, StandIn, code, greeting, polite, script, text};
use protocol::{Answer, Command as BoardCommand, DeviceToHost, HostToDevice, Refusal, Reply};
use test_support::TestFolder;
use test_support::board::{frame, hello};
use test_support::processes::Ran;

/// Lines as dfu-util 0.11 prints them.
const DFU_UTIL: &str = r#"#!/bin/sh
cd "$(dirname "$0")" || exit 1
case "$1" in
--version) exit 0 ;;
--list)
    [ -e rom ] && echo 'Found DFU: [0483:df11] ver=2200, devnum=9, cfg=1, intf=0, path="1-2", alt=1, name="@Option Bytes  /0x1FFFC000/01*016 e", serial="3262355B3231"' &&
        echo 'Found DFU: [0483:df11] ver=2200, devnum=9, cfg=1, intf=0, path="1-2", alt=0, name="@Internal Flash  /0x08000000/04*016Kg,01*064Kg,03*128Kg", serial="3262355B3231"'
    exit 0 ;;
esac
[ "$1 $2 $3 $4 $5" = "--device ,0483:df11 --alt 0 --dfuse-address" ] || exit 64
case "$7" in
--download) [ "$6" = 0x08000000 ] && head -c -16 "$8" > flash ;;
--upload)
    size=${6#0x08000000:}
    head -c "${size%:leave}" flash > "$8"
    [ -e worn ] && printf x | dd of="$8" bs=1 seek=7 conv=notrunc 2>/dev/null
    case "$size" in *:leave) rm -f rom; touch left ;; esac ;;
esac
exit 0
"#;

fn image(board: &str, revision: &str) -> Vec<u8> {
    let mut flash = vec![0x5A; 3_000];
    flash.extend(format!("SmartDepthSync image;{board};0.1.0;{revision};").bytes());
    test_support::dfu_image(flash)
}

/// A board that is off the bus while `rom` is there, and runs `revision` afterwards.
fn board(folder: &Path, answer: Result<(), Refusal>, revision: &'static str) -> StandIn {
    let folder = folder.to_owned();
    StandIn::new(move |command: HostToDevice| {
        if folder.join("rom").exists() {
            return Vec::new();
        }
        match command.command {
            BoardCommand::RestartIntoRom(_) => {
                if answer.is_ok() {
                    fs::write(folder.join("rom"), "").unwrap();
                }
                frame(&DeviceToHost::Answer(Answer {
                    id: command.id,
                    result: answer.map(Reply::RestartIntoRom),
                }))
            }
            BoardCommand::SayHello(_) if folder.join("left").exists() => {
                let mut now = hello();
                now.git_revision = revision.try_into().unwrap();
                greeting(command.id, now)
            }
            _ => polite(command),
        }
    })
}

fn flash(folder: &Path, board: &StandIn, more: &[&str]) -> Ran {
    let mut path = folder.as_os_str().to_owned();
    path.push(":/usr/bin:/bin");
    let mut command = support::program(&["board", "flash", "--json", "--port", &board.path]);
    command.env("PATH", path).arg("--image");
    Ran::new(command.arg(folder.join("image.dfu")).args(more))
}

#[test]
fn an_image_is_written_read_back_and_started_or_the_reason_is_said() {
    const NEW: &str = "fedcba987654";
    let good = || image("black-pill", NEW);
    let mut damaged = good();
    damaged[100] ^= 1;
    let busy = Refusal::OutputRunning;
    let worn = Some("worn");
    let refused = |name, image, word| (name, image, Ok(()), NEW, None, 3, word);
    // Image, answer, revision that runs afterwards, file that is there, exit code, word.
    for (name, image, answer, after, there, expected, word) in [
        ("in order", good(), Ok(()), NEW, None, 0, NEW),
        ("worn", good(), Ok(()), NEW, worn, 1, "does not hold"),
        ("another runs", good(), Ok(()), "0000", None, 1, "0000"),
        ("in use", good(), Err(busy), NEW, None, 3, "stop it first"),
        refused("damaged", damaged, "is damaged"),
        refused("cut", good()[..900].to_vec(), "cut short"),
        refused("other", image("discovery", NEW), "for a STM32F4DISCOVERY"),
    ] {
        let folder = TestFolder::new();
        let folder = folder.path();
        script(&folder.join("dfu-util"), DFU_UTIL);
        fs::write(folder.join("image.dfu"), &image).unwrap();
        if let Some(there) = there {
            fs::write(folder.join(there), "").unwrap();
        }
        let board = board(folder, answer, after);
        let output = flash(folder, &board, &[]);
        assert_eq!(code(&output), expected, "{name}: {output:?}");
        let said = text(&output.stdout);
        assert!(said.contains(word), "{name}: {said}");
        let was_written = folder.join("flash").exists();
        assert_eq!(was_written, expected != 3, "{name}");
        if expected == 0 {
            let written = fs::read(folder.join("flash")).unwrap();
            assert_eq!(written, image[..image.len() - 16]);
            assert!(!folder.join("rom").exists());
        }
    }
}

/// Where no firmware answers, the person names the board and starts the loader.
#[test]
fn a_board_without_firmware_is_flashed_when_it_is_named() {
    let folder = TestFolder::new();
    let folder = folder.path();
    script(&folder.join("dfu-util"), DFU_UTIL);
    let image = image("black-pill", "fedcba987654");
    fs::write(folder.join("image.dfu"), image).unwrap();
    fs::write(folder.join("rom"), "").unwrap();
    let board = board(folder, Ok(()), "fedcba987654");
    let unnamed = flash(folder, &board, &[]);
    assert_eq!(code(&unnamed), 10, "{unnamed:?}");
    let error = unnamed.json()["error"].clone();
    assert!(
        error["next_step"].as_str().unwrap().contains("--board"),
        "{error}"
    );
    let named = flash(folder, &board, &["--board", "black-pill"]);
    assert_eq!(code(&named), 0, "{named:?}");
}
