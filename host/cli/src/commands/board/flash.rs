//! `smartdepthsync board flash`: firmware onto the board, by the chip's own loader.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use board::BoardInfo;
use board::image::{FLASH_START, Image};
use protocol::{BoardModel, Hello, RestartIntoRom};
use serde::Serialize;
use system::{Limits, Output, RunError};

use super::keep_trying;
use crate::context::Context;
use crate::options::PortArg;
use crate::outcome::{ExitStatus, Failure};

/// The loader in the chip's ROM (AN2606).
const LOADER: &str = "0483:df11";
/// The loader's first memory: the flash.
const FLASH: [&str; 2] = ["--alt", "0"];
/// Longest wait for the loader, or for the board after it.
const APPEARS: Duration = Duration::from_secs(20);
/// Longest run of `dfu-util`: several times that of a write of the whole flash.
const WRITING: Duration = Duration::from_secs(300);
/// Most bytes that it prints, bars of progress included.
const MAX_OUTPUT: usize = 16 << 20;
/// Longest wait for the user to set jumpers and press buttons.
const BY_HAND: Duration = Duration::from_secs(180);

/// Options of `board flash`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: smartdepthsync board flash")]
pub(crate) struct FlashArgs {
    /// Image to write, `smartdepthsync-firmware*.dfu` [default: the installed one]
    #[arg(long, value_name = "FILE")]
    image: Option<PathBuf>,
    /// Model of the board, if none answers: discovery or black-pill
    #[arg(long, value_name = "BOARD", value_parser = parse_board)]
    board: Option<BoardModel>,
}

fn parse_board(text: &str) -> Result<BoardModel, String> {
    BoardModel::from_key(text).ok_or_else(|| "expected discovery or black-pill".to_owned())
}

/// The result.
#[derive(Debug, Serialize)]
struct Flashed {
    image: PathBuf,
    #[serde(flatten)]
    board: BoardInfo,
}

/// Runs the command.
///
/// # Errors
///
/// The board cannot be reached, no image fits it, `dfu-util` is missing or fails, or what runs
/// afterwards is something else.
pub(crate) fn run(
    args: &FlashArgs,
    port: &PortArg,
    context: &Context,
) -> Result<ExitStatus, Failure> {
    let found = port.open();
    let model = match (&found, args.board) {
        (Ok(board), None) => board.hello().board,
        (Ok(board), Some(model)) if board.hello().board == model => model,
        (Ok(board), Some(model)) => {
            let text = format!(
                "the board that answers is a {}, not a {}",
                board.hello().board.name(),
                model.name()
            );
            return Err(Failure::new(ExitStatus::Refused, text).next_step("leave --board out"));
        }
        (Err(_), Some(model)) => model,
        (Err(_), None) => {
            let step = "say which board it is: `smartdepthsync board flash --board discovery` (or \
                        `black-pill`)";
            return found
                .map(|_| ExitStatus::Error)
                .map_err(|error| error.next_step(step));
        }
    };
    let (path, image) = choose_image(args.image.as_deref(), model)?;
    dfu_util(&["--version"])?;
    let patience = match found {
        Ok(mut board) => {
            board.call(RestartIntoRom)?;
            APPEARS
        }
        Err(error) => {
            context.say(error.to_string());
            context.say(format!("help: {}", by_hand(model)));
            BY_HAND
        }
    };
    wait_for_loader(patience, context, model)?;
    context.say(format!("writing {} ...", path.display()));
    write(&path, &image)?;
    let hello = reconnect(port, context)?;
    if hello.board != image.board || hello.git_revision != *image.revision {
        let text = format!(
            "the board runs revision {} and not the image's {}",
            hello.git_revision, image.revision
        );
        return Err(
            Failure::new(ExitStatus::Error, text).next_step("reset the board, and repeat it")
        );
    }
    context.show(&Flashed {
        image: path,
        board: BoardInfo::new(&hello),
    })?;
    Ok(ExitStatus::Good)
}

/// Starts of the loader without the firmware's help (`docs/install.md` of the book).
const fn by_hand(model: BoardModel) -> &'static str {
    match model {
        BoardModel::Discovery => {
            "start the chip's loader: put a jumper from BOOT0 to VDD (header P2) and one from \
             PB2 to GND (header P1), supply the board through its mini-USB socket, connect the \
             micro-USB socket, and press reset"
        }
        BoardModel::BlackPill => {
            "start the chip's loader: hold BOOT0, press and release NRST, release BOOT0"
        }
    }
}

/// The image that was named, or the installed one for this board.
fn choose_image(named: Option<&Path>, model: BoardModel) -> Result<(PathBuf, Image), Failure> {
    let Some(path) = named else {
        return installed(model).ok_or_else(|| {
            Failure::new(
                ExitStatus::Usage,
                format!("no image for a {} is installed", model.name()),
            )
            .next_step(
                "install the Debian package, or run `cargo xtask build` in a clone and give \
                 `--image target/release/smartdepthsync-firmware*.dfu`",
            )
        });
    };
    let image = Image::read(path).map_err(|error| {
        Failure::new(ExitStatus::Refused, format!("{}: {error}", path.display()))
            .next_step("take an image that `cargo xtask build` or the package has made")
    })?;
    if image.board != model {
        let text = format!(
            "{} is for a {}, and the board is a {}",
            path.display(),
            image.board.name(),
            model.name()
        );
        return Err(Failure::new(ExitStatus::Refused, text)
            .next_step("nothing was written; choose the other image"));
    }
    Ok((path.to_owned(), image))
}

