//! The program on the phone, from its copy to its end.

use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

use phone_agent::PATIENCE_S;
use system::Process;

use super::exchange::first_answer;
use crate::adb::{Adb, AdbError, PATIENCE};

/// Folder on the phone from which programs can be run without root access.
const FOLDER: &str = "/data/local/tmp";

/// Beginning of the names of the program's file and its socket.
const NAME: &str = "smartdepthsync-phone-agent";

/// One start of the program, and the port to it. Dropping this releases the port.
pub(super) struct Program {
    adb: Adb,
    pub(super) device: String,
    pub(super) port: u16,
    /// `adb shell`, which runs as long as the program does.
    shell: Option<Process>,
}

/// Finds the program's file for an instruction set, by Android's name: beside this executable, or
/// where a package installs it.
fn program_for(processor: &str) -> Option<PathBuf> {
    let name = format!("{NAME}-{processor}");
    let own = std::env::current_exe().ok()?;
    let folder = own.parent()?;
    let places = [
        folder.join(&name),
        folder
            .join("../share/smartdepthsync/phone-agent")
            .join(&name),
    ];
    places.into_iter().find(|place| place.is_file())
}

impl Program {
    /// Copies the program to the phone, starts it there, and waits until it answers. Removes its
    /// file if it does not.
    pub(super) fn start(
        adb: &Adb,
        device: &str,
        now: fn() -> Duration,
    ) -> Result<(Self, TcpStream), AdbError> {
        let said = adb.shell(device, "getprop ro.product.cpu.abilist")?;
        let file = said.trim().split(',').find_map(program_for);
        let Some(source) = file else {
            return Err(AdbError::NoAgent {
                processors: said.trim().to_owned(),
            });
        };
        let number = u64::from(std::process::id()) << 32
            | std::time::SystemTime::now()
                .duration_since(std::time::UNIX_EPOCH)
                .map_or(0, |since| u64::from(since.subsec_nanos()));
        let socket = format!("{NAME}-{number:x}");
        let file = format!("{FOLDER}/{socket}");
        let pushed = adb.run_for(device, &["push", &source.to_string_lossy(), &file]);
        let started = pushed.and_then(|_| {
            let program = Self::launch(adb, device, &file, &socket)?;
            let stream = first_answer(program.port, now, adb.cancel())?;
            Ok((program, stream))
        });
        if started.is_err() {
            adb.clean_up(device, &["shell", &format!("rm -f {file}")]);
        }
        started
    }

    /// Starts the copied file, and has a port forwarded to it.
    fn launch(adb: &Adb, device: &str, file: &str, socket: &str) -> Result<Self, AdbError> {
        adb.shell(device, &format!("chmod 755 {file}"))?;
        let line = format!("{file} {socket} {PATIENCE_S}");
        let mut command = Command::new(adb.program());
        command
            .args(["-s", device, "shell", &line])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let shell = Process::spawn(&mut command).map_err(|source| adb.cannot_run(source))?;
        let forward = ["forward", "tcp:0", &format!("localabstract:{socket}")];
        let said = adb.run_to_end(device, &forward, PATIENCE)?;
        let port = said.trim().parse().map_err(|_| AdbError::Failed {
            command: String::from("forward tcp:0"),
            reason: format!("expected a port, found {:?}", said.trim()),
        })?;
        Ok(Self {
            adb: adb.clone(),
            device: device.to_owned(),
            port,
            shell: Some(shell),
        })
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.shell = None;
        let port = format!("tcp:{}", self.port);
        let remove = ["forward", "--remove", &port];
        self.adb.clean_up(&self.device, &remove);
    }
}