/// The image beside this program, or where a package puts it.
fn installed(model: BoardModel) -> Option<(PathBuf, Image)> {
    let own = std::env::current_exe().ok()?;
    let folder = own.parent()?;
    let folders = [
        folder.to_owned(),
        folder.join("../share/smartdepthsync/firmware"),
    ];
    let files = (folders.iter())
        .filter_map(|folder| std::fs::read_dir(folder).ok())
        .flat_map(|entries| entries.flatten().map(|entry| entry.path()));
    files
        .filter(|path| path.extension().is_some_and(|ending| ending == "dfu"))
        .filter_map(|path| Image::read(&path).ok().map(|image| (path, image)))
        .find(|(_, image)| image.board == model)
}

fn dfu_util(arguments: &[&str]) -> Result<Output, Failure> {
    let limits = Limits {
        run: Some(WRITING),
        ..Limits::default()
    };
    let output = system::run(Command::new("dfu-util").args(arguments), limits, MAX_OUTPUT);
    output.map_err(|error| match error {
        RunError::Start(_) => {
            Failure::new(ExitStatus::Error, format!("cannot run dfu-util: {error}"))
                .next_step("install it: `sudo apt-get install dfu-util`")
        }
        error => dfu_failed(&error.to_string()),
    })
}

fn dfu_failed(reason: &str) -> Failure {
    Failure::new(ExitStatus::Error, format!("dfu-util failed: {reason}")).next_step(
        "repeat it with --board; the udev rule of the installation lets users open the loader",
    )
}

/// Waits until one loader is on the USB.
fn wait_for_loader(
    patience: Duration,
    context: &Context,
    model: BoardModel,
) -> Result<(), Failure> {
    let begun = Instant::now();
    loop {
        let listed = dfu_util(&["--list"])?;
        let listed = String::from_utf8_lossy(&listed.stdout);
        let loaders = (listed.lines())
            .filter(|line| line.contains(LOADER) && line.contains("alt=0,"))
            .count();
        match loaders {
            1 => return Ok(()),
            0 if context.interrupt.requested() => return Err(interrupted()),
            0 if begun.elapsed() < patience => std::thread::sleep(Duration::from_millis(200)),
            0 => {
                return Err(Failure::new(
                    ExitStatus::NoPort,
                    "the chip's loader did not appear on the USB",
                )
                .next_step(format!(
                    "{} Then repeat it with --board {}",
                    by_hand(model),
                    model.key()
                )));
            }
            _ => {
                return Err(Failure::new(
                    ExitStatus::Refused,
                    format!("{loaders} chips wait in their loader"),
                )
                .next_step("unplug all boards but the one to be flashed"));
            }
        }
    }
}

fn interrupted() -> Failure {
    Failure::new(ExitStatus::Interrupted, "interrupted")
        .next_step("reset the board: its firmware is as it was")
}

/// Writes the image, reads it back, and has the loader start it.
fn write(path: &Path, image: &Image) -> Result<(), Failure> {
    let folder = std::env::temp_dir().join(format!("smartdepthsync-{}", std::process::id()));
    std::fs::create_dir(&folder).map_err(|error| Failure::file("make", &folder, &error))?;
    let written = write_by(&folder, path, image);
    // What is left there is of no use, and the system clears it.
    let _ = std::fs::remove_dir_all(&folder);
    written
}

fn write_by(folder: &Path, path: &Path, image: &Image) -> Result<(), Failure> {
    let start = format!("{FLASH_START:#010x}");
    let transfer = |address: &str, way: &str, file: &Path| {
        let file = file.to_string_lossy();
        let device = format!(",{LOADER}");
        let mut arguments = vec!["--device", &device];
        arguments.extend(FLASH);
        arguments.extend(["--dfuse-address", address, way, &file]);
        let output = dfu_util(&arguments)?;
        if output.status.success() {
            return Ok(());
        }
        let last = output.messages.lines().next_back();
        Err(dfu_failed(last.unwrap_or("it says nothing")))
    };
    transfer(&start, "--download", path)?;
    let read_back = folder.join("read-back");
    let whole = format!("{start}:{}", image.flash.len());
    transfer(&whole, "--upload", &read_back)?;
    let found =
        std::fs::read(&read_back).map_err(|error| Failure::file("read", &read_back, &error))?;
    if found != image.flash {
        let text = "the flash does not hold what was written";
        return Err(Failure::new(ExitStatus::Error, text)
            .next_step("repeat it with --board; if it fails again, the chip's flash is worn out"));
    }
    // Only a transfer can ask the loader to leave.
    transfer(
        &format!("{start}:4:leave"),
        "--upload",
        &folder.join("leave"),
    )
}

/// Connects to the board once the loader has started its firmware.
fn reconnect(port: &PortArg, context: &Context) -> Result<Hello, Failure> {
    let in_vain = |error: &Failure| {
        error.status() == ExitStatus::OtherVersion || context.interrupt.requested()
    };
    let board = keep_trying(APPEARS, in_vain, || port.open())?;
    Ok(board.hello().clone())
}
